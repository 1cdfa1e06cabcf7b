"""``--quiet`` of every command: errors and the exit code alone, for jobs that nobody watches."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import IO, Any

import click

_spoken: list[IO[Any]] = []
"""Standard output of a command that is quiet; empty where it is not."""


def is_quiet() -> bool:
    """Return whether this command is to print neither facts nor notes, and to show no bar."""
    return bool(_spoken)


def asked_output() -> IO[Any]:
    """Return where what was asked for goes, a JSON object: also where nothing else is printed."""
    return _spoken[0] if _spoken else sys.stdout


def add_quiet(group: click.Group) -> None:
    """Give a group and every command below it the option."""
    for command in (group, *group.commands.values()):
        if command is not group and isinstance(command, click.Group):
            add_quiet(command)
            continue
        command.params.append(
            click.Option(
                ["--quiet"],
                is_flag=True,
                expose_value=False,
                callback=_silence,
                help="Print errors alone, and with --json its object: no facts, notes or bars.",
            )
        )


def _silence(_: click.Context, __: click.Parameter, value: bool) -> None:
    if value and not _spoken:
        from clrelight.opencl.probe import tell_nothing  # of no use to those who listen

        tell_nothing()
        _spoken.append(sys.stdout)
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - closed by `speaking_after`


@contextmanager
def speaking_after() -> Iterator[None]:
    """Give standard output back when the block has ended, where a command in it was quiet."""
    try:
        yield
    finally:
        if _spoken:
            with suppress(OSError):
                sys.stdout.close()
            sys.stdout = _spoken.pop()
