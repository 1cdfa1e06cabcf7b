"""The bound on errors of lights by a sphere's highlights, as `benchmarks.light_bounds` computes it."""

import numpy as np
import pytest

from benchmarks.light_bounds import least_errors
from tests.reference.spheres import lamps

SMALL = (20.3, 20.6, 4.4)


def errors(is_known=True, sphere=SMALL, coder=None, **how):
    return least_errors(sphere, how, lamps(2, 1), is_known, coder)


@pytest.fixture(scope="module")
def plain():
    return errors()


def test_bound_grows_with_noise(plain):
    noisy = errors(noise=0.05)
    ratio = np.hypot(0.05, 1 / 255 / np.sqrt(12)) / np.hypot(0.005, 1 / 255 / np.sqrt(12))
    assert 0.5 * ratio < noisy[0] / plain[0] < 1.5 * ratio
    assert noisy[1] >= noisy[0] > plain[0]


def test_what_is_unknown_or_changed_by_a_coder_tells_less(plain):
    assert errors(is_known=False)[0] > plain[0]

    def coarse(codes):
        return (codes // 16 * 16 + 8).astype(np.uint8)

    assert errors(coder=coarse)[0] > 1.5 * plain[0]


def test_no_estimate_of_a_highlight_is_below_the_bound(plain):
    """A larger sphere of the same noise has more pixels a degree."""
    assert errors(sphere=(20.3, 20.6, 6.4))[0] < plain[0]
