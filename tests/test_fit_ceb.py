import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.fit.ceb import step_ends
from clrelight.jobs.fit import fit
from clrelight.sampling import make_pattern
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import BLACK, VARYING, columns_of, make_stack, samples_of
from tests.styles import gpu_style

METHODS = {"ceb": False, "ceb-crossing": True}


def check_ranks(fitted, basis_ik, exact_kp, rank_p):
    same = fitted.rank_hwc.ravel() == rank_p
    same = same[VARYING]  # the norm of a constant pixel is its bound: see below
    assert np.mean(same) >= 0.999
    assert np.abs(basis_ik @ (columns_of(fitted) - exact_kp))[:, VARYING][:, same].max() < 1e-5


def check(stack, fitted, weight_i=None, factor=1.0):
    """Compare with float64: ranks, and the image of columns with the same rank.

    A sum that meets the bound to a rounding error may go either way: one column in a thousand is let off.
    """
    weight_i = np.ones(stack.n_light) if weight_i is None else weight_i
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, fitted.degree), samples_of(stack)
    exact_kp, rank_p = reference.truncated(basis_ik, sample_ip, weight_i, factor, METHODS[fitted.method])
    check_ranks(fitted, basis_ik, exact_kp, rank_p)
    energy_p = factor * reference.bound(sample_ip, weight_i)
    return np.sum(columns_of(fitted) ** 2, axis=0) / np.where(energy_p > 0, energy_p, 1.0)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degree", [0, 2, 4, 6, 8])
def test_against_float64(device, degree, method):
    stack = make_stack()
    fitted = fit(stack, method, degree)
    share_p = check(stack, fitted)
    ranks = fitted.rank_hwc.ravel()[VARYING]
    if degree >= 2:
        assert ranks.min() < ranks.max()
    if method == "ceb":
        assert (share_p <= 1 + 1e-5).all()
    elif degree >= 2:
        # The term that crosses the bound is kept.
        assert np.mean(share_p > 1.01) > 0.3


@gpu_style
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("columns", [3, 127, 128, 129])
def test_against_float64_on_a_gpu(device, columns, method):
    stack = make_stack(shape_hwc=(1, columns, 1))
    check(stack, fit(stack, method, 2))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("factor", [1e-3, 0.4, 3.0])
def test_energy_factor(device, factor, method):
    stack = make_stack()
    share_p = check(stack, fit(stack, method, 4, energy=factor), factor=factor)
    assert method == "ceb-crossing" or (share_p <= 1 + 1e-5).all()


def test_a_bound_below_the_first_term_leaves_nothing(device):
    stack = make_stack()
    fitted = fit(stack, "ceb", 4, energy=1e-6)
    assert (fitted.rank_hwc.ravel()[VARYING] == 0).mean() > 0.9
    assert (fitted.coeffs_khwc[:, fitted.rank_hwc == 0] == 0).all()


def test_a_bound_above_all_terms_keeps_least_squares(device):
    stack = make_stack()
    fitted = fit(stack, "ceb", 2, energy=1e6)
    assert (fitted.rank_hwc == 9).all()
    basis_ik = basis.real_harmonics(stack.directions_i3, 2)
    exact_kp = reference.least_squares(basis_ik, samples_of(stack), np.ones(90))
    assert np.abs(basis_ik @ (columns_of(fitted) - exact_kp)).max() < 1e-5


@pytest.mark.parametrize("method", METHODS)
def test_solid_angle_weights(device, method):
    weights = 10.0 ** np.random.default_rng(0).uniform(-3, 0, 90)
    stack = make_stack(weights_i=weights)
    share_p = check(stack, fit(stack, method, 4, weights="solid-angle"), weights)
    assert method == "ceb-crossing" or (share_p <= 1 + 1e-5).all()


@pytest.mark.parametrize(("n_light", "lights"), [(1, "1 light"), (20, "20 lights")])
def test_fewer_lights_than_coefficients(device, n_light, lights):
    stack = make_stack(n_light)
    prepared = prepare_fit(stack, "ceb", 4)
    assert prepared.report.notes == [f"{lights} for 25 coefficients: the bound alone settles the others"]
    assert (check(stack, fit(stack, "ceb", 4)) <= 1 + 1e-5).all()


def test_equal_lights(device):
    stack = make_stack(60, directions_i3=np.repeat(make_pattern("uniform", 20), 3, axis=0))
    fitted = fit(stack, "ceb", 4)
    assert fitted.rank_hwc.max() <= 20
    assert (check(stack, fitted) <= 1 + 1e-5).all()


