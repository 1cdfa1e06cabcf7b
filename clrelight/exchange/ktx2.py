"""BC6H blocks as KTX2 (Khronos Texture 2.0): an array texture that engines and WebGL loaders take."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable

from clrelight.codec.encoded import Encoded
from clrelight.codec.transforms import blocks
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.exchange.block_files import BlockFiles, put_blocks

_IDENTIFIER = b"\xabKTX 20\xbb\r\n\x1a\n"
_BC6H_SFLOAT = 144
"""VK_FORMAT_BC6H_SFLOAT_BLOCK."""
_MODEL_BC6H, _BT709, _LINEAR = 133, 1, 1
_SIGNED_FLOAT = 0xC0
_HEADER_BYTES = 12 + 9 * 4 + 4 * 4 + 2 * 8
_LEVEL_BYTES = 3 * 8


def write_ktx2(
    out: str | os.PathLike[str],
    held: CoefficientMap | Encoded,
    device: Device,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write BC6H blocks as one KTX2 file, a layer for each group of three components, no mipmaps.

    Parameters
    ----------
    out : path
    held : CoefficientMap or Encoded
        Blocks of an encoding of codec `bc6h` are passed on as they are; coefficients are encoded rows at a time.
    device : Device
        Where they are.
    progress : callable, optional
        Called with rows done and in all.

    Raises
    ------
    InputError
        If the encoding is of another codec, binary16 does not hold a coefficient, or the file cannot be written.
    """
    if isinstance(held, Encoded) and held.codec != "bc6h":
        raise InputError(f"a KTX2 file holds blocks of codec bc6h, this encoding is {held.codec}")
    shape = held.shape if isinstance(held, Encoded) else (held.n_coeff, *held.image_shape)
    n_group, n_block = blocks.block_counts(shape)
    size = 16 * n_block * n_group
    _, height, width, _ = shape
    descriptor = _descriptor()
    notes = b"".join(_pair(key, value) for key, value in (("KTXorientation", "rd"), ("KTXwriter", "clrelight")))
    place = _HEADER_BYTES + _LEVEL_BYTES
    start = -(-(place + len(descriptor) + len(notes)) // 16) * 16  # of the level: a multiple of a block
    header = _IDENTIFIER + struct.pack("<9I", _BC6H_SFLOAT, 1, width, height, 0, n_group, 1, 1, 0)
    header += struct.pack("<4I2Q", place, len(descriptor), place + len(descriptor), len(notes), 0, 0)
    header += struct.pack("<3Q", start, size, size) + descriptor + notes
    with replacing(out) as part, naming(out):
        part.write(header.ljust(start, b"\0"))
        put_blocks(held, BlockFiles([part.descriptor], start), device, progress=progress)


def _descriptor() -> bytes:
    """Return the data format descriptor of blocks of 4 × 4 texels in 16 bytes, signed floats, linear."""
    block = struct.pack("<IHH4B4B8B", 0, 2, 40, _MODEL_BC6H, _BT709, _LINEAR, 0, 3, 3, 0, 0, 16, *[0] * 7)
    sample = struct.pack("<HBB4B2f", 0, 127, _SIGNED_FLOAT, 0, 0, 0, 0, -1.0, 1.0)
    return struct.pack("<I", 4 + len(block) + len(sample)) + block + sample


def _pair(key: str, value: str) -> bytes:
    content = key.encode() + b"\0" + value.encode() + b"\0"
    return (struct.pack("<I", len(content)) + content).ljust(-(-(4 + len(content)) // 4) * 4, b"\0")
