"""Monte Carlo light from expressions and maps, with its standard error, and products of lights."""

import math

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.errors import InputError
from clrelight.lighting.environment import Environment
from clrelight.lighting.expressions import parse_expression
from clrelight.lighting.sampled import look_up, multiply_lights, sample_light
from tests.commands import call, contents, succeed
from tests.reference.basis import real_harmonics, sphere_quadrature


def some_directions(count=200, seed=0):
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("text", "formula"),
    [
        ("max(0, z)", lambda x, y, z: np.maximum(0, z)),
        ("x*x + 2 * y - -z", lambda x, y, z: x * x + 2 * y + z),
        ("theta < 30 * deg", lambda x, y, z: (np.arccos(z) < np.pi / 6) * 1.0),
        ("0 < z <= 0.5", lambda x, y, z: ((z > 0) & (z <= 0.5)) * 1.0),
        ("where(phi > 0, 1, 0.2)", lambda x, y, z: np.where(np.arctan2(y, x) > 0, 1, 0.2)),
        ("exp(-theta ** 2 / 2)", lambda x, y, z: np.exp(-(np.arccos(z) ** 2) / 2)),
        ("max(x, y, z, 0) + min(1, abs(x))", lambda x, y, z: np.max([x, y, z, 0 * x], axis=0) + abs(x)),
        ("atan2(y, x) - phi + 3 % 2", lambda x, y, z: np.ones_like(x)),
        ("2", lambda x, y, z: np.full_like(x, 2)),
    ],
)
def test_expressions_say_what_python_would(text, formula):
    directions = some_directions()
    np.testing.assert_allclose(parse_expression(text)(directions)[:, 0], formula(*directions.T), atol=1e-12)


def test_three_expressions_are_colours():
    values = parse_expression("z > 0; 0.5; x")(some_directions())
    np.testing.assert_array_equal(values[:, 1], 0.5)
    assert values.shape == (200, 3)


@pytest.mark.parametrize(
    "text",
    [
        *(
            "",
            "1; 2",
            "x +",
            "q",
            "x.real",
            "x[0]",
            "'a'",
            "True",
            "None",
            "1j",
            "[1]",
            "(1, 2)",
            "{x}",
            "x if y else z",
        ),
        *(
            "lambda: 1",
            "__import__('os')",
            "open('f')",
            "eval('1')",
            "max(z, key=abs)",
            "max(z)",
            "sin(x, y)",
            "x := 1",
        ),
        *("(x)(y)", "x and y", "not x", "x == y", "x // y", "x << 1", "~x", "f'{x}'", "*x", "sin", "max.__class__"),
        *("[z for z in x]", "1e999", "9" * 400, "x" + "+x" * 600, "-" * 990 + "x", "(" * 300 + "x" + ")" * 300, "x\0"),
        *(
            "().__class__.__bases__[0]",
            "getattr(x, 'y')",
            "print(1)",
            "abs(*x)",
            "sqrt(x, **y)",
            "await x",
            "x; import os; 1",
        ),
    ],
)
def test_everything_else_is_refused(text):
    if text == "(" * 300 + "x" + ")" * 300:
        text = text.replace("x", "q")  # parentheses alone are no harm
    with pytest.raises(InputError) as told:
        parse_expression(text)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("text", ["1 / 0", "log(-1 - x * x)", "9 ** 9 ** 9", "sqrt(-2)", "1 / (x - x)"])
def test_values_that_are_not_finite_are_told(text):
    with pytest.raises(InputError, match="at direction"):
        parse_expression(text)(some_directions())


def test_the_standard_error_is_that():
    """Over many seeds the deviations from the truth have the size that each estimate tells of itself."""
    truth = np.zeros(9)
    truth[:] = [math.sqrt(math.pi) / 2, 0, math.sqrt(math.pi / 3), 0, 0, 0, math.sqrt(5 * math.pi) / 8, 0, 0]
    deviations, told = [], []
    for seed in range(30):
        light, error = sample_light(parse_expression("max(0, z)"), 2, 800, seed=seed)
        deviations.append(light.coeffs_kc[:, 0] - truth)
        told.append(error[:, 0])
    ratio = np.sqrt(np.mean(np.square(deviations), axis=0) / np.mean(np.square(told), axis=0))
    assert ratio.min() > 0.6
    assert ratio.max() < 1.5
    assert light.config["samples"] == 800


