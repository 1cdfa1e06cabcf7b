"""Light on the upper hemisphere: autocorrelation, relighting, and the sum of photographs it stands for."""

import numpy as np
import pytest

from benchmarks.photograph_sum import gather_light, sum_photographs
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.errors import InputError
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation, project_onto_hemisphere
from clrelight.jobs.fit import fit
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.light import Light, share_below
from clrelight.lighting.projection import project_environment
from clrelight.lighting.relighting import (
    automatic_exposure,
    map_tones,
    relight_under,
)
from clrelight.sampling import make_pattern
from tests.reference.basis import real_harmonics, sphere_quadrature
from tests.stacks import ring_stack

EPS32 = 2.0**-23


def hemisphere_quadrature(degree):
    """Return directions and weights for z > 0, from a rule on z in -1 .. 1 squeezed to 0 .. 1."""
    directions_i3, weights_i = sphere_quadrature(degree)
    z = 0.5 * (directions_i3[:, 2] + 1.0)
    turn = directions_i3[:, :2] / np.linalg.norm(directions_i3[:, :2], axis=1, keepdims=True)
    return np.column_stack([np.sqrt(1 - z * z)[:, None] * turn, z]), 0.5 * weights_i


def coefficient_map(degree, channels, seed=0):
    rng = np.random.default_rng(seed)
    coeffs = rng.standard_normal(((degree + 1) ** 2, 3, 5, channels)).astype(np.float32)
    return CoefficientMap(coeffs, degree, "uls", 1.0, "linear", make_pattern("uniform", 9))


@pytest.mark.parametrize(("degree", "other"), [(0, 0), (3, 3), (6, 2), (2, 9), (10, 10)])
def test_autocorrelation_is_the_integral_over_the_hemisphere(degree, other):
    directions_i3, weights_i = hemisphere_quadrature(max(degree, other) + 1)
    expected = (real_harmonics(directions_i3, degree).T * weights_i) @ real_harmonics(directions_i3, other)
    matrix = hemisphere_autocorrelation(degree, other)
    np.testing.assert_allclose(matrix, expected, atol=1e-12)
    light_kc = np.random.default_rng(0).standard_normal(((other + 1) ** 2, 3))
    np.testing.assert_allclose(project_onto_hemisphere(light_kc, degree), matrix @ light_kc, atol=1e-12)
    n = min(matrix.shape)
    np.testing.assert_allclose(np.diag(matrix)[:n], 0.5, atol=1e-12)


def test_autocorrelation_of_a_high_degree_is_half_a_projection():
    # Twice A maps functions onto the hemisphere and back: eigenvalues of A lie in 0 .. 1.
    values = np.linalg.eigvalsh(hemisphere_autocorrelation(20))
    assert values.min() > -1e-12
    assert values.max() < 1 + 1e-12


def test_share_below_the_horizon():
    z = np.zeros((4, 1))
    z[0], z[2] = np.sqrt(4 * np.pi), np.sqrt(4 * np.pi / 3)  # 1 + z: 3/4 of it above
    assert share_below(Light(z)) == pytest.approx(0.25)
    assert share_below(Light(np.zeros((1, 3)))) == 0.0


@pytest.mark.parametrize(("view", "light"), [(1, 1), (1, 3), (3, 1), (3, 3)])
@pytest.mark.parametrize(("degree", "other"), [(4, 4), (4, 7), (5, 2)])
def test_relighting_is_the_integral_of_the_product(device, view, light, degree, other):
    fitted = coefficient_map(degree, view)
    rng = np.random.default_rng(1)
    lit = Light(rng.standard_normal(((other + 1) ** 2, light)))
    directions_i3, weights_i = hemisphere_quadrature(max(degree, other) + 1)
    seen_ihwc = np.tensordot(real_harmonics(directions_i3, degree), fitted.coeffs_khwc.astype(np.float64), 1)
    light_ic = weights_i[:, None] * (real_harmonics(directions_i3, other) @ lit.coeffs_kc)
    expected = np.sum(seen_ihwc * light_ic[:, None, None, :], axis=0)
    image = relight_under(fitted, lit, device=device)
    assert image.shape == (3, 5, max(view, light))
    operator_kc = np.abs(project_onto_hemisphere(lit.coeffs_kc, degree))
    bound = np.tensordot(operator_kc.max(axis=1), np.abs(fitted.coeffs_khwc.astype(np.float64)), 1)
    assert (np.abs(image - expected) <= 40 * EPS32 * bound).all()


