import tracemalloc

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.codec.formats.klt import Klt
from clrelight.codec.minimum_size import pad_to_minimum
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.basis import evaluate_basis
from tests.mutations import check_large_claims


def smooth_map(degree, height, width, channel, seed=0, rank=6):
    """A few smooth planes times smooth spherical functions, and a little of everything else."""
    rng = np.random.default_rng(seed)
    n_coeff = (degree + 1) ** 2
    y, x = np.mgrid[:height, :width]
    planes = [np.cos(0.2 * rng.random() * x + 0.3 * rng.random() * y + 6 * rng.random()) for _ in range(rank)]
    decay = 1.0 / (1.0 + np.arange(n_coeff)) ** 0.7
    loadings = rng.standard_normal((n_coeff, channel, rank)) * decay[:, None, None]
    coeffs = np.einsum("kcr,rhw->khwc", loadings, np.array(planes))
    return (coeffs + 0.002 * rng.standard_normal(coeffs.shape)).astype(np.float32)


def image_error(a_khwc, b_khwc, degree):
    """Root mean square over the hemisphere, by a quadrature of this test's own (uniform in z and azimuth)."""
    z, azimuth = np.meshgrid((np.arange(40) + 0.5) / 40, 2 * np.pi * np.arange(64) / 64, indexing="ij")
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1).reshape(-1, 3)
    difference = (a_khwc.astype(np.float64) - b_khwc).reshape(len(a_khwc), -1)
    return float(np.sqrt(np.mean((evaluate_basis(directions, degree) @ difference) ** 2)))


@pytest.mark.parametrize("degree", [0, 1, 4, 6, 9])
@pytest.mark.parametrize("axes", ["smooth", "singular"])
def test_metric_is_the_integral_over_the_hemisphere(degree, axes):
    # 200 x 64 nodes, nothing shared with the package: Gauss-Legendre in z, trapezoid in azimuth.
    nodes, weights = np.polynomial.legendre.leggauss(64)
    z, azimuth = np.meshgrid((nodes + 1) / 2, 2 * np.pi * np.arange(64) / 64, indexing="ij")
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], -1).reshape(-1, 3)
    basis = evaluate_basis(directions, degree)
    gram = (basis * np.repeat(weights / 2, 64)[:, None] * 2 * np.pi / 64).T @ basis
    metric = hemisphere_metric((degree + 1) ** 2, axes)
    np.testing.assert_allclose(metric.forward_jk.T @ metric.forward_jk, gram, atol=1e-12)
    np.testing.assert_allclose(metric.forward_jk @ metric.inverse_kj, np.eye(len(metric.forward_jk)), atol=1e-6)


def test_smooth_axes_are_ordered_by_roughness():
    metric = hemisphere_metric(49)
    l = np.concatenate([np.full(2 * l + 1, l) for l in range(7)])
    roughness = np.einsum("kj,k->j", metric.inverse_kj**2, (l * (l + 1.0)) ** 2)
    for m in range(7):
        rows = [l * (l + 1) + m for l in range(m, 7)]
        assert np.all(np.diff(roughness[rows]) > 0)


@pytest.mark.parametrize(("height", "width", "channel"), [(24, 32, 3), (17, 13, 1), (1, 29, 2), (5, 1, 3)])
def test_a_finer_step_is_a_smaller_error(device, height, width, channel):
    coeffs = smooth_map(4, height, width, channel)
    errors = []
    for step in (0.3, 0.03, 0.003):
        decoded = decode(encode(coeffs, Klt(step=step), device).to_bytes(), device)
        errors.append(image_error(coeffs, decoded, 4))
    assert errors[0] > errors[1] > errors[2]
    # The step is relative to the largest coefficient's power of two; one plane's error is about a third of it.
    scale = 2.0 ** np.ceil(np.log2(np.abs(coeffs).max()))
    assert errors[2] < 3 * 0.003 * scale


@pytest.mark.parametrize("budget", [600, 2000, 9000])
def test_a_byte_budget_is_filled_and_never_passed(device, budget):
    encoded = encode(smooth_map(6, 40, 48, 3), Klt(byte_budget=budget), device)
    assert 0.97 * budget <= encoded.encoded_bytes <= budget


def test_a_rate_is_a_budget(device):
    encoded = encode(smooth_map(6, 40, 48, 3), Klt(rate=0.2), device)
    assert 0.97 * 0.2 <= encoded.bits_per_coefficient <= 0.2


def test_relighting_the_planes_equals_relighting_the_coefficients(device):
    coeffs = smooth_map(6, 20, 31, 3)
    encoded = encode(coeffs, Klt(step=0.02), device)
    directions = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.36, 0.48, 0.8]])
    images = Klt.decode_view(encoded.body, encoded.shape, device).relight(directions, device)
    direct = np.einsum("ik,khwc->ihwc", evaluate_basis(directions, 6), decode(encoded, device).astype(np.float64))
    assert np.abs(images - direct).max() < 1e-5 * np.abs(direct).max()


