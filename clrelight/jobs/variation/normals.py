"""Find the normals of a stack, under known, near or unknown lights, as maps in memory or as pictures."""

from __future__ import annotations

import os
import pathlib
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError, counted
from clrelight.images import write_image
from clrelight.jobs.inputs import StackLike, lend_stack, opened_on, path_text, paths_among, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.pictures import holds_floats
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.variation.normal_files import write_maps, write_ply
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.variation.heights import integrate_normals
from clrelight.variation.maps import NormalMap, Wanted, map_normals
from clrelight.variation.near_lights import NearLights, check_gains, read_gains, read_positions
from clrelight.variation.reflectance import LEAST_GLOSSY
from clrelight.variation.unknown import AMBIGUITY
from clrelight.variation.unknown_maps import map_unknown
from clrelight.variation.wanted import UnknownLight

GREENS = ("up", "down")
LIGHTINGS = ("known", "unknown")
_TOLD_FLOOR, _TOLD_GAP, _TOLD_RESIDUAL = 0.01, 0.1, 0.05

Path = str | os.PathLike[str]


def normals(
    source: StackLike,
    *,
    out: Path | None = None,
    method: str = "auto",
    green: str = "up",
    albedo: Path | None = None,
    confidence: Path | None = None,
    height: Path | None = None,
    ply: Path | None = None,
    transfer: str = "stack",
    field: float | None = None,
    positions: Path | NDArray | None = None,
    pixel: float | None = None,
    gains: Path | NDArray | None = None,
    lighting: str = "known",
    degree: int | None = None,
    concave: bool = False,
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NormalMap | Report:
    """Find the normal and the albedo of every pixel from its samples.

    Parameters
    ----------
    source : path or LightStack
        Its lights have one intensity, or the images were divided by theirs, or `gains` says what they are.
    out : path, optional
        A picture of the normals: floats as they are in ``.exr`` or ``.tif``; ``(n + 1) / 2`` in 16 bits in ``.png``.
        Without it the maps are returned.
    method : str
        ``"robust"``: gloss and matte reflectance of each pixel are found with its normal, shadows left out;
        ``"quick"``: gloss is left out too; ``"least-squares"``: all samples as they are; ``"auto"``: robust, or quick
        of large stacks.
    green : str
        Which way the second channel of pictures grows: ``"up"`` as in OpenGL (y up), ``"down"`` as in DirectX.
    albedo, confidence, height : path, optional
        Pictures of albedo, of confidence from 0 to 1, and of the height towards the camera in pixels (floats only).
    ply : path, optional
        The height as a mesh.
    transfer : str
        ``"stack"``: the curve the stack names; ``"linear"``, ``"srgb"``, or ``"auto"``: told from the samples.
    field : float, optional
        Degrees that the longer side of the images takes in the camera, 0 of one far away; default: told from gloss.
    positions : path or ndarray, shape (n_light, 3), optional
        Where near lights are, x right, y up, z to the camera from the middle of the image, instead of directions.
    pixel : float, optional
        Width of a pixel on the object in the unit of `positions`.
    gains : path, ndarray or "estimate", optional
        Intensities of lights that are still in the samples, (n_light,) or (n_light, channel).
    lighting : str
        ``"known"``, or ``"unknown"``: directions are not looked at, each image may be under any distant light.
    degree : int, optional
        Of unknown light: 1 (default) or 2.
    concave : bool
        Under unknown light, which of the two surfaces that cannot be told apart.
    memory : int or str
        Bytes that samples may take on their way; the maps come on top.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    NormalMap
        With `out` instead the report.

    Raises
    ------
    InputError
        If the lights do not determine normals, samples are no radiance or tell nothing, or a file cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    beside = {"albedo": albedo, "confidence": confidence, "height": height, "ply": ply}
    _check(out, beside, green)
    asked = _Asked(method, transfer, field, positions, pixel, gains, lighting, degree, concave)
    with (
        claimed([out, *beside.values()], [*paths_among(source), *asked.files], kept),
        opened_on(device, kept) as opened,
        lend_stack(source, kept) as stack,
    ):
        with stage(progress, "finding normals") as tell:
            found = asked.find(stack, opened, budget, tell, kept)
        if not (found.confidence_hw > 0.0).any():
            raise InputError("no pixel tells a normal: inside the mask all is black, clipped, or as under no lamp")
        _tell(found, stack, asked, kept)
        if out is None:
            return found
        since = time.perf_counter()
        heights_hw = None
        if height is not None or ply is not None:
            with stage(progress, "integrating"):
                heights_hw = integrate_normals(found.normals_hw3, stack.mask_hw)
            since = kept.add("integrate", since)
        with stage(progress, "writing"):
            write_maps(out, green, found, albedo, confidence)
            if heights_hw is not None and height is not None:
                write_image(height, heights_hw)
            if heights_hw is not None and ply is not None:
                write_ply(ply, heights_hw, found)
        kept.add("write", since)
    kept.facts["files"] = [os.fsdecode(each) for each in (out, *beside.values()) if each is not None]
    return kept


def _check(out: Path | None, beside: dict[str, Path | None], green: str) -> None:
    """Raise InputError where what is asked for does not go together."""
    if green not in GREENS:
        raise InputError(f"green must be up or down, got {green!r}")
    if out is None and any(beside.values()):
        raise InputError("pictures beside the normals need a picture of the normals: give out")
    height, ply = beside["height"], beside["ply"]
    if height is not None and not holds_floats(path_text(height, "heights")):
        raise InputError(f"heights are floats, for .exr or .tif, got {os.fsdecode(height)}")
    if ply is not None and not path_text(ply, "a mesh").lower().endswith(".ply"):
        raise InputError(f"a mesh goes to a .ply, got {os.fsdecode(ply)}")


@dataclass(frozen=True)
class _Asked:
    """What was asked of the lights and the method; fields as of `normals`."""

    method: str
    transfer: str
    field: float | None
    positions: Path | NDArray | None
    pixel: float | None
    gains: Path | NDArray | None
    lighting: str
    degree: int | None
    concave: bool

    def __post_init__(self) -> None:
        if self.lighting not in LIGHTINGS:
            raise InputError(f"lighting must be {' or '.join(LIGHTINGS)}, got {self.lighting!r}")
        if (self.positions is None) != (self.pixel is None):
            raise InputError("positions of lights and the width of a pixel on the object go together: give both")
        if self.field is not None and self.method in ("quick", "least-squares"):
            raise InputError(f"the {self.method} method does not look at the camera: leave out field, or use robust")
        without: dict[str, object] = {"degree": self.degree, "concave": self.concave or None}
        why = "only unknown light has: leave out"
        if self.lighting == "unknown":
            method = None if self.method == "auto" else self.method
            without = {"positions": self.positions, "gains": self.gains, "field": self.field, "method": method}
            why = "unknown light has no: leave out"
            if self.transfer == "auto":
                raise InputError("known lights tell the transfer curve: under unknown ones name linear or srgb")
        named = [name for name, value in without.items() if value is not None]
        if named:
            raise InputError(f"{why} {', '.join(named)}")

    @property
    def files(self) -> list[Path]:
        """What is read beside the stack."""
        return [each for each in paths_among(self.positions, self.gains) if each != "estimate"]

    def find(
        self, stack: LightStack, device: Device, memory_bytes: int, tell: Callable[[int, int], None], report: Report
    ) -> NormalMap:
        """Return the normals of a stack."""
        if self.lighting == "known":
            wanted = self._wanted(stack, report)
            return map_normals(
                stack, self.method, wanted, device=device, memory_bytes=memory_bytes, progress=tell, add_time=report.add
            )
        return map_unknown(
            stack,
            1 if self.degree is None else whole(self.degree, "degree"),
            concave=self.concave,
            transfer=None if self.transfer == "stack" else self.transfer,
            memory_bytes=memory_bytes,
            progress=tell,
            add_time=report.add,
        )

    def _wanted(self, stack: LightStack, report: Report) -> Wanted:
        """Return what is known of the lights, from files or arrays."""
        n_light, channel = stack.n_light, stack.image_shape[2]
        near, gains_ic = None, None
        if self.positions is not None and self.pixel is not None:
            if isinstance(self.positions, str | os.PathLike):
                near, notes = read_positions(pathlib.Path(self.positions), n_light, float(self.pixel))
                report.note(*notes)
            else:
                near = NearLights.of(np.asarray(self.positions, np.float64), n_light, float(self.pixel))
        estimate = isinstance(self.gains, str) and self.gains == "estimate"
        if isinstance(self.gains, str | os.PathLike) and not estimate:
            gains_ic = read_gains(pathlib.Path(self.gains), n_light, channel)
        elif self.gains is not None and not estimate:
            values = np.asarray(self.gains, np.float64)
            gains_ic = check_gains(values[:, None] if values.ndim == 1 else values, n_light, channel)
        field = None if self.field is None else float(self.field)
        return Wanted(near, gains_ic, estimate, self.transfer, field)


def _tell(found: NormalMap, stack: LightStack, asked: _Asked, report: Report) -> None:
    seen_hw, told = found.normals_hw3.any(axis=2), found.found
    report.facts |= {
        "method": found.method,
        "n_light": stack.n_light,
        "condition": found.condition,
        "pixels": int(np.count_nonzero(seen_hw)),
        "confidence_median": float(np.median(found.confidence_hw[seen_hw])) if seen_hw.any() else 0.0,
        "floor": found.floor,
        "transfer": told.transfer,
    }
    if asked.method == "auto" and found.method == "quick":
        report.note("large stack: gloss is left out instead of being found (quick); --method robust finds it")
    if found.method == "robust" and stack.n_light < LEAST_GLOSSY:
        few = counted(stack.n_light, "light does", "lights do")
        report.note(f"{few} not tell gloss, which {LEAST_GLOSSY} would: matte surfaces are assumed")
    if told.law is not None:
        report.facts |= {"law": told.law.text, "held_errors": told.tried}
    if told.curves:
        report.facts["curves"] = told.curves
        if told.better is not None:
            report.note(
                f"the samples follow {told.better} better than {told.transfer}, which the stack names: see --transfer"
            )
        elif told.is_close and asked.transfer == "auto":
            report.note(f"the samples hardly tell the transfer curve; {told.transfer} was taken, as the stack names it")
    if told.gains is not None:
        report.facts |= {"gains": told.gains.gains_i.tolist(), "gains_spread": told.gains.spread}
    if told.rounds > 1:
        report.facts["rounds"] = told.rounds
    if found.floor > _TOLD_FLOOR:
        report.note(
            f"shadows hold {found.floor:.1%} of the albedo: light from elsewhere, taken off before normals are found"
        )
    if told.light is not None:
        _tell_light(told.light, report)


def _tell_light(light: UnknownLight, report: Report) -> None:
    report.facts |= {
        "degree": light.degree,
        "energy": light.energy,
        "residual": light.residual,
        "gap": light.gap,
        "ambiguity": AMBIGUITY,
    }
    report.note(
        f"the light is not known: photographs tell normals up to {AMBIGUITY}, resolved since slopes are those of a "
        f"surface; of it and its inverse the {'concave' if light.concave else 'convex'} one was taken"
    )
    if light.gap > _TOLD_GAP or light.residual > _TOLD_RESIDUAL:
        report.note(
            f"do not rely on these normals: the law leaves {light.residual:.1%}, and the surface is told by "
            f"{light.gap:.2f} (0 well, 1 not at all)"
        )
