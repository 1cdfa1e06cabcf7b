"""Highlights on spheres: what is one, and what is none."""

import warnings

import numpy as np

from clrelight.variation.circles import Circle
from clrelight.variation.highlights import find_highlights
from clrelight.variation.spheres import view_sphere


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
