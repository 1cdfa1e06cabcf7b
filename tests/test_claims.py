"""Two programs and one output: the second is refused before it works."""

import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from clrelight import durable
from clrelight.errors import InputError
from clrelight.experiment import paper_experiment, run_experiment
from tests.commands import call, contents, environment, succeed

HOLD = """
    import sys, time
    from clrelight.durable import claiming
    with claiming(sys.argv[1]):
        print("held", flush=True)
        time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """Another program that has claimed out.h5."""
    started = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(HOLD), str(tmp_path / "out.h5")],
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
    )
    assert started.stdout.readline() == "held\n"
    yield started
    started.kill()
    started.communicate()


def test_every_command_refuses_what_another_program_writes(holder, tmp_path):
    succeed("synth", "ring", tmp_path / "ring.h5", "--size", 8, "--lights", 12)
    out, ring = tmp_path / "out.h5", tmp_path / "ring.h5"
    for words in (
        ("bench", ring, "--out", out),
        ("bench", "ring", "--out", out),
        ("trade", ring, "--out", out),
        ("fit", ring, out),
        ("encode", ring, out),
        ("decode", ring, out),
        ("synth", "ring", out),
        ("light", out, "--cap", "0,0,1,20"),
    ):
        since = time.monotonic()
        ended = call(*words)
        line = f"clrelight: cannot write {out}: another program is writing it; "
        line += "wait for its end, or choose another name\n"
        assert (ended.code, ended.out, ended.err) == (2, "", line)
        assert time.monotonic() - since < 30
    assert contents(tmp_path).keys() == {"ring.h5", ".out.h5.lock"}


def test_a_killed_program_holds_nothing(holder, tmp_path):
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    assert os.listdir(tmp_path) == [".out.h5.lock"]
    succeed("synth", "ring", tmp_path / "out.h5", "--size", 8, "--lights", 4)
    assert os.listdir(tmp_path) == ["out.h5"]


def test_the_library_refuses_too(holder, tmp_path):
    with pytest.raises(InputError, match="another program is writing it"):
        run_experiment(paper_experiment("ring"), tmp_path / "out.h5")


def test_without_locks_it_goes_on_and_says_so(tmp_path, monkeypatch):
    def none(descriptor, operation):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(durable.fcntl, "flock", none)
    ended = call("synth", "ring", tmp_path / "o.h5", "--size", 8, "--lights", 4)
    note = f"note: there are no file locks where {tmp_path / 'o.h5'} lies: let no second program write it\n"
    assert (ended.code, ended.err) == (0, note)


def test_two_results_of_one_command_have_two_names(tmp_path):
    succeed("synth", "ring", tmp_path / "ring.h5", "--size", 8, "--lights", 12)
    (tmp_path / "sub").mkdir()
    before = contents(tmp_path)
    out, again = tmp_path / "n.exr", tmp_path / "sub" / ".." / "n.exr"
    for beside in ("--albedo", "--confidence", "--height"):
        ended = call("normals", tmp_path / "ring.h5", out, beside, again)
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert "twice" in ended.err
    assert contents(tmp_path) == before
