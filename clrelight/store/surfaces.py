"""Group ``surface`` of stacks and fits: the mesh whose vertices their pixels are."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import StoreFormatError
from clrelight.store.opening import Opened, parse_config
from clrelight.store.schemas import SURFACE, SURFACE_FACTS
from clrelight.store.writing import CHUNK_BYTES, Draft, even_part
from clrelight.surface import Surface

_PARTS = {
    "vertices": "vertices_v3",
    "faces": "faces_f3",
    "normals": "normals_v3",
    "tangents": "tangents_v3",
    "albedo": "albedo_vc",
    "texture": "texture_v2",
}
"""Datasets, and what they are of a `Surface`."""
_NEEDED = ("vertices", "faces", "normals")


def surface_bytes(surface: Surface | None) -> int:
    """Return what a surface takes in a file."""
    return sum(array.nbytes for array in _arrays_of(surface).values())


def write_surface(draft: Draft, surface: Surface | None) -> None:
    """Write a surface, where there is one; its notes are not kept."""
    for name, array in _arrays_of(surface).items():
        path = f"surface/{name}"
        row_bytes = math.prod(array.shape[1:]) * array.itemsize
        chunks = (even_part(len(array), CHUNK_BYTES // row_bytes), *array.shape[1:])
        draft.dataset(path, array, SURFACE[path].axes, chunks)
    if surface is not None:
        facts = {"argument": surface.argument, "grid": surface.grid, "name": surface.name}
        draft.attributes({SURFACE_FACTS: json.dumps(facts, sort_keys=True)}, "surface/vertices")


def _arrays_of(surface: Surface | None) -> dict[str, NDArray]:
    if surface is None:
        return {}
    held = {name: getattr(surface, attribute) for name, attribute in _PARTS.items()}
    return {name: array for name, array in held.items() if array is not None}


def surface_of(opened: Opened) -> Surface | None:
    """Return the surface in an open file, None where there is none; StoreFormatError or InputError if it is not sound.

    It is read whole: what a map is of is small beside the map.
    """
    found = {name: opened.optional(f"surface/{name}") for name in _PARTS}
    if all(array is None for array in found.values()):
        return None
    for name in _NEEDED:
        if found[name] is None:
            raise StoreFormatError(f"its surface has no dataset {name}")
    facts = parse_config(opened.attribute(SURFACE_FACTS, str, of="surface/vertices"), SURFACE_FACTS)
    arrays = {_PARTS[name]: array for name, array in found.items()}
    return Surface(
        **arrays,
        grid=_fact(facts, "grid", _grid),
        argument=_fact(facts, "argument", _text),
        name=_fact(facts, "name", _text),
    )


def describe_surface(surface: Surface) -> dict[str, Any]:
    """Return what there is to tell of a surface, JSON values."""
    facts: dict[str, Any] = {"name": surface.name, "vertices": surface.n_vertex, "faces": len(surface.faces_f3)}
    if surface.grid is not None:
        facts["grid"] = list(surface.grid)
    facts["functions"] = f"of the direction to the {'light' if surface.argument == 'light' else 'eye'}"
    facts["frame"] = "global" if surface.tangents_v3 is None else "local"
    if surface.albedo_vc is not None:
        facts["albedo"] = np.round(surface.albedo_vc.mean(axis=0, dtype=np.float64), 4).tolist()
    facts["texture"] = surface.texture_v2 is not None
    return facts


def _fact(facts: dict[str, Any], name: str, take: Callable[[Any], Any]) -> Any:
    try:
        return take(facts[name])
    except (KeyError, TypeError, ValueError):
        raise StoreFormatError(f"attribute {SURFACE_FACTS} must have {name}, got {facts.get(name)!r:.80}") from None


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _grid(value: Any) -> tuple[int, int] | None:
    if value is None:
        return None
    rows, columns = value
    if not (type(rows) is type(columns) is int and rows > 0 and columns > 0):
        raise ValueError
    return rows, columns
