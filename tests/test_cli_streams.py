"""Standard streams as shells leave them: closed, full, or without a reader."""

import os
import subprocess

import pytest

from tests.commands import command_line, environment, succeed


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    path = tmp_path_factory.mktemp("streams") / "ring.h5"
    succeed("synth", "ring", path, "--size", 8, "--lights", 4)
    return path


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
def test_closed_streams_change_nothing_else(stack, tmp_path, redirection):
    done = shell(redirection, "synth", "ring", "o.h5", "--size", 8, "--lights", 4, folder=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    # The same bytes: nothing of ours had the number of a stream that somebody prints to.
    assert (tmp_path / "o.h5").read_bytes() == stack.read_bytes()
    done = shell(redirection, "info", "none.h5", folder=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == ("" if "2>" in redirection else "clrelight: there is no file none.h5\n")
    assert os.listdir(tmp_path) == ["o.h5"]


@pytest.mark.parametrize("words", [["info", "{stack}"], ["info", "{stack}", "--json"], ["--help"]])
def test_a_full_standard_output_is_said(stack, tmp_path, words):
    words = [word.format(stack=stack) for word in words]
    done = shell(">/dev/full", *words, folder=tmp_path)
    line = "clrelight: cannot write standard output: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, line)
    assert shell(">/dev/full 2>/dev/full", *words, folder=tmp_path).returncode == 2


def test_a_result_stands_although_nothing_can_be_printed(stack, tmp_path):
    done = shell(">/dev/full", "synth", "ring", "o.h5", "--size", 8, "--lights", 4, folder=tmp_path)
    assert done.returncode == 2
    assert (tmp_path / "o.h5").read_bytes() == stack.read_bytes()
    assert os.listdir(tmp_path) == ["o.h5"]


def test_too_few_descriptors_are_named(stack, tmp_path):
    done = subprocess.run(
        ["sh", "-c", 'ulimit -n 6 && "$@"', "sh", *command_line("fit", stack, "o.h5", "--degree", 1)],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("clrelight: too few files may be open at once (ulimit -n)")
    assert done.stderr.count("\n") == 1
    assert os.listdir(tmp_path) == []
