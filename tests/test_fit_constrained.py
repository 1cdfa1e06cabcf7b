import json

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import constrained
from clrelight.fit.value_bounds import bound_directions, least_energy
from clrelight.jobs.fit import fit
from clrelight.light_files import write_lp
from clrelight.opencl.devices import STYLES
from clrelight.sampling import make_pattern
from tests.commands import attributes, call, succeed
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import BLACK, columns_of, make_samples, make_stack, samples_of
from tests.styles import both_styles

CERTAIN = 1e-9


def values_at(fitted, at_j3):
    return basis.real_harmonics(at_j3, fitted.degree) @ columns_of(fitted)


def grid_of(degree):
    return bound_directions("grid", degree, np.zeros((0, 3)), sphere=False)


def compare(stack, fitted, at_j3, *, lower=None, upper=None, energy=1.0, tolerance=1e-6):
    """Compare coefficients, image and bounds with float64 in units of sqrt(E_c); return how many columns were."""
    solver = pytest.importorskip("tests.reference.constrained", reason="Clarabel is not installed")
    degree = fitted.degree
    basis_ik, rows_jk = (basis.real_harmonics(where, degree) for where in (stack.directions_i3, at_j3))
    samples_ip, weight_i = samples_of(stack), np.ones(stack.n_light)
    energy_p = energy * reference.bound(samples_ip, weight_i)
    coeffs_kp = columns_of(fitted)
    signed = [(-rows_jk, -lower)] * (lower is not None) + [(rows_jk, upper)] * (upper is not None)
    compared = 0
    for p in np.flatnonzero(energy_p > 0.0):
        rows = np.vstack([each for each, _ in signed])
        limit = np.concatenate([np.full(len(each), value) for each, value in signed], dtype=float)
        exact_k, missed = solver.solve_column(basis_ik, samples_ip[:, p], weight_i, energy_p[p], rows, limit)
        if missed > CERTAIN:
            continue
        compared += 1
        apart = np.abs(exact_k - coeffs_kp[:, p]).max() / np.sqrt(energy_p[p])
        assert apart < tolerance, (p, apart)
    assert (np.sum(coeffs_kp**2, axis=0) <= energy_p * (1 + 1e-5) + 1e-30).all()
    return compared


@pytest.mark.parametrize("degree", [1, 4, 6])
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_against_a_solver_of_cone_programmes(device, degree, precision):
    stack = make_stack(shape_hwc=(1, 11, 3))
    fitted = fit(stack, "constrained", degree, precision=precision)
    assert compare(stack, fitted, grid_of(degree), lower=0.0) >= 30
    assert values_at(fitted, grid_of(degree)).min() > -1e-6
    if degree > 1:
        plain = fit(stack, "cls", degree)
        assert np.mean((values_at(plain, grid_of(degree)) < -1e-4).any(axis=0)) > 0.3


def test_rows_that_depend_on_each_other(device):
    """On the horizon 13 functions differ at 52 directions: rows that leave together come back, and go in circles."""
    stack = make_stack(n_light=90, shape_hwc=(1, 12, 3))
    at_j3 = bound_directions("ring", 6, stack.directions_i3, sphere=False)
    fitted = fit(stack, "constrained", 6, at="ring")
    assert compare(stack, fitted, at_j3, lower=0.0) >= 30
    assert values_at(fitted, at_j3).min() > -1e-6


@pytest.mark.parametrize("steps", [0, 2])
def test_what_does_not_end_at_once_is_solved_in_a_bracket(device, monkeypatch, steps):
    monkeypatch.setattr(constrained, "_FAST_STEPS", steps)
    stack = make_stack(shape_hwc=(1, 7, 3))
    fitted = fit(stack, "constrained", 4)
    assert compare(stack, fitted, grid_of(4), lower=0.0) >= 18


def test_a_degree_above_what_it_solves_is_refused(device):
    with pytest.raises(InputError, match=r"constrained takes degrees to 20, got 21: .* lower degree, or cls"):
        fit(make_stack(shape_hwc=(1, 3, 3)), "constrained", 21)


def test_functions_that_no_light_sees_are_bounded_too(device):
    """144 coefficients of 40 lights: the energy hardly binds, and lambda is many decades below sigma^2."""
    stack = make_stack(n_light=40, shape_hwc=(1, 5, 3))
    fitted = fit(stack, "constrained", 11, energy=2.0)
    assert values_at(fitted, grid_of(11)).min() > -1e-6
    energy_p = 2.0 * reference.bound(samples_of(stack), np.ones(stack.n_light))
    assert (np.sum(columns_of(fitted) ** 2, axis=0) <= energy_p * (1 + 1e-5) + 1e-30).all()


