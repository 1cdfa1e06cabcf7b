"""Radiance, peaks and single samples from 1e-30 to 1e30: what squares in float32 could not hold."""

from contextlib import nullcontext

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit.scaling import TileScaling, column_peaks
from clrelight.jobs.fit import fit
from clrelight.relight import relight
from clrelight.sampling import make_pattern
from tests.extremes.judge import IMAGE, cap, judge, stack_of, with_images
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import columns_of, samples_of
from tests.styles import both_styles, gpu_style

METHODS = ["cls", "ceb"]
SCALES = [1e-30, 1e-20, 1e-15, 1e-9, 1e9, 1e15, 1e20, 1e30]
LIGHTS = make_pattern("uniform", 90)


@both_styles
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("method", METHODS)
def test_radiance(device, method, scale):
    assert judge(stack_of(LIGHTS, scale), method, 4) < IMAGE


@gpu_style
@pytest.mark.parametrize("peak", [1e-30, 1e30])
def test_peak_on_a_gpu(device, peak):
    assert judge(stack_of(LIGHTS, peak, peak=peak), "cls", 4) < IMAGE


@pytest.mark.parametrize("peak", [1e-37, 1e-30, 1e-10, 1e10, 1e30, 3.3e36])
@pytest.mark.parametrize("method", METHODS)
def test_peak(method, peak):
    assert judge(stack_of(LIGHTS, peak=1.0 if peak < 1e-30 else peak), method, 4) < IMAGE
    assert judge(stack_of(LIGHTS, peak, peak=peak), method, 4) < IMAGE


@pytest.mark.parametrize("peak", [0.5, 1e-25, 1e25])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float16])
def test_peaks_of_other_types(dtype, peak):
    assert judge(stack_of(LIGHTS, 200.0, peak=peak, dtype=dtype), "cls", 4) < IMAGE


@pytest.mark.parametrize("method", ["uls", "sloan", "project", "spline"])
@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_linear_methods_scale(method, scale):
    # Rounded to float32 the samples are not multiples of each other, but nearly.
    options = {"lam": 0.1} if method == "spline" else {}
    plain = columns_of(fit(stack_of(LIGHTS), method, 4, **options))
    scaled = columns_of(fit(stack_of(LIGHTS, scale), method, 4, **options)) / scale
    assert np.abs(scaled - plain).max() < 1e-5 * np.abs(plain).max()


@both_styles
@pytest.mark.parametrize("power", [-100, -60, -1, 1, 60, 100])
@pytest.mark.parametrize(("method", "degree"), [("cls", 4), ("cls", 9), ("ceb", 4), ("uls", 4)])
def test_a_power_of_two_scales_coefficients_exactly(device, method, degree, power):
    stack = stack_of(LIGHTS)
    larger = LightStack(np.ldexp(stack.images_ihwc, power), LIGHTS, 1.0)
    plain, scaled = fit(stack, method, degree), fit(larger, method, degree)
    np.testing.assert_array_equal(np.ldexp(plain.coeffs_khwc, power), scaled.coeffs_khwc)
    if plain.lambda_hwc is not None:
        np.testing.assert_array_equal(plain.lambda_hwc, scaled.lambda_hwc)
    if plain.rank_hwc is not None:
        np.testing.assert_array_equal(plain.rank_hwc, scaled.rank_hwc)


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("method", METHODS)
def test_columns_of_all_brightnesses_beside_each_other(method, transfer):
    # Each is as good as it is alone: no column may be lost behind a brighter one.
    stack = stack_of(LIGHTS, columns=40)
    scale_p = 10.0 ** np.linspace(-30, 30 if transfer == "linear" else 3, 40)
    mixed = LightStack((stack.images_ihwc * scale_p[:, None]).astype(np.float32), LIGHTS, 1.0, transfer)
    fitted = fit(mixed, method, 4)
    for p in range(2, 40):
        alone = LightStack(mixed.images_ihwc[:, :, p : p + 1], LIGHTS, 1.0, transfer)
        found_k, alone_k = fitted.coeffs_khwc[:, 0, p], fit(alone, method, 4).coeffs_khwc[:, 0, 0]
        if transfer == "linear":
            np.testing.assert_array_equal(found_k, alone_k)
        sample_ip = samples_of(alone)
        energy = reference.bound(sample_ip, np.ones(90))
        assert np.sum(columns_of(fitted)[:, p] ** 2) <= energy * (1 + 1e-5)
        if method == "cls":  # of an sRGB curve, the kernels' and NumPy's differ by rounding errors
            np.testing.assert_allclose(found_k, alone_k, atol=IMAGE * sample_ip.max())
            exact_kp = reference.constrained(basis.real_harmonics(LIGHTS, 4), sample_ip, np.ones(90))[0]
            error_k = columns_of(fitted)[:, p] - exact_kp[:, 0]
            assert np.abs(basis.real_harmonics(LIGHTS, 4) @ error_k).max() < IMAGE * sample_ip.max()


