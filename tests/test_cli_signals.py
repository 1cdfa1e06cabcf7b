"""Signals: a command ends at once, in one line, and leaves nothing half made."""

import ast
import json
import os
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from clrelight import interrupts
from clrelight.durable import replacing, replacing_folder
from clrelight.errors import InputError
from tests.commands import ROOT, command_line, contents, environment, succeed
from tests.kills import ENDINGS, await_handlers

LONG = ("--degree", 12, "--precision", "double", "--memory", "3M")
"""Of a fit that takes most of a second, part by part, and is not refused."""
HANDLED = {name: signal.Signals[name] for name in ENDINGS}


@pytest.fixture(scope="module")
def stack(tmp_path_factory):
    path = tmp_path_factory.mktemp("signals") / "ring.h5"
    succeed("synth", "ring", path, "--size", 32, "--lights", 60)
    return path


@pytest.fixture(scope="module")
def large_stack(tmp_path_factory):
    path = tmp_path_factory.mktemp("signals") / "large.h5"
    succeed("synth", "ring", path, "--size", 256, "--lights", 60)
    return path


def start(words, folder, **options):
    return subprocess.Popen(
        command_line(*words), cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options
    )


def wait_for(ready, started):
    since = time.monotonic()
    while not ready() and started.poll() is None and time.monotonic() - since < 60:
        time.sleep(0.001)
    assert started.poll() is None, started.communicate()


@pytest.mark.parametrize("name", ENDINGS)
def test_every_signal_cleans_up(large_stack, tmp_path, name):
    (tmp_path / "o.h5").write_bytes(b"precious")
    started = start(["fit", large_stack, "o.h5", *LONG], tmp_path)
    try:
        wait_for((tmp_path / ".o.h5.part").exists, started)
        assert (tmp_path / ".o.h5.lock").exists()
        started.send_signal(HANDLED[name])
        out, err = started.communicate(timeout=60)
    finally:
        started.kill()
    line = f"clrelight: {ENDINGS[name]}; files that were not finished are discarded\n"
    assert (started.returncode, out, err.decode()) == (128 + HANDLED[name], b"", line)
    assert contents(tmp_path) == {"o.h5": b"precious"}


def test_two_signals_at_once(large_stack, tmp_path):
    started = start(["fit", large_stack, "o.h5", *LONG], tmp_path)
    try:
        wait_for((tmp_path / ".o.h5.part").exists, started)
        for _ in range(2):
            started.send_signal(signal.SIGINT)
            time.sleep(0.001)
        _, err = started.communicate(timeout=60)
    finally:
        started.kill()
    assert started.returncode == 130
    assert err == b"clrelight: interrupted; files that were not finished are discarded\n"
    assert contents(tmp_path) == {}


def test_a_signal_as_early_as_we_can_see_it_is_silent(tmp_path):
    """From our first line on: before, Python itself begins."""
    for name in ("SIGTERM", "SIGINT"):
        started = start(["devices"], tmp_path)
        await_handlers(started)
        started.send_signal(HANDLED[name])
        out, err = started.communicate(timeout=60)
        assert (started.returncode, out) == (128 + HANDLED[name], b"")
        assert b"Traceback" not in err
        assert err.count(b"\n") <= 1


def test_handlers_stand_before_anything_of_weight_is_imported():
    code = """
        import sys
        before = set(sys.modules)
        import clrelight.cli
        print(sorted(set(sys.modules) - before))
    """
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)], cwd=ROOT, env=environment(), capture_output=True, text=True
    )
    assert set(ast.literal_eval(done.stdout)) <= {"__future__", "types", "clrelight", "clrelight.cli"}


def test_nohup_is_obeyed(tmp_path):
    def ignore():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    started = start(["synth", "ring", "o.h5", "--size", "16", "--lights", "16"], tmp_path, preexec_fn=ignore)
    time.sleep(0.3)
    started.send_signal(signal.SIGHUP)
    started.communicate(timeout=60)
    assert started.returncode == 0
    assert contents(tmp_path).keys() == {"o.h5"}


