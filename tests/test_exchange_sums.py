"""Sums of display values on a device, and bytes of them, against float64."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.exchange.shown_sums import LinearSums, ShownSums, code_values, slabs_of
from tests.reference.basis import real_harmonics

SPAN = (-0.02, 4.0)


def encode(values):
    """The sRGB curve, straight on below 0."""
    v = np.maximum(values, 0.0031308)
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * v ** (1 / 2.4) - 0.055)


def made(pixels, channel, transfer, seed=0):
    rng = np.random.default_rng(seed)
    coeffs = (2.0 * rng.standard_normal((9, 1, pixels, channel))).astype(np.float32)
    directions = rng.standard_normal((12, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return cr.CoefficientMap(coeffs, 2, "uls", 1.0, transfer, directions), real_harmonics(directions, 2)


def shown_of(fit, basis_ik):
    """Display values (light, channel, pixel) in float64."""
    radiance = np.einsum("ik,kpc->icp", basis_ik, fit.coeffs_khwc[:, 0].astype(float))
    clipped = np.clip(radiance, *SPAN)
    return encode(clipped) if fit.transfer == "srgb" else clipped


@pytest.mark.parametrize("pixels", [1, 15, 16, 17, 341, 1023, 1031])
@pytest.mark.parametrize(("channel", "transfer"), [(3, "srgb"), (1, "srgb"), (3, "linear")])
def test_sums_are_those_of_float64(device, pixels, channel, transfer):
    fit, basis_ik = made(pixels, channel, transfer)
    expected = shown_of(fit, basis_ik)
    most = encode(4.0) if transfer == "srgb" else 4.0
    assert pixels < 300 or (expected.max() == most and expected.min() < 0.0)
    rng = np.random.default_rng(1)
    coeffs_kcp = np.ascontiguousarray(np.moveaxis(fit.coeffs_khwc[:, 0], 2, 1))
    for columns in (12, 12 * channel):
        solver_td = rng.standard_normal((6, columns))
        sums = ShownSums(fit, basis_ik, solver_td, SPAN, device)
        sums_tq, shown_iq = (device.download(each) for each in sums.solve(coeffs_kcp))
        # A slope of the curve of 12.92, and twelve lights of three channels.
        bound = 12.92 * 9 * 4 * np.finfo(np.float32).eps * np.abs(basis_ik).max() * 4
        np.testing.assert_allclose(shown_iq.reshape(expected.shape), expected, atol=bound)
        given = expected.reshape(columns, -1)
        np.testing.assert_allclose(sums_tq, solver_td @ given, atol=4 * bound * np.abs(solver_td).sum(axis=1).max())


def test_sums_of_coefficients(device):
    fit, _ = made(37, 3, "linear")
    matrix_td = np.random.default_rng(2).standard_normal((6, 27))
    coeffs_kcp = np.ascontiguousarray(np.moveaxis(fit.coeffs_khwc[:, 0], 2, 1))
    found = device.download(LinearSums(matrix_td, device).solve(coeffs_kcp)[0])
    np.testing.assert_allclose(found, matrix_td @ coeffs_kcp.reshape(27, -1).astype(float), atol=1e-4)


@pytest.mark.parametrize(("columns", "group"), [(1, 1), (1023, 3), (1024, 6), (1025, 2)])
def test_bytes_are_the_nearest_and_lie_in_groups(device, columns, group):
    sums_tq = np.random.default_rng(3).uniform(-60, 320, (6, columns)).astype(np.float32)
    offset_t = np.array([0.0, 1.25, -7.5, 100.0, -100.0, 3.0])
    found = code_values(device.upload(sums_tq), offset_t, group, device)
    expected = np.clip(sums_tq.astype(float) + offset_t[:, None], 0, 255)
    grouped = expected.reshape(6 // group, group, columns).transpose(0, 2, 1)
    assert found.dtype == np.uint8
    assert np.abs(found - grouped).max() <= 0.5 + 1e-4


def test_slabs_are_all_pixels_in_order(device):
    fit, basis_ik = made(1031, 3, "srgb")
    tall = cr.CoefficientMap(
        np.repeat(fit.coeffs_khwc, 5, axis=1) + np.arange(5, dtype=np.float32)[None, :, None, None],
        *(2, "uls", 1.0, "srgb", fit.directions_i3),
    )
    sums = ShownSums(tall, basis_ik, np.ones((1, 12)), SPAN, device)
    sums.item_bytes = 1 << 16  # of many lights: 128 pixels a slab
    rows, found = [], []
    for first, end, slabs in slabs_of(tall, sums):
        rows += range(first, end)
        found += list(slabs)
    assert rows == list(range(5))
    assert len(found) > 5
    whole = np.concatenate(found, axis=2)
    np.testing.assert_array_equal(whole, tall.coeffs_khwc.reshape(9, -1, 3).transpose(0, 2, 1))
