"""Meshes under reflection maps: beside integration for every pixel, with light and view that turn."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.radial import Lambert, Phong
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.quadrature import product_rule
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.jobs.reflection.render import render_reflection
from clrelight.lighting.light import Light
from clrelight.lighting.rotation import rotate_light
from clrelight.shrm.angular import integrate_directions
from clrelight.shrm.lookup import central_directions
from clrelight.shrm.painting import Mesh
from clrelight.shrm.prefilter import build_shrm, to_global
from clrelight.shrm.zonal import build_zonal
from clrelight.transfer.cameras import Camera
from tests.rendering import meet_sphere, pixel_rays, sphere, torus_grid

F = 6
NEAR = Camera((0.4, -3.0, 1.1), (0.0, 0.0, 0.0), field_of_view=45.0)


@pytest.fixture(scope="module")
def light():
    return Light(np.random.default_rng(3).standard_normal((49, 1)))


def shrm_of(light, brdf, order, rows=90):
    rho = brdf_coefficients(brdf, F, order)
    return build_shrm(light, rho, rows, frame="global") if brdf.has_azimuth else build_zonal(light, rho, rows)


def truth_of(light, brdf, camera, size, turn=None):
    """Return the picture of the unit sphere, each pixel's middle integrated over all light, and where it is met."""
    eye, directions = pixel_rays(camera, size, size)
    points, met = meet_sphere(eye, directions)
    towards, normals = -directions[met], points[met]
    central = np.stack([central_directions(n[None], v, brdf.centre)[0] for n, v in zip(normals, towards, strict=True)])
    nodes, weights = product_rule(40, sphere=True)
    radiance = weights[:, None] * (evaluate_basis(nodes if turn is None else nodes @ turn, F) @ light.coeffs_kc)
    picture = np.zeros((size, size, 1))
    picture[met] = integrate_directions(nodes, radiance, brdf, central, towards)
    return picture, met


@pytest.mark.parametrize(
    ("brdf", "order", "most"),
    [(Lambert(), 0, 0.01), (Phong(12), 0, 0.02), (Microfacet(0.5), 8, 0.05), (KajiyaKay(4), 12, 0.03)],
    ids=["lambert", "phong", "microfacet", "fibres"],
)
def test_pixels_with_their_own_views_equal_integration(light, brdf, order, most):
    size, turn = 24, rotation_matrix("euler", (30.0, 40.0, 10.0))
    mesh = Mesh(sphere(5), (size, size), 1, "pixel")
    shrm = shrm_of(light, brdf, order)
    for held in (None, turn):
        truth, met = truth_of(light, brdf, NEAR, size, held)
        picture = mesh.paint(shrm, NEAR, np.eye(3) if held is None else held)
        inner = met & (picture.coverage_hw == 1.0)
        assert inner.sum() > 200
        off = np.linalg.norm(picture.radiance_hwc[inner] - truth[inner]) / np.linalg.norm(truth[inner])
        assert off < most, off


def test_a_distant_view_stands_for_all(light):
    """One map is exact without perspective, and near the truth with it; of one lobe always exact."""
    shrm = shrm_of(light, Microfacet(0.5), 6)
    far = Camera((0.4, -3.0, 1.1), (0.0, 0.0, 0.0), height=2.4)
    one, own = (Mesh(sphere(4), (20, 20), 2, views) for views in ("distant", "pixel"))
    np.testing.assert_allclose(
        one.paint(shrm, far, np.eye(3)).radiance_hwc, own.paint(shrm, far, np.eye(3)).radiance_hwc, atol=1e-5
    )
    near = [each.paint(shrm, NEAR, np.eye(3)).radiance_hwc for each in (one, own)]
    assert 1e-4 < np.linalg.norm(near[0] - near[1]) / np.linalg.norm(near[1]) < 0.2
    lobe = shrm_of(light, Phong(12), 0)
    near = [each.paint(lobe, NEAR, np.eye(3)).radiance_hwc for each in (one, own)]
    np.testing.assert_allclose(near[0], near[1], atol=1e-5)
    assert (len(one.clock.seconds), len(own.clock.seconds)) == (3, 0)
    assert one.clock.rate(24576) > 0


