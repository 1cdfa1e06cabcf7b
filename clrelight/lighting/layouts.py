"""How environment maps lay the sphere out in pictures: directions and solid angles of texels, and axes.

Directions are first taken in the picture's own view, which every layout has: right, forward (what an angular map has
in its centre, and the other layouts in the middle of the picture) and up. `parse_axes` says how these become x, y, z.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.latlong import latitude_weights, longitude_azimuths

ASPECTS = {
    "latlong": (2, 1),
    "angular": (1, 1),
    "vertical-cross": (3, 4),
    "horizontal-cross": (4, 3),
    "vertical-strip": (1, 6),
    "horizontal-strip": (6, 1),
}
"""Width to height of each layout of one picture."""

LAYOUTS = (*ASPECTS, "cube")
"""``cube``: six pictures, or a file that holds six, in Direct3D's order +X -X +Y -Y +Z -Z, whose left-handed axes are
right, up and forward."""

OPENEXR_FACES = (0, 1, 2, 3, 5, 4)
"""Where our faces lie in OpenEXR's cubes (ImfEnvmap.h), whose right-handed axes are right, up and back."""

AXES = {"z-up": "right,forward,up", "probe": "right,up,forward", "camera": "right,up,back"}
"""Named axes: the world's up is z; those of published tables (a mirror image); those of a stack whose y is up."""

# Where the faces lie, as (row, column, turned by 180 degrees).
_PLACES = {
    "vertical-cross": ((1, 2, 0), (1, 0, 0), (0, 1, 0), (2, 1, 0), (1, 1, 0), (3, 1, 1)),
    "horizontal-cross": ((1, 2, 0), (1, 0, 0), (0, 1, 0), (2, 1, 0), (1, 1, 0), (1, 3, 0)),
    "vertical-strip": tuple((face, 0, 0) for face in range(6)),
    "horizontal-strip": tuple((0, face, 0) for face in range(6)),
}
_WORDS = {word: (axis, sign) for axis, pair in enumerate((("right", "left"), ("forward", "back"), ("up", "down")))
          for word, sign in zip(pair, (1.0, -1.0), strict=True)}  # fmt: skip
_FACE_NAMES = (
    ("posx", "px", "+x", "right"),
    ("negx", "nx", "-x", "left"),
    ("posy", "py", "+y", "top", "up"),
    ("negy", "ny", "-y", "bottom", "down"),
    ("posz", "pz", "+z", "front"),
    ("negz", "nz", "-z", "back"),
)


def parse_axes(text: str) -> tuple[str, NDArray[np.float64]]:
    """Return axes in words, and the matrix that takes (right, forward, up) to our (x, y, z).

    Parameters
    ----------
    text : str
        A name of `AXES`, or where x, y and z point in the picture's view: three of right or left, forward or back, up
        or down, separated by commas. Swapping a word for its opposite mirrors the map along that axis.

    Raises
    ------
    InputError
        If it is neither.
    """
    words = AXES.get(text, text).split(",")
    found = [_WORDS.get(word.strip().lower()) for word in words]
    if len(found) != 3 or None in found or {each[0] for each in found if each} != {0, 1, 2}:
        raise InputError(
            f"axes must be {', '.join(AXES)}, or three directions such as right,forward,up (left, back and down are "
            f"their opposites), got {text!r}"
        )
    matrix = np.zeros((3, 3))
    for row, each in enumerate(found):
        if each:
            matrix[row, each[0]] = each[1]
    return ",".join(word.strip().lower() for word in words), matrix


def detect_layout(height: int, width: int) -> str | None:
    """Return the layout whose aspect a picture has, or None."""
    return next((name for name, (wide, high) in ASPECTS.items() if width * high == height * wide), None)


def check_layout(layout: str, height: int, width: int, what: str) -> None:
    """Raise InputError if a picture of this size cannot be of the layout."""
    wide, high = ASPECTS[layout]
    if height < 1 or width * high != height * wide or (width % wide or height % high):
        raise InputError(f"{what} has {width}×{height} texels, layout {layout} must be {wide}:{high}")


def face_order(names: Sequence[str]) -> list[int]:
    """Return the positions of +X, -X, +Y, -Y, +Z, -Z among six file names.

    Where each name bears another face's (posx, px, +x, right, ...) these count, else the order given.
    """
    found = [face_of(name) for name in names]
    return [found.index(face) for face in range(6)] if set(found) == set(range(6)) else list(range(6))


