"""Domes and projects of relight, ``.dome`` and ``.relight``: JSON with a direction for each lamp, or its place."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

ENDINGS = (".dome", ".relight", ".json")
_MOST_BYTES, _MOST_LIGHTS = 64 << 20, 1 << 16
_PLACES = ("directions", "positions3d", "positionsSphere")
"""Where lights may stand, the best first."""


def read_dome(path: Path) -> tuple[tuple[str, ...], NDArray[np.float64], tuple[str, ...]]:
    """Return what a dome says of its lamps; those of near lamps are their directions from the middle of the view.

    Returns
    -------
    names : tuple of str
        The photographs of a project, without those that it skips; empty of a dome.
    vectors_i3 : ndarray, shape (n_light, 3), float64
        As written.
    notes : tuple of str

    Raises
    ------
    InputError
        If the file is no dome, or a lamp is not three numbers.
    """
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise InputError(f"{path} is larger than {_MOST_BYTES >> 20} MiB, which no dome is")
        told = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path} is no JSON, as domes of relight are") from None
    whole: dict[str, Any] = told if isinstance(told, dict) else {}
    images, inner = whole.get("images"), whole.get("dome", whole)
    dome: dict[str, Any] = inner if isinstance(inner, dict) else {}
    held = next((name for name in _PLACES if dome.get(name)), None)
    if held is None or not isinstance(dome[held], list) or len(dome[held]) > _MOST_LIGHTS:
        raise InputError(f"{path} is no dome of relight: it has no list of {', '.join(_PLACES)}")
    vectors_i3 = np.array([_vector(path, i, each) for i, each in enumerate(dome[held])])
    kind = str(dome.get("lightConfiguration", "directional"))[:40]
    note = f"{path.name} has near lamps ({kind}): each is taken to lie where it is seen from the middle of the view"
    notes = () if kind == "directional" and held == "directions" else (note,)
    if not images:
        return (), vectors_i3, notes
    try:
        names = [os.fspath(each["filename"]) for each in images]  # TypeError of what is no text
        used = [i for i, each in enumerate(images) if not each.get("skip", False)]
    except (KeyError, TypeError, AttributeError):
        raise InputError(f"{path}: its images have no file names") from None
    if len(names) != len(vectors_i3):
        raise InputError(f"{path} names {len(names)} images, and has {len(vectors_i3)} lights")
    if not used:
        raise InputError(f"{path} skips all of its images")
    return tuple(names[i] for i in used), vectors_i3[used], notes


def _vector(path: Path, number: int, lamp: Any) -> list[float]:
    try:
        numbers = [lamp[axis] for axis in "xyz"] if isinstance(lamp, dict) else list(lamp)
        if len(numbers) != 3 or any(isinstance(each, bool) or not isinstance(each, int | float) for each in numbers):
            raise ValueError
        return [float(each) for each in numbers]
    except (KeyError, TypeError, ValueError, OverflowError):
        raise InputError(f"{path}: lamp {number} is {str(lamp)[:60]}, expected x, y and z") from None
