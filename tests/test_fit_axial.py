"""What `spectrum` learns of the zenith: orders that differ, and the covariance that the samples' moments add."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import collect_fit, prepare_fit
from clrelight.fit.axial import FEWEST, SHARES, _leave_out, _Lights, learn_step
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.places import find_gap_radii, find_places, find_zones, spread_points
from clrelight.fit.plan import make_lighting
from clrelight.fit.zonal import SHARE, Theta, coefficient_variances, degree_variances
from clrelight.harmonics.basis import evaluate_basis
from clrelight.metrics import measure_errors
from clrelight.sampling import make_pattern
from tests.reference import spectrum as reference
from tests.reference.basis import real_harmonics

THETA = Theta(level=0.4, slope=2.2, edge=0.05, heat=0.02, noise=1e-3, azimuth=-0.8, tilt=1.7)


LIMITED = replace(THETA, limit=4)


def reference_kernel(first_t3, second_s3):
    """Return the prior's kernel of `LIMITED`."""
    a_l = reference.variances(0.4, 2.2, 0.05, 0.02, 4)
    variance_k = reference.coefficient_variances(a_l, -0.8, 1.7)[:25]
    first_tk, second_sk = (
        np.array([harmonics_at(*point) for point in np.round(points, 13)]) for points in (first_t3, second_s3)
    )
    return first_tk * variance_k @ second_sk.T


@functools.cache
def harmonics_at(x, y, z):
    return real_harmonics(np.array([[x, y, z]]), 4)[0]


def reference_noise():
    a_l = reference.variances(0.4, 2.2, 0.05, 0.02, 4)
    a_l[1] *= 1.7
    return reference.noise_of(a_l, 1e-3)


def raised_lights(directions, columns=240, seed=0, noise=0.003):
    """Columns that change as a light is raised, hardly as it is turned, and glare near the zenith."""
    rng = np.random.default_rng(seed)
    z = directions[:, 2:]
    centre, width = rng.uniform(0.1, 1.0, columns), rng.uniform(0.08, 0.3, columns)
    lean = 0.05 * directions[:, :2] @ rng.standard_normal((2, columns))
    value = 0.3 + 0.4 * np.exp(-(((z - centre) / width) ** 2)) * (0.3 + z) + lean
    return np.clip(value + noise * rng.standard_normal(value.shape), 0, 1)


def as_stack(value_ip, directions):
    return LightStack(np.rint(255 * value_ip).astype(np.uint8).reshape(len(directions), 2, -1, 3), directions, 255.0)


def make_places(directions, value_ip):
    return find_places(make_lighting(as_stack(value_ip, directions), "uniform", "hemisphere"))


def test_variances_of_orders_are_the_references():
    found = coefficient_variances(THETA)
    a_l = reference.variances(0.4, 2.2, 0.05, 0.02)
    np.testing.assert_allclose(found, reference.coefficient_variances(a_l, -0.8, 1.7), rtol=1e-12)
    l_k = np.repeat(np.arange(26), 2 * np.arange(26) + 1)
    a_l[1] *= 1.7
    np.testing.assert_allclose(np.bincount(l_k, found) / (2 * np.arange(26) + 1), a_l, rtol=1e-12)
    # Around the zenith l = 6 varies with elevation, m = 0, more than with azimuth, m = 6.
    assert found[6 * 7] > 3 * found[6 * 7 + 6]


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_the_step_is_that_of_functions_turned_about_the_zenith(share):
    lights, targets = make_pattern("uniform", 15), spread_points(20, False)
    value_ip = raised_lights(lights)
    moment = value_ip @ value_ip.T / value_ip.shape[1]
    places = make_places(lights, value_ip)
    model = KrigingModel.make(places, LIMITED, learn_step(places, LIMITED, moment, share))
    noise_i = np.full(15, reference_noise())
    at_lights, to_targets = (
        reference_kernel(first, lights)
        + share * reference.moment_step(reference_kernel, noise_i, lights, moment, first, lights)
        for first in (lights, targets)
    )
    exact = to_targets @ np.linalg.inv(at_lights + np.diag(noise_i))
    np.testing.assert_allclose(model.weights_at(targets), exact, atol=1e-8)
    np.testing.assert_allclose(evaluate_basis(targets, 25) @ model.map_samples(25), exact, atol=1e-8)
    plain = reference_kernel(targets, lights) @ np.linalg.inv(reference_kernel(lights, lights) + np.diag(noise_i))
    np.testing.assert_allclose(model.plain.weights_at(targets), plain, atol=1e-8)
    assert np.abs(exact - plain).max() > 1e-3


