"""Glossy operators against direct integration in float64, diffuse transfer, and each other."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.harmonics.rotation_batch import rotate_many
from clrelight.surface import Surface
from clrelight.transfer.brdfs import BlinnPhong, Diffuse, Ggx, Phong
from clrelight.transfer.lobes import frames_of
from clrelight.transfer.operator_plan import EXTENSIONS, extension_matrix, plan_operators
from clrelight.transfer.operators import transfer_operators
from clrelight.transfer.reflection import add_diffuse, operator_degrees, reflect, reflect_map, reflected_coefficients
from clrelight.transfer.samples import Samples
from clrelight.transfer.transport import transfer_vertices
from tests.reference import reflection
from tests.reference.basis import real_harmonics

pytest.importorskip("embreex")
UP = np.array([0.0, 0.0, 1.0])


def turn(seed):
    """Return a rotation."""
    q, r = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def patch(tangents=True, albedo=None, matrix=None):
    """Return a triangle that faces up, turned as a whole."""
    rotation = np.eye(3) if matrix is None else matrix
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]) @ rotation.T
    normals, along = np.tile(rotation[:, 2], (3, 1)), np.tile(rotation[:, 0], (3, 1))
    return Surface(corners, np.array([[0, 1, 2]]), normals, along if tangents else None, albedo_vc=albedo)


def walled():
    """Return a floor whose vertices see a wall: x > 0 is hidden up to 45 degrees above the first vertex."""
    floor = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0.0]])
    wall = np.array([[1, -20, 0], [1, 20, 0], [1, -20, 1], [1, 20, 1.0]])
    vertices = np.concatenate([floor, wall])
    normals = np.concatenate([np.tile(UP, (3, 1)), np.tile([-1.0, 0, 0], (4, 1))])
    return Surface(vertices, np.array([[0, 1, 2], [3, 4, 5], [4, 6, 5]]), normals, frames_of(normals)[:, 0])


def unwalled(s, height=0.0):
    """Return where light `height` above `walled`'s first vertex comes from."""
    return ~((s[..., 0] > 0) & (s[..., 2] < (1 - height) * s[..., 0]))


def matrices(operators, vertex=0, channel=0):
    light, view = operator_degrees(operators)
    flat = np.asarray(operators.coeffs_khwc)[:, vertex, 0, channel]
    return flat.reshape((view + 1) ** 2, (light + 1) ** 2)


@functools.cache
def open_moments(formula):
    return reflection.view_moments(formula, 3, 40, 80)


@pytest.mark.parametrize(
    ("brdf", "formula", "bound"),
    [
        (Phong(exponent=20), lambda s, v: reflection.phong(s, v, 20), 2e-4),
        (Phong(exponent=100), lambda s, v: reflection.phong(s, v, 100), 2e-4),
        (BlinnPhong(exponent=40), lambda s, v: reflection.blinn(s, v, 40), 3e-4),
        (Ggx(specular=0.7, roughness=0.6), lambda s, v: reflection.ggx(s, v, 0.6, 0.7), 1e-3),
    ],
    ids=lambda each: getattr(each, "id", ""),
)
@pytest.mark.parametrize("extension", ["zero", "least-squares"])
def test_operator_is_the_double_integral(brdf, formula, bound, extension):
    expected = open_moments(formula)
    if extension == "least-squares":
        expected = np.linalg.solve(reflection.half_gram(3), expected)
    made = transfer_operators(patch(), brdf, 3, samples=1024, extension=extension)
    assert (made.coeffs_khwc.shape, made.degree, made.method) == ((256, 3, 1, 1), 15, "operator")
    grown = 1 if extension == "zero" else np.linalg.cond(reflection.half_gram(3)) ** 0.5
    np.testing.assert_allclose(matrices(made), expected, atol=bound * grown)


def test_shadows_cut_the_light():
    visible = transfer_operators(walled(), Phong(exponent=10), 3, samples=4096, extension="zero")
    brute = reflection.view_moments(lambda s, v: reflection.phong(s, v, 10), 3, 48, 96, visible=unwalled)
    open_sky = reflection.view_moments(lambda s, v: reflection.phong(s, v, 10), 3, 40, 80)
    assert abs(brute - open_sky).max() > 0.05
    np.testing.assert_allclose(matrices(visible), brute, atol=5e-3)
    np.testing.assert_allclose(
        matrices(transfer_operators(walled(), Phong(exponent=10), 3, extension="zero", shadowed=False)),
        open_sky,
        atol=2e-4,
    )


