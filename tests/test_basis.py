import numpy as np
import pytest

from clrelight.conventions import default_peak, linear_to_srgb, srgb_to_linear
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.decomposition import decompose
from clrelight.harmonics.index import coefficient_count, coefficient_index, degree_of
from clrelight.sampling import make_pattern
from tests.reference import basis as reference
from tests.reference import psnr


def random_directions(count, seed=0):
    v = np.random.default_rng(seed).standard_normal((count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_every_function_to_degree_100():
    directions = np.concatenate([random_directions(40), make_pattern("uniform", 20)])
    assert MAX_DEGREE == 100
    error = np.abs(evaluate_basis(directions, 100) - reference.real_harmonics(directions, 100))
    # The functions reach sqrt(2 l + 1) / sqrt(4 pi) = 4; rounding errors of the recurrence grow with l.
    for degree, bound in ((2, 2e-15), (10, 1e-14), (30, 4e-14), (100, 2e-13)):
        assert error[:, : (degree + 1) ** 2].max() < bound


def test_printed_forms_fix_order_and_sign():
    directions = random_directions(30)
    np.testing.assert_allclose(evaluate_basis(directions, 2), reference.closed_forms(directions), atol=2e-6)
    x = evaluate_basis(np.array([[1.0, 0.0, 0.0]]), 1)[0]
    np.testing.assert_allclose(x, [0.5 / np.sqrt(np.pi), 0, 0, np.sqrt(0.75 / np.pi)], atol=1e-16)


def test_a_lower_degree_is_a_prefix():
    directions = random_directions(7)
    np.testing.assert_array_equal(evaluate_basis(directions, 9)[:, :25], evaluate_basis(directions, 4))


def test_orthonormal_at_degree_30():
    directions, weights = reference.sphere_quadrature(30)
    basis = evaluate_basis(directions, 30)
    np.testing.assert_allclose(basis.T @ (weights[:, None] * basis), np.eye(31**2), atol=1e-12)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_poles_hold_zonal_functions_only(z):
    basis = evaluate_basis(np.array([[0.0, 0.0, z]]), 100)[0]
    l = np.arange(101)
    zonal = z**l * np.sqrt((2 * l + 1) / (4 * np.pi))
    expected = np.zeros(101**2)
    expected[l * (l + 1)] = zonal
    np.testing.assert_array_equal(basis[expected == 0], 0.0)
    np.testing.assert_allclose(basis, expected, rtol=1e-13)


def test_horizon_is_exact():
    azimuth = np.linspace(0, 2 * np.pi, 13)
    horizon = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(13)], axis=1)
    basis = evaluate_basis(horizon, 40)
    for l in range(41):
        for m in range(-l, l + 1):
            if (l + m) % 2:  # odd in z
                assert (basis[:, l * l + l + m] == 0).all()
    np.testing.assert_allclose(basis, reference.real_harmonics(horizon, 40), atol=4e-14)


def test_reflection_in_the_horizon():
    directions = random_directions(9)
    mirrored = evaluate_basis(directions * [1, 1, -1], 12)
    signs = np.concatenate([(-1.0) ** (l + np.arange(-l, l + 1)) for l in range(13)])
    np.testing.assert_array_equal(mirrored, signs * evaluate_basis(directions, 12))


@pytest.mark.parametrize("degree", [-1, 101])
def test_degree_out_of_range(degree):
    with pytest.raises(ValueError, match=f"0 to 100, got {degree}"):
        evaluate_basis(random_directions(1), degree)


def test_shape_of_directions():
    with pytest.raises(ValueError, match=r"\(n_light, 3\), got \(3,\)"):
        evaluate_basis(np.array([0.0, 0, 1]), 1)


def test_index_and_count():
    pairs = [(degree, m) for degree in range(12) for m in range(-degree, degree + 1)]
    assert [coefficient_index(*pair) for pair in pairs] == list(range(coefficient_count(11)))
    assert [degree_of(coefficient_count(d)) for d in range(40)] == list(range(40))
    for count in (0, -1, 2, 48, 50):
        with pytest.raises(ValueError, match=f"got {count}"):
            degree_of(count)
    with pytest.raises(ValueError, match="l=1, m=2"):
        coefficient_index(1, 2)


def test_decomposition_reproduces_the_basis():
    basis = evaluate_basis(make_pattern("uniform", 100), 6)
    svd = decompose(basis)
    np.testing.assert_allclose(svd.left_ir * svd.singular_r @ svd.right_kr.T, basis, atol=1e-14)
    np.testing.assert_allclose(svd.left_ir.T @ svd.left_ir, np.eye(49), atol=1e-13)
    np.testing.assert_allclose(svd.right_kr.T @ svd.right_kr, np.eye(49), atol=1e-13)
    assert (np.diff(svd.singular_r) <= 0).all()
    assert svd.condition == pytest.approx(np.linalg.cond(basis), rel=1e-9)


def test_decomposition_fixes_signs():
    basis = evaluate_basis(make_pattern("uniform", 72), 4)
    right = decompose(basis).right_kr
    size = np.abs(right)
    first = np.argmax(size > 0.999 * size.max(axis=0), axis=0)
    assert (right[first, np.arange(25)] > 0).all()
    # Another sign of all rows leaves the right side alone and turns the left one.
    np.testing.assert_allclose(decompose(-basis).left_ir, -decompose(basis).left_ir, atol=1e-12)


def test_decomposition_where_singular_values_coincide():
    # Rings of lights see cosine and sine of an order alike: LAPACK returns any mixture of the two.
    basis = evaluate_basis(make_pattern("grid", 144), 5)
    svd = decompose(basis)
    gap = -np.diff(svd.singular_r)
    assert np.sum(gap < 1e-12) >= 12
    np.testing.assert_allclose(svd.left_ir * svd.singular_r @ svd.right_kr.T, basis, atol=1e-13)
    np.testing.assert_allclose(svd.left_ir.T @ svd.left_ir, np.eye(36), atol=1e-11)
    np.testing.assert_allclose(svd.right_kr.T @ svd.right_kr, np.eye(36), atol=1e-12)
    for seed in range(3):
        order = np.random.default_rng(seed).permutation(144)
        other = decompose(basis[order])
        np.testing.assert_allclose(other.right_kr, svd.right_kr, atol=1e-9)
        np.testing.assert_allclose(other.left_ir, svd.left_ir[order], atol=1e-9)


def test_decomposition_of_few_or_equal_lights():
    few = evaluate_basis(make_pattern("uniform", 7), 4)
    assert decompose(few).singular_r.shape == (7,)
    twice = np.concatenate([few, few[:3]])
    svd = decompose(twice)
    assert svd.singular_r.shape == (7,)
    np.testing.assert_allclose(svd.left_ir * svd.singular_r @ svd.right_kr.T, twice, atol=1e-14)


def test_srgb_curve():
    values = np.concatenate([np.linspace(0, 2, 401), [0.04045, 0.0404501, 0.0031308, 0.0031309]])
    np.testing.assert_allclose(srgb_to_linear(values), psnr.decode(values), rtol=1e-15)
    np.testing.assert_allclose(linear_to_srgb(values), psnr.encode(values), rtol=1e-15)
    # The standard's rounded constants leave a step of 2e-7 at the break.
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(values)), values, atol=2e-7)


def test_default_peak():
    assert [default_peak(np.dtype(t)) for t in ("uint8", "uint16", "float16", "float32")] == [255, 65535, 1, 1]
