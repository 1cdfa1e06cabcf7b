import functools

import numpy as np
import pytest

from clrelight.codec import Uniform, decode, encode
from clrelight.errors import InputError, PayloadError
from tests.reference.uniform import decode_uniform, minmax_error
from tests.styles import both_styles

EPS = float(np.finfo(np.float32).eps)


def error_of(coeffs, encoded):
    """Squared error of each map as the float64 reference decodes it."""
    difference = decode_uniform(encoded.body, encoded.shape) - coeffs.astype(np.float64)
    return (difference**2).reshape(len(coeffs), -1).sum(axis=1)


@pytest.mark.parametrize("bits", range(1, 17))
@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (4, 1, 7, 1), (4, 3, 3, 3), (1, 2, 4, 1), (9, 31, 33, 3)])
def test_decoder_against_reference(device, bits, shape):
    coeffs = np.random.default_rng(bits).standard_normal(shape).astype(np.float32)
    encoded = encode(coeffs, Uniform(bits), device)
    assert encoded.encoded_bytes == 1 + 8 * shape[0] + -(-coeffs.size * bits // 8)
    spare = -coeffs.size * bits % 8
    assert encoded.body[-1] >> (8 - spare) == 0
    expected = decode_uniform(encoded.body, shape)
    decoded = decode(encoded.to_bytes(), device)
    np.testing.assert_allclose(decoded, expected, rtol=0, atol=4 * EPS * np.abs(expected).max())


@both_styles
@pytest.mark.parametrize("size", [4095, 4096, 4097, 8191, 16411])  # around a stretch, and a prime beyond the sample
def test_sizes_around_a_work_item(device, size):
    coeffs = np.random.default_rng(size).standard_normal((4, 1, size, 1)).astype(np.float32)
    encoded = encode(coeffs, Uniform(5), device)
    assert (error_of(coeffs, encoded) <= minmax_error(coeffs, 5)).all()
    expected = decode_uniform(encoded.body, coeffs.shape)
    np.testing.assert_allclose(decode(encoded, device), expected, rtol=0, atol=4 * EPS * np.abs(expected).max())


# Least mean squared error of a uniform quantiser of a unit normal variable: Max 1960, table II.
@pytest.mark.parametrize(("bits", "least"), [(1, 0.3634), (2, 0.1188), (3, 0.03744), (4, 0.01154), (5, 0.003495)])
def test_normal_values_reach_the_known_optimum(device, bits, least):
    coeffs = np.random.default_rng(0).standard_normal((4, 256, 256, 1)).astype(np.float32)
    mean = error_of(coeffs, encode(coeffs, Uniform(bits), device)) / coeffs[0].size
    assert (mean < 1.03 * least).all()
    assert (mean > 0.97 * least).all()


@functools.cache
def distributions():
    rng = np.random.default_rng(5)
    shape = (4, 61, 67, 3)
    normal = rng.standard_normal(shape)
    spike = np.zeros(shape)
    spike[:, 30, 30, 1] = 1000
    return {
        "normal": normal,
        "heavy tails": rng.standard_t(1.5, shape),
        "one outlier": 0.01 * normal + spike,
        "positive with a black half": np.where(normal > 0, 0, normal**4),
        "negative only": -5 - np.abs(normal),
        "two values": np.where(normal > 1, 3.0, -1.0),
        "large offset": 1000 + 1e-3 * normal,
        "flat": rng.uniform(-1, 2, shape),
        "a unit in the last place": 1 + rng.integers(0, 2, shape) * 2.0**-23,
    }


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 12, 16])
@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
@pytest.mark.parametrize("name", distributions())
def test_never_worse_than_least_to_greatest(device, name, scale, bits):
    coeffs = (distributions()[name] * scale).astype(np.float32)
    ours = error_of(coeffs, encode(coeffs, Uniform(bits), device)) / scale / scale
    reference = minmax_error(coeffs.astype(np.float64) / scale, bits)
    # The table's float32 shifts all levels by up to an ulp, which adds to the error's square by Cauchy-Schwarz.
    n, ulp = coeffs[0].size, EPS * np.abs(coeffs).max().astype(np.float64) / scale
    assert (np.sqrt(ours) <= np.sqrt(reference) * (1 + 1e-4) + ulp * np.sqrt(n)).all()


