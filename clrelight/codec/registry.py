"""The registry of codecs: what one is, how its bytes are wrapped, and how it is found by name."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.bodies import Body, BodyWriter, MemoryBody
from clrelight.codec.damage import Damage
from clrelight.codec.encoded import Encoded, check_shape
from clrelight.codec.finite import all_finite, check_coefficients
from clrelight.codec.minimum_size import least_payload
from clrelight.codec.rate.noise import Noise, second_moments
from clrelight.codec.streams import ArraySource, ArrayTarget, Source, Target
from clrelight.codec.transforms.metric import MAX_METRIC_DEGREE
from clrelight.codec.views import Regions, View
from clrelight.configurable import Configurable
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError, unknown
from clrelight.harmonics.index import degree_of

_REGISTRY: dict[str, type[Codec]] = {}


class Codec(Configurable, ABC):
    """A way to turn a coefficient map into bytes and back. Subclasses are frozen dataclasses with an `id`.

    Their fields are the options (JSON values), checked in ``__post_init__`` with InputError.
    """

    kind: ClassVar[str] = "codec"
    summary: ClassVar[str]
    encoding_holds: ClassVar[float] = 4.0
    decoding_holds: ClassVar[float] = 3.0
    """Times the bytes of a float32 map that the two take in any workspace; 0 for codecs that take parts."""

    hemisphere: ClassVar[bool] = False  # whether what functions are at z < 0 is left open
    decodes_finite: ClassVar[bool] = False  # whether what it decodes to was seen to be finite, or cannot be else
    takes_bases: ClassVar[bool] = True  # whether coefficients may be of other bases than spherical harmonics

    def bytes_to_encode(self, shape: tuple[int, int, int, int]) -> int:
        """Return about how many bytes of memory encoding takes at least, beside those of a workspace."""
        return int(4 * self.encoding_holds * math.prod(shape))

    @classmethod
    def bytes_to_decode(cls, body: Body, shape: tuple[int, int, int, int]) -> int:
        """Return the same of decoding; PayloadError where the body does not say."""
        return int(4 * cls.decoding_holds * math.prod(shape))

    @classmethod
    def least_bytes(cls, shape: tuple[int, int, int, int]) -> int:
        """Return the fewest bytes that may be asked for maps of a shape, if they may be black."""
        return least_payload(shape)

    @abstractmethod
    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """Return payload with side tables, and what else was measured, from finite float32 coefficients."""

    @classmethod
    @abstractmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """Return the coefficients from the bytes alone; PayloadError if they do not make sense."""

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write what `encode_body` returns; here from the whole map in memory."""
        content, info = self.encode_body(source.whole(), source.device)
        body.write_all(content)
        return info

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put what `decode_body` returns; here the whole map in memory."""
        target.put_rows(0, cls.decode_body(body[:], target.shape, device))

    def predict_noise(self, source: Source) -> Noise | None:
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
    def decode_view(cls, body: Body, shape: tuple[int, int, int, int], device: Device) -> View | None:
        """Return what relights without becoming coefficients first; None where coefficients are all there is."""
        return None

    @classmethod
    def decode_regions(cls, body: Body, shape: tuple[int, int, int, int], damage: Damage | None) -> Regions | None:
        """Return what decodes parts alone, damaged ones too where `damage` is there to be told; None if none does."""
        return None


class PartsCodec(Codec):
    """A codec that takes rows or maps in parts, in memory or from files alike; all bytes are the same."""

    encoding_holds: ClassVar[float] = 0.0
    decoding_holds: ClassVar[float] = 0.0

    @abstractmethod
    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write payload with side tables, and return what else was measured."""

    @classmethod
    @abstractmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put the coefficients and finish the target; PayloadError if the bytes do not make sense."""

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`."""
        info = self.encode_parts(ArraySource(coeffs_khwc, device), body := MemoryBody())
        return body.to_bytes(), info

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        target = ArrayTarget(shape)
        cls.decode_parts(body, target, device)
        return target.coeffs()


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
        raise unknown("codec", codec_id, codec_ids())
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
    check_coefficients(coeffs, device)
    return coeffs


def encode(
    coeffs_khwc: NDArray[np.float32], codec: Codec, device: Device, basis: str = SH, lights_i3: NDArray | None = None
) -> Encoded:
    """Encode a coefficient map.

    Parameters
    ----------
    coeffs_khwc : ndarray, shape (n_coeff, height, width, channel), float32
        Finite; other real types are converted.
    codec : Codec
        With its options.
    device : Device
        Where to encode.
    basis : str
        What they are coefficients of (`clrelight.bases`).
    lights_i3 : ndarray, shape (n_light, 3), float64, optional
        Unit vectors of the lights that they were fitted to: `klt` spends bits where these are. By default all of the
        hemisphere is worth the same.

    Returns
    -------
    Encoded
        What decodes by itself, and what was measured.

    Raises
    ------
    InputError
        If the shape is impossible, a coefficient is not finite, or the codec cannot hold one.
    """
    source, body = array_source(coeffs_khwc, device, basis, lights_i3), MemoryBody()
    info = encode_stream(source, codec, body)
    return Encoded(codec.id, codec.to_config(), source.shape, body.to_bytes(), info)


