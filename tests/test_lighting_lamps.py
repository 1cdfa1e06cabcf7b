"""Lights made without a map: caps, lamps, skies, shadows, blends, and Monte Carlo projection."""

import math

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.harmonics.latlong import project_latlong
from clrelight.harmonics.montecarlo import project_function, sample_sphere
from clrelight.harmonics.product import transfer_matrix
from clrelight.lighting.irradiance import evaluate_irradiance
from clrelight.lighting.lamps import blend_lights, cap_light, cap_visibility, cast_shadow, directional_light
from clrelight.lighting.light import Light, turn_about_z
from clrelight.lighting.sky import SKIES, sky_light, sky_luminance
from clrelight.sampling import make_pattern
from tests.reference.basis import real_harmonics, sphere_quadrature
from tests.reference.lighting import latlong_direction
from tests.reference.sky import (
    GENERAL_TYPES,
    TWO_LOBES,
    general_luminance,
    luminance,
    odd_orders_turned,
    project_upper,
    two_lobes,
)


def latlong_projection(function, degree, height):
    directions_i3 = np.array(
        [latlong_direction(row, column, height, 2 * height) for row in range(height) for column in range(2 * height)]
    )
    # of the reference's axes right, up, forward, ours are right, forward, up
    values = function(directions_i3[:, [0, 2, 1]])
    return project_latlong(values.reshape(height, 2 * height, 1), degree)[:, 0]


# --- Green's light ---


def test_two_lobes_by_quadrature():
    coeffs_k = odd_orders_turned(3) * latlong_projection(two_lobes, 3, 128)
    np.testing.assert_allclose(coeffs_k, TWO_LOBES, atol=5e-4)


def test_two_lobes_by_ten_thousand_samples():
    exact_k = odd_orders_turned(3) * TWO_LOBES
    # What one independent sample scatters by, over the root of their number
    every_i3 = sample_sphere(40_000, stratified=False, seed=1)
    scatter_k = np.std(4 * np.pi * two_lobes(every_i3)[:, None] * real_harmonics(every_i3, 3), axis=0)
    for stratified in (False, True):
        coeffs_k = project_function(two_lobes, 3, 10_000, stratified=stratified, seed=2)[:, 0]
        assert (abs(coeffs_k - exact_k) < 4 * scatter_k / 100 + 5e-4).all()


def test_monte_carlo_error_falls_with_the_root_of_the_samples():
    exact_k = latlong_projection(two_lobes, 3, 128)
    counts = (64, 256, 1024, 4096)
    errors = {}
    for stratified in (False, True):
        runs_nsk = [
            [project_function(two_lobes, 3, count, stratified=stratified, seed=seed)[:, 0] for seed in range(24)]
            for count in counts
        ]
        errors[stratified] = np.sqrt(np.mean(np.sum((np.array(runs_nsk) - exact_k) ** 2, axis=2), axis=1))
    slope = {stratified: np.polyfit(np.log(counts), np.log(each), 1)[0] for stratified, each in errors.items()}
    assert slope[False] == pytest.approx(-0.5, abs=0.1)
    assert slope[True] < -0.75
    assert errors[True][-1] < 0.2 * errors[False][-1]


