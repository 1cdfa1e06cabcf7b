"""The convolution formula of general materials, and its inversions."""

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay
from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.quadrature import product_rule
from clrelight.lighting.environment import read_environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.lighting.sky import sky_light
from clrelight.shrm.convolution import (
    complex_basis,
    complex_light,
    estimate_material,
    evaluate_reflected,
    factorise,
    material_coefficients,
    reflected_coefficients,
)
from clrelight.shrm.explicit import explicit_maps
from clrelight.shrm.prefilter import build_shrm
from tests.reference import shrm as reference

F, P = 5, 4


def fibres(degree, order):
    """Return coefficients (light, view) of Kajiya and Kay's fibres along x, lit from above only, band-limited."""
    nodes, weights = product_rule(24, sphere=True)
    tangent = np.arccos(np.clip(nodes[:, 0], -1, 1))
    values = KajiyaKay(6).evaluate(tangent[:, None], tangent, np.zeros(1))[..., 0] * (nodes[:, 2:] > 0)
    light, view = (evaluate_basis(nodes, each) * weights[:, None] for each in (degree, order))
    return light.T @ values @ view


def random_frames(count, seed=0):
    rng = np.random.default_rng(seed)
    frames = rng.random((count, 3)) * [np.pi, 2 * np.pi, 2 * np.pi]
    views = rng.standard_normal((count, 3))
    return frames, views / np.linalg.norm(views, axis=1, keepdims=True)


def about_z(angle):
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])


def test_a_tangent_material_equals_integration():
    rho = fibres(F, P)
    assert np.abs(rho[2 * 3 + 2] - rho[2 * 3 - 2]).max() > 0.01  # it has a direction
    light = np.random.default_rng(1).standard_normal((F + 1) ** 2)
    frames, views = random_frames(12)
    nodes, weights = product_rule(F, sphere=True)
    local = evaluate_basis(nodes, F) @ rho
    expected = []
    for (a, b, g), view in zip(frames, views, strict=True):
        turned = nodes @ (reference.frame(a, b) @ about_z(g)).T
        radiance = weights * (evaluate_basis(turned, F) @ light)
        expected.append(radiance @ (local @ evaluate_basis(view[None], P)[0]))
    reflected = reflected_coefficients(complex_light(light), material_coefficients(rho, F, P))
    assert [block.shape for block in reflected] == [(2 * l + 1, 2 * l + 1, (P + 1) ** 2) for l in range(F + 1)]
    got = evaluate_reflected(reflected, frames, views)
    np.testing.assert_allclose(got, expected, atol=1e-10 * np.abs(expected).max())


def test_isotropic_materials_are_those_of_n_equal_q():
    rng = np.random.default_rng(2)
    rho_lpq = rng.standard_normal((F + 1, P + 1, P + 1, 1))
    l, p, q = np.indices(rho_lpq.shape[:3])
    rho_lpq[q > np.minimum(l, p)] = 0.0
    rho_kj = np.zeros(((F + 1) ** 2, (P + 1) ** 2), complex)
    for l in range(F + 1):
        for p in range(P + 1):
            for q in range(-min(l, p), min(l, p) + 1):
                rho_kj[l * (l + 1) + q, p * (p + 1) + q] = rho_lpq[l, p, abs(q), 0]
    light = rng.standard_normal((F + 1) ** 2)
    shrm = build_shrm(Light(light[:, None]), BrdfCoefficients(rho_lpq, np.ones(1)), 3, 12)
    alpha, beta = (each.ravel() for each in np.meshgrid(*shrm.angles(), indexing="ij"))
    views = random_frames(1)[1]
    expected = explicit_maps(shrm, views)[0].ravel()
    reflected = reflected_coefficients(complex_light(light), rho_kj)
    for gamma in (0.0, 1.3):  # the tangent does not matter, but the view is measured from it
        frames = np.stack([alpha, beta, np.full(len(alpha), gamma)], axis=1)
        local = np.repeat(views @ about_z(gamma), len(alpha), axis=0)
        got = evaluate_reflected(reflected, frames, local)
        np.testing.assert_allclose(got, expected, atol=1e-10 * np.abs(expected).max())


def test_complex_harmonics_are_orthonormal():
    nodes, weights = product_rule(F, sphere=True)
    basis = complex_basis(nodes, F)
    np.testing.assert_allclose((basis.conj() * weights[:, None]).T @ basis, np.eye((F + 1) ** 2), atol=1e-12)
    light = np.random.default_rng(0).standard_normal((F + 1) ** 2)
    values = evaluate_basis(nodes, F) @ light
    np.testing.assert_allclose(basis @ complex_light(light), values, atol=1e-12)


def test_a_material_comes_from_image_and_light(real_data):
    """Sharp light tells more: the same noise hurts least under a lamp, more under Grace, most under an overcast sky."""
    environment, _ = read_environment(real_data / "probes" / "grace_latlong.exr")
    lights = {
        "lamp": evaluate_basis(np.array([[0.36, -0.48, 0.8]]), F)[0],
        "grace": project_environment(environment, F).coeffs_kc @ [0.2126, 0.7152, 0.0722],
        "overcast": sky_light("overcast", degree=F).coeffs_kc[:, 0],
    }
    material = material_coefficients(fibres(F, P), F, P)
    errors, conditions = {}, {}
    for name, light in lights.items():
        known = complex_light(light / np.linalg.norm(light))
        reflected = reflected_coefficients(known, material)
        exact = estimate_material(reflected, known)
        np.testing.assert_allclose(exact.rho_kj, material, atol=1e-10)
        rng = np.random.default_rng(3)
        noisy = [block + 1e-3 * rng.standard_normal(block.shape) for block in reflected]
        found = estimate_material(noisy, known)
        errors[name] = np.linalg.norm(found.rho_kj - material) / np.linalg.norm(material)
        conditions[name] = exact.condition_l
        print(name, f"{errors[name]:.4f}", np.round(exact.condition_l, 2))
    assert errors["lamp"] < errors["grace"] < errors["overcast"]
    assert conditions["lamp"].max() < conditions["grace"].max() < conditions["overcast"].max()


def test_light_without_a_degree_tells_nothing_of_it():
    light = complex_light(np.eye((F + 1) ** 2)[0])
    reflected = reflected_coefficients(light, material_coefficients(fibres(F, P), F, P))
    with pytest.raises(InputError, match="nothing of degree 1"):
        estimate_material(reflected, light)


def test_reflected_light_factorises():
    """Into light and a reciprocal material, up to one factor."""
    rng = np.random.default_rng(4)
    rho = rng.standard_normal(((F + 1) ** 2,) * 2)
    material = material_coefficients(rho + rho.T, F, F)
    light = complex_light(rng.standard_normal((F + 1) ** 2))
    reflected = reflected_coefficients(light, material)
    found_light, found_material = factorise(reflected)
    scale = light[0] / found_light[0]
    np.testing.assert_allclose(found_light * scale, light, atol=1e-6)
    np.testing.assert_allclose(found_material / scale, material, atol=1e-6)
    with pytest.raises(InputError, match="reciprocity"):
        factorise(reflected_coefficients(light, material_coefficients(fibres(F, P), F, P)))


def test_shapes_are_checked():
    with pytest.raises(InputError, match="do not have coefficients"):
        material_coefficients(np.zeros((4, 4)), 2, 1)
