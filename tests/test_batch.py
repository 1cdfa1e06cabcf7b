"""Batches: which stacks, with which options, what is kept, what a driver does with what fails, and the journal."""

import csv
import json
import os
import re
import shutil
from dataclasses import replace

import pytest

from clrelight.batch import journal as journals
from clrelight.batch import make_tasks, read_listing, run_batch
from clrelight.batch.engine import Ended, usable_cores, worker_environment
from clrelight.batch.fingerprint import is_unchanged, take_fingerprint, take_seal
from clrelight.batch.journal import Journal, sealed
from clrelight.batch.leftovers import sweep
from clrelight.batch.perform import _work, perform
from clrelight.batch.task import Outcome, Task
from clrelight.batch.verbs import VERBS
from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.jobs.report import Report
from clrelight.store import read_encoded, write_encoded
from tests.batches import FIT, make_stacks, results_in, strays_in
from tests.commands import ROOT, call, contents, succeed

FROZEN = ROOT / "tests" / "frozen"
OPTIONS = {"degree": 1, "measure": False}


class Here:
    """An engine without processes: does tasks at once, or says what a test wants it to."""

    label, workers, ahead, isolates = "here", 1, 0, True

    def __init__(self, say=None):
        self.say, self.begun, self.most, self.avoided = say or {}, [], 0, []
        self._held = []

    def __call__(self, lock):
        return self

    def submit(self, work):
        self.begun.append(work.name)
        self._held.append(work)
        self.most = max(self.most, len(self._held))

    def collect(self, seconds):
        work = self._held.pop(0)
        told = self.say.get(work.name, [])
        if told:
            ended = told.pop(0)
            return [ended if ended.outcome is None else replace(ended, outcome={**ended.outcome, "key": work.key})]
        return [Ended(work.name, perform(work.task, work.key, work.code, work.device))]

    def doing(self):
        return "something"

    def avoid(self, worker):
        self.avoided.append(worker)
        return len(self.avoided) < 2

    def close(self):
        self.begun.append("closed")


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    return make_stacks(tmp_path_factory.mktemp("stacks") / "in", ["a", "b", "c"])


@pytest.fixture
def copied(stacks, tmp_path):
    """A batch that is done, with inputs of its own."""
    shutil.copytree(stacks, tmp_path / "in")
    tasks = tasks_of(tmp_path / "in", tmp_path / "out")
    run_batch(tasks, tmp_path / "out", engine=Here(), report=Report())
    return tasks, tmp_path / "in", tmp_path / "out"


def tasks_of(folder, out, **options):
    return make_tasks(read_listing(folder, "fit", out=out), out, job="fit", options={**OPTIONS, **options})


def begun(tasks, out, **changes):
    """Run a batch again; return the names of what was done anew."""
    engine = Here()
    done = run_batch(tasks, out, engine=engine, report=Report(), **changes)
    assert not done.failed
    assert done.kept | {*engine.begun} - {"closed"} == {task.name for task in tasks}
    return [name for name in engine.begun if name != "closed"]


def test_results_are_those_of_the_command(stacks, tmp_path):
    ended = call("batch", stacks, tmp_path / "out", *FIT, "--json")
    assert ended.code == 0
    assert (ended.json["stacks"], ended.json["done"], ended.json["kept"], ended.json["failed"]) == (3, 3, 0, 0)
    for name in "abc":
        succeed("fit", stacks / f"{name}.h5", tmp_path / "alone.h5", "--degree", 1, "--no-measure")
        assert (tmp_path / "out" / f"{name}.h5").read_bytes() == (tmp_path / "alone.h5").read_bytes()
    with open(tmp_path / "out" / "summary.csv", newline="") as file:
        rows = [*csv.DictReader(file)]
    assert [(row["stack"], row["state"], row["error"]) for row in rows] == [(name, "done", "") for name in "abc"]
    size = (tmp_path / "out" / "a.h5").stat().st_size
    assert (int(rows[0]["bytes"]), ended.json["rows"][0]["bytes"]) == (size, size)
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["totals"]["done"] == 3
    assert strays_in(tmp_path / "out") == []


