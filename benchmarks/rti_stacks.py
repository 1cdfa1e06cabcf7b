"""The stacks that the RTI field measures on: SynthRTI and RealRTI, as CLRELIGHT_DATA has them."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack, split_lights
from clrelight.errors import InputError
from clrelight.jobs.ingest import ingest
from clrelight.jobs.report import Report

DATA_VARIABLE = "CLRELIGHT_DATA"
HOLDOUT = 5
_DOME, _TEST, _LIGHTS, _MASK = "Dome", "Test", "dirs.lp", "mask.png"


@dataclass(frozen=True)
class Source:
    """Where a stack lies, and which table it belongs to: Single, Multi or Real."""

    name: str
    group: str
    folder: Path


@dataclass(frozen=True)
class Case:
    """A stack with the lights to fit and those that no fit may see."""

    source: Source
    stack: LightStack
    fitted_i: NDArray[np.intp]
    unseen_i: NDArray[np.intp]

    @property
    def seen(self) -> LightStack:
        """The stack of the lights to fit."""
        return self.stack.select(self.fitted_i)

    @property
    def mask_hw(self) -> NDArray[np.bool_]:
        """The pixels that count."""
        whole = np.ones(self.stack.image_shape[:2], bool)
        return whole if self.stack.mask_hw is None else self.stack.mask_hw

    @property
    def example_light(self) -> int:
        """The unseen light that pictures are of: of median distance to the nearest light that was fitted."""
        cosine_ui = self.stack.directions_i3[self.unseen_i] @ self.stack.directions_i3[self.fitted_i].T
        order = np.argsort(cosine_ui.max(axis=1), kind="stable")
        return int(self.unseen_i[order[len(order) // 2]])


def find_stacks(patterns: Sequence[str] = ()) -> list[Source]:
    """Return the stacks in the folder that CLRELIGHT_DATA names whose names fit one of the patterns; all without any.

    Raises
    ------
    InputError
        If there is no folder, or no such stack in it.
    """
    if DATA_VARIABLE not in os.environ:
        raise InputError(f"{DATA_VARIABLE} must name the folder that holds stacks/synthrti and stacks/realrti")
    root = Path(os.environ[DATA_VARIABLE]) / "stacks"
    found = []
    for dome in sorted(root.glob(f"synthrti/**/{_DOME}")):
        if (dome.parent / _TEST).is_dir():
            place = dome.parent.relative_to(root / "synthrti")
            found.append(Source(place.as_posix(), place.parts[0], dome.parent))
    for lights in sorted(root.glob(f"realrti/*/{_LIGHTS}")):
        found.append(Source(f"Real/{lights.parent.name}", "Real", lights.parent))
    if not found:
        raise InputError(f"no stack in {root}/synthrti (folders with {_DOME} and {_TEST}) nor in {root}/realrti")
    chosen = [source for source in found if not patterns or any(fnmatch(source.name, p) for p in patterns)]
    if not chosen:
        raise InputError(f"no stack's name fits {', '.join(patterns)}; there are {', '.join(s.name for s in found)}")
    return chosen


def read_case(source: Source, transfer: str = "linear", pixels: int | None = None) -> Case:
    """Read a stack: SynthRTI is fitted to Dome and measured on Test, RealRTI keeps every fifth light for measuring.

    `pixels` keeps the middle so many of each side.
    """
    if source.group == "Real":
        stack = _read(source.folder, transfer)
        fitted_i, unseen_i = split_lights(stack.n_light, HOLDOUT)
    else:
        dome, test = (_read(source.folder / part, transfer) for part in (_DOME, _TEST))
        if dome.image_shape != test.image_shape:
            raise InputError(f"{source.name}: {_DOME} has images {dome.image_shape}, {_TEST} {test.image_shape}")
        stack = replace(
            dome,
            images_ihwc=np.concatenate([dome.images_ihwc, test.images_ihwc]),
            directions_i3=np.concatenate([dome.directions_i3, test.directions_i3]),
            weights_i=None,
        )
        fitted_i, unseen_i = np.arange(dome.n_light), np.arange(dome.n_light, stack.n_light)
    stack = replace(stack, name=source.name)
    return Case(source, stack if pixels is None else crop(stack, pixels), fitted_i, unseen_i)


def _read(folder: Path, transfer: str) -> LightStack:
    masks = [place / _MASK for place in (folder, folder.parent) if (place / _MASK).is_file()]
    stack: LightStack = ingest(
        folder, report=Report(), lights=folder / _LIGHTS, transfer=transfer, mask=masks[0] if masks else None
    )
    return replace(stack, notes=())


def crop(stack: LightStack, pixels: int) -> LightStack:
    """Return the middle so many pixels of each side; no mask where it would be empty."""
    rows, columns = (
        slice(max(0, (side - pixels) // 2), max(0, (side - pixels) // 2) + pixels) for side in stack.image_shape[:2]
    )
    mask_hw = None if stack.mask_hw is None else stack.mask_hw[rows, columns]
    if mask_hw is not None and not mask_hw.any():
        mask_hw = None
    return replace(stack, images_ihwc=np.ascontiguousarray(stack.images_ihwc[:, rows, columns]), mask_hw=mask_hw)
