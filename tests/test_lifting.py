import numpy as np
import pytest
from reference.wavelet import analyse_plane

from clrelight.codec.transforms.lifting import (
    dequantise_map,
    empty_planes,
    forward_transform,
    inverse_transform,
    list_subbands,
)
from tests.styles import both_styles


def random_maps(shape, seed=0):
    return np.random.default_rng(seed).standard_normal(shape).astype(np.float32)


@both_styles
@pytest.mark.parametrize(
    ("height", "width"), [(1, 1), (1, 2), (1, 17), (2, 1), (2, 3), (7, 8), (8, 9), (15, 16), (17, 31), (33, 40)]
)
@pytest.mark.parametrize("channels", [1, 3])
def test_transform_is_convolution_with_the_filters(device, height, width, channels):
    coeffs = random_maps((2, height, width, channels))
    scale = np.array([1.0, 4.0], np.float32)
    planes = device.download(forward_transform(coeffs, scale, 3, device))[:, :, :width]
    expected = [analyse_plane(scale[k] * coeffs[k, :, :, c], 3) for k in range(2) for c in range(channels)]
    assert np.abs(planes - np.array(expected)).max() <= 48 * np.finfo(np.float32).eps * np.abs(expected).max()


@pytest.mark.parametrize("height", range(1, 41))
def test_reconstruction_at_every_size(device, height):
    one = np.ones(4, np.float32)
    for width in range(1, 41):
        coeffs = random_maps((4, height, width, 3), seed=width)
        planes = forward_transform(coeffs, one, 3, device)
        back = inverse_transform(planes, coeffs.shape, one, 3, device)
        assert np.abs(back - coeffs).max() <= 1e-6 * np.abs(coeffs).max(), (height, width)


def test_transform_is_near_orthonormal(device):
    coeffs = random_maps((1, 256, 256, 1))
    planes = device.download(forward_transform(coeffs, np.ones(1, np.float32), 3, device))[0]
    energies = [np.mean(planes[band.rows, band.columns] ** 2) for band in list_subbands(256, 256, 3)]
    # White noise of variance 1: an orthonormal transform would keep 1 in every subband.
    assert min(energies) > 0.85
    assert max(energies) < 1.25


def test_subbands_tile_the_plane():
    for height, width in [(1, 1), (1, 40), (5, 3), (37, 64), (40, 40)]:
        covered = np.zeros((height, width), int)
        for band in list_subbands(height, width, 3):
            covered[band.rows, band.columns] += 1
        assert (covered == 1).all()
    assert [band.name for band in list_subbands(40, 40, 3)] == ["LL", *["HL", "LH", "HH"] * 3]
    assert len(list_subbands(1, 1, 3)) == 1


@both_styles
def test_dequantiser(device):
    """Of bodies of before."""
    shape = (2, 9, 11, 3)
    index = np.random.default_rng(0).integers(-9, 10, (3, 9, 11), dtype=np.int32)
    step = 0.25
    rebuilt = empty_planes(shape, device)
    dequantise_map(rebuilt, 1, index, step, (0.125, 0.0625), device)
    bias = np.where(np.abs(index) == 1, 0.125, 0.0625)
    expected = np.sign(index) * np.maximum(np.abs(index) - bias, 0.0) * step
    np.testing.assert_allclose(device.download(rebuilt)[3:6, :, :11], expected, rtol=1e-6, atol=0.0)
