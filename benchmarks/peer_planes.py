"""Coefficients as planes that image codecs take, and how many bits each plane gets.

Planes are klt's own (the axes and the table of its file, the planes solved against them and not yet quantised), or the
raw maps. Each codec codes each plane with a few errors; what is chosen is where the squared error of all images and the
bytes have one exchange rate for all planes, none at all for a plane among the choices.
"""

from __future__ import annotations

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.peer_coders import SCALES, PlaneCoder
from benchmarks.peer_search import CODING, Point
from benchmarks.peer_stacks import FittedStack
from clrelight.codec.encoded import Encoded
from clrelight.codec.formats.klt_units import HEAD_SIZE, parse_body
from clrelight.codec.minimum_size import drop_padding
from clrelight.codec.transforms.metric import hemisphere_metric

THREADS = 2
_MEAN = 4
_TRIED = (-1, 0, 1, 2)
"""Errors to try, in half octaves beside what equal errors in the image would ask."""
_WIDER = 2
_ROWS = 64
_PIECE = 512
"""Side of the part of a larger plane that the errors are tried on."""


@dataclass(frozen=True)
class PlaneSet:
    """Planes that the images are linear in.

    Attributes
    ----------
    stack : FittedStack
    planes_jhw : ndarray, float32
        Or a view whose planes are copied one by one.
    relight_icj : ndarray, float32
        Makes images at all lights of planes.
    offset_ic : ndarray, float32
        What is added.
    fixed_bytes : int
        Of tables, without the rows of planes.
    row_bytes : float
        Of a plane's row in the table.
    has_means : bool
        Whether a plane that is left out keeps its mean.
    """

    stack: FittedStack
    planes_jhw: NDArray[np.float32]
    relight_icj: NDArray[np.float32]
    offset_ic: NDArray[np.float32]
    fixed_bytes: int
    row_bytes: float
    has_means: bool

    def score(self, decoded_jhw: NDArray[np.float32]) -> dict[str, float]:
        """Return the PSNR of images from decoded planes."""
        n_light, channel, count = self.relight_icj.shape
        operator = self.relight_icj.reshape(-1, count)

        def relit(rows: slice) -> NDArray[np.float32]:
            part_jhw = decoded_jhw[:, rows]
            images_ip = operator @ part_jhw.reshape(count, -1) + self.offset_ic.reshape(-1, 1)
            return np.moveaxis(images_ip.reshape(n_light, channel, *part_jhw.shape[1:]), 1, 3)

        return self.stack.score(relit, of_fit=True)


def principal_planes(stack: FittedStack, encoded: Encoded) -> PlaneSet:
    """Return the planes of a klt file before quantisation: by least squares against the axes that the file holds."""
    shape = stack.coeffs_khwc.shape
    n_coeff, height, width, channel = shape
    parsed = parse_body(drop_padding(encoded.body, shape), shape)
    forward_jk = hemisphere_metric(n_coeff, "damped").forward_jk
    # Errors of all channels cost alike: their rotation does not matter here.
    turned = np.einsum("jk,kcn->jcn", forward_jk, parsed.operator_kcj).reshape(-1, parsed.operator_kcj.shape[2])
    solve = np.linalg.pinv(turned[:, :-1])
    forward_nkc = np.einsum("njc,jk->nkc", solve.reshape(-1, len(forward_jk), channel), forward_jk)
    mean_n = solve @ turned[:, -1]
    planes_jhw = np.empty((len(solve), height, width), np.float32)
    matrix = forward_nkc.reshape(len(solve), -1).astype(np.float32)
    for top in range(0, height, _ROWS):
        part_khwc = stack.coeffs_khwc[:, top : top + _ROWS]
        part_qp = np.ascontiguousarray(part_khwc.transpose(0, 3, 1, 2)).reshape(matrix.shape[1], -1)
        part_jp = matrix @ part_qp - mean_n[:, None]
        planes_jhw[:, top : top + _ROWS] = part_jp.reshape(len(solve), -1, width)
    relight_icj = np.einsum("ik,kcj->icj", stack.basis_ik, parsed.operator_kcj).astype(np.float32)
    row_bytes = parsed.head.axes_bytes / (len(solve) + 1)
    fixed = HEAD_SIZE + math.ceil(row_bytes)
    return PlaneSet(stack, planes_jhw, relight_icj[..., :-1], relight_icj[..., -1], fixed, row_bytes, False)


def raw_planes(stack: FittedStack) -> PlaneSet:
    """Return the maps as they are."""
    n_coeff, height, width, channel = stack.coeffs_khwc.shape
    planes_jhw = np.ascontiguousarray(stack.coeffs_khwc.transpose(0, 3, 1, 2)).reshape(-1, height, width)
    relight_icj = np.einsum("ik,cd->icdk", stack.basis_ik, np.eye(channel))
    relight_icj = relight_icj.transpose(0, 1, 3, 2).reshape(-1, channel, n_coeff * channel).astype(np.float32)
    offset_ic = np.zeros(relight_icj.shape[:2], np.float32)
    return PlaneSet(stack, planes_jhw, relight_icj, offset_ic, 16, 0.0, True)