def face_of(name: str) -> int | None:
    """Return the face that a file is named after, or None."""
    stem = PurePath(name).stem.lower()
    for face, words in enumerate(_FACE_NAMES):
        if any(re.search(rf"(?:^|[^a-z]){re.escape(word)}$", stem) for word in words):
            return face
    return None


def cut_faces(picture_hwc: NDArray, layout: str) -> NDArray:
    """Return the faces (6, size, size, channel) of a cross or a strip."""
    size = picture_hwc.shape[1] // ASPECTS[layout][0]
    faces = []
    for row, column, turned in _PLACES[layout]:
        face_hwc = picture_hwc[row * size : (row + 1) * size, column * size : (column + 1) * size]
        faces.append(face_hwc[::-1, ::-1] if turned else face_hwc)
    return np.stack(faces)


def used_texels(layout: str, height: int, width: int) -> NDArray[np.bool_]:
    """Return, as (height, width), which texels of a picture show something."""
    used = np.zeros((height, width), bool)
    if layout == "angular":
        return np.hypot(*_square(height)) <= 1.0
    if layout in _PLACES:
        size = width // ASPECTS[layout][0]
        for row, column, _ in _PLACES[layout]:
            used[row * size : (row + 1) * size, column * size : (column + 1) * size] = True
        return used
    return ~used


@functools.lru_cache(maxsize=2)
def texel_geometry(layout: str, height: int, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the directions of texels and their weights.

    Parameters
    ----------
    layout : str
        ``"angular"``, ``"latlong"`` or ``"cube"`` (faces one below the other, so height is six times width).
    height, width : int

    Returns
    -------
    directions_t3 : ndarray, shape (height * width, 3), float64
        Unit vectors in (right, forward, up) of the texels' centres.
    weights_t : ndarray, shape (height * width,), float64
        Solid angles, sum 4 pi. Lat-long maps get Fejer's first rule over their rows, which integrates band-limited
        radiance exactly (`latitude_weights`); cube faces each texel's exact solid angle; angular maps
        ``sin(theta) / theta`` inside the circle, 0 outside, scaled to 4 pi.
    """
    parts: tuple[NDArray[np.float64], ...]
    if layout == "latlong":
        azimuth_w = longitude_azimuths(width)
        z_h = np.cos(np.pi * (np.arange(height) + 0.5) / height)[:, None]
        radius_h = np.sqrt(1.0 - z_h * z_h)
        parts = (radius_h * np.cos(azimuth_w), radius_h * np.sin(azimuth_w), np.broadcast_to(z_h, (height, width)))
        weights = np.repeat(latitude_weights(height) * (2.0 * np.pi / width), width)
    elif layout == "angular":
        x, y = _square(height)
        radius = np.hypot(x, y)
        scale = np.pi * np.sinc(radius)  # sin(pi r) / r
        parts = (scale * x, np.cos(np.pi * radius), scale * y)
        weights = (np.sinc(radius) * (radius <= 1.0)).ravel()
        weights *= 4.0 * np.pi / weights.sum()
    else:
        parts, weights = _cube_geometry(width)
    directions = np.stack([part.ravel() for part in parts], axis=1)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for array in (directions, weights):
        array.flags.writeable = False  # kept for the next map of this size
    return directions, weights


def _square(size: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return, in -1 .. 1, how far right and up each texel of a square picture lies."""
    along = 2.0 * (np.arange(size) + 0.5) / size - 1.0
    x, y = np.meshgrid(along, -along)
    return x, y


def _cube_geometry(size: int) -> tuple[tuple[NDArray[np.float64], ...], NDArray[np.float64]]:
    x, y = _square(size)
    one = np.ones_like(x)
    # Each face as seen from inside, in (right, forward, up): x to the picture's right, y to its top.
    faces = ((one, -x, y), (-one, x, y), (x, -y, one), (x, y, -one), (x, one, y), (-x, -one, y))
    edge = 2.0 * np.arange(size + 1) / size - 1.0
    a, b = np.meshgrid(edge, edge)
    corner = np.arctan2(a * b, np.sqrt(a * a + b * b + 1.0))
    solid = corner[1:, 1:] - corner[:-1, 1:] - corner[1:, :-1] + corner[:-1, :-1]
    parts = tuple(np.stack([face[part] for face in faces]) for part in range(3))
    return parts, np.tile(solid.ravel(), 6)
