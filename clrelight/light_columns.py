"""Which columns, or rows, of a table of numbers are the x, y and z of lights."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.directions import are_unit
from clrelight.errors import InputError

_AXIS = re.compile(r"(?:.*[\W_])?(?:l|n|d|v|p|dir|light|pos|direction|position)?([xyz])(?:\W.*)?", re.IGNORECASE)


def find_axes(words: Sequence[str]) -> list[int] | None:
    """Return where x, y and z are among the words of a heading, or None where each is not there once."""
    axes = [found[1].lower() if (found := _AXIS.fullmatch(word)) else "" for word in words]
    return [axes.index(axis) for axis in "xyz"] if all(axes.count(axis) == 1 for axis in "xyz") else None


def read_directions(
    path: Path, values: NDArray[np.float64], heading: tuple[str, ...] | None, named: bool
) -> tuple[NDArray[np.float64], list[str]]:
    """Return the directions in a table of N lines, or of 3 where a column is a light, and notes."""
    count, width = values.shape
    if heading is not None and len(heading) == width - 1 and _counts_lines(values[:, 0]):
        heading = ("index", *heading)  # programs leave the name of this column out
    if heading is not None and (axes := find_axes(heading)) is not None:
        if len(heading) != width:
            raise InputError(f"{path} has {len(heading)} columns of numbers in its heading, but {width} below it")
        unused = [word for i, word in enumerate(heading) if i not in axes]
        notes = [f"{path.name}: column {word!r} is not used" for word in unused]
        if axes != sorted(axes):
            notes.append(f"{path.name}: x, y, z are columns {', '.join(str(i + 1) for i in axes)} as its heading says")
        return values[:, axes], notes
    if named or count != 3:
        return _three_columns(path, values)
    if width == 3:
        # One light a line, unless the columns alone are unit vectors.
        return (values.T.copy() if are_unit(values.T) and not are_unit(values) else values), []
    if not are_unit(values.T) and width in (4, 5):
        try:
            columns = _three_columns(path, values)
        except InputError:
            return values.T.copy(), []
        if are_unit(columns[0]):
            return columns
    return values.T.copy(), []


def _three_columns(path: Path, values: NDArray[np.float64]) -> tuple[NDArray[np.float64], list[str]]:
    """Return x, y and z of a table with a line a light: without a column of line numbers, or of one value."""
    count, width = values.shape
    if width == 3:
        return values, []
    if width in (4, 5):
        kept = []
        if _counts_lines(values[:, 0]):
            kept.append((values[:, 1:], f"{path.name}: the first column numbers the lines"))
        if np.all(values[:, -1] == values[0, -1]):
            kept.append((values[:, :-1], f"{path.name}: the last column is {values[0, -1]:g} everywhere and not used"))
        if width == 5 and kept:
            further, notes = _three_columns(path, kept[0][0])
            return further, [kept[0][1], *notes]
        if kept:
            # Where both could be, the one that leaves unit vectors.
            columns, note = next((each for each in kept if are_unit(each[0])), kept[0])
            return columns, [note]
    hints = {
        2: " (two numbers a light look like angles)",
        4: " (the fourth number of each light differs from line to line: what it means is not known)",
    }
    raise InputError(f"{path} holds {count}×{width} numbers, expected N×3 or 3×N{hints.get(width, '')}")


def _counts_lines(column: NDArray[np.float64]) -> bool:
    return len(column) > 1 and any(np.array_equal(column, np.arange(start, start + len(column))) for start in (0, 1))


def refuse_angles(path: Path, directions_i3: NDArray[np.float64]) -> None:
    """Refuse azimuth, elevation and a radius common to all: as x y z they would put nearly all at the horizon."""
    across, radius = np.abs(directions_i3[:, :2]), directions_i3[:, 2]
    if len(radius) < 4 or not np.all(radius == radius[0]) or not 2 < across.max() <= 360:
        return
    if np.mean(radius < 0.1 * np.linalg.norm(across, axis=1)) > 0.75:
        raise InputError(f"{path} holds what looks like two angles and the radius {radius[0]:g}, expected x y z")