def test_light_that_turns_is_light_that_was_turned(light):
    turn = rotation_matrix("axis", (0.0, 0.0, 1.0, 90.0))
    brdf, torus = Microfacet(0.5), torus_grid()
    told = {"mesh": torus, "size": 24, "camera": (1.0, -1.0, 1.0)}
    frames = render_reflection(shrm_of(light, brdf, 4), turntable=4, **told)
    assert frames.shape == (4, 24, 24, 1)
    expected = render_reflection(shrm_of(rotate_light(light, turn), brdf, 4), **told)
    np.testing.assert_allclose(frames[1], expected, atol=0.02 * np.abs(expected).max())
    turned = render_reflection(shrm_of(light, brdf, 4), rotate=90.0, **told)
    np.testing.assert_allclose(frames[1], turned, atol=1e-6)


def test_the_view_goes_round_a_still_light(light):
    """A torus about z looks alike from all around: a view that goes on by a quarter is light that goes back by one."""
    shrm, torus = shrm_of(light, Microfacet(0.5), 4), torus_grid()
    camera = Camera((2.0, -2.0, 2.0), height=3.0)
    told = {"mesh": torus, "size": 24, "camera": camera, "turntable": 4}
    views, lights = (render_reflection(shrm, turns=turns, **told) for turns in ("view", "light"))
    for i in range(4):
        np.testing.assert_allclose(views[i], lights[-i % 4], atol=0.03 * np.abs(lights).max())
    assert np.abs(views[0] - views[1]).max() > 0.1 * np.abs(views).max()


def test_tangents_of_a_surface_are_its_fibres(light):
    shrm = shrm_of(light, KajiyaKay(6), 10)
    torus = torus_grid()
    assert torus.tangents_v3 is not None
    camera = Camera((2.0, -3.0, 2.0), height=3.0)
    own = Mesh(torus, (24, 24), 2).paint(shrm, camera, np.eye(3)).radiance_hwc
    meridian = Mesh(replace(torus, tangents_v3=None), (24, 24), 2).paint(shrm, camera, np.eye(3)).radiance_hwc
    assert np.linalg.norm(own - meridian) > 0.1 * np.linalg.norm(meridian)


def test_bands_make_the_same_picture(light):
    shrm, torus = shrm_of(light, Microfacet(0.5), 2), torus_grid()
    whole = Mesh(torus, (24, 24), 2).paint(shrm, NEAR, np.eye(3))
    bands = Mesh(torus, (24, 24), 2, memory=24 * 4 * 240 * 5).paint(shrm, NEAR, np.eye(3))
    np.testing.assert_allclose(bands.radiance_hwc, whole.radiance_hwc, atol=1e-6)
    np.testing.assert_array_equal(bands.coverage_hw, whole.coverage_hw)


def test_what_cannot_be_is_refused(light):
    shrm = shrm_of(light, Phong(4), 0, 20)
    for words, said in (
        ({"mesh": sphere(1), "views": "all"}, "views must be one of distant, pixel"),
        ({"views": "pixel"}, "are for meshes"),
        ({"camera": (1, 0, 0)}, "are for meshes"),
        ({"mesh": sphere(1), "subsamples": 0}, "subsamples must be 1 to"),
        ({"mesh": sphere(1), "camera": Camera((0, -3, 0), (0, -9, 0))}, "sees nothing"),
        ({"background": "white"}, "a background is one of"),
        ({"turntable": 0}, "turntable must be"),
        ({"turntable": 2, "turns": "mesh"}, "what turns is one of"),
        ({"tonemap": "clip"}, "linear radiance"),
        ({"size": 0}, "picture's size"),
        ({"view": (0, 0, 0)}, "not 0"),
    ):
        with pytest.raises(InputError, match=said):
            render_reflection(shrm, **words)


def test_local_maps_are_turned_first(light):
    rho = brdf_coefficients(Microfacet(0.5), F, 3)
    local = build_shrm(light, rho, 40)
    got = render_reflection(local, mesh=sphere(3), size=16)
    np.testing.assert_allclose(got, render_reflection(to_global(local), mesh=sphere(3), size=16), atol=1e-6)
