"""Fits in tiles of rows: the bytes of one process, and shards that are missing, damaged or other ones."""

import json
import os
import shutil

import h5py
import numpy as np
import pytest

from clrelight.batch import make_tasks, read_listing
from clrelight.batch.tiles import run_tiles
from clrelight.dataset import FitRecord
from clrelight.errors import InputError, StoreFormatError
from clrelight.jobs.fit import fit
from clrelight.jobs.measure import measure
from clrelight.jobs.report import Report
from clrelight.store import open_fit, open_fitted, read_fit
from clrelight.store.shards import shard_name, shards_of
from clrelight.store.tiling import write_tiles
from clrelight.tiles import Rectangle
from tests.batches import make_stacks, strays_in
from tests.commands import call, succeed
from tests.test_batch import Here, died

HEIGHT, ROWS = 17, 5
METHODS = {"cls": {"degree": 2, "holdout": 4}, "ceb": {"degree": 2}, "spline": {"degree": 3, "weights": "solid-angle"}}


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    return make_stacks(tmp_path_factory.mktemp("tiles") / "in", ["a"], shape=(HEIGHT, 7, 3), n_light=24)


def fit_in_tiles(stacks, out, engine=None, *, rows=ROWS, virtual=False, report=None, **options):
    tasks = make_tasks(read_listing(stacks, "fit", out=out), out, job="fit", options=options)
    return run_tiles(tasks, out, rows=rows, virtual=virtual, engine=engine or Here(), report=report or Report())


@pytest.fixture
def tiled(stacks, tmp_path):
    batch = fit_in_tiles(stacks, tmp_path / "out", virtual=True, degree=2)
    assert not batch.failed
    return tmp_path / "out"


