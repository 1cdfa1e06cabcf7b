"""The noise a codec adds: what is predicted before encoding, against what decoding then shows."""

import functools
import math

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, encode, predict_noise
from clrelight.codec.formats.half import rounding_variance
from clrelight.codec.rate.noise import Noise, measure_image_error, sample_blocks, sample_columns
from clrelight.codec.streams import ArraySource
from clrelight.errors import InputError
from clrelight.jobs.fit import fit
from tests.commands import succeed
from tests.reference.basis import real_harmonics
from tests.stacks import ring_stack

PREDICTED = [("half", {}), ("s3tc", {}), ("uniform", {"bits": 4}), ("uniform", {"bits": 8})]
PREDICTED += [("whitened", {"codec": name, "options": options}) for name, options in (("half", {}), ("s3tc", {}))]
PREDICTED += [("whitened", {"codec": "uniform", "options": {"bits": 4}})]
GRID = [(method, *setting) for method in ("uls", "cls", "ceb") for setting in PREDICTED]
# Coding the maps takes most of the time here, so not every method has every rate.
RATES = {"uls": (0.5, 1.0, 2.0, 4.0), "cls": (0.5, 2.0), "ceb": (1.0,)}
GRID += [(method, "wavelet", {"rate": rate}) for method, rates in RATES.items() for rate in rates]
SCALABLE = [("half", {}), ("s3tc", {}), ("uniform", {"bits": 5}), ("wavelet", {"rate": 2.0})]


def decibels(error):
    return -10.0 * math.log10(error)


def hemisphere(count=24):
    """Return directions and weights, adding to 1, that integrate polynomials of degree below 2 `count` exactly."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    z = np.repeat((nodes + 1.0) / 2.0, 2 * count)
    azimuth = np.tile(np.arange(2 * count) * np.pi / count, count)
    side = np.sqrt(1.0 - z * z)
    return np.stack([side * np.cos(azimuth), side * np.sin(azimuth), z], 1), np.repeat(weights / 2, 2 * count) / (
        2 * count
    )


@functools.cache
def fitted(method):
    """Return the ring's coefficients by a method, of degree 4."""
    return fit(ring_stack(), method, degree=4).coeffs_khwc


def make_map(shape=(9, 24, 20, 3), seed=0):
    rng = np.random.default_rng(seed)
    smooth = rng.standard_normal(shape).cumsum(axis=1).cumsum(axis=2)
    return (smooth / 2.0 ** np.arange(shape[0])[:, None, None, None]).astype(np.float32)


@pytest.mark.parametrize(("method", "name", "options"), GRID, ids=str)
def test_prediction_on_the_ring_is_within_a_decibel(device, method, name, options):
    coeffs_khwc = fitted(method)
    codec = codec_class(name).from_config(options)
    predicted = predict_noise(coeffs_khwc, codec, device).image_error()
    measured = measure_image_error(coeffs_khwc, decode(encode(coeffs_khwc, codec, device).to_bytes(), device))
    assert abs(decibels(predicted) - decibels(measured)) <= 1.0


def test_errors_of_large_coefficients_are_not_independent(device):
    """What equation (11) leaves out: the maps of an unbounded fit are nearly multiples of each other."""

    def excess(method, name):
        noise = predict_noise(fitted(method), codec_class(name)(), device)
        return 10 * np.log10(noise.image_error_if_independent() / noise.image_error())

    assert excess("uls", "s3tc") > excess("cls", "s3tc") + 3.0
    assert abs(excess("cls", "uniform")) < 0.2
    assert excess("uls", "half") == pytest.approx(0.0, abs=1e-9)


def test_measured_error_is_the_mean_over_the_hemisphere():
    original = make_map((16, 3, 5, 2))
    decoded = original + np.float32(0.1) * make_map((16, 3, 5, 2), seed=1)
    directions, weights = hemisphere()
    errors_kp = (decoded.astype(np.float64) - original).reshape(16, -1)
    images_ip = real_harmonics(directions, 3) @ errors_kp
    expected = weights @ np.mean(images_ip**2, axis=1)
    assert measure_image_error(original, decoded) == pytest.approx(expected, rel=1e-10)
    assert Noise.of_coefficients(errors_kp @ errors_kp.T / errors_kp.shape[1]).image_error() == pytest.approx(expected)
    assert measure_image_error(original, original) == 0.0


def test_independent_relative_noise_is_equation_11():
    c = np.random.default_rng(3).standard_normal(49) * 10.0
    relative = 0.01
    noise = Noise.of_coefficients(np.diag((relative * c) ** 2))
    over_the_hemisphere = 2.0 * np.pi * noise.image_error_if_independent()
    assert over_the_hemisphere == pytest.approx(0.5 * relative**2 * np.sum(c**2), rel=1e-12)
    assert noise.image_error() == pytest.approx(noise.image_error_if_independent(), rel=1e-12)


def test_half_rounding_noise_of_every_binade():
    rng = np.random.default_rng(4)
    for exponent in [*range(-30, 15, 3), -25, -24, -15, -14]:
        values = (rng.uniform(1.0, 2.0, 20000) * 2.0**exponent * rng.choice([-1, 1], 20000)).astype(np.float32)
        actual = np.mean((values.astype(np.float16).astype(np.float64) - values.astype(np.float64)) ** 2)
        assert rounding_variance(values).mean() == pytest.approx(actual, rel=0.04), exponent
    assert rounding_variance(np.float32([0.0, 70000.0])).tolist() == [0.0, (70000.0 - 65504.0) ** 2]


