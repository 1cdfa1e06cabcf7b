"""Standard streams as shells leave them: closed, full, or without a reader."""

import errno
import os
import subprocess
import sys

import click
import pytest

from clrelight import __version__
from clrelight.cli.app import cli
from clrelight.errors import InputError, StoreFormatError
from tests.commands import call, command_line, environment, succeed


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    path = tmp_path_factory.mktemp("streams") / "ring.h5"
    succeed("synth", "ring", path, "--size", 8, "--lights", 4)
    return path


LIGHT = ("light", "o.h5", "--cap", "0,0,1,30")
"""A command that writes a file soon."""


@pytest.fixture(scope="module")
def light(tmp_path_factory):
    path = tmp_path_factory.mktemp("streams") / "light.h5"
    succeed(LIGHT[0], path, *LIGHT[2:])
    return path.read_bytes()


def shell(redirection, *words, folder):
    """Run a command of a shell; return its exit code, and what came through a pipe on each side."""
    line = f'"$@" {redirection}'
    return subprocess.run(
        ["sh", "-c", line, "sh", *command_line(*words)],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.mark.parametrize("redirection", [">&-", "2>&-", "<&-", "<&- >&-", "<&- >&- 2>&-", "2>/dev/full"])
def test_closed_streams_change_nothing_else(light, tmp_path, redirection):
    done = shell(redirection, *LIGHT, folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    # The same bytes: nothing of ours had the number of a stream that somebody prints to.
    assert (tmp_path / "o.h5").read_bytes() == light
    done = shell(redirection, "info", "none.h5", folder=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == ("" if "2>" in redirection else "clrelight: there is no file none.h5\n")
    assert os.listdir(tmp_path) == ["o.h5"]


WITHIN_PYTHON = """
import contextlib, io, sys
from clrelight.cli import main
collected = [io.StringIO(), open(sys.argv[1], "w"), io.TextIOWrapper(io.BytesIO())]
for stream in collected:
    with contextlib.redirect_stdout(stream):
        try:
            main(["--version"])
        except SystemExit as ended:
            assert ended.code == 0
        assert sys.stdout is stream
collected[1].close()
collected[2].seek(0)
print([collected[0].getvalue(), open(sys.argv[1]).read(), collected[2].read()])
"""


def test_what_a_caller_in_python_collects_is_left_to_it(tmp_path):
    """In memory, or in a file that is not standard output: nothing of it goes there."""
    ended = subprocess.run(
        [sys.executable, "-c", WITHIN_PYTHON, tmp_path / "said"], env=environment(), capture_output=True, text=True
    )
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout == str([f"clrelight {__version__}\n"] * 3) + "\n"


@pytest.mark.parametrize("words", [["info", "{stack}"], ["info", "{stack}", "--json"], ["--help"]])
def test_a_full_standard_output_is_said(stack, tmp_path, words):
    words = [word.format(stack=stack) for word in words]
    done = shell(">/dev/full", *words, folder=tmp_path)
    line = "clrelight: cannot write standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, line)
    assert shell(">/dev/full 2>/dev/full", *words, folder=tmp_path).returncode == 2


def test_a_result_stands_although_nothing_can_be_printed(light, tmp_path):
    assert shell(">/dev/full", *LIGHT, folder=tmp_path).returncode == 2
    assert (tmp_path / "o.h5").read_bytes() == light
    assert os.listdir(tmp_path) == ["o.h5"]


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EMFILE, "Too many open files", "some.h5"),
        OSError(errno.ENFILE, "Too many open files in system"),
        ImportError("some.so: cannot open shared object file: Too many open files"),
        StoreFormatError("some.h5 is damaged or not ours: errno = 24, error message = 'Too many open files'"),
    ],
    ids=lambda error: type(error).__name__,
)
def test_too_few_descriptors_are_named(monkeypatch, error):
    """Whatever a library made of it, also as the cause of another error."""

    def fail(**options):
        raise InputError("nothing can be read") from error

    monkeypatch.setattr(cli.commands["info"], "callback", fail)
    line = "clrelight: too few files may be open at once (ulimit -n): allow more, such as ulimit -n 256\n"
    ended = call("info", "some.h5")
    assert (ended.code, ended.out, ended.err) == (2, "", line)


@pytest.mark.parametrize("count", [5, 6, 9, 14])
def test_a_process_that_may_open_few_files_says_so(stack, tmp_path, count):
    """Where the loader then finds no driver, where none can be tried, and where a driver's linker would abort."""
    line = "clrelight: too few files may be open at once (ulimit -n): allow more, such as ulimit -n 256\n"
    for words in (["devices"], ["fit", stack, "o.h5", "--degree", 1]):
        limited = ["sh", "-c", f'ulimit -n {count} && exec "$@"', "sh", *command_line(*words)]
        done = subprocess.run(limited, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120)
        assert (done.returncode, done.stdout, done.stderr) == (2, "", line)
    assert os.listdir(tmp_path) == []


def test_a_process_of_little_address_space_says_so(stack, tmp_path):
    """PoCL aborts there, or waits for ever."""
    limited = ["sh", "-c", 'ulimit -v 500000 && exec "$@"', "sh", *command_line("fit", stack, "o.h5", "--degree", 1)]
    done = subprocess.run(limited, cwd=tmp_path, env=environment(), capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "the address space is limited to 0.48 GiB (ulimit -v)" in done.stderr
    assert os.listdir(tmp_path) == []


def test_quiet_prints_errors_alone_and_the_object_of_json(stack, tmp_path):
    before = sys.stdout
    assert succeed("info", stack).out
    for words in (("info", stack, "--quiet"), ("--quiet", "info", stack), ("fit", stack, tmp_path / "f.h5", "--quiet")):
        ended = call(*words, *(["--degree", 1] if words[0] == "fit" else []))
        assert (ended.code, ended.out, ended.err) == (0, "", "")
    assert call("info", stack, "--json", "--quiet").json["schema"] == "stack/1"
    ended = call("info", tmp_path / "none.h5", "--quiet")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert sys.stdout is before


def test_every_command_takes_quiet():
    def commands(group):
        for command in group.commands.values():
            yield from commands(command) if isinstance(command, click.Group) else [command]

    assert not [each.name for each in commands(cli) if [p.name for p in each.params].count("quiet") != 1]