@pytest.mark.parametrize("stratified", [False, True])
def test_samples_are_even(stratified):
    directions_i3 = sample_sphere(4096, stratified=stratified)
    np.testing.assert_allclose(np.linalg.norm(directions_i3, axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(directions_i3.mean(axis=0), 0, atol=0.03)
    np.testing.assert_allclose(directions_i3.T @ directions_i3 / 4096, np.eye(3) / 3, atol=0.03)
    np.testing.assert_array_equal(directions_i3, sample_sphere(4096, stratified=stratified))
    if stratified:  # one in each of 64 × 64 cells of equal area
        azimuth = np.arctan2(directions_i3[:, 1], directions_i3[:, 0]) % (2 * np.pi)
        cells = np.floor(32 * (1 - directions_i3[:, 2])) * 64 + np.floor(32 * azimuth / np.pi)
        assert len(set(cells)) == 4096


def test_samples_that_cannot_be():
    for count, seed, said in ((0, 0, "at least 1"), (5, 0, "a square count, got 5: 4 or 9"), (4, -1, "seed")):
        with pytest.raises(InputError, match=said):
            sample_sphere(count, seed=seed)
    with pytest.raises(InputError, match="degree must be 0 to 100"):
        project_function(two_lobes, 101, 4)


# --- caps and lamps ---


@pytest.mark.parametrize(
    ("direction", "angle"), [((0, 0, 1), 20), ((3, -1, 2), 50), ((0, 0, -1), 170), ((1, 0, 0), 180)]
)
def test_caps_against_quadrature(direction, angle):
    centre_3 = np.array(direction) / np.linalg.norm(direction)
    # A rule for the cap about z, turned: columns of the frame are any two across and the centre.
    frame = np.linalg.svd(centre_3[None])[2].T[:, [1, 2, 0]]
    frame[:, 2] = centre_3
    upright_i3, weights_i = sphere_quadrature(40)
    share = 0.5 * (1 - math.cos(math.radians(angle)))
    z = 1 - share * (1 - upright_i3[:, 2])
    turn = upright_i3[:, :2] / np.linalg.norm(upright_i3[:, :2], axis=1, keepdims=True)
    inside_i3 = np.column_stack([np.sqrt(1 - z * z)[:, None] * turn, z]) @ frame.T
    expected = share * real_harmonics(inside_i3, 12).T @ weights_i
    light = cap_light(direction, angle, 12, (1.0, 0.5, 0.0))
    np.testing.assert_allclose(light.coeffs_kc, expected[:, None] * [1.0, 0.5, 0.0], atol=1e-12)
    # and what is left of the sphere
    visible_k = cap_visibility(direction, angle, 12)
    whole = np.zeros(169)
    whole[0] = np.sqrt(4 * np.pi)
    np.testing.assert_allclose(visible_k, whole - expected, atol=1e-12)


def test_a_lamp_is_a_small_cap_of_its_irradiance():
    lamp = directional_light((2, 3, 6), 4, (2.0,))
    angle = 0.05
    cap = cap_light((2, 3, 6), angle, 4, (2.0 / (2 * np.pi * (1 - math.cos(math.radians(angle)))),))
    np.testing.assert_allclose(lamp.coeffs_kc, cap.coeffs_kc, atol=1e-5)
    facing = evaluate_irradiance(lamp, np.array([[2, 3, 6]]) / 7)
    # sum over l up to 2 of (2 l + 1) A_l / (4 pi)
    assert facing[0, 0] == pytest.approx(2.0 * (1 / 4 + 1 / 2 + 5 / 16), abs=1e-12)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: directional_light((0, 0, 0), 2), "three finite numbers that are not all zero"),
        (lambda: directional_light((0, np.nan, 1), 2), "three finite numbers"),
        (lambda: directional_light((0, 0, 1), 101), "degree must be 0 to 100"),
        (lambda: directional_light((0, 0, 1), 2, (1, 2)), "a colour is 1 or 3 finite numbers"),
        (lambda: cap_light((0, 0, 1), 0, 2), "above 0 and at most 180 degrees, got 0"),
        (lambda: cap_light((0, 0, 1), 181, 2), "above 0 and at most 180 degrees, got 181"),
        (lambda: cap_light((0, 0, 1), 10, 2, (-1.0,)), "not negative"),
        (lambda: cast_shadow(directional_light((0, 0, 1), 2), (0, 0, 1), 0), "the angle of a shadow"),
        (lambda: cast_shadow(directional_light((0, 0, 1), 2), (0, 0, 0), 9), "not all zero"),
    ],
)
def test_lamps_that_cannot_be(make, said):
    with pytest.raises(InputError, match=said):
        make()


# --- skies ---


@pytest.mark.parametrize(
    ("sky", "elevation"),
    [
        ("overcast", 40.0),
        ("clear", 0.0),
        ("clear", 3.0),
        ("clear", 90.0),
        ("partly-cloudy", 0.0),
        ("partly-cloudy", 40.0),
    ],
)
def test_skies_against_quadrature(sky, elevation):
    zenith = 3.5
    sun = math.radians(elevation)
    sun_3 = np.array([-math.cos(sun) * 0.6, math.cos(sun) * 0.8, math.sin(sun)])
    azimuth = math.degrees(math.atan2(0.8, -0.6))

    def radiance(directions_i3):
        angles = np.arccos(np.clip(directions_i3 @ sun_3, -1, 1))
        return zenith * luminance(sky, np.arccos(directions_i3[:, 2]), angles, np.pi / 2 - sun)

    light = sky_light(sky, elevation, azimuth, zenith=zenith, degree=6)
    expected = project_upper(radiance, 6, 220)
    np.testing.assert_allclose(light.coeffs_kc[:, 0], expected, rtol=0, atol=1e-5 * zenith)
    shown_i3 = make_pattern("uniform", 50)
    np.testing.assert_allclose(zenith * sky_luminance(shown_i3, sky, elevation, azimuth), radiance(shown_i3), rtol=1e-9)


