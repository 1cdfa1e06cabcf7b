"""Bases of the hemisphere against their published formulas, and what they integrate to."""

import numpy as np
import pytest

from clrelight.bases import basis_ids, basis_of, gram_matrix, harmonics_seen, require_sh
from clrelight.bases.octahedral import hemisphere_to_square, sphere_to_square, square_to_hemisphere, square_to_sphere
from clrelight.bases.products import seen_light
from clrelight.bases.registry import register
from clrelight.errors import InputError
from tests.reference import bases as reference
from tests.reference.basis import real_harmonics

POLAR = ("hsh", "gram-schmidt", "zernike", "makhotkin")
ALL = ("sh", *POLAR, "haar")


def directions(count=500, seed=0):
    rng = np.random.default_rng(seed)
    vectors = rng.standard_normal((count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    vectors[:3] = [[0, 0, 1], [1, 0, 0], [0, -1, 1e-9]]
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_ids_are_those_of_the_pages():
    assert tuple(basis_ids()) == ALL


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("degree", [0, 1, 3, 7])
def test_functions_are_the_published_ones(name, degree):
    found = basis_of(name).evaluate(directions(), degree)
    expected = reference.FUNCTIONS[name](directions(), degree)
    assert found.shape == (500, basis_of(name).count(degree))
    # Here QR's triangle has the condition of harmonics on a hemisphere, and 1 - x^2 loses digits at the horizon.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-10)


@pytest.mark.parametrize("name", POLAR)
@pytest.mark.parametrize("degree", [0, 4, 15, 24])
def test_functions_are_orthonormal(name, degree):
    nodes, weights = reference.hemisphere_quadrature(degree + 1)
    weights = weights * nodes[:, 2] if basis_of(name).weight == "cosine" else weights
    values = basis_of(name).evaluate(nodes, degree)
    np.testing.assert_allclose((values * weights[:, None]).T @ values, np.eye((degree + 1) ** 2), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_gram_matrix(name):
    np.testing.assert_allclose(gram_matrix(name, 3), reference.gram(name, 3), rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["sh", *POLAR])
def test_integrals_with_harmonics(name):
    nodes, weights = reference.root_quadrature(160, 40)
    expected = (reference.FUNCTIONS[name](nodes, 5) * weights[:, None]).T @ real_harmonics(nodes, 8)
    np.testing.assert_allclose(harmonics_seen(name, 5, 8), expected, rtol=0, atol=1e-11)


def haar_integrals(side, degree):
    """Return the integrals of Haar's functions with harmonics, by small steps in height and azimuth."""
    nodes, weights = reference.hemisphere_quadrature(250)
    row, column = (np.clip(((v + 1) / 2 * side).astype(int), 0, side - 1) for v in reversed(reference.square_of(nodes)))
    sums = np.zeros((side * side, (degree + 1) ** 2))
    np.add.at(sums, row * side + column, real_harmonics(nodes, degree) * weights[:, None])
    return reference.haar_images(side).reshape(side * side, -1) @ sums


def test_integrals_of_haar_with_harmonics():
    found = harmonics_seen("haar", 3, 4)
    np.testing.assert_allclose(found, haar_integrals(4, 4), rtol=0, atol=4e-3)  # what the small steps miss
    np.testing.assert_allclose(found[0, 0], np.sqrt(0.5), rtol=1e-12)


@pytest.mark.parametrize("name", ["sh", *POLAR])
def test_light_through_a_basis(name):
    light_kc = np.random.default_rng(1).standard_normal((25, 3))
    nodes, weights = reference.root_quadrature(80, 24)
    values = reference.FUNCTIONS[name](nodes, 3)
    expected = (values * weights[:, None]).T @ (real_harmonics(nodes, 4) @ light_kc)
    np.testing.assert_allclose(seen_light(name, 3, light_kc), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", ALL[1:])
def test_nothing_is_known_below_the_horizon(name):
    below = np.array([[0.6, 0.0, -0.8], [0.0, 0.0, -1.0]])
    assert not basis_of(name).evaluate(below, 3).any()
    level = basis_of(name).evaluate(np.array([[0.6, 0.8, -1e-9]]), 3)
    np.testing.assert_allclose(level, basis_of(name).evaluate(np.array([[0.6, 0.8, 0.0]]), 3), atol=1e-3)


@pytest.mark.parametrize("degree", [0, 1, 4, 8])
def test_gram_schmidt_becomes_harmonics_exactly(degree):
    basis = basis_of("gram-schmidt")
    coeffs = np.random.default_rng(degree).standard_normal(basis.count(degree))
    found = real_harmonics(directions(), degree) @ (basis.to_sh(degree) @ coeffs)
    np.testing.assert_allclose(found, basis.evaluate(directions(), degree) @ coeffs, rtol=0, atol=1e-8)


def test_only_gram_schmidt_becomes_harmonics():
    assert [name for name in ALL if basis_of(name).to_sh is not None] == ["gram-schmidt"]
    require_sh("sh")
    with pytest.raises(InputError, match=r"of basis hsh: fit with --basis sh"):
        require_sh("hsh")
    with pytest.raises(InputError, match=r"of basis gram-schmidt: clrelight to-sh"):
        require_sh("gram-schmidt")


def test_makhotkin_spans_what_hsh_spans():
    hsh, makhotkin = (basis_of(name).evaluate(directions(), 4) for name in ("hsh", "makhotkin"))
    solved = np.linalg.lstsq(hsh, makhotkin, rcond=None)[0]
    np.testing.assert_allclose(hsh @ solved, makhotkin, atol=1e-10)


def test_the_registry_refuses():
    with pytest.raises(InputError, match="unknown basis 'hhs'; known are sh, hsh, gram-schmidt"):
        basis_of("hhs")
    with pytest.raises(InputError, match="unknown basis 3"):
        basis_of(3)
    with pytest.raises(ValueError, match="registered already"):
        register(basis_of("hsh"))
    with pytest.raises(InputError, match="haar has degrees 0, 1, 3, 7, 15"):
        basis_of("haar").count(4)


@pytest.mark.parametrize(
    ("out", "back"), [(square_to_hemisphere, hemisphere_to_square), (square_to_sphere, sphere_to_square)]
)
def test_the_square_there_and_back(out, back):
    points = np.random.default_rng(2).uniform(-1, 1, (10_000, 2))
    vectors = out(points)
    np.testing.assert_allclose(np.linalg.norm(vectors, axis=1), 1, rtol=0, atol=1e-15)
    np.testing.assert_allclose(back(vectors), points, rtol=0, atol=1e-14)


def test_the_square_of_the_hemisphere_is_shirleys():
    vectors = directions(5000, seed=3)
    np.testing.assert_allclose(hemisphere_to_square(vectors), np.stack(reference.square_of(vectors), 1), atol=1e-8)
    corners = square_to_hemisphere(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [0, 0]], float))
    expected = [[0, -1, 0], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(corners, expected, atol=1e-15)


@pytest.mark.parametrize("back", [hemisphere_to_square, sphere_to_square])
def test_equal_areas_stay_equal(back):
    """Even points of the hemisphere, or the sphere, fall evenly into cells of the square."""
    count = 200_000
    index = np.arange(count) + 0.5
    z = index / count if back is hemisphere_to_square else 1 - 2 * index / count
    azimuth = index * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - z * z)
    square = back(np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1))
    counts, *_ = np.histogram2d(*square.T, bins=8, range=[[-1, 1]] * 2)
    np.testing.assert_allclose(counts, count / 64, rtol=0.01)
