"""Show a view under any light: one direction, several, or light from everywhere."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.device import Device
from clrelight.jobs.farm import Farm
from clrelight.jobs.frames import Rotation
from clrelight.jobs.inputs import FittedLike, opened_on, path_text, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.relighting import name_frames, show_frames, take_how
from clrelight.jobs.relighting_farm import SharedFrames
from clrelight.jobs.report import Progress, Report, report_for
from clrelight.jobs.unfinished import seen_inputs, unfinished_images
from clrelight.lighting.light import Light


@overload
def relight(
    source: FittedLike,
    light: ArrayLike | Light | str | os.PathLike[str] | None = None,
    *,
    lights: str | os.PathLike[str] | None = None,
    out: None = None,
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    salvage: bool = False,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> NDArray[np.float32]: ...


@overload
def relight(
    source: FittedLike,
    light: ArrayLike | Light | str | os.PathLike[str] | None = None,
    *,
    lights: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str],
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    salvage: bool = False,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    farm: Farm | None = None,
) -> Report: ...


def relight(
    source: FittedLike,
    light: ArrayLike | Light | str | os.PathLike[str] | None = None,
    *,
    lights: str | os.PathLike[str] | None = None,
    out: str | os.PathLike[str] | None = None,
    exposure: float | str = 0.0,
    rotate: Rotation | None = None,
    turntable: int | None = None,
    about: Sequence[float] | None = None,
    tonemap: str | None = None,
    transfer: str | None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    salvage: bool = False,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    farm: Farm | None = None,
) -> NDArray[np.float32] | Report:
    """Return, or write, the view under a direction, under several, or under light from everywhere.

    Parameters
    ----------
    source : path, URL, CoefficientMap or Encoded
    light : array_like, Light or path, optional
        Three numbers, or rows of them: directions from the surface to the light, of any length. Or light from
        everywhere: a `Light`, or the path of a light file.
    lights : path, optional
        Directions from a file instead, an ``.lp`` or a table.
    out : path, optional
        Where to write. The name decides the format: ``.exr``, ``.hdr`` and ``.tif`` hold linear radiance as floats,
        ``.png``, ``.jpg`` and others 8-bit display values. For several images it holds a number field such as
        ``%03d``; a turntable may be a ``.gif`` or ``.apng``.
    exposure : float or str
        Stops: values are scaled by ``2**exposure``. ``"auto"`` (light from everywhere): so that hardly anything is
        clipped.
    rotate : float or (str, numbers), optional
        Turn light from everywhere: degrees about z, or a form and numbers of `rotation_matrix`.
    turntable : int, optional
        So many images, light from everywhere going round once.
    about : three numbers, optional
        Axis of the turntable; default: z.
    tonemap : str, optional
        ``"clip"`` or ``"reinhard"``: of 8-bit images under light from everywhere.
    transfer : str, optional
        ``"linear"`` or ``"srgb"``: curve of 8-bit files; default: the stack's.
    region : four whole numbers, optional
        Column and row of the first pixel, width and height: this part alone, in pixels of the whole image.
    level : int
        Width and height are halved so often, without decoding what is not shown (files of codec klt or wavelet).
    salvage : bool
        Show what is left of a damaged file of codec klt or wavelet: notes, and ``damaged`` in the report, say what is
        filled.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    farm : Farm, optional
        Other processes that make some of the pictures each; `source` and light files are files then.

    Returns
    -------
    ndarray, float32
        Linear radiance in units of the peak, not clipped: (height, width, channel) for three numbers and for light
        from everywhere, (n, height, width, channel) for rows of numbers, a file of directions and a turntable. With
        `out` instead the report.

    Raises
    ------
    InputError
        If a direction has no length, a file is damaged or none of ours, or `out` cannot be written.
    """
    target = None if out is None else path_text(out, "an image to write")
    how = take_how(exposure, rotate, turntable, about, tonemap, transfer, region, level, salvage)
    how.check(target)
    kept = report_for(report)
    inputs = seen_inputs([source, lights, light])
    frames, flat = how.frames(light, lights, kept)
    names = name_frames(target, frames)
    if farm is not None:
        given: dict[str, Any] = {"rotate": rotate, "turntable": turntable, "about": about, "region": region}
        given |= {"level": level or None, "tonemap": tonemap, "transfer": transfer, "salvage": salvage or None}
        with claimed(names, paths_among(source, light, lights), kept):
            unfinished = unfinished_images(names, inputs, [how, light, device, "farm"])
            SharedFrames.of(farm, source, light, lights, names, given).write(frames, how.exposure, kept, unfinished)
        kept.facts = {"files": names, **kept.facts}
        return kept
    with claimed(names, paths_among(source, light, lights), kept), opened_on(device, kept) as opened:
        unfinished = unfinished_images(names, inputs, [how, light, kept.device])
        images_ihwc = show_frames(frames, source, names, how, opened, kept, progress, unfinished)
    if target is not None:
        kept.facts = {"files": names, **kept.facts}
        return kept
    return images_ihwc[0] if flat else images_ihwc