def transfer_vector(surface, degree, samples):
    """Return diffuse transfer of the first vertex in float64, by the plan's own directions and analytic shadows."""
    plan = plan_operators(Diffuse(), degree, samples=samples)
    local, frame = plan.lights_s3, surface.frames()[0]
    # The solid angles are read off the table of constants: matte light from s goes everywhere alike.
    table = plan.matte_sd.reshape(samples, (degree + 1) ** 2, -1)[:, 0, 0].astype(np.float64)
    weights = table / (np.sqrt(4 * np.pi) / np.pi * np.sqrt(0.25 / np.pi) * local[:, 2])
    np.testing.assert_allclose(weights.sum(), 2 * np.pi, rtol=1e-5)
    seen = unwalled(local @ frame, 1e-5 * surface.diagonal)  # rays start a little above
    return (weights / np.pi * local[:, 2] * seen) @ real_harmonics(local @ frame, degree)


@pytest.mark.parametrize("extension", ["smooth", "least-squares", "mirror"])
def test_the_diffuse_operator_is_the_transfer_vector(extension):
    surface = walled()
    made = transfer_operators(surface, Diffuse(), 4, samples=1000, extension=extension)
    expected = transfer_vector(surface, 4, 1000)
    got = matrices(made, 0)
    np.testing.assert_allclose(got[0] * np.sqrt(0.25 / np.pi), expected, atol=1e-5)
    np.testing.assert_allclose(got[1:], 0, atol=1e-5)
    # Under constant light of radiance 1 half the sky of the cosine is left: 1/2 + cos(45 degrees) / 2 of it.
    light = np.zeros((25, 1))
    light[0] = np.sqrt(4 * np.pi)
    np.testing.assert_allclose(reflect(made, light, UP)[0, 0, 0], 0.5 + np.sqrt(0.125), atol=3e-3)


def test_white_surfaces_under_white_light():
    light = np.zeros((1, 1))
    light[0] = np.sqrt(4 * np.pi)
    for brdf, radiance in ((Diffuse(0.5), 0.5), (Phong(exponent=0, specular=1), None)):
        made = reflected_coefficients(transfer_operators(patch(), brdf, 4), light)
        if radiance is not None:
            np.testing.assert_allclose(made[0] * np.sqrt(0.25 / np.pi), radiance, atol=1e-5)
            np.testing.assert_allclose(made[1:], 0, atol=1e-5)
        else:
            np.testing.assert_allclose(real_harmonics(UP[None], 4)[0] @ made[:, 0, 0, 0], 1, atol=0.02)


def test_operators_are_reciprocal():
    """With the view's cosine too, an integral over both hemispheres is the same from light to view and back."""
    made = matrices(
        transfer_operators(
            patch(), Ggx(diffuse=0.3, specular=0.8, roughness=0.6), 4, view_degree=5, samples=4096, extension="zero"
        )
    )
    nodes, weights = sphere(8)
    times_z = (real_harmonics(nodes, 4) * (weights * nodes[:, 2])[:, None]).T @ real_harmonics(nodes, 5)
    both = times_z @ made
    assert abs(both).max() > 0.1
    np.testing.assert_allclose(both, both.T, atol=2e-4)


def test_frames_turn_with_the_surface():
    """In its own frame a turned surface under turned light reflects what it did; in common axes views turn too."""
    light = np.random.default_rng(5).standard_normal((25, 3))
    brdf = Phong(exponent=8, diffuse=0.2, specular=0.7)
    rotation = turn(3)
    up = transfer_operators(patch(), brdf, 4)
    expected = reflected_coefficients(up, light)
    turned_light = np.empty_like(light)
    nodes, weights = sphere(9)
    turned_light = (real_harmonics(nodes, 4) * weights[:, None]).T @ (real_harmonics(nodes @ rotation, 4) @ light)
    own = transfer_operators(patch(matrix=rotation), brdf, 4)
    np.testing.assert_allclose(reflected_coefficients(own, turned_light), expected, atol=2e-5)
    common = transfer_operators(patch(tangents=False, matrix=rotation), brdf, 4, samples=4096)
    for seed in range(5):
        view = turn(seed + 50)[0]
        there = rotation @ view
        np.testing.assert_allclose(
            reflect(common, turned_light, there),
            np.einsum("k,khwc->hwc", real_harmonics(view[None], 4)[0], expected),
            atol=2e-3,
        )
        np.testing.assert_allclose(
            reflect(own, turned_light, there),
            np.einsum("k,khwc->hwc", real_harmonics(view[None], 4)[0], expected),
            atol=2e-5,
        )


