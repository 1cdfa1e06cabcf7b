"""Any codec, on the scene's own principal axes: most of what it codes lies in the first few maps."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter, rest_of
from clrelight.codec.factored import WhitenedMaps
from clrelight.codec.formats.inner import NOT_INSIDE, name_inner, open_inner
from clrelight.codec.registry import Codec, PartsCodec, codec_class, register
from clrelight.codec.streams import Source, Target
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.principal import sample_stride
from clrelight.codec.transforms.whitening import AXES
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

_COUNT = struct.Struct("<H")
_BEFORE = "smooth"
"""Axes of bodies that do not say that theirs are alike everywhere."""
_LEFT_OUT = 1e-4
"""Share of the image's energy that the axes left out by default may hold."""


@register
@dataclass(frozen=True)
class PrincipalMaps(PartsCodec):
    """Whitened coefficients along the principal axes of a scene, through another codec.

    The axes are those of all pixels and channels together, orthonormal in the metric of the hemisphere; the mean is not
    removed, so that the first map is nearly it and no table but the axes is needed.

    Attributes
    ----------
    codec : str
        The codec of the maps.
    options : mapping
        Its options. A rate is in bits per coefficient of the map as fitted, with the table of axes counted.
    planes : int, optional
        How many axes are kept; by default the fewest that leave out less than 1e-4 of the image's energy.

    Notes
    -----
    Body: length of the inner codec's id (1 byte), id, the number of axes (2 bytes), axes (n_axis, n_component) float16,
    the inner body. The maps are solved by least squares against the axes as they are stored. Bodies of before have
    other axes of the hemisphere, which above degree 8 processors disagree about.
    """

    id: ClassVar[str] = "principal"
    hemisphere: ClassVar[bool] = True
    takes_bases: ClassVar[bool] = False
    summary: ClassVar[str] = "another codec on the scene's principal axes: maps that are not needed are not coded"

    codec: str = "s3tc"
    options: Mapping[str, Any] = field(default_factory=dict)
    planes: int | None = None

    def __post_init__(self) -> None:
        if self.codec in NOT_INSIDE:
            raise InputError(f"codec {self.codec} changes the basis itself, choose another inside principal")
        if self.planes is not None and not (isinstance(self.planes, int) and 1 <= self.planes <= 65535):
            raise InputError(f"planes must be 1 to 65535, got {self.planes!r}")
        codec_class(self.codec).from_config(self.options)

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """See `Codec`; what the inner codec reports is passed on, and the number of planes."""
        forward_jk = hemisphere_metric(source.shape[0], AXES).forward_jk
        z_jp = forward_jk @ _sample_pixels(source)
        scale = float(np.abs(z_jp).max()) or 1.0  # squares of float32's largest numbers stay finite in float64
        energy, vectors = np.linalg.eigh((z_jp / scale) @ (z_jp / scale).T)
        axes = vectors[:, ::-1].T[: self._count_planes(energy[::-1])].astype("<f2")
        along_jk = np.linalg.pinv(axes.astype(np.float64)).T @ forward_jk
        maps = source.mapped(along_jk)
        head = name_inner(self.codec) + _COUNT.pack(len(axes)) + axes.tobytes()
        options = dict(self.options)
        if "rate" in options:
            rate = (options["rate"] * math.prod(source.shape) - 8.0 * len(head)) / math.prod(maps.shape)
            if rate <= 0.0:
                raise InputError(f"{options['rate']:g} bits per coefficient are too few for the table of axes alone")
            options["rate"] = rate
        body.lead(head)
        info = codec_class(self.codec).from_config(options).encode_parts(maps, body)
        return {**info, "planes": float(len(axes))}

    def _count_planes(self, energy: NDArray[np.float64]) -> int:
        if self.planes is not None:
            return min(self.planes, len(energy))
        left = energy.sum() - np.cumsum(energy)
        return int(np.argmax(left <= _LEFT_OUT * energy.sum())) + 1

    def bytes_to_encode(self, shape: tuple[int, int, int, int]) -> int:
        """See `Codec`; the inner codec's, of as many maps as there may be."""
        return codec_class(self.codec).from_config(self.options).bytes_to_encode(shape)

    @classmethod
    def bytes_to_decode(cls, body: Body, shape: tuple[int, int, int, int]) -> int:
        """See `Codec`; the inner codec's."""
        inner, inverse_kj, inside = _open(body, shape[0])
        return inner.bytes_to_decode(inside, (inverse_kj.shape[1], *shape[1:]))

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """See `Codec`."""
        inner, inverse_kj, inside = _open(body, target.shape[0])
        inner.decode_parts(inside, target.mapped(inverse_kj, device), device)

    @classmethod
    def decode_view(cls, body: Body, shape: tuple[int, int, int, int], device: Device) -> WhitenedMaps:
        """Return the maps along the axes, which relight as they are."""
        inner, inverse_kj, inside = _open(body, shape[0])
        return WhitenedMaps(inner.decode_body(inside[:], (inverse_kj.shape[1], *shape[1:]), device), inverse_kj)


def _sample_pixels(source: Source) -> NDArray[np.float32]:
    """Return some pixels of all channels, (n_coeff, pixel * channel)."""
    n_coeff, height, width, channel = source.shape
    stride = sample_stride(height * width)
    sampled = []
    with source.rows() as parts:
        for first, coeffs_khwc in parts:
            pixels = coeffs_khwc.reshape(n_coeff, -1, channel)[:, -first * width % stride :: stride]
            sampled.append(pixels.reshape(n_coeff, -1))
            if source.shape[1] != coeffs_khwc.shape[1]:
                sampled[-1] = sampled[-1].copy()  # the part's memory is used again
    return np.concatenate(sampled, axis=1)


def _open(body: Body, n_coeff: int) -> tuple[type[Codec], NDArray[np.float64], Body]:
    """Return the inner codec, the matrix that makes coefficients of its maps, and its body; or PayloadError."""
    inner, kind, inside = open_inner(body, PrincipalMaps.id, _BEFORE)
    inverse_kj = hemisphere_metric(n_coeff, kind).inverse_kj
    if len(inside) < _COUNT.size:
        raise PayloadError("a principal body has the number of its axes behind the name, this one is too short")
    (count,) = _COUNT.unpack(inside[: _COUNT.size])
    component = inverse_kj.shape[1]
    end = _COUNT.size + 2 * count * component
    if not 1 <= count <= component or len(inside) < end:
        raise PayloadError(f"a principal body of {len(body)} bytes cannot have {count} axes")
    axes = np.frombuffer(inside[_COUNT.size : end], "<f2").reshape(count, component).astype(np.float64)
    if not np.abs(axes).max() <= 1.0:
        raise PayloadError("a principal body holds axes beyond unit length")
    return inner, inverse_kj @ axes.T, rest_of(inside, end)
