"""The command line as tests use it: within this process, or in one of its own."""

import io
import json
import os
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import h5py

from clrelight.cli.app import run

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Ended:
    code: int
    out: str
    err: str

    @property
    def json(self):
        """The one JSON object on standard output, with nothing beside it."""
        assert self.out.count("\n") == 1
        assert self.out.endswith("\n")
        return json.loads(self.out)


def call(*arguments):
    """Run a command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run([str(argument) for argument in arguments])
    return Ended(code, out.getvalue(), err.getvalue())


def succeed(*arguments):
    """Run a command that must end well and have nothing to say on standard error."""
    ended = call(*arguments)
    assert (ended.code, ended.err) == (0, "")
    return ended


def environment(**changes):
    """Return the environment of a new process: ours, with this checkout first, and changes (None takes away)."""
    merged = {**os.environ, "PYTHONPATH": str(ROOT), **changes}
    return {name: value for name, value in merged.items() if value is not None}


def command_line(*arguments):
    return [sys.executable, "-m", "clrelight", *map(str, arguments)]


def process(*arguments, folder=None, errors=None, **changes):
    """Run a command in a process of its own; `errors` is for output that need not be text."""
    done = subprocess.run(
        command_line(*arguments),
        cwd=folder,
        env=environment(**changes),
        capture_output=True,
        text=True,
        errors=errors,
        timeout=120,
    )
    return Ended(done.returncode, done.stdout, done.stderr)


def contents(folder):
    """Return every file below a folder with its bytes: what must stay as it is."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def arrays(path):
    """Return the datasets of a file as plain h5py reads them."""
    found = {}
    with h5py.File(path) as file:
        file.visititems(
            lambda name, item: found.__setitem__(name, item[()]) if isinstance(item, h5py.Dataset) else None
        )
    return found


def attributes(path):
    with h5py.File(path) as file:
        return {name: v.decode() if isinstance(v, bytes) else v for name, v in file.attrs.items()}
