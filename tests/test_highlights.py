"""Highlights on spheres: what is one, and what is none."""

import tracemalloc
import warnings

import numpy as np
import pytest
from scipy import ndimage

from clrelight.jobs.variation import sphere_lights
from clrelight.jobs.variation.light_doubts import doubts
from clrelight.jobs.variation.sphere_lights import outlined, outlined_by_all, pictures_of
from clrelight.threads import on_one_thread
from clrelight.variation import beside_highlights, lobes
from clrelight.variation.beside_highlights import Ball
from clrelight.variation.circles import Circle
from clrelight.variation.error_law import ErrorLaw
from clrelight.variation.highlight_search import HighlightSearch
from clrelight.variation.highlights import Highlight, find_highlights
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


def test_means_inside_a_disc_are_those_of_a_gaussian():
    """By another program: SciPy's filters, which cut it off at eight of its widths here."""
    rng = np.random.default_rng(5)
    circle, values_hw = Circle(30.2, 26.1, 22.0), rng.standard_normal((50, 61))
    search = HighlightSearch.of((50, 61), circle, view_sphere(circle, (50, 61)), 1.0, (0, 0))
    for mean in (search.narrow, search.wide):
        sums_hw, shares_hw = (
            ndimage.gaussian_filter(each_hw * search.inside_hw, mean.sigma, mode="constant", truncate=8.0)
            for each_hw in (values_hw, np.ones((50, 61)))
        )
        wanted_hw = (sums_hw / np.maximum(shares_hw, 1e-6))[search.inside_hw]
        np.testing.assert_allclose(mean(values_hw)[search.inside_hw], wanted_hw, atol=1e-9)


def test_what_is_beside_highlights_takes_little_memory(monkeypatch):
    """Less than `sphere_lights` counts for a sample, which the photographs and a first guess are a part of."""
    monkeypatch.setattr(beside_highlights, "_PIECE", 1500)
    _, normals_hw3 = ball(60, 29.5, 29.5, 22.0)
    samples_ihw = np.random.default_rng(0).random((12, 60, 60), np.float32)
    told = Ball(normals_hw3, normals_hw3, 22.0)
    tracemalloc.start()
    try:
        with on_one_thread():
            found_ihw = told.beside(samples_ihw, lamps(12, 1), np.full(12, 5.0), np.inf)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert found_ihw.dtype == np.float32
    counted = sphere_lights._SAMPLE_BYTES - samples_ihw.itemsize - found_ihw.itemsize
    assert peak < 3600 * (12 * counted + sphere_lights._PIXEL_BYTES)


def ball(side, x, y, radius):
    """Return where a ball is, and its normals."""
    y_hw, x_hw = np.mgrid[:side, :side]
    u_hw, v_hw = (x_hw - x) / radius, (y - y_hw) / radius
    depth_hw = 1.0 - u_hw**2 - v_hw**2
    normals_hw3 = np.stack([u_hw, v_hw, np.sqrt(np.maximum(depth_hw, 0.0))], axis=2)
    return depth_hw > 0.01, np.where(depth_hw[..., None] > 0.01, normals_hw3, 0.0)


def half_way(lights_i3):
    half_i3 = lights_i3 + np.array([0.0, 0.0, 1.0])
    return half_i3 / np.linalg.norm(half_i3, axis=1, keepdims=True)


def test_what_stays_and_shading_are_told_from_highlights():
    inside_hw, normals_hw3 = ball(49, 24.2, 23.7, 20.0)
    lights_i3 = lamps(9, 2, least=0.3)
    rays_hw3 = 2.0 * normals_hw3[..., 2:] * normals_hw3 - [0.0, 0.0, 1.0]
    still_hw = np.where(inside_hw, np.random.default_rng(0).random((49, 49)), 0.0)
    beside_ihw = still_hw + 0.4 * np.maximum(np.einsum("ia,hwa->ihw", lights_i3, normals_hw3), 0.0) * inside_hw
    # A highlight of its own 8 degrees wide, which the median of all nine photographs would hold in places.
    shine_ihw = 3.0 * np.exp(-np.sum((half_way(lights_i3)[:, None, None] - normals_hw3) ** 2, axis=3) / 0.07**2)
    told = Ball(normals_hw3, np.where(inside_hw[..., None], rays_hw3, 0.0), 20.0)
    found_ihw = told.beside(beside_ihw + shine_ihw * inside_hw, lights_i3, np.full(9, 8.0), np.inf)
    front_hw = inside_hw & (normals_hw3[..., 2] > 0.5)
    # What a polynomial misses of shading of 0.4, and where all nine photographs have a highlight near.
    assert np.abs(found_ihw - beside_ihw)[:, front_hw].max() < 0.06
    plain_hw = np.median(beside_ihw + shine_ihw, axis=0)
    assert np.abs(plain_hw - beside_ihw)[:, front_hw].max() > 0.2