def test_the_zenith_has_its_luminance():
    for sky in SKIES:
        assert sky_luminance(np.array([[0.0, 0.0, 1.0]]), sky, 35.0, 70.0)[0] == pytest.approx(1.0, abs=1e-14)
        assert sky_luminance(np.array([[0.6, 0.0, -0.8]]), sky, 35.0, 70.0)[0] == 0.0


def test_overcast_skies_light_the_ground_as_the_formula_says():
    # Horizontal illuminance 7 pi / 9 of the zenith's luminance, in klx for kcd/m²; from the hemisphere it needs no more
    # than the moments of z: E = integral L z.
    light = sky_light("overcast", zenith=9.0, degree=1)
    assert light.coeffs_kc[2, 0] / np.sqrt(3 / (4 * np.pi)) == pytest.approx(9.0 * 7 * np.pi / 9, abs=1e-12)


def test_type_12_is_the_clear_sky():
    # whose 0.91 is 1 - 10 exp(-3 pi / 2), rounded
    clear, general = (sky_light(sky, 25.0, 10.0, degree=8).coeffs_kc for sky in ("clear", "12"))
    np.testing.assert_allclose(clear, general, rtol=0, atol=2e-4 * clear[0, 0])
    assert abs(clear - general).max() > 0


@pytest.mark.parametrize("number", range(1, 16))
def test_types_of_the_general_sky(number):
    shown_i3 = make_pattern("uniform", 50)
    sun_3 = np.array([0.0, 0.8, 0.6])
    angles = np.arccos(np.clip(shown_i3 @ sun_3, -1, 1))
    expected = general_luminance(GENERAL_TYPES[number - 1], np.arccos(shown_i3[:, 2]), angles, np.arccos(0.6))
    relative = sky_luminance(shown_i3, str(number), np.degrees(np.arcsin(0.6)), 90.0)
    np.testing.assert_allclose(relative, expected, rtol=1e-9)


def test_general_skies_that_need_no_sun():
    # CIE types 1, 3 and 5 have no indicatrix; type 5 is uniform.
    np.testing.assert_allclose(sky_luminance(make_pattern("uniform", 9), "5", 20.0), 1.0, atol=1e-15)
    steep = sky_luminance(make_pattern("uniform", 9), "1", 20.0)
    np.testing.assert_allclose(steep, sky_luminance(make_pattern("uniform", 9), "1", 80.0), atol=1e-14)
    assert (np.diff(steep[np.argsort(make_pattern("uniform", 9)[:, 2])]) > 0).all()


def test_a_sky_turns_with_its_sun():
    turned = turn_about_z(sky_light("partly-cloudy", 30.0, 20.0), np.radians(50.0))
    np.testing.assert_allclose(sky_light("partly-cloudy", 30.0, 70.0).coeffs_kc, turned.coeffs_kc, atol=1e-13)


@pytest.mark.parametrize(
    ("words", "zenith", "said"),
    [
        (("blue", 10, 0), 1, "sky must be one of overcast, clear"),
        (("16", 10, 0), 1, "sky must be one of"),
        (("clear", -1, 0), 1, "the sun is below the horizon"),
        (("clear", 91, 0), 1, "an elevation of 0 to 90 degrees"),
        (("clear", np.nan, 0), 1, "an elevation of 0 to 90 degrees"),
        (("clear", 10, np.inf), 1, "a finite azimuth"),
        (("clear", 10, 0), 0, "the luminance of the zenith must be above 0"),
        (("clear", 10, 0), np.inf, "the luminance of the zenith must be above 0"),
    ],
)
def test_skies_that_cannot_be(words, zenith, said):
    with pytest.raises(InputError, match=said):
        sky_light(*words, zenith=zenith)


# --- shadows and blends ---


