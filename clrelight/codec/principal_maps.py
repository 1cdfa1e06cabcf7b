"""Any codec, on the scene's own principal axes: most of what it codes lies in the first few maps."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.factored import WhitenedMaps
from clrelight.codec.finite import check_sums
from clrelight.codec.metric import hemisphere_metric
from clrelight.codec.principal import sample_stride
from clrelight.codec.registry import Codec, codec_class, register
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

_COUNT = struct.Struct("<H")
_LEFT_OUT = 1e-4
"""Share of the image's energy that the axes left out by default may hold."""


@register
@dataclass(frozen=True)
class PrincipalMaps(Codec):
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
    the inner body. The maps are solved by least squares against the axes as they are stored.
    """

    id: ClassVar[str] = "principal"
    summary: ClassVar[str] = "another codec on the scene's principal axes: maps that are not needed are not coded"

    codec: str = "s3tc"
    options: Mapping[str, Any] = field(default_factory=dict)
    planes: int | None = None

    def __post_init__(self) -> None:
        if self.codec in _NOT_INSIDE:
            raise InputError(f"codec {self.codec} changes the basis itself, choose another inside principal")
        if self.planes is not None and not (isinstance(self.planes, int) and 1 <= self.planes <= 65535):
            raise InputError(f"planes must be 1 to 65535, got {self.planes!r}")
        codec_class(self.codec).from_config(self.options)

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """See `Codec`; what the inner codec reports is passed on, and the number of planes."""
        n_coeff, height, width, channel = coeffs_khwc.shape
        forward_jk = hemisphere_metric(n_coeff).forward_jk
        sampled = coeffs_khwc.reshape(n_coeff, height * width, channel)[:, :: sample_stride(height * width)]
        z_jp = forward_jk @ sampled.reshape(n_coeff, -1)
        scale = float(np.abs(z_jp).max()) or 1.0  # squares of float32's largest numbers stay finite in float64
        energy, vectors = np.linalg.eigh((z_jp / scale) @ (z_jp / scale).T)
        axes = vectors[:, ::-1].T[: self._count_planes(energy[::-1])].astype("<f2")
        along_jk = np.linalg.pinv(axes.astype(np.float64)).T @ forward_jk
        maps = check_sums(WhitenedMaps(coeffs_khwc, along_jk).to_coeffs(device), device)
        name = self.codec.encode("ascii")
        head = bytes([len(name)]) + name + _COUNT.pack(len(axes)) + axes.tobytes()
        options = dict(self.options)
        if "rate" in options:
            rate = (options["rate"] * coeffs_khwc.size - 8.0 * len(head)) / maps.size
            if rate <= 0.0:
                raise InputError(f"{options['rate']:g} bits per coefficient are too few for the table of axes alone")
            options["rate"] = rate
        body, info = codec_class(self.codec).from_config(options).encode_body(maps, device)
        return head + body, {**info, "planes": float(len(axes))}

    def _count_planes(self, energy: NDArray[np.float64]) -> int:
        if self.planes is not None:
            return min(self.planes, len(energy))
        left = energy.sum() - np.cumsum(energy)
        return int(np.argmax(left <= _LEFT_OUT * energy.sum())) + 1

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """See `Codec`."""
        return cls.decode_view(body, shape, device).to_coeffs(device)

    @classmethod
    def decode_view(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> WhitenedMaps:
        """Return the maps along the axes, which relight as they are."""
        inverse_kj = hemisphere_metric(shape[0]).inverse_kj
        at = 1 + body[0] if body else 1
        if len(body) < at + _COUNT.size:
            raise PayloadError("a principal body starts with the name of its codec, this one is too short")
        try:
            inner = codec_class(body[1:at].decode("ascii"))
        except (InputError, UnicodeDecodeError):
            raise PayloadError("a principal body names a codec that is not known") from None
        if inner.id in _NOT_INSIDE:
            raise PayloadError(f"a principal body cannot hold codec {inner.id}")
        (count,) = _COUNT.unpack_from(body, at)
        component = inverse_kj.shape[1]
        start = at + _COUNT.size
        end = start + 2 * count * component
        if not 1 <= count <= component or len(body) < end:
            raise PayloadError(f"a principal body of {len(body)} bytes cannot have {count} axes")
        axes = np.frombuffer(body, "<f2", count * component, start).reshape(count, component).astype(np.float64)
        if not np.abs(axes).max() <= 1.0:
            raise PayloadError("a principal body holds axes beyond unit length")
        maps = inner.decode_body(body[end:], (count, *shape[1:]), device)
        return WhitenedMaps(maps, inverse_kj @ axes.T)


_NOT_INSIDE = ("principal", "whitened", "klt")
