from dataclasses import replace

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.jobs.fit import fit
from clrelight.sampling import make_pattern
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import BLACK, VARYING, columns_of, make_stack, samples_of
from tests.styles import gpu_style

SOLVERS = ["bisection", "newton"]


def check(stack, fitted, weight_i=None, factor=1.0, rtol=1e-4):
    """Compare with float64: the image, lambda where it is well defined, and the bound."""
    weight_i = np.ones(stack.n_light) if weight_i is None else weight_i
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, fitted.degree), samples_of(stack)
    exact_kp, lambda_p, free_p = reference.constrained(basis_ik, sample_ip, weight_i, factor)
    energy_p = factor * reference.bound(sample_ip, weight_i)
    assert np.abs(basis_ik @ (columns_of(fitted) - exact_kp)).max() < 1e-5
    assert (np.sum(columns_of(fitted) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()
    found_p = fitted.lambda_hwc.ravel()
    share_p = np.where(free_p > 0, energy_p, np.inf) / np.where(free_p > 0, free_p, 1.0)
    bent = (share_p > 1e-3) & (share_p < 0.99)
    np.testing.assert_allclose(found_p[bent], lambda_p[bent], rtol=rtol)
    assert (found_p[share_p < 0.9999] > 0).all()
    assert (found_p[share_p > 1.0001] == 0).all()
    assert found_p[BLACK] == 0
    return int(bent.sum())


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("degree", [0, 2, 4, 6, 8])
def test_against_float64(device, degree, solver):
    stack = make_stack()
    bent = check(stack, fit(stack, "cls", degree, solver=solver))
    assert bent > (100 if degree in (2, 4, 6) else -1)


@gpu_style
@pytest.mark.parametrize(("solver", "degree"), [("bisection", 2), ("newton", 2), ("newton", 8)])  # 81 in memory
def test_against_float64_on_a_gpu(device, degree, solver):
    stack = make_stack()
    bent = check(stack, fit(stack, "cls", degree, solver=solver))
    assert bent > (100 if degree == 2 else -1)


@gpu_style
@pytest.mark.parametrize("columns", [2, 127, 128, 129])  # about a group, and the last one of padding alone
def test_any_number_of_columns_on_a_gpu(device, columns):
    stack = make_stack(shape_hwc=(1, columns, 1))
    check(stack, fit(stack, "cls", 2, solver="newton"))


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("factor", [1e-4, 0.3, 3.0, 1e3])
def test_energy_factor(device, factor, solver):
    stack = make_stack()
    check(stack, fit(stack, "cls", 4, energy=factor, solver=solver), factor=factor)


@pytest.mark.parametrize("solver", SOLVERS)
def test_solid_angle_weights(device, solver):
    # Weights over three decades, as clustered lights have them.
    weights = 10.0 ** np.random.default_rng(0).uniform(-3, 0, 90)
    stack = make_stack(weights_i=weights)
    fitted = fit(stack, "cls", 4, weights="solid-angle", solver=solver)
    assert check(stack, fitted, weights) > 100
    assert fitted.config["weights"] == "solid-angle"


@gpu_style
@pytest.mark.parametrize("precision", ["mixed", "double"])
@pytest.mark.parametrize(("steps", "factor"), [(12, 1.0), (20, 1.0), (16, 1e-3)])
def test_the_search_as_the_paper_prints_it(device, steps, precision, factor):
    stack = make_stack(40)
    options = {"solver": "paper", "iterations": steps, "energy": factor}
    fitted = fit(stack, "cls", 4, **options, precision=precision)
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 4), samples_of(stack)
    exact_kp, lambda_p = reference.constrained_as_printed(basis_ik, sample_ip, np.ones(40), steps, factor)
    found_p = fitted.lambda_hwc.ravel()
    # Lambda is a number of halves of halves, exactly; where the norm meets the bound to a rounding error, the next one.
    same = np.abs(found_p - lambda_p) <= 1e-6 * lambda_p
    assert same.mean() > 0.9
    assert (np.abs(found_p - lambda_p) <= np.maximum(lambda_p, 1.0) * 2.0 ** -(steps - 8))[VARYING].all()
    assert np.abs(basis_ik @ (columns_of(fitted) - exact_kp))[:, same].max() < 1e-5
    assert (
        np.sum(columns_of(fitted) ** 2, axis=0) <= factor * reference.bound(sample_ip, np.ones(40)) * (1 + 1e-5)
    ).all()
    assert (lambda_p > 2.0).any() if factor < 1.0 else (lambda_p < 0.5).any()


def test_a_few_heavy_lights(device):
    # Which columns float32 cannot settle depends on the mean weight; by the largest, lambda was off by 6e-5 here.
    weights = np.where(np.arange(400) < 4, 1.0, 0.003)
    stack = make_stack(400, weights_i=weights, shape_hwc=(5, 201, 3))
    assert check(stack, fit(stack, "cls", 4, weights="solid-angle"), weights, rtol=3.5e-5) > 2000


@pytest.mark.parametrize("count", [16, 257, 600])
@pytest.mark.parametrize("width", [2, 15, 255, 256, 257])
def test_newton_agrees_with_bisection_run_to_convergence(device, width, count):
    stack = make_stack(count, shape_hwc=(1, width, 1))
    newton = fit(stack, "cls", 4)
    halved = fit(stack, "cls", 4, solver="bisection", iterations=64)
    assert newton.config["solver"] == "newton"
    image_ip = basis.real_harmonics(stack.directions_i3, 4) @ (columns_of(newton) - columns_of(halved))
    assert np.abs(image_ip).max() < 1e-6
    held, free = newton.lambda_hwc > 1e-3, newton.lambda_hwc == 0
    np.testing.assert_allclose(newton.lambda_hwc[held], halved.lambda_hwc[held], rtol=1e-4)
    assert (halved.lambda_hwc[free] < 1e-3).all()


def test_weights_of_equal_cells_change_nothing(device):
    stack = make_stack(weights_i=np.full(90, 0.123))
    np.testing.assert_allclose(
        columns_of(fit(stack, "cls", 4, weights="solid-angle")), columns_of(fit(stack, "cls", 4)), atol=1e-6
    )


@pytest.mark.parametrize("solver", SOLVERS)
def test_fewer_lights_than_coefficients(device, solver):
    stack = make_stack(20)
    prepared = prepare_fit(stack, "cls", 4)
    assert prepared.report.notes == ["20 lights for 25 coefficients: the bound alone settles the others"]
    check(stack, fit(stack, "cls", 4, solver=solver))


@pytest.mark.parametrize("solver", SOLVERS)
def test_equal_lights(device, solver):
    stack = make_stack(60, directions_i3=np.repeat(make_pattern("uniform", 20), 3, axis=0))
    notes = prepare_fit(stack, "cls", 4).report.notes
    assert notes == ["only 20 of 25 components can be told from zero in float64"]
    # The three photographs of a light share its weight, and so lambda is a third of what it would be.
    fitted = fit(stack, "cls", 4, solver=solver)
    check(stack, replace(fitted, lambda_hwc=3.0 * fitted.lambda_hwc))


def test_one_light(device):
    stack = make_stack(1)
    fitted = fit(stack, "cls", 2)
    check(stack, fitted)
    # The mean energy over the sphere of a function of degree 2 is less than its peak's: one light is met exactly.
    basis_ik = basis.real_harmonics(stack.directions_i3, 2)
    np.testing.assert_allclose(basis_ik @ columns_of(fitted), samples_of(stack), atol=1e-6)


@pytest.mark.parametrize("solver", SOLVERS)
def test_singular_values_over_twelve_decades(device, solver):
    # Lights in a small patch see high degrees only by their derivatives. Nothing may overflow on the way to lambda.
    stack = make_stack(directions_i3=make_patch(9, 10, 0.0012))
    prepared = prepare_fit(stack, "cls", 4)
    assert prepared.plan.condition > 1e10
    fitted = fit(stack, "cls", 4, solver=solver)
    assert np.isfinite(fitted.coeffs_khwc).all()
    check(stack, fitted)


def make_patch(rows, columns, step):
    """Lights around the zenith, none so near to another that they would be photographs of one."""
    points = step * np.stack(np.meshgrid(np.arange(rows), np.arange(columns)), axis=-1).reshape(-1, 2)
    points += np.random.default_rng(3).uniform(-step / 8, step / 8, points.shape) - points.mean(axis=0)
    return np.concatenate([points, np.sqrt(1.0 - np.sum(points**2, axis=1, keepdims=True))], axis=1)


def test_without_a_decomposition(device):
    # Eq. 18 as it stands: for each column, a dense problem for every lambda.
    stack = make_stack()
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 4), samples_of(stack)
    fitted = fit(stack, "cls", 4)
    lambdas = fitted.lambda_hwc.ravel()
    energy_p = reference.bound(sample_ip, np.ones(90))
    for p in np.flatnonzero(lambdas > 0)[:8]:
        exact_k, lambda_ = reference.constrained_dense(basis_ik, sample_ip[:, p], np.ones(25), energy_p[p])
        assert lambdas[p] == pytest.approx(lambda_, rel=1e-4)
        np.testing.assert_allclose(columns_of(fitted)[:, p], exact_k, atol=1e-5)