@pytest.mark.parametrize(("name", "options"), SCALABLE, ids=str)
def test_noise_grows_with_the_coefficients(device, name, options):
    codec, coeffs_khwc = codec_class(name).from_config(options), make_map()
    noise, doubled = (predict_noise(values, codec, device) for values in (coeffs_khwc, 2.0 * coeffs_khwc))
    np.testing.assert_allclose(doubled.covariance_jj, 4.0 * noise.covariance_jj, rtol=1e-5)


@pytest.mark.parametrize(("name", "options"), [*SCALABLE, ("whitened", {"codec": "half"})], ids=str)
def test_black_loses_nothing(device, name, options):
    codec = codec_class(name).from_config(options)
    black = np.zeros((9, 16, 16, 3), np.float32)
    assert predict_noise(black, codec, device).image_error() == 0.0


def test_whitened_errors_weigh_the_same(device):
    noise = predict_noise(make_map(), codec_class("whitened").from_config({"codec": "uniform"}), device)
    assert noise.image_error_if_independent() == pytest.approx(noise.image_error(), rel=1e-9)
    assert noise.image_error() == pytest.approx(np.trace(noise.covariance_jj) / (2 * np.pi), rel=1e-9)


def test_samples_are_parts_of_the_map(device):
    coeffs_khwc = np.arange(4 * 160 * 164 * 3, dtype=np.float32).reshape(4, 160, 164, 3)
    columns = sample_columns(ArraySource(coeffs_khwc, device))
    assert columns.shape == (4, 1, 16384, 1)
    assert len(set(columns[0].ravel().tolist())) == 16384
    assert (np.diff(columns, axis=0) == 160 * 164 * 3).all()
    blocks = sample_blocks(ArraySource(coeffs_khwc, device), 4)
    assert blocks.shape == (4, 4, 4 * 1024, 3)
    left = blocks[:, :, ::4]
    for x in range(4):
        np.testing.assert_array_equal(blocks[:, :, x::4], left + 3 * x)
    corners = left[0, 0, :, 0]
    assert (corners % 12 == 0).all()
    assert (corners // (164 * 3) % 4 == 0).all()
    np.testing.assert_array_equal(left[0, 3, :, 0], corners + 3 * 164 * 3)


def test_what_encode_refuses_prediction_refuses(device):
    for codec, coeffs in (
        (codec_class("half")(), np.full((4, 2, 2, 1), np.nan, np.float32)),
        (codec_class("wavelet")(rate=1e-3), make_map((4, 8, 8, 1))),
    ):
        with pytest.raises(InputError):
            predict_noise(coeffs, codec, device)


def test_no_model_and_no_hemisphere_are_none(device):
    assert predict_noise(make_map(), codec_class("vq")(), device) is None
    whitened = codec_class("whitened").from_config({"codec": "vq"})
    assert predict_noise(make_map(), whitened, device) is None
    assert predict_noise(np.ones((42**2, 1, 1, 1), np.float32), codec_class("half")(), device) is None


def test_bench_report_and_encode_show_both(tmp_path):
    out, small = tmp_path / "r.h5", ["--size", 16, "--lights", 40, "--degrees", 2, "--methods", "cls"]
    rows = succeed("bench", "ring", "--out", out, *small, "--codecs", "none,half,cpca", "--json").json["rows"]
    by_codec = {row["codec"]: row for row in rows}
    keys = ("coding_psnr_independent", "coding_psnr_predicted", "coding_psnr")
    assert [by_codec["none"][key] for key in keys] == ["inf"] * 3
    assert np.ptp([by_codec["half"][key] for key in keys]) < 1.0
    assert by_codec["half"]["coding_psnr"] > 60.0
    assert [by_codec["cpca"][key] for key in keys[:2]] == [None] * 2
    succeed("report", out, "--out", tmp_path / "report")
    page = (tmp_path / "report" / "report.md").read_text()
    part = page[page.index("### Noise: predicted and measured") :]
    assert f"{by_codec['half']['coding_psnr']:.2f}" in part[: part.index("As files")]
    for ending in ("md", "csv", "tex"):
        assert (tmp_path / "report" / "tables" / f"noise.{ending}").stat().st_size > 100

    stack, fitted_file, enc = (tmp_path / name for name in ("s.h5", "f.h5", "e.h5"))
    succeed("synth", "ring", stack, "--size", 16, "--lights", 40)
    succeed("fit", stack, fitted_file, "--method", "cls", "--degree", 2)
    told = succeed("encode", fitted_file, enc, "--codec", "half", "--json").json["coding_noise"]
    assert told["coding_psnr_predicted"] == pytest.approx(by_codec["half"]["coding_psnr_predicted"], abs=1e-6)
    assert "coding_psnr" not in told
    shown = succeed("encode", fitted_file, enc, "--codec", "half", "--stack", stack).out
    assert f"{by_codec['half']['coding_psnr']:.2f} dB measured" in shown
