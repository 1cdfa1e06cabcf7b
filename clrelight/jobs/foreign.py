"""What files of other programs hold: polynomial texture maps, relight folders, and lists of lights."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.directions import count_duplicates, unit_directions
from clrelight.dome_files import ENDINGS
from clrelight.errors import InputError
from clrelight.exchange.files import read_start
from clrelight.exchange.ptm import read_ptm_header
from clrelight.exchange.relight_folder import INFO
from clrelight.exchange.relight_reading import read_relight_folder
from clrelight.exchange.rows import ImageRows
from clrelight.exchange.rti import read_rti
from clrelight.light_files import read_light_file
from clrelight.remote import is_remote

_BASES = {
    "bilinear": "bilinear table",
    "rbf": "radial functions of lights",
    "ptm": "polynomials",
    "hsh": "hemispherical harmonics",
    "sh": "spherical harmonics",
}


def describe_foreign(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return a summary of a file of another program; None where its name is not that of one.

    Planes are not decoded, and those of whole images and tiles are only looked for.

    Returns
    -------
    dict
        JSON values: ``file``, ``kind``, ``bytes_on_disk`` (of a folder, of all that lies in it); of pictures ``shape``
        (height, width, channel), ``basis``, ``planes`` and how they are stored, of a relight folder the number of
        ``lights`` that it names; of lists of lights ``lights``, ``elevation_range`` in degrees, ``below_horizon``,
        ``duplicates``, the ``images`` that it names, and ``notes``.

    Raises
    ------
    InputError
        If it cannot be read, is not what its name says, or is cut short.
    """
    place = Path(os.fsdecode(path))
    summary = _summary_of(path)
    if summary is None:
        return None
    kind, facts = summary(place)
    return {"file": str(place), "kind": kind, "bytes_on_disk": _bytes_of(place), **facts}


def _summary_of(path: str | os.PathLike[str]) -> Callable[[Path], tuple[str, dict[str, Any]]] | None:
    """Return what makes the summary of a file, by its name; None of what is no regular file, which may never end."""
    if is_remote(os.fsdecode(path)):
        return None
    place = Path(os.fsdecode(path))
    if os.path.exists(place) and not os.path.isfile(place):
        return _folder_facts if os.path.isfile(place / INFO) else None
    return _folder_facts if place.name == INFO else _SUMMARIES.get(place.suffix.lower())


def _bytes_of(place: Path) -> int:
    folder = place.parent if place.name == INFO else place
    if not folder.is_dir():
        return place.stat().st_size
    return sum(each.stat().st_size for each in folder.rglob("*") if each.is_file())


def _ptm_facts(place: Path) -> tuple[str, dict[str, Any]]:
    head = read_ptm_header(place)
    stored = "JPEG" if head.is_compressed else "bytes"
    basis = "polynomials" if head.planes == 18 else "polynomials, of luminance"
    facts = {"shape": [*head.size, 3], "basis": basis, "planes": head.planes, "stored": stored}
    return f"polynomial texture map 1.2, {head.kind}", facts


def _rti_facts(place: Path) -> tuple[str, dict[str, Any]]:
    found = read_rti(place)
    order = 2 if len(found.scale_t) == 9 else 1
    facts = {"basis": f"hemispherical harmonics, order {order}", "planes": found.codes_hwp.shape[2], "stored": "bytes"}
    return "universal RTI file", {"shape": list(found.image_shape), **facts}


def _folder_facts(place: Path) -> tuple[str, dict[str, Any]]:
    found = read_relight_folder(place)
    lights = found.info.get("lights")
    facts: dict[str, Any] = {
        "shape": list(found.image_shape),
        "basis": _BASES[found.info["type"]],
        "colorspace": found.info["colorspace"],
        "planes": len(found.scale_p),
        "stored": "whole images" if isinstance(found.texels_hwp, ImageRows) else "tiles",
    }
    return "relight folder", facts | ({"lights": len(lights) // 3} if isinstance(lights, list) and lights else {})


def _light_facts(place: Path) -> tuple[str, dict[str, Any]]:
    if b"brdf-coefficients/" in read_start(place, 1 << 12)[0]:
        _brdf_facts(place)
    file = read_light_file(place)
    directions_i3 = unit_directions(file.directions_i3, file.label, allow_below=True)
    if not len(directions_i3):
        raise InputError(f"{place} holds no lights")
    degrees_i = np.degrees(np.arcsin(np.clip(directions_i3[:, 2], -1.0, 1.0)))
    facts: dict[str, Any] = {
        "lights": len(directions_i3),
        "elevation_range": [round(float(degrees_i.min()), 3), round(float(degrees_i.max()), 3)],
        "below_horizon": int((directions_i3[:, 2] < 0).sum()),
        "duplicates": count_duplicates(directions_i3),
        "images": list(file.names),
        "notes": [*file.notes, *file.count_notes()],
    }
    if place.suffix.lower() not in ENDINGS:
        return "list of lights", facts
    return "project of relight" if file.names else "dome of relight", facts


def _brdf_facts(place: Path) -> tuple[str, dict[str, Any]]:
    raise InputError(f"{place}: clrelight brdf info says what a reflectance holds")


_SUMMARIES = {
    ".ptm": _ptm_facts,
    ".rti": _rti_facts,
    **dict.fromkeys((".lp", ".txt", ".csv", *ENDINGS), _light_facts),
    ".brdf": _brdf_facts,
}
