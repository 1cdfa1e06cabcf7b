"""Write `bc6h` blocks as DDS textures that GPUs, engines and image tools open (Microsoft's DDS header, DX10 form)."""

from __future__ import annotations

import struct
from pathlib import Path

from clrelight.codec.encoded import Encoded
from clrelight.codec.transforms import blocks
from clrelight.errors import InputError

DXGI_FORMAT_BC6H_SF16 = 96


def write_dds(path: str | Path, encoded: Encoded, group: int | None = None) -> None:
    """Write an encoding of codec `bc6h` as one DDS file.

    Parameters
    ----------
    path : str or Path
        The file, replaced if it exists.
    encoded : Encoded
        Of codec ``bc6h``.
    group : int, optional
        Only this group of three components, as a plain two-dimensional texture: with RGB coefficients the map of
        coefficient `group`, else the planes ``3 group`` to ``3 group + 2``. By default a texture array of all groups,
        which GPUs and engines take, but not every image viewer.

    Raises
    ------
    InputError
        If the encoding is of another codec, or has no such group.
    """
    if encoded.codec != "bc6h":
        raise InputError(f"a DDS file holds blocks of codec bc6h, this encoding is {encoded.codec}")
    n_group, n_block = blocks.block_counts(encoded.shape)
    body = encoded.body[:]
    if group is not None:
        if not 0 <= group < n_group:
            raise InputError(f"group must be 0 to {n_group - 1}, got {group}")
        body = body[16 * n_block * group : 16 * n_block * (group + 1)]
    Path(path).write_bytes(dds_header(encoded.shape, n_group if group is None else 1) + body)


def dds_header(shape: tuple[int, int, int, int], layers: int) -> bytes:
    """Return what stands before the blocks of so many groups of a map (n_coeff, height, width, channel)."""
    height, width, level_bytes = *shape[1:3], 16 * blocks.block_counts(shape)[1]
    flags = 0x1 | 0x2 | 0x4 | 0x1000 | 0x80000  # caps, height, width, pixel format, linear size
    pixel_format = struct.pack("<II4s5I", 32, 0x4, b"DX10", 0, 0, 0, 0, 0)
    header = struct.pack("<7I44x", 124, flags, height, width, level_bytes, 1, 1) + pixel_format
    header += struct.pack("<5I", 0x1000, 0, 0, 0, 0)  # a texture
    return b"DDS " + header + struct.pack("<5I", DXGI_FORMAT_BC6H_SF16, 3, 0, layers, 0)  # two-dimensional