def sphere(degree):
    node, weight = np.polynomial.legendre.leggauss(degree + 1)
    z, azimuth = np.meshgrid(node, 2 * np.pi * np.arange(2 * degree + 1) / (2 * degree + 1), indexing="ij")
    r = np.sqrt(1 - z * z)
    nodes = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
    return nodes, np.repeat(weight * 2 * np.pi / (2 * degree + 1), 2 * degree + 1)


@pytest.mark.parametrize("channels", [1, 3])
def test_light_may_be_turned_when_it_is_used(channels):
    light = np.random.default_rng(6).standard_normal((25, channels))
    brdf = Phong(exponent=8, diffuse=(0.2, 0.3, 0.1), specular=0.6)
    surface = walled()
    common = transfer_operators(surface, brdf, 4, samples=256)
    local = transfer_operators(surface, brdf, 4, samples=256, light_frame="local")
    assert abs(common.coeffs_khwc - local.coeffs_khwc).max() > 0.1
    expected = reflected_coefficients(common, light)
    np.testing.assert_allclose(reflected_coefficients(local, light), expected, atol=1e-5)
    np.testing.assert_allclose(reflect(local, light, UP), reflect(common, light, UP), atol=1e-5)
    with pytest.raises(InputError, match="tangents"):
        transfer_operators(patch(tangents=False), brdf, 4, light_frame="local")
    with pytest.raises(InputError, match="no surface"):
        reflected_coefficients(replace(local, surface=None), light)


