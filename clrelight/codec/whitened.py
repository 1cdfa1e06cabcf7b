"""Any codec, on coordinates that are whitened first: an error in them is an error in the image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.factored import WhitenedMaps
from clrelight.codec.finite import check_sums
from clrelight.codec.metric import hemisphere_metric
from clrelight.codec.noise import Noise
from clrelight.codec.registry import Codec, codec_class, register
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError


@register
@dataclass(frozen=True)
class Whitened(Codec):
    """Coefficients in the metric of the hemisphere, ``z = S V' c`` (see `hemisphere_metric`), through another codec.

    Attributes
    ----------
    codec : str
        The codec of the whitened maps.
    options : mapping
        Its options.

    Notes
    -----
    Body: length of the inner codec's id (1 byte), id, the inner body. The change of coordinates depends on the degree
    alone, so nothing else is sent.
    """

    id: ClassVar[str] = "whitened"
    summary: ClassVar[str] = "another codec on whitened coefficients: errors cost the same everywhere in the image"

    codec: str = "s3tc"
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.codec in _NOT_INSIDE:
            raise InputError(f"codec {self.codec} is whitened itself, choose another inside whitened")
        codec_class(self.codec).from_config(self.options)

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`; what the inner codec reports is passed on."""
        inner = codec_class(self.codec).from_config(self.options)
        body, info = inner.encode_body(_whiten(coeffs_khwc, device), device)
        name = self.codec.encode("ascii")
        return bytes([len(name)]) + name + body, info

    def predict_noise(self, coeffs_khwc: NDArray[np.float32], device: Device) -> Noise | None:
        """See `Codec`; the inner codec's, in whitened coordinates, where errors weigh the same in the image."""
        inner = codec_class(self.codec).from_config(self.options)
        noise = inner.predict_noise(_whiten(coeffs_khwc, device), device)
        if noise is None:
            return None
        return Noise(noise.covariance_jj, hemisphere_metric(len(coeffs_khwc), "singular").inverse_kj @ noise.basis_kj)

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        return cls.decode_view(body, shape, device).to_coeffs(device)

    @classmethod
    def decode_view(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> WhitenedMaps:
        """Return the whitened maps, which relight as they are."""
        if not body or len(body) < 1 + body[0]:
            raise PayloadError("a whitened body starts with the name of its codec, this one is too short")
        try:
            inner = codec_class(body[1 : 1 + body[0]].decode("ascii"))
        except (InputError, UnicodeDecodeError):
            raise PayloadError("a whitened body names a codec that is not known") from None
        if inner.id in _NOT_INSIDE:
            raise PayloadError(f"a whitened body cannot hold codec {inner.id}")
        inverse_kj = hemisphere_metric(shape[0], "singular").inverse_kj
        maps = inner.decode_body(body[1 + body[0] :], (inverse_kj.shape[1], *shape[1:]), device)
        return WhitenedMaps(maps, inverse_kj)


def _whiten(coeffs_khwc: NDArray[np.float32], device: Device) -> NDArray[np.float32]:
    # The same product as back, with the matrix that leads into the metric.
    forward_jk = hemisphere_metric(len(coeffs_khwc), "singular").forward_jk
    return check_sums(WhitenedMaps(coeffs_khwc, forward_jk).to_coeffs(device), device)


_NOT_INSIDE = ("principal", "whitened", "klt")
