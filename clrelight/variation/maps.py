"""Normals of a whole stack: rows go through in tiles, and blocks of their pixels through a device."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.passes import rows_within, stack_rows
from clrelight.streaming import Buffer, reading_ahead
from clrelight.threads import on_one_thread
from clrelight.tiles import chunk_rows
from clrelight.variation.heights import integrate_normals
from clrelight.variation.normals import METHODS, light_condition
from clrelight.variation.reflectance_kernel import LANES
from clrelight.variation.samples import SampleReader
from clrelight.variation.solvers import BlockSolver
from clrelight.variation.wanted import Found, Wanted, settle

_BLOCK = 1 << 14
"""Pixels that go to the device together: enough to make a launch worth while."""
_WORK = 3
"""Arrays of float32 as large as a block's samples that are alive at once: one being made, one on the device."""
MOST_ROBUST = 300e6
"""Samples of one channel up to which the robust method is what ``auto`` takes: 6 megapixels of 50 lights."""
_ROUNDS, _SETTLED = 6, 0.02
"""Rounds of normals and heights under near lights, and the mean turn in degrees at which they end."""

__all__ = ["MOST_ROBUST", "NormalMap", "SampleReader", "Wanted", "map_normals"]


@dataclass(frozen=True)
class NormalMap:
    """Normals, albedo and confidence of every pixel.

    Attributes
    ----------
    normals_hw3 : ndarray, shape (height, width, 3), float32
        Unit vectors, x right, y up, z towards the camera; 0 outside the mask, and where nothing is seen.
    albedo_hwc : ndarray, shape (height, width, channel), float32
        Linear radiance under a light along the normal, in units of the peak; of the robust method without gloss.
    confidence_hw : ndarray, shape (height, width), float32
        From 0 to 1: see `clrelight.variation.normals.PixelNormals`.
    condition : float
        Of the lights' directions.
    floor : float
        What shadows hold of light from elsewhere, as a share of the albedo.
    method : str
        What was done: ``"robust"``, ``"quick"`` or ``"least-squares"``.
    found : Found
        What was told from the samples on the way.
    """

    normals_hw3: NDArray[np.float32]
    albedo_hwc: NDArray[np.float32]
    confidence_hw: NDArray[np.float32]
    condition: float
    floor: float
    method: str
    found: Found


