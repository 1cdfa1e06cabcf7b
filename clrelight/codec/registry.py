"""The registry of codecs: what one is, how its bytes are wrapped, and how it is found by name."""

from __future__ import annotations

import math
import struct
import zlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.finite import all_finite
from clrelight.codec.metric import MAX_METRIC_DEGREE
from clrelight.codec.noise import Noise, second_moments
from clrelight.configurable import Configurable
from clrelight.conventions import degree_of
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

MAGIC = b"CLRE"
WRAPPER_VERSION = 1
MAX_EXTENT = 1 << 20
MAX_CHANNELS = 1 << 10
MAX_COEFFICIENTS = 1 << 32

_REGISTRY: dict[str, type[Codec]] = {}


@dataclass(frozen=True)
class Encoded:
    """A coefficient map as bytes.

    Attributes
    ----------
    codec : str
        Id of the codec.
    config : mapping
        The codec's options, for the record; decoding does not need them.
    shape : tuple of int
        (n_coeff, height, width, channel).
    body : bytes
        Payload and every side table: all that grows with the data, and what sizes count.
    info : mapping
        What else the codec measured, such as ``entropy_bits`` (an estimate, bits per coefficient).
    """

    codec: str
    config: Mapping[str, Any]
    shape: tuple[int, int, int, int]
    body: bytes
    info: Mapping[str, float] = field(default_factory=dict)

    @property
    def encoded_bytes(self) -> int:
        """Payload and every side table in bytes."""
        return len(self.body)

    @property
    def bits_per_coefficient(self) -> float:
        """``8 encoded_bytes / (n_coeff height width channel)``."""
        return 8.0 * len(self.body) / float(np.prod(self.shape, dtype=np.int64))

    def header(self) -> bytes:
        """Return the few fixed bytes in front of the body: magic, version, codec, shape, length, checksum."""
        name = self.codec.encode("ascii")
        head = MAGIC + struct.pack("<BB", WRAPPER_VERSION, len(name)) + name
        head += struct.pack("<4IQ", *self.shape, len(self.body))
        return head + struct.pack("<I", zlib.crc32(self.body, zlib.crc32(head)))

    def to_bytes(self) -> bytes:
        """Return header and body: these bytes alone decode."""
        return self.header() + self.body

    @classmethod
    def from_bytes(cls, payload: bytes) -> Self:
        """Take apart what `to_bytes` made; PayloadError if it is damaged, cut, or not ours."""
        payload = bytes(payload)  # no copy of bytes; a memoryview or bytearray is taken too
        if payload[:4] != MAGIC:
            raise PayloadError(f"not a clrelight payload: it starts with {payload[:4]!r}, expected {MAGIC!r}")
        if len(payload) < 6 or len(payload) < 6 + payload[5] + 28:
            raise PayloadError(f"the payload is cut short within its header, at {len(payload)} bytes")
        if payload[4] != WRAPPER_VERSION:
            raise PayloadError(f"payload version {payload[4]} is not known, this program reads {WRAPPER_VERSION}")
        at = 6 + payload[5]
        *shape, length = struct.unpack_from("<4IQ", payload, at)
        (checksum,) = struct.unpack_from("<I", payload, at + 24)
        body = payload[at + 28 :]
        if len(body) != length:
            raise PayloadError(f"the payload should have {length} bytes behind its header, it has {len(body)}")
        if zlib.crc32(body, zlib.crc32(payload[: at + 24])) != checksum:
            raise PayloadError("the payload's checksum does not fit: it is damaged")
        # Checked although the sum fits: a foreign writer may compute checksums too.
        try:
            check_shape(tuple(shape))
            codec = payload[6:at].decode("ascii")
        except ValueError as error:
            raise PayloadError(f"the payload's header is not valid: {error}") from None
        return cls(codec, {}, tuple(shape), body)


def check_shape(shape: tuple[int, ...]) -> None:
    """Raise ValueError unless (n_coeff, height, width, channel) is a shape that a payload may have."""
    if len(shape) != 4 or min(shape) < 1:
        raise ValueError(f"coefficients must be (coefficient, height, width, channel), none empty, got shape {shape}")
    if max(shape) > MAX_EXTENT or math.prod(shape) > MAX_COEFFICIENTS:
        raise ValueError(
            f"a coefficient map has at most {MAX_COEFFICIENTS} values and {MAX_EXTENT} along an axis, got {shape}"
        )
    # Coders go from channel to channel: a million of them, claimed by a few bytes, would take hours.
    if shape[3] > MAX_CHANNELS:
        raise ValueError(f"a coefficient map has at most {MAX_CHANNELS} channels, got {shape[3]}")
    degree_of(shape[0])


class View(Protocol):
    """A decoded map in a basis of its own."""

    def to_coeffs(self, device: Device) -> NDArray[np.float32]:
        """Return the (n_coeff, height, width, channel) coefficients."""
        ...

    def relight(self, directions_i3: NDArray[np.float64], device: Device) -> NDArray[np.float32]:
        """Return images (n_light, height, width, channel), float32 linear radiance in units of the peak.

        PayloadError where they are not finite: no encoder wrote such a map.
        """
        ...


