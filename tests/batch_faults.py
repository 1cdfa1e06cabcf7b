"""Batches in real processes that are harmed: what is found afterwards is what one undisturbed process makes.

``python -m tests.batch_faults --kills 50`` kills so many drivers at random moments, and does each other harm that
`KINDS` names; it prints a JSON object a kind, and exits with 1 where something is not as it must be. ``--only driver``
is one kind alone. ``full-disk`` and ``hosts`` need root: a small file system, and network namespaces.
"""

import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import click
import pytest

from clrelight.batch.journal import Journal
from clrelight.errors import InputError
from clrelight.store import read_fit
from tests import campaign
from tests.batches import (
    FIT,
    are_gone,
    await_line,
    children_of,
    finish_batch,
    make_stacks,
    results_in,
    start_batch,
    strays_in,
)
from tests.campaign import Tally
from tests.commands import ROOT, environment
from tests.test_batch_pack import WORDS, write

NAMES = [f"s{i}" for i in range(6)]
DASK = str(Path(sys.executable).with_name("dask"))
_PATIENCE_SECONDS = 180
_CHAIN = 4
"""Drivers that are killed one after the other before one is let finish."""


class Place:
    """Stacks, what one process makes of them, and a folder for results."""

    names, job = NAMES, FIT

    def __init__(self, folder, seed):
        self.folder, self.random = folder, random.Random(seed)
        self.stacks = self.make(folder / "in")
        self.out = folder / "out"
        self.seconds = 0.0
        for _ in range(2):  # the first may build kernels
            since = time.monotonic()
            self.fresh()
            self.finish()
            self.seconds = time.monotonic() - since
        self.made = results_in(self.out)
        assert len(self.made) == len(self.names)

    def make(self, folder):
        return make_stacks(folder, self.names, shape=(40, 30, 3))

    def words(self, *more, engine="local"):
        return (self.stacks, self.out, *self.job, "--engine", engine, *more)

    def fresh(self):
        shutil.rmtree(self.out, ignore_errors=True)

    def finish(self, *more, engine="local", faults=None):
        code, told, complaint = finish_batch(*self.words(*more, "--json", engine=engine), faults=faults)
        assert code == 0, complaint
        return json.loads(told)

    def check(self):
        """What stands is what one process makes, and nothing else."""
        found = results_in(self.out)
        assert found == self.made, [name for name in self.made if found.get(name) != self.made[name]]
        assert strays_in(self.out) == [], strays_in(self.out)

    def wait(self):
        time.sleep(self.random.random() * self.seconds)


class PackPlace(Place):
    """One stack that is packed in tiles."""

    names, job = ["a"], WORDS

    def make(self, folder):
        folder.mkdir()
        write(folder / "a.h5")
        return folder


def poison_tile(place, count):
    """A tile that ends every worker fails; the other parts are kept, and the same command does what is missing."""
    place.fresh()
    words = place.words("--keep-going", "--json", "--jobs", 2)
    since = time.monotonic()
    code, told, _ = finish_batch(*words, faults={"a@measure-windows-*": "kill"})
    seconds = time.monotonic() - since
    (row,) = json.loads(told)["rows"]
    assert (code, row["state"]) == (2, "failed"), row
    assert row["error"].startswith("a@measure-windows-"), row
    assert results_in(place.out) == {}
    before = {path.name: path.stat().st_mtime_ns for path in (place.out / "a.shards").glob("pack-*.npz")}
    assert before
    assert strays_in(place.out / "a.shards") == []
    place.finish()
    place.check()
    assert not (place.out / "a.shards").exists()
    return ["failed alone"], seconds


def fill_disk_of_shards(place, count):
    """A file system without room for the shards: one line, nothing unfinished; with room the same command completes."""
    before, place.out = place.out, place.folder / "small" / "out"
    try:
        with small_disk(place.folder / "small", len(place.made["a.h5"])):
            code, _, complaint = finish_batch(*place.words())
            assert code == 2, complaint
            assert "the disk is full" in complaint or "MB are free" in complaint, complaint
            assert results_in(place.out) == {}
            assert strays_in(place.out) == []
            subprocess.run(["mount", "-o", "remount,size=64M", place.out.parent], check=True)
            place.finish()
            place.check()
    finally:
        (place.folder / "small").rmdir()
        place.out = before
    return ["refused"]


