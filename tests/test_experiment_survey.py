"""What an experiment reads of a scene before it begins."""

import numpy as np

from clrelight.dataset import LightStack
from clrelight.experiment import scenes
from clrelight.sampling import make_pattern


def test_a_scene_of_many_tiles_is_seen_whole(monkeypatch):
    codes = np.random.default_rng(4).integers(1, 256, (9, 23, 7, 3), np.uint8)
    stack = LightStack(codes, make_pattern("uniform", 9), 255.0)
    whole = scenes.survey_stack(stack)
    monkeypatch.setattr(scenes, "PIECE_BYTES", 9 * 7 * 3 * 4)  # four rows
    parts = scenes.survey_stack(stack)
    assert (parts.light, parts.column) == (whole.light, whole.column)
    np.testing.assert_array_equal(parts.picture_hwc, whole.picture_hwc)
    np.testing.assert_array_equal(whole.picture_hwc, codes[whole.light])
