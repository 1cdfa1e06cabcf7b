"""Wavelet coefficients made strip by strip are those of the whole image, to the last bit."""

import numpy as np
import pytest

from clrelight.codec.entropy.units import LEVELS, MARGIN, Window, list_tiles
from clrelight.codec.streams import ArraySource
from clrelight.codec.transforms.lifting import list_subbands, transform_planes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.strips import Strips
from clrelight.device import open_device
from tests.styles import both_styles


def pixels_of(height, width, device, seed=0):
    coeffs = np.random.default_rng(seed).standard_normal((4, height, width, 1)).astype(np.float32)
    return Pixels(ArraySource(coeffs, device))


def make_planes(count=3):
    rng = np.random.default_rng(1)
    return rng.standard_normal((count, 4)), rng.standard_normal(count)


def bands_of(values, window, level_rows):
    """Return each subband's rows of a window by (name, level)."""
    found = list_subbands(*window.shape, LEVELS)
    return {(band.name, band.level): values[:, band.rows, band.columns][:, : level_rows(band.level)] for band in found}


# 1536 rows are whole precincts; 1087 is a prime; of 1537 and 1025 the last strip has one row.
@pytest.mark.parametrize("height", [1025, 1087, 1536, 1537, 1670])
@pytest.mark.parametrize("width", [33, 71])
def test_strips_have_the_bits_of_the_whole_image(device, height, width):
    pixels, planes = pixels_of(height, width, device), make_planes()
    whole = pixels.planes((0, height), (0, width), planes)
    transform_planes("analyse", whole, width, LEVELS, device)
    expected = bands_of(device.download(whole), Window(0, 0, height, width), lambda level: height)
    tiles = list_tiles(height, width, 3, 4 * 3 * width * (512 + 2 * MARGIN))
    assert len(tiles) == -(-height // 512)
    strips = Strips.of(pixels, planes, tiles)
    for tile in tiles:
        values, window = device.download(strips.take(tile)), strips.window_of(tile)

        def rows_of(level, tile=tile):
            return -(-tile.bottom >> level) - (tile.top >> level)

        for (name, level), band in bands_of(values, window, rows_of).items():
            of_all = expected[name, level][:, tile.top >> level :][:, : band.shape[1]]
            assert np.array_equal(band[:, : of_all.shape[1]], of_all), (tile.top, name, level)
            band[...] = np.nan  # indices take the place of values


def test_no_strips_where_tiles_are_narrower_than_the_image(device):
    pixels, planes = pixels_of(1100, 1100, device), make_planes()
    tiles = list_tiles(1100, 1100, 3, 1 << 22)
    assert min(tile.window.right - tile.window.left for tile in tiles) < 1100
    assert Strips.of(pixels, planes, tiles) is None


def test_a_gpu_s_kernels_make_whole_windows():
    device = open_device(style="gpu")
    tiles = list_tiles(1100, 70, 3, 4 * 3 * 70 * 800)
    assert Strips.of(pixels_of(1100, 70, device), make_planes(), tiles) is None


@both_styles
@pytest.mark.parametrize("channel", [1, 2, 3])
@pytest.mark.parametrize(("rows", "columns"), [((0, 1), (0, 1)), ((3, 20), (5, 38)), ((0, 23), (0, 41))])
def test_planes_of_a_part_are_sums_of_its_coefficients(device, channel, rows, columns):
    """Whether kernels read coefficients where they lie, or copies of a part."""
    rng = np.random.default_rng(channel)
    coeffs = rng.standard_normal((4, 23, 41, channel)).astype(np.float32)
    planes = rng.standard_normal((5, 4 * channel)), rng.standard_normal(5)
    source = ArraySource(coeffs, device)
    made = device.download(Pixels(source).planes(rows, columns, planes))[:, :, : columns[1] - columns[0]].copy()
    part = coeffs[:, slice(*rows), slice(*columns)].astype(np.float64)
    of_pixels = part.transpose(1, 2, 0, 3).reshape(*part.shape[1:3], -1)
    expected = np.einsum("yxq,jq->jyx", of_pixels, planes[0]) - planes[1][:, None, None]
    terms = np.einsum("yxq,jq->jyx", abs(of_pixels), abs(planes[0])) + abs(planes[1])[:, None, None]
    assert (abs(made - expected) <= 4 * channel * np.finfo(np.float32).eps * terms).all()
    source.in_memory = None
    copied = device.download(Pixels(source).planes(rows, columns, planes))[:, :, : columns[1] - columns[0]]
    assert np.array_equal(made, copied)
