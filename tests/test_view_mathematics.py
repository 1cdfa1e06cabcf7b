"""What the page's scripts compute of lights, against NumPy and SciPy: harmonics, lamps, skies and what a fit sees."""

import numpy as np
import pytest

from clrelight.codec.transforms.code_values import node_matrices
from clrelight.harmonics.quadrature import product_rule
from clrelight.lighting.light import Light, turn_about_z
from clrelight.lighting.sky import sky_light
from clrelight.view.lights import sky_tables
from clrelight.view.sources import analysis_columns, floats_text
from tests.javascript import DECODER, evaluate
from tests.reference.basis import real_harmonics

MATHEMATICS = (*DECODER, "harmonics.js", "lighting.js")


def mathematics(code, **data):
    return evaluate(code, data, MATHEMATICS)


def test_the_basis_is_ours():
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    directions = np.concatenate([directions, np.eye(3)])
    code = "return data.directions.map((direction) => [...clrelight.evaluateBasis(direction, data.degree)]);"
    for degree in (0, 4, 20):
        found = mathematics(code, directions=directions.tolist(), degree=degree)
        np.testing.assert_allclose(found, real_harmonics(directions, degree), atol=1e-12)


def test_light_is_turned_as_ours():
    rng = np.random.default_rng(2)
    coeffs = rng.standard_normal((49, 3))
    code = "return [...clrelight.turnAboutZ(Float64Array.from(data.coeffs), 3, data.angle)];"
    found = mathematics(code, coeffs=coeffs.ravel().tolist(), angle=0.7)
    np.testing.assert_allclose(np.reshape(found, (49, 3)), turn_about_z(Light(coeffs), 0.7).coeffs_kc, atol=1e-12)


def test_a_soft_lamp_is_the_mean_over_its_cap():
    angle, degree, direction = 25.0, 6, np.array([0.3, -0.4, np.sqrt(0.75)])
    code = "return [...clrelight.lampCoefficients(data.direction, data.angle, data.degree)];"
    found = mathematics(code, direction=direction.tolist(), angle=angle, degree=degree)
    rng = np.random.default_rng(3)
    height = 1 - rng.random(30_000) * (1 - np.cos(np.radians(angle)))
    turn, across = 2 * np.pi * rng.random(len(height)), np.sqrt(1 - height**2)
    u = np.cross(direction, [0.0, 0.0, 1.0])
    u /= np.linalg.norm(u)
    spread = np.outer(height, direction) + np.outer(across * np.cos(turn), u)
    spread += np.outer(across * np.sin(turn), np.cross(direction, u))
    np.testing.assert_allclose(found, real_harmonics(spread, degree).mean(axis=0), atol=1e-2)
    # A lamp whose cap reaches below the horizon keeps what is above it.
    low = np.array([np.cos(0.1), 0.0, np.sin(0.1)])
    found = mathematics(code, direction=low.tolist(), angle=40.0, degree=1)
    assert found[0] == pytest.approx(np.sqrt(1 / (4 * np.pi)))
    assert found[2] > np.sqrt(3 / (4 * np.pi)) * np.sin(0.1)


def test_skies_are_interpolated_between_ours():
    table = sky_tables(12)
    assert [each["name"] for each in table] == ["clear", "partly-cloudy", "overcast"]
    code = """
    const lighting = new clrelight.Lighting({ light_degree: 12, skies: data.skies, environments: [] });
    return data.asked.map(([sky, height]) => [...lighting.skyAt(sky, height)]);
    """
    asked = {(0, 35.0): 1e-6, (1, 37.0): 0.01, (2, 90.0): 1e-6}
    found = mathematics(code, skies=table, asked=list(asked))
    for (number, height), tolerance, coeffs in zip(asked, asked.values(), found, strict=True):
        made = sky_light(table[number]["name"], height, degree=12).coeffs_kc[:, 0]
        np.testing.assert_allclose(coeffs, made / (made[0] * np.sqrt(4 * np.pi)), atol=tolerance)


