"""Directions as people write them: unit vectors of them, and what to say where they are none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted

_UNIT_TOLERANCE = 0.01
_HORIZON_DEGREES = 0.15
"""A light so little below the horizon, by rounding or measurement, is taken to be at it."""
_SAME_DIRECTION = 1e-9
_ASKEW = np.array([0.48, 0.6, 0.64])
"""An axis along which lights in a ring or a plane differ: those that are alike are then neighbours."""


def unit_directions(
    directions_i3: NDArray[np.float64],
    label: Callable[[int], str],
    allow_below: bool = False,
    option: str = "--allow-below",
) -> NDArray[np.float64]:
    """Return the directions with unit length.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        Vectors of any length.
    label : callable
        Gives the name of a light for messages.
    allow_below : bool
        Accept lights with z < 0, which a function on the upper hemisphere cannot use. Else those at most 0.15°
        below the horizon are put on it, see `horizon_note`.
    option : str
        What accepts them, for messages.

    Raises
    ------
    InputError
        Naming the first light that is not finite, has no length, or lies below the horizon.
    """
    finite = np.isfinite(directions_i3).all(axis=1)
    if not finite.all():
        light = int(np.flatnonzero(~finite)[0])
        raise InputError(f"{label(light)} has direction {vector_text(directions_i3[light])}, expected finite numbers")
    # Divided by the largest component first, so that no square over- or underflows.
    largest = np.abs(directions_i3).max(axis=1, keepdims=True)
    if not np.all(largest > 0):
        light = int(np.flatnonzero(largest[:, 0] == 0)[0])
        raise InputError(f"{label(light)} has direction 0 0 0, expected a vector towards the light")
    scaled = directions_i3 / largest
    unit_i3 = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    if allow_below:
        return unit_i3
    grazing = _grazing(unit_i3)
    below = np.flatnonzero((unit_i3[:, 2] < 0) & ~grazing)
    if below.size:
        others = f" (and {below.size - 1} more)" if below.size > 1 else ""
        raise InputError(
            f"{label(int(below[0]))}{others} is below the horizon: {vector_text(directions_i3[below[0]])}; "
            f"expected z >= 0{_axis_hint(directions_i3)}, or {option}"
        )
    unit_i3[grazing, 2] = 0.0
    unit_i3[grazing] /= np.linalg.norm(unit_i3[grazing], axis=1, keepdims=True)
    return unit_i3


def _grazing(unit_i3: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (unit_i3[:, 2] < 0) & (unit_i3[:, 2] >= -np.sin(np.radians(_HORIZON_DEGREES)))


def _axis_hint(directions_i3: NDArray[np.float64]) -> str:
    """Return what may be wrong with directions of which some are below the horizon: another axis never is."""
    if len(directions_i3) < 4 or np.sum(directions_i3[:, 2] < 0) < 0.2 * len(directions_i3):
        return ""
    if np.all(directions_i3[:, 2] <= 0):
        return " (all z are negative: does z point away from the camera?)"
    up = next((axis for axis in (1, 0) if np.all(directions_i3[:, axis] >= 0)), None)
    return f" (the {('first', 'second')[up]} number is never negative: is z written there?)" if up is not None else ""


def count_duplicates(directions_i3: NDArray[np.float64]) -> int:
    """Return how many lights have the direction of an earlier one, within 1e-9 in each component."""
    along_i = directions_i3 @ _ASKEW
    order_i = np.argsort(along_i)
    sorted_i3, along_i = directions_i3[order_i], along_i[order_i]
    again_i = np.zeros(len(directions_i3), bool)
    for step in range(1, len(directions_i3)):
        close_i = along_i[step:] - along_i[:-step] <= 2.0 * _SAME_DIRECTION  # |_ASKEW| sums to less
        if not close_i.any():
            break
        close_i &= (np.abs(sorted_i3[step:] - sorted_i3[:-step]) <= _SAME_DIRECTION).all(axis=1)
        again_i[np.maximum(order_i[step:], order_i[:-step])[close_i]] = True
    return int(again_i.sum())


def horizon_note(directions_i3: NDArray[np.float64], label: Callable[[int], str], allow_below: bool) -> list[str]:
    """Return a note on the lights that `unit_directions` puts on the horizon, else nothing."""
    unit_i3 = unit_directions(directions_i3, label, True)
    grazing = np.flatnonzero(_grazing(unit_i3))
    if allow_below or not grazing.size:
        return []
    degrees = float(np.degrees(np.arcsin(-unit_i3[grazing[0], 2])))
    others = f" and {grazing.size - 1} more, at most {_HORIZON_DEGREES:g}°" if grazing.size > 1 else ""
    return [f"{label(int(grazing[0]))} is {degrees:.2g}° below the horizon{others}: taken to be at it"]


def length_note(directions_i3: NDArray[np.float64]) -> list[str]:
    """Return a note if directions as written are not of unit length within 1%, else nothing."""
    lengths = np.linalg.norm(directions_i3, axis=1)
    off = np.flatnonzero(_off_unit(directions_i3))
    if not off.size:
        return []
    worst = float(lengths[off][np.argmax(np.abs(lengths[off] - 1.0))])
    return [
        f"{counted(off.size, 'direction was', 'directions were')} not of unit length "
        f"(worst {worst:.4g}), and normalised"
    ]


def are_unit(vectors: NDArray[np.float64]) -> bool:
    """Return whether all are of unit length within 1%."""
    return not _off_unit(vectors).any()


def _off_unit(vectors: NDArray[np.float64]) -> NDArray[np.bool_]:
    return ~(np.abs(np.linalg.norm(vectors, axis=1) - 1.0) <= _UNIT_TOLERANCE)


def vector_text(values: NDArray[np.float64]) -> str:
    """Return numbers as messages show them."""
    return " ".join(f"{v:g}" for v in values)