def test_rotations_into_frames():
    frames = np.stack([turn(seed) for seed in range(6)])
    coeffs = np.random.default_rng(1).standard_normal(36)
    local = rotate_many(np.eye(36), frames) @ coeffs
    directions = np.random.default_rng(2).standard_normal((40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for frame, turned in zip(frames, local, strict=True):
        # A direction d of the frame is F^T d in common axes.
        np.testing.assert_allclose(
            real_harmonics(directions, 5) @ turned, real_harmonics(directions @ frame, 5) @ coeffs, atol=1e-10
        )


def test_albedo_scales_what_is_matte():
    albedo = np.array([[0.1, 0.5, 1.0]] * 3, np.float32)
    plain = transfer_operators(patch(), Phong(diffuse=0.4, specular=0.5, exponent=9), 2)
    dull = transfer_operators(patch(), Phong(diffuse=0.4, specular=0.0, exponent=9), 2)
    painted = transfer_operators(patch(albedo=albedo), Phong(diffuse=0.4, specular=0.5, exponent=9), 2)
    assert painted.image_shape == (3, 1, 3)
    gloss = plain.coeffs_khwc - dull.coeffs_khwc
    np.testing.assert_allclose(painted.coeffs_khwc, gloss + dull.coeffs_khwc * albedo[:1], atol=1e-6)
    coloured = transfer_operators(patch(), Ggx(diffuse=(0.1, 0.2, 0.3), specular=(0.9, 0.6, 0.2)), 2)
    assert coloured.image_shape == (3, 1, 3)


def test_a_transfer_vector_is_added_to_the_constant_row():
    surface = patch(tangents=False)
    gloss = transfer_operators(surface, Phong(specular=0.5, exponent=9), 3)
    vectors = np.random.default_rng(0).random((25, 3, 1, 3)).astype(np.float32)
    transfer = CoefficientMap(vectors, 4, "transfer", 1.0, "linear", UP[None], surface=surface)
    light = np.random.default_rng(1).standard_normal((16, 3))
    both = add_diffuse(gloss, transfer)
    expected = reflect(gloss, light, UP) + np.einsum("khwc,kc->hwc", vectors[:16], light)
    np.testing.assert_allclose(reflect(both, light, UP), expected, atol=1e-4)
    with pytest.raises(InputError, match="does not go with"):
        add_diffuse(transfer_operators(surface, Phong(), 6), transfer)
    with pytest.raises(InputError, match="no operators"):
        add_diffuse(transfer, transfer)
    own = CoefficientMap(vectors, 4, "transfer", 1.0, "linear", UP[None], surface=patch())
    with pytest.raises(InputError, match="frames"):
        add_diffuse(gloss, own)


def test_tiles_do_not_show():
    rng = np.random.default_rng(4)
    vertices = rng.random((30, 3))
    normals = np.stack([turn(seed)[0] for seed in range(30)])
    surface = Surface(vertices, rng.permutation(30)[:27].reshape(9, 3), normals)
    whole = transfer_operators(surface, Phong(exponent=6), 2, samples=64)
    told = []
    parts = transfer_operators(
        surface, Phong(exponent=6), 2, samples=64, memory=60_000, progress=lambda *step: told.append(step)
    )
    assert len(told) > 2
    assert told[-1] == (30, 30)
    np.testing.assert_allclose(parts.coeffs_khwc, whole.coeffs_khwc, atol=1e-6)
    with pytest.raises(InputError, match="--memory"):
        transfer_operators(surface, Phong(), 2, memory=1000)


def test_reflected_radiance_is_a_map_of_views():
    light = np.random.default_rng(1).standard_normal((9, 1))
    made = transfer_operators(patch(), Phong(exponent=6), 4, view_degree=3)
    assert (operator_degrees(made), made.n_coeff, made.degree) == ((4, 3), 400, 19)
    seen = reflect_map(made, light)
    assert (seen.degree, seen.surface.argument, seen.image_shape) == (3, "view", (3, 1, 1))
    view = turn(1)[0]
    np.testing.assert_allclose(
        np.einsum("k,khwc->hwc", real_harmonics(view[None], 3)[0], seen.coeffs_khwc),
        reflect(made, light, view),
        atol=1e-5,
    )
    with pytest.raises(InputError, match="no operators"):
        reflect_map(seen, light)
    for views in ((0, 0, 2), (0, 1), np.zeros((2, 3))):
        with pytest.raises(InputError, match="unit vector"):
            reflect(made, light, views)
    with pytest.raises(InputError, match="light must be"):
        reflect(made, light[:, 0], UP)


@pytest.mark.parametrize("extension", EXTENSIONS)
def test_constants_stay(extension):
    moments = reflection.half_gram(4)[:, 0] * np.sqrt(4 * np.pi)
    made = extension_matrix(4, extension) @ moments
    expected = np.zeros(25)
    expected[0] = np.sqrt(4 * np.pi)
    if extension == "zero":
        assert made[0] == pytest.approx(expected[0] / 2)
    else:
        np.testing.assert_allclose(made, expected, atol=1e-9)


def test_smoothing_keeps_coefficients_small():
    """The paper's theme: least squares over a hemisphere makes large coefficients; smoothing does not."""
    smooth, plain = (
        matrices(transfer_operators(patch(), Phong(exponent=20), 4, extension=each))
        for each in ("smooth", "least-squares")
    )
    assert (smooth**2).sum() < 0.1 * (plain**2).sum()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"degree": -1}, "degree"),
        ({"degree": 40}, "degree"),
        ({"samples": 3}, "at least 16"),
        ({"extension": "none"}, "extended by"),
    ],
)
def test_what_cannot_be_planned_is_refused(options, words):
    with pytest.raises(InputError, match=words):
        plan_operators(Phong(), **options)


def test_diffuse_operators_are_transfer_of_the_same_directions():
    """Row by row, with the directions that each vertex looks in handed to `transfer_vertices`."""
    rng = np.random.default_rng(8)
    vertices = rng.random((24, 3))
    normals = np.stack([turn(seed)[0] for seed in range(24)])
    surface = Surface(vertices, rng.permutation(24).reshape(8, 3), normals, frames_of(normals)[:, 0])
    made = transfer_operators(surface, Diffuse(), 4, samples=500)
    plan = plan_operators(Diffuse(), 4, samples=500)
    table = plan.matte_sd.reshape(500, 25, 25)[:, 0, 0].astype(np.float64)
    weights = table / (np.sqrt(4 * np.pi) / np.pi * np.sqrt(0.25 / np.pi) * plan.lights_s3[:, 2])
    common = replace(surface, tangents_v3=None)
    open_sky = transfer_operators(surface, Diffuse(), 4, samples=500, shadowed=False)
    assert abs(open_sky.coeffs_khwc - made.coeffs_khwc).max() > 0.1
    for vertex in range(0, 24, 5):
        looked = plan.lights_s3 @ surface.frames()[vertex]
        samples = Samples(looked / np.linalg.norm(looked, axis=1, keepdims=True), weights, False)
        expected = transfer_vertices(common, 4, "shadowed", samples)[:, vertex, 0]
        np.testing.assert_allclose(matrices(made, vertex)[0] * np.sqrt(0.25 / np.pi), expected, atol=1e-5)