def test_tiles_are_the_same_as_the_whole(tmp_path):
    from clrelight.store import open_stack, write_stack

    images = stack_of(LIGHTS, 1e25, columns=60).images_ihwc.reshape(90, 10, 6, 1).copy()
    images[:, :5] *= np.float32(1e-25)
    images[:, 7] *= np.float32(1e-40)
    stack = LightStack(images, LIGHTS, 1.0)
    before = images.copy()
    whole = fit(stack, "cls", 4)
    np.testing.assert_array_equal(fit(stack, "cls", 4, memory=20_000).coeffs_khwc, whole.coeffs_khwc)
    np.testing.assert_array_equal(images, before)  # a stack in memory is the caller's
    write_stack(tmp_path / "s.h5", stack)
    with open_stack(tmp_path / "s.h5") as opened:
        for memory in (20_000, 1 << 28):
            np.testing.assert_array_equal(fit(opened, "cls", 4, memory=memory).coeffs_khwc, whole.coeffs_khwc)


def test_float32_bounds_what_coefficients_can_be():
    bright = stack_of(LIGHTS, 1e30, peak=1e-30)
    with pytest.raises(InputError, match="coefficients, or images of them, exceed float32"):
        fit(bright, "cls", 4)


@pytest.mark.parametrize("sphere", [False, True])
@pytest.mark.parametrize("precision", ["mixed", "single", "double"])
@pytest.mark.parametrize("method", ["cls", "uls", "spline"])
def test_what_is_fitted_has_images(device, method, precision, sphere):
    """Samples up to the largest float32: what is not refused is relit without infinity."""
    lights = make_pattern("uniform", 40, sphere=sphere)
    plain = stack_of(lights, columns=8)
    options = {"lam": 0.1} if method == "spline" else {}
    for top in (1e36, 3.3e38):
        images = (plain.images_ihwc * (top / np.float64(plain.images_ihwc.max()))).astype(np.float32)
        stack = LightStack(images, lights, 1.0)
        with pytest.raises(InputError, match="images of them, exceed float32") if top > 1e37 else nullcontext():
            fitted = fit(stack, method, 4, precision=precision, **options)
            assert np.isfinite(relight(fitted, lights, device=device)).all()


@pytest.mark.parametrize("peak", [1e-38, 1e38, np.nextafter(1e-37, 0)])
def test_peaks_that_float32_does_not_hold(peak):
    with pytest.raises(InputError, match="peak must be from 1e-37 to 1e\\+37, which float32 holds"):
        stack_of(LIGHTS, peak=peak)


@pytest.mark.parametrize("degree", [6, 10, 13])
@pytest.mark.parametrize("method", METHODS)
def test_one_bright_sample(method, degree):
    lights = make_pattern("uniform", 200)
    for around in (0.0, 1e-6, 1e-30):
        images = np.full((200, 16), around)
        images[np.arange(16) * 7, np.arange(16)] = 1.0
        assert judge(with_images(images, lights), method, degree) < IMAGE


@pytest.mark.parametrize("method", ["project", "uls", "sloan", "cls", "ceb", "ceb-crossing", "spline"])
def test_nothing_but_zeros(method):
    black = with_images(np.zeros((90, 5)), LIGHTS)
    fitted = fit(black, method, 4)
    assert (fitted.coeffs_khwc == 0).all()
    signed = with_images(-np.zeros((90, 5)), LIGHTS)
    assert (fit(signed, method, 4).coeffs_khwc == 0).all()