@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
@pytest.mark.parametrize("solver", SOLVERS)
def test_scattered_samples(device, solver, weights):
    # Eq. 26-30. kappa and the energy are integrals over the sampled part, whose area is the sum of the weights.
    angle_i = np.random.default_rng(4).uniform(0.01, 0.03, 90)
    stack = make_stack(directions_i3=make_pattern("scattered", 90, seed=5), weights_i=angle_i, shape_hwc=(5, 7, 1))
    if weights == "uniform":
        angle_i = np.full(90, 2 * np.pi / 90)
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 3), samples_of(stack)
    scale_k = np.sqrt(angle_i @ basis_ik**2)
    energy_p = angle_i @ sample_ip**2
    root_i = np.sqrt(angle_i / angle_i.mean())
    fitted = fit(stack, "cls", 3, sampling="scattered", weights=weights, solver=solver)
    found_kp, lambdas = columns_of(fitted), fitted.lambda_hwc.ravel()
    assert (np.sum((scale_k[:, None] * found_kp) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()
    bent = np.flatnonzero(lambdas > 1e-3)[:10]
    assert len(bent) == 10
    for p in bent:
        exact_k, lambda_ = reference.constrained_dense(
            root_i[:, None] * basis_ik, root_i * sample_ip[:, p], scale_k, energy_p[p]
        )
        assert lambdas[p] == pytest.approx(lambda_, rel=1e-4)
        assert np.abs(basis_ik @ (found_kp[:, p] - exact_k)).max() < 1e-5
    free_kp = reference.least_squares(basis_ik, sample_ip, angle_i)
    for p in np.flatnonzero(lambdas == 0):
        assert np.abs(basis_ik @ (found_kp[:, p] - free_kp[:, p])).max() < 1e-5


def test_scattered_samples_that_miss_functions(device):
    # On the circle x = 0 the functions that are odd in x vanish: nothing tells their coefficients.
    angle = np.linspace(0.1, 3.0, 30)
    directions = np.stack([0 * angle, np.cos(angle), np.sin(angle)], axis=1)
    stack = make_stack(directions_i3=directions, shape_hwc=(3, 4, 1))
    assert "3 basis functions vanish at all samples: their coefficients are 0" in (
        prepare_fit(stack, "cls", 2, sampling="scattered").report.notes
    )
    fitted = fit(stack, "cls", 2, sampling="scattered")
    assert (fitted.coeffs_khwc[[3, 4, 7]] == 0).all()  # x, x y and x z
    assert (fitted.coeffs_khwc[[0, 1, 2, 5, 6, 8]] != 0).any(axis=(1, 2, 3)).all()


@pytest.mark.parametrize("iterations", [1, 2, 3, 5, 9, 16, 24])
def test_few_halvings_end_where_the_bound_holds(device, iterations):
    stack = make_stack()
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 4), samples_of(stack)
    _, lambda_p, _ = reference.constrained(basis_ik, sample_ip, np.ones(90))
    fitted = fit(stack, "cls", 4, solver="bisection", iterations=iterations)
    assert fitted.config["iterations"] == iterations
    energy_p = reference.bound(sample_ip, np.ones(90))
    assert (np.sum(columns_of(fitted) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()
    # The norm of a constant pixel is its bound: whether its lambda is 0 or 1e-18 is rounding, the reference's too.
    assert (fitted.lambda_hwc.ravel() >= lambda_p * 0.999)[VARYING].all()


def test_more_halvings_are_closer(device):
    stack = make_stack()
    basis_ik = basis.real_harmonics(stack.directions_i3, 4)
    _, lambda_p, _ = reference.constrained(basis_ik, samples_of(stack), np.ones(90))
    bent = lambda_p > 0
    error = [
        np.median(fit(stack, "cls", 4, solver="bisection", iterations=n).lambda_hwc.ravel()[bent] / lambda_p[bent] - 1)
        for n in (1, 6, 10, 16)
    ]
    assert error[0] > 10 * error[1] > 100 * error[2] > 1000 * error[3]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"energy": 0.0}, "energy must be a positive factor on E_c, got 0.0"),
        ({"energy": -1.0}, "positive factor"),
        ({"energy": float("nan")}, "positive factor"),
        ({"energy": float("inf")}, "positive factor"),
        ({"solver": "secant"}, "solver must be bisection, newton, paper, got 'secant'"),
        ({"iterations": 0}, "iterations must be 1 to 1000, got 0"),
        ({"iterations": 1001}, "iterations must be 1 to 1000, got 1001"),
        ({"rounds": 3}, "method cls has no option 'rounds'; it has: energy, iterations, solver"),
    ],
)
def test_wrong_options(options, message):
    with pytest.raises(InputError, match=message):
        prepare_fit(make_stack(9, (1, 2, 1)), "cls", 2, options=options)


def test_the_area_of_scattered_samples_scales_lambda_alone(device):
    # Twice the area: kappa and the energy are twice as large, so lambda D^2 is the same for half the lambda.
    lights = make_pattern("scattered", 90, seed=5)
    angle_i = np.random.default_rng(4).uniform(0.01, 0.03, 90)
    small, large = (
        fit(
            make_stack(directions_i3=lights, weights_i=area * angle_i),
            "cls",
            3,
            sampling="scattered",
            weights="solid-angle",
        )
        for area in (1.0, 2.0)
    )
    np.testing.assert_allclose(columns_of(large), columns_of(small), atol=1e-5)
    held = small.lambda_hwc > 1e-3
    assert held.sum() > 10
    np.testing.assert_allclose(large.lambda_hwc[held], 0.5 * small.lambda_hwc[held], rtol=1e-4)