def kill_drivers(place, count, engine="local"):
    """SIGKILL; the children are gone in 5 s, and the last driver finishes what the killed ones began."""
    place.fresh()
    slowest = 0.0
    for _ in range(count):
        started = start_batch(*place.words("--jobs", 2, engine=engine))
        place.wait()
        children = children_of(started)
        since = time.monotonic()
        started.kill()
        assert are_gone(children, 5.0), "children live on"
        slowest = max(slowest, time.monotonic() - since)
        started.communicate()
        whole = results_in(place.out) if place.out.exists() else {}
        assert all(place.made[name] == content for name, content in whole.items())
    place.finish("--jobs", 2)
    place.check()
    return ["killed"] * count, slowest


def kill_workers(place, count):
    """SIGKILL of a worker at any moment: the driver goes on, and every stack is done."""
    place.fresh()
    started = start_batch(*place.words("--jobs", 2, "--retries", 9))
    killed = 0
    end = time.monotonic() + _PATIENCE_SECONDS
    while started.poll() is None and time.monotonic() < end:
        time.sleep(place.random.random() * place.seconds / 3)
        children = sorted(children_of(started))
        if children and killed < count:
            with suppress(ProcessLookupError):
                os.kill(place.random.choice(children), signal.SIGKILL)
                killed += 1
    _, complaint = started.communicate(timeout=10)
    assert started.returncode == 0, complaint
    place.check()
    return ["killed"] * killed


def interrupt(place, count):
    """Ctrl-C and SIGTERM: one line, nothing unfinished, and the same command goes on."""
    place.fresh()
    started = start_batch(*place.words("--jobs", 2))
    await_line(place.out / "journal.jsonl", '"run"', _PATIENCE_SECONDS)
    place.wait()
    children = children_of(started)
    number = place.random.choice([signal.SIGINT, signal.SIGTERM])
    started.send_signal(number)
    _, complaint = started.communicate(timeout=20)
    assert are_gone(children, 1.0)
    if started.returncode:
        assert started.returncode == 128 + number, started.returncode
        said = [line for line in complaint.splitlines() if not line.startswith("note: ")]  # those came before
        assert len(said) <= 1, complaint
    assert strays_in(place.out) == []
    place.finish()
    place.check()
    return ["ended"]


def poison(place, count, engine="local"):
    """A stack that ends every worker fails alone, in 10 s net of the start."""
    place.fresh()
    since = time.monotonic()
    words = place.words("--keep-going", "--json", "--jobs", 2, engine=engine)
    code, told, _ = finish_batch(*words, faults={"s2": "kill"})
    seconds = time.monotonic() - since
    tries = {row["stack"]: row["tries"] for row in json.loads(told)["rows"]}
    assert tries["s2"] == 2, tries  # and so many workers have ended
    rows = {row["stack"]: row["state"] for row in json.loads(told)["rows"]}
    assert (code, rows) == (2, {name: "failed" if name == "s2" else "done" for name in NAMES}), rows
    assert strays_in(place.out) == []
    place.finish()
    place.check()
    return ["failed alone"], seconds


@contextmanager
def small_disk(folder, size):
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


def fill_disk(place, count):
    """A file system without room for all: one line, nothing unfinished; with room the same command completes."""
    before, place.out = place.out, place.folder / "small" / "out"
    size = int(2.5 * max(map(len, place.made.values())))
    try:
        with small_disk(place.folder / "small", size):
            code, _, complaint = finish_batch(*place.words())
            assert code == 2
            assert "the disk is full" in complaint or "MB are free" in complaint, complaint
            assert complaint.count("\n") <= 2, complaint
            assert strays_in(place.out) == []
            found = results_in(place.out)
            assert 0 < len(found) < len(NAMES)
            assert all(place.made[name] == content for name, content in found.items())
            subprocess.run(["mount", "-o", "remount,size=64M", place.out.parent], check=True)
            assert place.finish()["kept"] >= len(found) - 1
            place.check()
    finally:
        (place.folder / "small").rmdir()
        place.out = before
    return ["refused"]


def lose_shards(place, count):
    """A shard that is missing is an error, never NaN, and the batch makes it again."""
    place.fresh()
    tiles = ("--tile-rows", 9, "--virtual", "--match", "s0")
    place.finish(*tiles)
    fitted, shards = place.out / "s0.h5", sorted((place.out / "s0.shards").iterdir())
    whole, content = read_fit(fitted).coeffs_khwc, fitted.read_bytes()
    lost = place.random.choice(shards)
    lost.unlink()
    with pytest.raises(InputError, match="is missing"):
        read_fit(fitted)
    place.finish(*tiles)
    assert fitted.read_bytes() == content
    assert (read_fit(fitted).coeffs_khwc == whole).all()
    return ["found"]


