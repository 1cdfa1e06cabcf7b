"""Fill a stack from its photographs, several decoded at once, within a memory budget."""

from __future__ import annotations

import math
import os
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.images import BAND_BYTES
from clrelight.ingest.photographs import Photographs

if TYPE_CHECKING:
    from clrelight.store.scratch_images import ScratchImages


@dataclass(frozen=True)
class Plan:
    """How the memory budget is spent: `workers` bands of `band_bytes` at once, and `n_held` whole images.

    With ``n_held = 0`` not even one image fits, and bands go to the file one by one.
    """

    workers: int
    band_bytes: int
    n_held: int


def plan_memory(source: Photographs, memory_bytes: int) -> Plan:
    """Return how to decode within a number of bytes; InputError where one row of an image takes more."""
    header, values = source.headers[0], source.values
    n_image, *image_shape = source.shape_ihwc
    # A band exists as read, where it is divided as float32, and as it is written; and the one before it is
    # still alive while it is decoded.
    sizes = (header.dtype.itemsize, 4 if values.factors_ic is not None else 0, values.dtype.itemsize)
    growth = 2 * sum(sizes) / header.dtype.itemsize
    # Tiles may differ from file to file.
    row_step = max(h.row_step for h in source.headers)
    smallest = header.row_bytes * row_step
    bands_budget = memory_bytes / 4 / growth
    workers = int(max(1, min(os.cpu_count() or 1, n_image, bands_budget // smallest)))
    band_bytes = int(max(smallest, min(BAND_BYTES, bands_budget / workers)))
    n_fitting = int((memory_bytes - workers * band_bytes * growth) // (math.prod(image_shape) * values.dtype.itemsize))
    if n_fitting >= 1:
        n_block = math.ceil(n_image / n_fitting)
        # Blocks of nearly equal size: a small last one would waste room in its chunks.
        return Plan(workers, band_bytes, math.ceil(n_image / n_block))
    if smallest * growth > memory_bytes:
        raise InputError(
            f"memory of {memory_bytes} bytes cannot hold {counted(row_step, 'row')} of {header.path}; "
            f"expected at least {math.ceil(smallest * growth)}"
        )
    return Plan(1, int(memory_bytes / growth), 0)


def fill_stack(images_ihwc: Any, source: Photographs, plan: Plan) -> Generator[int, None, None]:
    """Write all images, whole chunks at a time where possible; yield how many are decoded after each."""
    chunk_lights, chunk_rows = images_ihwc.chunks[:2]
    if plan.n_held == 0:
        row_bytes = source.headers[0].row_bytes
        band_bytes = _multiple(plan.band_bytes // row_bytes, chunk_rows) * row_bytes
        for light in range(len(source.headers)):
            for row, band_hwc in source.bands(light, band_bytes):
                written = np.ascontiguousarray(band_hwc, dtype=source.values.dtype)
                images_ihwc[light : light + 1, row : row + len(written)] = written[None]
            yield light + 1
        return
    n_light, *image_shape = source.shape_ihwc
    n_held = plan.n_held if plan.n_held == n_light else _multiple(plan.n_held, chunk_lights)
    block_ihwc = np.empty((n_held, *image_shape), source.values.dtype)
    with ThreadPoolExecutor(plan.workers) as pool:
        for start in range(0, n_light, n_held):
            stop = min(start + n_held, n_light)
            tasks = [
                pool.submit(_decode_into, block_ihwc[i - start], source, i, plan.band_bytes) for i in range(start, stop)
            ]
            with _cancelling(tasks):
                for done, task in enumerate(tasks, start=start + 1):
                    task.result()
                    yield done
            images_ihwc[start:stop, 0 : image_shape[0]] = block_ihwc[: stop - start]


def fill_scratch(images_ihwc: ScratchImages, source: Photographs, plan: Plan) -> Generator[int, None, None]:
    """Write all images, each by the thread that decodes it; yield how many are done after each."""

    def copy(light: int) -> None:
        for row, band_hwc in source.bands(light, plan.band_bytes):
            images_ihwc.write_rows(light, row, np.asarray(band_hwc, dtype=source.values.dtype))

    with ThreadPoolExecutor(plan.workers) as pool:
        tasks = [pool.submit(copy, light) for light in range(len(source.headers))]
        with _cancelling(tasks):
            for done, task in enumerate(tasks, start=1):
                task.result()
                yield done


@contextmanager
def _cancelling(tasks: Sequence[Future[None]]) -> Iterator[None]:
    """Leave no task to be begun when the block ends, however it does."""
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()


def _multiple(count: int, of: int) -> int:
    """Return the largest multiple that is not over `count`, or `count` where there is none."""
    return count - count % of if count > of else count


def _decode_into(target_hwc: NDArray, source: Photographs, light: int, band_bytes: int) -> None:
    for row, band_hwc in source.bands(light, band_bytes):
        target_hwc[row : row + len(band_hwc)] = band_hwc