def test_a_shadow_is_the_product_with_what_is_visible():
    light = sky_light("clear", 40.0, 30.0, degree=5, colour=(1.0, 0.8, 0.5))
    shaded = cast_shadow(light, (1, 2, 2), 35.0)
    # The same by a transfer matrix, and by a fine grid of the true, sharp visibility
    matrix = transfer_matrix(cap_visibility((1, 2, 2), 35.0, 10), 5)
    np.testing.assert_allclose(shaded.coeffs_kc, matrix @ light.coeffs_kc, atol=1e-12)
    inside_kc = light.coeffs_kc - shaded.coeffs_kc
    node, weight = np.polynomial.legendre.leggauss(24)
    centre_3, across_3 = np.array([1, 2, 2]) / 3, np.array([2, 1, -2]) / 3
    other_3 = np.cross(centre_3, across_3)
    share = 0.5 * (1 - math.cos(math.radians(35.0)))
    expected = np.zeros((36, 3))
    for z, w in zip(1 - share * (node + 1), weight, strict=True):
        azimuth = 2 * np.pi * np.arange(24) / 24
        ring = (
            np.sqrt(1 - z * z) * (np.outer(np.cos(azimuth), across_3) + np.outer(np.sin(azimuth), other_3))
            + z * centre_3
        )
        basis_ik = real_harmonics(ring, 5)
        expected += w * share * (2 * np.pi / 24) * basis_ik.T @ (basis_ik @ light.coeffs_kc)
    np.testing.assert_allclose(inside_kc, expected, atol=1e-12)


def test_shadows_add_up_to_darkness():
    light = sky_light("overcast", degree=4)
    dark = cast_shadow(light, (0, 0, 1), 180.0)
    np.testing.assert_allclose(dark.coeffs_kc, 0, atol=1e-14)
    halves = [cast_shadow(light, side, 90.0).coeffs_kc for side in ((0, 1, 0), (0, -1, 0))]
    np.testing.assert_allclose(sum(halves), light.coeffs_kc, atol=1e-13)
    assert cast_shadow(dark, (0, 1, 0), 20.0).config["shadows"] == [[0.0, 0.0, 1.0, 180.0], [0.0, 1.0, 0.0, 20.0]]


def test_blends_weigh_by_distance():
    lights = [directional_light(at, 2 + i) for i, at in enumerate(((0, 0, 1), (1, 0, 0), (0, 1, 1)))]
    positions_i3 = np.array([[0.0, 0, 0], [3, 0, 0], [0, 4, 0]])
    at = np.array([1.0, 0.0, 0.0])
    weights = np.array([1, 1 / 2**2, 1 / 17])
    weights /= weights.sum()
    blend = blend_lights(lights, positions_i3, at, 2.0)
    assert blend.degree == 4
    expected = np.zeros((25, 1))
    for weight, light in zip(weights, lights, strict=True):
        expected[: len(light.coeffs_kc)] += weight * light.coeffs_kc
    np.testing.assert_allclose(blend.coeffs_kc, expected, atol=1e-15)
    assert sum(blend.config["blend"]) == pytest.approx(1.0)
    there = blend_lights(lights, positions_i3, positions_i3[1])
    np.testing.assert_array_equal(there.coeffs_kc[:16], lights[1].coeffs_kc)
    assert not there.coeffs_kc[16:].any()
    # The nearest takes all, whatever the power does to the others' weights.
    near = blend_lights(lights, positions_i3, np.array([0.0, 1e-200, 0.0]), 10.0)
    np.testing.assert_array_equal(near.coeffs_kc[:9], lights[0].coeffs_kc)
    coloured = blend_lights([lights[0], Light(np.ones((9, 3)))], positions_i3[:2], np.array([1.5, 0, 0]))
    np.testing.assert_allclose(coloured.coeffs_kc, np.repeat(0.5 * (lights[0].coeffs_kc + 1), 3, axis=1), atol=1e-15)


@pytest.mark.parametrize(
    ("positions", "place", "power", "said"),
    [
        ([[0, 0, 0]], [0, 0, 0], 1, "one position of three numbers each"),
        ([[0, 0, 0], [0, 0, 0]], [0, 0, 1], 1, "the same position"),
        ([[0, 0, 0], [0, 0, np.inf]], [0, 0, 1], 1, "finite"),
        ([[0, 0, 0], [0, 0, 1]], [0, 0, 1], 0, "above 0, got 0"),
        ([[0, 0, 0], [0, 0, 1]], [0, 0, 1], np.nan, "above 0"),
    ],
)
def test_blends_that_cannot_be(positions, place, power, said):
    lights = [directional_light((0, 0, 1), 1)] * 2
    with pytest.raises(InputError, match=said):
        blend_lights(lights, np.array(positions), np.array(place), power)
