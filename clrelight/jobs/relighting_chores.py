"""The parts of `relight` as jobs: some of its pictures, as the bytes of their files."""

from __future__ import annotations

import json
import math
import os
import tempfile
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.device import Device
from clrelight.jobs.farm import write_arrays
from clrelight.jobs.frames import LightFrames, Rotation
from clrelight.jobs.inputs import opened_on
from clrelight.jobs.pictures import array_of, is_animation, show, write_view
from clrelight.jobs.region import take_part
from clrelight.jobs.relighting import How
from clrelight.jobs.report import Report, report_for
from clrelight.jobs.written import count_stops


def relight_some(
    source: str | os.PathLike[str],
    light: ArrayLike | str | None = None,
    *,
    out: str | os.PathLike[str],
    some: Sequence[int],
    kind: str,
    lights: str | None = None,
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
    report: Report | None = None,
) -> Report:
    """Relight some of the pictures that `clrelight.jobs.relight.relight` would write.

    Parameters
    ----------
    source : path
        A fit or an encoded file.
    light, lights, exposure, rotate, turntable, about, tonemap, transfer, region, level, salvage, device, report
        As of `clrelight.jobs.relight.relight`.
    out : path
        Gets ``picture0``, ``picture1``, ...: the bytes of files, or the values of an animation's pictures; ``count`` of
        them; ``told``, notes and device in JSON; of light from everywhere ``exposure`` and ``below``, the largest share
        of the light that comes from below the horizon.
    some : (first, end)
        Numbers of the pictures.
    kind : str
        Ending of their files.

    Raises
    ------
    InputError
        As of `clrelight.jobs.relight.relight`.
    """
    kept, made = report_for(report), dict[str, NDArray]()
    how = How(count_stops(exposure), rotate, turntable, about, tonemap, transfer, take_part(region, level), salvage)
    frames = how.frames(light, lights, kept)[0].only(*some)
    folder = os.path.dirname(os.fsdecode(out))
    with (
        opened_on(device, kept) as opened,
        tempfile.TemporaryDirectory(prefix=".pictures.", dir=folder) as place,
        frames.lend(source, opened, kept, None) as (images, curve),
    ):
        for number, image in enumerate(images):
            content: NDArray[np.uint8]
            if is_animation(kind):
                content = show(array_of(image), tonemap, transfer or curve)
            else:
                name = os.path.join(place, f"{number}{kind}")
                write_view(name, image, tonemap, transfer or curve)
                content = np.fromfile(name, np.uint8)
            made[f"picture{number}"] = content
    facts = kept.facts if isinstance(frames, LightFrames) else {"exposure": 0.0, "below": -math.inf}
    told = np.frombuffer(json.dumps({"notes": kept.notes, "device": kept.device}).encode("ascii"), np.uint8)
    numbers = {name: np.array(float(facts[name])) for name in ("exposure", "below")}
    write_arrays(out, {**made, **numbers, "count": np.array(frames.count), "told": told})
    return kept
