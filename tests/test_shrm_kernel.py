"""The kernel that integrates lobes over angles, against sums in float64."""

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.radial import Lambert, Phong
from clrelight.errors import InputError
from clrelight.shrm.angular import integrate_directions, integrate_on_device, lobe_angle
from tests.styles import both_styles, every_width

EPS32 = 2.0**-23
LOBES = [Lambert(), Phong(0), Phong(40), Microfacet(0.1), Microfacet(0.5), KajiyaKay(32)]


def unit(count, seed):
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def compare(device, brdf, points, texels, channels=3, epsilon=0.0):
    light, weighted = unit(texels, 1), np.random.default_rng(2).random((texels, channels))
    central, view = unit(points, 3), unit(points, 4)
    if epsilon:  # float32 may put what lies on the edge on its other side
        cosine = central @ light.T
        on_edge = np.abs(cosine - np.cos(lobe_angle(brdf, epsilon))) < 1e-6
        light = light[~on_edge.any(axis=0)]
        weighted = weighted[: len(light)]
    got = integrate_on_device(device, light, weighted, brdf, central, view, epsilon=epsilon)
    expected = integrate_directions(light, weighted, brdf, central, view, epsilon=epsilon)
    number = getattr(brdf, "exponent", None) or 1 / getattr(brdf, "sigma", 1.0)
    bound = EPS32 * (texels + 8 * (1 + number**2)) * np.abs(expected).max()
    np.testing.assert_allclose(got, expected, atol=bound)
    assert got.shape == (points, channels)


@both_styles
@pytest.mark.parametrize("brdf", LOBES, ids=lambda brdf: f"{brdf.id}-{brdf.to_config().get('exponent', '')}")
def test_every_lobe(device, brdf):
    compare(device, brdf, 37, 1500)
    compare(device, brdf, 5, 900, epsilon=0.05)


@every_width
@pytest.mark.parametrize("points", [1, 15, 16, 17, 2053])
def test_sizes(device, points):
    compare(device, Phong(7.5), points, 31, 1)


@pytest.mark.parametrize("texels", [1, 2047, 2048, 2049])
def test_runs(device, texels):
    compare(device, Microfacet(0.3), 3, texels)


def test_others_are_for_the_host(device):
    with pytest.raises(InputError, match="take the host"):
        integrate_on_device(device, unit(3, 0), np.ones((3, 1)), SKIN, unit(2, 1), unit(2, 2))
