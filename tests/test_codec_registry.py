import struct
import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from clrelight.codec import (
    Codec,
    Encoded,
    Half,
    S3tc,
    Uniform,
    codec_class,
    codec_ids,
    decode,
    encode,
    register,
    registry,
    slabs,
)
from clrelight.device import Device, open_device
from clrelight.errors import InputError, PayloadError
from clrelight.opencl.devices import loaded_devices

FROZEN = Path(__file__).resolve().parent / "frozen"
EXAMPLES = [Half(), Half(clamp=True), S3tc(), Uniform(), Uniform(bits=3)]


def example_map(shape=(4, 5, 9, 3)):
    return np.random.default_rng(0).standard_normal(shape).astype(np.float32)


def with_checksum(payload):
    """Return `payload` with the checksum that its own header asks for, wherever that header puts it."""
    at = 6 + payload[5] + 24
    if len(payload) < at + 4:
        return payload
    checksum = zlib.crc32(payload[at + 4 :], zlib.crc32(payload[:at]))
    return payload[:at] + struct.pack("<I", checksum) + payload[at + 4 :]


def crafted(name=b"half", shape=(1, 1, 1, 1), body=b"\0\0", version=1, length=None):
    head = b"CLRE" + struct.pack("<BB", version, len(name)) + name
    head += struct.pack("<4IQ", *shape, len(body) if length is None else length)
    return with_checksum(head + bytes(4) + body)


def test_codecs_of_this_package_are_known():
    assert {"half", "s3tc", "uniform"} <= set(codec_ids())
    assert codec_class("half") is Half


def test_unknown_id_lists_the_known_ones():
    with pytest.raises(InputError, match=r"'zip'.*half.*s3tc.*uniform"):
        codec_class("zip")


def test_second_codec_of_one_id_is_refused():
    @dataclass(frozen=True)
    class Other(Half):
        id: ClassVar[str] = "half"

    with pytest.raises(ValueError, match="half"):
        register(Other)
    assert codec_class("half") is Half


@pytest.mark.parametrize("bad", ["", "ä", "x" * 256, "a\nb"])
def test_an_id_that_no_header_holds_is_refused(bad):
    with pytest.raises(ValueError, match="id"):
        register(type("Bad", (Half,), {"id": bad}))
    assert bad not in codec_ids()


def test_a_codec_from_outside_is_found(device, monkeypatch):
    monkeypatch.setattr(registry, "_REGISTRY", dict(registry._REGISTRY))

    @register
    @dataclass(frozen=True)
    class Raw(Codec):
        id: ClassVar[str] = "raw"
        summary: ClassVar[str] = "float32 as it is"

        def encode_body(self, coeffs_khwc, device):
            return coeffs_khwc.tobytes(), {}

        @classmethod
        def decode_body(cls, body, shape, device):
            return np.frombuffer(body, np.float32).reshape(shape)

    coeffs = example_map()
    np.testing.assert_array_equal(decode(encode(coeffs, Raw(), device).to_bytes(), device), coeffs)


def test_unknown_option_is_named():
    with pytest.raises(InputError, match=r"uniform.*'bit'.*bits"):
        Uniform.from_config({"bit": 8})
    with pytest.raises(InputError, match=r"s3tc.*'bits'.*none"):
        S3tc.from_config({"bits": 8})


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (np.zeros((4, 3, 3)), "shape"),
        (np.zeros((4, 0, 3, 3)), "shape"),
        (np.zeros((3, 2, 2, 3)), "square"),
        (np.zeros((1, 1, (1 << 20) + 1, 1)), "axis"),
        (np.zeros((1, 1, 1, 1025)), "1024 channels"),
        (np.zeros((1, 1, 1, 1), complex), "complex"),
        (np.full((1, 1, 1, 1), "x"), "real"),
    ],
)
def test_bad_maps(device, bad, message):
    with pytest.raises(InputError, match=message):
        encode(bad, Half(), device)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e39])
def test_a_value_that_is_not_finite_is_named(device, value):
    coeffs = np.zeros((4, 2, 3, 3))
    coeffs[1, 0, 2, 1] = value
    with pytest.raises(InputError, match=r"\(1, 0, 2, 1\)"):
        encode(coeffs, Half(), device)


