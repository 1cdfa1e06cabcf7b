"""Light between folds, as `benchmarks.folds` measures what it does to normals."""

import numpy as np
import pytest

pytest.importorskip("embreex", reason="extra surfaces is not installed")
from benchmarks import folds
from clrelight.sampling import make_pattern
from clrelight.transfer.rays import RayScene


def valley(width=15, length=15):
    """Return two walls that meet in the middle at a right angle."""
    return np.tile(np.abs(np.arange(width) - width // 2), (length, 1)).astype(np.float64)


def test_walls_see_each_other_as_solid_angles_say():
    """Of two planes at a right angle, at t from the edge: ``(1 - t / sqrt(t^2 + w^2)) / 2``, the other one w wide."""
    scene = RayScene(folds.relief(valley(31, 61)))
    seen_hw = np.asarray(folds.gather(scene).sum(axis=1)).reshape(61, 31)
    assert seen_hw[30, 13] == pytest.approx(0.5 * (1.0 - 2.0 / np.hypot(2.0, 15.0)), abs=0.04)
    flat = RayScene(folds.relief(np.zeros((9, 9))))
    assert folds.gather(flat).sum() == 0.0


def test_normals_get_flatter_by_light_between_folds(device):
    _, rows = folds.fold_table(valley(), make_pattern("uniform", 24), (0.0, 0.8))
    clean, lit = ([float(each) for each in row] for row in rows)
    assert clean[2] < 0.1
    assert lit[2] > clean[2] + 1.0
    assert lit[3] < clean[3] - 0.02
