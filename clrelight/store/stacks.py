"""``stack/1``: images under many lights."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import SAMPLE_DTYPES, LightStack
from clrelight.errors import InputError
from clrelight.store.foreign import stack_of_others
from clrelight.store.opening import Opened, opening, refusing
from clrelight.store.schemas import STACK
from clrelight.store.writing import Sink, chunk_shape, drafting, padded_bytes


@contextmanager
def create_stack(
    path: str | os.PathLike,
    *,
    shape_ihwc: tuple[int, int, int, int],
    dtype: Any,
    directions_i3: NDArray[np.float64],
    peak: float,
    transfer: str,
    weights_i: NDArray[np.float64] | None = None,
    mask_hw: NDArray[np.bool_] | None = None,
    name: str = "stack",
    chunk_lights: int | None = None,
) -> Iterator[Sink]:
    """Write a stack piece by piece: lend its images, to be filled by slices ``[i0:i1, r0:r1]``.

    The file stands at `path` once the block has ended well; until then an old one stays as it is.

    Parameters
    ----------
    path : path
        Where the file is to stand.
    shape_ihwc : tuple of int
        (n_light, height, width, channel).
    dtype : dtype
        One of `dataset.SAMPLE_DTYPES`; what is filled in must have it.
    directions_i3, peak, transfer, weights_i, mask_hw, name
        As of `LightStack`.
    chunk_lights : int, optional
        Lights that are stored together; all of them without, which reads tiles of rows fastest. A stack too large
        for memory is written fastest when this many lights come at a time.

    Raises
    ------
    InputError
        If the arguments make no stack, or the file cannot be written.
    """
    dtype = np.dtype(dtype)
    if dtype not in SAMPLE_DTYPES:
        raise InputError(f"images must be {', '.join(SAMPLE_DTYPES)}, got {dtype}")
    blank = np.broadcast_to(np.zeros((), dtype), shape_ihwc)  # takes no memory, carries shape and type to the checks
    stack = LightStack(blank, directions_i3, peak, transfer, weights_i, mask_hw, name)
    chunks = chunk_shape(shape_ihwc, dtype.itemsize, chunk_lights)
    with drafting(path, STACK, padded_bytes(shape_ihwc, chunks, dtype.itemsize)) as draft:
        draft.attributes({"peak": float(peak), "transfer": transfer, "name": name})
        draft.dataset("directions", stack.directions_i3, ("light", "xyz"))
        if weights_i is not None:
            draft.dataset("weights", weights_i.astype(np.float64), ("light",))
        if mask_hw is not None:
            draft.dataset("mask", mask_hw.astype(np.uint8), ("height", "width"))
        yield draft.sink("images", shape_ihwc, dtype, ("light", "height", "width", "channel"), chunks)


def write_stack(path: str | os.PathLike, stack: LightStack) -> None:
    """Write a stack; InputError if the file cannot be written."""
    images = stack.images_ihwc
    with create_stack(
        path,
        shape_ihwc=tuple(images.shape),
        dtype=images.dtype,
        directions_i3=stack.directions_i3,
        peak=stack.peak,
        transfer=stack.transfer,
        weights_i=stack.weights_i,
        mask_hw=stack.mask_hw,
        name=stack.name,
    ) as sink:
        rows = sink.chunks[1]
        for r0 in range(0, images.shape[1], rows):
            sink[:, r0 : r0 + rows] = np.asarray(images[:, r0 : r0 + rows])


@contextmanager
def open_stack(path: str | os.PathLike) -> Iterator[LightStack]:
    """Open a stack; its images are a `StoredArray`, read as they are indexed.

    Raises
    ------
    InputError
        If there is no such file.
    StoreFormatError
        If it holds no sound stack.
    """
    with opening(path, "stack") as opened:
        with refusing(opened.path):
            stack = stack_of(opened)
        yield stack


def stack_of(opened: Opened) -> LightStack:
    """Return the stack in an open file; StoreFormatError or InputError if it is not sound."""
    if not opened.sealed:
        return stack_of_others(opened)
    attributes = opened.attributes()
    mask = opened.optional("mask")
    return LightStack(
        opened.arrays["images"],
        opened.arrays["directions"][...],
        attributes["peak"],
        attributes["transfer"],
        opened.optional("weights"),
        None if mask is None else mask.astype(np.bool_),
        attributes["name"],
    )
