"""Haar wavelets on the square, and their triple products, against sums over all cells."""

import numpy as np
import pytest

from clrelight.bases.haar import (
    analyse,
    evaluate_haar,
    integrate_triple,
    keep_largest,
    level_roughness,
    multiply,
    synthesise,
    terms_for_energy,
)
from tests.reference.bases import haar_images


def coefficients(side, seed=0, share=1.0):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal(side * side)
    values[rng.random(side * side) > share] = 0.0
    return values


@pytest.mark.parametrize("side", [1, 2, 4, 8, 16])
def test_transform_is_the_sum_of_functions(side):
    coeffs = np.random.default_rng(side).standard_normal((side * side, 3))
    values = synthesise(coeffs)
    np.testing.assert_allclose(values, np.einsum("kyx,kc->yxc", haar_images(side), coeffs), rtol=0, atol=1e-12)
    np.testing.assert_allclose(analyse(values), coeffs, rtol=0, atol=1e-12)


@pytest.mark.parametrize("area", [2 * np.pi, 4 * np.pi])
def test_energy_is_kept(area):
    values = np.random.default_rng(0).standard_normal((16, 16))
    np.testing.assert_allclose((analyse(values, area) ** 2).sum(), (values**2).mean() * area, rtol=1e-13)


@pytest.mark.parametrize("side", [1, 2, 4])
def test_every_tripling_coefficient_is_the_dense_integral(side):
    images = haar_images(side)
    dense = np.einsum("iyx,jyx,kyx->ijk", images, images, images) * (2 * np.pi / side**2)
    unit = np.eye(side * side)
    found = [[[integrate_triple(f, g, h)[0] for h in unit] for g in unit] for f in unit]
    np.testing.assert_allclose(found, dense, rtol=0, atol=1e-12)


@pytest.mark.parametrize("share", [1.0, 0.2, 0.02])
def test_triple_product_of_sparse_functions(share):
    f, g, h = (coefficients(32, seed, share) for seed in (1, 2, 3))
    dense = (synthesise(f) * synthesise(g) * synthesise(h)).mean() * 2 * np.pi
    found, terms = integrate_triple(f, g, h)
    np.testing.assert_allclose(found, dense, rtol=0, atol=1e-12 * np.abs(f).sum())
    # Three pairs and six crosses at each of three types of a cell, of which a full square has 341.
    assert terms <= 1 + 341 * 15
    if share < 1.0:
        assert terms < 341 * 15 * share * 2


def test_a_product_is_the_sum_over_triples():
    f, g = coefficients(8, 1), coefficients(8, 2)
    expected = [integrate_triple(f, g, unit)[0] for unit in np.eye(64)]
    np.testing.assert_allclose(multiply(f, g), expected, rtol=0, atol=1e-12)


def test_shapes_that_do_not_match_are_refused():
    with pytest.raises(ValueError, match="one square"):
        integrate_triple(np.zeros(4), np.zeros(16), np.zeros(16))
    with pytest.raises(ValueError, match="square of cells"):
        analyse(np.zeros((4, 8)))


def test_a_point_has_few_terms():
    """One constant and three of each level, however many there are."""
    for level in (1, 3, 5):
        at = evaluate_haar(np.array([[0.3, -0.2, 0.9]]) / np.linalg.norm([0.3, -0.2, 0.9]), (1 << level) - 1)
        assert np.count_nonzero(at) == 1 + 3 * level


def test_fewest_terms_for_a_share_of_the_energy():
    coeffs = np.sqrt([0.5, 0.3, 0.15, 0.05])[[2, 0, 3, 1]]
    assert [terms_for_energy(coeffs, share) for share in (0.5, 0.51, 0.8, 0.949, 0.96, 1.0)] == [1, 2, 2, 3, 4, 4]
    assert terms_for_energy(np.zeros(4)) == 0
    channels = np.array([[1.0, 0.0], [0.0, 2.0]])
    assert terms_for_energy(channels, 0.8) == 1
    np.testing.assert_allclose(keep_largest(coeffs, 2) ** 2, [0, 0.5, 0, 0.3], atol=1e-15)


def test_roughness_grows_with_levels():
    found = level_roughness(7)
    assert found.shape == (64,)
    np.testing.assert_allclose(found[[0, 1, 3, 4, 15, 16, 63]], [1e-2, 4, 4, 16, 16, 64, 64])
