"""Outlines and highlights of balls to parts of a pixel, against photographs rendered by code of the tests alone."""

import numpy as np
import pytest
from scipy import ndimage

from clrelight.variation import rim_design
from clrelight.variation.circles import Circle
from clrelight.variation.highlights import find_highlights
from clrelight.variation.lobes import Lobe, LobeFit
from clrelight.variation.rim_design import Design, radial_functions
from clrelight.variation.rims import fit_rim
from clrelight.variation.spheres import flat_view, view_sphere
from tests.reference.spheres import lamps, photograph_spheres

SMALL = (20.3, 21.6, 12.4)


def test_radial_functions_are_those_of_a_blurred_disc():
    """A disc drawn finely and blurred by SciPy shows what rings summed by Bessel functions say."""
    fine, radius, sigma = 20, 9.0, 1.2
    side = np.arange(-18 * fine, 18 * fine + 1) / fine
    away_hw = np.hypot(side, side[:, None])
    z_hw = np.sqrt(np.maximum(1.0 - (away_hw / radius) ** 2, 0.0))
    functions = radial_functions(radius, sigma, 3.0, 14.0)
    places = np.arange(3.5, 13.5, 0.5)
    at = np.rint(places * fine).astype(int) + 18 * fine
    for number, picture_hw in ((0, away_hw < radius), (1, z_hw), (2, z_hw**2), (3, away_hw >= radius)):
        blurred_hw = ndimage.gaussian_filter(picture_hw.astype(float), sigma * fine, truncate=6.0)
        np.testing.assert_allclose(functions(places)[:, number], blurred_hw[18 * fine, at], atol=4e-3)


@pytest.mark.parametrize(
    ("how", "most"),
    [
        ({"texture": 0.0, "noise": 0.0}, 0.01),
        ({"seed": 2}, 0.06),
    ],
)
def test_a_ball_of_twelve_pixels_has_its_outline(how, most):
    photographs_ihw = photograph_spheres(lamps(12, 2), (44, 42), [SMALL], **how)
    found = fit_rim(photographs_ihw, Circle(SMALL[0] + 0.3, SMALL[1] - 0.2, SMALL[2] + 0.3))
    off_3 = np.array([found.circle.x, found.circle.y, found.circle.radius]) - SMALL
    assert np.abs(off_3).max() < most
    # What it says of itself is not wrong by much: three standard deviations, and what the renderer's samples are off.
    assert np.abs(off_3).max() < 3.5 * max(found.centre_off, found.radius_off) + 0.01
    np.testing.assert_allclose(found.blur, np.hypot(how.get("blur", 0.7), np.sqrt(1 / 12)), rtol=0.06)


def test_a_ball_that_mirrors_the_table_in_its_rim_is_not_taken_for_a_smaller_one():
    ball = 36.3, 37.6, 28.4
    photographs_ihw = photograph_spheres(lamps(10, 2), (76, 74), [ball], table=0.5, texture=0.0, noise=0.002)
    found = fit_rim(photographs_ihw, Circle(36.3, 37.6, 28.2))
    np.testing.assert_allclose([found.circle.x, found.circle.y], ball[:2], atol=0.06)
    assert abs(found.circle.radius - ball[2]) < 0.25


def test_nothing_round_has_no_outline():
    noise_ihw = np.random.default_rng(0).random((8, 44, 42))
    found = fit_rim(noise_ihw, Circle(*SMALL))
    assert found is None or found.centre_off > 0.05


def test_a_lobe_is_where_it_was_drawn_and_tells_how_sure_it_is():
    circle = Circle(20.3, 20.6, 14.0)
    sphere = view_sphere(circle, (42, 42))
    fit = LobeFit(circle, sphere, 1.0, (0, 0), 0.8, 1e-3)
    rng = np.random.default_rng(1)
    for lobe in (Lobe(2.0, False), Lobe(8.0, True)):
        values_3 = np.array([24.31, 16.84, np.log(0.05)])
        window = fit._window(np.zeros((42, 42)), np.zeros((42, 42)), 24.0, 17.0, 6.0, np.inf)
        picture_hw = np.zeros((42, 42))
        part = picture_hw[window.rows, window.columns]
        part.ravel()[window.kept_p] = 0
        shown = np.zeros(part.size)
        shown[window.kept_p] = fit._shape(values_3, window, lobe)
        picture_hw[window.rows, window.columns] = shown.reshape(part.shape)
        seen_hw = picture_hw + 1e-3 * rng.standard_normal((42, 42)) + 0.02
        found = fit.fit([(seen_hw, seen_hw, picture_hw > 0.3 * picture_hw.max())], np.inf, lobe)[0]
        assert np.hypot(found.x - 24.31, found.y - 16.84) < 5.0 * found.off + 2e-3
        assert found.off < 0.02
        clipped_hw = np.minimum(seen_hw, 0.6 * picture_hw.max())
        clipped = [(clipped_hw, clipped_hw, picture_hw > 0.3 * picture_hw.max())]
        found = fit.fit(clipped, 0.6 * picture_hw.max(), lobe)[0]
        assert np.hypot(found.x - 24.31, found.y - 16.84) < 0.05


