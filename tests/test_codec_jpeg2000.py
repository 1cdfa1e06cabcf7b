import builtins
import itertools

import numpy as np
import pytest

from clrelight.codec import decode, encode
from clrelight.codec.formats.jpeg2000 import Jpeg2000
from clrelight.codec.minimum_size import FLOOR
from clrelight.errors import InputError, PayloadError
from tests.mutations import check_large_claims

pytest.importorskip("PIL")


def waves(shape, seed=0, noise=0.05):
    rng = np.random.default_rng(seed)
    k, h, w, c = np.indices(shape)
    values = np.sin(h / 9 + w / 7 + k) / (1 + k) + 0.2 * c + noise * rng.standard_normal(shape)
    return values.astype(np.float32)


@pytest.mark.parametrize("rate", [0.1, 0.5, 1, 2.37, 4, 8])
@pytest.mark.parametrize("shape", [(4, 128, 131, 3), (9, 61, 127, 1)])
def test_the_rate_is_met(device, rate, shape):
    encoded = encode(waves(shape), Jpeg2000(rate), device)
    assert 0.99 * rate <= encoded.bits_per_coefficient <= rate


def test_error_falls_with_the_rate(device):
    coeffs = waves((4, 64, 96, 3))
    errors = [
        np.sqrt(np.mean((decode(encode(coeffs, Jpeg2000(rate), device), device) - coeffs) ** 2))
        for rate in (0.25, 1, 2, 4, 6, 9)
    ]
    # The noise of 0.05 is what takes the bits: 6 dB each once the waves are known.
    assert errors[0] < 0.2
    assert all(b < 0.75 * a for a, b in itertools.pairwise(errors))
    assert errors[3] < 0.05 / 2**2


@pytest.mark.parametrize("size", [(1, 1), (1, 13), (17, 1), (2, 2), (3, 5), (31, 37), (67, 8)])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_any_size_comes_back_at_full_rate(device, size, channels):
    coeffs = waves((4, *size, channels))
    decoded = decode(encode(coeffs, Jpeg2000(2000.0), device).to_bytes(), device)
    # 16 bits over each map's range, and the last bits that OpenJPEG's finest quantiser and inverse transform lose.
    span = coeffs.max(axis=(1, 2), keepdims=True) - coeffs.min(axis=(1, 2), keepdims=True)
    assert (np.abs(decoded - coeffs) <= 6 * span / 65535 + 1e-6).all()


@pytest.mark.parametrize("value", [0.0, -7.3, 1e-45, 1e30, -3.4028235e38])
def test_constant_maps_are_exact_and_leave_their_bytes_to_others(device, value):
    coeffs = waves((4, 32, 48, 3))
    coeffs[1:, :, :, 1] = value
    encoded = encode(coeffs, Jpeg2000(2.0), device)
    np.testing.assert_array_equal(decode(encoded, device)[1:, :, :, 1], coeffs[1:, :, :, 1])
    assert encoded.bits_per_coefficient > 1.98
    everywhere = np.full((4, 5, 6, 3), value, np.float32)
    encoded = encode(everywhere, Jpeg2000(20.0), device)
    np.testing.assert_array_equal(decode(encoded, device), everywhere)
    assert encoded.encoded_bytes == 12 * 12


@pytest.mark.parametrize("scale", [1e-45, 1e-38, 3.4e38])
def test_ends_of_float32(device, scale):
    coeffs = (np.random.default_rng(0).uniform(-1, 1, (4, 9, 41, 3)) * scale).astype(np.float32)
    decoded = decode(encode(coeffs, Jpeg2000(60.0), device), device)
    assert np.isfinite(decoded).all()
    assert np.abs(decoded / 4 - coeffs / 4).max() <= 1e-3 * np.abs(coeffs / 4).max() + 1.5e-45


def test_what_would_come_back_as_zeros_is_refused(device):
    coeffs = np.zeros((4, 9, 9, 1), np.float32)
    coeffs[0, 3, 5] = 2.0**-149
    with pytest.raises(InputError, match=r"the largest coefficient is 1\.4\d*e-45, .* all would be 0"):
        encode(coeffs, Jpeg2000(rate=120.0), device)
    coeffs[0, 3, 5] *= 4
    assert decode(encode(coeffs, Jpeg2000(rate=120.0), device), device)[0, 3, 5].item() > 2.0**-148


