"""Our commands in this process, quietly."""

from __future__ import annotations

import io
from contextlib import redirect_stdout

from clrelight.cli.app import run
from clrelight.errors import InputError


def run_command(words: list[str]) -> None:
    """Run one of our commands; InputError if it refuses."""
    with redirect_stdout(io.StringIO()):
        code = run(words)
    if code != 0:
        raise InputError(f"clrelight {words[0]} ended with exit code {code}")
