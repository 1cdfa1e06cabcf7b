"""Parts of photographs, the planes that are made of them, and the curve that bends values on the way."""

import tempfile

import numpy as np
import pytest

from clrelight.codec.streams import ArraySource
from clrelight.codec.transforms.code_values import bent, code_values_of
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.workspace import BoundedWorkspace, Workspace
from clrelight.conventions import linear_to_srgb, srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.fit import prepare_fit
from clrelight.fit.run import collect_fit
from clrelight.jobs import bands as bands_module
from clrelight.jobs.bands import bands_of
from clrelight.jobs.fitted_source import fitted_source
from clrelight.sampling import make_pattern
from clrelight.store import open_stack, write_stack
from clrelight.store.scratch_images import ScratchImages
from tests.stacks import make_samples
from tests.styles import both_styles, every_width

SHAPE = (13, 37, 3)
SPECIAL = [0.0, np.inf, np.nan, 1.0, 3e38, 1.13e16, 1.2e16, 0.04045, 0.0031308, 1e-40]


def bendable():
    values = np.concatenate([np.linspace(0, 1.2, 10001), 10.0 ** np.linspace(-30, 38, 3001), SPECIAL])
    return np.concatenate([values, -values]).astype(np.float32)


@every_width
@pytest.mark.parametrize("decode", [False, True])
def test_the_curve_bends_values_of_any_size(device, decode):
    values = bendable()
    with np.errstate(over="ignore", invalid="ignore"):
        curve = srgb_to_linear if decode else linear_to_srgb
        expected = np.copysign(curve(np.abs(values.astype(np.float64))), values)
        rounded = expected.astype(np.float32)
    found = bent(values, device, decode=decode)
    np.testing.assert_array_equal(np.isnan(found), np.isnan(rounded))
    np.testing.assert_array_equal(np.isinf(found), np.isinf(rounded))
    np.testing.assert_array_equal(np.signbit(found), np.signbit(values))
    finite = np.isfinite(rounded) & (np.abs(expected) > 1e-36)
    error = np.abs(found[finite] - expected[finite])
    assert np.all(error < 5e-7 * np.abs(expected[finite]) + 2e-8)


def make_images(n_light=20, dtype=np.uint8, seed=0):
    return np.rint(255 * make_samples(make_pattern("uniform", n_light), SHAPE, seed)).astype(dtype)


@pytest.mark.parametrize("kind", ["memory", "file", "scratch", "scratch in memory", "subset"])
@pytest.mark.parametrize("band_bytes", [1, 20 * 37 * 3 * 4, 1 << 30])
def test_bands_give_parts(tmp_path, monkeypatch, kind, band_bytes):
    monkeypatch.setattr(bands_module, "_BAND_BYTES", band_bytes)
    images, directions = make_images(), make_pattern("uniform", 20)
    stack = LightStack(images, directions, 255.0)
    expected = images
    if kind.startswith("scratch"):
        held = ScratchImages(tmp_path, images.shape, images.dtype, in_memory=kind != "scratch")
        for light, image in enumerate(images):
            held.write_rows(light, 0, image[:5])
            held.write_part(light, 5, 0, image[5:, :20])
            held.write_part(light, 5, 20, image[5:, 20:])
        stack = LightStack(held, directions, 255.0)
    write_stack(tmp_path / "s.h5", stack)
    with open_stack(tmp_path / "s.h5") as stored:
        if kind in ("file", "subset"):
            stack = stored
        if kind == "subset":
            stack, expected = stored.select(np.array([1, 4, 5, 19])), images[[1, 4, 5, 19]]
        with bands_of(stack) as bands:
            for rows, columns in [((0, 1), (0, 37)), ((3, 12), (5, 6)), ((0, 13), (0, 37)), ((12, 13), (30, 37))]:
                part = bands.part(rows, columns)
                np.testing.assert_array_equal(part, expected[:, slice(*rows), slice(*columns)])
                part[...] = 0  # a copy
                np.testing.assert_array_equal(bands.part(rows, columns), expected[:, slice(*rows), slice(*columns)])


def test_rows_that_were_lent_last_stay_as_they_are():
    """A device may still read them while the next ones come, read ahead or not."""
    images = make_images()
    stack = LightStack(images, make_pattern("uniform", 20), 255.0)
    every = (0, 37)
    with bands_of(stack) as bands:
        last, of = bands.part((0, 2), every), (0, 2)
        for rows in [(2, 4), (4, 5), (0, 3), (3, 6), (6, 7), (9, 11), (1, 2), (2, 3), (3, 5), (5, 13)]:
            following = bands.part(rows, every)
            if bands._ahead is not None:
                bands._ahead[1].result()  # whatever is read ahead is there by now
            np.testing.assert_array_equal(last, images[:, slice(*of)])
            last, of = following, rows
            np.testing.assert_array_equal(last, images[:, slice(*of)])


