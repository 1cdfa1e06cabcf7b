import itertools

import numpy as np
import pytest

from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.reproduction.deletion import condition_numbers
from clrelight.reproduction.eigenvectors import _paper_search, _solve
from clrelight.reproduction.parts import name_of


@pytest.mark.parametrize("count", [1, 2, 3])
def test_conditions_by_blocks_are_those_of_the_whole_matrix(count):
    matrix = hemisphere_autocorrelation(3)
    sets = list(itertools.combinations(range(16), count))[::7]
    found = condition_numbers(matrix, sets)
    for gone, condition in zip(sets, found, strict=True):
        left = np.delete(np.delete(matrix, gone, axis=0), gone, axis=1)
        assert condition == pytest.approx(np.linalg.cond(left), rel=1e-9)


def test_as_the_paper_says_of_25_and_49_functions():
    """Section IV-D: the third function mends n = 25; more than 100 pairs of 49 are alike."""
    of_25 = condition_numbers(hemisphere_autocorrelation(4), [(k,) for k in range(25)])
    assert np.argsort(of_25).tolist().index(2) < 4
    assert np.linalg.cond(hemisphere_autocorrelation(4)) > 40 * of_25[2]
    of_49 = condition_numbers(hemisphere_autocorrelation(6), list(itertools.combinations(range(49), 2)))
    assert np.sum(of_49 <= of_49.min() * (1 + 1e-9)) > 100


def test_the_papers_search_ends_within_the_bound():
    matrix, right = np.array([[10.0, 4.0], [4.0, 2.0]]), np.array([6.0, 1.0])
    tried = _paper_search(matrix, right, 1.0)
    assert tried[0] == 1.0
    assert np.sum(_solve(matrix, right, tried[-1]) ** 2) <= 1.0


def test_names():
    assert [name_of(k) for k in (0, 1, 2, 3, 6)] == ["y00", "y1₋1", "y10", "y11", "y20"]
