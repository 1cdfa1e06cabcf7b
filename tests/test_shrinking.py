"""Photographs averaged while they are read, against matrices of areas in float64."""

from dataclasses import replace

import numpy as np
import pytest

import clrelight as cr
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.ingest import ingest_folder
from clrelight.ingest.shrinking import Edges, plan_shrink
from clrelight.sampling import make_pattern
from tests.commands import call, contents, succeed
from tests.reference.psnr import decode, encode

LIGHTS = 6
RNG = np.random.default_rng(23)


def areas(size, count, factor=None):
    """Return (count, size): how much of each pixel before lies in each pixel after, sums 1."""
    ends = np.arange(count + 1) * (size / count) if factor is None else np.minimum(np.arange(count + 1) * factor, size)
    at = np.arange(size)
    shared = np.clip(np.minimum(ends[1:, None], at + 1) - np.maximum(ends[:-1, None], at), 0, None)
    return shared / shared.sum(axis=1, keepdims=True)


def reference(codes, rows, columns, transfer, peak):
    """Return the averaged codes, float64, not rounded."""
    values = np.float64(codes) / peak
    radiance = decode(values) if transfer == "srgb" else values
    small = np.einsum("ah,bw,ihwc->iabc", rows, columns, radiance)
    return peak * (encode(small) if transfer == "srgb" else small)


def codes(dtype, height, width, channel=3):
    noise = RNG.random((LIGHTS, height, width, channel)) ** 3
    return np.rint(noise * np.iinfo(dtype).max).astype(dtype) if np.dtype(dtype).kind == "u" else noise.astype(dtype)


def read_stack(path):
    with cr.open_stack(path) as stack:
        return replace(stack, images_ihwc=stack.images_ihwc[...])


def make_folder(place, images, ending):
    place.mkdir()
    lines = [str(len(images))]
    for i, (image, direction) in enumerate(zip(images, make_pattern("uniform", len(images)), strict=True)):
        write_image(place / f"{i}{ending}", image)
        lines.append(f"{i}{ending} " + " ".join(map(repr, map(float, direction))))
    (place / "dome.lp").write_text("\n".join(lines))
    return place


@pytest.mark.parametrize(
    ("dtype", "ending", "transfer"),
    [
        (np.uint8, ".png", "srgb"),
        (np.uint8, ".png", "linear"),
        (np.uint16, ".tif", "srgb"),
        (np.float32, ".exr", "linear"),
        (np.float16, ".exr", "linear"),
        (np.float32, ".exr", "srgb"),
    ],
)
@pytest.mark.parametrize("size", [("--downscale", 2), ("--downscale", 3), ("--downscale", 5), ("--max-side", 17)])
def test_each_pixel_is_the_mean_radiance_of_its_area(tmp_path, dtype, ending, transfer, size):
    images = codes(dtype, 23, 38, 1 if ending == ".tif" else 3)
    folder = make_folder(tmp_path / "p", images, ending)
    ended = call("ingest", folder, tmp_path / "s.h5", "--transfer", transfer, *size)
    assert ended.code == 0
    shape = {2: (12, 19), 3: (8, 13), 5: (5, 8), 17: (10, 17)}[size[1]]
    factor = size[1] if size[0] == "--downscale" else None
    assert f"averaged from 38×23 to {shape[1]}×{shape[0]} pixels" in ended.err
    peak = float(np.iinfo(dtype).max) if np.dtype(dtype).kind == "u" else 1.0
    expected = reference(images, areas(23, shape[0], factor), areas(38, shape[1], factor), transfer, peak)
    found = read_stack(tmp_path / "s.h5").images_ihwc
    assert found.dtype == dtype
    if dtype in (np.uint8, np.uint16):
        # Where the mean lies in the middle of two codes, either is right.
        assert np.all(np.abs(found - expected) <= 0.5 + 1e-9)
    else:
        rounding = np.finfo(dtype).eps / 2
        np.testing.assert_allclose(np.float64(found), expected, rtol=rounding * (1 + 1e-9), atol=6e-8 * rounding)


def test_black_and_white_stay_and_grey_is_not_the_mean_of_codes(tmp_path):
    images = np.zeros((LIGHTS, 4, 4, 3), np.uint8)
    images[:, :, 1::2] = 255
    images[:, :2] = 255
    cr.ingest(make_folder(tmp_path / "p", images, ".png"), tmp_path / "s.h5", transfer="srgb", downscale=2)
    found = read_stack(tmp_path / "s.h5").images_ihwc
    assert found[0, :, :, 0].tolist() == [[255, 255], [188, 188]]