def test_relighting_whitened_maps_equals_relighting_the_coefficients(device):
    coeffs = smooth_map(6, 20, 31, 3)
    encoded = encode(coeffs, codec_class("whitened").from_config({"codec": "half"}), device)
    directions = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.36, 0.48, 0.8]])
    view = decode_view(encoded, device)
    direct = np.einsum("ik,khwc->ihwc", evaluate_basis(directions, 6), decode(encoded, device).astype(np.float64))
    assert np.abs(view.relight(directions, device) - direct).max() < 1e-5 * np.abs(direct).max()


def test_a_codec_in_the_plain_basis_has_no_view(device):
    assert decode_view(encode(smooth_map(1, 4, 4, 3), codec_class("half")(), device), device) is None


def test_an_empty_map_and_a_constant_one(device):
    zeros = np.zeros((9, 8, 8, 3), np.float32)
    assert not decode(encode(zeros, Klt(step=0.01), device), device).any()
    constant = np.full((9, 8, 8, 3), 0.5, np.float32)
    error = image_error(constant, decode(encode(constant, Klt(step=0.001), device), device), 2)
    assert error < 0.001


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_scales(device, scale):
    coeffs = (smooth_map(3, 16, 16, 3) * scale).astype(np.float32)
    error = image_error(coeffs, decode(encode(coeffs, Klt(step=0.001), device), device), 3)
    assert error < 0.01 * np.abs(coeffs).max()


def test_same_map_same_bytes(device):
    coeffs = smooth_map(4, 30, 22, 3)
    assert encode(coeffs, Klt(rate=0.3), device).to_bytes() == encode(coeffs, Klt(rate=0.3), device).to_bytes()


def test_options_are_checked():
    for options in ({"rate": 1.0, "step": 0.1}, {"rate": -1.0}, {"byte_budget": 0}, {"step": 99.0}):
        with pytest.raises(InputError):
            Klt(**options)


def test_a_budget_too_small_is_refused(device):
    with pytest.raises(InputError, match="needs"):
        encode(smooth_map(4, 16, 16, 3), Klt(byte_budget=20), device)


@pytest.mark.parametrize("inner", ["half", "s3tc", "uniform", "wavelet"])
def test_whitened_gives_the_coefficients_back(device, inner):
    coeffs = smooth_map(4, 32, 32, 3)
    options = {"bits": 12} if inner == "uniform" else {"rate": 8.0} if inner == "wavelet" else {}
    whitened = codec_class("whitened").from_config({"codec": inner, "options": options})
    plain = codec_class(inner).from_config(options)
    error = image_error(coeffs, decode(encode(coeffs, whitened, device).to_bytes(), device), 4)
    assert error < 1.2 * image_error(coeffs, decode(encode(coeffs, plain, device), device), 4)


def test_whitened_cannot_hold_itself():
    with pytest.raises(InputError, match="choose another"):
        codec_class("whitened").from_config({"codec": "klt"})


def test_few_bytes_cannot_claim_gigabytes(device):
    body = encode(np.zeros((9, 8, 8, 3), np.float32), Klt(step=0.01), device).body
    check_large_claims(device, Klt, [body, b"", bytes(40)])
    wavelet = codec_class("wavelet")
    check_large_claims(device, wavelet, [encode(np.zeros((9, 8, 8, 3), np.float32), wavelet(), device).body])


@pytest.mark.parametrize("codec", ["klt", "wavelet"])
def test_units_that_are_only_claimed_take_no_memory(device, codec):
    """A body long enough for such a map: its millions of units have no streams."""
    noise = np.random.default_rng(3).standard_normal((1, 600, 600, 1)).astype(np.float32)
    body = encode(noise, codec_class(codec)(rate=1.0), device).body
    claimed = (1, 1 << 18, 1 << 18, 1)
    padded = pad_to_minimum(body, claimed)
    tracemalloc.start()
    try:
        with pytest.raises(PayloadError, match="index of units"):
            codec_class(codec).decode_body(padded, claimed, device)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("codec", ["klt", "whitened"])
def test_degrees_beyond_the_metric_are_refused_both_ways(device, codec):
    coeffs = np.zeros((42 * 42, 2, 2, 1), np.float32)
    with pytest.raises(InputError, match="degrees up to 40"):
        encode(coeffs, codec_class(codec)(), device)
    with pytest.raises(PayloadError, match="degrees up to 40"):
        codec_class(codec).decode_body(b"\x04half" + bytes(60), coeffs.shape, device)


def test_steps_too_fine_for_the_table_of_the_mean_are_not_tried(device):
    # Constant maps: only the mean costs bytes, so no rate is ever reached.
    coeffs = np.full((4, 9, 7, 3), 0.3, np.float32)
    found = decode(encode(coeffs, Klt(rate=12.0), device), device)
    np.testing.assert_allclose(found, coeffs, atol=1e-6)
    with pytest.raises(InputError, match=r"klt step must be \S+ or more for this map, got 2.38419e-07"):
        encode(coeffs, Klt(step=2.0**-22), device)
