"""The parts of `relight` as jobs: some of its pictures, as the bytes of their files."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clrelight.device import Device
from clrelight.jobs.farm import text_array, write_arrays
from clrelight.jobs.frames import LightFrames
from clrelight.jobs.inputs import opened_on
from clrelight.jobs.pictures import array_of, is_animation, show, write_view
from clrelight.jobs.relighting import take_how
from clrelight.jobs.report import Report, report_for


def relight_some(
    source: str | os.PathLike[str],
    light: ArrayLike | str | None = None,
    *,
    out: str | os.PathLike[str],
    some: Sequence[int],
    kind: str,
    lights: str | None = None,
    device: Device | str | None = None,
    report: Report | None = None,
    **asked: Any,
) -> Report:
    """Relight some of the pictures that `clrelight.jobs.relight.relight` would write.

    Parameters
    ----------
    source : path
        A fit or an encoded file.
    light, lights, device, report
        As of `clrelight.jobs.relight.relight`.
    out : path
        Gets ``picture0``, ``picture1``, ...: the bytes of files, or the values of an animation's pictures; ``count`` of
        them; ``told``, notes and device in JSON; of light from everywhere ``exposure`` and ``below``, the largest share
        of the light that comes from below the horizon.
    some : (first, end)
        Numbers of the pictures.
    kind : str
        Ending of their files.
    **asked
        See `clrelight.jobs.relighting.take_how`.

    Raises
    ------
    InputError
        As of `clrelight.jobs.relight.relight`.
    """
    kept, made = report_for(report), dict[str, NDArray]()
    how = take_how(**asked)
    frames = how.frames(light, lights, kept)[0].only(*some)
    folder = os.path.dirname(os.fsdecode(out))
    with (
        opened_on(device, kept) as opened,
        tempfile.TemporaryDirectory(prefix=".pictures.", dir=folder) as place,
        frames.lend(source, opened, kept, None) as (images, curve),
    ):
        for number, image in enumerate(images):
            if is_animation(kind):
                made[f"picture{number}"] = show(array_of(image), how.tonemap, how.transfer or curve)
            else:
                name = os.path.join(place, f"{number}{kind}")
                write_view(name, image, how.tonemap, how.transfer or curve)
                made[f"picture{number}"] = np.memmap(name, np.uint8, "r")  # which the system may take from memory
        facts = kept.facts if isinstance(frames, LightFrames) else {"exposure": 0.0, "below": -math.inf}
        told = text_array({"notes": kept.notes, "device": kept.device})
        numbers = {name: np.array(float(facts[name])) for name in ("exposure", "below")}
        write_arrays(out, {**made, **numbers, "count": np.array(frames.count), "told": told})
        made.clear()  # some systems remove no file that is mapped
    return kept