def test_crafted_header_is_a_good_one(device):
    assert decode(crafted(), device) == 0


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"CLR",
        b"CLRE",
        b"CLRE\x01",
        b"ELRC" + crafted()[4:],
        crafted(version=2),
        crafted(name=b"zip"),
        crafted(name=b""),
        crafted(name=b"h\xe4lf"),
        crafted(name=b"half\n"),
        crafted(name=b"h" * 255),
        crafted(shape=(0, 1, 1, 1)),
        crafted(shape=(2, 1, 1, 1), body=bytes(4)),
        crafted(shape=(1, 1 << 21, 1, 1)),
        crafted(shape=(1, 1, 1, 1025), body=bytes(2050)),
        crafted(shape=(1, 1 << 20, 1 << 20, 3)),
        crafted(shape=(1, 1 << 16, 1 << 16, 1)),
        crafted(shape=(0xFFFFFFFF,) * 4),
        crafted(length=1),
        crafted(length=(1 << 64) - 1),
        crafted()[:-1],
        crafted() + b"\0",
        crafted()[:-1] + b"\1",
    ],
)
def test_bad_payloads(device, bad):
    with pytest.raises(PayloadError):
        decode(bad, device)


@pytest.mark.parametrize("name", ["half", "s3tc", "uniform"])
@pytest.mark.parametrize("shape", [(1, 1 << 16, 1 << 16, 1), (1 << 16, 256, 256, 1), (1, 1, 1, 1 << 20)])
def test_a_large_claim_over_a_small_body_allocates_nothing(device, name, shape):
    for body in (b"", b"\x01", b"\x01" + bytes(1000)):
        with pytest.raises(PayloadError):
            decode(Encoded(name, {}, shape, body), device)
        with pytest.raises(PayloadError):
            decode(crafted(name=name.encode(), shape=shape, body=body), device)


@pytest.mark.parametrize("codec", [Half(), S3tc(), Uniform(7)], ids=lambda codec: codec.id)
def test_every_truncation_is_noticed(device, codec):
    payload = encode(example_map((1, 3, 4, 3)), codec, device).to_bytes()
    for length in range(len(payload)):
        for bad in (payload[:length], with_checksum(payload[:length]) if length > 5 else b""):
            with pytest.raises(PayloadError):
                decode(bad, device)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("codec", EXAMPLES, ids=repr)
@pytest.mark.parametrize("slab_bytes", [32, 1 << 12, 1 << 15])
def test_slabs_change_nothing(device, monkeypatch, codec, channels, slab_bytes):
    coeffs = example_map((16, 11, 37, channels))
    encoded = encode(coeffs, codec, device)
    values = decode(encoded, device)
    monkeypatch.setattr(slabs, "SLAB_BYTES", slab_bytes)
    assert encode(coeffs, codec, device).body == encoded.body
    np.testing.assert_array_equal(decode(encoded, device), values)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("codec", EXAMPLES, ids=repr)
def test_arrays_at_any_float_boundary(device, codec, channels):
    """NumPy aligns to 16 bytes at best, a slice of an array not even that; vectors have 32."""
    coeffs = example_map((4, 9, 67, channels))
    expected = encode(coeffs, codec, device).body
    room = np.empty(coeffs.size + 8, np.float32)
    for offset in range(8):
        shifted = room[offset : offset + coeffs.size].reshape(coeffs.shape)
        shifted[:] = coeffs
        assert encode(shifted, codec, device).body == expected


@pytest.fixture(scope="module")
def as_gpu():
    """Return this machine's device posing as a GPU: scalar kernels, groups of work-items, memory of its own."""
    info = open_device().info
    handle = loaded_devices()[info.index][1]
    return Device(replace(info, kind="gpu"), handle)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size", [(1, 1), (5, 7), (8, 33), (67, 131)])
@pytest.mark.parametrize("codec", EXAMPLES, ids=repr)
def test_code_paths_of_a_gpu(device, as_gpu, codec, size, channels):
    coeffs = example_map((4, *size, channels))
    payload = encode(coeffs, codec, device).to_bytes()
    values = decode(payload, device)
    atol = 4 * np.finfo(np.float32).eps * np.abs(values).max()
    np.testing.assert_allclose(decode(payload, as_gpu), values, rtol=0, atol=atol)
    # Roundings differ, so levels may, but the error is the same.
    there = decode(encode(coeffs, codec, as_gpu).to_bytes(), device)
    assert np.square(there - coeffs).sum() <= 1.001 * np.square(values - coeffs).sum() + coeffs.size * atol**2


@pytest.mark.parametrize("payload", sorted(FROZEN.glob("*.bin")), ids=lambda path: path.stem)
def test_what_was_encoded_once_still_decodes(device, payload):
    expected = np.load(payload.with_suffix(".npy"))
    # Devices may fuse a multiplication and an addition.
    atol = 4 * np.finfo(np.float32).eps * np.abs(expected).max()
    np.testing.assert_allclose(decode(payload.read_bytes(), device), expected, rtol=0, atol=atol)


def test_every_codec_has_a_frozen_payload():
    assert set(codec_ids()) == {path.stem.partition(".")[0] for path in FROZEN.glob("*.bin")}
