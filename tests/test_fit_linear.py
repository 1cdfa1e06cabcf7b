import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.jobs.fit import fit
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import columns_of, make_stack, samples_of

EPS32 = 2.0**-23


def check_image(stack, fitted, exact_kp):
    """A float32 coefficient is off by its own rounding at least, which the image sees times |c|."""
    basis_ik = basis.real_harmonics(stack.directions_i3, fitted.degree)
    error_ip = np.abs(basis_ik @ (columns_of(fitted) - exact_kp))
    assert (error_ip <= 1e-5 + 3e-7 * np.linalg.norm(exact_kp, axis=0)).all()


def any_weights(n_light):
    return np.random.default_rng(n_light).random(n_light) ** 2 + 0.01


@pytest.mark.parametrize("degree", [0, 1, 6])
@pytest.mark.parametrize("fill", ["zero", "mirror"])
@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
def test_projection_is_the_quadrature(device, degree, fill, weights):
    stack = make_stack(weights_i=any_weights(90))
    angle_i = stack.weights_i if weights == "solid-angle" else np.full(90, 2 * np.pi / 90)
    basis_ik = basis.real_harmonics(stack.directions_i3, degree)
    if fill == "mirror":
        basis_ik = basis_ik + basis.real_harmonics(stack.directions_i3 * [1, 1, -1], degree)
    fitted = fit(stack, "project", degree, fill=fill, weights=weights)
    sample_ip = samples_of(stack)
    size_kp = np.abs(angle_i[:, None] * basis_ik).T @ sample_ip
    error_kp = np.abs(columns_of(fitted) - reference.project(basis_ik, sample_ip, angle_i))
    assert (error_kp <= 50 * EPS32 * size_kp + 1e-14).all()
    assert fitted.config == {"fill": fill, "weights": weights, "sampling": "hemisphere", "precision": "mixed"}


def band_limited(directions_i3, weights_i, coeffs_k):
    values_i = basis.real_harmonics(directions_i3, 3) @ coeffs_k
    assert values_i.min() > 0
    return LightStack(values_i.astype(np.float32)[:, None, None, None], directions_i3, 1.0, weights_i=weights_i)


def test_projection_over_the_sphere_finds_a_band_limited_function(device):
    directions, weights = basis.sphere_quadrature(6)
    exact = np.concatenate([[3.0], 0.3 * np.random.default_rng(0).standard_normal(15)])
    found = fit(band_limited(directions, weights, exact), "project", 3, weights="solid-angle")
    np.testing.assert_allclose(found.coeffs_khwc.ravel(), exact, atol=2e-6)


def test_mirrored_projection_finds_an_even_function(device):
    directions, weights = basis.sphere_quadrature(7)  # an even number of rows: none on the horizon
    upper = directions[:, 2] > 0
    even = np.concatenate([(l + np.arange(-l, l + 1)) % 2 == 0 for l in range(4)])
    exact = even * np.concatenate([[3.0], 0.3 * np.random.default_rng(1).standard_normal(15)])
    stack = band_limited(directions[upper], weights[upper], exact)
    found = fit(stack, "project", 3, fill="mirror", weights="solid-angle")
    np.testing.assert_allclose(found.coeffs_khwc.ravel(), exact, atol=2e-6)


def test_uniform_weights_over_the_sphere_cover_all_of_it(device):
    directions, _ = basis.sphere_quadrature(6)
    ones = LightStack(np.ones((len(directions), 1, 1, 1), np.float32), directions, 1.0)
    np.testing.assert_allclose(fit(ones, "project", 0).coeffs_khwc.item(), 2 * np.sqrt(np.pi), rtol=1e-6)
    with pytest.raises(InputError, match="lights below the horizon, so fill must be zero"):
        fit(ones, "project", 0, fill="mirror")


@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
@pytest.mark.parametrize("degree", [0, 4, 8])
def test_uls(device, degree, weights):
    stack = make_stack(weights_i=any_weights(90))
    weight_i = stack.weights_i if weights == "solid-angle" else np.ones(90)
    basis_ik = basis.real_harmonics(stack.directions_i3, degree)
    check_image(
        stack,
        fit(stack, "uls", degree, weights=weights),
        reference.least_squares(basis_ik, samples_of(stack), weight_i),
    )


def test_uls_finds_what_made_the_samples(device):
    stack = make_stack(40, (1, 2, 1))
    exact = np.concatenate([[5.0], 0.5 * np.random.default_rng(2).standard_normal(15)])
    found = fit(band_limited(stack.directions_i3, None, exact), "uls", 3)
    np.testing.assert_allclose(found.coeffs_khwc.ravel(), exact, atol=1e-4)


@pytest.mark.parametrize("degree", [1, 4])
def test_sloan_is_uls_without_y10(device, degree):
    stack = make_stack()
    basis_ik = basis.real_harmonics(stack.directions_i3, degree)
    exact_kp = np.insert(
        reference.least_squares(np.delete(basis_ik, 2, axis=1), samples_of(stack), np.ones(90)), 2, 0.0, axis=0
    )
    fitted = fit(stack, "sloan", degree)
    assert (fitted.coeffs_khwc[2] == 0).all()
    check_image(stack, fitted, exact_kp)


def test_sloan_needs_a_function_to_leave_out(device):
    with pytest.raises(InputError, match="degree 1 or more, got 0"):
        fit(make_stack(), "sloan", 0)


@pytest.mark.parametrize("method", ["uls", "sloan"])
@pytest.mark.parametrize(("n_light", "fits"), [(48, 5), (49, 6), (50, 6), (1, 0)])
def test_fewer_lights_than_coefficients(method, n_light, fits):
    stack = make_stack(n_light, (1, 2, 1))
    with pytest.raises(InputError, match=f"{method} at degree 7 has 64 .* {n_light} lights?: degree {fits} is"):
        prepare_fit(stack, method, 7)
    if fits:
        prepare_fit(stack, method, fits)


def test_equal_lights_leave_the_least_norm(device):
    few = make_stack(10, (2, 3, 1))
    stack = make_stack(20, directions_i3=np.repeat(few.directions_i3, 2, axis=0), shape_hwc=(2, 3, 1))
    basis_ik = basis.real_harmonics(stack.directions_i3, 3)
    exact_kp = np.linalg.pinv(basis_ik, rcond=1e-10) @ samples_of(stack)
    prepared = prepare_fit(stack, "uls", 3)
    assert prepared.report.notes == ["only 10 of 16 components can be told from zero in float64"]
    np.testing.assert_allclose(columns_of(fit(stack, "uls", 3)), exact_kp, atol=1e-5)


@pytest.mark.parametrize("method", ["uls", "sloan", "project"])
def test_black_pixels_have_no_coefficients(device, method):
    fitted = fit(make_stack(), method, 4)
    assert (fitted.coeffs_khwc[:, 0, 0, 0] == 0).all()
    assert fitted.lambda_hwc is None
    assert fitted.rank_hwc is None


def test_scattered_lights_leave_least_squares_alone(device):
    # The scale of the basis functions changes a constraint, but not a fit without one.
    stack = make_stack()
    basis_ik = basis.real_harmonics(stack.directions_i3, 4)
    check_image(
        stack,
        fit(stack, "uls", 4, sampling="scattered"),
        reference.least_squares(basis_ik, samples_of(stack), np.ones(90)),
    )