def test_a_highlight_of_another_form_keeps_the_mean_of_its_pixels():
    """Two lamps beside each other are no lobe: their middle is not moved to one of them."""
    circle = Circle(30.0, 30.0, 25.0)
    y_hw, x_hw = np.mgrid[:61, :61]
    samples_ihw = np.zeros((1, 61, 61))
    samples_ihw[0] = (np.hypot(x_hw - 27, y_hw - 30) < 1.8) | (np.hypot(x_hw - 33, y_hw - 30) < 1.8)
    samples_ihw[0, 30, 27:34] = 1.0
    found = find_highlights(samples_ihw, circle, view_sphere(circle, (61, 61)), 1.0, (0, 0), np.inf, 0.7)[0]
    assert np.isnan(found.off)
    assert abs(found.x - 30.0) < 0.2


def test_a_turned_picture_shows_a_circle_and_turns_back():
    circle = Circle(105.3, 70.6, 35.0)
    angle_n = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    sphere = view_sphere(circle, (112, 150), 250.0)
    flat = flat_view(sphere)
    x_n, y_n = flat.back(flat.radius * np.cos(angle_n), flat.radius * np.sin(angle_n))
    np.testing.assert_allclose(view_sphere(circle, (112, 150), 250.0, np.stack([x_n, y_n], axis=1)).sine, sphere.sine)
    np.testing.assert_allclose(
        flat.there(x_n, y_n), [flat.radius * np.cos(angle_n), flat.radius * np.sin(angle_n)], atol=1e-9
    )


def test_slopes_of_what_is_seen_are_those_of_differences():
    rng = np.random.default_rng(0)
    angle_p, away_p = rng.uniform(0.0, 2.0 * np.pi, 60), rng.uniform(9.0, 13.0, 60)
    right_p, down_p = away_p * np.cos(angle_p), away_p * np.sin(angle_p)
    orders, step = (3, 2, 1, 4, 2), 1e-4
    radial, other = radial_functions(11.0, 0.9, 7.5, 14.5), radial_functions(11.2, 0.9, 7.5, 14.5)
    found_fm = rng.standard_normal((sum(2 * order + 1 for order in orders), 3))

    def seen(x, y, functions=radial):
        return Design.at(right_p - x, down_p - y, functions, orders).functions_pf @ found_fm

    design = Design.at(right_p, down_p, radial, orders)
    by_x_pm, by_y_pm = design.moved(found_fm)
    np.testing.assert_allclose(by_x_pm, (seen(step, 0.0) - seen(-step, 0.0)) / (2.0 * step), atol=1e-5)
    np.testing.assert_allclose(by_y_pm, (seen(0.0, step) - seen(0.0, -step)) / (2.0 * step), atol=1e-5)
    expected_pm = seen(0.0, 0.0, other) - seen(0.0, 0.0)
    np.testing.assert_allclose(design.exchanged(found_fm, other, radial), expected_pm, atol=1e-12)


def test_rings_of_large_balls_are_those_of_the_bessel_function(monkeypatch):
    ball, at_d = (12.0, 0.8, 8.5, 16.0), np.linspace(8.5, 16.0, 61)
    assert rim_design._LARGE * 0.8**2 < 8.5 * (8.5 - 5.0 * 0.8)
    found_df = radial_functions(*ball)(at_d)
    monkeypatch.setattr(rim_design, "_LARGE", np.inf)
    radial_functions.cache_clear()
    np.testing.assert_allclose(found_df, radial_functions(*ball)(at_d), rtol=0.0, atol=1e-10)
    radial_functions.cache_clear()
