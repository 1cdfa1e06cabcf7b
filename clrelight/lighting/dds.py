"""Cube maps of floats in Microsoft's DDS files, which OpenImageIO does not read."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

_HEADER_BYTES, _DX10_BYTES = 128, 20
_ALL_FACES = 0xFE00  # caps2: cube map, and each of its six faces
_CUBE_CAPS = 0x200  # the first of them
_CUBE_FLAG = 0x4  # of the DX10 header
_MAX_SIZE = 1 << 14
_MAX_BYTES = 8 * _MAX_SIZE * _MAX_SIZE * 16

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
        content = path.read_bytes() if path.stat().st_size <= _MAX_BYTES else b""
    except OSError as error:
        raise InputError(f"cannot read image {path}: {error.strerror}") from None
    if len(content) < _HEADER_BYTES or content[:4] != b"DDS ":
        raise InputError(f"{path} is no DDS file")
    height, width = struct.unpack_from("<2I", content, 12)
    levels, code, caps2 = (struct.unpack_from("<I", content, at)[0] for at in (28, 84, 112))
    start, form, count = _HEADER_BYTES, _D3D_FORMATS.get(code), 1
    n_face = (caps2 & _ALL_FACES & ~_CUBE_CAPS).bit_count() if caps2 & _CUBE_CAPS else 0
    if content[84:88] == b"DX10" and len(content) >= _HEADER_BYTES + _DX10_BYTES:
        # Writers set the cube flag here, there, or in both headers; and a count of 0, 1 or 6 for one cube.
        code, _, flags, count = struct.unpack_from("<4I", content, _HEADER_BYTES)
        start, form = start + _DX10_BYTES, _DXGI_FORMATS.get(code)
        n_face = 6 if flags & _CUBE_FLAG else n_face
        if n_face and count not in (0, 1, 6):
            raise InputError(f"{path} is an array of {count} cube maps, expected one")
    if form is None:
        raise InputError(f"{path} has texel format {code}; read are cube maps of half or single floats, uncompressed")
    if n_face != 6 or height != width or not 1 <= width <= _MAX_SIZE:
        raise InputError(f"{path} is no cube map of six square faces ({n_face} faces of {width}×{height})")
    dtype, channels = np.dtype(form[0]).newbyteorder("<"), form[1]
    # Each face is followed by its own smaller levels.
    sizes = [max(1, width >> level) ** 2 * channels * dtype.itemsize for level in range(min(max(1, levels), 16))]
    needed = 6 * sum(sizes)
    if len(content) < start + needed:
        raise InputError(f"{path} is cut short: {len(content)} bytes, its header needs {start + needed}")
    if count == 6 and len(content) >= start + count * needed:
        raise InputError(f"{path} is an array of 6 cube maps, expected one")
    faces = [
        np.frombuffer(content, dtype, width * width * channels, start + face * sum(sizes)).reshape(
            width, width, channels
        )
        for face in range(6)
    ]
    return np.stack(faces)[..., :3]
