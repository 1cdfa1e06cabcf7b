"""Degrees, sets of lights and bounds: condition numbers to 1e13, and bounds from 1e-12 to beyond what is needed."""

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.fit.linear import LARGEST_CONDITION
from clrelight.fit.plan import IMAGE_ROUNDING
from clrelight.jobs.fit import fit
from clrelight.sampling import make_pattern
from tests.extremes.judge import IMAGE, cap, image_error, judge, stack_of
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import columns_of, make_samples, samples_of
from tests.styles import gpu_style

METHODS = ["cls", "ceb"]


@pytest.mark.parametrize("degree", [1, 4, 8, 15])
@pytest.mark.parametrize("method", METHODS)
def test_degrees_on_a_hemisphere(method, degree):
    assert judge(stack_of(make_pattern("uniform", 256)), method, degree) < IMAGE


@gpu_style
@pytest.mark.parametrize(("method", "degree"), [("cls", 6), ("cls", 15), ("ceb", 6)])
def test_degrees_on_a_gpu(device, method, degree):
    assert judge(stack_of(make_pattern("uniform", 256)), method, degree) < IMAGE


@pytest.mark.parametrize("radius", [60, 30, 10, 2])
@pytest.mark.parametrize("degree", [2, 6, 10])
@pytest.mark.parametrize("method", METHODS)
def test_caps(method, degree, radius):
    assert judge(stack_of(cap(200, radius)), method, degree) < IMAGE


def nearly_in_line(count):
    """Lights within 1e-7 of one great circle."""
    angle = np.linspace(0.1, 3.0, count)
    line = np.stack([1e-7 * np.sin(7 * angle), np.cos(angle), np.sin(angle)], axis=1)
    return line / np.linalg.norm(line, axis=1, keepdims=True)


def nearly_equal(count):
    lights = make_pattern("uniform", count)
    moved = lights + 1e-7 * np.random.default_rng(0).standard_normal(lights.shape)
    return np.concatenate([lights, moved / np.linalg.norm(moved, axis=1, keepdims=True)])


SETS = {
    "clusters": make_pattern("scattered", 120, seed=3),
    "equal": np.repeat(make_pattern("uniform", 64), 2, axis=0),
    "nearly equal": nearly_equal(64),
    "nearly in line": nearly_in_line(60),
    "all the same": np.repeat(make_pattern("uniform", 1), 30, axis=0),
}


@pytest.mark.parametrize("lights", SETS)
@pytest.mark.parametrize("degree", [6, 10])
@pytest.mark.parametrize("method", METHODS)
def test_sets_of_lights(method, degree, lights):
    assert judge(stack_of(SETS[lights]), method, degree) < IMAGE


@pytest.mark.parametrize("n_light", [1, 4, 8, 48, 49, 257, 4096])
@pytest.mark.parametrize("method", METHODS)
def test_numbers_of_lights(method, n_light):
    assert judge(stack_of(make_pattern("uniform", n_light), columns=24), method, 6) < IMAGE


@pytest.mark.parametrize("factor", [1e-12, 1e-9, 1e-6, 1e-3, 0.5, 0.999, 1.0, 1.001, 10.0, 1e3])
@pytest.mark.parametrize("degree", [4, 8])
@pytest.mark.parametrize("method", METHODS)
def test_factors_on_the_bound(method, degree, factor):
    assert judge(stack_of(make_pattern("uniform", 90)), method, degree, factor) < IMAGE


@pytest.mark.parametrize("factor", [1e-12, 1e-6])
@pytest.mark.parametrize("n_light", [256, 4096])
@pytest.mark.parametrize("scale", [1.0, 1e-20])
def test_small_factors_with_many_lights(factor, n_light, scale):
    stack = stack_of(make_pattern("uniform", n_light), scale, columns=12)
    assert judge(stack, "cls", 8, factor, solver="newton") < IMAGE
    assert judge(stack, "cls", 8, factor, solver="bisection", iterations=64) < IMAGE


