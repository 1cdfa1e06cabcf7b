"""Find the lights of photographs that came without: by glossy or matte spheres in them, or by the object itself."""

from __future__ import annotations

import csv as csv_format
import io
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.durable import replacing
from clrelight.errors import InputError, counted
from clrelight.images import write_image
from clrelight.jobs.inputs import StackLike, path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for
from clrelight.jobs.variation.light_doubts import RIVAL
from clrelight.jobs.variation.light_frames import Frames, lend_frames
from clrelight.jobs.variation.light_pictures import draw_spheres
from clrelight.jobs.variation.object_lights import lights_of_object
from clrelight.jobs.variation.sphere_lights import SphereLights, lights_of_sphere
from clrelight.jobs.variation.sphere_means import agree
from clrelight.jobs.variation.sphere_search import look_for_spheres
from clrelight.jobs.written import count_bytes
from clrelight.light_files import write_lp
from clrelight.memory import IMAGE_MEMORY
from clrelight.threads import on_one_thread
from clrelight.variation.circles import Circle

WAYS = ("sphere", "object")
KINDS = ("glossy", "matte")
_NAMED = 6
_LEAST_LOOKED_AT = 4
"""Photographs below which little tells a sphere that is looked for from other things that are round."""
_APART, _MOST_APART = "spheres apart", 2.0
"""What is told of a lamp that spheres place elsewhere, and degrees off their mean from which on."""
Path = str | os.PathLike[str]


@dataclass(frozen=True)
class FoundLights:
    """Lights of photographs.

    Attributes
    ----------
    names : tuple of str
        All photographs.
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors to the lamps, x right, y up, z to the camera; 0 where none was found.
    rows : tuple of dict
        Of each photograph what is told beside: ``elevation``, ``azimuth``, ``confidence``, ``residual``, ...
    """

    names: tuple[str, ...]
    directions_i3: NDArray[np.float64]
    rows: tuple[dict[str, Any], ...]