def map_normals(
    stack: LightStack,
    method: str = "auto",
    wanted: Wanted | None = None,
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
        Lights of equal intensity, unless their gains are wanted or given.
    method : str
        ``"robust"``: each pixel's matte and glossy reflectance with its normal. ``"quick"``: gloss left out.
        ``"least-squares"``: all samples as they are. ``"auto"``: robust, or quick of stacks beyond `MOST_ROBUST`.
    wanted : Wanted, optional
        The transfer curve, near lights, gains and the camera.
    device : Device, optional
        Where normals are computed; without one, in NumPy, which takes several times as long.
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
    asked = wanted or Wanted()
    directions_i3 = stack.directions_i3 if asked.near is None else asked.near.directions_i3
    condition = light_condition(directions_i3)
    if method == "quick" and asked.near is not None:
        raise InputError("the quick method takes lights as distant: with positions, use robust or least-squares")
    height, width, channel = stack.image_shape
    if method == "auto":
        is_large = stack.n_light * height * width > MOST_ROBUST and asked.near is None
        method = "quick" if is_large else "robust"
    step, block = _plan(stack, memory_bytes)
    tally = add_time or (lambda _, since: time.perf_counter())
    result = NormalMap(
        np.zeros((height, width, 3), np.float32),
        np.zeros((height, width, channel), np.float32),
        np.zeros((height, width), np.float32),
        condition,
        0.0,
        method,
        Found(stack.transfer, 0.0),
    )
    heights_hw = np.zeros((height, width), np.float32)
    rounds = 1 if asked.near is None else _ROUNDS
    for turn in range(rounds):
        told = None if progress is None else _share(progress, turn, rounds)
        since = time.perf_counter()
        with on_one_thread():
            found = settle(stack, method, asked, device, heights_hw)
        tally("choose", since)
        solver = BlockSolver(stack, directions_i3, asked.near, heights_hw, method, found, device)
        before_hw3 = result.normals_hw3.copy() if rounds > 1 else result.normals_hw3
        _pass(stack, _Filler(stack, result, solver, block), step, told, tally)
        if turn + 1 == rounds or (turn and _mean_turn(before_hw3, result.normals_hw3) < _SETTLED):
            break
        since = time.perf_counter()
        if result.normals_hw3.any():
            heights_hw = integrate_normals(result.normals_hw3, stack.mask_hw)
        tally("integrate", since)
    return replace(result, floor=found.floor, found=replace(found, rounds=turn + 1))


def _share(progress: Callable[[int, int], None], turn: int, rounds: int) -> Callable[[int, int], None]:
    return lambda done, height: progress(turn * height + done, rounds * height)


def _mean_turn(before_hw3: NDArray[np.float32], after_hw3: NDArray[np.float32]) -> float:
    seen_hw = after_hw3.any(axis=2)
    if not seen_hw.any():
        return 0.0
    apart_p = np.linalg.norm(after_hw3[seen_hw] - before_hw3[seen_hw], axis=1)
    return float(np.degrees(2.0 * np.arcsin(np.minimum(apart_p / 2.0, 1.0))).mean())


def _pass(
    stack: LightStack,
    filler: _Filler,
    step: int,
    progress: Callable[[int, int], None] | None,
    tally: Callable[[str, float], float],
) -> None:
    """Send all rows through once."""
    height = stack.image_shape[0]
    since = time.perf_counter()
    with on_one_thread(), stack_rows(stack, step) as tiles:
        for first, end, tile_ihwc in tiles:
            since = tally("read", since)
            filler.fill(first, end, tile_ihwc)
            since = tally("solve", since)
            if progress is not None:
                progress(end, height)


def _plan(stack: LightStack, memory_bytes: int) -> tuple[int, int]:
    """Return rows of a tile and pixels of a block within the budget."""
    height, width, channel = stack.image_shape
    pixel = stack.n_light * channel * stack.images_ihwc.dtype.itemsize
    work = 4 * stack.n_light * channel * _WORK
    block = max(64, min(_BLOCK, memory_bytes // 4 // work // LANES * LANES))
    rows = (memory_bytes - work * block) // (2 * width * pixel)
    if rows < 1:
        rows_within(2 * width * pixel + work * block, memory_bytes)
    together = chunk_rows(stack.images_ihwc)
    if together <= rows:
        rows -= rows % together
    return int(min(rows, height)), block


@dataclass(frozen=True)
class _Filler:
    """Fills maps from tiles of samples, block by block; the next block is decoded while one is solved."""

    stack: LightStack
    result: NormalMap
    solver: BlockSolver
    block: int
    buffers: Iterator[Buffer] = field(default_factory=lambda: itertools.cycle([Buffer(), Buffer()]))

    def fill(self, first: int, end: int, tile_ihwc: NDArray) -> None:
        """Fill rows first..end; pixels outside the mask stay 0."""
        n_light, _, width, channel = tile_ihwc.shape
        columns_ipc = tile_ihwc.reshape(n_light, -1, channel)
        inside_p = None if self.stack.mask_hw is None else np.flatnonzero(self.stack.mask_hw[first:end])
        count = columns_ipc.shape[1] if inside_p is None else len(inside_p)
        pixels = [
            slice(start, min(start + self.block, count)) if inside_p is None else inside_p[start : start + self.block]
            for start in range(0, count, self.block)
        ]
        normals_p3, albedo_pc, confidence_p = (
            each[first:end].reshape(-1, *each.shape[2:])
            for each in (self.result.normals_hw3, self.result.albedo_hwc, self.result.confidence_hw)
        )

        def decode(which: slice | NDArray[np.intp]) -> NDArray[np.float32]:
            codes_ipc = columns_ipc[:, which]
            shape = (channel, n_light, codes_ipc.shape[1])
            return self.solver.reader.linear(codes_ipc, next(self.buffers).lend(shape, np.dtype(np.float32)))

        with reading_ahead(decode, pixels) as samples:
            for which, samples_cip in zip(pixels, samples, strict=True):
                size = samples_cip.shape[2]
                solved = self.solver(samples_cip, which, first * width)
                normals_p3[which], albedo_pc[which] = solved.normals_p3[:size], solved.albedo_pc[:size]
                confidence_p[which] = solved.confidence_p[:size]
