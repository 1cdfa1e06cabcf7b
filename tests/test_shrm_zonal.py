"""Reflection maps without azimuths: P + 1 coefficients, the same radiance, beside tables of as many maps."""

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.radial import Phong
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.quadrature import product_rule
from clrelight.lighting.light import Light
from clrelight.shrm.angular import integrate_directions
from clrelight.shrm.explicit import explicit_maps, interpolate_texture, view_map, view_texture, without_azimuth
from clrelight.shrm.lookup import local_view, render_sphere, view_sphere
from clrelight.shrm.prefilter import build_shrm, to_global, to_local
from clrelight.shrm.record import Shrm, grid_directions
from clrelight.shrm.zonal import build_zonal, to_zonal, with_azimuth, zonal_weights
from clrelight.store import read_shrm, write_shrm

VIEW = np.array([0.36, -0.8, 0.48])


@pytest.fixture(scope="module")
def light():
    return Light(np.random.default_rng(0).standard_normal((64, 3)))


@pytest.fixture(scope="module")
def fibres():
    return brdf_coefficients(KajiyaKay(9), 7, 12)


def test_coefficients_are_those_of_local_maps(light, fibres):
    zonal, local = build_zonal(light, fibres, 10, 21), build_shrm(light, fibres, 10, 21)
    assert (zonal.maps_khwc.shape, zonal.order) == ((13, 10, 21, 3), 12)
    np.testing.assert_allclose(with_azimuth(zonal).maps_khwc, local.maps_khwc, atol=1e-12)
    np.testing.assert_array_equal(to_zonal(local).maps_khwc, local.maps_khwc[[p * (p + 1) for p in range(13)]])
    for frame in (zonal, to_local(zonal)):
        np.testing.assert_allclose(to_global(frame).maps_khwc, to_global(local).maps_khwc, atol=1e-12)
    assert to_zonal(zonal) is zonal
    assert without_azimuth(zonal) is zonal
    with pytest.raises(InputError, match="local reflection maps alone"):
        to_zonal(to_global(local))


def test_views_are_those_of_global_maps(light, fibres):
    zonal = build_zonal(light, fibres, 10, 21)
    expected = view_map(to_global(zonal), VIEW)
    np.testing.assert_allclose(view_map(zonal, VIEW), expected, atol=1e-12)
    np.testing.assert_allclose(local_view(zonal, VIEW), expected, atol=1e-12)
    own = np.array([[0.0, 0.6, 0.8]])
    np.testing.assert_allclose(explicit_maps(zonal, own), explicit_maps(to_local(zonal), own), atol=1e-12)
    theta = np.linspace(0, np.pi, 5)
    np.testing.assert_allclose(view_texture(zonal, theta), view_texture(to_local(zonal), theta), atol=1e-12)


def test_weights_are_harmonics():
    x = np.linspace(-1, 1, 7)
    directions = np.stack([np.sqrt(1 - x * x), 0 * x, x], axis=1)
    expected = evaluate_basis(directions, 6)[:, [p * (p + 1) for p in range(7)]]
    np.testing.assert_allclose(zonal_weights(x, 6).T, expected, atol=1e-12)
    assert zonal_weights(x, 0).shape == (1, 7)


def test_fibres_equal_integration_and_beat_as_many_tabulated_maps(light):
    brdf = KajiyaKay(16)
    nodes, weights = product_rule(60, sphere=True)
    radiance = weights[:, None] * (evaluate_basis(nodes, 7) @ light.coeffs_kc)
    rows, width = 8, 16
    central = grid_directions(rows, width).reshape(-1, 3)
    truth = integrate_directions(nodes, radiance, brdf, central, VIEW).reshape(rows, width, 3)
    high = brdf_coefficients(brdf, 7, 17)
    angle = np.arccos(np.clip(grid_directions(rows, width) @ VIEW, -1, 1))
    errors = {}
    for count in (6, 12, 18):
        zonal = build_zonal(light, high.cut(7, count - 1), rows, width)
        theta = np.linspace(0, np.pi, count)
        table = view_texture(build_zonal(light, high, rows, width), theta)
        found = {"orders": view_map(zonal, VIEW), "table": interpolate_texture(table, theta, angle)}
        errors[count] = {k: np.linalg.norm(v - truth) / np.linalg.norm(truth) for k, v in found.items()}
        assert errors[count]["orders"] < 0.75 * errors[count]["table"], errors
    assert errors[18]["orders"] < 0.01


def test_spheres_and_poles(light, fibres):
    zonal = build_zonal(light, fibres, 90)
    sphere = view_sphere(24, VIEW, "tangent")
    expected = render_sphere(to_global(zonal), sphere)
    np.testing.assert_allclose(render_sphere(zonal, sphere), expected, atol=0.01 * np.abs(expected).max())


def test_files_keep_the_frame(light, fibres, tmp_path):
    made = build_zonal(light, fibres, 6, 15, dtype=np.float32)
    write_shrm(tmp_path / "z.h5", made)
    held = read_shrm(tmp_path / "z.h5")
    assert (held.frame, held.order, held.centre) == ("zonal", 12, "tangent")
    np.testing.assert_array_equal(held.maps_khwc, made.maps_khwc)


def test_what_cannot_be_is_refused(light, fibres):
    with pytest.raises(InputError, match="more than 14 columns"):
        build_zonal(light, fibres, 4, 8)
    with pytest.raises(InputError, match="1 row and column"):
        build_zonal(light, fibres, 0)
    with pytest.raises(InputError, match="reflection map"):
        Shrm(np.zeros((5, 2, 4, 1)), "global", 1)
    assert build_zonal(light, brdf_coefficients(Phong(4), 7, 0), 8).order == 0
    assert build_zonal(light, brdf_coefficients(Microfacet(0.5), 7, 2), 8).maps_khwc.shape[0] == 3
