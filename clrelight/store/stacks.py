"""``stack/1``: images under many lights."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from clrelight.dataset import LightStack
from clrelight.store.foreign import stack_of_others
from clrelight.store.opening import Opened, opening, refusing
from clrelight.store.schemas import STACK
from clrelight.store.surfaces import surface_bytes, surface_of, write_surface
from clrelight.store.writing import Sink, chunk_shape, drafting, padded_bytes


@contextmanager
def create_stack(path: str | os.PathLike, stack: LightStack, *, chunk_lights: int | None = None) -> Iterator[Sink]:
    """Write a stack piece by piece: lend its images, to be filled by slices ``[i0:i1, r0:r1]``.

    The file stands at `path` once the block has ended well; until then an old one stays as it is.

    Parameters
    ----------
    path : path
        Where the file is to stand.
    stack : LightStack
        What the file is to hold. Of its images shape and type count, which what is filled in must have.
    chunk_lights : int, optional
        Lights that are stored together; all of them without, which reads tiles of rows fastest. A stack too large
        for memory is written fastest when this many lights come at a time.

    Raises
    ------
    InputError
        If the file cannot be written.
    """
    shape, dtype = tuple(stack.images_ihwc.shape), stack.images_ihwc.dtype
    chunks = chunk_shape(shape, dtype.itemsize, chunk_lights)
    n_bytes = padded_bytes(shape, chunks, dtype.itemsize) + surface_bytes(stack.surface)
    with drafting(path, STACK, n_bytes) as draft:
        draft.attributes({"peak": float(stack.peak), "transfer": stack.transfer, "name": stack.name})
        draft.dataset("directions", stack.directions_i3, ("light", "xyz"))
        if stack.weights_i is not None:
            draft.dataset("weights", stack.weights_i, ("light",))
        if stack.mask_hw is not None:
            draft.dataset("mask", stack.mask_hw.astype(np.uint8), ("height", "width"))
        write_surface(draft, stack.surface)
        yield draft.sink("images", shape, dtype, ("light", "height", "width", "channel"), chunks)


def write_stack(path: str | os.PathLike, stack: LightStack) -> None:
    """Write a stack; InputError if the file cannot be written."""
    images = stack.images_ihwc
    with create_stack(path, stack) as sink:
        rows = sink.chunks[1]
        for r0 in range(0, images.shape[1], rows):
            sink[:, r0 : r0 + rows] = np.asarray(images[:, r0 : r0 + rows])


@contextmanager
def open_stack(path: str | os.PathLike) -> Iterator[LightStack]:
    """Open a stack; its images are a `StoredArray`, read as they are indexed; errors as of `open_fit`."""
    with opening(path, "stack") as opened:
        with refusing(opened.path):
            stack = stack_of(opened)
        yield stack


def read_stack(path: str | os.PathLike) -> LightStack:
    """Read a whole stack into memory; errors as of `open_fit`."""
    with open_stack(path) as stack:
        return replace(stack, images_ihwc=stack.images_ihwc[...])


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
        surface=surface_of(opened),
    )
