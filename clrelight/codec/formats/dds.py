"""What stands before blocks of `bc6h` in a DDS texture, which GPUs, engines and image tools open (the DX10 form)."""

from __future__ import annotations

import struct

from clrelight.codec.transforms import blocks

DXGI_FORMAT_BC6H_SF16 = 96


def dds_header(shape: tuple[int, int, int, int], layers: int) -> bytes:
    """Return what stands before the blocks of so many groups of a map (n_coeff, height, width, channel)."""
    height, width, level_bytes = *shape[1:3], 16 * blocks.block_counts(shape)[1]
    flags = 0x1 | 0x2 | 0x4 | 0x1000 | 0x80000  # caps, height, width, pixel format, linear size
    pixel_format = struct.pack("<II4s5I", 32, 0x4, b"DX10", 0, 0, 0, 0, 0)
    header = struct.pack("<7I44x", 124, flags, height, width, level_bytes, 1, 1) + pixel_format
    header += struct.pack("<5I", 0x1000, 0, 0, 0, 0)  # a texture
    return b"DDS " + header + struct.pack("<5I", DXGI_FORMAT_BC6H_SF16, 3, 0, layers, 0)  # two-dimensional
