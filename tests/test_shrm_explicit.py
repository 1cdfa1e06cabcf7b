"""Tables of radiance from reflection maps and back, earlier methods', lookups and pictures of spheres."""

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.radial import Lambert, Phong
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.quadrature import product_rule
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.lighting.light import Light
from clrelight.shrm.angular import integrate_directions, lobe_angle
from clrelight.shrm.explicit import (
    explicit_maps,
    fit_maps,
    icosahedron,
    interpolate_icosahedron,
    interpolate_texture,
    view_grid,
    view_map,
    view_texture,
    without_azimuth,
)
from clrelight.shrm.lookup import local_view, local_views, look_up, render_sphere, view_sphere
from clrelight.shrm.prefilter import build_shrm, to_global
from clrelight.shrm.record import grid_directions


@pytest.fixture(scope="module")
def light():
    falling = 1.0 / np.arange(1, 9) ** 2
    noise = np.random.default_rng(7).standard_normal((64, 3))
    return Light(noise * np.repeat(falling, 2 * np.arange(8) + 1)[:, None] + np.eye(64, 1) * 3)


@pytest.fixture(scope="module")
def local(light):
    return build_shrm(light, brdf_coefficients(Microfacet(0.4), 7, 5), 12)


@pytest.mark.parametrize(("dtype", "most"), [(np.float64, 1e-12), (np.float32, 1e-6)])
@pytest.mark.parametrize("order", [2, 5])
def test_a_hundred_maps_and_back(light, dtype, most, order):
    for frame in ("local", "global"):
        shrm = build_shrm(light, brdf_coefficients(Microfacet(0.4), 7, order), 12, frame=frame)
        maps = explicit_maps(shrm, view_grid(10)).astype(dtype)
        assert maps.shape == (100, 12, 24, 3)
        back = fit_maps(maps, view_grid(10), order, shrm)
        size = np.abs(shrm.maps_khwc).max()
        np.testing.assert_allclose(back.maps_khwc, shrm.maps_khwc, atol=most * size)
        assert (back.frame, back.degree) == (frame, 7)


def test_too_few_views_are_refused(local):
    maps = explicit_maps(local, view_grid(3))
    with pytest.raises(InputError, match="9 views do not tell the 36 coefficients of order 5 apart"):
        fit_maps(maps, view_grid(3), 5, local)
    with pytest.raises(InputError, match="need as many views"):
        fit_maps(maps[:4], view_grid(3), 1, local)


def test_without_azimuth_it_is_the_texture(local):
    """Kautz and McCool's 3-D texture holds what q = 0 holds, whatever the azimuth of the view."""
    theta = np.linspace(0, np.pi, 7)
    texture = view_texture(local, theta)
    for phi in (0.0, 1.0, 4.0):
        views = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
        maps = explicit_maps(without_azimuth(local), views)
        np.testing.assert_allclose(maps, texture, atol=1e-12 * np.abs(texture).max())
    mean = np.mean([local_view_at(local, 1.1, phi) for phi in 2 * np.pi * np.arange(16) / 16], axis=0)
    np.testing.assert_allclose(mean, view_texture(local, [1.1])[0], atol=1e-12)
    for made in (without_azimuth, lambda shrm: view_texture(shrm, theta)):
        with pytest.raises(InputError, match="local"):
            made(to_global(local))


def local_view_at(shrm, theta, phi):
    return explicit_maps(shrm, np.array([[np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]]))[0]


def test_a_fine_texture_is_met_between_its_angles(local):
    theta = np.linspace(0, np.pi, 400)
    angle = np.random.default_rng(0).random((12, 24)) * np.pi
    got = interpolate_texture(view_texture(local, theta), theta, angle)
    for h, w in ((0, 0), (5, 7), (11, 23)):
        np.testing.assert_allclose(got[h, w], view_texture(local, [angle[h, w]])[0, h, w], atol=1e-4)
    ends = interpolate_texture(view_texture(local, theta), theta, np.full((12, 24), np.pi))
    np.testing.assert_allclose(ends, view_texture(local, [np.pi])[0], atol=1e-12)


def test_the_icosahedron_is_one():
    vertices, faces = icosahedron()
    assert vertices.shape == (12, 3)
    assert faces.shape == (20, 3)
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 1)
    np.testing.assert_allclose(np.bincount(faces.ravel()), 5)


def test_twelve_maps_are_met_at_their_vertices(local):
    world = to_global(local)
    vertices, _ = icosahedron()
    maps = explicit_maps(world, vertices)
    for v in range(12):
        np.testing.assert_allclose(interpolate_icosahedron(maps, vertices[v]), maps[v], atol=1e-12)
    between = interpolate_icosahedron(maps, np.array([0.3, -0.2, 0.93]) / np.linalg.norm([0.3, -0.2, 0.93]))
    assert maps.min() <= between.min() <= between.max() <= maps.max()