def test_both_bounds_on_the_horizon(device):
    stack = make_stack(shape_hwc=(1, 10, 3))
    fitted = fit(stack, "constrained", 4, lower=0.0, upper=0.2, at="ring", energy=2.0, precision="double")
    at_j3 = bound_directions("ring", 4, stack.directions_i3, sphere=False)
    assert np.abs(at_j3[:, 2]).max() == 0.0
    assert compare(stack, fitted, at_j3, lower=0.0, upper=0.2, energy=2.0) >= 25
    values = values_at(fitted, at_j3)
    assert values.min() > -1e-6
    assert values.max() < 0.2 + 1e-6
    assert values.max() > 0.2 - 1e-6


def test_equal_bounds_fix_a_value(device):
    stack = make_stack(shape_hwc=(1, 9, 3))
    zenith = [[0.0, 0.0, 2.0]]
    fitted = fit(stack, "constrained", 3, lower=0.0, upper=0.0, at=zenith, precision="double")
    assert np.abs(values_at(fitted, np.array([[0.0, 0.0, 1.0]]))).max() < 1e-6


@both_styles
@pytest.mark.parametrize("columns", [1, 7, 8, 9, 17])
def test_columns_do_not_depend_on_their_neighbours(device, columns):
    stack = make_stack(shape_hwc=(1, 17, 1))
    whole = fit(stack, "constrained", 3)
    part = LightStack(stack.images_ihwc[:, :, :columns], stack.directions_i3, 1.0)
    np.testing.assert_array_equal(fit(part, "constrained", 3).coeffs_khwc, whole.coeffs_khwc[:, :, :columns])


@pytest.mark.parametrize("style", STYLES)
def test_styles_agree_with_float64(style, monkeypatch):
    from clrelight.device import open_device

    stack = make_stack(shape_hwc=(1, 5, 3))
    fitted = fit(stack, "constrained", 4, device=open_device(style=style))
    assert compare(stack, fitted, grid_of(4), lower=0.0) >= 13


def test_what_meets_its_bounds_is_cls(device):
    stack = make_stack(shape_hwc=(1, 41, 3))
    fitted, plain = fit(stack, "constrained", 4, lower=-10.0), fit(stack, "cls", 4)
    np.testing.assert_allclose(columns_of(fitted), columns_of(plain), atol=2e-5)
    assert (columns_of(fitted)[:, BLACK] == 0).all()


def test_single_precision_keeps_bounds_to_its_own(device):
    stack = make_stack(shape_hwc=(1, 31, 3))
    with pytest.warns(match="single precision keeps bounds on values"):
        fitted = fit(stack, "constrained", 4, precision="single")
    assert values_at(fitted, grid_of(4)).min() > -1e-4
    energy_p = reference.bound(samples_of(stack), np.ones(stack.n_light))
    assert (np.sum(columns_of(fitted) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()


@pytest.mark.parametrize("scale", [2.0**-80, 1.0, 2.0**60])
def test_bounds_are_radiance_whatever_the_scale(device, scale):
    """Kernels get samples far from the peak scaled by powers of two; bounds go with them."""
    samples = make_samples(make_pattern("uniform", 40), (1, 6, 3)).astype(np.float32)
    dim = LightStack(samples * np.float32(scale), make_pattern("uniform", 40), 1.0)
    fitted = fit(dim, "constrained", 2, lower=0.0, upper=0.1 * scale)
    values = values_at(fitted, grid_of(2))
    assert values.min() > -1e-6 * scale
    assert 0.1 * scale * (1 - 1e-5) < values.max() < 0.1 * scale * (1 + 1e-5)


def test_fewer_lights_than_coefficients_and_scattered_samples(device):
    few = make_stack(n_light=12, shape_hwc=(1, 11, 3))
    values = values_at(fit(few, "constrained", 4, measure=False), grid_of(4))
    assert values.min() > -1e-6
    assert (values_at(fit(few, "cls", 4), grid_of(4)).min(axis=0) < -1e-3).any()
    scattered = make_stack(directions_i3=make_pattern("scattered", 60), shape_hwc=(1, 11, 3))
    assert values_at(fit(scattered, "constrained", 4, sampling="scattered"), grid_of(4)).min() > -2e-5


def test_at_the_lights_and_below_the_horizon(device):
    stack = make_stack(n_light=30, shape_hwc=(1, 11, 3))
    fitted = fit(stack, "constrained", 3, at="lights")
    assert values_at(fitted, stack.directions_i3).min() > -1e-6
    below = np.array([[0.0, 0.0, -1.0], [0.6, 0.0, -0.8]])
    assert values_at(fit(stack, "constrained", 3, at=below), below).min() > -1e-6


def test_least_energy_is_that_of_the_nearest_function():
    rows = np.array([[1.0, 0.0], [0.0, 2.0]])
    low, none = np.array([3.0, -1e30]), np.array([1e30, 1e30])
    assert least_energy(rows, low, none) == pytest.approx(9.0)
    assert least_energy(rows, np.array([3.0, 2.0]), none) == pytest.approx(10.0)
    assert least_energy(rows, np.array([-1.0, -1e30]), none) == 0.0
    opposed = np.array([[1.0, 0.0], [-1.0, 0.0]])
    assert least_energy(opposed, np.array([1.0, 1.0]), none) is None


def test_a_pixel_without_the_energy_is_refused_by_its_place(device, tmp_path):
    stack = make_stack(shape_hwc=(3, 7, 3))
    with pytest.raises(InputError, match=r"pixel at row 0, column 0, channel 0: its energy bound E_c is too small"):
        fit(stack, "constrained", 2, lower=0.01)
    mask = np.ones((3, 7), bool)
    mask[0, 0] = False
    bright = make_stack(shape_hwc=(3, 7, 3), mask_hw=mask)
    images = np.maximum(bright.images_ihwc, np.float32(0.05))
    images[:, 0, 0] = 0.0
    held = fit(LightStack(images, bright.directions_i3, 1.0, mask_hw=mask), "constrained", 2, lower=0.01)
    assert values_at(held, grid_of(2))[:, 3:].min() > 0.01 - 1e-6


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lower": 0.5, "upper": 0.2}, r"lower 0.5 is above upper 0.2"),
        ({"lower": 0.5, "nonnegative": True}, r"nonnegative means lower 0"),
        ({"lower": float("nan")}, r"lower must be a number within"),
        ({"upper": "much"}, r"upper must be a number within"),
        ({"energy": 0.0}, r"energy must be a positive factor"),
        ({"at": "everywhere"}, r"bounds stand at grid, ring, lights, or at directions of your own"),
        ({"at": [[0.0, 0.0, 0.0]]}, r"direction 0 of bounds is \[0.0, 0.0, 0.0\], which points nowhere"),
        ({"at": [[0.0, 1.0]]}, r"rows of x y z, got shape \(1, 2\)"),
        ({"lower": 1.0, "upper": 1.0, "at": "grid"}, r"energy bound E_c is too small"),
    ],
)
def test_odd_input_is_one_line(device, options, message):
    with pytest.raises(InputError, match=message) as refused:
        fit(make_stack(shape_hwc=(1, 3, 3)), "constrained", 2, **options)
    assert "\n" not in str(refused.value)


