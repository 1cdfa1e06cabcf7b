"""Large images are measured in windows: where they lie, what is reckoned from them, and whether it is right."""

import math

import numpy as np
import pytest

from clrelight.cli.trade import trade as trade_command
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.experiment.axes import Axes
from clrelight.experiment.excerpt import WINDOW, excerpt_of
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests.commands import call, succeed
from tests.test_trade import SMALL, trial

LIGHTS = make_pattern("uniform", 24)


def numbered(height, width, mask=None):
    """Return a stack whose pixels hold their row and column."""
    rows, columns = np.indices((height, width))
    images = np.stack([rows, columns], axis=-1).astype(np.uint16)
    return LightStack(np.broadcast_to(images, (2, height, width, 2)).copy(), LIGHTS[:2], 65535.0, mask_hw=mask)


@pytest.mark.parametrize(
    ("height", "width", "pixels"), [(700, 1100, 1e5), (40, 9000, 4e4), (3000, 129, 1e5), (300, 300, 1)]
)
def test_windows_are_whole_spread_and_apart(height, width, pixels):
    stack = numbered(height, width)
    found, scale = excerpt_of(stack, pixels)
    sides = min(WINDOW, height), min(WINDOW, width)
    images = found.images_ihwc[0]
    assert scale == pytest.approx(height * width / (images.shape[0] * images.shape[1]))
    assert 0.5 * pixels <= images.shape[0] * images.shape[1] <= max(1.5 * pixels, sides[0] * sides[1])
    seen = np.zeros((height, width), int)
    for top in range(0, images.shape[0], sides[0]):
        for left in range(0, images.shape[1], sides[1]):
            window = images[top : top + sides[0], left : left + sides[1]]
            first = window[0, 0]
            np.testing.assert_array_equal(window, first + np.moveaxis(np.indices(sides), 0, -1))
            seen[window[..., 0], window[..., 1]] += 1
    assert seen.max() == 1
    for axis, length in ((0, height), (1, width)):  # no more is left out before, between and behind than anywhere else
        used = np.flatnonzero(seen.any(axis=1 - axis))
        gaps = np.diff(np.concatenate([[-1], used, [length]])) - 1
        gaps = [gaps[0], *gaps[1:-1][gaps[1:-1] > 0], gaps[-1]]
        assert max(gaps) - min(gaps) <= 1 or len(gaps) == 2


def test_small_images_and_masks():
    stack = numbered(20, 30)
    assert excerpt_of(stack, 600) == (stack, 1.0)
    assert excerpt_of(numbered(999, 999), math.inf)[1] == 1.0
    mask = np.zeros((1000, 1000), bool)
    mask[:, 500:] = True
    found, _ = excerpt_of(numbered(1000, 1000, mask), 1e5)
    np.testing.assert_array_equal(found.mask_hw, found.images_ihwc[0, :, :, 1] >= 500)
    with pytest.raises(InputError, match="the mask leaves no pixel in the windows that are measured"):
        excerpt_of(numbered(1000, 1000, np.eye(1000, dtype=bool) & (np.arange(1000) == 1)), 1e4)
    with pytest.raises(InputError, match="megapixels must be above 0, got 0"):
        Axes(megapixels=0.0)


def test_the_command_measures_as_much_as_the_axes_say():
    default = next(each.default for each in trade_command.params if each.name == "megapixels")
    assert default == Axes().megapixels == 0.1


def test_seconds_and_bytes_of_the_whole():
    part = trial(3.0, 100, 20.0)
    part.row["seconds_encode"], part.row["seconds_decode"] = 2.0, 1.0
    whole = type(part)(part.model, part.setting, part.row, 10.0, 1.0)
    assert (part.seconds, part.size, part.stages) == (6.0, 100, (3.0, 2.0, 1.0))
    assert (whole.seconds, whole.size, whole.stages) == (51.0, 1000, (21.0, 20.0, 10.0))


def test_what_is_reckoned_is_what_the_whole_has(tmp_path):
    rng = np.random.default_rng(0)
    y, x = np.mgrid[0:384, 0:512] / 20.0  # many waves, so that windows see what the image has
    slope = np.stack([0.6 * np.cos(3 * x + y), 0.6 * np.sin(2 * y - x), np.ones_like(x)])
    shade = np.maximum(np.einsum("ia,ahw->ihw", LIGHTS, slope / np.linalg.norm(slope, axis=0)), 0.0)
    images = np.rint(230 * shade + 10 * rng.random(shade.shape)).astype(np.uint8)[..., None]
    write_stack(tmp_path / "s.h5", LightStack(images, LIGHTS, 255.0, name="s"))
    words = ("trade", tmp_path / "s.h5", *SMALL, "--methods", "cls", "--iterations", 4, "--json")
    part = succeed(*words, "--out", tmp_path / "part.h5", "--megapixels", 0.05).json
    whole = succeed(*words, "--out", tmp_path / "whole.h5", "--megapixels", "inf").json
    assert part["measured"].startswith("0.049 of 0.197 megapixels, in windows")
    assert "measured" not in whole
    assert part["choice"]["label"] == whole["choice"]["label"]
    of_whole = {row["label"]: row for row in whole["trials"]}
    for row in part["trials"]:
        other = of_whole[row["label"]]
        assert row["psnr_pooled_holdout"] == pytest.approx(other["psnr_pooled_holdout"], abs=0.5)
        assert row["bytes"] == pytest.approx(other["bytes"], rel=0.02)
        assert row["bytes"] == round(row["encoded_bytes"] * 4)
    ended = call(*words, "--out", tmp_path / "part.h5", "--megapixels", 0.1)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "holds rows of 256×192 pixels of 's', and these are 384×256: other --megapixels, or another" in ended.err
    ended = call(*words, "--out", tmp_path / "part.h5")  # 0.1 is the default
    assert "other --megapixels" in ended.err
