"""Normals of a whole stack: rows go through in tiles, and blocks of their pixels through a device."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.streaming import Buffer, reading_ahead
from clrelight.threads import on_one_thread
from clrelight.variation.kernel import LANES, NormalSolver
from clrelight.variation.normals import METHODS, PixelNormals, find_normals, light_condition, shadow_floor

_BLOCK = 1 << 14
"""Pixels that go to the device together: enough to make a launch worth while."""
_WORK = 3
"""Arrays of float32 as large as a block's samples that are alive at once: one being made, one on the device."""
_PROBE_ROWS, _PROBE_PIXELS = 16, 1 << 13


@dataclass(frozen=True)
class NormalMap:
    """Normals, albedo and confidence of every pixel.

    Attributes
    ----------
    normals_hw3 : ndarray, shape (height, width, 3), float32
        Unit vectors, x right, y up, z towards the camera; 0 outside the mask, and where nothing is seen.
    albedo_hwc : ndarray, shape (height, width, channel), float32
        Linear radiance under a light along the normal, in units of the peak.
    confidence_hw : ndarray, shape (height, width), float32
        From 0 to 1: see `clrelight.variation.normals.PixelNormals`.
    condition : float
        Of the lights' directions.
    floor : float
        What shadows hold of light from elsewhere, as a share of the albedo.
    """

    normals_hw3: NDArray[np.float32]
    albedo_hwc: NDArray[np.float32]
    confidence_hw: NDArray[np.float32]
    condition: float
    floor: float


def map_normals(
    stack: LightStack,
    method: str = "robust",
    *,
    device: Device | None = None,
    memory_bytes: int = DEFAULT_MEMORY,
    progress: Callable[[int, int], None] | None = None,
    add_time: Callable[[str, float], float] | None = None,
) -> NormalMap:
    """Return the normals of a stack, whose rows are read tile by tile, the next tile while one is computed.

    Parameters
    ----------
    stack : LightStack
        Lights of equal intensity.
    method : str
        ``"robust"`` or ``"least-squares"``.
    device : Device, optional
        Where the robust method is computed; without one, in NumPy, which takes four times as long.
    memory_bytes : int
        Bytes that samples may take, and what is made of them on the way.
    progress : callable, optional
        Told rows done, and of how many.
    add_time : callable, optional
        Told a stage and when it began, returns now.

    Raises
    ------
    InputError
        If the method is unknown, the lights do not determine normals, a row does not fit the budget, or samples are
        negative or not finite.
    """
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    condition = light_condition(stack.directions_i3)
    height, width, channel = stack.image_shape
    tally = add_time or (lambda _, since: time.perf_counter())
    step, block = _plan(stack, memory_bytes)
    tiles = [(first, min(first + step, height)) for first in range(0, height, step)]
    buffers = itertools.cycle([Buffer() for _ in tiles[:2]])

    def read(rows: tuple[int, int]) -> NDArray:
        shape = (stack.n_light, rows[1] - rows[0], width, channel)
        return stack.read_rows(*rows, next(buffers).lend(shape, stack.images_ihwc.dtype))

    curve = SampleReader(stack)
    found = NormalMap(
        np.zeros((height, width, 3), np.float32),
        np.zeros((height, width, channel), np.float32),
        np.zeros((height, width), np.float32),
        condition,
        0.0 if method == "least-squares" else _probe_floor(stack, curve),
    )
    solve = _Blocks(stack, curve, method, found, block, device)
    since = time.perf_counter()
    with on_one_thread(), reading_ahead(read, tiles) as samples:
        for (first, end), tile_ihwc in zip(tiles, samples, strict=True):
            since = tally("read", since)
            solve.fill(first, end, tile_ihwc)
            since = tally("solve", since)
            if progress is not None:
                progress(end, height)
    return found