def test_a_bright_rim_and_shading_around_are_not_the_lamp():
    """The table shows in the rim, brighter than the lamp but where the ball's shadow lies; lit sides are bright."""
    inside_hw, normals_hw3 = ball(65, 32.3, 31.6, 28.0)
    lights_i3, circle = lamps(8, 3, least=0.35), Circle(32.3, 31.6, 28.0)
    samples_ihw = 0.5 * np.maximum(np.einsum("ia,hwa->ihw", lights_i3, normals_hw3), 0.0)
    samples_ihw += 0.4 * np.exp(-np.sum((half_way(lights_i3)[:, None, None] - normals_hw3) ** 2, axis=3) / 0.06**2)
    behind_ihw = np.einsum("ia,hwa->ihw", lights_i3[:, :2], normals_hw3[..., :2]) < -0.3
    samples_ihw = np.where((normals_hw3[..., 2] < 0.5) & ~behind_ihw, samples_ihw + 0.9, samples_ihw) * inside_hw
    found = find_highlights(samples_ihw, circle, view_sphere(circle, (65, 65)), 1.0, (0, 0))
    off_i = [np.degrees(np.arccos(each.light_3 @ light_3)) for each, light_3 in zip(found, lights_i3, strict=True)]
    assert max(off_i) < 2.0


def test_a_shadow_beside_a_ball_does_not_move_its_outline():
    """It touches the ball, and lies elsewhere in each photograph, always on the same side."""
    inside_hw, normals_hw3 = ball(60, 30.0, 30.0, 18.0)
    y_hw, x_hw = np.mgrid[:60, :60]
    grain_hw = np.random.default_rng(1).uniform(0.2, 0.5, (60, 60))
    photographs = []
    for turn in np.radians(np.arange(-40, 41, 10)):
        light_3 = np.array([np.sin(turn) * 0.6, -0.6 * np.cos(turn), 0.8])
        light_3 /= np.linalg.norm(light_3)
        right_hw, up_hw = (x_hw - 30.0) / 18.0, (30.0 - y_hw) / 18.0
        along_hw = right_hw * light_3[0] + up_hw * light_3[1] - light_3[2]
        in_shadow_hw = (right_hw**2 + up_hw**2 + 1.0 - along_hw**2 < 1.0) & (along_hw < 0.0)
        table_hw = np.where(in_shadow_hw, 0.0, grain_hw * light_3[2])
        photographs.append(np.where(inside_hw, 0.3 * np.maximum(normals_hw3 @ light_3, 0.0), table_hw))
    samples_ihw = np.array(photographs, np.float32)
    start = Circle(31.0, 29.0, 17.5)

    def off(circle):
        return abs(circle.x - 30.0) + abs(circle.y - 30.0) + abs(circle.radius - 18.0)

    assert off(outlined_by_all(samples_ihw, start)[0]) < 0.5 < 0.5 * off(outlined(pictures_of(samples_ihw), start)[0])


def test_doubts_name_their_reasons():
    def seen(**changed):
        return Highlight(**{"x": 0.0, "y": 0.0, "light_3": None, "height": 1.0, "spread": 5.0, "rival": 0.0} | changed
                         | {"clipped": False})  # fmt: skip

    highlights = [seen(), seen(), seen(), seen(spread=9.0), seen(height=0.1), seen(rival=0.8), None, seen(), seen()]
    lights_i3 = np.tile([0.0, 0.0, 1.0], (9, 1))
    lights_i3[6], lights_i3[7] = 0.0, [0.9, 0.0, -0.436]
    uncertain_i, clipped_i = np.array([0.1] * 8 + [2.5]), np.array([0.1, 0.4] + [0.0] * 7)

    def told(which, is_outlined=True, count=9):
        return doubts(which, lights_i3[:count], uncertain_i[:count], is_outlined, clipped_i[:count])

    plain = ("", "over-exposed", "", "wide", "dim", "second highlight", "", "below the horizon", "uncertain")
    assert told(highlights) == plain
    unsure = told(highlights, is_outlined=False)
    assert unsure[0] == "no sure outline"
    assert unsure[3] == "no sure outline, wide"
    assert unsure[6] == ""
    two = told([seen(rival=0.6), seen(), seen(rival=0.6)], count=3)
    assert two == ("two lamps", "two lamps, over-exposed", "two lamps")
    assert told([None], is_outlined=False, count=1) == ("",)