def test_lookup_is_bilinear_and_goes_on_beyond_poles():
    height, width = 16, 32
    map_hwc = np.random.default_rng(0).random((height, width, 3))
    at = grid_directions(height, width).reshape(-1, 3)
    np.testing.assert_allclose(look_up(map_hwc, at), map_hwc.reshape(-1, 3), atol=1e-9)
    pole = look_up(map_hwc, np.array([[1e-12, 0.0, 1.0]]))
    assert map_hwc[0].min() <= pole.min() <= pole.max() <= map_hwc[0].max()
    linear = np.einsum("hwx,x->hw", grid_directions(200, 400), [0.2, 0.5, -1.0])[..., None]
    anywhere = np.random.default_rng(1).standard_normal((500, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    np.testing.assert_allclose(look_up(linear, anywhere)[:, 0], anywhere @ [0.2, 0.5, -1.0], atol=2e-4)


def test_local_views_are_those_of_the_frame(local):
    from tests.reference.shrm import frame

    view = np.array([0.6, 0.0, 0.8])
    alpha, beta = local.angles()
    got = local_views(local, view)
    for h, w in ((0, 0), (3, 11), (11, 23)):
        np.testing.assert_allclose(got[h, w], frame(alpha[h], beta[w]).T @ view, atol=1e-14)
    np.testing.assert_allclose(local_view(to_global(local), view), local_view(local, view), atol=1e-12)


def test_a_sphere_is_seen_as_it_is():
    sphere = view_sphere(33, np.array([0.0, -2.0, 0.0]))
    middle = sphere.picture(sphere.normals_n3)[16, 16]
    np.testing.assert_allclose(middle, (0, -1, 0), atol=1e-12)
    assert sphere.picture(sphere.normals_n3)[1, 16, 2] > 0.9  # z is up
    assert sphere.picture(sphere.normals_n3)[16, 31, 0] > 0.9  # x is right
    cosine = np.sum(sphere.central_n3 * sphere.view_3, axis=1)
    np.testing.assert_allclose(cosine, 2 * (sphere.normals_n3 @ sphere.view_3) ** 2 - 1, atol=1e-12)
    for centre in ("normal", "tangent"):
        other = view_sphere(33, np.array([0.3, -2.0, 1.0]), centre)
        np.testing.assert_allclose(np.linalg.norm(other.central_n3, axis=1), 1)
    along = np.sum(other.central_n3 * other.normals_n3, axis=1)
    np.testing.assert_allclose(along, 0, atol=1e-12)
    assert view_sphere(9, np.array([0.0, 0.0, 1.0])).inside_hw.any()
    for bad in ([0, 0, 0], [1, 0], [np.nan, 0, 1]):
        with pytest.raises(InputError, match="not 0"):
            view_sphere(8, np.array(bad))


@pytest.mark.parametrize(("brdf", "order"), [(Lambert(), 0), (Phong(12), 0), (Microfacet(0.4), 10), (KajiyaKay(6), 10)])
def test_spheres_equal_integration(light, brdf, order):
    """Rendered by one dynamic map, also while the light turns, beside a sum over the light for every pixel."""
    shrm = build_shrm(light, brdf_coefficients(brdf, 7, order), 128, frame="global")
    sphere = view_sphere(24, np.array([0.4, -1.0, 0.3]), brdf.centre)
    nodes, weights = product_rule(60, sphere=True)
    for turn in (np.eye(3), rotation_matrix("euler", (30.0, 40.0, 10.0))):
        radiance = weights[:, None] * (evaluate_basis(nodes @ turn, 7) @ light.coeffs_kc)
        truth = sphere.picture(integrate_directions(nodes, radiance, brdf, sphere.central_n3, sphere.view_3))
        got = render_sphere(shrm, sphere, turn)
        assert np.linalg.norm(got - truth) / np.linalg.norm(truth) < 0.05


def test_lobes_are_cut_where_little_is_left():
    assert lobe_angle(Phong(8), 0.05) == pytest.approx(np.arccos(0.05 ** (1 / 9)))
    assert lobe_angle(Microfacet(0.2), 0.0) == np.pi
    angles = [lobe_angle(Microfacet(0.2), epsilon) for epsilon in (0.3, 0.05, 0.01)]
    assert angles == sorted(angles)
    nodes, weights = product_rule(40, sphere=True)
    central = grid_directions(4, 8).reshape(-1, 3)
    for brdf in (Phong(8), Microfacet(0.3)):
        full, cut = (
            integrate_directions(nodes, weights[:, None], brdf, central, central, epsilon=e) for e in (0.0, 0.05)
        )
        assert 0.85 < (cut / full).min() <= (cut / full).max() < 1.0
    for epsilon in (-0.1, 1.0):
        with pytest.raises(InputError, match="epsilon"):
            lobe_angle(Phong(8), epsilon)


def test_one_dynamic_map_is_the_sum_of_all(local):
    world, view = to_global(local), np.array([0.0, 0.6, 0.8])
    expected = np.einsum("k,khwc->hwc", evaluate_basis(view[None], 5)[0], world.maps_khwc)
    np.testing.assert_allclose(view_map(world, view), expected, atol=1e-12)