@pytest.mark.parametrize("rows", [1, 5, HEIGHT, 100])
@pytest.mark.parametrize("method", METHODS)
def test_tiles_give_the_bytes_of_one_process(stacks, tmp_path, method, rows):
    report = Report()
    batch = fit_in_tiles(stacks, tmp_path / "out", rows=rows, method=method, **METHODS[method])
    fit(stacks / "a.h5", method, out=tmp_path / "one.h5", report=report, **METHODS[method])
    assert (tmp_path / "out" / "a.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
    (outcome,) = batch.outcomes
    assert outcome.psnr == report.psnr
    assert not (tmp_path / "out" / "a.shards").exists()
    assert strays_in(tmp_path / "out") == []


def test_what_is_done_is_kept(stacks, tmp_path):
    engine = Here()
    fit_in_tiles(stacks, tmp_path, engine, degree=1)
    assert engine.begun == ["a@000000", "a@000005", "a@000010", "a@000015", "closed", "a", "closed"]
    engine = Here()
    assert fit_in_tiles(stacks, tmp_path, engine, degree=1).kept == {"a"}
    assert engine.begun == []
    assert not fit_in_tiles(stacks, tmp_path, engine, degree=0).kept
    assert engine.begun[0] == "a@000000"
    engine = Here()
    tasks = make_tasks(read_listing(stacks, "fit"), tmp_path, job="fit", options={"degree": 0})
    run_tiles(tasks, tmp_path, rows=9, virtual=True, engine=engine, anew=True, report=Report())
    assert engine.begun == ["a@000000", "a@000009", "closed", "a", "closed"]
    assert run_tiles(tasks, tmp_path, rows=9, virtual=True, engine=engine, report=Report()).kept == {"a"}


def test_a_poison_tile_fails_alone(stacks, tmp_path):
    engine = Here({"a@000005": [died("a@000005"), died("a@000005")]})
    tasks = make_tasks(read_listing(stacks, "fit"), tmp_path, job="fit", options={"degree": 1})
    batch = run_tiles(tasks, tmp_path, rows=ROWS, engine=engine, keep_going=True, report=Report())
    assert [each.name for each in batch.failed] == ["a@000005"]
    assert batch.left == ("a",)
    assert not (tmp_path / "a.h5").exists()
    assert len(os.listdir(tmp_path / "a.shards")) == 3
    assert "a@000005,failed" in (tmp_path / "summary.csv").read_text()
    engine = Here()
    batch = run_tiles(tasks, tmp_path, rows=ROWS, engine=engine, report=Report())
    assert engine.begun == ["a@000005", "closed", "a", "closed"]
    assert [each.name for each in batch.outcomes] == ["a"]


def test_a_fit_in_shards_is_a_fit(stacks, tiled, tmp_path):
    fit(stacks / "a.h5", "cls", 2, out=tmp_path / "one.h5", report=Report())
    one, whole = read_fit(tmp_path / "one.h5"), read_fit(tiled / "a.h5")
    np.testing.assert_array_equal(whole.coeffs_khwc, one.coeffs_khwc)
    np.testing.assert_array_equal(whole.lambda_hwc, one.lambda_hwc)
    assert whole.config == one.config
    with open_fit(tiled / "a.h5") as opened:
        for key in (np.s_[1], np.s_[:, 4:11], np.s_[2, 16, 3, 1], np.s_[..., 0], np.s_[[0, 3], 9], np.s_[:, 5:5]):
            np.testing.assert_array_equal(opened.coeffs_khwc[key], one.coeffs_khwc[key])
        rows = np.empty((9, 8, 7, 3), np.float32)
        opened.coeffs_khwc.read_into(Rectangle(3, 0, 11, 7), rows)
        np.testing.assert_array_equal(rows, one.coeffs_khwc[:, 3:11])
        with pytest.raises(ValueError, match="a part of 17 x 7"):
            opened.coeffs_khwc.read_into(Rectangle(10, 0, 18, 7), rows)
    assert measure(tiled / "a.h5", stacks / "a.h5") == measure(tmp_path / "one.h5", stacks / "a.h5")
    # As other programs see it: from another folder too.
    with h5py.File(tiled / "a.h5") as file:
        assert file["coefficients"].is_virtual
        np.testing.assert_array_equal(file["coefficients"][...], one.coeffs_khwc)
        np.testing.assert_array_equal(file["lambda"][...], one.lambda_hwc)
    told = succeed("info", tiled / "a.h5", "--json").json
    assert (told["schema"], told["datasets"]["coefficients"]["shape"]) == ("tiles/1", [9, HEIGHT, 7, 3])
    for name, fitted in (("1", tmp_path / "one.h5"), ("2", tiled / "a.h5")):
        succeed("encode", fitted, tmp_path / f"{name}.h5", "--codec", "half")
        succeed("relight", fitted, tmp_path / f"{name}.exr", "--light", "0,0,1")
    assert (tmp_path / "1.h5").read_bytes() == (tmp_path / "2.h5").read_bytes()
    assert (tmp_path / "1.exr").read_bytes() == (tmp_path / "2.exr").read_bytes()


def test_the_same_shards_give_the_same_file(tiled):
    content = (tiled / "a.h5").read_bytes()
    record = read_fit(tiled / "a.h5")
    write_tiles(tiled / "again.h5", FitRecord.of(record), tiled / "a.shards", [5, 10, 15, 17])
    assert (tiled / "again.h5").read_bytes() == content


def lose(folder):
    (folder / shard_name(5, 10)).unlink()


def exchange(folder):
    shutil.copyfile(folder / shard_name(0, 5), folder / shard_name(5, 10))


def link(folder):
    os.rename(folder / shard_name(5, 10), folder / "real.h5")
    os.symlink("real.h5", folder / shard_name(5, 10))


def cut(folder):
    os.truncate(folder / shard_name(5, 10), 3000)


def test_a_missing_shard_is_found_before_others_are_read(tiled):
    """Of a thousand the last may be the one: here the first is damaged."""
    (tiled / "a.shards" / "000015-000017.h5").unlink()
    (tiled / "a.shards" / "000000-000005.h5").write_bytes(b"nothing")
    with pytest.raises(StoreFormatError, match=r"000015-000017\.h5 is missing"), open_fit(tiled / "a.h5"):
        pass


@pytest.mark.parametrize(
    ("harm", "complaint"),
    [
        (lose, "shard a.shards/000005-000010.h5 is missing"),
        (exchange, "is not the one that was written"),
        (link, "is no regular file"),
        (cut, "cut short|truncated"),
    ],
)
def test_shards_that_are_not_right(stacks, tiled, harm, complaint):
    content = (tiled / "a.h5").read_bytes()
    harm(tiled / "a.shards")
    for opening in (open_fit, open_fitted):
        with pytest.raises(StoreFormatError, match=complaint), opening(tiled / "a.h5"):
            pass
    assert call("psnr", tiled / "a.h5", stacks / "a.h5").code == 2
    # The batch sees that it is not whole any more, and makes that tile alone.
    if harm is not link:  # which holds the same
        engine = Here()
        assert not fit_in_tiles(stacks, tiled, engine, virtual=True, degree=2).failed
        assert engine.begun == ["a@000005", "closed"]
        assert (tiled / "a.h5").read_bytes() == content
        read_fit(tiled / "a.h5")


def test_no_flipped_bit_of_a_shard_goes_unnoticed(tiled):
    path = tiled / "a.shards" / shard_name(5, 10)
    content, whole = path.read_bytes(), read_fit(tiled / "a.h5").coeffs_khwc
    noticed = 0
    for place in np.random.default_rng(5).integers(0, len(content), 40):
        damaged = bytearray(content)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            np.testing.assert_array_equal(read_fit(tiled / "a.h5").coeffs_khwc, whole)  # nothing reads that bit
        except StoreFormatError:
            noticed += 1
    assert noticed > 15


HOSTILE = {
    "expected a folder beside it": {"folder": ".."},
    "expected a folder": {"folder": "a/b"},
    "no list of 1 to": {"ends": []},
    "with a seal for each": {"seals": ["xxh3-64 0000000000000000"]},
    "do not follow each other": {"ends": [5, 5, 15, 17]},
    "do not follow": {"ends": [5, 10.5, 15, 17]},
    "is none": {"seals": ["x"] * 4},
}


@pytest.mark.parametrize("complaint", HOSTILE)
def test_hostile_lists_of_shards(complaint):
    manifest = {"folder": "a.shards", "ends": [5, 10, 15, 17], "seals": ["xxh3-64 0123456789abcdef"] * 4}

    class Opened:
        def attributes(self):
            return {"shards": json.dumps({**manifest, **HOSTILE[complaint]})}

    with pytest.raises(StoreFormatError, match=complaint):
        shards_of(Opened())


def test_what_is_not_for_tiles(stacks, tmp_path):
    with pytest.raises(InputError, match="tiles are for the jobs fit, decode, pack"):
        run_tiles(make_tasks(read_listing(stacks, "normals"), tmp_path, job="normals"), tmp_path)
    with pytest.raises(InputError, match="store is not for a fit that several"):
        fit_in_tiles(stacks, tmp_path, store="float16")
    # What cannot be read fails with its own line, and the others do not.
    shutil.copytree(stacks, tmp_path / "in")
    (tmp_path / "in" / "b.h5").write_text("no HDF5")
    tasks = make_tasks(read_listing(tmp_path / "in", "fit"), tmp_path / "out", job="fit", options={"degree": 1})
    batch = run_tiles(tasks, tmp_path / "out", rows=ROWS, engine=Here(), keep_going=True, report=Report())
    assert {each.name: each.is_done for each in batch.outcomes} == {"a": True, "b": False}
    assert batch.failed[0].error.endswith("is not an HDF5 file")


def test_tiles_from_the_command_line(stacks, tmp_path):
    words = ("--job", "fit", "--set", "degree=1", "--tile-rows", 6, "--jobs", 2, "--json")
    told = succeed("batch", stacks, tmp_path / "out", *words).json
    assert (told["done"], told["rows"][0]["psnr"] > 0) == (1, True)
    alone = succeed("fit", stacks / "a.h5", tmp_path / "one.h5", "--degree", 1, "--json").json
    assert told["rows"][0]["psnr"] == pytest.approx(alone["psnr"]["pooled_fitted"], abs=1e-9)
    assert (tmp_path / "out" / "a.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
