"""Reflection maps and transfer at the ends of what they take: degrees, single rows and faces, radiance, size."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import eval_legendre

import clrelight as cr
from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.radial import Lambert, Phong
from clrelight.errors import InputError
from clrelight.lighting.environment import Environment
from clrelight.lighting.projection import project_environment
from clrelight.shrm.explicit import explicit_maps, view_grid
from clrelight.transfer.transport import transfer_vertices
from tests.meshes import open_box
from tests.meshes import quad as sheet

MAP = np.random.default_rng(5).random((44, 88, 3), np.float32) + np.float32(0.1)
VIEWS = view_grid(5)


def shown(radiance_hwc, brdf, degree, order, rows, device, **words):
    """Return what a reflection map shows to some views, (view, row, column, channel)."""
    made = cr.build_reflection(
        Environment(radiance_hwc, "latlong"), brdf, degree=degree, order=order, rows=rows, device=device, **words
    )
    assert np.isfinite(made.maps_khwc).all()
    return explicit_maps(made, VIEWS)


@pytest.mark.parametrize(("degree", "order", "rows"), [(0, 0, 1), (20, 0, 1), (0, 20, 2), (20, 20, 1), (20, 2, 21)])
@pytest.mark.parametrize("method", ["device", "fft", "product"])
@pytest.mark.parametrize("brdf", [Lambert(), Phong(0.0), Phong(1e5)], ids=["lambert", "phong 0", "phong 1e5"])
def test_a_lobe_of_energy_one_in_a_constant_world_is_that_world(device, degree, order, rows, method, brdf):
    if method == "fft" and 2 * rows <= 2 * degree:
        with pytest.raises(InputError, match="column"):
            shown(MAP, brdf, degree, order, rows, device, method=method)
        return
    for radiance in (1.0, 1e30, 1e-30):
        found = shown(np.full_like(MAP, radiance), brdf, degree, order, rows, device, method=method)
        np.testing.assert_allclose(found, radiance, rtol=2e-5)


@pytest.mark.parametrize("brdf", [Microfacet(1e-3), Microfacet(0.2), Microfacet(50.0), KajiyaKay(0.0), KajiyaKay(1e3)])
def test_radiance_scales_what_is_reflected(device, brdf):
    """By powers of two, which rounding does not see: the same digits."""
    once = shown(MAP, brdf, 6, 2, 13, device)
    assert np.abs(once).max() > 0.0
    for power in (-90, 90):
        scaled = shown(MAP * np.float32(2.0**power), brdf, 6, 2, 13, device)
        np.testing.assert_array_equal(scaled, once * np.float32(2.0**power))
    assert not shown(np.zeros_like(MAP), brdf, 6, 2, 13, device).any()


@pytest.mark.parametrize("method", ["auto", "separable", "separable-device"])
def test_radiance_beyond_float32_is_refused_in_a_line(device, method):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match=r"radiance up to 3\.\d+e\+38 cannot be summed in float32"):
            project_environment(Environment(MAP * np.float32(3e38), "latlong"), 4, method=method, device=device)


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0])
def test_texels_that_are_no_radiance_are_named(value):
    broken = MAP.copy()
    broken[3, 4, 1] = value
    with pytest.raises(InputError, match="row 3, column 4, channel 1"):
        Environment(broken, "latlong")


def test_one_texel_resolves_degree_0(device):
    single = Environment(np.full((1, 1, 1), 2.0, np.float32), layout="angular")
    assert single.resolved_degree == 0
    found = cr.build_reflection(single, Lambert(), degree=0, order=0, rows=1, device=device)
    with pytest.raises(InputError, match="fine enough for degree 0"):
        cr.build_reflection(single, Lambert(), degree=1, order=0, rows=1, device=device)
    assert found.maps_khwc.shape == (1, 1, 2, 1)


def cosine_by_quadrature(l):
    """Return the coefficient of ``max(z, 0) / pi`` at order 0 of degree l."""
    integral = quad(lambda z: z * eval_legendre(l, z), 0, 1, epsabs=1e-13)[0]
    return 2.0 * integral * np.sqrt((2 * l + 1) / (4.0 * np.pi))


@pytest.mark.parametrize("kind", ["unshadowed", "shadowed", "interreflected"])
@pytest.mark.parametrize("degree", [0, 20])
@pytest.mark.parametrize("size", [1e-30, 1.0, 1e30])
def test_a_face_alone_sees_half_of_the_world(kind, degree, size):
    """Whatever its size and albedo: nothing of it sees any other part."""
    face = sheet((0, 0, 0), (size, 0, 0), (0, size, 0))
    exact = kind == "unshadowed"
    found = transfer_vertices(face, degree, kind, None if exact else 1 << 10)
    expected_k = np.zeros((degree + 1) ** 2)
    expected_k[[l * (l + 1) for l in range(degree + 1)]] = [cosine_by_quadrature(l) for l in range(degree + 1)]
    np.testing.assert_allclose(found[..., 0], np.tile(expected_k[:, None], 4), atol=1e-6 if exact else 2e-2)


@pytest.mark.parametrize("degree", [0, 20])
@pytest.mark.parametrize("way", ["gather", "shoot"])
def test_black_sends_nothing_on_and_white_no_more_than_the_world_has(degree, way):
    box, white = open_box(2), np.sqrt(4.0 * np.pi)
    black = replace(box, albedo_vc=np.zeros((box.n_vertex, 1), np.float32))
    assert not transfer_vertices(black, degree, "interreflected", 64, way=way, threshold=1e-2).any()
    direct = transfer_vertices(box, degree, "shadowed", 64)
    found = transfer_vertices(box, degree, "interreflected", 64, bounces=1000, way=way, threshold=1e-2)
    assert np.isfinite(found).all()
    assert (found[0] >= direct[0] - 1e-6).all()
    assert (found[0] * white <= 1.0 + 2e-2).all()
