"""How soon hostile files are refused: the slowest of each kind, in milliseconds of a processor and of the clock.

``python -m tests.refusal_times --count 300 --most 10`` damages files of every schema and shards of files in tiles,
seals journals of nonsense and writes lists of stacks that are none, beside what programs would do that mean harm
(claims of terabytes, chunks that inflate without end, links, a thousand shards). It prints a JSON object a kind, and
exits with 1 where one takes a processor longer than ``--most``. Who takes longer is tried again: what other programs do
meanwhile is none of a file's doing.
"""

from __future__ import annotations

import json
import os
import random
import sys
import tempfile
import time
from pathlib import Path

import click
import h5py
import numpy as np

from clrelight import store
from clrelight.batch.journal import Journal, sealed
from clrelight.batch.lists import read_list
from clrelight.batch.task import Outcome
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.store.shards import shard_name
from clrelight.store.tiling import write_tiles
from tests.file_mutations import KINDS, damage, write_all
from tests.hdf5 import content, unseal

TRIES = 4
"""Of a case that is slow: the fastest counts."""


class Slowest:
    """The slowest refusal of a kind."""

    def __init__(self, most):
        self.most, self.count, self.read, self.failures = most, 0, 0, []
        self.cpu_ms, self.wall_ms, self.case = 0.0, 0.0, ""

    def time(self, case, do):
        """Do what is to be refused with InputError; what is not counts as read."""
        self.count += 1
        spent = []
        for _ in range(TRIES):
            cpu, wall = time.process_time(), time.perf_counter()
            try:
                do()
            except InputError:
                pass
            except Exception as error:
                self.failures.append(f"{case}: {error!r}")
                return
            else:
                self.read += 1
                return
            spent.append((1e3 * (time.process_time() - cpu), 1e3 * (time.perf_counter() - wall)))
            if max(spent[-1]) < self.most / 2:
                break
        cpu, wall = min(each[0] for each in spent), min(each[1] for each in spent)
        if cpu > self.cpu_ms:
            self.case = case
        self.cpu_ms, self.wall_ms = max(self.cpu_ms, cpu), max(self.wall_ms, wall)

    def told(self, kind):
        return {
            "kind": kind,
            "cases": self.count,
            "refused": self.count - self.read,
            "slowest_cpu_ms": round(self.cpu_ms, 2),
            "slowest_ms": round(self.wall_ms, 2),
            "case": self.case,
            "failures": self.failures[:5],
        }


def damaged_files(kind, folder, count, slowest, rng):
    """Files of a schema, damaged at random."""
    sound = {name: path.read_bytes() for name, path in write_all(folder).items()}
    path, others = folder / "damaged.h5", list(sound.values())
    for number in range(count):
        path.write_bytes(damage(sound[kind], others, rng))
        slowest.time(f"damage {number}", lambda: content(kind, path))


def harmful_stacks(folder, count, slowest, rng):
    """Stacks that another program made to do harm: those of the tests."""
    sys.path.insert(0, str(Path(__file__).parent))  # of which it imports others by their names, as pytest has it
    from tests import test_store_hostile as hostile

    sound = write_all(folder)["stack"].read_bytes()
    path = folder / "harmful.h5"
    for test in (hostile.test_sizes, hostile.test_wrong_values):
        cases = next(mark for mark in test.pytestmark if mark.name == "parametrize").args[1]
        for number, (change, phrase) in enumerate(cases):
            path.write_bytes(sound)
            try:
                hostile.edit(path, change)
            except KeyError:
                continue
            slowest.time(f"{test.__name__} {number}: {phrase}", lambda: content("stack", path))


def fit_in_tiles(folder, ends):
    """Write a fit in tiles; return its path and its shards."""
    rng, lights = np.random.default_rng(1), make_pattern("uniform", 9)
    shards = folder / "tiled.shards"
    shards.mkdir()
    for first, end in zip([0, *ends], ends, strict=False):
        rows = rng.standard_normal((4, end - first, 5, 3), np.float32)
        fit = CoefficientMap(rows, 1, "cls", 255.0, "srgb", lights, {}, None, None, "vase")
        store.write_fit(shards / shard_name(first, end), fit)
    record = FitRecord(1, "cls", 255.0, "srgb", lights, {}, "vase")
    write_tiles(folder / "tiled.h5", record, shards, ends)
    return folder / "tiled.h5", sorted(shards.iterdir())


def tiles(folder, count, slowest, rng):
    """``tiles/1``: damaged files, shards that are missing among many, and lists of shards that are none."""
    path, shards = fit_in_tiles(folder, [3, 6, 9])
    sound = path.read_bytes()
    pieces = [each.read_bytes() for each in shards]
    for number in range(count):
        path.write_bytes(damage(sound, pieces, rng))
        slowest.time(f"damage {number}", lambda: store.read_fit(path))
    path.write_bytes(sound)
    for name, text in _manifests(json.loads(_attribute(path, "shards"))):
        path.write_bytes(sound)
        with h5py.File(path, "r+") as file:
            unseal(file)
            file.attrs["shards"] = text
        slowest.time(name, lambda: store.read_fit(path))