def test_gathered_light_is_all_light_of_the_hemisphere():
    rng = np.random.default_rng(2)
    environment = Environment(rng.random((24, 48, 3), np.float32), "latlong")
    directions_i3 = make_pattern("uniform", 31)
    gathered_ic = gather_light(environment, directions_i3)
    texel_t3, weights_t = environment.geometry()
    above = texel_t3[:, 2] > 0
    radiance_tc = environment.radiance_hwc.reshape(-1, 3)[above].astype(np.float64)
    np.testing.assert_allclose(gathered_ic.sum(axis=0), weights_t[above] @ radiance_tc)
    nearest = np.argmax(texel_t3[above] @ directions_i3.T, axis=1)
    expected = (weights_t[above, None] * radiance_tc)[nearest == 7].sum(axis=0)
    np.testing.assert_allclose(gathered_ic[7], expected)


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_photographs_are_summed_in_linear_radiance(transfer):
    images = np.random.default_rng(3).integers(0, 256, (4, 2, 3, 3), np.uint8)
    stack = LightStack(images, make_pattern("uniform", 4), 255.0, transfer)
    light_ic = np.arange(12.0).reshape(4, 3)
    values = images / 255.0
    if transfer == "srgb":
        values = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(sum_photographs(stack, light_ic), (values * light_ic[:, None, None]).sum(axis=0))


def test_a_smooth_view_under_a_smooth_map_is_the_sum_of_its_photographs(device):
    directions_i3 = make_pattern("uniform", 4000)
    rng = np.random.default_rng(4)
    coeffs = rng.standard_normal((9, 2, 2, 3)).astype(np.float32) * 0.05
    coeffs[0] = 3.0
    fitted = CoefficientMap(coeffs, 2, "uls", 1.0, "linear", directions_i3)
    images = np.tensordot(real_harmonics(directions_i3, 2), coeffs, 1).astype(np.float32)
    stack = LightStack(images, directions_i3, 1.0)
    environment = Environment(rng.random((32, 64, 3), np.float32), "latlong")
    expected = sum_photographs(stack, gather_light(environment, directions_i3))
    image = relight_under(fitted, project_environment(environment, 12), device=device)
    np.testing.assert_allclose(image, expected, rtol=0.03)


def test_the_ring_under_grace_is_the_sum_of_its_photographs(real_data, device):
    pytest.importorskip("embreex", reason="the scene is ray traced")
    stack = ring_stack()
    environment, _ = read_environment(real_data / "probes" / "grace_cross.hdr")
    expected = sum_photographs(stack, gather_light(environment, stack.directions_i3))
    psnr = []
    for degree in (2, 8):
        fitted = fit(stack, "spline", degree=degree, device=device)
        image = relight_under(fitted, project_environment(environment, 2 * degree, device=device), device=device)
        psnr.append(-10 * np.log10(np.mean((image - expected) ** 2) / expected.max() ** 2))
    assert psnr[0] > 28
    assert psnr[1] > 40


def test_tones():
    image = np.array([[[-1.0, 0.0, 0.5], [1.0, 3.0, 1e9]]], np.float32)
    np.testing.assert_allclose(map_tones(image, "clip"), [[[0, 0, 0.5], [1, 1, 1]]])
    np.testing.assert_allclose(map_tones(image, "reinhard"), [[[0, 0, 1 / 3], [0.5, 0.75, 1]]])
    with pytest.raises(InputError, match="clip, reinhard"):
        map_tones(image, "film")
    assert automatic_exposure(np.full((4, 4, 3), 8.0)) == -3.0
    assert automatic_exposure(np.zeros((4, 4, 3))) == 0.0
