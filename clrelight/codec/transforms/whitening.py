"""A map's principal axes over coefficients and channels together, in coordinates whose errors all cost alike.

All of it is one matrix from the coefficients of a pixel to its planes, found from some of the pixels.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.transforms.light_metric import light_root
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.principal import ROTATION_UNIT, Axes, each_channel
from clrelight.opencl.arguments import DeviceArray
from clrelight.threads import on_one_thread

AXES = "damped"
"""Those of `hemisphere_metric` that every processor finds alike."""
_SAMPLED_ROWS, _SAMPLED_PIXELS, _SAMPLED_VALUES = 256, 1 << 15, 1 << 24
_PART_PIXELS, _FEW_PIXELS = 1 << 11, 256
"""Pixels whose moments are summed together, and by which the mean is reckoned that is taken off before."""

Planes = tuple[NDArray[np.float64], NDArray[np.float64]]
"""What makes planes: a matrix (n_plane, n_coeff * channel), and what is taken off."""
ReadPlaces = Callable[[Sequence[tuple[int, slice]]], NDArray[np.float32]]
"""Returns some pixels of some rows of all maps, (n_coeff, pixels, channel), one row after another."""


@dataclass(frozen=True)
class Whitening:
    """What leads from the coefficients of a pixel, (k c) in a row, to coordinates d, and to principal axes j.

    Attributes
    ----------
    exponent : int
        Power of two that coefficients are divided by.
    rotation_cc : ndarray, shape (channel, channel), int8
        Rows are the rotated channels, in units of 1 / `ROTATION_UNIT`.
    forward_dq : ndarray, shape (channel * n_component, n_coeff * channel), float64
        The division, the hemisphere's metric and the rotation.
    mean_d : ndarray, float64
    vectors_jd : ndarray, float64
        Axes by the deviation of the pixels along them, orthonormal in the metric of `root_nn`.
    deviation_j : ndarray, float64
        Standard deviations, descending.
    root_nn : ndarray, shape (n_component, n_component), float64
        What an error e of a channel's coordinates costs is ``|root e|^2``; upper triangular.
    """

    exponent: int
    rotation_cc: NDArray[np.int8]
    forward_dq: NDArray[np.float64]
    mean_d: NDArray[np.float64]
    vectors_jd: NDArray[np.float64]
    deviation_j: NDArray[np.float64]
    root_nn: NDArray[np.float64]

    def exact(self, count: int) -> Planes:
        """Return what makes the first planes."""
        return self._made(each_channel(self.vectors_jd[:count], self.root_nn.T))

    def solved(self, axes: Axes) -> Planes:
        """Return the same for axes as the decoder knows them: planes are coordinates along them by least squares."""
        vectors = each_channel(axes.vectors_jd, self.root_nn.T)
        # The axes being near orthonormal, their Gram matrix is near the identity, and far smaller than they are.
        return self._made(np.linalg.pinv(vectors @ vectors.T, hermitian=True) @ vectors)

    def turned(self, turn_jj: NDArray[np.float64]) -> Whitening:
        """Return the same with the first axes turned: rows of a rotation are the new ones in terms of the old."""
        count = len(turn_jj)
        variance_j = np.square(turn_jj) @ np.square(self.deviation_j[:count])
        order = np.argsort(-variance_j, kind="stable")
        vectors_jd, deviation_j = self.vectors_jd.copy(), self.deviation_j.copy()
        vectors_jd[:count] = turn_jj[order] @ self.vectors_jd[:count]
        deviation_j[:count] = np.sqrt(variance_j[order])
        return replace(self, vectors_jd=vectors_jd, deviation_j=deviation_j)

    def cost_j(self, errors_jd: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what errors of axes cost for each squared unit of their planes."""
        return (each_channel(errors_jd, self.root_nn.T) ** 2).sum(axis=1)

    def _made(self, solution_jd: NDArray[np.float64]) -> Planes:
        weighted_jd = each_channel(solution_jd, self.root_nn)
        return weighted_jd @ self.forward_dq, weighted_jd @ self.mean_d


def whitening_of(
    shape: tuple[int, int, int, int],
    read: ReadPlaces,
    turn_dc: NDArray[np.float64] | None = None,
    basis: str = SH,
    lights_i3: NDArray[np.float64] | None = None,
    beside: Sequence[tuple[int, int]] = (),
) -> Whitening:
    """Return the whitening of a map of which some pixels are read; always the same, whatever else the machine does.

    They lie all over it; those `beside`, (row, column), are read too. Errors along the rows of `turn_dc` cost alike; by
    default those of the channels do, in the rows of a rotation. Over directions they cost what
    `clrelight.codec.transforms.light_metric.light_root` says of `lights_i3`.
    """
    pixels_kpc = _sample(shape, read, beside)
    with on_one_thread():
        metric = hemisphere_metric(shape[0], AXES, basis)
        root_nn = light_root(metric, basis, lights_i3)
        return _whiten(_moments_of(pixels_kpc), metric.forward_jk, shape[3], turn_dc, root_nn)