def shards(folder, count, slowest, rng):
    """The shard of a fit in one tile, damaged: two files are opened, and each further shard is one more."""
    path, (shard,) = fit_in_tiles(folder, [9])
    sound = shard.read_bytes()
    for number in range(count):
        shard.write_bytes(damage(sound, [path.read_bytes()], rng))
        slowest.time(f"damage {number}", lambda: store.read_fit(path))


def _attribute(path, name):
    with h5py.File(path) as file:
        return file.attrs[name]


def _manifests(known):
    seal = known["seals"][0]
    rows = [*range(1, 1025)]
    yield "a thousand shards that are missing", json.dumps({**known, "ends": rows, "seals": [seal] * 1024})
    yield "the last of three is missing", json.dumps({**known, "ends": [3, 6, 10]})
    yield "too many", json.dumps({**known, "ends": [*range(1, 3000)], "seals": [seal] * 2999})
    yield "a folder above", json.dumps({**known, "folder": ".."})
    yield "a huge row", json.dumps({**known, "ends": [3, 6, 10**4000]})
    yield "a number without end", json.dumps(known).replace("[3", "[" + "9" * 6000)
    yield "nested", "[" * 30000
    yield "seals of other files", json.dumps({**known, "seals": [seal] * 3})


def journals(folder, count, slowest, rng):
    """Journals: other files in their place; what is sealed and is not ours is read, and says nothing."""
    path = folder / "journal.jsonl"
    with_lines = sealed(b'{"format":"other/1"}') + b"\n"
    cases = {
        "a megabyte of zeros": bytes(1 << 20),
        "a megabyte of lines": b"\n" * (1 << 20),
        "sums without end": b'{"sum":"' * (1 << 17),
        "sums and lines": (b'{"sum":"' + b"0" * 16 + b'",\n') * (1 << 16),
        "nested": sealed(b"{" + b"[" * (1 << 16)),
        "another format": with_lines,
        "another format of many lines": with_lines * 100,
        **{f"noise {number}": rng.bytes(1 + number * 997 % 99991) for number in range(count)},
    }
    for name, held in cases.items():
        path.write_bytes(held)
        slowest.time(name, lambda: Journal(path).close())


def read_journals(folder, count, slowest, rng):
    """Journals of a thousand stacks, damaged: they are read, without what is damaged; the time is that of reading."""
    path = folder / "journal.jsonl"
    journal = Journal(path)
    os_fsync, os.fsync = os.fsync, lambda descriptor: None
    try:
        for number in range(1000):
            journal.add(Outcome(f"s{number}", "done", "k", outputs={str(folder / "a.h5"): {"bytes": 1}}))
    finally:
        os.fsync = os_fsync
        journal.close()
    sound = path.read_bytes()

    def read():
        Journal(path).close()
        raise InputError("read")

    for number in range(max(1, count // 30)):
        path.write_bytes(damage(sound, [sound], rng))
        slowest.time(f"damage {number}", read)


def lists(folder, count, slowest, rng):
    """Lists of stacks in TOML."""
    path, draw = folder / "list.toml", random.Random(1)
    sound = b'job = "fit"\nstacks = ["none*.h5"]\n[options]\ndegree = 4\n[[override]]\nmatch = "c*"\n'
    cases = [b"a = " + b"[" * 5000, b"a = " + b"9" * 6000, b"a = " + b"{a=" * 3000, b"a." * 300 + b"a = 1", bytes(9999)]
    for number in range(count):
        changed = bytearray(sound)
        for _ in range(1 + number % 3):
            changed[draw.randrange(len(changed))] = draw.randrange(256)
        cases.append(bytes(changed))
    for number, held in enumerate(cases):
        path.write_bytes(held)
        slowest.time(f"list {number}", lambda: read_list(path, None))


CORPORA = {
    **{f"{kind}": lambda *rest, kind=kind: damaged_files(kind, *rest) for kind in KINDS},
    "stacks made to do harm": harmful_stacks,
    "tiles": tiles,
    "shards": shards,
    "journals": journals,
    "journals of 1000 stacks (read)": read_journals,
    "lists": lists,
}


@click.command()
@click.option("--count", type=click.IntRange(min=1), default=300, show_default=True, help="Damages of each kind.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--only", metavar="TEXT", default="", help="Only kinds whose name holds TEXT.")
@click.option("--most", type=float, default=10.0, show_default=True, help="Milliseconds of a processor.")
def main(count, seed, only, most):
    """Have hostile files refused; print one JSON object for each kind, exit 1 where one takes too long."""
    failed = False
    for kind, corpus in CORPORA.items():
        if only not in kind:
            continue
        slowest = Slowest(most)
        with tempfile.TemporaryDirectory() as folder:
            corpus(Path(folder), count, slowest, np.random.default_rng(seed))
        print(json.dumps(slowest.told(kind)), flush=True)
        failed |= bool(slowest.failures) or ("(read)" not in kind and slowest.cpu_ms > most)
    sys.exit(failed)


if __name__ == "__main__":
    main(prog_name="python -m tests.refusal_times")
