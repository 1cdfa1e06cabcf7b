"""Any codec, on coordinates that are whitened first: an error in them is an error in the image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from clrelight.codec.bodies import Body, BodyWriter
from clrelight.codec.factored import WhitenedMaps
from clrelight.codec.formats.inner import NOT_INSIDE, name_inner, open_inner
from clrelight.codec.rate.noise import Noise
from clrelight.codec.registry import Codec, PartsCodec, codec_class, register
from clrelight.codec.streams import Source, Target
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.whitening import AXES
from clrelight.device import Device
from clrelight.errors import InputError

_BEFORE = "singular"
"""Axes of bodies that do not say that theirs are alike everywhere."""


@register
@dataclass(frozen=True)
class Whitened(PartsCodec):
    """Coefficients in the metric of the hemisphere (see `hemisphere_metric`), through another codec.

    Attributes
    ----------
    codec : str
        The codec of the whitened maps.
    options : mapping
        Its options.

    Notes
    -----
    Body: length of the inner codec's id (1 byte), id, the inner body. The change of coordinates depends on the degree
    alone, so nothing else is sent. Bodies of before have other axes, which above degree 11 processors disagree about.
    """

    id: ClassVar[str] = "whitened"
    hemisphere: ClassVar[bool] = True
    takes_bases: ClassVar[bool] = False
    summary: ClassVar[str] = "another codec on whitened coefficients: errors cost the same everywhere in the image"

    codec: str = "s3tc"
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.codec in NOT_INSIDE:
            raise InputError(f"codec {self.codec} is whitened itself, choose another inside whitened")
        codec_class(self.codec).from_config(self.options)

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """See `Codec`; what the inner codec reports is passed on."""
        body.lead(name_inner(self.codec))
        return self._inner().encode_parts(_whiten(source), body)

    def predict_noise(self, source: Source) -> Noise | None:
        """See `Codec`; the inner codec's, in whitened coordinates, where errors weigh the same in the image."""
        noise = self._inner().predict_noise(_whiten(source))
        if noise is None:
            return None
        return Noise(noise.covariance_jj, hemisphere_metric(source.shape[0], AXES).inverse_kj @ noise.basis_kj)

    def _inner(self) -> Codec:
        return codec_class(self.codec).from_config(self.options)

    def bytes_to_encode(self, shape: tuple[int, int, int, int]) -> int:
        """See `Codec`; the inner codec's."""
        return self._inner().bytes_to_encode(shape)

    @classmethod
    def bytes_to_decode(cls, body: Body, shape: tuple[int, int, int, int]) -> int:
        """See `Codec`; the inner codec's."""
        inner, _, inside = open_inner(body, cls.id, _BEFORE)
        return inner.bytes_to_decode(inside, shape)

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """See `Codec`."""
        inner, axes, inside = open_inner(body, cls.id, _BEFORE)
        inverse_kj = hemisphere_metric(target.shape[0], axes).inverse_kj
        inner.decode_parts(inside, target.mapped(inverse_kj, device), device)

    @classmethod
    def decode_view(cls, body: Body, shape: tuple[int, int, int, int], device: Device) -> WhitenedMaps:
        """Return the whitened maps, which relight as they are."""
        inner, axes, inside = open_inner(body, cls.id, _BEFORE)
        inverse_kj = hemisphere_metric(shape[0], axes).inverse_kj
        return WhitenedMaps(inner.decode_body(inside[:], (inverse_kj.shape[1], *shape[1:]), device), inverse_kj)


def _whiten(source: Source) -> Source:
    return source.remember("whitened", lambda: source.mapped(hemisphere_metric(source.shape[0], AXES).forward_jk))