def flip_bits(place, count):
    """Flips and truncations of the journal, of a file in tiles, and of a shard: none changes a value in silence."""
    place.fresh()
    place.finish("--tile-rows", 9, "--virtual", "--match", "s0")
    fitted, journal = place.out / "s0.h5", place.out / "journal.jsonl"
    whole, known = read_fit(fitted), Journal(journal)
    known.close()
    ways = []
    for path, look in (
        (fitted, lambda: _same_fit(fitted, whole)),
        (sorted((place.out / "s0.shards").iterdir())[1], lambda: _same_fit(fitted, whole)),
        (journal, lambda: _same_journal(journal, known)),
    ):
        content = path.read_bytes()
        for number in range(count + count * 4 // 15):
            spot = place.random.randrange(len(content))
            damaged = bytearray(content) if number < count else bytearray(content[:spot])
            if number < count:
                damaged[spot] ^= 1 << place.random.randrange(8)
            path.write_bytes(damaged)
            ways.append(look())
        path.write_bytes(content)
    assert "silent" not in ways, ways.count("silent")
    return ways


def _same_fit(path, whole):
    try:
        found = read_fit(path)
    except InputError:
        return "found"
    arrays = all((getattr(found, name) == getattr(whole, name)).all() for name in ("coeffs_khwc", "lambda_hwc"))
    facts = all(getattr(found, name) == getattr(whole, name) for name in ("config", "peak", "degree", "name"))
    return "harmless" if arrays and facts and (found.directions_i3 == whole.directions_i3).all() else "silent"


def _same_journal(path, known):
    try:
        found = Journal(path)
    except InputError:
        return "found"
    found.close()
    if not all(outcome == known.outcomes.get(name) for name, outcome in found.outcomes.items()):
        return "silent"
    return "found" if found.damaged else "harmless"


def two_drivers(place, count):
    """Two begin at once: one works, the other is refused or finds all done; no stack is done twice at a time."""
    place.fresh()
    both = [start_batch(*place.words("--jobs", 1)) for _ in range(2)]
    codes = sorted((each.communicate(timeout=_PATIENCE_SECONDS), each.returncode)[1] for each in both)
    assert codes in ([0, 0], [0, 2]), codes
    place.check()
    return ["refused"] if codes == [0, 2] else ["in turn"]


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def start_dask(stack, *words, inside=(), **changes):
    """Begin a scheduler or a worker, ended when the stack is."""
    started = subprocess.Popen(
        [*inside, DASK, *map(str, words)],
        env=environment(**{"DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0", **changes}),
        cwd=ROOT.parent,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )

    def end():
        with suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
        started.wait()

    stack.callback(end)
    return started


def unsound_worker(place, count):
    """A scheduler with two workers, of which one has no sound device: it is told of, and the job goes on."""
    place.fresh()
    with ExitStack() as stack:
        port = free_port()
        address = f"tcp://127.0.0.1:{port}"
        local = str(place.folder / "dask")
        start_dask(stack, "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
        options = ("worker", address, "--nthreads", 1, "--no-dashboard", "--local-directory", local)
        start_dask(
            stack, *options, OCL_ICD_VENDORS=str(place.folder / "none"), CLRELIGHT_DEVICE="none", OCL_ICD_FILENAMES=""
        )
        start_dask(stack, *options)
        time.sleep(2 * place.seconds)  # both are to be there
        told = place.finish(engine=address)
    place.check()
    refused = [note for note in told["notes"] if "gets no more stacks" in note]
    assert len(refused) == 1, told["notes"]
    return ["refused"]


def two_hosts(place, count):
    """A scheduler and a worker in one network namespace, a worker in another: stacks are done on both."""
    place.fresh()
    names = [f"clr{os.getpid() % 10000}{which}" for which in "ab"]

    def ip(*words):
        subprocess.run(["ip", *words], check=True, capture_output=True)

    with ExitStack() as stack:
        for name in names:
            ip("netns", "add", name)
            stack.callback(subprocess.run, ["ip", "netns", "del", name], check=False)
        ip("link", "add", names[0], "type", "veth", "peer", "name", names[1])
        for number, name in enumerate(names, 1):
            ip("link", "set", name, "netns", name)
            for words in (
                ("addr", "add", f"10.77.0.{number}/24", "dev", name),
                ("link", "set", name, "up"),
                ("link", "set", "lo", "up"),
            ):
                ip("-n", name, *words)
        address = "tcp://10.77.0.1:8786"
        first, second = (["ip", "netns", "exec", name] for name in names)
        start_dask(stack, "scheduler", "--host", "10.77.0.1", "--port", 8786, "--no-dashboard", inside=first)
        for inside, host in ((first, "10.77.0.1"), (second, "10.77.0.2")):
            local = str(place.folder / host)
            words = ("worker", address, "--nthreads", 1, "--host", host, "--no-dashboard", "--local-directory", local)
            start_dask(stack, *words, inside=inside)
        time.sleep(2 * place.seconds)
        words = [*map(str, place.words("--json", engine=address))]
        code = f"from tests.batches import finish_batch; print(finish_batch(*{words!r}))"
        done = subprocess.run(
            [*first, sys.executable, "-c", code],
            cwd=ROOT,
            env=environment(),
            capture_output=True,
            text=True,
            timeout=_PATIENCE_SECONDS,
        )
        assert done.stdout.startswith("(0,"), done.stdout + done.stderr
        stacks = json.loads((place.out / "summary.json").read_text())["stacks"]
        hosts = {each["worker"].split("/")[2].rpartition(":")[0] for each in stacks}
        assert hosts == {"10.77.0.1", "10.77.0.2"}, hosts
    place.check()
    return ["done on both"]


PACKED = {
    "pack-driver": (kill_drivers, "killed"),
    "pack-driver-dask": (lambda place, count: kill_drivers(place, count, "dask"), "killed"),
    "pack-worker": (kill_workers, "killed"),
    "pack-interrupt": (interrupt, "ended"),
    "pack-poison": (poison_tile, "failed alone"),
    "pack-full-disk": (fill_disk_of_shards, "refused"),
}
KINDS = {
    "driver": (kill_drivers, "killed"),
    "driver-dask": (lambda place, count: kill_drivers(place, count, "dask"), "killed"),
    "worker": (kill_workers, "killed"),
    "interrupt": (interrupt, "ended"),
    "poison": (poison, "failed alone"),
    "poison-dask": (lambda place, count: poison(place, count, "dask"), "failed alone"),
    "full-disk": (fill_disk, "refused"),
    "lost-shard": (lose_shards, "found"),
    "flips": (flip_bits, "found"),
    "two-drivers": (two_drivers, "refused"),
    "unsound-worker": (unsound_worker, "refused"),
    "hosts": (two_hosts, "done on both"),
}
WAYS = ("cases", "killed", "ended", "failed alone", "refused", "in turn", "found", "harmless", "done on both")


def rounds_of(kind, kills, flips):
    """Return how often a kind is done, and how many harms each time."""
    if kind in ("driver", "pack-driver"):
        return -(-kills // _CHAIN), _CHAIN
    if kind in ("worker", "pack-worker"):
        return max(1, kills * 3 // 5 // 3), 3
    if kind in ("interrupt", "pack-interrupt"):
        return max(1, kills // 10), 1
    return {
        "driver-dask": (1, 2),
        "pack-driver-dask": (1, 2),
        "flips": (1, flips),
    }.get(kind, (1, 1))


@click.command()
@click.option("--kills", type=click.IntRange(min=1), default=50, show_default=True, help="Drivers that are killed.")
@click.option("--flips", type=click.IntRange(min=1), default=1500, show_default=True, help="Bits of each kind of file.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--only", metavar="TEXT", default="", help="Only kinds whose name holds TEXT.")
@click.option("--without", metavar="NAMES", default="", help="Kinds to leave out, separated by commas.")
def main(kills, flips, seed, only, without):
    """Harm batches; print one JSON object for each kind, exit 1 on a failure."""

    def tallies():
        with tempfile.TemporaryDirectory() as folder:
            places = {}
            for kind, (harm, _) in {**KINDS, **PACKED}.items():
                if only not in kind or kind in without.split(","):
                    continue
                make = PackPlace if kind in PACKED else Place
                if make not in places:
                    (Path(folder) / make.__name__).mkdir()
                    places[make] = make(Path(folder) / make.__name__, seed)
                place = places[make]
                tally = Tally(*WAYS)
                rounds, count = rounds_of(kind, kills, flips)
                for number in range(rounds):
                    tally.run(
                        f"{kind} {number}",
                        lambda harm=harm, count=count, place=place: harm(place, count),
                        first="cases",
                    )
                tally.counts = {way: n for way, n in tally.counts.items() if n}
                yield kind, tally

    campaign.conclude("kind", tallies())


if __name__ == "__main__":
    main(prog_name="python -m tests.batch_faults")
