"""Irradiance: the clamped cosine, nine coefficients in each form, brute force, and the paper's error figures."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre

from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.irradiance import (
    WORST_CASE_ERROR,
    compare_irradiance,
    cosine_coefficients,
    evaluate_irradiance,
    integrate_irradiance,
    irradiance_by_matrix,
    irradiance_by_polynomial,
    irradiance_matrix,
)
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.sampling import make_pattern
from tests.reference.basis import closed_forms, real_harmonics
from tests.reference.lighting import irradiance

EPS32 = 2.0**-23
PROBES = ("grace_cross.hdr", "grace_latlong.exr", "beach_probe.hdr", "galileo_cross.dds")


def normals(count=500):
    upper = make_pattern("uniform", count)
    return np.concatenate([upper, -upper])


def test_factors_are_those_of_the_paper():
    printed = [3.141593, 2.094395, 0.785398, 0, -0.130900, 0, 0.049087]
    np.testing.assert_allclose(cosine_coefficients(6), printed, atol=5e-7)


@pytest.mark.parametrize("l", [0, 1, 2, 3, 8, 17, 40, 100])
def test_factors_are_integrals_of_the_clamped_cosine(l):
    expected = 2 * np.pi * quad(lambda z: z * eval_legendre(l, z), 0, 1, limit=200)[0]
    assert cosine_coefficients(l)[l] == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("channels", [1, 3])
def test_every_form_is_the_sum_of_nine_terms(channels):
    light = Light(np.random.default_rng(0).standard_normal((16, channels)))
    normals_n3 = normals()
    factors_k = np.repeat([3.141593, 2.094395, 0.785398], [1, 3, 5])  # printed, so good to 1e-6
    expected = closed_forms(normals_n3) @ (factors_k[:, None] * light.coeffs_kc[:9])
    scale = np.abs(expected).max()
    for made in (
        evaluate_irradiance(light, normals_n3),
        irradiance_by_matrix(irradiance_matrix(light), normals_n3),
        irradiance_by_polynomial(light, normals_n3),
    ):
        np.testing.assert_allclose(made, expected, atol=2e-6 * scale)
    nine = evaluate_irradiance(light, normals_n3)
    np.testing.assert_allclose(irradiance_by_matrix(irradiance_matrix(light), normals_n3), nine, atol=1e-13 * scale)
    np.testing.assert_allclose(irradiance_by_polynomial(light, normals_n3), nine, atol=1e-13 * scale)


def test_matrix_has_the_printed_constants():
    light = Light(np.arange(1.0, 10.0)[:, None])
    l00, l1_1, l10, l11, l2_2, l2_1, l20, l21, l22 = range(1, 10)
    c1, c2, c3, c4, c5 = 0.429043, 0.511664, 0.743125, 0.886227, 0.247708
    printed = [
        [c1 * l22, c1 * l2_2, c1 * l21, c2 * l11],
        [c1 * l2_2, -c1 * l22, c1 * l2_1, c2 * l1_1],
        [c1 * l21, c1 * l2_1, c3 * l20, c2 * l10],
        [c2 * l11, c2 * l1_1, c2 * l10, c4 * l00 - c5 * l20],
    ]
    np.testing.assert_allclose(irradiance_matrix(light)[0], printed, atol=1.5e-5)


def test_a_light_of_low_degree_has_no_more_terms():
    light = Light(np.full((1, 3), np.sqrt(4 * np.pi)))  # radiance 1 from everywhere: irradiance pi
    for made in (evaluate_irradiance(light, normals()), irradiance_by_polynomial(light, normals())):
        np.testing.assert_allclose(made, np.pi)
    np.testing.assert_allclose(irradiance_by_matrix(irradiance_matrix(light), normals()), np.pi)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 31, 1025])
@pytest.mark.parametrize("channels", [1, 3])
def test_brute_force_is_the_sum_over_texels(device, count, channels):
    rng = np.random.default_rng(1)
    environment = Environment(rng.random((48, 8, channels), np.float32), "cube")
    directions_t3, weights_t = environment.geometry()
    radiance_tc = environment.radiance_hwc.reshape(-1, channels).astype(np.float64)
    normals_n3 = normals(1025)[:count]
    expected = irradiance(directions_t3, weights_t, radiance_tc, normals_n3)
    made = integrate_irradiance(environment, normals_n3, device=device)
    assert made.shape == (count, channels)
    np.testing.assert_allclose(made, expected, rtol=64 * EPS32)


def test_brute_force_of_a_black_map_is_black(device):
    environment = Environment(np.zeros((8, 8, 3), np.float32), "angular")
    assert not integrate_irradiance(environment, normals(3), device=device).any()


def test_texels_outside_a_probe_do_not_count(device):
    radiance = np.ones((64, 64, 1), np.float32)
    radiance[0, 0] = np.nan
    radiance[-1, -1] = np.inf
    made = integrate_irradiance(Environment(radiance, "angular"), normals(4), device=device)
    np.testing.assert_allclose(made, np.pi, rtol=0.01)


def test_the_worst_case_of_nine_coefficients_is_nine_percent():
    lamp = np.array([[0.0, 0.6, 0.8]])
    light = Light(real_harmonics(lamp, 2).T.copy())  # a distant lamp of total light 1
    normals_n3 = normals(20000)
    exact = np.maximum(normals_n3 @ lamp.T, 0.0)
    error = compare_irradiance(
        evaluate_irradiance(light, normals_n3), exact, np.ones(len(normals_n3)), Light(light.coeffs_kc)
    )
    assert error.maximum == pytest.approx(WORST_CASE_ERROR, abs=1e-4)
    assert 0.085 < error.maximum < 0.095
    quadratic = np.polynomial.Polynomial([3 / 32, 1 / 2, 15 / 32])  # 1/4 P0 + 1/2 P1 + 5/16 P2
    expected = 0.5 * quad(lambda z: abs(max(z, 0) - quadratic(z)), -1, 1, points=[0], limit=200)[0]
    assert error.mean == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("file", PROBES)
def test_errors_on_natural_light_are_those_the_paper_tells(real_data, device, file):
    environment, _ = read_environment(real_data / "probes" / file)
    light = project_environment(environment, 2, device=device)
    normals_n3, weights_n = layouts.texel_geometry("latlong", 16, 32)
    exact_nc = integrate_irradiance(environment, normals_n3, device=device)
    error = compare_irradiance(evaluate_irradiance(light, normals_n3), exact_nc, weights_n, light)
    assert 0.001 < error.mean < 0.01
    assert 0.005 < error.maximum < 0.05
