"""A small picture of what a file holds, of a few of its rows."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Encoded
from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.archives import archive_reader
from clrelight.jobs.foreign import describe_foreign
from clrelight.jobs.relight import relight
from clrelight.jobs.report import Report
from clrelight.lighting.light import Light
from clrelight.relight import to_display
from clrelight.shrm.record import Shrm
from clrelight.store import file_schema, open_fit, open_stack, read_encoded, read_light, read_results, read_shrm

LIGHT = np.array([-1.0, 1.0, 2.0]) / np.sqrt(6.0)
"""From the upper left, 35 degrees off the view: what shows most of a relief."""

_MOST_VALUES = 1 << 24
"""Coefficients that are decoded for a thumbnail."""
_LEVELS = {"klt": 5, "wavelet": 5}
"""Codecs that give lower resolutions, and how many."""


def thumbnail(path: str | os.PathLike[str], side: int = 256, *, is_patient: bool = False) -> NDArray[np.uint8] | None:
    """Return a picture of a file for display.

    A stack is shown by its photograph nearest to `LIGHT`, a fit or an encoding under `LIGHT`, results by their first
    picture, a light by a ball whose points show the radiance from where they face, a reflection map by its mean.

    Parameters
    ----------
    path : path
        A file of ours on this machine, or of another viewer's, as of `foreign.describe_foreign`.
    side : int
        Pixels of the longer side, at most.
    is_patient : bool
        Whether an encoding is decoded however long that takes.

    Returns
    -------
    ndarray, shape (height, width, 1 or 3), uint8, or None
        sRGB; None where the file holds no picture, or one that takes long.

    Raises
    ------
    InputError, StoreFormatError
        As `open_stack`.
    """
    if (facts := describe_foreign(path)) is not None:
        return _of_foreign(path, facts, side)
    match file_schema(path).partition("/")[0]:
        case "stack":
            with open_stack(path) as stack:
                return _of_stack(stack, side) if min(stack.images_ihwc.shape[1:3]) > 1 else None
        case "fit":
            with open_fit(path) as fitted:
                return thumbnail_of_fit(fitted, side) if min(fitted.image_shape[:2]) > 1 else None
        case "encoded":
            return thumbnail_of_encoded(Path(os.fsdecode(path)), *_codec_and_shape(path), side, is_patient=is_patient)
        case "light":
            return _shown(_scaled(_of_light(read_light(path), min(side, 128))))
        case "shrm":
            return _shown(_scaled(_of_maps(read_shrm(path), side)))
        case _:
            pictures = read_results(path).pictures
            first = next(iter(pictures.values()), None)
            return None if first is None else _shown(_shrunk(srgb_to_linear(first / 255.0), side))


def _of_stack(stack: LightStack, side: int) -> NDArray[np.uint8]:
    light = int(np.argmax(stack.directions_i3 @ LIGHT))
    height, width, _ = stack.images_ihwc.shape[1:]
    rows = _picked(height, width, side)
    values = np.stack([np.asarray(stack.images_ihwc[light, row], np.float64) for row in rows]) / stack.peak
    linear = srgb_to_linear(np.clip(values, 0, 1)) if stack.transfer == "srgb" else values
    return _shown(_columns(linear, side, height))


def _of_foreign(path: str | os.PathLike[str], facts: dict[str, Any], side: int) -> NDArray[np.uint8] | None:
    """Return a picture of what other viewers show, under `LIGHT`; None of lists of lights."""
    if "shape" not in facts:
        return None
    height, width, _ = facts["shape"]
    is_large = facts["planes"] * height * width > _MOST_VALUES
    if min(height, width) == 1 or (is_large and facts["stored"] != "bytes"):
        return None
    reader = archive_reader(os.fsdecode(path))
    assert reader is not None  # it was described
    found = reader(os.fsdecode(path))
    rows = _picked(height, width, side)
    shown = np.concatenate([found.display_values(LIGHT[None], int(row), int(row) + 1)[0] for row in rows])
    return _shown(_columns(srgb_to_linear(shown), side, height))


def thumbnail_of_fit(fitted: CoefficientMap, side: int = 256) -> NDArray[np.uint8]:
    """Return a picture of a fit under `LIGHT`, as `thumbnail` does of its file."""
    height, width, _ = fitted.image_shape
    factor_k = fitted.functions_at(LIGHT[None])[0]
    rows = _picked(height, width, side)
    relit = np.stack([np.tensordot(factor_k, np.asarray(fitted.coeffs_khwc[:, row]), 1) for row in rows])
    return _shown(_columns(relit, side, height))


def _codec_and_shape(path: str | os.PathLike[str]) -> tuple[str, tuple[int, int, int, int]]:
    encoded, _ = read_encoded(path)
    return encoded.codec, encoded.shape


def thumbnail_of_encoded(
    source: Path | Encoded,
    codec: str,
    shape: tuple[int, int, int, int],
    side: int = 256,
    device: Device | None = None,
    is_patient: bool = False,
) -> NDArray[np.uint8] | None:
    """Return a picture of an encoding, by its codec and of its shape, under `LIGHT`; None where that takes long.

    Where the level that is as large as `side` takes long, a smaller one is shown, unless `is_patient`.
    """
    n_coeff, height, width, channel = shape
    if min(height, width) == 1:
        return None
    halvings, last = max(0, math.floor(math.log2(max(height, width) / side))), _LEVELS.get(codec, 0)
    for level in {**dict.fromkeys(range(min(halvings, last), last + 1)), 0: None}:
        if not is_patient and n_coeff * height * width * channel >> (2 * level) > _MOST_VALUES:
            continue
        try:
            relit = relight(source, LIGHT, level=level, device=device, report=Report())
        except InputError:
            if not level:
                raise
            continue  # of before there were levels
        return _shown(_shrunk(relit, side))
    return None


def has_levels(codec: str) -> bool:
    """Return whether a codec gives lower resolutions, which take a part of the time."""
    return codec in _LEVELS


def _of_light(light: Light, side: int) -> NDArray:
    """Return a ball whose points show the radiance from where they face; black beside it."""
    at = (2 * np.arange(side) + 1) / side - 1
    x, y = np.meshgrid(at, -at)
    z_squared = 1 - x**2 - y**2
    inside = z_squared > 0
    normals = np.stack([x, y, np.sqrt(np.maximum(z_squared, 0))], axis=-1)[inside]
    ball = np.zeros((side, side, light.coeffs_kc.shape[1]))
    ball[inside] = evaluate_basis(normals, light.degree) @ light.coeffs_kc
    return ball


def _of_maps(shrm: Shrm, side: int) -> NDArray:
    return _shrunk(np.asarray(shrm.maps_khwc[0], np.float64), side)


def _picked(height: int, width: int, side: int) -> NDArray[np.intp]:
    """Return so many rows, from the middle of equal parts, that the picture keeps its shape."""
    count = max(1, min(height, round(height * min(1.0, side / max(height, width)))))
    return (np.arange(count) * height + height // 2) // count if count < height else np.arange(height)


def _columns(values_hwc: NDArray, side: int, height: int) -> NDArray:
    """Return means of columns: as many as the picture is to have."""
    width = values_hwc.shape[1]
    count = max(1, min(width, round(width * min(1.0, side / max(height, width)))))
    starts = np.arange(count) * width // count
    lengths = np.diff([*starts, width])
    return np.add.reduceat(values_hwc.astype(np.float64), starts, axis=1) / lengths[:, None]


def _shrunk(values_hwc: NDArray, side: int) -> NDArray:
    height, width, _ = values_hwc.shape
    return _columns(values_hwc[_picked(height, width, side)], side, height)


def _scaled(values: NDArray) -> NDArray:
    """Return radiance so that what is bright, but for a hundredth, is white."""
    positive = values[values > 0]
    return values / np.quantile(positive, 0.99) if positive.size else values


def _shown(values_hwc: NDArray) -> NDArray[np.uint8]:
    """Return sRGB of linear radiance; of other numbers of channels, their mean."""
    if values_hwc.shape[2] not in (1, 3):
        values_hwc = values_hwc.mean(axis=2, keepdims=True)
    return to_display(np.nan_to_num(values_hwc).astype(np.float32), "srgb")