class PlanePeer:
    """A codec on a set of planes.

    Parameters
    ----------
    coder : PlaneCoder
    planes : PlaneSet
    """

    def __init__(self, coder: PlaneCoder, planes: PlaneSet) -> None:
        self._coder, self._set = coder, planes
        count, height, width = planes.planes_jhw.shape
        rows, columns = (
            slice(max(side - _PIECE, 0) // 2, max(side - _PIECE, 0) // 2 + _PIECE) for side in (height, width)
        )
        self._tried_jhw = planes.planes_jhw[:, rows, columns]
        self._area = height * width / math.prod(self._tried_jhw.shape[1:])
        self._weight_j = np.square(planes.relight_icj, dtype=np.float64).mean(axis=(0, 1))
        rest_jhw = self._tried_jhw
        mean_j = rest_jhw.mean(axis=(1, 2), dtype=np.float64) if planes.has_means else np.zeros(count)
        self._variance_j = np.array(
            [np.square(p - m, dtype=np.float64).mean() for p, m in zip(rest_jhw, mean_j, strict=True)]
        )
        self._left_out = 10.0 ** (-planes.score(planes.planes_jhw)[CODING] / 10.0)
        self._options: dict[tuple[int, int], tuple[float, float]] = {}

    def evaluate(self, psnr: float) -> Point:
        """Return the point of the choice that should have this PSNR of coding."""
        aim = max(10.0 ** (-psnr / 10.0) - self._left_out, 0.02 * 10.0 ** (-psnr / 10.0))
        chosen = self._choose(aim)
        planes, coder = self._set, self._coder
        exact = {j: np.ascontiguousarray(planes.planes_jhw[j]) for j in chosen}
        with ThreadPoolExecutor(THREADS) as pool:
            since = time.perf_counter()
            streams = dict(
                zip(chosen, pool.map(lambda j: coder.encode(exact[j], _error(chosen[j])), chosen), strict=True)
            )
            encoded = time.perf_counter()
            decoded = dict(zip(chosen, pool.map(lambda j: coder.decode(*streams[j]), chosen), strict=True))
            ended = time.perf_counter()
        decoded_jhw = np.zeros(planes.planes_jhw.shape, np.float32)
        for j, plane_hw in enumerate(decoded_jhw):
            plane_hw[:] = decoded[j] if j in decoded else planes.planes_jhw[j].mean() if planes.has_means else 0.0
        size = planes.fixed_bytes + (_MEAN * (len(decoded_jhw) - len(chosen)) if planes.has_means else 0)
        size += sum(coder.count(stream) for stream, _ in streams.values()) + SCALES * len(chosen)
        size += max((coder.shared(stream) for stream, _ in streams.values()), default=0)
        size += math.ceil(planes.row_bytes * len(chosen))
        setting = f"{len(chosen)} of {len(decoded_jhw)} planes"
        return Point(size, planes.score(decoded_jhw), encoded - since, ended - encoded, setting)

    def _choose(self, aim: float) -> dict[int, int]:
        """Return which planes are coded, and with what error, at a mean squared error of the images."""
        usual_j = self._equal_errors(aim)
        tried = {j: {usual_j[j] + step for step in _TRIED} for j in range(len(usual_j))}
        chosen: dict[int, int] = {}
        for _ in range(3):
            self._try([(j, m) for j, errors in tried.items() for m in errors])
            chosen = self._exchange(aim, tried)
            wider = {j: m for j, m in chosen.items() if m in (min(tried[j]), max(tried[j]))}
            if not wider:
                break
            for j, m in wider.items():
                tried[j] |= {m + step for step in range(-_WIDER, _WIDER + 1)}
        return chosen

    def _equal_errors(self, aim: float) -> NDArray[np.intp]:
        """Return the half octave of each plane's error where all cost the images the same, or the plane's energy."""
        cost_j = self._weight_j * self._variance_j
        low, high = -400.0, math.log2(max(cost_j.max(), 1e-100))
        for _ in range(60):
            middle = (low + high) / 2.0
            low, high = (middle, high) if np.minimum(cost_j, 2.0**middle).sum() < aim else (low, middle)
        return np.rint(high - np.log2(np.maximum(self._weight_j, 1e-100))).astype(np.intp)

    def _try(self, pairs: list[tuple[int, int]]) -> None:
        """Find bytes and mean squared errors of planes at errors."""
        new = [pair for pair in pairs if pair not in self._options]

        def code(pair: tuple[int, int]) -> tuple[float, float]:
            plane_hw = np.ascontiguousarray(self._tried_jhw[pair[0]])
            stream, scales = self._coder.encode(plane_hw, _error(pair[1]))
            back_hw = self._coder.decode(stream, scales)
            return self._coder.count(stream) * self._area, float(np.square(back_hw - plane_hw, dtype=np.float64).mean())

        with ThreadPoolExecutor(THREADS) as pool:
            self._options.update(zip(new, pool.map(code, new), strict=True))

    def _exchange(self, aim: float, tried: dict[int, set[int]]) -> dict[int, int]:
        """Return the errors at one exchange rate of bytes and error; a plane that is not worth its bytes is absent."""
        most = 1 + max(len(errors) for errors in tried.values())
        size, error = np.full((2, len(tried), most), np.inf)
        errors_jo = [sorted(tried[j]) for j in range(len(tried))]
        size[:, 0] = _MEAN if self._set.has_means else 0.0
        error[:, 0] = self._variance_j * self._weight_j
        for j, errors in enumerate(errors_jo):
            for o, m in enumerate(errors, 1):
                size[j, o], error[j, o] = self._options[j, m]
                size[j, o] += SCALES + self._set.row_bytes
                error[j, o] *= self._weight_j[j]
        low, high = -120.0, 40.0
        every = np.arange(len(tried))
        for _ in range(60):
            middle = (low + high) / 2.0
            picked = (error + 2.0**middle * size).argmin(axis=1)
            low, high = (middle, high) if error[every, picked].sum() <= aim else (low, middle)
        picked = (error + 2.0**low * size).argmin(axis=1)
        return {j: errors_jo[j][o - 1] for j, o in enumerate(picked) if o}


def _error(half_octaves: int) -> float:
    return float(2.0 ** (half_octaves / 2.0))
