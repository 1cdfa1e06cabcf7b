"""How many orders and samples are needed, beside the figures that are stated of Grace Cathedral."""

import numpy as np
import pytest

from clrelight.brdf.analytic import Microfacet
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.radial import Phong, lobe_factors
from clrelight.errors import InputError
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.lighting.environment import read_environment
from clrelight.lighting.projection import project_environment
from clrelight.shrm.orders import (
    LUMINANCE,
    bilinear_error,
    crossover_exponent,
    minimal_orders,
    phong_degree,
    phong_width,
    reflected_accuracy,
)

FS = (4, 6, 8, 10, 12, 16)


@pytest.fixture(scope="module")
def grace(real_data):
    environment, _ = read_environment(real_data / "probes" / "grace_latlong.exr")
    return environment


@pytest.fixture(scope="module")
def grace_light(grace):
    return project_environment(grace, 60).coeffs_kc


def test_phong_under_grace(grace, grace_light):
    _, weights = grace.geometry()
    energy = float(((grace.radiance_hwc.reshape(-1, 3) @ LUMINANCE) ** 2 * weights).sum())
    found = reflected_accuracy(grace_light, brdf_coefficients(Phong(32), 30, 0), energy)
    stated = (0.7894, 0.9442, 0.9806, 0.9960, 0.9991, 0.99999)
    np.testing.assert_allclose(found.reflected_l[list(FS)], stated, atol=2e-3)
    alone = (0.5325, 0.7759, 0.9167, 0.9762, 0.9948, 0.9999)
    np.testing.assert_allclose(found.brdf_l[list(FS)], alone, atol=2e-3)
    # Estimates are on the safe side, and taking the lesser error is taking the reflectance's: figure 6.
    assert (found.bound_l <= found.reflected_l + 1e-12).all()
    assert (found.least_l[4:] <= found.reflected_l[4:] + 1e-12).all()
    np.testing.assert_allclose(found.least_l[4:], found.brdf_l[4:], atol=1e-12)
    assert (np.diff(found.bound_l[:25]) > 0).all()


def test_bilinear_lookups_under_grace(grace_light):
    """Of a map that holds all but 1e-5 of the reflected energy, F = 17; ten samples a degree are good to 0.13%."""
    degree = 17
    factors = lobe_factors(32, degree)[degrees_of_coefficients(degree)]
    reflected = factors[:, None] * grace_light[: len(factors)]
    found = [bilinear_error(reflected, samples * degree) for samples in (2, 3, 5, 10, 20)]
    np.testing.assert_allclose(found, (0.032, 0.015, 0.0055, 0.0013, 0.0003), rtol=0.2)


def test_estimates_of_a_phong_lobe():
    for s in (16, 64, 256):
        for epsilon in (0.3, 0.1, 0.03):
            shares = brdf_coefficients(Phong(s), 60, 0).shares()[:, 0, 0]
            exact = int(np.argmax(shares >= 1 - epsilon))
            assert abs(exact - phong_degree(s, epsilon)) <= 2
    assert phong_width(8, 0.05) == pytest.approx((1 - 0.05 ** (1 / 9)) / 2)
    assert phong_width(1e6, 0.05) == pytest.approx(-np.log(0.05) / 2e6, rel=1e-4)
    assert crossover_exponent(100) == pytest.approx(464.16, abs=0.01)
    for epsilon in (0.0, 1.0, -1.0):
        with pytest.raises(InputError, match="epsilon"):
            phong_degree(8, epsilon)


def test_bounds_hold_where_the_view_counts():
    light = np.random.default_rng(0).standard_normal((41**2, 3))
    found = reflected_accuracy(light, brdf_coefficients(Microfacet(0.3), 40, 8))
    assert (found.bound_l <= found.reflected_l + 1e-12).all()
    assert found.reflected_l[-1] == 1.0


def test_least_orders_are_least():
    brdf = brdf_coefficients(Microfacet(0.2), 40, 5)
    for epsilon in (0.2, 0.1, 0.03, 0.015):
        degree, order = minimal_orders(brdf, epsilon)
        shares = brdf.shares()[..., 0]
        assert shares[degree, order] >= 1 - epsilon
        assert degree == 0 or shares[degree - 1, order] < 1 - epsilon
        assert order == 0 or shares[-1, order - 1] < 1 - epsilon
        assert brdf.cut(degree, order).shares()[-1, -1, 0] == pytest.approx(shares[degree, order])
