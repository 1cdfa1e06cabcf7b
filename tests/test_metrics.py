from dataclasses import replace

import numpy as np
import pytest

from clrelight.cli.psnr import psnr_lines
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.errors import InputError
from clrelight.metrics import domain_note, measure_errors, psnr_of, summarize_errors
from clrelight.relight import relight
from clrelight.sampling import make_pattern
from tests.reference import basis, psnr
from tests.styles import both_styles, every_width


def make_case(dtype, shape_hwc, *, n_light=9, degree=2, transfer="linear", peak=None, seed=0):
    """Return a map whose images go below 0 and above 1, and a stack that goes above its peak."""
    rng = np.random.default_rng(seed)
    directions = make_pattern("uniform", n_light)
    coeffs = 0.5 * rng.standard_normal(((degree + 1) ** 2, *shape_hwc)).astype(np.float32)
    coeffs[0] += 1.5
    if np.dtype(dtype).kind == "u":
        top = np.iinfo(dtype).max
        images, peak = rng.integers(0, top, (n_light, *shape_hwc), dtype, endpoint=True), peak or 0.8 * top
    else:
        peak = peak or 1.0
        images = (peak * rng.random((n_light, *shape_hwc)) * 1.2).astype(dtype)
    fitted = CoefficientMap(coeffs, degree, "uls", 1.0, transfer, directions)
    return fitted, LightStack(images, directions, peak, transfer)


def reference_errors(fitted, stack, mask_hw=None):
    basis_ik = basis.real_harmonics(stack.directions_i3, fitted.degree)
    relit = np.einsum("ik,khwc->ihwc", basis_ik, fitted.coeffs_khwc.astype(np.float64))
    assert relit.min() < 0
    assert relit.max() > 1
    mask_hw = np.ones(stack.image_shape[:2], bool) if mask_hw is None else mask_hw
    return psnr.mean_squared_errors(relit, stack.images_ihwc, stack.peak, stack.transfer, mask_hw)


@both_styles
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_every_sample_type_and_curve(device, dtype, transfer):
    fitted, stack = make_case(dtype, (13, 37, 3), transfer=transfer)
    np.testing.assert_allclose(measure_errors(fitted, stack), reference_errors(fitted, stack), rtol=2e-6)


@every_width
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_whole_tiles_through_the_curve_at_every_width(device, dtype):
    fitted, stack = make_case(dtype, (5, 257, 3), transfer="srgb")
    np.testing.assert_allclose(measure_errors(fitted, stack), reference_errors(fitted, stack), rtol=2e-6)


@both_styles
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_black_and_white_have_no_error(device, transfer):
    fitted, stack = make_case("uint8", (3, 700, 1), n_light=1, degree=0, transfer=transfer, peak=255.0)
    fitted.coeffs_khwc[:] = stack.images_ihwc[:] = np.arange(2100).reshape(stack.image_shape) % 2
    fitted.coeffs_khwc[:] *= 9
    stack.images_ihwc[:] *= 255
    assert measure_errors(fitted, stack)[0] == 0


@both_styles
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_what_is_no_number_is_not_counted_as_right(device, transfer):
    fitted, stack = make_case("uint8", (3, 700, 1), transfer=transfer)
    fitted.coeffs_khwc[0, 0, 5, 0] = np.nan
    assert np.isnan(measure_errors(fitted, stack)).all()


@both_styles
@pytest.mark.parametrize("width", [3, 7, 8, 1023, 1024, 1025, 2053, 4095, 4096, 4097])  # about vectors and segments
def test_any_width(device, width):
    fitted, stack = make_case("float32", (1, width, 1))
    np.testing.assert_allclose(measure_errors(fitted, stack), reference_errors(fitted, stack), rtol=2e-6)


def test_several_tiles(device, monkeypatch):
    monkeypatch.setattr("clrelight.metrics.PIECE_BYTES", 4 * (9 + 9) * 37 * 3 * 2)
    monkeypatch.setattr("clrelight.metrics._IN_PLACE", 1)
    fitted, stack = make_case("uint8", (13, 37, 3))
    done = []
    errors = measure_errors(fitted, stack, progress=lambda *step: done.append(step))
    assert done == [(min(end, 13), 13) for end in range(2, 15, 2)]
    np.testing.assert_allclose(errors, reference_errors(fitted, stack), rtol=2e-6)


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_masked_pixels_do_not_count(device, transfer):
    fitted, stack = make_case("uint8", (13, 37, 3), transfer=transfer)
    mask = np.random.default_rng(3).random((13, 37)) < 0.3
    masked = replace(stack, mask_hw=mask)
    np.testing.assert_allclose(measure_errors(fitted, masked), reference_errors(fitted, stack, mask), rtol=2e-6)
    stack.images_ihwc[:, ~mask] = 0
    np.testing.assert_allclose(measure_errors(fitted, masked), reference_errors(fitted, stack, mask), rtol=2e-6)