def test_scattered_samples(device):
    # The eigenbasis of A* (eq. 29), where the bound on D c is a sum of squares again.
    stack = make_stack(directions_i3=make_pattern("scattered", 90, seed=5))
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 3), samples_of(stack)
    scale_k = np.sqrt(np.sum(basis_ik**2, axis=0) * (2 * np.pi / 90))
    rotation, sigma, z = reference.decomposed(basis_ik / scale_k, sample_ip, np.ones(90))
    within = np.cumsum((z / sigma) ** 2, axis=0) <= 2 * np.pi * np.mean(sample_ip**2, axis=0)
    exact_kp = rotation @ (within * z / sigma) / scale_k[:, None]
    notes = prepare_fit(stack, "ceb", 3, sampling="scattered").report.notes
    assert any("ceb on scattered samples" in note for note in notes)
    fitted = fit(stack, "ceb", 3, sampling="scattered")
    check_ranks(fitted, basis_ik, exact_kp, within.sum(axis=0))


@pytest.mark.parametrize("method", METHODS)
def test_black_pixels(device, method):
    fitted = fit(make_stack(), method, 4)
    assert (columns_of(fitted)[:, BLACK] == 0).all()
    assert np.isfinite(fitted.coeffs_khwc).all()
    assert fitted.lambda_hwc is None


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("n_light", [25, 90, 256])
def test_constant_pixels_are_kept_whole(device, n_light, degree, method):
    # The norm of their coefficients is the bound exactly, so a rounding error must not cost them a term.
    directions = make_pattern("uniform", n_light)
    values = np.random.default_rng(0).random((1, 5, 61, 1), np.float32)
    stack = LightStack(np.repeat(values, n_light, axis=0), directions, 1.0)
    fitted = fit(stack, method, degree)
    if method == "ceb":
        assert (np.sum(columns_of(fitted) ** 2, axis=0) <= 4 * np.pi * values.ravel() ** 2 * (1 + 1e-5)).all()
    image_ip = basis.real_harmonics(directions, degree) @ columns_of(fitted)
    np.testing.assert_allclose(image_ip, np.broadcast_to(values.reshape(1, -1), image_ip.shape), atol=1e-5)


def make_rings(heights, count):
    z, azimuth = np.repeat(heights, count), np.tile(np.arange(count) * (2 * np.pi / count), len(heights))
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def turn(directions, angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return directions @ np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


@gpu_style
@pytest.mark.parametrize(("method", "digits"), [("ceb", 16), ("ceb", 6), ("ceb-crossing", 16)])
@pytest.mark.parametrize(
    ("heights", "count", "degree"), [((0.5,), 24, 4), ((0.1, 0.4, 0.7, 0.95), 24, 6), ((0.2, 0.6, 0.9), 11, 3)]
)
def test_lights_turned_around_their_axis_give_the_same_image(device, heights, count, degree, method, digits):
    # Of two eigenvectors to one eigenvalue, which a decomposition turns at will, neither may be kept alone.
    lights = make_rings(heights, count)
    stack = make_stack(len(lights), directions_i3=lights)
    images = []
    for angle in (0.0, 1.0, *np.random.default_rng(degree).uniform(0, 2 * np.pi, 4)):
        turned = turn(lights, angle).round(digits)
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        fitted = fit(LightStack(stack.images_ihwc, turned, stack.peak), method, degree, energy=0.3)
        images.append(basis.real_harmonics(turned, degree) @ columns_of(fitted))
    assert np.abs(np.array(images[1:]) - images[0]).max() <= 1e-4 * np.max(samples_of(stack))
    ranks = fitted.rank_hwc.ravel()[VARYING]
    assert len(heights) == 1 or ranks.min() < ranks.max()


def test_a_step_is_all_components_of_equal_singular_value():
    found = step_ends(np.array([9.0, 5.0, 5.0 - 1e-9, 4.0, 4.0 * (1 - 6e-5), 4.0 * (1 - 1.2e-4), 1.0]))
    np.testing.assert_array_equal(found, [1, 3, 3, 5, 5, 6, 7])


@pytest.mark.parametrize("method", METHODS)
def test_wrong_options(method):
    stack = make_stack(9, (1, 2, 1))
    with pytest.raises(InputError, match="energy must be a positive factor on E_c, got -2"):
        prepare_fit(stack, method, 2, options={"energy": -2})
    with pytest.raises(InputError, match=f"method {method} has no option 'solver'; it has: energy"):
        prepare_fit(stack, method, 2, options={"solver": "newton"})