def test_what_a_fit_sees_is_the_upper_hemisphere_of_the_light():
    """Beside SciPy's harmonics and Gauss's rule of NumPy: of a light that lies, and of one that stands."""
    degree, wide = 3, 5
    height, share = np.polynomial.legendre.leggauss(12)
    z, azimuth = np.meshgrid((height + 1) / 2, 2 * np.pi * np.arange(24) / 24, indexing="ij")
    across = np.sqrt(1 - z**2)
    up = np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
    weight = np.repeat(share / 2 * 2 * np.pi / 24, 24)
    light = np.random.default_rng(4).standard_normal(((wide + 1) ** 2, 3))
    code = """
    const lighting = new clrelight.Lighting({ light_degree: data.wide, skies: [], environments: [] });
    return [false, true].map((standing) => [...lighting.seen(data.light, 3, standing, data.degree)]);
    """
    found = np.reshape(mathematics(code, light=light.ravel().tolist(), degree=degree, wide=wide), (2, -1, 3))
    for standing, coeffs in enumerate(found):
        about = up[:, [0, 2, 1]] * [1, -1, 1] if standing else up
        expected = (real_harmonics(up, degree) * weight[:, None]).T @ (real_harmonics(about, wide) @ light)
        np.testing.assert_allclose(coeffs, expected, atol=1e-12)


@pytest.mark.parametrize("degree", [0, 2, 7])
def test_coefficients_behind_the_curve_are_those_of_the_format(degree):
    code = """
    const columns = clrelight.floatsOf(data.columns);
    const { directions } = clrelight.productRule(data.degree);
    return [[...directions], [...clrelight.spreadOverAzimuths(columns, data.degree)]];
    """
    n_coeff = (degree + 1) ** 2
    columns = floats_text(analysis_columns(n_coeff))
    directions, matrix = mathematics(code, columns=columns, degree=degree)
    expected_i3, _ = product_rule(degree)
    np.testing.assert_allclose(np.reshape(directions, (-1, 3)), expected_i3, atol=1e-12)
    analysis_ki = node_matrices(n_coeff)[1]
    np.testing.assert_allclose(np.reshape(matrix, (n_coeff, -1)), analysis_ki, atol=1e-6 * abs(analysis_ki).max())


@pytest.mark.parametrize("degree", [0, 3])
def test_planes_behind_the_curve_become_coefficients_of_radiance(degree):
    """Beside sums over all nodes in NumPy; five pixels, for four are taken at a time."""
    n_coeff, planes, pixels, channels = (degree + 1) ** 2, 6, 5, 3
    rng = np.random.default_rng(7)
    operator_kcj = rng.standard_normal((n_coeff, channels, planes + 1)) / n_coeff
    values_jp = rng.standard_normal((8, pixels)).astype(np.float16)
    values_jp[planes:] = 0
    code = """
    const { straighten, floatsOf, productRule, evaluationOf } = clrelight;
    const { degree, planes, pixels } = data;
    const nodes = productRule(degree).directions;
    const evaluation = evaluationOf({ nodes, channels: 3, planes, operator: data.operator, degree });
    const curve = { planes, channels: 3, evaluation, columns: floatsOf(data.columns), degree };
    return [...straighten(Uint16Array.from(data.texels), pixels, curve)];
    """
    texels = values_jp.reshape(2, 4, pixels).swapaxes(1, 2).ravel().view(np.uint16)
    sent = {"degree": degree, "planes": planes, "pixels": pixels, "operator": operator_kcj.ravel().tolist()}
    found = mathematics(code, texels=texels.tolist(), columns=floats_text(analysis_columns(n_coeff)), **sent)
    layers = -(-n_coeff * channels // 4)
    found_qp = np.uint16(found).view(np.float16).reshape(layers, pixels, 4).swapaxes(1, 2).reshape(-1, pixels)

    directions_i3, _ = product_rule(degree)
    given_jp = np.concatenate([values_jp[:planes].astype(float), np.ones((1, pixels))])
    coded_icp = np.einsum("ik,kcj,jp->icp", real_harmonics(directions_i3, degree), operator_kcj, given_jp)
    size = np.abs(coded_icp)
    radiance_icp = np.sign(coded_icp) * np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    expected = np.einsum("ki,icp->kcp", node_matrices(n_coeff)[1], radiance_icp).reshape(-1, pixels)
    np.testing.assert_allclose(found_qp[: len(expected)], expected, rtol=2**-10, atol=1e-4 * np.abs(expected).max())
