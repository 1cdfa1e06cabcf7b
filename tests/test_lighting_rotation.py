"""Rotation of coefficients: recursion against turns about z, against rotated functions, and maps on the device."""

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_blocks, rotation_blocks_zyz, rotation_matrix
from clrelight.lighting.light import Light, turn_about_z
from clrelight.lighting.rotation import rotate_light, rotate_lights, rotate_maps
from tests.reference.basis import real_harmonics, sphere_quadrature

EPS32 = 2.0**-24


def any_rotation(seed):
    numbers = np.random.default_rng(seed).standard_normal(4)
    return rotation_matrix("quaternion", numbers)


EULER = [(0, 0, 0), (20, 0, 30), (0, 90, 0), (10, 90, -70), (33, 180, 12), (15, 179.9, 1), (200, 1e-4, 5), (7, 45, 300)]


@pytest.mark.parametrize("degree", [0, 1, 2, 7, 30])
def test_blocks_are_orthogonal(degree):
    blocks = rotation_blocks(any_rotation(degree), degree)
    assert [block.shape for block in blocks] == [(2 * l + 1, 2 * l + 1) for l in range(degree + 1)]
    for block in blocks:
        np.testing.assert_allclose(block @ block.T, np.eye(len(block)), atol=1e-12)


def test_high_degrees_stay_exact():
    matrix = any_rotation(5)
    directions_i3 = sphere_quadrature(2)[0]
    before_ik, after_ik = (real_harmonics(at, 100)[:, -201:] for at in (directions_i3, directions_i3 @ matrix.T))
    block = rotation_blocks(matrix, 100)[-1]
    np.testing.assert_allclose(block @ block.T, np.eye(201), atol=1e-12)
    np.testing.assert_allclose(before_ik @ block.T, after_ik, atol=1e-11)


@pytest.mark.parametrize("angles", EULER)
def test_two_ways_agree(angles):
    matrix = rotation_matrix("euler", angles)
    for ours, other in zip(rotation_blocks(matrix, 12), rotation_blocks_zyz(matrix, 12), strict=True):
        # The angles of a matrix nearly about z are known to the square root of rounding only; their sum is not.
        np.testing.assert_allclose(ours, other, atol=1e-11)


def test_two_ways_agree_at_degree_30():
    matrix = any_rotation(1)
    for ours, other in zip(rotation_blocks(matrix, 30), rotation_blocks_zyz(matrix, 30), strict=True):
        np.testing.assert_allclose(ours, other, atol=1e-12)


def test_composition_and_inverse():
    first, second = any_rotation(2), any_rotation(3)
    one, two, both = (rotation_blocks(each, 30) for each in (first, second, second @ first))
    for a, b, c, back in zip(one, two, both, rotation_blocks(first.T, 30), strict=True):
        np.testing.assert_allclose(b @ a, c, atol=1e-12)
        np.testing.assert_allclose(back, a.T, atol=1e-12)


def test_rotate_then_project_is_project_then_rotate():
    degree, matrix = 9, any_rotation(4)
    axes_j3 = np.random.default_rng(4).standard_normal((3, 3))

    def function(directions_i3):
        return np.exp(directions_i3 @ axes_j3.T)  # of no finite degree

    # sharp enough a rule that what is left of higher degrees is rounding
    directions_i3, weights_i = sphere_quadrature(40)
    basis_ik = real_harmonics(directions_i3, degree) * weights_i[:, None]
    light = Light(basis_ik.T @ function(directions_i3))
    rotated_kc = basis_ik.T @ function(directions_i3 @ matrix)  # g(s) = f(R^T s)
    np.testing.assert_allclose(rotate_light(light, matrix).coeffs_kc, rotated_kc, atol=1e-12 * abs(rotated_kc).max())


def test_a_turn_about_z_is_the_one_of_lights():
    light = Light(np.random.default_rng(0).standard_normal((49, 3)))
    turned = rotate_light(light, rotation_matrix("axis", (0, 0, 2, 37)))
    np.testing.assert_allclose(turned.coeffs_kc, turn_about_z(light, np.radians(37)).coeffs_kc, atol=1e-13)


