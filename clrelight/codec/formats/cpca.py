"""Codec `cpca`: clustered principal component analysis of pixels (Sloan, Hall, Hart and Snyder 2003)."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.bitpack import pack_codes, packed_size, unpack_codes
from clrelight.codec.formats import cpca_search as search
from clrelight.codec.minimum_size import check_padding, least_bytes, pad_body
from clrelight.codec.registry import Codec, register
from clrelight.codec.slabs import slabs
from clrelight.codec.transforms import vectors
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError

MAX_CLUSTERS, MAX_COMPONENTS, MAX_BITS = 4096, 256, 16
MAX_WEIGHT = 2.0**40
"""Far above the weights of scaled vectors; keeps what hostile weights decode to finite."""

_HEAD = struct.Struct("<HHBh")


@register
@dataclass(frozen=True)
class Cpca(Codec):
    """Approximate each pixel's vector of all coefficients and channels in the affine subspace of its cluster.

    Pixels are clustered by their distance to the subspaces themselves; each has a cluster index and one weight for
    each component. A renderer may light the means and axes once, and then needs a few products a pixel.

    Body: clusters, components (uint16), bits (uint8), exponent e (int16); means (cluster, vector) and axes (cluster,
    component, vector) in units of 2**e as binary16; first level and step of the weights (cluster, component) as
    float32; packed cluster indices; packed weight codes (pixel, component); zeros up to one byte for each 1024
    coefficients. A vector is (coefficient, channel).

    Attributes
    ----------
    clusters : int
        1 to 4096; fewer where there are fewer pixels.
    components : int
        Axes of each cluster, 1 to 256; fewer where the vector is shorter.
    bits : int
        Bits of a weight, 1 to 16.
    """

    id: ClassVar[str] = "cpca"
    summary: ClassVar[str] = "clustered principal components: cluster index and a few weights per pixel"

    clusters: int = 16
    components: int = 8
    bits: int = 8

    def __post_init__(self) -> None:
        for name, most in (("clusters", MAX_CLUSTERS), ("components", MAX_COMPONENTS), ("bits", MAX_BITS)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
                raise InputError(f"codec cpca: {name} must be an integer from 1 to {most}, got {value!r}")

    def encode_body(self, coeffs_khwc: NDArray[np.float32], device: Device) -> tuple[bytes, dict[str, float]]:
        """Return tables, indices and weights; ``info["table_bytes"]`` is what does not grow with the pixels."""
        exponent = vectors.exponent_of(coeffs_khwc)
        vectors_pd = vectors.pixel_vectors(vectors.scaled(coeffs_khwc, -exponent))
        n_pixel, n_dim = vectors_pd.shape
        n_cluster, n_axis = min(self.clusters, n_pixel), min(self.components, n_dim)
        model = search.fit_subspaces(vectors_pd, n_cluster, n_axis)
        means_kd, axes_krd = model.means_kd.astype(np.float16), model.axes_krd.astype(np.float16)
        low_kr, step_kr = np.zeros((2, n_cluster, n_axis), np.float32)
        codes_pr = np.zeros((n_pixel, n_axis), np.uint16)
        for k in range(n_cluster):
            members = model.cluster_p == k
            if not members.any():
                continue
            # Weights for the tables as they are stored: best for those, not for what they were rounded from.
            inverse_dr = np.linalg.pinv(axes_krd[k].astype(np.float64))
            weights_pr = (vectors_pd[members] - means_kd[k].astype(np.float64)) @ inverse_dr
            low_kr[k] = weights_pr.min(axis=0)
            # Weights that are all the same may lie below their own float32.
            step_kr[k] = np.maximum(weights_pr.max(axis=0) - low_kr[k], 0.0) / (2**self.bits - 1)
            step = np.where(step_kr[k] > 0, step_kr[k], 1.0).astype(np.float64)
            codes_pr[members] = np.clip(np.rint((weights_pr - low_kr[k]) / step), 0, 2**self.bits - 1)
        tables = _HEAD.pack(n_cluster, n_axis, self.bits, exponent)
        tables += means_kd.tobytes() + axes_krd.tobytes() + low_kr.tobytes() + step_kr.tobytes()
        body = (
            tables + pack_codes(model.cluster_p, (n_cluster - 1).bit_length()) + pack_codes(codes_pr.ravel(), self.bits)
        )
        return pad_body(body, coeffs_khwc.size), {"table_bytes": float(len(tables))}

    @classmethod
    def decode_body(cls, body: bytes, shape: tuple[int, int, int, int], device: Device) -> NDArray[np.float32]:
        """Return the coefficients; PayloadError where tables, indices or lengths do not make sense."""
        n_pixel, n_dim = shape[1] * shape[2], shape[0] * shape[3]
        if len(body) < max(_HEAD.size, least_bytes(math.prod(shape))):
            raise PayloadError(f"codec cpca: {len(body)} bytes cannot hold coefficients of shape {shape}")
        n_cluster, n_axis, bits, exponent = _HEAD.unpack_from(body)
        if not (
            1 <= n_cluster <= min(MAX_CLUSTERS, n_pixel)
            and 1 <= n_axis <= min(MAX_COMPONENTS, n_dim)
            and 1 <= bits <= MAX_BITS
            and abs(exponent) <= 150
        ):
            raise PayloadError(f"codec cpca: {n_cluster} clusters, {n_axis} components, {bits} bits are not possible")
        index_bits = (n_cluster - 1).bit_length()
        sizes = [
            2 * n_cluster * n_dim,
            2 * n_cluster * n_axis * n_dim,
            4 * n_cluster * n_axis,
            4 * n_cluster * n_axis,
            packed_size(n_pixel, index_bits),
            packed_size(n_pixel * n_axis, bits),
        ]
        ends = [_HEAD.size + sum(sizes[:i]) for i in range(len(sizes) + 1)]
        check_padding(cls.id, body, ends[-1], math.prod(shape))
        parts = [body[a:b] for a, b in pairwise(ends)]
        means_kd = np.frombuffer(parts[0], np.float16).reshape(n_cluster, n_dim)
        axes_krd = np.frombuffer(parts[1], np.float16).reshape(n_cluster, n_axis, n_dim)
        with np.errstate(invalid="ignore"):
            low_kr, step_kr = (np.frombuffer(p, np.float32).reshape(n_cluster, n_axis) for p in parts[2:4])
            last_kr = low_kr + step_kr.astype(np.float64) * (2**bits - 1)
        if not (
            np.isfinite(means_kd).all()
            and np.isfinite(axes_krd).all()
            and ((np.abs(low_kr) <= MAX_WEIGHT) & (step_kr >= 0) & (last_kr <= MAX_WEIGHT)).all()
        ):
            raise PayloadError("codec cpca: a mean, an axis or a weight is not finite or far too large")
        cluster_p = unpack_codes(parts[4], n_pixel, index_bits)
        if cluster_p.max() >= n_cluster:
            raise PayloadError(f"codec cpca: a pixel is in cluster {cluster_p.max()} of {n_cluster}")
        codes_pr = unpack_codes(parts[5], n_pixel * n_axis, bits).reshape(n_pixel, n_axis)
        vectors_pd = np.empty((n_pixel, n_dim), np.float32)
        for pixels in slabs(n_pixel, 4 * n_dim):
            for k in np.unique(cluster_p[pixels]):
                members = pixels.start + np.flatnonzero(cluster_p[pixels] == k)
                weights_pr = low_kr[k] + codes_pr[members] * step_kr[k]
                decoded_pd = means_kd[k].astype(np.float32) + weights_pr @ axes_krd[k].astype(np.float32)
                vectors_pd[members] = vectors.scaled(decoded_pd, exponent)
        return vectors.from_pixel_vectors(vectors_pd, shape)