def test_decibels_and_a_bad_stack(stacks, tmp_path):
    shutil.copytree(stacks, tmp_path / "in")
    (tmp_path / "in" / "b.h5").write_text("no HDF5")
    words = ("batch", tmp_path / "in", tmp_path / "out", "--job", "fit", "--set", "degree=1", "--set", "holdout=3")
    ended = call(*words)
    assert ended.code == 2
    assert "note: b: " in ended.err
    assert "2 (1 done, 1 failed)" not in ended.out
    assert "3 (1 done, 1 failed, 1 left)" in ended.out
    ended = call(*words, "--keep-going", "--json")
    assert (ended.code, ended.json["done"], ended.json["kept"], ended.json["failed"]) == (2, 2, 1, 1)
    row = {row["stack"]: row for row in ended.json["rows"]}
    assert row["b"]["error"].endswith("b.h5 is not an HDF5 file")
    alone = succeed_with_notes(
        "fit", tmp_path / "in" / "a.h5", tmp_path / "f.h5", "--degree", 1, "--holdout", 3, "--json"
    )
    assert row["a"]["psnr"] == pytest.approx(alone["psnr"]["pooled_fitted"], abs=1e-9)
    assert row["a"]["psnr_holdout"] == pytest.approx(alone["psnr"]["pooled_holdout"], abs=1e-9)
    assert (row["a"]["state"], row["c"]["state"]) == ("kept", "done")


def succeed_with_notes(*words):
    ended = call(*words)
    assert ended.code == 0
    return ended.json


def test_a_dry_run_writes_nothing(stacks, tmp_path):
    told = succeed("batch", stacks, tmp_path / "out", *FIT, "--dry-run", "--json").json
    assert [(each["stack"], each["state"]) for each in told["rows"]] == [(name, "to do") for name in "abc"]
    assert told["rows"][0]["options"] == OPTIONS
    assert "a.h5" in succeed("batch", stacks, tmp_path / "out", *FIT, "--dry-run").out
    assert not (tmp_path / "out").exists()


def test_what_is_done_is_kept(copied):
    tasks, folder, out = copied
    (out / "b.h5").unlink()
    told = succeed("batch", folder, out, *FIT, "--dry-run", "--json").json
    assert [each["state"] for each in told["rows"]] == ["kept", "to do", "kept"]
    assert begun(tasks, out) == ["b"]
    before = contents(out)

    def never(lock):
        raise AssertionError("nothing is to be done")

    done = run_batch(tasks, out, engine=never, report=Report())
    assert done.kept == {"a", "b", "c"}
    after = contents(out)
    assert {k: v for k, v in after.items() if "summary" not in k} == {
        k: v for k, v in before.items() if "summary" not in k
    }


def test_a_touched_copy_is_kept_and_another_is_not(copied):
    tasks, folder, out = copied
    for path in (folder / "a.h5", out / "b.h5"):
        os.utime(path, ns=(1, 1))  # a clock that was set back, say
    assert begun(tasks, out) == []
    content = bytearray((folder / "a.h5").read_bytes())
    shutil.copyfile(folder / "c.h5", folder / "a.h5")
    assert (folder / "a.h5").stat().st_size == len(content)
    assert begun(tasks, out) == ["a"]
    (out / "b.h5").unlink()
    assert begun(tasks, out) == ["b"]
    assert begun(tasks, out, anew=True) == ["a", "b", "c"]
    assert begun(tasks_of(folder, out, degree=0), out) == ["a", "b", "c"]


def test_a_flipped_bit_is_found_where_it_is_looked_for(copied):
    tasks, _, out = copied
    path = out / "c.h5"
    known, content = path.stat(), bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)
    os.utime(path, ns=(known.st_atime_ns, known.st_mtime_ns))
    assert begun(tasks, out) == []  # nobody can know without reading
    assert begun(tasks, out, verify=True) == ["c"]


def test_other_code_does_it_again(copied, monkeypatch):
    tasks, _, out = copied
    for module in ("fingerprint", "driver", "perform"):
        monkeypatch.setattr(f"clrelight.batch.{module}.code_digest", lambda: "other")
    assert begun(tasks, out) == ["a", "b", "c"]


