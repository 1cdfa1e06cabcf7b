"""Coefficients of klt's planes, against sums in float64."""

from types import SimpleNamespace

import numpy as np
import pytest

from clrelight.codec.formats.klt_regions import Held
from clrelight.codec.formats.klt_unmix import Unmixing
from clrelight.codec.views import Region
from tests.styles import both_styles

EPS32 = np.finfo(np.float32).eps


def unmixing(device, operator_kcj):
    head = SimpleNamespace(transfer="linear", basis="sh")
    parsed = SimpleNamespace(head=head, operator_kcj=operator_kcj)
    return Unmixing(parsed, (len(operator_kcj), 0, 0, operator_kcj.shape[1]), device)


@both_styles
@pytest.mark.parametrize("channel", [1, 2, 3, 11])
@pytest.mark.parametrize(("count", "width"), [(1, 1), (7, 255), (29, 257), (64, 31), (300, 13)])
def test_coefficients_are_sums_of_planes(device, channel, count, width):
    rng = np.random.default_rng(count)
    n_coeff, height, level, (top, left) = 4 if count > 7 else 9, 5, count % 3, (2, 3)
    operator = rng.standard_normal((n_coeff, channel, count + 1))
    window = rng.standard_normal((count, height + 4, width + 9)).astype(np.float32)
    region = Region(10, 20, 10 + height, 20 + width, level)
    # Two parts, which lie in windows of their own, make one region.
    parts = [
        Held(Region(10, 20, 12, 20 + width, level), device.hold(window.copy()), top, left),
        Held(Region(12, 20, 10 + height, 20 + width, level), device.hold(window.copy()), top + 2, left),
    ]
    found = unmixing(device, operator).coefficients(iter(parts), region)
    planes = np.ones((count + 1, height, width))
    planes[:count] = window[:, top : top + height, left : left + width] * 0.5**level
    expected = np.einsum("kcj,jyx->kyxc", operator, planes)
    terms = np.einsum("kcj,jyx->kyxc", np.abs(operator), np.abs(planes))
    assert found.shape == expected.shape
    assert (np.abs(found - expected) <= EPS32 * (66 + count / 64) * terms).all()


def test_there_may_be_no_planes_but_the_mean(device):
    operator = np.arange(6.0).reshape(2, 3, 1)
    found = unmixing(device, operator).coefficients(iter([Held(Region(0, 0, 4, 5), None)]), Region(0, 0, 4, 5))
    np.testing.assert_array_equal(found, np.broadcast_to(operator[:, None, None, :, 0], (2, 4, 5, 3)))


@both_styles
@pytest.mark.parametrize("channel", [1, 3])
def test_what_passes_float32_is_its_largest(device, channel):
    planes = np.full((2, 3, 17), 3e38, np.float32)
    planes[1, 1] = -3e38
    operator = np.full((1, channel, 3), 5.0)
    region = Region(0, 0, 3, 17)
    found = unmixing(device, operator).coefficients(iter([Held(region, device.hold(planes))]), region)
    assert np.isfinite(found).all()
    assert (found[0, [0, 2]] == np.finfo(np.float32).max).all()


def test_so_is_a_mean_alone(device):
    region = Region(0, 0, 4, 5)
    found = unmixing(device, np.array([[[1e39], [-1e300]]])).coefficients(iter([Held(region, None)]), region)
    most = np.finfo(np.float32).max
    np.testing.assert_array_equal(found, np.broadcast_to([most, -most], (1, 4, 5, 2)))
