"""Rotations of channels: the kernels of rotate.cl against NumPy in float64."""

import numpy as np
import pytest

from clrelight.codec.formats.wavelet_planes import launch_rotation, planes_to_maps, scales_of
from clrelight.codec.transforms.channels import angles_of, rotations_of

EPS = float(np.finfo(np.float32).eps)
LARGEST = float(np.finfo(np.float32).max)
SHAPES = [(1, 1, 1, 1), (4, 3, 7, 1), (4, 5, 8, 2), (5, 2, 13, 3), (3, 4, 9, 5)]


def make_case(shape, rotated):
    """Return coefficients, rotations or None, and the planes of all maps but the second."""
    rng = np.random.default_rng(sum(shape))
    n_coeff, channel = shape[0], shape[3]
    rotation_kdc = np.linalg.qr(rng.standard_normal((n_coeff, channel, channel)))[0] if rotated else None
    place_kd = np.full((n_coeff, channel), -1, np.int32)
    present = [k for k in range(n_coeff) if k != 1]
    place_kd[present] = rng.permutation(len(present) * channel).reshape(len(present), channel)
    return rng.standard_normal(shape).astype(np.float32), rotation_kdc, place_kd


@pytest.mark.parametrize("rotated", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_components_there_and_back(device, shape, rotated):
    coeffs_khwc, rotation_kdc, place_kd = make_case(shape, rotated)
    n_coeff, height, width, channel = shape
    pitch = -(-width // 8) * 8
    exponent_k = np.arange(n_coeff) * 7 - 20
    planes = device.empty((int(place_kd.max()) + 1, height, pitch), np.float32)
    launch_rotation(
        "rotate_channels", planes, device.upload(coeffs_khwc), rotation_kdc, scales_of(exponent_k), place_kd, device
    )
    found_jyx = device.download(planes)
    turned_kdc = np.broadcast_to(np.eye(channel), (n_coeff, channel, channel)) if rotation_kdc is None else rotation_kdc
    expected_kdhw = np.einsum("kdc,khwc->kdhw", turned_kdc, coeffs_khwc) * np.exp2(exponent_k)[:, None, None, None]
    for k, d in np.argwhere(place_kd >= 0):
        bound = (channel + 3) * EPS * np.abs(coeffs_khwc[k]).sum(axis=-1).max() * 2.0 ** exponent_k[k]
        np.testing.assert_allclose(found_jyx[place_kd[k, d], :, :width], expected_kdhw[k, d], rtol=0, atol=bound)
        assert (found_jyx[place_kd[k, d], :, width:] == 0).all()
    step_k = np.exp2(-exponent_k.astype(float)) * 1.5
    back_khwc = planes_to_maps(planes, shape, rotation_kdc, step_k, place_kd, device)
    wanted_khwc = np.where(place_kd[:, :1, None, None] >= 0, 1.5 * coeffs_khwc, 0.0)
    np.testing.assert_allclose(back_khwc, wanted_khwc, rtol=0, atol=(2 * channel + 8) * EPS * 4 * channel)


@pytest.mark.parametrize(("exponent", "expected"), [(140, LARGEST), (-185, 0.0), (100, 2.0**100)])
def test_steps_beyond_float32_end_at_its_ends(device, exponent, expected):
    planes = device.upload(np.full((1, 1, 8), 1.0, np.float32))
    found = planes_to_maps(planes, (1, 1, 8, 1), None, np.array([2.0**exponent]), np.zeros((1, 1), np.int32), device)
    np.testing.assert_array_equal(found, np.float32(expected))


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [2, 3, 5])
def test_angles_make_the_rotations_that_they_are_of(channels, dtype):
    rotations = np.linalg.qr(np.random.default_rng(1).standard_normal((20, channels, channels)))[0]
    found = rotations_of(angles_of(rotations, np.dtype(dtype)), channels)
    np.testing.assert_allclose(found @ found.transpose(0, 2, 1), np.eye(channels)[None].repeat(20, 0), atol=1e-12)
    turn = 2.0 * np.pi / (1 << 8 * np.dtype(dtype).itemsize)
    off = 1.0 - np.abs(np.einsum("mdc,mdc->md", found, rotations))
    assert off.max() < (channels * turn) ** 2
