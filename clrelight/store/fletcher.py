"""Fletcher's checksum of chunks, as HDF5's filter ``fletcher32`` takes it, on a CPU device: ten times as fast."""

from __future__ import annotations

import functools
import threading
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import DeviceError

if TYPE_CHECKING:
    from clrelight.device import Device

SUM_DTYPE = np.dtype("<u4")
"""How HDF5 writes a sum behind its chunk."""

LEAST_BUFFER = 128 << 20
"""Bytes of an array that every device takes; and a quarter of its memory where that is more (OpenCL 1.2, table 4.3)."""

_lock = threading.Lock()


@functools.cache
def _device() -> Device | None:
    """Return the device that takes sums, for who holds `_lock`; None where there is none."""
    from clrelight.device import make_device

    try:
        return make_device("cpu", style="cpu")
    except DeviceError:
        return None


def takes_sums(n_bytes: int) -> bool:
    """Return whether an array of so many bytes can be summed here; else HDF5 must do it."""
    with _lock:
        device = _device()
        return device is not None and 0 < n_bytes <= max(LEAST_BUFFER, device.info.memory_bytes // 4)


def add_pieces(
    rows_mx: NDArray[np.uint8],
    image_n: NDArray[np.intp],
    place_n: NDArray[np.intp],
    *,
    chunks: int,
    piece: int,
    pieces: int,
    skipped: int = 0,
) -> NDArray[np.uint64]:
    """Return what pieces of chunks that lie in rows of images add to the chunks' sums.

    Parameters
    ----------
    rows_mx : ndarray, shape (images, bytes of each), uint8
        C-contiguous; used in place.
    image_n, place_n : ndarray, shape (n,), int
        Which images to take, and which piece of a chunk each of them holds.
    chunks : int
        Number of chunks: bytes ``skipped + b * piece`` and on of an image belong to chunk b.
    piece, pieces : int
        Bytes of a piece, and pieces of a chunk.
    skipped : int
        Bytes of each image before its first piece.

    Returns
    -------
    ndarray, shape (chunks, 2), uint64
        To be added to those of the chunks' other pieces, for `checksums`.
    """
    with _lock:
        device = _device()
        if device is None:
            raise DeviceError("there is no CPU device to take sums: ask takes_sums first")
        sums_bs = device.empty((chunks, 2), np.uint64)
        device.launch(
            "store/fletcher.cl",
            "sum_chunks_bs",
            (chunks,),
            sums_bs,
            device.upload(rows_mx),
            device.upload(np.asarray(image_n, np.int32)),
            device.upload(np.asarray(place_n, np.int32)),
            piece,
            skipped,
            pieces,
            rows_mx.shape[1],
            len(image_n),
        )
        return device.download(sums_bs)


def checksums(sums_bs: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """Return the checksum of each chunk from the sums over all its pieces, shape (chunks,)."""
    # HDF5 folds carries instead of dividing: 65535 stands for any multiple of it but 0 itself, which only zeros give.
    reduced_bs = (256 * (sums_bs % 65535) + 65534) % 65535 + 1
    reduced_bs[sums_bs[:, 0] == 0] = 0
    return (reduced_bs[:, 1] << 16 | reduced_bs[:, 0]).astype(SUM_DTYPE)