@pytest.mark.parametrize("factor", [1e6, 1e12])
@pytest.mark.parametrize("method", METHODS)
def test_bounds_that_bind_nothing_leave_least_squares(method, factor):
    lights = make_pattern("uniform", 90)
    assert judge(stack_of(lights), method, 4, factor) < IMAGE
    assert prepare_fit(stack_of(lights), method, 4, options={"energy": factor}).report.notes == []
    (note,) = prepare_fit(stack_of(lights), method, 8, options={"energy": factor}).report.notes
    error = judge(stack_of(lights), method, 8, factor)
    assert IMAGE < error < float(note.split("up to ")[1].split()[0])


@pytest.mark.parametrize("share", [1e-6, 1e-2, 0.5, 0.9, 0.999, 0.999999])
@pytest.mark.parametrize("degree", [2, 6])
def test_shares_of_the_unconstrained_energy(degree, share):
    # All columns are turns of one about z, so that one factor is the same share of each column's own energy.
    rings, around = np.meshgrid(np.linspace(0.05, 0.95, 12), np.arange(24) * (np.pi / 12.0), indexing="ij")
    across = np.sqrt(1.0 - rings**2)
    lights = np.stack([across * np.cos(around), across * np.sin(around), rings], axis=2).reshape(-1, 3)
    sample_zi = make_samples(lights, (1, 1, 3), seed=2)[:, 0, 0, 2].reshape(12, 24)
    images = np.stack([np.roll(sample_zi, turn, axis=1).ravel() for turn in range(24)], axis=1)
    stack = LightStack(images.astype(np.float32)[:, None, :, None], lights, 1.0)
    sample_ip = samples_of(stack)
    free_kp = reference.least_squares(basis.real_harmonics(lights, degree), sample_ip, np.ones(len(lights)))
    factor = share * float(np.mean(np.sum(free_kp**2, axis=0) / reference.bound(sample_ip, np.ones(len(lights)))))
    assert judge(stack, "cls", degree, factor) < IMAGE


def test_the_norm_falls_as_lambda_grows():
    stack = stack_of(make_pattern("uniform", 256))
    for degree in (4, 12):
        norms, lambdas = [], []
        for factor in 10.0 ** np.arange(-12, 4, 1.5):
            fitted = fit(stack, "cls", degree, energy=factor)
            norms.append(np.sum(columns_of(fitted) ** 2, axis=0)[1:])
            lambdas.append(fitted.lambda_hwc.ravel()[1:])
        assert (np.diff(norms, axis=0) >= -1e-6 * np.array(norms[1:])).all()
        assert (np.diff(lambdas, axis=0) <= 1e-6 * np.array(lambdas[:-1])).all()


@pytest.mark.parametrize(
    ("method", "lights", "degree"),
    [("uls", "hemisphere", 10), ("uls", "hemisphere", 15), ("uls", "cap", 4), ("uls", "cap", 9), ("sloan", "cap", 9)],
)
def test_least_squares_beyond_float32_is_cut_and_says_so(method, lights, degree):
    directions = make_pattern("uniform", 256) if lights == "hemisphere" else cap(256, 30)
    stack = stack_of(directions)
    prepared = prepare_fit(stack, method, degree)
    (note,) = (n for n in prepared.report.notes if "float32" in n)
    assert f"{method}: condition number {prepared.report.condition:.2g} is beyond float32" in note
    basis_ik = basis.real_harmonics(directions, degree)
    if method == "sloan":
        basis_ik[:, 2] = 0.0  # which adds a singular value of 0
    rotation, sigma, z_rp = reference.decomposed(basis_ik, samples_of(stack), np.ones(256))
    kept = sigma[:, 0] > sigma[0, 0] / LARGEST_CONDITION
    assert prepared.plan.synthesis_kr.shape[1] == np.sum(kept)
    exact_kp = rotation[:, kept] @ (z_rp[kept] / sigma[kept])
    error = image_error(stack, fit(stack, method, degree), exact_kp)
    assert error < IMAGE_ROUNDING * LARGEST_CONDITION
    residual = samples_of(stack) - basis_ik @ columns_of(fit(stack, method, degree))
    assert np.abs(residual).max() < 2.0 * samples_of(stack).max()