def test_bounds_that_exclude_each_other_are_refused(device, monkeypatch):
    from clrelight.fit import constrained

    limits = iter([np.array([1.0, -1e30]), np.array([1e30, -1.0])])
    monkeypatch.setattr(constrained, "limits_of", lambda *_, **__: next(limits))
    at = [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]]
    with pytest.raises(InputError, match=r"no function of degree 2 is within .* at all 2 directions"):
        fit(make_stack(shape_hwc=(1, 3, 3)), "constrained", 2, at=at, lower=1.0)


def test_the_command_takes_a_light_file(tmp_path):
    stack, out, lights = tmp_path / "ring.h5", tmp_path / "fit.h5", tmp_path / "at.lp"
    succeed("synth", "ring", stack, "--size", 16, "--lights", 49)
    at_j3 = make_pattern("uniform", 9)
    write_lp(lights, [f"{j}.png" for j in range(9)], at_j3)
    words = ("--method", "constrained", "--degree", 3, "--nonnegative", "--upper", 0.9, "--bound-at", lights)
    succeed("fit", stack, out, *words)
    held = json.loads(attributes(out)["config"])
    np.testing.assert_allclose(held["at"], at_j3, atol=1e-8)
    assert (held["lower"], held["upper"], held["nonnegative"]) == (0.0, 0.9, True)
    ended = call("fit", stack, out, "--method", "constrained", "--bound-at", tmp_path / "none.lp")
    assert ended.code == 2
    assert "is neither" in ended.err
    ended = call("fit", stack, out, "--method", "cls", "--nonnegative")
    assert ended.code == 2
    assert "has no option 'nonnegative'" in ended.err
    ended = call("fit", stack, lights, "--method", "constrained", "--bound-at", lights)
    assert ended.code == 2


def test_a_tile_goes_in_pieces_between_which_it_can_be_interrupted(device, monkeypatch):
    stack = make_stack(shape_hwc=(7, 11, 3))
    whole = columns_of(fit(stack, "constrained", 4, device=device))
    monkeypatch.setattr(constrained, "_MOST_WORK", 1)
    monkeypatch.setattr(constrained, "_ITEMS_PER_UNIT", {"cpu": 1, "gpu": 1})
    launched, launch = [], type(device).launch
    monkeypatch.setattr(type(device), "launch", lambda *words, **more: launched.append(words) or launch(*words, **more))
    np.testing.assert_array_equal(columns_of(fit(stack, "constrained", 4, device=device)), whole)
    assert sum(words[2] == "fit_bounded_rq" for words in launched) >= 3
