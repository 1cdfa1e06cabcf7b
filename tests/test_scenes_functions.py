"""Raw functions of vertices against intersections with an analytic torus, with triangles one by one, and a sum."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight.codec import decode, encode
from clrelight.codec.formats.uniform import Uniform
from clrelight.codec.formats.wavelet import Wavelet
from clrelight.errors import InputError
from clrelight.jobs.fit import fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.sampling import make_pattern
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Ggx, Phong
from clrelight.transfer.functions import FixedLight, sample_transfer, sample_views
from datasets_synth.dama import MATERIALS, render_dama
from datasets_synth.studio import STUDIO, studio_lights, studio_radiance
from datasets_synth.torus import MAJOR, MINOR, render_torus, torus_surface
from tests.reference.torus import phong, torus_clearance, torus_is_hit, triangles_hit

pytest.importorskip("embreex")
DIRECTIONS = make_pattern("uniform", 64)


def test_torus_functions_are_cosine_times_analytic_visibility():
    surface = torus_surface(160, 160)
    stack = sample_transfer(surface, DIRECTIONS)
    assert stack.images_ihwc.shape == (64, 160, 160, 1)
    assert stack.images_ihwc.dtype == np.float32
    assert (stack.peak, stack.transfer, stack.surface) == (1.0, "linear", surface)
    checked = blocked = 0
    for vertex in (0, 31 * 160 + 40, 77 * 160 + 61, 90 * 160 + 80, 119 * 160 + 97, 150 * 160 + 118):
        frame, start = surface.frames()[vertex], surface.vertices_v3[vertex] + 1e-6 * surface.normals_v3[vertex]
        got = stack.images_ihwc.reshape(64, -1)[:, vertex]
        for i, local in enumerate(DIRECTIONS):
            direction = local @ frame
            if abs(torus_clearance(start, direction, MAJOR, MINOR)) < 4e-3:
                continue  # within what the mesh differs from the torus
            hit = torus_is_hit(start, direction, MAJOR, MINOR, least=1e-4)
            assert got[i] == pytest.approx(0.0 if hit else local[2], abs=1e-6)
            checked, blocked = checked + 1, blocked + hit
    assert checked > 250
    assert blocked > 40


def test_mesh_functions_by_brute_force_in_global_axes_with_albedo():
    whole = torus_surface(12, 10)
    rng = np.random.default_rng(3)
    albedo = rng.random((whole.n_vertex, 3), np.float32)
    surface = replace(whole, tangents_v3=None, albedo_vc=albedo)
    directions = make_pattern("uniform", 41, sphere=True)
    got = sample_transfer(surface, directions).images_ihwc.reshape(41, -1, 3)
    plain = sample_transfer(surface, directions, "unshadowed").images_ihwc.reshape(41, -1, 3)
    corners = surface.vertices_v3[surface.faces_f3]
    n_blocked = 0
    for vertex in range(0, whole.n_vertex, 7):
        start = surface.vertices_v3[vertex] + 1e-5 * surface.diagonal * surface.normals_v3[vertex]
        cosine = np.maximum(directions @ surface.normals_v3[vertex], 0.0)
        np.testing.assert_allclose(plain[:, vertex], cosine[:, None] * albedo[vertex], atol=1e-6)
        hits = np.array([triangles_hit(start, direction, corners, 0.0) for direction in directions])
        n_blocked += int((hits & (cosine > 0)).sum())
        np.testing.assert_allclose(got[:, vertex], (cosine * ~hits)[:, None] * albedo[vertex], atol=1e-6)
    assert n_blocked > 30


def test_what_the_torus_reflects_does_not_hang_on_where_it_is_around_the_axis():
    images = render_torus(size=32, lights=50).images_ihwc[..., 0]
    same = np.isclose(images, images[:, :1], atol=1e-6)
    assert same.mean() > 0.99  # rays that graze an edge of the mesh may differ
    assert np.abs(images[:, 0, 16]).sum() < np.abs(images[:, 0, 0]).sum()  # the inside lies in shadow


def plate():
    """Return a square that faces up, and above its middle a small square that faces down."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]])
    above = corners[::-1] * 0.5 + [0, 0, 0.5]
    up, right = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    return Surface(
        np.concatenate([corners, [[0, 0, 0.0]], above]),
        np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [5, 6, 7], [5, 7, 8]]),
        np.array([up] * 5 + [-up] * 4),
        np.array([right] * 9),
    )


def test_views_are_the_sum_over_lights_of_what_the_brdf_sends():
    lights = FixedLight(
        np.array([[0.0, 0, 1], [0.8, 0, 0.6], [0, -0.96, 0.28], [0, 0.6, -0.8]]),
        np.array([[1.0, 2, 3], [4, 1, 2], [3, 3, 3], [9, 9, 9]]),
    )
    brdf = Phong((0.4, 0.3, 0.2), (0.3, 0.3, 0.5), exponent=7.0)
    albedo = np.linspace(0.2, 1.0, 9, dtype=np.float32)[:, None]
    stack = sample_views(replace(plate(), albedo_vc=albedo), DIRECTIONS, lights, brdf)
    assert stack.surface.argument == "view"
    got = stack.images_ihwc.reshape(64, 9, 3)
    for vertex, seen in ((0, (0, 1, 2)), (4, (1, 2))):  # the middle has the small square before its zenith
        scale = np.array(brdf.diffuse) * albedo[vertex]
        for i in (0, 20, 63):
            sent = [
                e * s[2] * phong(s, DIRECTIONS[i], scale, brdf.specular, 7.0)
                for s, e in zip(lights.directions_l3[list(seen)], lights.irradiance_lc[list(seen)], strict=True)
            ]
            np.testing.assert_allclose(got[i, vertex], np.sum(sent, axis=0), rtol=1e-5)
    open_ = sample_views(plate(), DIRECTIONS, lights, brdf, shadowed=False).images_ihwc.reshape(64, 9, 3)
    np.testing.assert_allclose(open_[:, 4], open_[:, 1], rtol=1e-6)
    # A vertex that no light reaches is dark: of the small square, which faces down, only from below.
    below = FixedLight(lights.directions_l3[:1], lights.irradiance_lc[:1])
    assert not sample_views(plate(), DIRECTIONS, below, brdf).images_ihwc.reshape(64, 9, 3)[:, 5:].any()