PUT_OFF = """
    import os, signal, sys
    from clrelight import interrupts
    from clrelight import durable
    from clrelight.durable import {what}

    opened = {blocked}

    def strike(*arguments, **options):
        made = opened(*arguments, **options)
        for _ in range({signals}):
            interrupts._note(signal.SIGTERM)
        return made

    {blocked} = strike
    with interrupts.watch_interrupts():
        try:
            with {what}({path!r}) as lent:
                {inside}
        except KeyboardInterrupt:
            print(interrupts.end_watch())
        else:
            print("nothing came")
"""


@pytest.mark.parametrize("signals", [1, 2])
@pytest.mark.parametrize(
    ("what", "blocked", "inside"),
    [
        ("replacing", "os.open", 'raise SystemExit("the block was entered")'),
        ("replacing", "os.replace", 'lent.write(b"new")'),
        ("replacing", "os.fsync", 'lent.write(b"new")'),
        ("claiming", "os.open", 'raise SystemExit("the block was entered")'),
        ("replacing_folder", "durable.tempfile.mkdtemp", 'raise SystemExit("the block was entered")'),
    ],
)
def test_a_signal_between_making_and_noting(tmp_path, what, blocked, inside, signals):
    """As the file is made, and as it is renamed: the two instants at which its name is in no variable."""
    path = tmp_path / "out"
    code = textwrap.dedent(PUT_OFF.format(what=what, blocked=blocked, inside=inside, path=str(path), signals=signals))
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, timeout=60)
    line = "clrelight: terminated; files that were not finished are discarded"
    if signals == 1:
        assert (done.returncode, done.stdout, done.stderr) == (0, f"{(143, line)}\n", "")
    else:
        assert done.returncode in (0, 143), done.stderr
        assert line in done.stdout + done.stderr
    assert contents(tmp_path) == ({"out": b"new"} if blocked == "os.replace" else {})
    assert os.listdir(tmp_path) == (["out"] if blocked == "os.replace" else [])


def test_what_is_unfinished_is_removed_even_where_an_interrupt_is_swallowed(tmp_path):
    """The folder and the file stand when the end comes, as they do at a second signal."""
    with interrupts.watch_interrupts(), replacing_folder(tmp_path / "b") as folder:
        (folder / "c").write_bytes(b"half")
        with pytest.raises(InputError, match="No such file"):
            _end_while_open(tmp_path)
        folder.mkdir(parents=True)
    assert os.listdir(tmp_path) == ["b"]


def _end_while_open(folder):
    with replacing(folder / "a"):
        assert len(os.listdir(folder)) == 2
        assert interrupts.end_watch() is None
        assert os.listdir(folder) == []


EARLY = """
import os, signal, threading, time
start = threading.Thread.start
def strike(thread):
    start(thread)
    if thread.name == "clrelight-signals":
        os.kill(os.getpid(), signal.{name})
        time.sleep(0.5)
threading.Thread.start = strike
from clrelight.cli import main
main(["info", "none.h5"])
"""


@pytest.mark.skipif(not hasattr(signal, "SIGRTMIN"), reason="there no thread waits for signals")
@pytest.mark.parametrize(("name", "word"), [("SIGINT", "interrupted"), ("SIGTERM", "terminated")])
def test_a_signal_before_the_command_begins(name, word):
    done = subprocess.run(
        [sys.executable, "-c", EARLY.format(name=name)], env=environment(), capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 128 + getattr(signal, name)
    assert done.stderr == f"clrelight: {word}; files that were not finished are discarded\n"


def test_kills(tmp_path):
    command = [sys.executable, "-m", "tests.kills", "--only", "fit", "--count", "5", "--seed", "4"]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    tallies = [json.loads(line) for line in done.stdout.splitlines()]
    assert sum(tally["ended"] for tally in tallies) == 5
    assert sum(tally["absent"] + tally["old"] + tally["new"] for tally in tallies) == 5