class Codec(Configurable, ABC):
    """A way to turn a coefficient map into bytes and back. Subclasses are frozen dataclasses with an `id`.

    Their fields are the options (JSON values), checked in ``__post_init__`` with InputError.
    """

    kind: ClassVar[str] = "codec"
    summary: ClassVar[str]

    @abstractmethod
    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """Return payload with side tables, and what else was measured, from finite float32 coefficients."""

    @classmethod
    @abstractmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """Return the coefficients from the bytes alone; PayloadError if they do not make sense."""

    def predict_noise(self, coeffs_khwc: NDArray[np.float32], device: Device) -> Noise | None:
        """Return the noise to expect of `encode_body`, found in less than its time; None where there is no model."""
        return None

    def for_transfer(self, transfer: str) -> Codec:
        """Return the codec for a fit whose images are compared behind a transfer curve, where that is left open."""
        return self

    def try_on(self, sample_khwc: NDArray[np.float32], device: Device) -> Noise:
        """Return the noise of a sample, for codecs that code its parts as they code them among all others."""
        body, _ = self.encode_body(sample_khwc, device)
        decoded_khwc = self.decode_body(body, sample_khwc.shape, device)
        errors_kp = (decoded_khwc - sample_khwc.astype(np.float64)).reshape(len(sample_khwc), -1)
        return Noise.of_coefficients(second_moments(errors_kp))

    @classmethod
    def decode_view(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> View | None:
        """Return what relights without becoming coefficients first; None where coefficients are all there is."""
        return None


def register(codec: type[Codec]) -> type[Codec]:
    """Enter a codec class under its id (a class decorator); ValueError if the id is taken or fits no header."""
    if not (codec.id.isascii() and codec.id.isprintable() and 1 <= len(codec.id) <= 255):
        raise ValueError(f"a codec's id is 1 to 255 printable ASCII characters, got {codec.id!r}")
    if codec.id in _REGISTRY:
        raise ValueError(f"a codec {codec.id!r} is registered already: {_REGISTRY[codec.id]!r}")
    _REGISTRY[codec.id] = codec
    return codec


def codec_ids() -> list[str]:
    """Return the known ids."""
    return sorted(_REGISTRY)


def codec_class(codec_id: str) -> type[Codec]:
    """Return the class of an id; InputError lists the known ones."""
    if codec_id not in _REGISTRY:
        raise InputError(f"unknown codec {codec_id!r}; known are {', '.join(codec_ids())}")
    return _REGISTRY[codec_id]


def _checked(coeffs_khwc: NDArray[np.float32], device: Device) -> NDArray[np.float32]:
    """Return coefficients as codecs take them; InputError where they are none."""
    given = np.asarray(coeffs_khwc)
    if given.dtype.kind not in "fiu":
        raise InputError(f"coefficients must be real numbers, got {given.dtype}")
    try:
        check_shape(given.shape)
    except ValueError as error:
        raise InputError(str(error)) from None
    with np.errstate(over="ignore"):  # what float32 cannot hold is infinite now, and refused below
        coeffs = np.ascontiguousarray(given, dtype=np.float32)
    if not all_finite(coeffs, device):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(coeffs))[0])
        raise InputError(
            f"coefficient (k, row, column, channel) = {where} is {coeffs[where]}, expected a finite number"
        )
    return coeffs


def encode(coeffs_khwc: NDArray[np.float32], codec: Codec, device: Device) -> Encoded:
    """Encode a coefficient map.

    Parameters
    ----------
    coeffs_khwc : ndarray, shape (n_coeff, height, width, channel), float32
        Finite; other real types are converted.
    codec : Codec
        With its options.
    device : Device
        Where to encode.

    Returns
    -------
    Encoded
        What decodes by itself, and what was measured.

    Raises
    ------
    InputError
        If the shape is impossible, a coefficient is not finite, or the codec cannot hold one.
    """
    coeffs = _checked(coeffs_khwc, device)
    body, info = codec.encode_body(coeffs, device)
    return Encoded(codec.id, codec.to_config(), tuple(coeffs.shape), body, info)


def predict_noise(coeffs_khwc: NDArray[np.float32], codec: Codec, device: Device) -> Noise | None:
    """Return the noise that `encode` will leave in a coefficient map, without encoding it; see `Noise`.

    None where the codec has no model of its noise, or the degree none of its hemisphere.

    Raises
    ------
    InputError
        As `encode` does.
    """
    coeffs = _checked(coeffs_khwc, device)
    return codec.predict_noise(coeffs, device) if degree_of(len(coeffs)) <= MAX_METRIC_DEGREE else None


def decode(payload: Encoded | bytes, device: Device) -> NDArray[np.float32]:
    """Return the (n_coeff, height, width, channel) float32 coefficients of encoded bytes.

    Raises
    ------
    PayloadError
        If the bytes are damaged, cut short, not ours, or of a codec that is not known here.
    """
    encoded, codec = _open(payload)
    coeffs = codec.decode_body(encoded.body, encoded.shape, device)
    if coeffs.shape != encoded.shape or coeffs.dtype != np.float32:
        raise PayloadError(f"codec {encoded.codec} gave {coeffs.dtype} {coeffs.shape} for {encoded.shape}")
    if not all_finite(coeffs, device):  # finite is what was encoded
        raise PayloadError(f"the payload decodes to values that are not finite: codec {encoded.codec} did not write it")
    return coeffs


def decode_view(payload: Encoded | bytes, device: Device) -> View | None:
    """Return what relights an encoded map in its own basis, at no cost per coefficient; None for the plain basis.

    PayloadError as `decode` raises it.
    """
    encoded, codec = _open(payload)
    return codec.decode_view(encoded.body, encoded.shape, device)


def _open(payload: Encoded | bytes) -> tuple[Encoded, type[Codec]]:
    """Return an encoding and its codec, or PayloadError."""
    encoded = payload if isinstance(payload, Encoded) else Encoded.from_bytes(payload)
    try:
        check_shape(encoded.shape)
        return encoded, codec_class(encoded.codec)
    except ValueError as error:
        raise PayloadError(str(error)) from None
