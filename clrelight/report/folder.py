"""A folder that is filled aside, and moved into place file by file once everything is made."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from clrelight.durable import claiming, folder_aside, reason_of
from clrelight.errors import InputError
from clrelight.interrupts import holding
from clrelight.report.canvas import require_matplotlib


def fill_folder(out_dir: str | os.PathLike[str], make: Callable[[Path], list[str]]) -> list[Path]:
    """Make files in a folder aside, and move them to `out_dir`, which is made if it does not exist.

    Files of the same names are replaced, all others are left alone; nothing is replaced before everything is made.

    Parameters
    ----------
    out_dir : path
    make : callable
        Gets the folder aside, and returns the relative paths of what it made there, in the order of moving.

    Returns
    -------
    list of Path
        The files, the last one first.

    Raises
    ------
    InputError
        If `out_dir` cannot be written to.
    """
    check_folder(out_dir)
    out = Path(os.fsdecode(out_dir)).resolve()
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with claiming(out), folder_aside(out) as aside:
            return _move(make(aside), aside, out)
    except OSError as error:
        raise InputError(f"cannot write the report to {os.fsdecode(out_dir)}: {reason_of(error)}") from error


def check_folder(out_dir: str | os.PathLike[str]) -> None:
    """Raise InputError if `out_dir` is a file."""
    out = Path(os.fsdecode(out_dir)).resolve()
    if out.exists() and not out.is_dir():
        raise InputError(f"{out_dir} is a file; give a folder to write the report into")


def check_report(out_dir: str | os.PathLike[str] | None) -> None:
    """Raise InputError if a report is wanted and could not be written, before the long work that it is about."""
    if out_dir is not None:
        require_matplotlib()
        check_folder(out_dir)


def write_text(path: Path, content: str) -> None:
    """Write UTF-8 with the same line ends everywhere."""
    path.write_text(content, encoding="utf-8", newline="\n")


def _move(written: list[str], source: Path, out: Path) -> list[Path]:
    """Move the files into place; InputError before the first if something stands in the way of any."""
    for path in written:
        if (out / path).is_dir():
            raise InputError(f"{out / path} is a folder, but the report has a file of that name; move it away")
        if (out / path).parent.exists() and not (out / path).parent.is_dir():
            raise InputError(f"{(out / path).parent} is a file, but the report has a folder of that name; move it away")
    with holding():  # all of them, or none
        for path in written:
            (out / path).parent.mkdir(parents=True, exist_ok=True)
            os.replace(source / path, out / path)
    return [out / path for path in (*written[-1:], *written[:-1])]