@pytest.mark.parametrize("memory", [3000, 12000, 1 << 30])
def test_bands_and_memory_change_nothing(tmp_path, memory):
    images = codes(np.uint8, 61, 40)
    folder = make_folder(tmp_path / "p", images, ".png")
    for name, options in (("a", {"downscale": 3}), ("b", {"max_side": 19})):
        whole = cr.ingest(folder, transfer="srgb", **options).images_ihwc
        ingest_folder(folder, tmp_path / f"{name}.h5", transfer="srgb", memory_bytes=memory, **options)
        np.testing.assert_array_equal(read_stack(tmp_path / f"{name}.h5").images_ihwc, whole)


def test_masks_crops_and_intensities(tmp_path):
    images = codes(np.uint8, 20, 24)
    folder = make_folder(tmp_path / "p", images, ".png")
    mask = np.zeros((20, 24), np.uint8)
    mask[3:14, 2:21] = 255
    write_image(tmp_path / "m.png", mask)
    part = (1, 2, 22, 17)
    cr.ingest(folder, tmp_path / "s.h5", mask=tmp_path / "m.png", crop=part, downscale=4)
    stack = read_stack(tmp_path / "s.h5")
    rows, columns = areas(17, 5, 4), areas(22, 6, 4)
    cropped = np.s_[2:19, 1:23]
    np.testing.assert_array_equal(stack.mask_hw, rows @ (mask[cropped] > 0) @ columns.T >= 0.5)
    expected = reference(images[(slice(None), *cropped)], rows, columns, "linear", 255.0)
    assert np.all(np.abs(stack.images_ihwc - expected) <= 0.5 + 1e-9)


def test_pack_reads_them_smaller_too(tmp_path):
    folder = make_folder(tmp_path / "p", codes(np.uint8, 33, 48), ".png")
    asked = ("--method", "cls", "--degree", 1, "--rate", 2, "--measure", "none")
    told = call("pack", folder, tmp_path / "a.h5", *asked, "--max-side", 24, "--json").json
    assert told["image_shape"] == [17, 24, 3]
    assert any("averaged from 48×33 to 24×17" in note for note in told["notes"])
    call("ingest", folder, tmp_path / "s.h5", "--max-side", 24)
    succeed("pack", tmp_path / "s.h5", tmp_path / "b.h5", *asked, "--json")
    a, b = (cr.read_encoded(tmp_path / name)[0].to_bytes() for name in ("a.h5", "b.h5"))
    assert a == b


def test_images_that_are_small_enough_stay(tmp_path):
    images = codes(np.uint8, 9, 12)
    ended = call("ingest", make_folder(tmp_path / "p", images, ".png"), tmp_path / "s.h5", "--max-side", 12)
    assert ended.code == 0
    assert "images have 12×9 pixels already, none on the longer side above 12" in ended.err
    np.testing.assert_array_equal(read_stack(tmp_path / "s.h5").images_ihwc, images)


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--downscale", 2, "--max-side", 9), "give one of --downscale and --max-side"),
        (("--downscale", 1), "1 is not in the range 2<=x"),
        (("--max-side", 0), "0 is not in the range 1<=x"),
        (("--downscale", 40, "--mask", "m.png"), "leaves no pixel of the smaller images half covered"),
    ],
)
def test_what_is_refused(tmp_path, options, why):
    folder = make_folder(tmp_path / "p", codes(np.uint8, 9, 12), ".png")
    mask = np.zeros((9, 12), np.uint8)
    mask[0, 0] = 255
    write_image(tmp_path / "m.png", mask)
    before = contents(tmp_path)
    options = [tmp_path / each if each == "m.png" else each for each in options]
    ended = call("ingest", folder, tmp_path / "s.h5", *options)
    assert ended.code == 2
    assert why in ended.err
    assert contents(tmp_path) == before


def test_stacks_are_not_made_smaller(tmp_path):
    cr.ingest(make_folder(tmp_path / "p", codes(np.uint8, 9, 12), ".png"), tmp_path / "s.h5")
    ended = call("pack", tmp_path / "s.h5", tmp_path / "o.h5", "--downscale", 2)
    assert (ended.code, ended.err) == (2, "clrelight: downscale: for a folder of photographs, not for a stack\n")


def test_every_size_of_a_side_adds_up():
    for size in (1, 2, 7, 101, 4000):
        for count in {1, min(2, size), (size + 1) // 2, max(size - 1, 1), size}:
            edges = Edges(size, count)
            assert edges.lengths.sum() == pytest.approx(size)
            np.testing.assert_allclose(edges.sum_over(np.ones(size)), edges.lengths, atol=1e-9)
            shares = np.zeros(size)
            for number in range(count):
                first, end = edges.rows_of(number)
                shares[first:end] += edges.share_of(number, first, end)
            np.testing.assert_allclose(shares, 1, atol=1e-9)
    with pytest.raises(InputError, match="--max-side must be a whole number"):
        plan_shrink(9, 9, None, 2.5)