@pytest.mark.parametrize("name", MATERIALS)
def test_materials_send_on_no_more_than_they_get_and_are_reciprocal(name):
    brdf = MATERIALS[name]
    nodes, weights = np.polynomial.legendre.leggauss(200)
    z, azimuth = 0.5 * (nodes + 1), 2 * np.pi * np.arange(256) / 256
    r = np.sqrt(1 - z * z)
    views = np.stack([np.outer(r, np.cos(azimuth)), np.outer(r, np.sin(azimuth)), np.outer(z, np.ones(256))], axis=-1)
    solid = np.outer(0.5 * weights, np.full(256, 2 * np.pi / 256))
    for light_z in (1.0, 0.7, 0.3, 0.05):
        light = np.array([np.sqrt(1 - light_z**2), 0.0, light_z])
        f = brdf.evaluate(light[None, None], views)
        assert ((f * (views[..., 2] * solid)[..., None]).sum(axis=(0, 1)) <= 1.0).all()
        np.testing.assert_allclose(brdf.evaluate(views[::9, ::31], light[None, None]), f[::9, ::31], rtol=1e-9)


def test_studio_lights_sum_to_its_radiance():
    light = studio_lights(per_area=30, room=200)
    total = light.irradiance_lc.sum(axis=0)
    dense = make_pattern("uniform", 400_000, sphere=True)
    np.testing.assert_allclose(total, studio_radiance(dense).mean(axis=0) * 4 * np.pi, rtol=0.01)
    for n, area in enumerate(STUDIO):
        apart = np.degrees(np.arccos(light.directions_l3[30 * n : 30 * n + 30] @ area.direction))
        assert 0.9 * area.radius < apart.max() <= area.radius


def test_fits_take_functions_as_they_are():
    stack = render_torus(size=16, lights=100)
    for method in ("uls", "sloan", "cls", "ceb", "spline", "spectrum"):
        made = fit(stack, method, degree=4)
        assert made.coeffs_khwc.shape == (25, 16, 16, 1)
        assert made.surface is stack.surface


def test_dama_is_glossy_and_shadowed():
    stack = render_dama(size=12, lights=60, material="blinn")
    assert stack.images_ihwc.shape == (60, 12, 12, 3)
    assert stack.surface.argument == "view"
    values = stack.images_ihwc.reshape(60, -1)
    assert np.median(values.max(axis=0) / np.maximum(values.min(axis=0), 1e-6)) > 1.5


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: sample_transfer(s, DIRECTIONS, "interreflected"), "kind must be one of unshadowed, shadowed"),
        (lambda s: sample_transfer(s, 2 * DIRECTIONS), "unit"),
        (lambda s: sample_transfer(replace(s, argument="view"), DIRECTIONS), "functions of the view, not of the light"),
        (lambda s: sample_views(replace(s, tangents_v3=None), DIRECTIONS, studio_lights(), Ggx()), "has no tangents"),
        (lambda s: sample_views(s, -DIRECTIONS, studio_lights(), Ggx()), "views must be above the surface"),
        (lambda s: FixedLight(DIRECTIONS, np.ones((3, 3))), r"irradiance must have shape \(64, 3\)"),
        (lambda s: FixedLight(DIRECTIONS, np.full((64, 3), -1.0)), "finite and not negative"),
        (lambda s: render_torus(size=7), "size must be at least 8"),
        (lambda s: render_torus(albedo="red"), "albedo must be one of white, tiles"),
        (lambda s: render_torus(dtype="int8"), "dtype must be one of"),
        (lambda s: render_dama(size=2), "size must be at least 8"),
        (lambda s: render_dama(material="wood"), "material must be one of phong, blinn, ggx"),
        (lambda s: render_dama(dtype="int8"), "dtype must be one of"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(InputError, match=message):
        call(torus_surface(4, 4))


@pytest.mark.parametrize("make", [render_torus, render_dama], ids=["torus", "dama"])
def test_noise_hurts_uls_most_then_sloan_and_neither_cls_nor_ceb(make, device):
    """The paper's finding at 49 coefficients: figures 5, 9, 13 and 6, 10, 14."""
    stack = make(size=24, lights=144)
    falls = {}
    for method in ("uls", "sloan", "cls", "ceb"):
        fitted = fit(stack, method, degree=6, device=device)
        plain = summarize_errors(measure_errors(fitted, stack, device=device)).psnr_mean
        for codec in (Uniform(bits=8), Wavelet(rate=4.0)):
            decoded_khwc = decode(encode(fitted.coeffs_khwc, codec, device).to_bytes(), device)
            coded = replace(fitted, coeffs_khwc=decoded_khwc)
            falls[method, codec.id] = plain - summarize_errors(measure_errors(coded, stack, device=device)).psnr_mean
    assert max(falls[method, codec] for method in ("cls", "ceb") for codec in ("uniform", "wavelet")) < 0.5
    assert falls["uls", "uniform"] > 6.0
    assert falls["cls", "uniform"] < falls["sloan", "uniform"] < falls["uls", "uniform"]