def test_a_tiny_share_leaves_the_mean(device):
    coeffs = waves((4, 5, 9, 3))
    encoded = encode(coeffs, Jpeg2000(2.5), device)
    assert encoded.bits_per_coefficient <= 2.5
    np.testing.assert_allclose(decode(encoded, device).mean(axis=(1, 2)), coeffs.mean(axis=(1, 2)), atol=0.1)


def test_a_large_constant_map_pays_for_what_it_claims(device):
    encoded = encode(np.zeros((1, 2048, 1024, 1), np.float32), Jpeg2000(1.0), device)
    assert encoded.encoded_bytes == 2048 * 1024 / FLOOR
    assert not decode(encoded, device).any()


def test_same_input_same_bytes_and_no_comment_of_a_library_version(device):
    coeffs = waves((4, 31, 77, 3))
    body = encode(coeffs, Jpeg2000(), device).body
    assert encode(coeffs.copy(), Jpeg2000(), device).body == body
    assert b"OpenJPEG" not in body


def test_a_rate_below_the_tables_is_refused(device):
    with pytest.raises(InputError, match="tables"):
        encode(waves((4, 5, 9, 3)), Jpeg2000(2.0), device)


@pytest.mark.parametrize("shape", [(4, 19, 23, 3), (1, 2, 3, 1), (4, 40, 1, 1)])
def test_the_least_size_that_is_told_is_the_least(device, shape):
    coeffs = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    least = Jpeg2000.least_bytes(shape)
    assert encode(coeffs, Jpeg2000(rate=8.0 * least / coeffs.size), device).encoded_bytes <= least
    with pytest.raises(InputError, match=rf"\({least} bytes\), got \S+ \({least - 1} bytes\)$"):
        encode(coeffs, Jpeg2000(rate=8.0 * (least - 1) / coeffs.size), device)


@pytest.mark.parametrize("rate", [0, -1, float("nan"), float("inf"), "4", True])
def test_bad_rates(rate):
    with pytest.raises(InputError, match="rate"):
        Jpeg2000(rate)


def test_without_pillow_the_extra_is_named(device, monkeypatch):
    coeffs = waves((1, 8, 8, 3))
    encoded = encode(coeffs, Jpeg2000(16.0), device)
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.split(".")[0] == "PIL":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", refuse)
    for use in (lambda: encode(coeffs, Jpeg2000(), device), lambda: decode(encoded, device)):
        with pytest.raises(InputError, match=r"clrelight\[codecs\]"):
            use()


def test_pillows_limit_is_an_error_of_ours(device, monkeypatch):
    from PIL import Image

    encoded = encode(waves((1, 16, 16, 1)), Jpeg2000(12.0), device)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    with pytest.raises(PayloadError, match="pixels"):
        decode(encoded, device)


def test_too_many_pixels_for_a_plane(device):
    with pytest.raises(InputError, match="pixels"):
        Jpeg2000().encode_body(
            np.lib.stride_tricks.as_strided(np.zeros(1, np.float32), (1, 1 << 14, 1 << 13, 1)), device
        )


def test_damaged_bodies(device):
    shape = (1, 16, 16, 3)
    body = encode(waves(shape), Jpeg2000(8.0), device).body
    floats, sizes = np.frombuffer(body[:24], "<f4"), np.frombuffer(body[24:36], "<u4")

    def remade(floats=floats, sizes=sizes, rest=body[36:]):
        return np.float32(floats).tobytes() + np.uint32(sizes).tobytes() + rest

    assert remade() == body
    bad = [b"", body[:35], body[:-1], body + b"\0"]
    bad += [remade(floats=np.where(np.arange(6) == i, v, floats)) for i in (0, 4) for v in (np.nan, np.inf)]
    bad += [remade(floats=np.where(np.arange(6) == 4, v, floats)) for v in (0.0, -1.0, 3e38)]
    bad += [
        remade(sizes=sizes + np.eye(3)[0]),
        remade(sizes=[0xFFFFFFFF] * 3),
        remade(sizes=sizes * (1 - np.eye(3)[1])),
    ]
    for damaged in bad:
        with pytest.raises(PayloadError):
            Jpeg2000.decode_body(damaged, shape, device)
    check_large_claims(device, Jpeg2000, [b"", bytes(13), bytes(1000)])
