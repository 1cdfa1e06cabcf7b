"""`pack` in tiles: the bytes of one process, whatever ends on the way."""

import fnmatch
import json
import os
import signal
import time

import numpy as np
import pytest

from clrelight.batch import make_tasks, read_listing
from clrelight.batch.single import run_single
from clrelight.batch.tiles import run_tiles
from clrelight.codec.entropy.units import list_tiles, list_units
from clrelight.codec.formats import klt, klt_tiles
from clrelight.codec.formats.klt_tiles import cut_tile, sides_of
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.jobs.farm import pack_arrays, unpack_arrays
from clrelight.jobs.pack import pack
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests.batches import are_gone, await_line, children_of, finish_batch, start_batch, strays_in
from tests.commands import call, succeed
from tests.test_batch import Here, died

HEIGHT, WIDTH, LIGHTS = 600, 1100, 6
OPTIONS = {"method": "spline", "degree": 1, "memory": "8MiB", "rate": 0.5}
WORDS = ("--job", "pack", "--tiles", *(f"--set={name}={value}" for name, value in OPTIONS.items()))


def photographs(height=HEIGHT, width=WIDTH, n_light=LIGHTS):
    """8-bit photographs of one channel: bumps, with noise."""
    y, x = np.mgrid[0 : 1 : height * 1j, 0 : 1 : width * 1j]
    normals = np.stack([np.sin(25 * x * y), np.cos(17 * y), np.full_like(x, 1.5)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    shading = np.maximum(np.einsum("id,hwd->ihw", make_pattern("uniform", n_light), normals), 0.0)
    noise = 0.02 * np.random.default_rng(5).standard_normal((n_light, height, width))
    return np.rint(255 * np.clip(shading + noise, 0, 1)).astype(np.uint8)[..., None]


def write(path, **fields):
    write_stack(path, LightStack(photographs(), make_pattern("uniform", LIGHTS), 255.0, name="s", **fields))


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packs") / "in"
    folder.mkdir()
    write(folder / "a.h5")
    return folder


@pytest.fixture(scope="module")
def alone(stacks, tmp_path_factory):
    """What one process makes."""
    out, report = tmp_path_factory.mktemp("alone") / "a.h5", Report()
    pack(stacks / "a.h5", out, report=report, **OPTIONS)
    return out.read_bytes(), report


class Failing(Here):
    """Ends the process of chores with some names, so many times."""

    def __init__(self, pattern, times=99):
        super().__init__()
        self.pattern, self.times = pattern, times

    def collect(self, seconds):
        if self.times and fnmatch.fnmatchcase(self._held[0].name, self.pattern):
            self.times -= 1
            return [died(self._held.pop(0).name)]
        return super().collect(seconds)


def pack_in_tiles(stacks, out, engine, changes=None, **given):
    tasks = make_tasks(read_listing(stacks, "pack", out=out), out, job="pack", options={**OPTIONS, **(changes or {})})
    return run_tiles(tasks, out, engine=engine, report=Report(), **given)


def chores(engine, kind="pack-tile"):
    return [name for name in engine.begun if f"@{kind}-" in name]


def test_tiles_give_the_bytes_of_one_process(stacks, alone, tmp_path):
    engine = Here()
    batch = pack_in_tiles(stacks, tmp_path / "out", engine)
    assert not batch.failed, batch.failed
    assert (tmp_path / "out" / "a.h5").read_bytes() == alone[0]
    (outcome,) = batch.outcomes
    assert dict(outcome.psnr) == alone[1].psnr
    assert all(chores(engine, kind) for kind in ("pack-tile", "pack-try", "measure-windows"))
    assert not (tmp_path / "out" / "a.shards").exists()
    assert strays_in(tmp_path / "out") == []
    # What stands is kept, by a batch without tiles as well.
    again = Here()
    assert pack_in_tiles(stacks, tmp_path / "out", again).kept == {"a"}
    assert again.begun == []
    assert succeed("batch", stacks, tmp_path / "out", *WORDS[:2], *WORDS[3:], "--json").json["kept"] == 1


@pytest.mark.parametrize(
    ("transfer", "changes"),
    [("linear", {"method": "cls", "holdout": 3}), ("srgb", {"holdout": 3, "memory": "4MiB", "measure": "all"})],
)
def test_other_fits_and_curves(tmp_path, monkeypatch, transfer, changes):
    monkeypatch.setattr(klt, "_WHOLE_BYTES", 1)  # else a small map behind a curve is coded as a whole
    monkeypatch.setattr(klt_tiles, "PART_PIXELS", 1)
    (tmp_path / "in").mkdir()
    mask_hw = np.ones((HEIGHT, WIDTH), bool)
    mask_hw[:, :300] = False
    write(tmp_path / "in" / "a.h5", transfer=transfer, mask_hw=mask_hw)
    engine, report = Here(), Report()
    batch = pack_in_tiles(tmp_path / "in", tmp_path / "out", engine, changes)
    assert not batch.failed, batch.failed
    assert chores(engine)
    pack(tmp_path / "in" / "a.h5", tmp_path / "one.h5", report=report, **{**OPTIONS, **changes})
    assert (tmp_path / "out" / "a.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
    assert dict(batch.outcomes[0].psnr) == report.psnr


def test_a_poison_tile_fails_alone(stacks, alone, tmp_path):
    engine = Failing("*@pack-tile-*", times=2)
    batch = pack_in_tiles(stacks, tmp_path, engine, keep_going=True, retries=0)
    (outcome,) = batch.failed
    assert (outcome.name, outcome.kind) == ("a", "died")
    assert outcome.error.startswith("a@pack-tile-")
    assert not (tmp_path / "a.h5").exists()
    shards = sorted(os.listdir(tmp_path / "a.shards"))
    assert strays_in(tmp_path / "a.shards") == []
    # One that holds other bits now is not taken; what was done else is not done again.
    damaged = next(name for name in shards if name.startswith("pack-try-"))
    content = bytearray((tmp_path / "a.shards" / damaged).read_bytes())
    content[len(content) // 2] ^= 8
    (tmp_path / "a.shards" / damaged).write_bytes(content)
    again = Here()
    assert not pack_in_tiles(stacks, tmp_path, again).failed
    assert (tmp_path / "a.h5").read_bytes() == alone[0]
    assert [name.split("@")[1] for name in chores(again, "pack-try")] == [damaged.removesuffix(".npz")]


def test_a_worker_that_dies_once(stacks, alone, tmp_path):
    engine = Failing("*@pack-tile-*", times=1)
    assert not pack_in_tiles(stacks, tmp_path, engine).failed
    assert (tmp_path / "a.h5").read_bytes() == alone[0]


def test_a_folder_is_read_into_a_stack_for_all(tmp_path):
    folder = tmp_path / "photographs"
    folder.mkdir()
    lines = [str(LIGHTS)]
    for light, (direction, image) in enumerate(zip(make_pattern("uniform", LIGHTS), photographs(), strict=True)):
        write_image(folder / f"{light}.png", image)
        lines.append(f"{light}.png {direction[0]} {direction[1]} {direction[2]}")
    (folder / "dome.lp").write_text("\n".join(lines))
    engine, report = Here(), Report()
    asked = {**OPTIONS, "subset": "0:5", "transfer": "linear"}
    run_single("pack", folder, tmp_path / "view.h5", options=asked, engine=engine, report=report)
    assert chores(engine, "ingest")
    pack(folder, tmp_path / "one.h5", report=Report(), **asked)
    assert (tmp_path / "view.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["one.h5", "photographs", "view.h5"]
    assert report.facts["n_light"] == 5


def test_a_command_with_workers_says_what_it_says_alone(stacks, alone, tmp_path):
    words = ("--method", "spline", "--degree", 1, "--memory", "8MiB", "--rate", 0.5, "--json")
    told = succeed("pack", stacks / "a.h5", tmp_path / "view.h5", *words, "--jobs", 2).json
    assert (tmp_path / "view.h5").read_bytes() == alone[0]
    assert told["psnr"] == alone[1].psnr
    assert told["bytes_on_disk"] == len(alone[0])
    assert os.listdir(tmp_path) == ["view.h5"]


def test_a_failure_leaves_what_is_done_and_nothing_else_is_removed(stacks, alone, tmp_path):
    shards = tmp_path / "view.shards"
    shards.mkdir()
    (shards / "mine.txt").write_text("not to be touched")
    engine = Failing("*@pack-tile-*")
    with pytest.raises(InputError, match="view@pack-tile-"):
        run_single("pack", stacks / "a.h5", tmp_path / "view.h5", options=OPTIONS, engine=engine, report=Report())
    assert not (tmp_path / "view.h5").exists()
    again = Here()
    run_single("pack", stacks / "a.h5", tmp_path / "view.h5", options=OPTIONS, engine=again, report=Report())
    assert not chores(again, "pack-try")
    assert (tmp_path / "view.h5").read_bytes() == alone[0]
    assert os.listdir(shards) == ["mine.txt"]


def test_what_is_not_for_workers(stacks, tmp_path):
    def refuse(text, source, out="x.h5", **options):
        with pytest.raises(InputError, match=text):
            run_single("pack", source, tmp_path / out, options=options, engine=Here(), report=Report())
        assert not any(tmp_path.iterdir())

    refuse("no file or folder", tmp_path / "none.h5")
    refuse("pack has no option 'colour'", stacks / "a.h5", colour=1)
    refuse("there is no folder", stacks / "a.h5", "none/x.h5")
    with pytest.raises(InputError, match="for the jobs fit and decode, not for pack"):
        pack_in_tiles(stacks, tmp_path / "out", Here(), rows=5)


@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_a_driver_that_is_ended(stacks, alone, tmp_path, name):
    out = tmp_path / "out"
    started = start_batch(stacks, out, *WORDS, "--jobs", 2, faults={"*@pack-tile-*": "slow"})
    try:
        await_line(out / "journal.jsonl", "@pack-tile-")
        children = children_of(started)
        started.send_signal(signal.Signals[name])
        since = time.monotonic()
        started.communicate(timeout=20)
        assert are_gone(children, 5.0 - (time.monotonic() - since))
    finally:
        started.kill()
    if name == "SIGINT":
        assert started.returncode == 128 + signal.SIGINT
        assert strays_in(out) == []
    done = len([*(out / "a.shards").glob("pack-try-*")])
    assert done
    told = call("batch", stacks, out, *WORDS, "--json").json
    assert told["done"] == 1
    assert (out / "a.h5").read_bytes() == alone[0]
    runs = (out / "journal.jsonl").read_text().count("@pack-try-")
    assert runs == done
    assert strays_in(out) == []


def test_workers_that_are_killed(stacks, alone, tmp_path):
    out = tmp_path / "out"
    code, told, complaint = finish_batch(
        stacks, out, *WORDS, "--jobs", 2, "--json", faults={"*@measure-windows-*": "once"}
    )
    assert code == 0, complaint
    assert json.loads(told)["done"] == 1
    assert (out / "a.h5").read_bytes() == alone[0]


@pytest.mark.parametrize(("height", "width"), [(1, 1), (512, 3000), (513, 5000), (4000, 1100), (1537, 2049)])
def test_parts_are_the_tile(height, width):
    for tile in list_tiles(height, width, 9, 1 << 24):
        for most in (1, 1 << 20):
            parts = cut_tile(tile, height, width, most)
            assert sorted(t for part in parts for t in part.streams) == sorted(tile.streams)
            assert sum(part.n_pixel for part in parts) == tile.n_pixel
            units = list_units(height, width)
            assert all([units[t] for t in part.streams] == part.units for part in parts)
            assert all(sides_of(part)[1] % 512 == sides_of(part)[0] % 512 == 0 for part in parts)


def test_arrays_travel_as_they_are():
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array([1], np.uint8)}
    content = pack_arrays(arrays)
    assert content == pack_arrays(dict(arrays))
    found = unpack_arrays(content)
    assert all((found[name] == arrays[name]).all() and found[name].dtype == arrays[name].dtype for name in arrays)
    with pytest.raises(ValueError, match="allow_pickle"):
        unpack_arrays(pack_arrays({"a": np.array([{}], object)}))
