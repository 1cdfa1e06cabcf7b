"""`spectrum-curve`: values as displayed are fitted, coefficients are of radiance."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import collect_fit, method_class, prepare_fit
from clrelight.fit.columns import launch_columns
from clrelight.metrics import measure_errors
from clrelight.relight import relight
from clrelight.sampling import make_pattern
from tests.reference import spectrum as reference
from tests.styles import both_styles

SPECTRUM = {"level": 0.4, "slope": 2.2, "edge": 0.05, "heat": 0.02, "noise": 1e-3}
GIVEN = {**SPECTRUM, "azimuth": 0.0, "tilt": 1.0, "share": 0.0}
UNSEEN = make_pattern("uniform", 23)


def to_linear(v):
    """IEC 61966-2-1; a line below 0 too."""
    return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0.0) + 0.055) / 1.055) ** 2.4)


def to_curve(v):
    return np.where(v <= 0.0031308, v * 12.92, 1.055 * np.maximum(v, 0.0) ** (1 / 2.4) - 0.055)


def make_stack(directions, transfer="srgb", dtype=np.uint8, peak=255, noise=0.0):
    """Columns that are quadratic in the light's direction as displayed."""
    rng = np.random.default_rng(5)
    x, y, z = directions.T[:, :, None]
    a, b, c = rng.uniform(-0.25, 0.25, (3, 60))
    shown = 0.45 + a * x + b * y + c * (2 * z - 1) + 0.3 * (a + b) * x * y
    shown = np.clip(shown + noise * rng.standard_normal(shown.shape), 0, 1)
    codes = shown if transfer == "srgb" else to_linear(shown)
    return LightStack(
        np.rint(codes * peak).astype(dtype).reshape(len(directions), 2, 10, 3), directions, peak, transfer
    )


def mean_psnr(coefficients, tested):
    return float(np.mean(-10 * np.log10(measure_errors(coefficients, tested))))


@both_styles
@pytest.mark.parametrize("shape", [(1, 16), (3, 48), (5, 1072)])
def test_values_on_the_curve_become_radiance(device, shape):
    v = np.linspace(-0.5, 2.0, shape[0] * shape[1]).reshape(shape).astype(np.float32)
    z = device.hold(v.copy())
    launch_columns(device, "fit/decode_curve.cl", "decode_rq", z, *shape, defines={})
    exact = to_linear(np.minimum(v.astype(np.float64), 1.25))
    assert np.abs(device.download(z) - exact).max() < 3e-6


@pytest.mark.parametrize(("transfer", "dtype", "peak"), [("srgb", np.uint8, 255), ("linear", np.uint16, 60000)])
def test_images_are_radiance_of_what_kriging_says_of_values_as_displayed(device, transfer, dtype, peak):
    lights = make_pattern("uniform", 30)
    stack = make_stack(lights, transfer, dtype, peak)
    method = method_class("spectrum-curve").from_config(GIVEN)
    fitted = collect_fit(prepare_fit(stack, method, 15, device=device))
    shown_ip = stack.images_ihwc.reshape(30, -1) / peak
    shown_ip = shown_ip if transfer == "srgb" else to_curve(shown_ip)
    a_l = reference.variances(*list(SPECTRUM.values())[:4])
    exact_tp = to_linear(reference.predict(a_l, SPECTRUM["noise"], lights, shown_ip, UNSEEN))
    found_tp = relight(fitted, UNSEEN, device=device).reshape(len(UNSEEN), -1)
    assert np.abs(found_tp - exact_tp).max() < 2e-3
    # And not what kriging says of radiance.
    other = collect_fit(prepare_fit(stack, "spectrum", 15, options=GIVEN, device=device))
    assert np.abs(relight(other, UNSEEN, device=device).reshape(found_tp.shape) - exact_tp).max() > 0.01


def test_tiles_and_masks_change_nothing(device):
    stack = make_stack(make_pattern("uniform", 20))
    whole = collect_fit(prepare_fit(stack, "spectrum-curve", 4, options=GIVEN, device=device))
    mask_hw = np.ones((2, 10), bool)
    mask_hw[0, 3] = False
    prepared = prepare_fit(replace(stack, mask_hw=mask_hw), "spectrum-curve", 4, options=GIVEN, device=device)
    tiled = collect_fit(prepared, memory_bytes=1 << 15)
    assert not tiled.coeffs_khwc[:, ~mask_hw].any()
    np.testing.assert_allclose(tiled.coeffs_khwc[:, mask_hw], whole.coeffs_khwc[:, mask_hw], atol=1e-5)


def test_only_integers_are_on_the_curve(device):
    stack = make_stack(make_pattern("uniform", 20))
    floats = replace(stack, images_ihwc=np.asarray(stack.images_ihwc, np.float32))
    with pytest.raises(
        InputError, match="spectrum-curve fits integer code values; these images are float32: take spec"
    ):
        prepare_fit(floats, "spectrum-curve", 4, device=device)
    assert prepare_fit(floats, "auto", "auto", device=device).method.id == "spectrum"


@pytest.mark.parametrize(("transfer", "within"), [("srgb", 1.24), ("linear", 1.66)])
def test_what_is_far_over_the_peak_is_not_cut(device, transfer, within):
    """Radiance beyond the curve would be lost without a word."""
    stack = make_stack(make_pattern("uniform", 24), transfer, np.uint16, 4095, noise=0.01)
    images_ihwc = stack.images_ihwc.copy()
    images_ihwc[3, 1, 4] = 4095 * within
    held = replace(stack, images_ihwc=images_ihwc)
    assert prepare_fit(held, "spectrum-curve", 4, options=GIVEN, device=device).method.id == "spectrum-curve"
    images_ihwc[3, 1, 4] = 4095 * (within + 0.1)
    with pytest.raises(InputError, match=r"spectrum-curve fits code values up to .* under a peak of 4095, one is"):
        prepare_fit(held, "spectrum-curve", 4, options=GIVEN, device=device)
    assert prepare_fit(held, "auto", 2, device=device).choice.code_gain is None


@pytest.mark.parametrize("transfer", ["srgb", "linear"])
def test_auto_takes_it_where_it_is_clearly_better(device, transfer):
    stack, unseen = (make_stack(make_pattern("uniform", n), transfer, noise=0.01) for n in (24, 97))
    prepared, plain = (prepare_fit(stack, method, "auto", device=device) for method in ("auto", "spectrum"))
    reached, other = (mean_psnr(collect_fit(one), unseen) for one in (prepared, plain))
    assert (prepared.method.id, plain.method.id) == ("spectrum-curve", "spectrum")
    assert reached > other + 0.3
    assert prepared.choice.chosen.predicted == pytest.approx(reached, abs=2.5)
    assert prepared.choice.code_gain > 0.5
    assert "dB better there than fitted as radiance" in prepared.choice.note
    told = prepared.choice.to_config()
    assert told["chosen"]["method"] == "spectrum-curve"
    assert [one["method"] for one in told["tried"]].count("spectrum") == 1
    named = prepare_fit(stack, "spectrum-curve", "auto", device=device)
    assert (named.method, named.degree) == (prepared.method, prepared.degree)
