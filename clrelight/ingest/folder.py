"""Turn a folder of images under known lights into a stack file, streaming within a memory budget."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.arrays import check_transfer
from clrelight.dataset import LightStack
from clrelight.directions import count_duplicates, horizon_note, length_note, unit_directions
from clrelight.errors import InputError
from clrelight.image_set import check_covers, describe_headers, read_headers
from clrelight.ingest.filling import fill_stack, plan_memory
from clrelight.ingest.photographs import Extremes, Photographs, Values, choose_values, keep_mask, place_crop
from clrelight.ingest.shrinking import plan_shrink, shrink_mask, shrink_notes
from clrelight.lights import INTENSITIES_FILE, MASK_FILE, NAMES_FILE, LightTable, find_lights, parse_subset
from clrelight.memory import IMAGE_MEMORY
from clrelight.negatives import Negatives


@dataclass(frozen=True)
class IngestSummary:
    """What was written, and what the user should know about it.

    Attributes
    ----------
    n_light : int
    image_shape : tuple of int
        Height, width and channels.
    dtype : str
        Type of the code values in the stack.
    transfer : str
    peak : float
        Code value that means 1.0.
    duplicates : int
        Lights that have the direction of an earlier one.
    below_horizon : int
        Lights with z < 0; more than 0 only where they were allowed.
    elevation_range : tuple of float
        Lowest and highest light, in degrees above the horizon.
    notes : tuple of str
        How the input was understood, one line each.
    """

    n_light: int
    image_shape: tuple[int, int, int]
    dtype: str
    transfer: str
    peak: float
    duplicates: int
    below_horizon: int
    elevation_range: tuple[float, float]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Folder:
    """Photographs whose headers and lights are known to be right, not read yet.

    Attributes
    ----------
    stack : LightStack
        What they will be; its images take no memory.
    source : Photographs
    chosen : list of int
        Which lights of the light file they are of.
    notes : tuple of str
        What is to be said before they are read.
    inputs : list of path
        Files that are read.
    """

    stack: LightStack
    source: Photographs
    chosen: list[int]
    notes: tuple[str, ...]
    inputs: list[Path]

    def summarize(self) -> IngestSummary:
        """Return what is to be said once they are read; InputError where a value is no radiance."""
        negative_notes = self.source.negatives.conclude(self.source.values.code_peak)
        return _summarize(self.stack, (*self.notes, *negative_notes, *self.source.extreme_notes(self.chosen)))


def ingest_folder(
    folder: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    *,
    memory_bytes: int = IMAGE_MEMORY,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> IngestSummary:
    """Write the images of a folder and their lights to a stack file.

    All that headers and light files tell is checked before the first image is decoded, and each image is decoded
    once. Nothing appears at `out_path` unless everything is well.

    Parameters
    ----------
    folder, **options
        As of `read_folder`.
    out_path : path
        The stack file to write.
    memory_bytes : int
        Bound on decoded image data held at a time, without the decoders' own buffers.
    progress : callable, optional
        Called with (images done, images in all) after each image.

    Raises
    ------
    InputError
        As `read_folder` does, and where the file cannot be written.
    """
    found = read_folder(folder, memory_bytes=memory_bytes, **options)
    return write_photographs(found, out_path, memory_bytes, progress)


def write_photographs(
    found: Folder,
    out_path: str | os.PathLike[str],
    memory_bytes: int = IMAGE_MEMORY,
    progress: Callable[[int, int], None] | None = None,
) -> IngestSummary:
    """Write photographs whose headers `read_folder` has read to a stack file, once; else as `ingest_folder`."""
    # Imported late: the store is needed only when all else is known to be right.
    from clrelight.store import check_output, create_stack

    check_output(out_path, found.inputs)
    plan = plan_memory(found.source, memory_bytes)
    with (
        create_stack(out_path, found.stack, chunk_lights=max(1, plan.n_held)) as images_ihwc,
        # Closed in any case, so that no decoder still runs when an error leaves this block.
        closing(fill_stack(images_ihwc, found.source, plan)) as steps,
    ):
        for done in steps:
            if progress is not None:
                progress(done, found.stack.n_light)
        return found.summarize()


def read_folder(
    folder: str | os.PathLike[str],
    *,
    lights: str | os.PathLike[str] | None = None,
    transfer: str | None = None,
    peak: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    mask: str | os.PathLike[str] | None = None,
    downscale: int | None = None,
    max_side: int | None = None,
    subset: str | None = None,
    allow_below: bool = False,
    divide_intensities: bool = True,
    layer: str | None = None,
    upright: bool = False,
    clip_negative: bool = False,
    memory_bytes: int = IMAGE_MEMORY,
    name: str | None = None,
) -> Folder:
    """Return the photographs of a folder and their lights, as headers and light files tell of them.

    Parameters
    ----------
    folder : path
        Holds the images: gray or RGB; uint8, uint16, half or float; all alike.
    lights : path, optional
        An ``.lp`` file or a table of N×3 or 3×N numbers; found in the folder by default (see `find_lights`).
    transfer : str, optional
        ``"linear"``, the default, or ``"srgb"``: the curve between the code values and linear radiance.
    peak : float, optional
        Code value of the image files that means 1.0; the largest code of integers and 1.0 of floats by default.
    crop : (x, y, width, height), optional
        The pixels to keep; x from the left, y from the top.
    mask : path, optional
        An image of the size of the others; pixels where it is zero in all colours do not count. By default
        that of a DiLiGenT folder.
    downscale : int, optional
        Average blocks of so many pixels squared, in linear radiance; those at the right and lower edge hold what is
        left. Pixels of the mask count then where at least half of their area does.
    max_side : int, optional
        Average so that the longer side of what is kept has so many pixels; images that have no more stay as they are.
    subset : str, optional
        Which lights to take, such as ``"0:200:2"`` or ``"1,5,9"``, counted from 0 in the order of the light file.
    allow_below : bool
        Accept lights with z < 0.
    divide_intensities : bool
        Divide the images of a DiLiGenT folder by its ``light_intensities.txt``. The stack then holds
        ``code / peak * mean / intensity`` with the mean over all lights and channels, so that 1.0, the stack's
        peak, is white under a light of mean intensity. White under a dimmer light comes out above 1; such values
        stay in the stack, and are clipped only where images are compared. Its type is float16 where the files are
        uint8 (11 bits keep 8), else float32. `subset` does not change these numbers.
    layer : str, optional
        Which layer of EXR images, or page of TIFFs, is read; see `image_parts.choose_picture`.
    upright : bool
        Turn images as their EXIF orientation says. By default it is only mentioned: a camera that looks down sets it
        at random, and the images of one that is fixed lie alike as they are stored.
    clip_negative : bool
        Set negative values of float images to 0, however large. By default only those within a thousandth of what is
        bright are, which lossy compression leaves; others are refused.
    memory_bytes : int
        Bound on what is held of a mask.
    name : str, optional
        What tables call the stack; the folder's name by default.

    Raises
    ------
    InputError
        Naming the file, line or light that is wrong.
    """
    folder, curve = Path(os.fsdecode(folder)), transfer or "linear"
    check_transfer(curve)
    if peak is not None and not (np.isfinite(peak) and peak > 0):
        raise InputError(f"peak must be a positive number, got {peak}")
    table = find_lights(folder, Path(os.fsdecode(lights)) if lights is not None else None)
    chosen = parse_subset(subset, len(table.images)) if subset is not None else list(range(len(table.images)))
    written_i3 = table.directions_i3[chosen]

    def label(light: int) -> str:
        return table.label(chosen[light])

    directions_i3 = unit_directions(written_i3, label, allow_below)
    headers = read_headers([table.images[i] for i in chosen], layer, upright)
    window = place_crop(headers[0], crop)
    check_covers(headers, (window.left, window.top, *window.shape[::-1]))
    values = choose_values(table, headers[0], chosen, curve, peak, divide_intensities)
    mask_path = Path(os.fsdecode(mask)) if mask is not None else table.mask
    mask_hw, mask_notes = keep_mask(mask_path, headers[0], window, memory_bytes)
    shrink = plan_shrink(*window.shape, downscale, max_side)
    tables = [table.source, *(table.source.parent / name for name in (NAMES_FILE, INTENSITIES_FILE))]
    extremes = [Extremes(values.code_peak) for _ in headers]
    source = Photographs(headers, window, values, Negatives(clip_negative), mask_hw, extremes, shrink, curve)
    blank_ihwc = np.broadcast_to(np.zeros((), values.dtype), source.shape_ihwc)
    title = folder.resolve().name if name is None else name
    stack = LightStack(
        blank_ihwc, directions_i3, values.peak, curve, None, shrink_mask(shrink, mask_hw, mask_path), title
    )
    notes = (
        *table.notes,
        *length_note(written_i3),
        *horizon_note(written_i3, label, allow_below),
        *_notes(table, folder, mask_path, values),
        *mask_notes,
        *shrink_notes(shrink, *window.shape, max_side),
        *describe_headers(headers, transfer),
    )
    inputs = [*table.images, *tables, *([mask_path] if mask_path is not None else [])]
    return Folder(stack, source, chosen, notes, inputs)


def _summarize(stack: LightStack, notes: tuple[str, ...]) -> IngestSummary:
    directions_i3 = stack.directions_i3
    elevations = np.degrees(np.arcsin(np.clip(directions_i3[:, 2], -1.0, 1.0)))
    return IngestSummary(
        n_light=stack.n_light,
        image_shape=stack.image_shape,
        dtype=stack.images_ihwc.dtype.name,
        transfer=stack.transfer,
        peak=stack.peak,
        duplicates=count_duplicates(directions_i3),
        below_horizon=int(np.count_nonzero(directions_i3[:, 2] < 0)),
        elevation_range=(float(elevations.min()), float(elevations.max())),
        notes=notes,
    )


def _notes(table: LightTable, folder: Path, mask_path: Path | None, values: Values) -> Iterator[str]:
    if values.factors_ic is not None:
        yield f"divided by the light intensities; {values.peak:g} is white under a light of mean intensity"
    elif table.intensities_ic is not None:
        yield "not divided by the light intensities"
    if mask_path is None and (folder / MASK_FILE).is_file():
        yield f"{MASK_FILE} lies in the folder but was not asked for"
