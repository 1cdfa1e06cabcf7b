import numpy as np
import pytest
from PIL import Image

from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.masks import read_mask
from tests.commands import call

DISC = np.hypot(*np.mgrid[-20:20, -25:25]) < 15


def test_zero_does_not_count(tmp_path):
    for name, values in (
        ("a.png", DISC * np.uint8(255)),
        ("b.png", DISC * np.uint8(1)),
        ("c.tif", DISC * np.uint16(65535)),
        ("d.exr", DISC * np.float32(0.25)),
        ("e.png", np.dstack([DISC * 0, DISC * 9, DISC * 0]).astype(np.uint8)),
    ):
        write_image(tmp_path / name, values)
        mask_hw, notes = read_mask(tmp_path / name, DISC.shape, 500)
        np.testing.assert_array_equal(mask_hw, DISC)
        assert notes == []


def test_forms_of_other_programs(tmp_path):
    image = Image.fromarray(DISC * np.uint8(255))
    image.convert("1").save(tmp_path / "bits.png")
    palette = Image.fromarray((~DISC).astype(np.uint8), "P")
    palette.putpalette([255, 255, 255, 0, 0, 0])
    palette.save(tmp_path / "palette.png")
    Image.merge("LA", [image, Image.new("L", image.size, 255)]).save(tmp_path / "opaque.png")
    for name in ("bits.png", "palette.png", "opaque.png"):
        mask_hw, notes = read_mask(tmp_path / name, DISC.shape)
        np.testing.assert_array_equal(mask_hw, DISC)
        assert notes == []


@pytest.mark.parametrize("colour", [0, 255, 90])
@pytest.mark.parametrize("mode", ["LA", "RGBA"])
def test_alpha_is_the_mask_where_colours_are_flat(tmp_path, mode, colour):
    bands = [Image.new("L", DISC.shape[::-1], colour)] * (len(mode) - 1)
    Image.merge(mode, [*bands, Image.fromarray(DISC * np.uint8(255))]).save(tmp_path / "a.png")
    mask_hw, notes = read_mask(tmp_path / "a.png", DISC.shape)
    np.testing.assert_array_equal(mask_hw, DISC)
    assert notes == ["mask a.png: its colours are the same throughout, so its alpha says what counts"]


@pytest.mark.parametrize("quality", [40, 60, 95])
def test_jpeg_counts_from_half(tmp_path, quality):
    Image.fromarray(DISC * np.uint8(255)).save(tmp_path / "a.jpg", quality=quality)
    with Image.open(tmp_path / "a.jpg") as file:
        assert np.count_nonzero(np.asarray(file)) > DISC.sum()  # whatever is not zero would be too much
    mask_hw, notes = read_mask(tmp_path / "a.jpg", DISC.shape)
    np.testing.assert_array_equal(mask_hw, DISC)
    assert notes == ["mask a.jpg is of a lossy format: what is at least half as bright as white counts"]


def test_soft_edges_are_mentioned(tmp_path):
    soft = np.clip(300 - 15 * np.hypot(*np.mgrid[-20:20, -25:25]), 0, 255).astype(np.uint8)
    write_image(tmp_path / "a.png", soft)
    mask_hw, notes = read_mask(tmp_path / "a.png", DISC.shape)
    np.testing.assert_array_equal(mask_hw, soft > 0)
    assert notes == ["mask a.png has more than two levels: whatever is not zero counts"]


def test_bad_masks(tmp_path):
    write_image(tmp_path / "a.exr", np.where(DISC, np.nan, 1).astype(np.float32))
    with pytest.raises(InputError, match=r"mask .*a.exr holds NaN"):
        read_mask(tmp_path / "a.exr", DISC.shape)
    with pytest.raises(InputError, match=r"a.exr has 50×40 pixels, but the images 40×50"):
        read_mask(tmp_path / "a.exr", (50, 40))


def test_ingest_says_how_many_pixels_count(tmp_path):
    (tmp_path / "a").mkdir()
    for i in range(2):
        write_image(tmp_path / "a" / f"{i}.png", np.full(DISC.shape, 100 + i, np.uint8))
    (tmp_path / "a" / "light_directions.txt").write_text("0 0 1\n0.6 0 0.8\n")
    write_image(tmp_path / "m.png", DISC * np.uint8(255))
    found = call("ingest", tmp_path / "a", tmp_path / "o.h5", "--mask", tmp_path / "m.png")
    assert f"note: mask m.png keeps {DISC.sum()} of 2000 pixels\n" in found.err
    cropped = call("ingest", tmp_path / "a", tmp_path / "o.h5", "--mask", tmp_path / "m.png", "--crop", "25,20,25,20")
    assert f"keeps {DISC[20:, 25:].sum()} of 500 pixels" in cropped.err