def test_the_share_is_judged_by_lights_that_the_step_has_not_seen():
    lights = np.concatenate([make_pattern("uniform", 7), make_pattern("uniform", 40)[[5, 21]]])
    value_ip = raised_lights(lights)
    moment = value_ip @ value_ip.T / value_ip.shape[1]
    noise_i = np.full(9, reference_noise())
    zones = find_zones(lights, float(np.median(find_gap_radii(lights))))
    assert max(len(zone) for zone in zones) > 1
    exact = []
    for place, zone in enumerate(zones):
        kept = np.setdiff1d(np.arange(9), zone)
        few = lights[kept]

        def added(first, kept=kept, few=few):
            inner = moment[np.ix_(kept, kept)]
            return reference.moment_step(reference_kernel, noise_i[kept], few, inner, first, few)

        own, across = (added(first) for first in (few, lights[[place]]))
        rows = []
        for share in SHARES:
            covariance = reference_kernel(few, few) + share * own + np.diag(noise_i[kept])
            weights = (reference_kernel(lights[[place]], few) + share * across) @ np.linalg.inv(covariance)
            rows.append(np.log(np.mean((weights @ value_ip[kept] - value_ip[place]) ** 2) + 1e-8))
        exact.append(rows)
    noise = LIMITED.noise * float(SHARE @ degree_variances(LIMITED.to_logs(), 4)[0])
    inside = _Lights(coefficient_variances(LIMITED), evaluate_basis(lights, 25), moment, np.full(9, noise))
    np.testing.assert_allclose(_leave_out(inside, lights, SHARES), np.mean(exact, axis=0), atol=1e-6)


def test_scenes_that_know_the_zenith_are_foretold_better(device):
    lights, unseen = make_pattern("uniform", 36), spread_points(90, False)
    stack = as_stack(raised_lights(lights), lights)
    held = LightStack(raised_lights(unseen, noise=0.0).astype(np.float32).reshape(90, 2, -1, 3), unseen, 1.0)

    def reached(**options):
        fitted = collect_fit(prepare_fit(stack, "spectrum", 25, options=options))
        return fitted.config, float(np.mean(-10 * np.log10(measure_errors(fitted, held))))

    config, whole = reached()
    assert config["azimuth"] < -0.5
    assert config["share"] > 0.0
    _, without_step = reached(share=0.0)
    _, zonal = reached(share=0.0, azimuth=0.0, tilt=1.0)
    assert whole > without_step + 0.5
    assert without_step > zonal + 0.5


@pytest.mark.parametrize(("count", "most"), [(2, 0.0), (FEWEST - 1, 0.0), (5, SHARES[1])])
def test_few_lights_take_little_of_the_step(count, most):
    lights = make_pattern("uniform", count)
    stack = as_stack(raised_lights(lights), lights)
    method = prepare_fit(stack, "spectrum", 6).method
    assert method.share <= most
    assert (method.step is not None) == (method.share > 0.0)


def test_a_stack_of_black_takes_no_step(device):
    lights = make_pattern("uniform", 12)
    fitted = collect_fit(prepare_fit(as_stack(np.zeros((12, 240)), lights), "spectrum", 6))
    assert fitted.config["share"] == 0.0
    assert (fitted.coeffs_khwc == 0).all()


def test_one_light_that_is_not_black():
    lights = make_pattern("uniform", 12)
    value_ip = np.zeros((12, 240))
    value_ip[4] = 0.5
    prepared = prepare_fit(as_stack(value_ip, lights), "spectrum", 6)
    assert np.isfinite(prepared.method.share)
    assert np.isfinite(collect_fit(prepared).coeffs_khwc).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"share": 1.5}, "share must be a number from 0 to 1, got 1.5"),
        ({"azimuth": -4}, "azimuth must be a number from -3 to 3, got -4"),
        ({"tilt": 0.0}, "tilt must be a number from 1e-12"),
        ({"step": None}, "method spectrum has no option 'step'"),
    ],
)
def test_bad_options(options, message):
    lights = make_pattern("uniform", 9)
    with pytest.raises(InputError, match=message):
        prepare_fit(as_stack(raised_lights(lights), lights), "spectrum", 3, options=options)