def test_a_map_is_looked_up():
    rng = np.random.default_rng(3)
    radiance = rng.random((8, 16, 3)).astype(np.float32)
    environment = Environment(radiance, "latlong", "right,forward,up")
    at, _ = environment.geometry()
    np.testing.assert_allclose(look_up(environment)(at), radiance.reshape(-1, 3))
    turned = Environment(radiance, "latlong", "left,back,up")
    at, _ = turned.geometry()
    np.testing.assert_allclose(look_up(turned)(at), radiance.reshape(-1, 3))


def test_products_against_quadrature():
    rng = np.random.default_rng(1)
    first, second = cr.Light(rng.standard_normal((16, 3))), cr.Light(rng.standard_normal((9, 1)))
    nodes, weights = sphere_quadrature(10)
    values = (real_harmonics(nodes, 3) @ first.coeffs_kc) * (real_harmonics(nodes, 2) @ second.coeffs_kc)
    for degree in (None, 5, 1):
        made = multiply_lights(first, second, degree)
        expected = (real_harmonics(nodes, made.degree) * weights[:, None]).T @ values
        assert made.degree == (3 if degree is None else degree)
        np.testing.assert_allclose(made.coeffs_kc, expected, atol=1e-10)
    with pytest.raises(InputError, match="degree"):
        multiply_lights(first, second, 101)


def test_project_and_product_commands(tmp_path):
    succeed("project", tmp_path / "lobe.h5", "--expr", "max(0, z)", "--degree", 2, "--samples", 20000)
    told = succeed("project", tmp_path / "lobe.h5", "--expr", "max(0, z)", "--degree", 2, "--json").json
    held = cr.read_light(tmp_path / "lobe.h5")
    assert (told["degree"], told["channels"], held.source) == (2, 1, "max(0, z)")
    assert abs(held.coeffs_kc[2, 0] - math.sqrt(math.pi / 3)) < 6 * told["largest_error"] < 1e-2
    again = succeed("project", tmp_path / "lobe.h5", "--expr", "max(0, z)", "--degree", 2, "--json").json
    assert again["error"] == told["error"]
    succeed("product", tmp_path / "lobe.h5", tmp_path / "lobe.h5", tmp_path / "both.h5", "--degree", 4)
    both = cr.read_light(tmp_path / "both.h5").coeffs_kc[:, 0]
    np.testing.assert_allclose(both[0], (held.coeffs_kc[:, 0] ** 2).sum() * np.sqrt(0.25 / np.pi), rtol=1e-9)


def test_a_map_is_projected_by_the_command(tmp_path):
    image = oiio.ImageBuf(oiio.ImageSpec(32, 16, 3, "float"))
    oiio.ImageBufAlgo.fill(image, (0.2, 0.5, 1.0))
    image.write(str(tmp_path / "flat.exr"))
    told = succeed(
        "project", tmp_path / "flat.h5", "--env", tmp_path / "flat.exr", "--degree", 1, "--samples", 800, "--json"
    )
    light = cr.read_light(tmp_path / "flat.h5").coeffs_kc
    np.testing.assert_allclose(light[0], np.sqrt(4 * np.pi) * np.array([0.2, 0.5, 1.0]), rtol=1e-3)
    assert told.json["channels"] == 3


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("project o.h5", "by one of --expr"),
        ("project o.h5 --expr z --env missing.hdr", "by one of --expr"),
        ("project o.h5 --expr z --axes camera", "is for maps"),
        ("project o.h5 --expr import", "no expression"),
        ("project o.h5 --expr 1/0", "at direction"),
        ("project o.h5 --expr z --samples 3", "samples"),
        ("product missing.h5 missing.h5 o.h5", "missing.h5"),
    ],
)
def test_bad_input_is_told_in_a_line(tmp_path, monkeypatch, line, words):
    monkeypatch.chdir(tmp_path)
    ended = call(*line.split())
    assert (ended.code, ended.out) == (2, "")
    assert words in ended.err
    assert ended.err.count("\n") == 1
    assert contents(tmp_path) == {}
