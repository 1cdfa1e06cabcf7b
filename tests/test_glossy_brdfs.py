"""Reflectance functions: energy, reciprocity, and their moments over views against brute quadrature in float64."""

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.transfer.brdfs import BlinnPhong, Diffuse, Ggx, Phong, parse_brdf
from clrelight.transfer.lobes import frames_of, lobe_rule
from tests.reference import reflection
from tests.reference.basis import real_harmonics

CASES = {
    "diffuse": (Diffuse(0.8), lambda s, v: 0.8 / np.pi + 0 * (s * v).sum(-1)),
    "phong": (Phong(exponent=20), lambda s, v: reflection.phong(s, v, 20)),
    "phong with diffuse": (
        Phong(diffuse=0.3, specular=0.6, exponent=5),
        lambda s, v: 0.3 / np.pi + 0.6 * reflection.phong(s, v, 5),
    ),
    "blinn": (BlinnPhong(specular=0.5, exponent=40), lambda s, v: 0.5 * reflection.blinn(s, v, 40)),
    "ggx": (Ggx(specular=0.9, roughness=0.3), lambda s, v: reflection.ggx(s, v, 0.3, 0.9)),
    "rough ggx": (Ggx(specular=0.04, roughness=0.8), lambda s, v: reflection.ggx(s, v, 0.8, 0.04)),
}


def directions(count, seed):
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    vectors[:, 2] = abs(vectors[:, 2]) + 0.01
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("name", CASES)
def test_values_are_those_of_the_formula_and_reciprocal(name):
    brdf, formula = CASES[name]
    light, view = directions(500, 1), directions(500, 2)
    values = brdf.evaluate(light, view)
    np.testing.assert_allclose(values[:, 0], formula(light, view), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(brdf.evaluate(view, light), values, rtol=1e-9, atol=1e-12)
    assert values.min() >= 0
    below = light * [1, 1, -1]
    assert not brdf.evaluate(below, view).any()
    assert not brdf.evaluate(light, below).any()


@pytest.mark.parametrize(
    "brdf",
    [
        Diffuse(1.0),
        Phong(exponent=0),
        Phong(exponent=1000),
        BlinnPhong(exponent=1),
        BlinnPhong(exponent=300),
        Ggx(specular=1, roughness=0.2),
        Ggx(specular=1, roughness=1),
        Ggx(diffuse=1, specular=0.04, roughness=0.2),
        Ggx(diffuse=1, specular=0.5, roughness=0.6),
    ],
)
def test_no_more_light_leaves_than_arrives(brdf):
    nodes, weights = reflection.hemisphere(200, 400)
    for angle in (0, 20, 45, 70, 85):
        light = np.array([np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])
        reflected = (weights * nodes[:, 2]) @ brdf.evaluate(light, nodes)
        assert reflected.max() <= 1.003, angle


def test_a_lobe_along_the_normal_sends_on_its_strength():
    nodes, weights = reflection.hemisphere(200, 400)
    up = np.array([0, 0, 1.0])
    for brdf in (Phong(specular=0.7, exponent=30), BlinnPhong(specular=0.7, exponent=30), Diffuse(0.7)):
        np.testing.assert_allclose((weights * nodes[:, 2]) @ brdf.evaluate(up, nodes), 0.7, atol=1e-6)


@pytest.mark.parametrize("name", ["phong", "blinn", "ggx", "rough ggx"])
@pytest.mark.parametrize("angle", [0, 40, 75])
def test_the_rule_around_a_lobe_integrates_it(name, angle):
    brdf, formula = CASES[name]
    light = np.array([[np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))]])
    nodes, weights = reflection.hemisphere(300, 600)
    expected = real_harmonics(nodes, 4).T @ (weights * formula(light, nodes))
    views, solid = lobe_rule(light, brdf.lobe_width)
    assert views[..., 2].min() > -1e-12
    got = real_harmonics(views[0], 4).T @ (solid[0] * brdf.gloss(light, views[0])[:, 0])
    np.testing.assert_allclose(got, expected, atol=1e-3 * abs(expected).max())


def test_frames_are_frames():
    z = np.concatenate([directions(50, 3), -directions(50, 4), [[0, 0, 1], [0, 0, -1]]])
    frames = frames_of(z)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.tile(np.eye(3), (len(z), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-12)
    np.testing.assert_array_equal(frames[:, 2], z)


@pytest.mark.parametrize(
    ("text", "brdf"),
    [
        ("diffuse", Diffuse()),
        ("phong:20", Phong(exponent=20)),
        ("blinn:1e2", BlinnPhong(exponent=100)),
        ("ggx:0.3", Ggx(roughness=0.3)),
        ("phong", Phong()),
    ],
)
def test_brdfs_as_people_write_them(text, brdf):
    assert parse_brdf(text) == brdf
    assert parse_brdf(text).to_config()["brdf"] == text.partition(":")[0]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: parse_brdf("mirror"), "a BRDF is diffuse"),
        (lambda: parse_brdf("diffuse:3"), "a BRDF is diffuse"),
        (lambda: parse_brdf("phong:many"), "takes a number"),
        (lambda: parse_brdf("phong:-1"), "exponent"),
        (lambda: parse_brdf("phong:nan"), "exponent"),
        (lambda: parse_brdf("ggx:0"), "roughness"),
        (lambda: Phong(diffuse=0.6, specular=0.6), "together"),
        (lambda: Phong(specular=(0.1, 0.2)), "1 or 3 numbers"),
        (lambda: Ggx(diffuse=1.5), "from 0 to 1"),
        (lambda: Diffuse(specular=0.5), "no specular"),
        (lambda: Phong(diffuse="red"), "1 or 3 numbers"),
    ],
)
def test_what_is_no_brdf_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