def test_both_folders_may_be_moved_together(copied, tmp_path):
    _, folder, out = copied
    (tmp_path / "new").mkdir()
    shutil.copytree(folder, tmp_path / "new" / "in")
    shutil.copytree(out, tmp_path / "new" / "out")
    assert begun(tasks_of(tmp_path / "new" / "in", tmp_path / "new" / "out"), tmp_path / "new" / "out") == []


def test_a_worker_with_other_code_refuses(stacks, tmp_path):
    (task,) = make_tasks(read_listing(stacks, "fit", match=["a"]), tmp_path, job="fit", options=OPTIONS)
    told = Outcome.from_json(perform(task.to_json(), "key", "other", None))
    assert (told.state, told.kind) == ("failed", "input")
    assert "another clrelight" in told.error
    assert not (tmp_path / "a.h5").exists()


def test_a_stack_that_changes_meanwhile_fails(stacks, tmp_path, monkeypatch):
    shutil.copyfile(stacks / "a.h5", tmp_path / "a.h5")
    looks = iter([(1, 1, "one"), (1, 1, "two")])
    monkeypatch.setattr("clrelight.batch.perform.look_at", lambda path: next(looks))
    task = Task("a", "fit", str(tmp_path / "a.h5"), str(tmp_path / "o.h5"), OPTIONS, (str(tmp_path / "a.h5"),))
    with pytest.raises(InputError, match="changed while it was read"):
        _work(task, None, Report(), None)


def test_folders_of_stacks(stacks, tmp_path):
    make_stacks(tmp_path / "in", ["x", "deep/y", ".hidden/z", "out/r"])
    shutil.copyfile(tmp_path / "in" / "x.h5", tmp_path / "in" / ".w.h5")
    succeed("fit", stacks / "a.h5", tmp_path / "in" / "fit.h5", "--degree", 1, "--no-measure")
    (tmp_path / "in" / "notes.txt").write_text("")
    listing = read_listing(tmp_path / "in", "fit", out=tmp_path / "in" / "out")
    assert [stack.name for stack in listing.stacks] == ["deep/y", "x"]
    assert "1 file in" in listing.notes[0]
    tasks = make_tasks(listing, tmp_path / "in" / "out", job="fit")
    assert tasks[0].out == str(tmp_path / "in" / "out" / "deep" / "y.h5")
    assert [each.name for each in read_listing(tmp_path / "in", "encode").stacks] == ["fit"]


def test_folders_of_photographs(tmp_path):
    for name in ("one", "more/two", "more/two/thumbnails"):
        (tmp_path / "in" / name).mkdir(parents=True)
        (tmp_path / "in" / name / "1.JPG").write_text("")
    listing = read_listing(tmp_path / "in", "ingest")
    assert [stack.name for stack in listing.stacks] == ["more/two", "one"]
    with pytest.raises(InputError, match="holds photographs itself"):
        read_listing(tmp_path / "in" / "one", "ingest")
    with pytest.raises(InputError, match="no stacks"):
        read_listing(tmp_path / "in", "fit")


def write_list(folder, text):
    (folder / "list.toml").write_text(text)
    return folder / "list.toml"


def test_options_of_all_of_some_and_of_one(tmp_path):
    make_stacks(tmp_path / "in", ["coin-1", "coin-2", "tile", "test"])
    listing = read_listing(
        write_list(
            tmp_path,
            """
            job = "fit"
            stacks = ["in/*.h5"]
            exclude = ["in/test*"]
            [options]
            degree = 4
            method = "uls"
            [[stack]]
            source = "in/tile.h5"
            name = "Tile"
            options = { degree = 2, confidence = "{name}.png" }
            [[override]]
            match = "coin-*"
            degree = 3
            [[override]]
            match = "*-2"
            degree = 5
            [[override]]
            match = "*-1"
            method = "default"
            energy = 0.5
            [[override]]
            match = "vase*"
            degree = 5
            """,
        )
    )
    assert listing.notes == ("[[override]] vase* matches no stack",)
    tasks = {task.name: task for task in make_tasks(listing, tmp_path / "out")}
    assert tasks["coin-1"].options == {"degree": 3, "energy": 0.5}
    tasks = {task.name: task for task in make_tasks(listing, tmp_path / "out", options={"method": "cls"})}
    assert {name: task.options["degree"] for name, task in tasks.items()} == {"coin-1": 3, "coin-2": 5, "Tile": 2}
    assert {task.options["method"] for task in tasks.values()} == {"cls"}
    assert tasks["Tile"].options["confidence"] == str(tmp_path / "out" / "Tile.png")
    assert tasks["Tile"].out == str(tmp_path / "out" / "Tile.h5")
    assert tasks["Tile"].source == str(tmp_path / "in" / "tile.h5")


