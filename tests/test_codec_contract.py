"""What every codec promises. A new codec takes one line, in CODECS."""

import json

import numpy as np
import pytest

from clrelight.codec import codec_class, codec_ids, decode, encode
from clrelight.errors import InputError, PayloadError

# Per codec some settings that a small map has room for, and the root mean square error that they may leave, of the
# map's own.
CODECS = [
    ("half", {}, 1e-3),
    ("half", {"clamp": True}, 1e-3),
    ("s3tc", {}, 0.8),
    ("bc6h", {}, 0.8),
    ("uniform", {}, 0.02),
    ("uniform", {"bits": 3}, 0.3),
    ("wavelet", {"rate": 6.0}, 0.1),
    ("wavelet", {"rate": 6.0, "allocation": "global"}, 0.1),
    ("jpeg2000", {"rate": 12.0}, 0.1),
    ("vq", {"bits": 6}, 0.8),
    ("cpca", {"clusters": 1, "components": 3}, 0.9),
    ("whitened", {}, 0.3),
    ("principal", {}, 0.3),
    ("klt", {"step": 0.02}, 0.1),
    ("klt", {"step": 0.02, "transfer": "srgb"}, 0.3),
]
NAMES = [f"{name} {json.dumps(options)}" for name, options, _ in CODECS]
CHANNELS = (1, 2, 3, 4)


def make(name, options):
    return codec_class(name).from_config(options)


def smooth_map(channels=3, shape=(4, 19, 23)):
    """Return waves with noise, positive in the mean, as fits are."""
    rng = np.random.default_rng(0)
    k, h, w, c = np.indices((*shape, channels))
    waves = np.sin(0.3 * h * (1 + k) + c) * np.cos(0.2 * w + k) + 1.5 * (k == 0)
    return (0.3 * waves + 0.01 * rng.standard_normal(waves.shape)).astype(np.float32)


def error_of(found, coeffs):
    return float(np.sqrt(np.mean((found - coeffs) ** 2) / np.mean(coeffs**2)))


def test_every_codec_is_here():
    assert {name for name, _, _ in CODECS} == set(codec_ids())


@pytest.fixture(params=CODECS, ids=NAMES)
def case(request):
    return request.param


def test_settings_survive_json(case):
    codec = make(*case[:2])
    assert type(codec).from_config(json.loads(json.dumps(codec.to_config()))) == codec


def test_unknown_settings_are_named(case):
    with pytest.raises(InputError, match=r"'bite'"):
        make(case[0], {"bite": 1})


def test_bytes_alone_decode_alike(case, device):
    name, options, error = case
    coeffs = smooth_map()
    encoded = encode(coeffs, make(name, options), device)
    payload = encoded.to_bytes()
    assert payload == encoded.header() + bytes(encoded.body)
    values = decode(payload, device)
    assert values.shape == coeffs.shape
    assert values.dtype == np.float32
    assert error_of(values, coeffs) <= error
    for same in (encoded, bytearray(payload), memoryview(payload)):
        np.testing.assert_array_equal(decode(same, device), values)


def test_input_is_left_alone_and_may_lie_anyhow(case, device):
    codec = make(*case[:2])
    coeffs = np.asfortranarray(smooth_map())
    before = coeffs.copy()
    coeffs.flags.writeable = False
    body = bytes(encode(coeffs, codec, device).body)
    np.testing.assert_array_equal(coeffs, before)
    assert bytes(encode(np.ascontiguousarray(before), codec, device).body) == body
    assert bytes(encode(before.astype(np.float64), codec, device).body) == body


def attempt(codec, coeffs, device):
    """Return what is encoded, or None and why the codec refuses."""
    try:
        return encode(coeffs, codec, device), ""
    except InputError as refusal:
        return None, str(refusal)


@pytest.mark.parametrize("channels", CHANNELS)
def test_any_number_of_channels_or_a_word_why_not(case, device, channels):
    name, options, error = case
    coeffs = smooth_map(channels)
    encoded, refusal = attempt(make(name, options), coeffs, device)
    if encoded is None:
        assert channels in (2, 4)  # pictures are gray or in colour
        assert "channel" in refusal
    else:
        assert error_of(decode(encoded.to_bytes(), device), coeffs) <= error


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 40), (4, 40, 1), (9, 2, 3)])
def test_thin_maps(case, device, shape):
    encoded, refusal = attempt(make(*case[:2]), smooth_map(3, shape), device)
    if encoded is None:
        assert refusal  # too few bytes for its tables, say
    else:
        assert np.isfinite(decode(encoded.to_bytes(), device)).all()


@pytest.mark.parametrize("value", [0.0, 0.25])
def test_a_constant_map(case, device, value):
    coeffs = np.full((4, 19, 23, 3), value, np.float32)
    found = decode(encode(coeffs, make(*case[:2]), device).to_bytes(), device)
    assert np.abs(found - coeffs).max() <= 0.02 * max(value, 1e-6) + (1e-6 if value == 0 else 0.02)


def test_damage_is_a_payload_error_or_a_map(case, device):
    payload = encode(smooth_map(), make(*case[:2]), device).to_bytes()
    rng = np.random.default_rng(5)
    for length in rng.integers(0, len(payload), 12):
        with pytest.raises(PayloadError):
            decode(payload[:length], device)
    for _ in range(12):
        damaged = bytearray(payload)
        damaged[rng.integers(len(damaged))] ^= 1 << rng.integers(8)
        with pytest.raises(PayloadError):
            decode(bytes(damaged), device)