@both_styles
def test_values_are_clipped_before_they_are_compared(device):
    fitted, stack = make_case("float32", (1, 2, 1), n_light=1, degree=0)
    fitted.coeffs_khwc[:] = np.array([-3.0, 9.0]).reshape(1, 1, 2, 1)
    stack.images_ihwc[:] = np.array([0.0, 5.0]).reshape(1, 1, 2, 1)
    assert measure_errors(fitted, stack)[0] == 0


def test_identical_images(device):
    fitted, stack = make_case("float32", (5, 7, 3))
    relit = np.maximum(relight(fitted, stack.directions_i3), 0)
    same = replace(stack, images_ihwc=relit)
    np.testing.assert_array_equal(measure_errors(fitted, same), 0.0)
    quality = summarize_errors(measure_errors(fitted, same))
    assert quality.psnr_mean == quality.psnr_pooled == np.inf
    relit[4, 0, 0, 0] = 0.5 * relit[4, 0, 0, 0] + 0.01
    quality = summarize_errors(measure_errors(fitted, same))
    assert quality.psnr_mean == np.inf
    assert np.isfinite(quality.psnr_pooled)
    assert np.isfinite(quality.psnr_i).sum() == 1
    assert (quality.n_identical, quality.psnr_others) == (8, pytest.approx(quality.psnr_i[4]))
    assert quality.note == f"8 of 9 images are identical, {quality.psnr_i[4]:.2f} dB mean over the others"


def test_an_infinite_mean_is_not_printed_as_identical():
    some = {"mean_fitted": np.inf, "pooled_fitted": 42.0, "identical_fitted": 2, "mean_others_fitted": 41.0}
    line = "41.00 dB mean over the lights whose images are not identical (2 are), 42.00 dB pooled"
    assert psnr_lines(some) == {"PSNR": line}
    every = {"mean_fitted": np.inf, "pooled_fitted": np.inf}
    line = "inf dB (identical) mean over lights, inf dB (identical) pooled"
    assert psnr_lines(every) == {"PSNR": line}


@pytest.mark.parametrize(("fit_transfer", "transfer"), [("linear", "srgb"), ("srgb", "linear")])
def test_a_stack_of_another_curve_is_converted_and_that_is_said(device, fit_transfer, transfer):
    fitted, same = make_case("uint8", (5, 7, 3), transfer=fit_transfer)
    fitted = replace(fitted, peak=same.peak)
    _, stack = make_case("uint8", (5, 7, 3), transfer=transfer)
    assert domain_note(fitted, same) == ""
    assert f"of a {fit_transfer} stack with peak 204, this one is {transfer}" in domain_note(fitted, stack)
    np.testing.assert_allclose(measure_errors(fitted, stack), reference_errors(fitted, stack), rtol=2e-6)


def test_other_lights_and_peaks_than_the_fit_s(device):
    fitted, _ = make_case("uint8", (4, 6, 3))
    _, stack = make_case("uint16", (4, 6, 3), n_light=5, seed=8)
    np.testing.assert_allclose(measure_errors(fitted, stack), reference_errors(fitted, stack), rtol=2e-6)


def test_an_empty_mask(device):
    fitted, stack = make_case("uint8", (2, 3, 1))
    with pytest.raises(InputError, match="the mask leaves no pixel to measure"):
        measure_errors(fitted, replace(stack, mask_hw=np.zeros((2, 3), bool)))


@pytest.mark.parametrize("shape", [(3, 2, 3), (2, 3, 1), (4, 3, 3)])
def test_another_view(device, shape):
    fitted, _ = make_case("uint8", (2, 3, 3))
    _, stack = make_case("uint8", shape)
    with pytest.raises(InputError, match=r"coefficients are of images \(2, 3, 3\) but the stack has \("):
        measure_errors(fitted, stack)


def test_decibels():
    np.testing.assert_allclose(psnr_of(np.array([1.0, 0.1, 1e-3, 0.5])), [0, 10, 30, psnr.psnr(0.5)], atol=1e-12)
    assert psnr_of(0.0) == np.inf
    quality = summarize_errors(np.array([1e-2, 1e-4]))
    assert quality.psnr_mean == pytest.approx(30.0)
    assert quality.psnr_pooled == pytest.approx(psnr.psnr(5.05e-3))
    np.testing.assert_allclose(quality.psnr_i, [20, 40])
