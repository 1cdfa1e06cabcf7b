"""Batches in real processes: workers that die, hang or are ended, drivers that are, and what is found afterwards."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

from clrelight.batch.fingerprint import code_digest
from clrelight.batch.task import Task
from tests.batches import (
    FIT,
    are_gone,
    await_line,
    children_of,
    faulty_environment,
    finish_batch,
    make_stacks,
    results_in,
    start_batch,
    strays_in,
)
from tests.commands import call, command_line, environment

ENGINES = ["local", "dask"]


@pytest.fixture(scope="module", params=ENGINES)
def engine(request):
    if request.param == "dask":
        pytest.importorskip("distributed", reason="the engines of Dask: pip install 'clrelight[cluster]'")
    return ("--engine", request.param)


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    return make_stacks(tmp_path_factory.mktemp("stacks") / "in", ["a", "b", "c", "d"])


@pytest.fixture(scope="module")
def made(stacks):
    """What one undisturbed process makes."""
    out = stacks.parent / "made"
    assert call("batch", stacks, out, *FIT).code == 0
    return results_in(out)


def test_a_poison_stack_fails_alone(stacks, made, tmp_path, engine):
    out = tmp_path / "out"
    words = (stacks, out, *FIT, *engine, "--jobs", 2, "--keep-going", "--json")
    code, told, complaint = finish_batch(
        *words, faults={"b": "kill", "d": "once"} if engine[1] == "local" else {"b": "kill"}
    )
    assert code == 2, complaint
    rows = {row["stack"]: row for row in json.loads(told)["rows"]}
    assert {name: row["state"] for name, row in rows.items()} == {"a": "done", "b": "failed", "c": "done", "d": "done"}
    assert rows["b"]["error"].startswith("ends the process")
    assert rows["b"]["error"].endswith("2 times")
    assert rows["d"]["tries"] > 1 or engine[1] == "dask"
    assert results_in(out) == {name: made[name] for name in ("a.h5", "c.h5", "d.h5")}
    assert strays_in(out) == []
    # The same command finishes it where nothing does harm, on whatever engine.
    told = call("batch", stacks, out, *FIT, "--json").json
    assert (told["kept"], told["done"]) == (3, 4)
    assert results_in(out) == made


def test_a_stack_that_hangs_and_one_with_a_bug(stacks, made, tmp_path):
    out = tmp_path / "out"
    words = (stacks, out, *FIT, "--jobs", 3, "--keep-going", "--timeout", 3, "--json")
    code, told, _ = finish_batch(*words, faults={"a": "hang", "c": "bug"})
    assert code == 1
    rows = {row["stack"]: row for row in json.loads(told)["rows"]}
    assert rows["a"]["error"] == "took longer than 3 s"
    assert rows["c"]["error"] == "ZeroDivisionError: nobody expects this"
    assert "nobody expects this" in (out / "journal.jsonl").read_text()
    assert sorted(results_in(out)) == ["b.h5", "d.h5"]


@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_driver_that_is_ended(stacks, made, tmp_path, engine, name):
    out = tmp_path / "out"
    words = (stacks, out, *FIT, *engine, "--jobs", 2 if engine[1] == "local" else 1)
    started = start_batch(*words, faults={"[cd]": "hang"})
    try:
        await_line(out / "journal.jsonl", '"state":"done"')
        time.sleep(0.2)
        children = children_of(started)
        started.send_signal(signal.Signals[name])
        since = time.monotonic()
        _, complaint = started.communicate(timeout=20)
        assert are_gone(children, 5.0 - (time.monotonic() - since))
    finally:
        started.kill()
    if name != "SIGKILL":
        assert started.returncode == 128 + signal.Signals[name]
        assert complaint.endswith("files that were not finished are discarded\n")
        assert complaint.count("\n") == 1
        assert strays_in(out) == []
    found = results_in(out)
    assert found
    assert all(made[name] == content for name, content in found.items())
    told = call("batch", stacks, out, *FIT, "--json").json
    assert 1 <= told["kept"] <= len(found)  # one may stand of which the journal could not tell any more
    assert told["done"] == 4
    assert results_in(out) == made
    assert strays_in(out) == []


def test_a_worker_that_is_killed(stacks, made, tmp_path):
    out = tmp_path / "out"
    started = start_batch(stacks, out, *FIT, faults={"b": "slow"})
    await_line(out / "journal.jsonl", '"name":"a"')
    time.sleep(0.3)
    for child in children_of(started):
        os.kill(child, signal.SIGKILL)
    assert started.wait(60) == 0
    started.communicate()
    assert results_in(out) == made
    assert strays_in(out) == []


def test_a_second_driver_is_refused(stacks, tmp_path):
    out = tmp_path / "out"
    started = start_batch(stacks, out, *FIT, faults={"b": "hang"})
    try:
        await_line(out / "journal.jsonl", '"name":"a"')
        before = (out / "journal.jsonl").read_bytes()
        ended = call("batch", stacks, out, *FIT)
        assert ended.code == 2
        assert "another program is writing it" in ended.err
        assert (out / "journal.jsonl").read_bytes() == before
    finally:
        started.terminate()
        started.communicate()


def test_a_full_disk(tmp_path):
    """Files may not become as large as results are; the journal's and compilers' may."""
    stacks, out, limit = make_stacks(tmp_path / "in", ["a"], shape=(256, 256, 3)), tmp_path / "out", 3_000_000
    code = f"import resource, runpy, sys; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit})); "
    code += f"sys.argv[:] = {['clrelight', *command_line('batch', stacks, out, *FIT)[3:]]!r}; "
    code += "runpy.run_module('clrelight', run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, timeout=60)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith(f"note: a: cannot write {out}/a.h5: ")
    assert done.stderr.count("\n") == 1
    assert results_in(out) == {}
    assert strays_in(out) == []
    assert call("batch", stacks, out, *FIT).code == 0
    assert len(results_in(out)["a.h5"]) > limit


def test_small_stacks_share_a_task_of_dask(tmp_path):
    """More than one round of parcels: every stack has its line in the journal, and results are those of one process."""
    pytest.importorskip("distributed", reason="the engines of Dask: pip install 'clrelight[cluster]'")
    names = [f"s{number:02d}" for number in range(30)]
    stacks, alone, out = make_stacks(tmp_path / "in", names), tmp_path / "alone", tmp_path / "out"
    assert call("batch", stacks, alone, *FIT).code == 0
    code, told, complaint = finish_batch(stacks, out, *FIT, "--engine", "dask", "--jobs", 1, "--json")
    assert code == 0, complaint
    assert [row["stack"] for row in json.loads(told)["rows"]] == names
    assert (out / "journal.jsonl").read_text().count('"state":"done"') == 30
    assert results_in(out) == results_in(alone)


def test_a_script_without_a_guard_is_told_of_it(stacks, tmp_path):
    pytest.importorskip("distributed", reason="the engines of Dask: pip install 'clrelight[cluster]'")
    script = tmp_path / "script.py"
    script.write_text(
        "from clrelight.batch import make_tasks, read_listing, run_batch\n"
        f"tasks = make_tasks(read_listing({str(stacks)!r}, 'fit'), {str(tmp_path / 'out')!r}, job='fit')\n"
        f"run_batch(tasks, {str(tmp_path / 'out')!r}, engine='dask', workers=1)\n"
    )
    done = subprocess.run([sys.executable, script], env=environment(), capture_output=True, text=True, timeout=60)
    assert done.returncode
    assert "\nclrelight.errors.InputError: no worker of Dask could be started" in done.stderr
    assert "under if __name__ == '__main__'" in done.stderr


@pytest.mark.parametrize("seconds", [86400.0, -86400.0])
def test_a_clock_that_is_set_while_a_batch_runs(stacks, made, tmp_path, seconds):
    """Nothing is late, waits longer, is done twice or is lost where the clock jumps by a day each time one looks."""
    out = tmp_path / "out"
    code = "import time; print(abs(time.time() - time.time()) > 80000, abs(time.time_ns() - time.time_ns()) > 8e13)"
    changes = {"CLRELIGHT_CLOCK": str(seconds)}
    looked = subprocess.run(
        [sys.executable, "-c", code], env=faulty_environment(**changes), capture_output=True, text=True, check=True
    )
    assert looked.stdout == "True True\n"
    words = (stacks, out, *FIT, "--jobs", 2, "--timeout", 60, "--json")
    ended, told, complaint = finish_batch(*words, **changes)
    assert ended == 0, complaint
    assert json.loads(told)["done"] == 4
    assert results_in(out) == made
    ended, told, complaint = finish_batch(*words, **changes)
    assert (ended, json.loads(told)["kept"]) == (0, 4), complaint
    assert strays_in(out) == []


def test_a_worker_whose_driver_is_gone_begins_nothing(stacks, tmp_path):
    out = tmp_path / "a.h5"
    task = Task("a", "fit", str(stacks / "a.h5"), str(out), {"degree": 1}, (str(stacks / "a.h5"),)).to_json()
    code = "from clrelight.batch import child, perform; child.main()"
    line = json.dumps({"task": task, "key": "k", "code": code_digest(), "device": None})
    ended = subprocess.run([sys.executable, "-c", code], input=line + "\n", capture_output=True, text=True, timeout=60)
    assert (ended.stdout, ended.stderr) == ("", "")
    assert not out.exists()
