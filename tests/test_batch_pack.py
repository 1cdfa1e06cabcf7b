"""`pack` in tiles: the bytes of one process, whatever ends on the way."""

import numpy as np
import pytest

from clrelight.batch import make_tasks, read_listing
from clrelight.batch.tiles import run_tiles
from clrelight.codec.formats import klt_tiles
from clrelight.dataset import LightStack
from clrelight.jobs.pack import pack
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests.batches import strays_in
from tests.test_batch import Here

HEIGHT, WIDTH, LIGHTS = 1100, 1300, 8
OPTIONS = {"method": "spline", "degree": 1, "memory": "24MiB", "measure": "sample"}


def photographs(height=HEIGHT, width=WIDTH, n_light=LIGHTS):
    """8-bit photographs of one channel: bumps, with noise."""
    y, x = np.mgrid[0 : 1 : height * 1j, 0 : 1 : width * 1j]
    normals = np.stack([np.sin(25 * x * y), np.cos(17 * y), np.full_like(x, 1.5)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    shading = np.maximum(np.einsum("id,hwd->ihw", make_pattern("uniform", n_light), normals), 0.0)
    noise = 0.02 * np.random.default_rng(5).standard_normal((n_light, height, width))
    return np.rint(255 * np.clip(shading + noise, 0, 1)).astype(np.uint8)[..., None]


@pytest.fixture(scope="module")
def stacks(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packs") / "in"
    folder.mkdir()
    write_stack(folder / "a.h5", LightStack(photographs(), make_pattern("uniform", LIGHTS), 255.0, name="s"))
    return folder


@pytest.fixture(scope="module", autouse=True)
def small_parts():
    """Parts of one precinct, so that a small image has several."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(klt_tiles, "PART_PIXELS", 1)
        yield


@pytest.fixture(scope="module")
def alone(stacks, tmp_path_factory):
    """What one process makes."""
    out, report = tmp_path_factory.mktemp("alone") / "a.h5", Report()
    pack(stacks / "a.h5", out, report=report, **OPTIONS)
    return out.read_bytes(), report


def pack_in_tiles(stacks, out, engine, report=None, changes=None, **given):
    options = {**OPTIONS, **(changes or {})}
    tasks = make_tasks(read_listing(stacks, "pack", out=out), out, job="pack", options=options)
    return run_tiles(tasks, out, engine=engine, report=report or Report(), **given)


def test_tiles_give_the_bytes_of_one_process(stacks, alone, tmp_path):
    engine = Here()
    batch = pack_in_tiles(stacks, tmp_path / "out", engine)
    assert not batch.failed, batch.failed
    assert (tmp_path / "out" / "a.h5").read_bytes() == alone[0]
    (outcome,) = batch.outcomes
    assert dict(outcome.psnr) == alone[1].psnr
    kinds = {name.split("@")[1].rpartition("-")[0] for name in engine.begun if "@" in name}
    assert kinds == {"pack-tile", "pack-try", "pack-measure"}
    assert not (tmp_path / "out" / "a.shards").exists()
    assert strays_in(tmp_path / "out") == []
