from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight.codec import decode, encode, slabs
from clrelight.codec.formats.bc6h import Bc6h
from clrelight.codec.formats.dds import dds_header
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError
from clrelight.opencl.devices import loaded_devices
from tests.mutations import check_large_claims
from tests.reference.bc6h import LAYOUTS, decode_bc6h, decode_block, simple_error

SIZES = [(1, 1), (1, 7), (3, 4), (5, 3), (8, 8), (9, 31), (13, 17)]


def some_map(shape, seed=0, noise=0.05):
    rng = np.random.default_rng(seed)
    k, h, w, c = np.indices(shape)
    values = np.sin(h / 5 + w / 7 + k) / (1 + k) + 0.2 * c + noise * rng.standard_normal(shape)
    return values.astype(np.float32)


def random_blocks(count, seed=0):
    """Every mode that is decoded, with any bits behind it but the endpoint -32768."""
    rng = np.random.default_rng(seed)
    blocks = rng.integers(0, 256, (count, 16), dtype=np.uint8)
    blocks[:, 0] = blocks[:, 0] & 0xE0 | rng.choice(list(LAYOUTS), count)
    return [b.tobytes() for b in blocks if np.isfinite(decode_block(b.tobytes())[1]).all()]


def open_dds(path):
    image = oiio.ImageInput.open(str(path))
    assert image is not None, oiio.geterror()
    assert image.spec().format == oiio.HALF
    return image.read_image()


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("size", SIZES)
def test_decoder_against_reference(device, size, channels):
    coeffs = some_map((4, *size, channels))
    encoded = encode(coeffs, Bc6h(), device)
    groups = -(-4 * channels // 3)
    assert encoded.encoded_bytes == 16 * groups * -(-size[0] // 4) * -(-size[1] // 4)
    np.testing.assert_array_equal(decode(encoded.to_bytes(), device), decode_bc6h(encoded.body, coeffs.shape))


def test_exactly_eight_thirds_bits(device):
    assert encode(some_map((4, 8, 12, 3)), Bc6h(), device).bits_per_coefficient == 8 / 3
    assert encode(some_map((9, 8, 12, 1)), Bc6h(), device).bits_per_coefficient == 8 / 3


def test_any_bits_decode_as_the_reference_and_openimageio_do(device, tmp_path):
    blocks = random_blocks(600)[:512]
    body = b"".join(blocks)
    shape = (1, 32, 256, 3)
    ours = Bc6h.decode_body(body, shape, device)
    np.testing.assert_array_equal(ours, decode_bc6h(body, shape))
    (tmp_path / "a.dds").write_bytes(dds_header(shape, 1) + body)
    np.testing.assert_array_equal(open_dds(tmp_path / "a.dds"), ours[0])


def error_of(coeffs, device):
    decoded = decode_bc6h(encode(coeffs, Bc6h(), device).body, coeffs.shape).astype(np.float64)
    return (decoded - coeffs) ** 2


@pytest.mark.parametrize("kind", ["smooth", "noise", "offset", "scales", "outlier", "large", "small"])
def test_better_than_a_simple_encoder(device, kind):
    rng = np.random.default_rng(1)
    noise = rng.standard_normal((1, 16, 32, 3))
    coeffs = {
        "smooth": some_map((1, 16, 32, 3)),
        "noise": noise,
        "offset": 5 + 0.01 * noise,
        "scales": noise * [100, 1, 0.01],
        "outlier": noise * np.where(rng.random(noise.shape) < 0.03, 1000, 1),
        "large": np.clip(noise * 3e4, -65000, 65000),
        "small": noise * 1e-6,
    }[kind].astype(np.float32)
    ours = error_of(coeffs, device).reshape(4, 4, 8, 4, 3).sum(axis=(1, 3, 4)).ravel()
    texels = coeffs.reshape(4, 4, 8, 4, 3).transpose(0, 2, 1, 3, 4).reshape(-1, 16, 3).astype(np.float64)
    simple = np.array([simple_error(block) for block in texels])
    assert ours.sum() < {"offset": 0.2, "smooth": 0.8}.get(kind, 0.97) * simple.sum()
    assert (ours <= 1.1 * simple).mean() > 0.95


def test_what_the_format_holds_comes_back(device):
    """Blocks that are a decoded line exactly: the encoder must come near a line that it did not make."""
    texels = [decode_block(b)[1].astype(np.float32) for b in random_blocks(4000, 2)]
    coeffs = np.concatenate([block for block in texels if np.abs(block).max() < 2], axis=1)[None]
    assert coeffs.shape[2] > 400
    error = error_of(coeffs, device)[0].reshape(4, -1, 4, 3).sum(axis=(0, 2, 3))
    energy = (coeffs[0].astype(np.float64) ** 2).reshape(4, -1, 4, 3).sum(axis=(0, 2, 3))
    relative = error / energy
    assert np.median(relative) < 1e-6
    assert np.quantile(relative, 0.9) < 2e-3


@pytest.mark.parametrize("value", [0.0, 1.0, -7.3, 6e-8, -6e-5, 65504.0, 0.1])
def test_constant_blocks_are_exact_halves(device, value):
    for shape in [(1, 5, 6, 3), (4, 5, 6, 1), (1, 1, 1, 3)]:
        coeffs = np.full(shape, value, np.float16).astype(np.float32)
        coeffs[..., 0] = np.float16(-0.3)
        np.testing.assert_array_equal(decode(encode(coeffs, Bc6h(), device), device), coeffs)


@pytest.mark.parametrize("value", [65520.0, -3e38])
def test_overflow_names_the_coefficient(device, value):
    coeffs = np.zeros((4, 5, 9, 3), np.float32)
    coeffs[3, 1, 7, 2] = value
    with pytest.raises(InputError, match=r"\(3, 1, 7, 2\)"):
        encode(coeffs, Bc6h(), device)
    encoded = encode(coeffs, Bc6h(clamp=True), device)
    assert encoded.info["clamped"] == 1
    assert decode(encoded, device)[3, 1, 7, 2] == np.copysign(65504, value)
    coeffs[3, 1, 7, 2] = np.copysign(65519, value)
    assert decode(encode(coeffs, Bc6h(), device), device)[3, 1, 7, 2] == np.copysign(65504, value)


def test_clamp_must_be_a_truth_value():
    with pytest.raises(InputError, match="clamp"):
        Bc6h(clamp=1)


@pytest.mark.parametrize("channels", [1, 3])
def test_slabs_change_nothing(device, monkeypatch, channels):
    coeffs = some_map((9, 11, 13, channels))
    encoded = encode(coeffs, Bc6h(), device)
    values = decode(encoded, device)
    assert encode(coeffs.copy(), Bc6h(), device).body == encoded.body
    for slab_bytes in (32, 1 << 12):
        monkeypatch.setattr(slabs, "SLAB_BYTES", slab_bytes)
        assert encode(coeffs, Bc6h(), device).body == encoded.body
        np.testing.assert_array_equal(decode(encoded, device), values)


def test_code_paths_of_a_gpu(device):
    there = Device(replace(device.info, kind="gpu"), loaded_devices()[device.info.index][1])
    for shape in [(4, 13, 37, 3), (4, 5, 6, 1)]:
        coeffs = some_map(shape)
        payload = encode(coeffs, Bc6h(), device).to_bytes()
        np.testing.assert_array_equal(decode(payload, there), decode(payload, device))
        assert encode(coeffs, Bc6h(), there).to_bytes() == payload


def test_damaged_bodies(device):
    shape = (1, 4, 5, 3)
    body = encode(some_map(shape), Bc6h(), device).body
    minus_32768 = (15 | 1 << (35 + 4)).to_bytes(16, "little")
    other_modes = [bytes([mode]) + body[1:] for mode in range(32) if mode not in LAYOUTS]
    for damaged in (b"", body[:-1], body + b"\0", minus_32768 + body[16:], *other_modes):
        with pytest.raises(PayloadError):
            Bc6h.decode_body(damaged, shape, device)
    check_large_claims(device, Bc6h, [b"", bytes(16), bytes(1000)])