def find_lights(
    source: StackLike,
    *,
    out: Path | None = None,
    by: str = "sphere",
    kind: str = "glossy",
    spheres: Sequence[Sequence[float]] | None = None,
    count: int = 1,
    focal: float | None = None,
    normals: Path | None = None,
    albedo: Path | None = None,
    mask: Path | None = None,
    green: str = "up",
    transfer: str = "linear",
    csv: Path | None = None,
    picture: Path | None = None,
    memory: int | str = IMAGE_MEMORY,
    progress: Progress | None = None,
    report: Report | None = None,
) -> FoundLights | Report:
    """Find where the light of each photograph came from.

    Parameters
    ----------
    source : path or LightStack
        A folder of photographs, in natural order, or a stack, whose own lights are not used but compared.
    out : path, optional
        An ``.lp`` file; photographs without a light are left out of it, and named. Without it lights are returned.
    by : str
        ``"sphere"``: one or more in the photographs; ``"object"``: the shading of a matte object.
    kind : str
        Of the spheres: ``"glossy"``, by their highlights, or ``"matte"``, by their shading.
    spheres : sequence of (x, y, radius), optional
        In pixels, from 0 at the centre of the first; default: they are looked for.
    count : int
        Spheres that are looked for.
    focal : float, optional
        The camera's focal length in pixels; default: a camera far away.
    normals, albedo : path, optional
        Pictures of the object's normals, and of its albedo, as `normals` writes them. Without normals, lights and
        surface are found together, for lamps of equal intensity and an object that bulges.
    mask : path, optional
        Where the object is; default: the stack's mask, or everywhere.
    green : str
        Which way the second channel of `normals` grows.
    transfer : str
        Of a folder's photographs: ``"linear"`` or ``"srgb"``.
    csv, picture : path, optional
        A table of all lights; a picture of the spheres and their highlights.
    memory : int or str
        Bytes of samples that are held.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Raises
    ------
    InputError
        If photographs are not alike, no sphere or highlight is found, or the object does not tell lights.
    """
    kept, budget = report_for(report), count_bytes(memory)
    _check(out, by, kind, spheres, count, normals, albedo, mask, csv, picture)
    with (
        claimed([out, csv, picture], paths_among(source, normals, albedo, mask), kept),
        lend_frames(source, transfer, kept) as frames,
        on_one_thread(),
    ):
        told: list[SphereLights] = []
        if by == "object":
            directions_i3, rows = lights_of_object(frames, normals, albedo, mask, green, budget, progress, kept)
        else:
            circles = [Circle(*map(float, each)) for each in spheres or ()]
            if not circles:
                since = time.perf_counter()
                circles = look_for_spheres(frames, whole(count, "count"), kind == "matte", progress)
                kept.add("look", since)
                _note_few(len(frames.names), kept)
            is_given = spheres is not None
            told = [
                lights_of_sphere(frames, each, is_given, kind == "matte", focal, budget // len(circles), progress, kept)
                for each in circles
            ]
            directions_i3, rows = _rows(told, kind)
        found = FoundLights(frames.names, directions_i3, tuple(rows))
        _tell(found, frames, by, kind, told, kept)
        if out is None:
            return found
        seen = np.flatnonzero(directions_i3.any(axis=1))
        since = time.perf_counter()
        if csv is not None:
            _write_csv(csv, found)
        if picture is not None:
            write_image(picture, draw_spheres(frames, told, budget))
        write_lp(out, [frames.names[i] for i in seen], directions_i3[seen])
        kept.add("write", since)
    kept.facts["files"] = [os.fsdecode(each) for each in (out, csv, picture) if each is not None]
    return kept


def _note_few(count: int, report: Report) -> None:
    if count < _LEAST_LOOKED_AT:
        report.note(
            f"{count} photograph{'s' * (count > 1)} hardly tell{'s' * (count == 1)} a sphere from other things: look "
            "at --picture, or say where it is with --sphere"
        )


def _check(out, by, kind, spheres, count, normals, albedo, mask, csv, picture) -> None:  # type: ignore[no-untyped-def]
    for name, value, known in (("by", by, WAYS), ("kind", kind, KINDS)):
        if value not in known:
            raise InputError(f"{name} must be {' or '.join(known)}, got {value!r}")
    if out is not None and not path_text(out, "lights").lower().endswith(".lp"):
        raise InputError(f"lights go to a .lp, got {os.fsdecode(out)}")
    if out is None and (csv is not None or picture is not None):
        raise InputError("a table or a picture beside the lights needs a file of the lights: give out")
    if by == "object" and (spheres is not None or picture is not None):
        raise InputError("spheres, and a picture of them, are for lights by spheres, not by the object")
    if by == "sphere" and any(each is not None for each in (normals, albedo, mask)):
        raise InputError("normals, albedo and mask are of the object: ask for lights by the object")
    if albedo is not None and normals is None:
        raise InputError("an albedo needs the normals that it belongs to")
    if whole(count, "count") < 1:
        raise InputError(f"count must be at least 1, got {count}")
    for each in spheres or ():
        if len(each) != 3 or not np.all(np.isfinite(each)) or not each[2] > 2.0:
            raise InputError(f"a sphere is x, y and a radius of more than 2 pixels, got {','.join(map(str, each))}")


def _rows(told: Sequence[SphereLights], kind: str) -> tuple[NDArray[np.float64], list[dict]]:
    """Return lamps, and what is told of each."""
    directions_i3, apart_i = agree(told)
    rows = []
    for i, light_3 in enumerate(directions_i3):
        # What a highlight is worth: brighter than its rivals, and not much dimmer than those of other photographs.
        marks = [each.highlights[i] for each in told if each.highlights]
        seen = [each for each in marks if each is not None]
        best = max(seen, key=lambda each: each.height) if seen else None
        row: dict = {"confidence": 0.0, "degrees_a_pixel": None, "apart": None, "residual": None}
        row |= {"uncertain": None, "doubt": None}
        if light_3.any():
            row["degrees_a_pixel"] = float(np.min([each.degrees_a_pixel_i[i] for each in told]))
            row["apart"] = None if np.isnan(apart_i[i]) else float(apart_i[i])
            row["residual"] = float(np.nanmin([each.residual_i[i] for each in told]))
            telling = [each for each in told if each.lights_i3[i].any()]
            sure = [each for each in telling if not each.doubts[i]] or telling
            offs = [each.uncertain_i[i] for each in sure if np.isfinite(each.uncertain_i[i])]
            row["uncertain"] = float(np.min(offs)) if offs else None
            row["doubt"] = sure[0].doubts[i] or (_APART if apart_i[i] > _MOST_APART else None)
            row["confidence"] = 1.0 - row["residual"] if best is None else 1.0 - best.rival
        if kind == "glossy":
            row |= {
                "x": None if best is None else best.x,
                "y": None if best is None else best.y,
                "rival": None if best is None else best.rival,
                "clipped": None if best is None else best.clipped,
            }
        rows.append(row)
    return directions_i3, rows


def _tell(found: FoundLights, frames: Frames, by: str, kind: str, told: Sequence[SphereLights], report: Report) -> None:
    directions_i3 = found.directions_i3
    seen_i: NDArray[np.bool_] = np.any(directions_i3 != 0.0, axis=1)
    if not seen_i.any():
        what = "highlight" if by == "sphere" and kind == "glossy" else "light"
        raise InputError(f"no {what} is found in any of the {len(found.names)} photographs")
    for row, light_3, name in zip(found.rows, directions_i3, found.names, strict=True):
        is_seen = light_3.any()
        row |= {
            "image": name,
            "direction": light_3.tolist() if is_seen else None,
            "elevation": float(np.degrees(np.arcsin(np.clip(light_3[2], -1, 1)))) if is_seen else None,
            "azimuth": float(np.degrees(np.arctan2(light_3[1], light_3[0]))) if is_seen else None,
        }
    missing = [name for name, is_seen in zip(found.names, seen_i, strict=True) if not is_seen]
    if missing:
        what = "no highlight" if told and kind == "glossy" else "too little light"
        report.note(f"{what} in {_some(missing)}: left out of the lights")
    _note_doubts(found, report)
    below = int(np.count_nonzero(directions_i3[:, 2] < 0.0))
    if below:
        report.note(
            f"{counted(below, 'light is', 'lights are')} below the horizon: ingest takes them with --allow-below"
        )
    report.facts |= {
        "by": by,
        "kind": kind if by == "sphere" else None,
        "spheres": [[each.circle.x, each.circle.y, each.circle.radius] for each in told],
        "outlines": [{"seen": each.circle.outline, "off": each.circle.off} for each in told],
        "n_image": len(found.names),
        "n_light": int(seen_i.sum()),
        "lights": list(found.rows),
    }
    if frames.is_lit:
        cosine_i = np.sum(directions_i3 * frames.stack.directions_i3, axis=1)[seen_i]
        off_i = np.degrees(np.arccos(np.clip(cosine_i, -1.0, 1.0)))
        report.facts["off_known"] = {"median": float(np.median(off_i)), "most": float(off_i.max())}


def _note_doubts(found: FoundLights, report: Report) -> None:
    """Name the lights that are not to be trusted, by the reason."""
    by_reason: dict[str, list[str]] = {}
    for name, row in zip(found.names, found.rows, strict=True):
        if row.get("doubt"):
            by_reason.setdefault(row["doubt"], []).append(name)
    unsure = [name for name, row in zip(found.names, found.rows, strict=True) if (row.get("rival") or 0.0) > RIVAL]
    if unsure:
        report.note(f"more than one bright highlight in {_some(unsure)}: the brightest is taken")
    for reason, names in by_reason.items():
        report.note(f"not to be trusted ({reason}): {_some(names)}")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")


def _write_csv(path: Path, found: FoundLights) -> None:
    columns = [name for name in found.rows[0] if name not in ("image", "direction")]
    text = io.StringIO()
    table = csv_format.writer(text, lineterminator="\n")
    table.writerow(["image", "x", "y", "z", *(f"highlight_{c}" if c in "xy" else c for c in columns)])
    for row in found.rows:
        vector = row["direction"] or ("", "", "")
        table.writerow([row["image"], *vector, *("" if row[c] is None else row[c] for c in columns)])
    with replacing(os.fsdecode(path)) as part:
        part.write(text.getvalue().encode("utf-8"))