def test_files_that_options_name_are_inputs(tmp_path):
    make_stacks(tmp_path / "in", ["a"])
    listing = read_listing(
        write_list(tmp_path, 'job = "encode"\nstacks = ["in/*.h5"]\n[options]\nstack = "photos/{name}.h5"')
    )
    (task,) = make_tasks(listing, tmp_path / "out")
    assert task.inputs == (str(tmp_path / "in" / "a.h5"), str(tmp_path / "photos" / "a.h5"))


LISTS = {
    "nested too deeply": "job = " + "[" * 5000,
    "is no list in TOML: Exceeds": "job = " + "9" * 5000,
    r"must be a list of texts, got \[1, .*\.\.\.$": 'job = "fit"\nstacks = ' + str([1] * 999),
    "is no list in TOML": "job = ",
    "unknown key 'jobs'": 'jobs = "fit"',
    "it needs a job": 'stacks = ["in/*.h5"]',
    "there is no job 'fits'": 'job = "fits"',
    "there is no .*none": 'job = "fit"\nstacks = ["in/none*.h5"]',
    "stacks must be a list of texts": 'job = "fit"\nstacks = "in"',
    "holds no stacks": 'job = "fit"',
    "both called a": 'job = "fit"\nstacks = ["in/a.h5", "in/more/a.h5"]',
    "is no name": 'job = "fit"\n[[stack]]\nsource = "in/a.h5"\nname = "../a"',
    "fit has no option 'degre'": 'job = "fit"\nstacks = ["in/a.h5"]\n[options]\ndegre = 3',
    "needs a source": 'job = "fit"\n[[stack]]\nname = "a"',
    "needs a match": 'job = "fit"\nstacks = ["in/a.h5"]\n[[override]]\ndegree = 3',
    "would both write": 'job = "fit"\nstacks = ["in/*.h5"]\n[options]\nconfidence = "one.png"',
    "writes .h5, not .png": 'job = "fit"\nstacks = ["in/a.h5"]\nending = ".png"',
    "degree must be": 'job = "fit"\nstacks = ["in/a.h5"]\n[options]\ndegree = 2.5',
}