def test_an_outlier_is_clipped(device):
    coeffs = np.random.default_rng(0).standard_normal((1, 64, 64, 3)).astype(np.float32)
    coeffs[0, 0, 0, 0] = 30
    assert error_of(coeffs, encode(coeffs, Uniform(4), device))[0] < 0.2 * minmax_error(coeffs, 4)[0]


def test_rare_outliers_that_the_sample_misses_are_kept(device):
    """Clipping one value of 1e6 would cost more than it gains; a decision from a sample alone would clip it."""
    for at in range(0, 40000, 3989):
        coeffs = np.random.default_rng(at).standard_normal((1, 200, 200, 1)).astype(np.float32)
        coeffs.reshape(-1)[at] = 1e6
        assert error_of(coeffs, encode(coeffs, Uniform(12), device))[0] <= minmax_error(coeffs, 12)[0] * 1.0001


@pytest.mark.parametrize("value", [0.0, -0.0, 1.0, -7.3, 1e-45, -3e-39, 1e-30, 1e30, 3.4028235e38])
@pytest.mark.parametrize("bits", [1, 8, 16])
def test_constant_maps_are_exact(device, value, bits):
    coeffs = np.random.default_rng(0).standard_normal((4, 5, 5, 3)).astype(np.float32)
    coeffs[2] = value
    encoded = encode(coeffs, Uniform(bits), device)
    np.testing.assert_array_equal(decode(encoded, device)[2], coeffs[2])


@pytest.mark.parametrize("bits", [2, 8, 16])
@pytest.mark.parametrize("scale", [1.4e-45, 1e-40, 3.4e38])
def test_ends_of_float32(device, scale, bits):
    coeffs = (np.random.default_rng(0).uniform(-1, 1, (4, 9, 41, 3)) * scale).astype(np.float32)
    decoded = decode(encode(coeffs, Uniform(bits), device), device)
    assert np.isfinite(decoded).all()
    step = max(2.0 / (2**bits - 1), 1e-45 / scale)
    assert np.abs((decoded.astype(np.float64) - coeffs) / scale).max() <= step


def test_black_stays_black(device):
    coeffs = np.random.default_rng(0).standard_normal((4, 64, 64, 3)).astype(np.float32)
    coeffs[:, :, :40] = 0
    assert (decode(encode(coeffs, Uniform(6), device), device)[:, :, :40] == 0).all()


def test_entropy_of_known_codes(device):
    coeffs = np.zeros((4, 8, 8, 1), np.float32)
    coeffs[0, :4] = 1  # half ones: 1 bit
    coeffs[1, :2] = 1  # a quarter: 0.811278 bit; the others are constant: 0
    encoded = encode(coeffs, Uniform(1), device)
    table = 8 * 32 / 256
    assert encoded.info["entropy_bits"] == pytest.approx((1 + 0.8112781244591328) / 4 + table, rel=1e-12)


def test_damaged_bodies(device):
    shape = (1, 4, 5, 3)
    body = encode(np.random.default_rng(0).standard_normal(shape).astype(np.float32), Uniform(7), device).body
    damaged = [b"", b"\0", body[:-1], body + b"\0", b"\0" + body[1:], b"\x11" + body[1:], b"\x08" + body[1:], body[:5]]
    for low, step in [(np.nan, 1), (np.inf, 1), (0, np.nan), (0, np.inf), (0, -1), (0, 3e38), (3e38, 1e37)]:
        damaged.append(body[:1] + np.array([low, step], "<f4").tobytes() + body[9:])
    for bad in damaged:
        with pytest.raises(PayloadError):
            Uniform.decode_body(bad, shape, device)
    assert np.isfinite(Uniform.decode_body(body, shape, device)).all()


@pytest.mark.parametrize("bits", [0, 17, -1, 8.0, "8", True, None])
def test_bad_bits(bits):
    with pytest.raises(InputError, match="bits"):
        Uniform(bits)
