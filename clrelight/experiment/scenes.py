"""The scenes of an experiment: opening them, telling them apart, and what one look at all images tells."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import TRANSFERS
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.experiment.grid import Experiment
from clrelight.memory import PIECE_BYTES
from clrelight.passes import stack_rows
from clrelight.relight import to_display
from clrelight.store import open_stack
from datasets_synth.scenes import SCENES

PICTURE_LIGHT = np.array([0.5, 0.5, math.sqrt(0.5)])
"""Pictures show the light nearest to this direction."""
MAX_PICTURE_SIDE = 512


def scene_name(scene: str) -> str:
    """Return what progress calls a scene that is not open yet."""
    return scene if scene in SCENES else Path(scene).stem


def check_names(experiment: Experiment) -> None:
    """Raise InputError where rows could not tell two scenes apart."""
    owners: dict[str, str] = {}
    for scene in experiment.scenes:
        if scene in SCENES:
            name = SCENES[scene].stack_name(experiment.synth.get(scene, {}))
        else:
            with open_stack(scene) as stack:
                name = stack.name
        if name in owners:
            raise InputError(f"{owners[name]} and {scene} are both named {name!r}: ingest one with another --name")
        owners[name] = scene


def read_notes(experiment: Experiment) -> list[str]:
    """Return what the files of stacks left open, and how it is taken."""
    notes = []
    for scene in experiment.scenes:
        if scene not in SCENES:
            with open_stack(scene) as stack:
                notes += [f"{scene}: {note}" for note in stack.notes]
    return notes


@contextmanager
def open_scene(
    scene: str, experiment: Experiment, *, progress: Callable[[int, int], None] | None = None
) -> Iterator[LightStack]:
    """Lend the stack of a scene; what has no file is rendered, and `progress` called with parts done and in all."""
    if scene not in SCENES:
        with open_stack(scene) as stack:
            yield stack
        return
    made, options = SCENES[scene], experiment.synth.get(scene, {})
    yield replace(made.render(options, progress), name=made.stack_name(options))


@dataclass(frozen=True)
class Survey:
    """What one look at all images tells.

    Attributes
    ----------
    fingerprint : str
        Checksum of everything that a fit or a measurement sees.
    light : int
        The light that pictures show.
    picture_hwc : ndarray, uint8
        Its photograph, small enough for a report.
    column : int
        The typical pixel: the median, of all that are not black, of the means over the lights.
    """

    fingerprint: str
    light: int
    picture_hwc: NDArray[np.uint8]
    column: int


def survey_stack(stack: LightStack) -> Survey:
    """Read all images once; InputError names a sample that is negative or not finite."""
    light = int(np.argmax(stack.directions_i3 @ PICTURE_LIGHT))
    _, width, channel = stack.image_shape
    sum32 = zlib.crc32(repr((stack.n_light, stack.image_shape, stack.peak, stack.transfer)).encode())
    for array in (stack.directions_i3, stack.weights_i, stack.mask_hw):
        sum32 = zlib.crc32(b"" if array is None else np.ascontiguousarray(array).tobytes(), sum32)
    step = max(1, PIECE_BYTES // (stack.n_light * width * channel))
    means, rows = [], []
    with stack_rows(stack, step) as tiles:
        for _, _, tile_ihwc in tiles:
            sum32 = zlib.crc32(tile_ihwc.data.cast("B"), sum32)
            means.append(tile_ihwc.mean(axis=0, dtype=np.float64).ravel())
            rows.append(tile_ihwc[light].astype(np.float32) / stack.peak)
    mean_p = np.concatenate(means)
    order = np.argsort(mean_p, kind="stable")
    lit = order[mean_p[order] > 0]
    # The photograph is in the stack's transfer already, which is what a display gets.
    shown = shrink_picture(to_display(np.concatenate(rows), TRANSFERS[0]))
    return Survey(f"{sum32:08x}", light, shown, int(lit[len(lit) // 2]) if len(lit) else 0)


def shrink_picture(image_hwc: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image averaged over square blocks until no side is above `MAX_PICTURE_SIDE`."""
    height, width, channel = image_hwc.shape
    block = -(-max(height, width) // MAX_PICTURE_SIDE)
    if block == 1:
        return image_hwc
    kept = image_hwc[: height // block * block, : width // block * block]
    blocks = kept.reshape(height // block, block, width // block, block, channel)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)