@pytest.mark.parametrize("complaint", [c for c in LISTS if c != "degree must be"])
def test_lists_that_are_not_right(tmp_path, complaint):
    make_stacks(tmp_path / "in", ["a", "b", "more/a"])
    path = write_list(tmp_path, LISTS[complaint])
    with pytest.raises(InputError, match=complaint):
        make_tasks(read_listing(path), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_results_never_replace_stacks(stacks, tmp_path):
    with pytest.raises(InputError, match="which a reads"):
        make_tasks(read_listing(stacks, "fit"), stacks, job="fit")


def test_words_that_are_not_right(stacks, tmp_path):
    for words, complaint in (
        ((stacks,), "name the job with --job"),
        ((stacks, "--job", "relit"), "there are pack, ingest"),
        ((stacks, "--job", "fit", "--set", "degree"), "--set takes KEY=VALUE"),
        ((stacks, "--job", "fit", "--match", "z*"), "holds no stacks that match z*"),
        ((stacks, "--job", "fit", "--engine", "spark"), "there is no engine 'spark'"),
        ((tmp_path / "none", "--job", "fit"), "there is no file or folder"),
    ):
        ended = call("batch", words[0], tmp_path / "out", *words[1:])
        assert (ended.code, ended.out) == (2, "")
        assert complaint in ended.err
        assert ended.err.count("\n") == 1


def test_every_job_knows_its_options():
    for verb in VERBS.values():
        assert {"rate", "bytes"} <= {*verb.options()} or verb.id not in ("pack", "encode")
        assert {*verb.reads, *verb.writes} <= {*verb.options()}, verb.id
    assert {"lights", "crop", "transfer", "target_psnr"} <= {*VERBS["pack"].options()}
    assert {"energy", "solver", "fill"} <= {*VERBS["fit"].options()}


def test_every_other_job(stacks, tmp_path):
    """Each from the results of the one before."""
    photographs = f"{stacks}/{{name}}.h5"
    steps = (
        (stacks, "fits", "fit", OPTIONS, ["a.h5"]),
        ("fits", "small", "encode", {"codec": "klt", "rate": 8, "stack": photographs}, ["a.h5"]),
        ("small", "back", "decode", {}, ["a.h5"]),
        ("small", "psnr", "psnr", {"stack": photographs}, []),
        ("small", "photos", "unpack", {"kind": "png"}, ["a"]),
        ("photos", "again", "ingest", {}, ["a.h5"]),
        ("photos", "packed", "pack", {"method": "uls", "degree": 1, "bytes": "9k", "crop": "0,0,4,4"}, ["a.h5"]),
        ("small", "lit", "relight", {"light": "0,0.1,2"}, ["a.png"]),
        ("fits", "textures", "export", {"format": "exr"}, ["a"]),
        (stacks, "normals", "normals", {"albedo": "{name}-albedo.exr"}, ["a-albedo.exr", "a.exr"]),
        (stacks, "bench", "bench", {"methods": "uls", "degrees": 1, "codecs": ["none", "half"]}, ["a.h5"]),
        ("fits", "shown", "preview", {"size": 5}, ["a.png"]),
        (stacks, "hemispherical", "fit", {**OPTIONS, "method": "uls", "basis": "gram-schmidt"}, ["a.h5"]),
        ("hemispherical", "spherical", "to-sh", {}, ["a.h5"]),
        ("others", "imported", "import", {"lights": 9}, ["a.h5"]),
        ("others", "transfer", "transfer", {"kind": "unshadowed", "degree": 1}, ["a.h5"]),
    )
    (tmp_path / "others" / "below").mkdir(parents=True)
    write_ptm(tmp_path / "others" / "a.ptm")
    (tmp_path / "others" / "a.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    (tmp_path / "others" / "notes.txt").write_text("of neither kind")
    for source, name, job, options, made in steps:
        out = tmp_path / name
        tasks = make_tasks(read_listing(tmp_path / source, job, match=["a"]), out, job=job, options=options)
        done = run_batch(tasks, out, engine=Here(), report=Report())
        assert [each.error for each in done.outcomes] == [""], job
        left = sorted({*os.listdir(out)} - {"journal.jsonl", "summary.csv", "summary.json"})
        assert left == made, job
        if job in ("encode", "psnr"):
            assert done.outcomes[0].psnr["pooled_fitted"] > 0
        assert run_batch(tasks, out, engine=Here(), report=Report()).kept == {"a"}, job


def write_ptm(path):
    """A polynomial texture map of three by two pixels."""
    head = "PTM_1.2\nPTM_FORMAT_RGB\n3\n2\n" + "1.0 " * 6 + "\n" + "0 " * 6 + "\n"
    path.write_bytes(head.encode() + bytes(range(3 * 6 * 6)))


def test_what_finds_no_lights_says_so_in_its_line(stacks, tmp_path):
    tasks = make_tasks(read_listing(stacks, "find-lights", match=["a"]), tmp_path, job="find-lights")
    (outcome,) = run_batch(tasks, tmp_path, engine=Here(), report=Report()).failed
    assert (outcome.kind, outcome.error.count("\n")) == ("input", 0)
    assert not (tmp_path / "a.lp").exists()


def died(name, fault="died"):
    return Ended(name, None, "ends the process, SIGKILL", fault)


def test_what_dies_is_tried_again_last(stacks, tmp_path):
    engine = Here({"a": [died("a")], "b": [died("b"), died("b")]})
    done = run_batch(tasks_of(stacks, tmp_path), tmp_path, engine=engine, keep_going=True, report=Report())
    assert engine.begun == ["a", "b", "c", "a", "b", "closed"]
    assert [(each.name, each.state, each.tries) for each in done.outcomes] == [
        ("a", "done", 2),
        ("b", "failed", 2),
        ("c", "done", 1),
    ]
    assert done.failed[0].error == "ends the process, SIGKILL, 2 times"
    assert sorted(results_in(tmp_path)) == ["a.h5", "c.h5"]


def test_suspects_are_alone_where_workers_hold_several(stacks, tmp_path):
    engine = Here({name: [died(name)] for name in "abc"})
    engine.isolates, engine.workers, engine.ahead = False, 2, 1
    flying = []
    submit = engine.submit
    engine.submit = lambda work: (submit(work), flying.append(len(engine._held)))
    done = run_batch(tasks_of(stacks, tmp_path), tmp_path, engine=engine, report=Report())
    assert not done.failed
    assert max(flying[:3]) == 3
    assert flying[3:] == [1, 1, 1]


def test_a_time_that_is_up_is_not_tried_again(stacks, tmp_path):
    engine = Here({"a": [died("a", "late")]})
    done = run_batch(tasks_of(stacks, tmp_path), tmp_path, engine=engine, report=Report())
    assert engine.begun == ["a", "closed"]
    assert (done.failed[0].kind, done.left) == ("late", ("b", "c"))


def test_a_worker_with_an_unsound_device_gets_no_more(stacks, tmp_path):
    unsound = Outcome("a", "failed", kind="device", error="computes wrong numbers", worker="w1").to_json()
    engine, report = Here({"a": [Ended("a", unsound)]}), Report()
    done = run_batch(tasks_of(stacks, tmp_path), tmp_path, engine=engine, report=report)
    assert (engine.avoided, len(done.outcomes), done.failed) == (["w1"], 3, ())
    assert any("w1 gets no more stacks" in note for note in report.notes)
    # Where there is no other worker, the stack fails as it would alone.
    engine = Here({"a": [Ended("a", unsound), Ended("a", unsound)]})
    done = run_batch(tasks_of(stacks, tmp_path), tmp_path, engine=engine, anew=True, report=Report())
    assert done.failed[0].error == "computes wrong numbers"


def test_a_journal_that_is_torn_anywhere(tmp_path):
    path = tmp_path / "journal.jsonl"
    for name in ("first", "last"):
        journal = Journal(path)
        journal.add(Outcome(name, "done", "k", psnr={"a": float("inf"), "b": float("nan")}))
        journal.close()
    content = path.read_bytes()
    start = content.rindex(b"\n", 0, -1) + 1
    for end in range(start, len(content)):
        path.write_bytes(content[:end])
        journal = Journal(path)
        assert [*journal.outcomes] == ["first"]
        assert journal.damaged == (end > start)
        journal.add(Outcome("next", "failed", "k"))
        journal.close()
        journal = Journal(path)
        assert [*journal.outcomes] == ["first", "next"]
        assert journal.damaged == 0
        journal.close()
    for end in range(1, content.index(b"\n") + 1):  # killed while it was begun
        path.write_bytes(content[:end])
        if end > 16:
            Journal(path).close()


def test_a_journal_with_flipped_bits_says_nothing_wrong(tmp_path):
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    outcomes = [Outcome(name, "done", name, outputs={str(tmp_path / name): {"bytes": 1}}) for name in "abc"]
    for each in outcomes:
        journal.add(each)
    journal.close()
    content = path.read_bytes()
    for place in range(content.index(b"\n") + 1, len(content)):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        journal = Journal(path)
        assert all(each in outcomes for each in journal.outcomes.values())
        assert len(journal.outcomes) >= 1
        assert journal.damaged
        journal.close()


def test_other_files_are_no_journals(tmp_path):
    path = tmp_path / "journal.jsonl"
    for content in (b"my diary\n", b"my diary", b'{"sum":"0"}\n', b"\n", b'{"sum":"' * 20000, bytes(1 << 20)):
        path.write_bytes(content)
        with pytest.raises(InputError, match="no journal"):
            Journal(path)
        assert path.read_bytes() == content


HOSTILE = [
    '{"stack":"a"}',
    '{"stack":{}}',
    '{"stack":{"name":["a"],"state":"done"}}',
    '{"stack":{"name":"a","state":"finished"}}',
    '{"stack":{"name":"a","state":"done","seconds":"long"}}',
    '{"stack":{"name":"a","state":"done","outputs":{"a.h5":7}}}',
    '{"stack":{"name":"a","state":"done","outputs":{"a.h5":{"bytes":"many"}}}}',
    '{"stack":{"name":"a","state":"done","outputs":["a.h5"]}}',
    '{"stack":{"name":"a","state":"done","psnr":{"mean":"good"}}}',
    '{"stack":{"name":"a","state":"done","notes":[1]}}',
    '{"stack":{"name":"a","state":"done","new":1}}',
    "[1]",
    '{"run":1}',
]


@pytest.mark.parametrize("line", HOSTILE)
def test_sealed_lines_of_others_count_for_nothing(tmp_path, line):
    """Checksums are no secret: what a line holds is looked at all the same."""
    path = tmp_path / "journal.jsonl"
    journal = Journal(path)
    journal.add(Outcome("first", "done", "k"))
    journal.close()
    with path.open("ab") as file:
        file.write(sealed(line.encode()) + b"\n")
    journal = Journal(path)
    assert [*journal.outcomes] == ["first"]
    journal.close()


def test_two_drivers(stacks, tmp_path, monkeypatch):
    monkeypatch.setattr(journals, "_WAIT_SECONDS", 0.1)
    held = Journal(tmp_path / "journal.jsonl")
    with pytest.raises(InputError, match="still running"):
        run_batch(tasks_of(stacks, tmp_path), tmp_path, engine=Here())
    held.close()
    assert begun(tasks_of(stacks, tmp_path), tmp_path) == ["a", "b", "c"]


def test_leftovers_of_killed_workers(tmp_path):
    ours, theirs = tmp_path / "a.h5", tmp_path / "b.h5"
    for name in (".a.h5.part", ".a.h5.lock", ".b.h5.part", ".a.h5.txt", "a.h5.part"):
        (tmp_path / name).write_text("")
    (tmp_path / ".a.h5.x1y2z3w4.part").mkdir()
    (tmp_path / ".a.h5.x1y2z3w4.part" / "file").write_text("")
    assert sweep([str(ours)]) == 3
    assert sorted(os.listdir(tmp_path)) == [".a.h5.txt", ".b.h5.part", "a.h5.part"]
    with replacing(theirs):
        assert sweep([str(ours), str(theirs)]) == 0
    assert theirs.exists()


def test_fingerprints_of_folders(tmp_path):
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "a").write_text("one")
    (folder / "b").write_text("two")
    known = take_fingerprint(folder).to_json()
    (folder / ".DS_Store").write_text("x")
    assert is_unchanged(folder, known, verify=True)
    (folder / "a").rename(folder / "c")
    assert not is_unchanged(folder, known)
    (folder / "c").rename(folder / "a")
    assert is_unchanged(folder, known)
    (folder / "a").write_text("onf")
    assert not is_unchanged(folder, known)
    assert not is_unchanged(tmp_path / "none", known)


def test_the_fingerprint_of_an_encoding_is_its_seal(tmp_path):
    """Which its payload bears: no more of a large file is read."""
    path = tmp_path / "e.h5"
    write_encoded(path, read_encoded(FROZEN / "encoded.2.hdf")[0])
    known = take_seal(path)
    assert known["content"].startswith("seal xxh3-64 ")
    os.utime(path, ns=(0, 0))
    assert is_unchanged(path, known)
    write_encoded(path, replace(read_encoded(path)[0], body=bytes(48)))
    assert not is_unchanged(path, known)


def test_workers_share_the_processors():
    assert worker_environment(1, {}) == {}
    share = worker_environment(2, {"OMP_NUM_THREADS": "7"})
    assert share["POCL_MAX_PTHREAD_COUNT"] == str(max(1, usable_cores() // 2))
    assert "OMP_NUM_THREADS" not in share


def test_the_help_names_every_job_and_which_have_other_endings():
    said = " ".join(call("batch", "--help").out.split()).replace("- ", "-")
    jobs = re.search(r"--job TEXT (.*?)\. ", said)[1].replace(" or ", ", ").split(", ")
    assert jobs == list(VERBS)
    endings = re.search(r"such as \.exr \((.*?)\)", said)[1].split(", ")
    assert sorted(endings) == sorted(name for name, verb in VERBS.items() if verb.endings)