class _Moments(NamedTuple):
    """Of pixels: the largest magnitude, the mean of each value, and their covariances."""

    largest: float
    mean_q: NDArray[np.float64]
    covariance_qq: NDArray[np.float64]


def _moments_of(pixels_kpc: NDArray[np.float32]) -> _Moments:
    """Return the moments of pixels, of parts that processors take as they are free; their sums have one order."""
    about_q = pixels_kpc[:, :: max(pixels_kpc.shape[1] // _FEW_PIXELS, 1)].mean(axis=1, dtype=np.float64).ravel()

    def sums(start: int) -> tuple[float, NDArray[np.float64], NDArray[np.float64]]:
        part_kpc = pixels_kpc[:, start : start + _PART_PIXELS]
        part_pq = part_kpc.transpose(1, 0, 2).astype(np.float64, order="C").reshape(part_kpc.shape[1], -1)
        largest = float(max(part_pq.max(), -part_pq.min()))
        part_pq -= about_q
        return largest, part_pq.sum(axis=0), part_pq.T @ part_pq

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # NumPy lets go of Python's lock
        found = list(pool.map(sums, range(0, pixels_kpc.shape[1], _PART_PIXELS)))
    off_q = sum((each for _, each, _ in found), np.zeros(len(about_q))) / pixels_kpc.shape[1]
    square_qq = sum((each for _, _, each in found), np.zeros((len(about_q), len(about_q))))
    covariance_qq = square_qq / pixels_kpc.shape[1] - np.outer(off_q, off_q)
    return _Moments(max(largest for largest, _, _ in found), about_q + off_q, covariance_qq)


def _whiten(
    moments: _Moments,
    metric_jk: NDArray[np.float64],
    channel: int,
    wanted_dc: NDArray[np.float64] | None,
    root_nn: NDArray[np.float64],
) -> Whitening:
    """Return the whitening of pixels, of which all hangs on their moments."""
    largest, mean_q, covariance_qq = moments
    exponent = int(np.clip(np.frexp(largest)[1], -126, 126)) if largest else 0
    n_coeff, forward_jk = metric_jk.shape[1], np.ldexp(metric_jk, -exponent)
    if wanted_dc is None:
        moment_kcld = (covariance_qq + np.outer(mean_q, mean_q)).reshape(n_coeff, channel, n_coeff, channel)
        shown_jk = root_nn @ forward_jk
        wanted_dc = np.linalg.eigh(np.einsum("kl,kcld->cd", shown_jk.T @ shown_jk, moment_kcld))[1][:, ::-1].T
    rotation_cc = np.rint(ROTATION_UNIT * wanted_dc).astype(np.int8)
    turn_dc = rotation_cc / ROTATION_UNIT
    forward_dq = np.einsum("dc,jk->djkc", turn_dc, forward_jk).reshape(channel * len(forward_jk), n_coeff * channel)
    shown_dq = each_channel(forward_dq.T, root_nn.T).T
    variance, vectors = np.linalg.eigh(shown_dq @ covariance_qq @ shown_dq.T)
    deviation = np.sqrt(np.maximum(variance[::-1], 0.0))
    vectors_jd = each_channel(vectors[:, ::-1].T, np.asarray(np.linalg.inv(root_nn).T, np.float64))
    return Whitening(exponent, rotation_cc, forward_dq, forward_dq @ mean_q, vectors_jd, deviation, root_nn)


def _sample(
    shape: tuple[int, int, int, int], read: ReadPlaces, beside: Sequence[tuple[int, int]]
) -> NDArray[np.float32]:
    """Return the coefficients of pixels that lie all over the image, (n_coeff, n_pixel, channel)."""
    n_coeff, height, width, channel = shape
    most = min(_SAMPLED_PIXELS, _SAMPLED_VALUES // (n_coeff * channel))
    step = -(-height // _SAMPLED_ROWS)
    rows = range(step // 2, height, step)
    column_step = -(-width * len(rows) // most)
    places = [(y, slice((7 * i) % column_step, width, column_step)) for i, y in enumerate(rows)]
    return read(places + [(row, slice(column, column + 1)) for row, column in beside])


def reshaped(array: DeviceArray, shape: tuple[int, ...]) -> DeviceArray:
    """Return the same memory, or the first of it, under another shape."""
    host = array.host
    if host is not None:
        host = host.reshape(-1)[: int(np.prod(shape, dtype=np.int64))].reshape(shape)
    return replace(array, shape=shape, host=host)


def with_type(array: DeviceArray, dtype: type[np.generic]) -> DeviceArray:
    """Return the same memory as values of another type of the same size."""
    host = None if array.host is None else array.host.view(dtype)
    return replace(array, dtype=np.dtype(dtype), host=host)
