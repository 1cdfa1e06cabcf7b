import numpy as np
import pytest

from clrelight.codec import Half, decode, encode
from clrelight.errors import InputError, PayloadError
from tests.reference.half import decode_half, encode_half
from tests.styles import both_styles


def as_map(values):
    return np.asarray(values, np.float32).reshape(1, 1, -1, 1)


def every_finite_half():
    bits = np.arange(65536, dtype=np.uint16)
    return bits[(bits & 0x7C00) != 0x7C00]


def test_reference_agrees_with_numpy_on_every_half():
    bits = every_finite_half()
    np.testing.assert_array_equal(decode_half(bits), bits.view(np.float16).astype(np.float64))


@both_styles
def test_every_half_survives(device):
    bits = every_finite_half()
    values = decode_half(bits)
    encoded = encode(as_map(values), Half(), device)
    np.testing.assert_array_equal(np.frombuffer(encoded.body, "<u2"), bits)
    np.testing.assert_array_equal(decode(encoded, device).ravel(), values)


@both_styles
def test_rounding_at_and_beside_every_tie(device):
    positive = decode_half(np.arange(0x7C00))
    ties = ((positive[1:] + positive[:-1]) / 2).astype(np.float32)  # exact: one more bit
    values = np.concatenate(
        [f(ties) for f in (lambda x: x, lambda x: np.nextafter(x, 0), lambda x: np.nextafter(x, 9e9))]
    )
    values = np.concatenate([values, -values, np.nextafter(np.float32([65520, -65520]), 0, dtype=np.float32)])
    encoded = encode(as_map(values), Half(), device)
    np.testing.assert_array_equal(np.frombuffer(encoded.body, "<u2"), encode_half(values))
    np.testing.assert_array_equal(np.frombuffer(encoded.body, "<f2"), values.astype(np.float16))


@both_styles
@pytest.mark.parametrize("width", [1, 7, 8, 9, 13, 1023, 1024, 1025, 2053])
def test_any_length(device, width):
    rng = np.random.default_rng(width)
    coeffs = (rng.standard_normal((4, 1, width, 1)) * 10.0 ** rng.uniform(-9, 4, (4, 1, width, 1))).astype(np.float32)
    encoded = encode(coeffs, Half(), device)
    assert encoded.bits_per_coefficient == 16
    np.testing.assert_array_equal(np.frombuffer(encoded.body, "<u2"), encode_half(coeffs).ravel())
    np.testing.assert_array_equal(decode(encoded.to_bytes(), device), coeffs.astype(np.float16))


@both_styles
@pytest.mark.parametrize("column", [0, 8, 1028])  # a vector, and the scalar rest of the last work-item
@pytest.mark.parametrize("value", [65520.0, -65520.0, 3e38])
def test_overflow_names_the_coefficient(device, column, value):
    coeffs = np.zeros((4, 2, 343, 3), np.float32)
    coeffs[3, 1, column // 3, column % 3] = value
    where = (3, 1, column // 3, column % 3)
    with pytest.raises(
        InputError, match=rf"\({where[0]}, {where[1]}, {where[2]}, {where[3]}\) is {value:g}".replace("+", r"\+")
    ):
        encode(coeffs, Half(), device)
    encoded = encode(coeffs, Half(clamp=True), device)
    assert encoded.info["clamped"] == 1
    assert decode(encoded, device)[where] == np.copysign(65504, value)


def test_nothing_is_clamped_below_the_limit(device):
    values = np.nextafter(np.float32([65520] * 9), 0, dtype=np.float32)
    encoded = encode(as_map(values), Half(clamp=True), device)
    assert encoded.info["clamped"] == 0
    assert (decode(encoded, device) == 65504).all()


@both_styles
def test_damaged_bodies(device):
    shape = (1, 3, 5, 1)
    for body in (b"", bytes(29), bytes(31), bytes(28) + b"\x00\x7c", b"\x01\xfe" + bytes(28)):
        with pytest.raises(PayloadError):
            Half.decode_body(body, shape, device)
    assert (Half.decode_body(bytes(30), shape, device) == 0).all()


def test_clamp_must_be_a_truth_value():
    with pytest.raises(InputError, match="clamp"):
        Half(clamp=1)
