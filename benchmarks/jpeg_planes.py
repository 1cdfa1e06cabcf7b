"""Planes of coefficients as RTI tools store them: 8 bits over the central part of their values, in JPEG files."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

RANGE_PERCENT = 99.5


def compress_planes(
    planes: list[NDArray[np.float32]],
    quality: int | None,
    mask_hw: NDArray[np.bool_] | None = None,
    span: tuple[float, float] | None = None,
) -> tuple[int, list[NDArray[np.float32]]]:
    """Return the bytes of planes (h, w, 1 or 3) as scaled JPEG files, and the planes that come back from them.

    Colours are stored without subsampling. Scales are two float32 for each channel of each plane, unless all have the
    same `span`. Pixels outside the mask do not count: they are black in the files, and cost next to nothing.
    """
    mask_hw = np.ones(planes[0].shape[:2], bool) if mask_hw is None else mask_hw
    if quality is None:
        return sum(int(mask_hw.sum()) * plane.shape[2] * plane.itemsize for plane in planes), planes
    try:
        from PIL import Image, ImageFile
    except ImportError:
        raise InputError("JPEG planes need Pillow: pip install 'clrelight[codecs]'") from None
    size, decoded = 0, []
    for plane_hwc in planes:
        if span is None:
            outside = (100.0 - RANGE_PERCENT) / 2.0
            low_c, high_c = np.percentile(plane_hwc[mask_hw], [outside, 100.0 - outside], axis=0).astype(np.float32)
        else:
            low_c, high_c = (np.full(plane_hwc.shape[2], end, np.float32) for end in span)
        step_c = np.where(high_c > low_c, high_c - low_c, np.float32(1)) / np.float32(255)
        codes_hwc = np.clip(np.rint((plane_hwc - low_c) / step_c), 0, 255).astype(np.uint8)
        codes_hwc[~mask_hw] = 0
        file = io.BytesIO()
        # Where the best code is asked for, the whole file must fit a buffer, and noise takes more than the usual one.
        ImageFile.MAXBLOCK = max(ImageFile.MAXBLOCK, 4 * codes_hwc.size)
        single = codes_hwc.shape[2] == 1
        image = Image.fromarray(codes_hwc[:, :, 0] if single else codes_hwc)
        image.save(file, "JPEG", quality=quality, subsampling=0, optimize=True)
        size += len(file.getvalue()) + (low_c.nbytes + step_c.nbytes if span is None else 0)
        with Image.open(io.BytesIO(file.getvalue())) as read:
            back_hwc = np.array(read).reshape(codes_hwc.shape)
        decoded.append((low_c + back_hwc * step_c).astype(np.float32))
    return size, decoded