def test_scratch_images_are_indexed_as_arrays():
    images = make_images(6)
    with tempfile.TemporaryDirectory() as folder:
        held = ScratchImages(folder, images.shape, images.dtype)
        for light, image in enumerate(images):
            held.write_rows(light, 0, image)
        for key in [np.s_[:], np.s_[2], np.s_[1:4, 3:9], np.s_[:, 5, ::2], np.s_[[0, 5], :, 7:9, 1], np.s_[..., 2]]:
            np.testing.assert_array_equal(held[key], images[key])
        with pytest.raises(TypeError, match="expected uint8 rows"):
            held.write_rows(0, 0, images[0].astype(np.float32))
        with pytest.raises(IndexError):
            held[9]
        held.close()


@both_styles
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("coded", ["linear", "srgb"])
@pytest.mark.parametrize(
    ("method", "dtype"), [("spline", np.uint8), ("uls", np.uint16), ("cls", np.uint8), ("uls", np.float32)]
)
def test_planes_are_those_of_coefficients(device, transfer, coded, method, dtype):
    mask = np.arange(13 * 37).reshape(13, 37) % 5 != 2
    images = make_images(dtype=np.uint8).astype(dtype)
    stack = LightStack(images, make_pattern("uniform", 20), 255.0, transfer, mask_hw=mask)
    prepared = prepare_fit(stack, method, 3, device=device)
    coeffs = np.ascontiguousarray(collect_fit(prepared).coeffs_khwc)
    expected = code_values_of(coeffs, device) if coded == "srgb" else coeffs
    operator = np.random.default_rng(0).standard_normal((5, 16 * 3))
    offset = np.array([0.5, 0.0, -1.0, 2.0, 0.25])
    wanted = np.einsum("jkc,khwc->jhw", operator.reshape(5, 16, 3), expected.astype(np.float64)) - offset[:, None, None]
    with fitted_source(prepared, Workspace()) as source:
        assert (source.linear is not None) == (method != "cls" and np.issubdtype(dtype, np.integer))
        pixels = Pixels(source, coded)
        np.testing.assert_allclose(pixels.coefficients((2, 9), (3, 31)), expected[:, 2:9, 3:31], atol=2e-4)
        for lent in (False, True):
            made = device.download(pixels.planes((2, 9), (3, 31), (operator, offset), lent=lent))
            scale = np.abs(wanted).max()
            np.testing.assert_allclose(made[:, :, :28], wanted[:, 2:9, 3:31], atol=2e-5 * scale)


def test_one_program_is_for_any_number_of_coefficients(device):
    stack = LightStack(make_images(), make_pattern("uniform", 20), 255.0)
    programs = []
    for degree in (1, 3):
        with fitted_source(prepare_fit(stack, "spline", degree, device=device), Workspace()) as source:
            operator = np.ones((2, 3 * (degree + 1) ** 2))
            Pixels(source, "linear").planes((0, 2), (0, 5), (operator, np.zeros(2)))
        device.finish()
        programs.append({name for name in device._programs if name[0] == "codec/planes.cl"})
    assert programs[0] == programs[1] != set()


def test_scattered_pixels_keep_to_a_budget(device, monkeypatch):
    """They are fitted some places at a time, with the bits of all at once."""
    stack = LightStack(make_images(), make_pattern("uniform", 20), 255.0)
    prepared = prepare_fit(stack, "spline", 3, device=device)
    places = [(row, slice(row % 4, 37, 4)) for row in range(0, 13, 2)]
    asked = []
    with fitted_source(prepared, Workspace()) as source:
        whole = source.read_scattered(places).copy()
    pixel_bytes = 3 * (2 * 20 + 4 * 16)
    with fitted_source(prepared, BoundedWorkspace(4 * 25 * pixel_bytes)) as source:
        run = source._fit.run
        monkeypatch.setattr(
            source._fit, "run", lambda *given: asked.append(given[2].samples_ihwc.shape[2]) or run(*given)
        )
        np.testing.assert_array_equal(source.read_scattered(places), whole)
    assert len(asked) > 2
    assert max(asked) <= 25
    assert sum(asked) == whole.shape[2] == sum(len(range(*columns.indices(37))) for _, columns in places)


def test_lent_planes_share_memory(device):
    pixels = Pixels(ArraySource(np.ones((4, 8, 8, 1), np.float32), device))
    matrix = np.ones((2, 4)), np.zeros(2)
    first = pixels.planes((0, 8), (0, 8), matrix, lent=True)
    own = pixels.planes((0, 8), (0, 8), matrix)
    second = pixels.planes((0, 8), (0, 8), matrix, lent=True)
    if device.shares_memory:
        assert np.shares_memory(first.host, second.host)
        assert not np.shares_memory(first.host, own.host)
