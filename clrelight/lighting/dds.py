"""Cube maps of floats in Microsoft's DDS files, which OpenImageIO does not read."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

_HEADER_BYTES, _DX10_BYTES = 128, 20
_ALL_FACES = 0xFE00  # caps2: cube map, and each of its six faces
_CUBE_FLAG = 0x4  # of the DX10 header
_MAX_SIZE = 1 << 14

# Numbers in place of a FourCC (D3DFMT), and DXGI formats: scalar type and channels of a texel.
_D3D_FORMATS = {113: (np.float16, 4), 116: (np.float32, 4)}
_DXGI_FORMATS = {2: (np.float32, 4), 6: (np.float32, 3), 10: (np.float16, 4)}


def read_dds_faces(path: Path) -> NDArray:
    """Return the faces (6, size, size, 3) of an uncompressed cube map of half or single floats, in Direct3D's order.

    Smaller mipmap levels and alpha are left out.

    Raises
    ------
    InputError
        If the file is missing, cut short, no cube map, or of another texel format.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read image {path}: {error.strerror}") from None
    if len(content) < _HEADER_BYTES or content[:4] != b"DDS ":
        raise InputError(f"{path} is no DDS file")
    height, width = struct.unpack_from("<2I", content, 12)
    levels, code, caps2 = (struct.unpack_from("<I", content, at)[0] for at in (28, 84, 112))
    start, form = _HEADER_BYTES, _D3D_FORMATS.get(code)
    is_cube = caps2 & _ALL_FACES == _ALL_FACES
    if content[84:88] == b"DX10" and len(content) >= _HEADER_BYTES + _DX10_BYTES:
        code, _, flags = struct.unpack_from("<3I", content, _HEADER_BYTES)
        start, form, is_cube = start + _DX10_BYTES, _DXGI_FORMATS.get(code), bool(flags & _CUBE_FLAG)
    if form is None:
        raise InputError(f"{path} has texel format {code}; read are cube maps of half or single floats, uncompressed")
    if not is_cube or height != width or not 1 <= width <= _MAX_SIZE:
        raise InputError(f"{path} is no cube map of six square faces ({width}×{height})")
    dtype, channels = np.dtype(form[0]).newbyteorder("<"), form[1]
    # Each face is followed by its own smaller levels.
    sizes = [max(1, width >> level) ** 2 * channels * dtype.itemsize for level in range(min(max(1, levels), 16))]
    if len(content) < start + 6 * sum(sizes):
        raise InputError(f"{path} is cut short: {len(content)} bytes, its header needs {start + 6 * sum(sizes)}")
    faces = [
        np.frombuffer(content, dtype, width * width * channels, start + face * sum(sizes)).reshape(
            width, width, channels
        )
        for face in range(6)
    ]
    return np.stack(faces)[..., :3]
