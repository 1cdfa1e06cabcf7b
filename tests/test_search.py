"""The one search by trials: few of them, none twice, and what is found does what was asked."""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from clrelight.search import search_falling


def power_law(exponent, scale=1.0, noise=0.0):
    """Logarithm of a size that falls with a power of a step, with a little noise as entropy coders have it."""
    return lambda place: math.log(scale) - exponent * place + noise * math.sin(40.0 * place)


def run(measure, start, bounds, aim, tolerance=0.01, **options):
    options = {"limit": aim, "most": 40, "width": 1e-4, "expect": lambda place, value: place + value - aim} | options
    return search_falling(measure, start, bounds, aim, is_enough=lambda value: abs(value - aim) <= tolerance, **options)


@pytest.mark.parametrize("exponent", [0.3, 0.9, 1.0, 3.0])
@pytest.mark.parametrize("aim", [-8.0, 0.5, 6.0])
def test_a_power_law_takes_three_trials(exponent, aim):
    bounds = (aim / -exponent - 9.0, aim / -exponent + 11.0)
    tried = run(power_law(exponent), -aim / exponent + 2.0, bounds, aim)
    assert len(tried) <= 3
    exact = brentq(lambda place: power_law(exponent)(place) - aim, *bounds)
    assert tried[-1][0] == pytest.approx(exact, abs=0.01 / exponent + 1e-9)


def test_what_bends_and_wavers_is_found_within_bounds():
    def measure(place):
        return 9.0 - math.exp(place / 3.0) - 0.5 * place + 0.002 * math.sin(90.0 * place)

    for aim in np.linspace(-5.0, 8.5, 28):
        tried = run(measure, 0.0, (-20.0, 10.0), aim)
        assert abs(tried[-1][1] - aim) <= 0.01
        assert len(tried) <= 9
        assert all(-20.0 <= place <= 10.0 for place, _ in tried)


@pytest.mark.parametrize(("aim", "end"), [(100.0, 0), (-100.0, 1)])
def test_out_of_reach_ends_at_the_end(aim, end):
    bounds = (-3.0, 5.0)
    tried = run(power_law(1.0), 0.0, bounds, aim)
    assert tried[-1][0] == bounds[end]


@pytest.mark.parametrize("jump", range(-3, 9))
def test_whole_places_around_a_jump(jump):
    """Left of the jump all is above the limit, right of it below: both sides of it are tried."""
    tried = run(lambda code: 1.0 if code < jump else -1.0, 2, (0, 6), 0.0, whole=True, width=1.0)
    places = [place for place, _ in tried]
    assert all(isinstance(place, int) and 0 <= place <= 6 for place in places)
    assert len(set(places)) == len(places)
    assert {max(jump - 1, 0), min(jump, 6)} <= set(places) or not 0 < jump <= 6
    assert 0 in places or jump > 0
    assert 6 in places or jump <= 6


def test_no_more_trials_than_allowed_and_none_twice():
    random = np.random.default_rng(0)
    tried = run(lambda place: random.standard_normal(), 0.0, (-1.0, 1.0), 0.0, tolerance=0.0, most=7, width=0.0)
    assert len(tried) == 7
    assert len({place for place, _ in tried}) == 7


def test_values_that_are_not_finite_only_bound():
    """An image without an error has an infinite PSNR, a map without an index no logarithm of its bits."""

    def measure(place):
        return math.inf if place < -4.0 else -math.inf if place > 4.0 else -place

    for start in (-9.0, 9.0):
        assert abs(run(measure, start, (-10.0, 10.0), 1.5)[-1][1] - 1.5) <= 0.01


def test_a_line_that_rises_is_not_followed():
    """Noise turned two values round: the line through them would lead away."""
    values = iter([1.0, 1.2])

    def measure(place):
        return next(values, -place)

    tried = run(measure, -2.0, (-10.0, 10.0), 0.0, slopes=(-4.0, -0.5), most=12)
    assert abs(tried[-1][1]) <= 0.01