def _plan(stack: LightStack, memory_bytes: int) -> tuple[int, int]:
    """Return rows of a tile and pixels of a block within the budget."""
    height, width, channel = stack.image_shape
    pixel = stack.n_light * channel * stack.images_ihwc.dtype.itemsize
    work = 4 * stack.n_light * channel * _WORK
    block = max(64, min(_BLOCK, memory_bytes // 4 // work // LANES * LANES))
    rows = (memory_bytes - work * block) // (2 * width * pixel)
    if rows < 1:
        needed = 2 * width * pixel + work * block
        raise InputError(f"one row of this stack takes {needed} bytes, more than the memory budget {memory_bytes}")
    chunks = getattr(stack.images_ihwc, "chunks", None)
    if chunks and chunks[1] <= rows:
        rows -= rows % chunks[1]
    return int(min(rows, height)), block


class SampleReader:
    """What turns a stack's code values into linear radiance in units of its peak."""

    def __init__(self, stack: LightStack) -> None:
        dtype = np.dtype(stack.images_ihwc.dtype)
        self._peak, self._is_srgb = stack.peak, stack.transfer == "srgb"
        self._is_integer = dtype.kind == "u"
        codes = np.arange(np.iinfo(dtype).max + 1) if self._is_integer else np.zeros(1)
        self._table = self._decode(codes)
        self._most = min(np.iinfo(dtype).max, stack.peak) if self._is_integer else np.inf

    def _decode(self, values: NDArray) -> NDArray[np.float32]:
        radiance = values / np.float64(self._peak)
        return (srgb_to_linear(radiance) if self._is_srgb else radiance).astype(np.float32)

    @property
    def most(self) -> float:
        """Radiance from which on samples are at the end of an integer type's range; inf of floats."""
        if not self._is_integer:
            return np.inf
        # Half a code below the last, whatever way radiance is rounded.
        return float(self._decode(np.array([self._most - 0.5]))[0])

    def linear(self, codes_ipc: NDArray) -> NDArray[np.float32]:
        """Return radiance, (channel, n_light, P)."""
        codes_cip = np.ascontiguousarray(codes_ipc.transpose(2, 0, 1))
        if not self._is_integer:
            return self._decode(codes_cip)
        if self._is_srgb:
            return np.take(self._table, codes_cip)
        return np.multiply(codes_cip, np.float32(1.0 / self._peak), dtype=np.float32)


def _probe_floor(stack: LightStack, curve: SampleReader) -> float:
    """Return what shadows hold, from some rows of the stack."""
    height, width, _ = stack.image_shape
    rows = np.unique(np.linspace(0, height - 1, min(height, _PROBE_ROWS)).round().astype(int))
    stride = -(-len(rows) * width // _PROBE_PIXELS)
    kept = []
    for row in rows.tolist():
        row_ipc = stack.read_rows(row, row + 1)[:, 0]
        if stack.mask_hw is not None:
            row_ipc = row_ipc[:, stack.mask_hw[row]]
        kept.append(row_ipc[:, ::stride])
    samples_cip = curve.linear(np.concatenate(kept, axis=1))
    with on_one_thread():
        return shadow_floor(*_in_range(samples_cip)[:1], stack.directions_i3) if samples_cip.size else 0.0


def _in_range(samples_cip: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """Return samples by a power of two nearer to 1 where their squares would leave float32, and its exponent."""
    exponent = int(np.frexp(samples_cip.max(initial=0.0))[1])
    if abs(exponent) < 24:
        return samples_cip, 0
    return np.ldexp(samples_cip, -exponent), exponent


@dataclass(frozen=True)
class _Blocks:
    """Fills maps from tiles of samples, block by block; the next block is decoded while one is solved."""

    stack: LightStack
    reader: SampleReader
    method: str
    found: NormalMap
    block: int
    device: Device | None

    def fill(self, first: int, end: int, tile_ihwc: NDArray) -> None:
        """Fill rows first..end; pixels outside the mask stay 0."""
        n_light, _, _, channel = tile_ihwc.shape
        columns_ipc = tile_ihwc.reshape(n_light, -1, channel)
        inside_p = None if self.stack.mask_hw is None else np.flatnonzero(self.stack.mask_hw[first:end])
        count = columns_ipc.shape[1] if inside_p is None else len(inside_p)
        pixels = [
            slice(start, min(start + self.block, count)) if inside_p is None else inside_p[start : start + self.block]
            for start in range(0, count, self.block)
        ]
        normals_p3, albedo_pc, confidence_p = (
            each[first:end].reshape(-1, *each.shape[2:])
            for each in (self.found.normals_hw3, self.found.albedo_hwc, self.found.confidence_hw)
        )

        def decode(which: slice | NDArray[np.intp]) -> NDArray[np.float32]:
            return self.reader.linear(columns_ipc[:, which])

        with reading_ahead(decode, pixels) as samples:
            for which, samples_cip in zip(pixels, samples, strict=True):
                solved = self._solve(samples_cip)
                size = samples_cip.shape[2]
                normals_p3[which], albedo_pc[which] = solved.normals_p3[:size], solved.albedo_pc[:size]
                confidence_p[which] = solved.confidence_p[:size]

    def _solve(self, samples_cip: NDArray[np.float32]) -> PixelNormals:
        samples_cip, exponent = _in_range(samples_cip)
        directions_i3, floor = self.stack.directions_i3, self.found.floor
        most = float(np.ldexp(self.reader.most, -exponent))
        if self.device is None or self.method != "robust":
            clipped_ip: NDArray[np.bool_] = np.any(samples_cip >= most, axis=0)
            solved = find_normals(samples_cip, directions_i3, self.method, clipped_ip, floor)
        else:
            padding = -samples_cip.shape[2] % LANES
            if padding:
                samples_cip = np.pad(samples_cip, ((0, 0), (0, 0), (0, padding)))
            solved = NormalSolver(self.device, directions_i3, floor)(samples_cip, most)
        if not exponent:
            return solved
        return PixelNormals(solved.normals_p3, np.ldexp(solved.albedo_pc, exponent), solved.confidence_p)