@pytest.mark.parametrize(("n_light", "degree"), [(256, 6), (90, 8), (256, 9)])
def test_least_squares_within_float32(n_light, degree):
    stack = stack_of(make_pattern("uniform", n_light))
    prepared = prepare_fit(stack, "uls", degree)
    condition = prepared.report.condition
    noted = [n for n in prepared.report.notes if f"condition number {condition:.2g}; rounding of the float32" in n]
    assert len(noted) == (condition > 1e5)
    exact_kp = reference.least_squares(
        basis.real_harmonics(stack.directions_i3, degree), samples_of(stack), np.ones(n_light)
    )
    assert image_error(stack, fit(stack, "uls", degree), exact_kp) < max(IMAGE, IMAGE_ROUNDING * condition)


@pytest.mark.parametrize("method", ["project", "uls", "cls", "ceb", "spline"])
def test_the_order_of_lights_and_pixels_does_not_matter(method):
    # A grid, whose rings make singular values coincide: their vectors must not depend on the order either.
    # Constant pixels are left out: whether their last component passes a bound that they meet exactly, chance decides.
    stack = stack_of(make_pattern("grid", 144))
    stack.images_ihwc[:, :, 1] *= np.linspace(0.5, 1.0, 144, dtype=np.float32)[:, None, None]
    order_i, order_p = np.random.default_rng(0).permutation(144), np.random.default_rng(1).permutation(48)
    found = fit(stack, method, 5).coeffs_khwc
    turned = LightStack(stack.images_ihwc[order_i], stack.directions_i3[order_i], 1.0)
    assert np.abs(fit(turned, method, 5).coeffs_khwc - found).max() < 1e-5 * np.abs(found).max() * (
        1e3 if method == "uls" else 1
    )
    mixed = LightStack(stack.images_ihwc[:, :, order_p], stack.directions_i3, 1.0)
    options = {"lam": 0.1} if method == "spline" else {}  # found on samples in their order
    np.testing.assert_array_equal(
        fit(mixed, method, 5, **options).coeffs_khwc,
        fit(stack, method, 5, **options).coeffs_khwc[:, :, order_p],
    )


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("angle", [0.3, np.pi / 2, 3.0])
def test_turning_the_lights_about_z_turns_the_coefficients(method, angle):
    # c_(l,m) and c_(l,-m) turn like cos(m phi) and sin(m phi).
    degree, lights = 5, make_pattern("uniform", 120)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    stack = stack_of(lights)
    turned = LightStack(stack.images_ihwc, lights @ turn.T, 1.0)
    before, after = columns_of(fit(stack, method, degree)), columns_of(fit(turned, method, degree))
    expected = before.copy()
    for l in range(degree + 1):
        for m in range(1, l + 1):
            cosine, sine = before[l * l + l + m], before[l * l + l - m]
            expected[l * l + l + m] = np.cos(m * angle) * cosine - np.sin(m * angle) * sine
            expected[l * l + l - m] = np.sin(m * angle) * cosine + np.cos(m * angle) * sine
    assert np.abs(after - expected).max() < 1e-5 * np.abs(before).max()


@pytest.mark.parametrize("energy", [1e-300, 1e-13, 1e13, 1e300])
@pytest.mark.parametrize("method", ["cls", "ceb", "ceb-crossing"])
def test_factors_beyond_float32_are_refused(method, energy):
    with pytest.raises(InputError, match=r"energy must be a factor on E_c from 1e-12 to 1e\+12, got"):
        prepare_fit(stack_of(make_pattern("uniform", 9), columns=3), method, 1, options={"energy": energy})


@pytest.mark.parametrize("method", ["spectrum", "auto"])
def test_more_lights_than_pairs_can_be_held_of_are_refused(method):
    lights = make_pattern("uniform", 8193)
    stack = LightStack(np.ones((8193, 1, 1, 1), np.uint8), lights, 255.0)
    with pytest.raises(InputError, match="each other, at most 8192, got 8193: take another method"):
        fit(stack, method, "auto")
