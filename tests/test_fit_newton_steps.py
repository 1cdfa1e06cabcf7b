"""Newton with fewer steps than it needs to end: coefficients beyond the bound are scaled onto it."""

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.jobs.fit import fit
from clrelight.sampling import make_pattern
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import columns_of, make_stack, samples_of
from tests.styles import both_styles

STEPS = [1, 2, 3, 5, 15]


def norm_at(stack, degree, lambda_p):
    """Return each column's |c|^2 at a lambda, and its bound."""
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, degree), samples_of(stack)
    _, sigma, z_rp = reference.decomposed(basis_ik, sample_ip, np.ones(stack.n_light))
    norm_p = np.sum((sigma * z_rp / (sigma**2 + lambda_p)) ** 2, axis=0)
    return norm_p, reference.bound(sample_ip, np.ones(stack.n_light))


@both_styles
@pytest.mark.parametrize("precision", ["mixed", "double"])
@pytest.mark.parametrize("degree", [2, 8])  # on GPUs 9 components in registers, and 81 in memory
@pytest.mark.parametrize("steps", STEPS)
def test_few_steps_end_on_the_bound(device, steps, degree, precision):
    stack = make_stack()
    fitted = fit(stack, "cls", degree, iterations=steps, precision=precision)
    assert (fitted.config["iterations"], fitted.config["solver"]) == (steps, "newton")
    lambda_p = fitted.lambda_hwc.ravel().astype(np.float64)
    norm_p, energy_p = norm_at(stack, degree, lambda_p)
    found_p = np.sum(columns_of(fitted) ** 2, axis=0)
    rounding = 1e-5 if precision == "mixed" else 1e-6
    assert (found_p <= energy_p * (1 + rounding)).all()
    beyond = norm_p > energy_p * (1 + 2 * rounding)
    np.testing.assert_allclose(found_p[beyond], energy_p[beyond], rtol=rounding)
    if steps < 3 and (precision == "double" or device.style == "gpu"):
        assert beyond.sum() > 400  # without the scaling, the bound would not hold
        assert (norm_p[beyond] > 1.1 * energy_p[beyond]).any()


@both_styles
@pytest.mark.parametrize("precision", ["mixed", "double"])
def test_more_steps_are_closer(device, precision):
    stack = make_stack()
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 6), samples_of(stack)
    exact_kp, lambda_p, _ = reference.constrained(basis_ik, sample_ip, np.ones(90))
    bent = lambda_p > 1e-3
    off_image, off_lambda = [], []
    for steps in (1, 2, 4, 8, 15, 32):
        fitted = fit(stack, "cls", 6, iterations=steps, precision=precision)
        off_image.append(np.abs(basis_ik @ (columns_of(fitted) - exact_kp)).max())
        found_p = fitted.lambda_hwc.ravel()[bent]
        off_lambda.append(np.median(np.abs(found_p / lambda_p[bent] - 1)))
        # From the left, but for rounding errors of the search.
        assert (found_p <= lambda_p[bent] * (1.02 if steps == 1 else 1 + 1e-4)).all()
    assert off_image[-1] < 1e-6
    assert off_image[-2] < 1e-6
    assert off_image[3] < 1e-5
    if precision == "double" or device.style == "gpu":  # from the left end, without a table
        assert off_image[1] > 1e-3
    assert (np.diff(off_image) < 1e-7).all()
    assert (np.diff(off_lambda) < 1e-6).all()


def test_the_one_pass_kernel_starts_so_near_that_two_steps_are_all(device):
    stack = make_stack(256)
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 6), samples_of(stack)
    exact_kp, _, _ = reference.constrained(basis_ik, sample_ip, np.ones(256))
    one, two = (np.abs(basis_ik @ (columns_of(fit(stack, "cls", 6, iterations=n)) - exact_kp)).max() for n in (1, 2))
    assert two < 1e-6 < one < 2e-4


@both_styles
@pytest.mark.parametrize("steps", [1, 4])
def test_the_bound_of_scattered_samples_holds_too(device, steps):
    # There it is one of D c, D^2 the energy of the basis functions over the samples.
    stack = make_stack(directions_i3=make_pattern("scattered", 90, seed=5), shape_hwc=(5, 7, 1))
    basis_ik, angle = basis.real_harmonics(stack.directions_i3, 3), 2 * np.pi / 90
    scale_k = np.sqrt(angle * np.sum(basis_ik**2, axis=0))
    fitted = fit(stack, "cls", 3, sampling="scattered", iterations=steps)
    energy_p = angle * np.sum(samples_of(stack) ** 2, axis=0)
    assert (np.sum((scale_k[:, None] * columns_of(fitted)) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()


@pytest.mark.parametrize("iterations", [0, 1001])
def test_other_numbers_of_steps_are_refused(iterations):
    with pytest.raises(InputError, match=f"iterations must be 1 to 1000, got {iterations}"):
        prepare_fit(make_stack(9, (1, 2, 1)), "cls", 2, options={"iterations": iterations})