@pytest.mark.parametrize("value", [1e-30, 0.7, 1e30])
@pytest.mark.parametrize("degree", [0, 4, 10])
@pytest.mark.parametrize("method", METHODS)
def test_constant_pixels(method, degree, value):
    assert judge(with_images(np.full((90, 5), value), LIGHTS), method, degree) < IMAGE


@pytest.mark.parametrize("value", [1e-45, 1e-42, 1e-39])
@pytest.mark.parametrize("method", METHODS)
def test_subnormal_samples(method, value):
    # The coefficients are subnormal too: whole multiples of 2^-149.
    images = np.full((90, 3), np.float32(value))
    images[::2, 1] = 0
    stack = with_images(images, LIGHTS)
    fitted = fit(stack, method, 2)
    basis_ik = basis.real_harmonics(LIGHTS, 2)
    exact_kp = reference.constrained(basis_ik, samples_of(stack), np.ones(90))[0]
    if method == "ceb":  # twice the first is 1/2: the constant pixels keep everything
        exact_kp = reference.truncated(basis_ik, samples_of(stack), np.ones(90), 1.0 + 1e-6)[0]
    assert np.abs(columns_of(fitted) - exact_kp).max() <= 2.0**-149 + 1e-5 * value


@pytest.mark.parametrize("value", [65504.0, 65520.0, 6e-8])
def test_ends_of_half(value):
    if value > 65504.0:
        with (
            pytest.raises(InputError, match="image 0 is inf at row 0, column 1, channel 0"),
            np.errstate(over="ignore"),
        ):
            fit(stack_of(LIGHTS, 2 * value, dtype=np.float16), "cls", 4)
        return
    images = np.full((90, 1, 6, 1), value, np.float16)
    images[::3, 0, 2:] = 0
    for peak in (1.0, 65504.0):
        for method in METHODS:
            assert judge(LightStack(images, LIGHTS, peak), method, 4) < IMAGE


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("bad", [np.nan, -np.nan, np.inf, -np.inf, -1e-7])
@pytest.mark.parametrize("scale", [1.0, 1e-4])
def test_bad_samples_are_refused_by_position(dtype, bad, scale):
    images = np.full((90, 6, 5, 2), scale, dtype)
    images[::2, 3] = 0.0
    images[31, 4, 2, 1] = bad
    stack = LightStack(images, LIGHTS, 1.0)
    for memory in (1 << 28, 20_000):
        with pytest.raises(InputError, match=r"image 31 is \S+ at row 4, column 2, channel 1: radiance must be finite"):
            fit(stack, "cls", 2, memory=memory)


def test_held_out_lights_do_not_shift_the_name_of_a_bad_image():
    images = np.ones((10, 1, 2, 1), np.float32)
    images[7, 0, 1, 0] = np.nan
    stack = LightStack(images, make_pattern("uniform", 10), 1.0)
    for held in (2, 3, 5):  # of which only 2 keeps image 7 out
        if held != 2:
            with pytest.raises(InputError, match="image 7 is nan"):
                fit(stack, "cls", 1, holdout=held)
    with pytest.raises(InputError, match="image 7 is nan"):
        fit(stack.select(np.array([1, 3, 7, 9])).select(np.array([0, 2, 3])), "cls", 1)


def test_photographs_are_left_alone():
    for stack in (stack_of(LIGHTS), stack_of(LIGHTS, 1e-5), stack_of(LIGHTS, 255, peak=255, dtype=np.uint8)):
        from clrelight.fit import prepare_fit

        tile = TileScaling(stack, prepare_fit(stack, "cls", 6).plan, np.dtype(np.float32)).load(0, 1)
        assert tile.exponent_hwc is None
        assert np.may_share_memory(tile.samples_ihwc, stack.images_ihwc)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_peaks_of_columns(dtype):
    values = np.abs(np.random.default_rng(0).standard_normal((7, 20_000))).astype(dtype)
    np.testing.assert_array_equal(column_peaks(values), values.max(axis=0))
    for bad in (np.nan, np.inf, -np.inf, -1.0, -0.0):
        values[3, 17] = bad
        assert np.flatnonzero(~np.isfinite(column_peaks(values))).tolist() == [17]


def test_caps_keep_their_scale():
    for scale in (1e-25, 1e25):
        assert judge(stack_of(cap(300, 10), scale), "cls", 6) < IMAGE
