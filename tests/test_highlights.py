"""Highlights on spheres: what is one, and what is none."""

import warnings

import numpy as np
import pytest

from clrelight.variation import lobes
from clrelight.variation.circles import Circle
from clrelight.variation.error_law import ErrorLaw
from clrelight.variation.highlights import find_highlights
from clrelight.variation.spheres import view_sphere
from tests.reference.spheres import lamps, photograph_spheres


def test_what_stands_out_of_nothing_is_no_highlight():
    """Not above a hollow's surroundings: once all the rest of the sphere was taken for it, with negative weights."""
    circle = Circle(24.0, 24.0, 20.0)
    y_hw, x_hw = np.mgrid[:49, :49]
    away_hw = np.hypot(x_hw - 24, y_hw - 24)
    samples_ihw = np.zeros((3, 49, 49))
    samples_ihw[0] = np.where(away_hw > 4.5, 0.5, np.where(away_hw < 1.5, 0.45, 0.0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for each in find_highlights(samples_ihw, circle, view_sphere(circle, (49, 49)), 1.0, (0, 0)):
            assert each is None or each.spread < 90.0


@pytest.mark.parametrize("terms", [(1e-4, 0.0, 0.0), (1e-6, 1e-3, 0.0), (1e-6, 0.0, 4e-3), (3e-5, 2e-4, 1e-3)])
def test_errors_are_a_law_of_brightness(terms):
    """Their variance is told to a fifth everywhere from 5000 samples, whatever the units."""
    rng = np.random.default_rng(0)
    bright_n = rng.random(5000) ** 3
    left_n = rng.standard_normal(5000) * np.sqrt(np.polynomial.polynomial.polyval(bright_n, terms))
    for scale in (1.0, 1e3):
        found_p = ErrorLaw.of(scale * bright_n, scale * left_n).variance(scale * np.linspace(0.02, 1.0, 9)) / scale**2
        expected_p = np.polynomial.polynomial.polyval(np.linspace(0.02, 1.0, 9), terms) + 0.02 * sum(terms)
        np.testing.assert_allclose(found_p, expected_p, rtol=0.2)


@pytest.mark.parametrize("bright_n", [np.zeros(4), np.ones(1), np.array([0.0, 1.0])])
def test_a_law_of_few_samples_is_positive(bright_n):
    for left_n in (np.zeros_like(bright_n), bright_n, np.ones_like(bright_n)):
        assert (ErrorLaw.of(bright_n, left_n).variance(np.array([0.0, 0.5, 1.0])) > 0.0).all()


def test_samples_count_by_how_far_such_bright_ones_are_off(monkeypatch):
    """Errors that grow with brightness, as those of codes behind a curve: lights are a third closer for it."""
    lights_i3, circle = lamps(14, 4, least=0.3), Circle(24.3, 23.8, 18.4)
    samples_ihw = photograph_spheres(lights_i3, (49, 49), [(24.3, 23.8, 18.4)], noise=0.0)
    samples_ihw *= 1.0 + 0.1 * np.random.default_rng(1).standard_normal(samples_ihw.shape)

    monkeypatch.setattr(lobes.LobeFit, "choose", lambda *_: lobes.Lobe(2.0, by_light=False))

    def off():
        found = find_highlights(
            samples_ihw, circle, view_sphere(circle, (49, 49)), 1.0, (0, 0), most=1.0, blur=np.hypot(0.7, 0.29)
        )
        lights = [each.light_3 for each in found if each is not None and np.isfinite(each.off)]
        known = [light_3 for light_3, each in zip(lights_i3, found, strict=True) if each and np.isfinite(each.off)]
        assert len(lights) > 8
        return np.degrees(np.sqrt(np.mean(np.sum((np.array(lights) - known) ** 2, axis=1))))

    weighted = off()
    monkeypatch.setattr(lobes, "_LEAST_LOBES", 100)
    assert weighted < 0.7 * off()