def predict_noise(coeffs_khwc: NDArray[np.float32], codec: Codec, device: Device) -> Noise | None:
    """Return the noise that `encode` will leave in a coefficient map, without encoding it; see `Noise`.

    None where the codec has no model of its noise, or the degree none of its hemisphere.

    Raises
    ------
    InputError
        As `encode` does.
    """
    return predict_noise_of(array_source(coeffs_khwc, device), codec)


def array_source(
    coeffs_khwc: NDArray[np.float32], device: Device, basis: str = SH, lights_i3: NDArray | None = None
) -> ArraySource:
    """Return coefficients in memory as `encode_stream` takes them; InputError as `encode` raises it."""
    return ArraySource(_checked(coeffs_khwc, device), device, basis, lights_i3)


def predict_noise_of(source: Source, codec: Codec) -> Noise | None:
    """Return what `predict_noise` does of coefficients that may lie in a file."""
    noise = codec.predict_noise(source) if degree_of(source.shape[0]) <= MAX_METRIC_DEGREE else None
    return noise if noise is None else replace(noise, basis=source.basis)


def encode_stream(source: Source, codec: Codec, body: BodyWriter) -> dict[str, float]:
    """Encode coefficients that may lie in a file, and return what was measured; the bytes are those of `encode`.

    Raises
    ------
    InputError
        As `encode` does, and where a part does not fit the source's workspace.
    """
    try:
        check_shape(source.shape)
    except ValueError as error:
        raise InputError(str(error)) from None
    if not (source.basis == SH or codec.takes_bases):
        raise InputError(
            f"codec {codec.id} makes spherical harmonics orthonormal over the hemisphere, but this is of basis "
            f"{source.basis}: take klt, or the codec inside {codec.id} by itself"
        )
    return codec.encode_parts(source, body)


def decode(payload: Encoded | bytes, device: Device) -> NDArray[np.float32]:
    """Return the (n_coeff, height, width, channel) float32 coefficients of encoded bytes.

    Raises
    ------
    PayloadError
        If the bytes are damaged, cut short, not ours, or of a codec that is not known here.
    """
    encoded, codec = open_payload(payload, summed=True)
    coeffs = codec.decode_body(encoded.body[:], encoded.shape, device)
    if coeffs.shape != encoded.shape or coeffs.dtype != np.float32:
        raise PayloadError(f"codec {encoded.codec} gave {coeffs.dtype} {coeffs.shape} for {encoded.shape}")
    check_decoded(coeffs, encoded.codec, device)
    return coeffs


def decode_stream(encoded: Encoded, target: Target, device: Device) -> None:
    """Decode to where the coefficients shall go; PayloadError as `decode` raises it."""
    found, codec = open_payload(encoded, summed=True)
    codec.decode_parts(found.body, target, device)


def bytes_to_decode(encoded: Encoded) -> int:
    """Return about how many bytes of memory decoding takes at least; PayloadError as `decode` raises it."""
    found, codec = open_payload(encoded)
    return codec.bytes_to_decode(found.body, found.shape)


def check_decoded(coeffs_khwc: NDArray[np.float32], codec_id: str, device: Device) -> None:
    """Raise PayloadError unless coefficients that were decoded are finite, as those encoded were."""
    if not codec_class(codec_id).decodes_finite:
        refuse_infinite(coeffs_khwc, codec_id, device)


def refuse_infinite(coeffs_khwc: NDArray[np.float32], codec_id: str, device: Device) -> None:
    """Raise PayloadError unless coefficients that a codec decodes to are finite."""
    if not all_finite(coeffs_khwc, device):
        raise PayloadError(f"the payload decodes to values that are not finite: codec {codec_id} did not write it")


def open_payload(payload: Encoded | bytes, *, summed: bool = False) -> tuple[Encoded, type[Codec]]:
    """Return an encoding, whose checksum was compared where that is asked for, and its codec, or PayloadError."""
    encoded = payload if isinstance(payload, Encoded) else Encoded.from_bytes(payload)
    encoded = encoded.summed() if summed else encoded
    try:
        check_shape(encoded.shape)
        return encoded, codec_class(encoded.codec)
    except ValueError as error:
        raise PayloadError(str(error)) from None