@pytest.mark.parametrize("degree", [2, 30])
def test_maps_on_the_device(degree):
    rng = np.random.default_rng(degree)
    maps_khwc = rng.standard_normal(((degree + 1) ** 2, 3, 5, 3)).astype(np.float32)
    matrix = any_rotation(6)
    turned = rotate_maps(maps_khwc, matrix)
    assert (turned.dtype, turned.shape) == (np.float32, maps_khwc.shape)
    blocks = rotation_blocks_zyz(matrix, degree)
    for l, block in enumerate(blocks):
        own = slice(l * l, (l + 1) ** 2)
        part = maps_khwc[own].reshape(2 * l + 1, -1).astype(np.float64)
        # matrix and sum are rounded: one for the matrix and one for each term and its place in the sum
        bound = (2 * l + 4) * EPS32 * (abs(block) @ abs(part))
        assert (abs(turned[own].reshape(2 * l + 1, -1) - block @ part) <= bound).all()
    back = rotate_maps(turned, matrix.T)
    np.testing.assert_allclose(back, maps_khwc, atol=1e-5)


@pytest.mark.parametrize("degree", [0, 2, 9, 40])
def test_many_turns_of_a_light_are_each_of_them(degree, monkeypatch):
    rng = np.random.default_rng(degree)
    light = Light(rng.standard_normal(((degree + 1) ** 2, 3)), "noise")
    matrices = np.array([rotation_matrix("axis", (1, 2, 0.5, 360 * step / 7)) for step in range(7)])
    together = list(rotate_lights(light, matrices))
    monkeypatch.setattr("clrelight.lighting.rotation._TURN_BYTES", 1)  # one by one
    alone = list(rotate_lights(light, matrices))
    assert len(together) == len(alone) == 7
    for matrix, first, second in zip(matrices, together, alone, strict=True):
        expected = rotate_light(light, matrix)
        np.testing.assert_allclose(first.coeffs_kc, expected.coeffs_kc, atol=1e-12)
        np.testing.assert_allclose(second.coeffs_kc, expected.coeffs_kc, atol=1e-12)
        assert first.config == expected.config
    assert list(rotate_lights(light, matrices[:0])) == []


def test_float32_matrices_are_orthogonal():
    identity = np.eye(31 * 31, dtype=np.float32)
    matrix = rotate_maps(identity, any_rotation(7)).astype(np.float64)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(31 * 31), atol=1e-6)


@pytest.mark.parametrize(
    ("form", "numbers", "moved"),
    [
        ("axis", (1, 0, 0, 90), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ("axis", (0, 0, -3, 90), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
        ("axis", (0, 5e-324, 0, 180), [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        ("quaternion", (1, 1, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ("quaternion", (-1e200, 0, 0, -1e200), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        ("euler", (90, 90, 0), [[0, 0, -1], [-1, 0, 0], [0, 1, 0]]),
    ],
)
def test_forms(form, numbers, moved):
    # Rows are where x, y and z go.
    np.testing.assert_allclose(rotation_matrix(form, numbers).T, moved, atol=1e-15)


@pytest.mark.parametrize(
    ("form", "numbers", "said"),
    [
        ("angles", (1, 2, 3), "a rotation is one of euler, quaternion, axis"),
        ("euler", (1, 2), "euler takes 3 finite numbers, got 1, 2"),
        ("euler", (1, 2, np.inf), "euler takes 3 finite numbers"),
        ("quaternion", (0, 0, 0, 0), "the quaternion of a rotation must not be all zeros"),
        ("axis", (0, 0, 0, 10), "the axis of a rotation must not be all zeros"),
    ],
)
def test_no_rotation(form, numbers, said):
    with pytest.raises(InputError, match=said):
        rotation_matrix(form, numbers)


def test_no_rotation_matrix():
    for matrix in (np.eye(3) * 1.1, np.diag([1.0, 1.0, -1.0]), np.eye(2), np.full((3, 3), np.nan)):
        with pytest.raises(InputError, match="orthogonal 3 by 3"):
            rotation_blocks(matrix, 2)
    with pytest.raises(InputError, match="degree must be 0 to 100"):
        rotation_blocks(np.eye(3), 101)
