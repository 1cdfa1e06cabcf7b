"""Turn a folder of images under known lights into a stack file, streaming within a memory budget."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import TRANSFERS, default_peak
from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.image_set import check_covers, describe_headers, read_headers
from clrelight.images import BAND_BYTES, read_bands
from clrelight.lights import (
    INTENSITIES_FILE,
    MASK_FILE,
    NAMES_FILE,
    LightTable,
    count_duplicates,
    find_lights,
    horizon_note,
    length_note,
    parse_subset,
    unit_directions,
)
from clrelight.masks import read_mask
from clrelight.negatives import Negatives

# Half precision keeps 11 bits between these.
_HALF_SMALLEST, _HALF_LARGEST = 2.0**-14, 65504.0


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
class _Window:
    """The rows and columns of the images that the stack keeps."""

    row: int
    column: int
    height: int
    width: int

    @property
    def rows(self) -> tuple[int, int]:
        return self.row, self.row + self.height


@dataclass(frozen=True)
class _Values:
    """How code values of a file become those of the stack: as they are, or times a factor per light and channel."""

    dtype: np.dtype
    peak: float
    factors_ic: NDArray[np.float32] | None = None
    code_peak: float = 1.0

    def convert(self, band_hwc: NDArray, light: int) -> NDArray:
        if self.factors_ic is None:
            return band_hwc
        return np.multiply(band_hwc, self.factors_ic[light], dtype=np.float32)


@dataclass
class _Extremes:
    """Whether an image is black, or at the code of white or above, wherever pixels count.

    Floats have no such code: what is above 1.0 is not clipped.
    """

    white_code: float
    black: bool = True
    white: bool = True

    def take(self, band_hwc: NDArray, mask_hw: NDArray[np.bool_] | None) -> None:
        """Take in further rows of the image; once both are out of the question this costs nothing."""
        self.white = self.white and band_hwc.dtype.kind == "u"
        if mask_hw is not None and mask_hw.any():
            # One pixel decides nearly always, and spares picking out the others.
            self._look(band_hwc[np.unravel_index(mask_hw.argmax(), mask_hw.shape)])
            if self.black or self.white:
                self._look(band_hwc[mask_hw])
        elif mask_hw is None:
            self._look(band_hwc)

    def _look(self, values: NDArray) -> None:
        self.black = self.black and not values.any()
        self.white = self.white and bool(values.min() >= self.white_code)


@dataclass(frozen=True)
class _Source:
    """What is read: the images, the part of them that is kept, and how their values change."""

    headers: list[ImageHeader]
    window: _Window
    values: _Values
    negatives: Negatives = field(default_factory=Negatives)
    mask_hw: NDArray[np.bool_] | None = None
    extremes: Sequence[_Extremes] = ()

    @property
    def shape_ihwc(self) -> tuple[int, int, int, int]:
        return len(self.headers), self.window.height, self.window.width, self.headers[0].channels

    def bands(self, light: int, band_bytes: int) -> Iterator[tuple[int, NDArray]]:
        """Yield the stack's values of an image from top to bottom, with the first row of each band in the stack."""
        header = self.headers[light]
        for row, band_hwc in read_bands(header, self.window.rows, band_bytes):
            kept_hwc = _columns(band_hwc, self.window)
            if header.dtype.kind == "f":
                kept_hwc = self.negatives.clip(kept_hwc, light, f"image {header.path}", row, self.window.column)
            if self.extremes:
                at = row - self.window.row
                self.extremes[light].take(
                    kept_hwc, None if self.mask_hw is None else self.mask_hw[at : at + len(kept_hwc)]
                )
            yield row - self.window.row, self.values.convert(kept_hwc, light)


@dataclass(frozen=True)
class _Plan:
    """How the memory budget is spent: `workers` bands of `band_bytes` at once, and `n_held` whole images.

    With ``n_held = 0`` not even one image fits, and bands go to the file one by one.
    """

    workers: int
    band_bytes: int
    n_held: int


def ingest_folder(
    folder: str | os.PathLike[str],
    out_path: str | os.PathLike[str],
    *,
    lights: str | os.PathLike[str] | None = None,
    transfer: str = "linear",
    peak: float | None = None,
    crop: tuple[int, int, int, int] | None = None,
    mask: str | os.PathLike[str] | None = None,
    subset: str | None = None,
    allow_below: bool = False,
    divide_intensities: bool = True,
    layer: str | None = None,
    upright: bool = False,
    clip_negative: bool = False,
    memory_bytes: int = 1 << 30,
    name: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> IngestSummary:
    """Write the images of a folder and their lights to a stack file.

    All that headers and light files tell is checked before the first image is decoded, and each image is decoded
    once. Nothing appears at `out_path` unless everything is well.

    Parameters
    ----------
    folder : path
        Holds the images: gray or RGB; uint8, uint16, half or float; all alike.
    out_path : path
        The stack file to write.
    lights : path, optional
        An ``.lp`` file or a table of N×3 or 3×N numbers; found in the folder by default (see `find_lights`).
    transfer : str
        ``"linear"`` or ``"srgb"``: the curve between the code values and linear radiance.
    peak : float, optional
        Code value of the image files that means 1.0; the largest code of integers and 1.0 of floats by default.
    crop : (x, y, width, height), optional
        The pixels to keep; x from the left, y from the top.
    mask : path, optional
        An image of the size of the others; pixels where it is zero in all colours do not count. By default
        that of a DiLiGenT folder.
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
        Bound on decoded image data held at a time, without the decoders' own buffers.
    name : str, optional
        What tables call the stack; the folder's name by default.
    progress : callable, optional
        Called with (images done, images in all) after each image.

    Raises
    ------
    InputError
        Naming the file, line or light that is wrong.
    """
    # Imported late: the store is needed only when all else is known to be right.
    from clrelight.store import check_output, create_stack

    folder = Path(os.fsdecode(folder))
    if transfer not in TRANSFERS:
        raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {transfer!r}")
    if peak is not None and not (np.isfinite(peak) and peak > 0):
        raise InputError(f"peak must be a positive number, got {peak}")
    table = find_lights(folder, Path(os.fsdecode(lights)) if lights is not None else None)
    chosen = parse_subset(subset, len(table.images)) if subset is not None else list(range(len(table.images)))
    written_i3 = table.directions_i3[chosen]

    def label(light: int) -> str:
        return table.label(chosen[light])

    directions_i3 = unit_directions(written_i3, label, allow_below)
    headers = read_headers([table.images[i] for i in chosen], layer, upright)
    window = _place_crop(headers[0], crop)
    check_covers(headers, (window.column, window.row, window.width, window.height))
    values = _choose_values(table, headers[0], chosen, transfer, peak, divide_intensities)
    mask_path = Path(os.fsdecode(mask)) if mask is not None else table.mask
    mask_hw, mask_notes = (
        _read_mask(mask_path, headers[0], window, memory_bytes) if mask_path is not None else (None, [])
    )
    tables = [table.source, *(table.source.parent / name for name in (NAMES_FILE, INTENSITIES_FILE))]
    check_output(out_path, [*table.images, *tables, *([mask_path] if mask_path is not None else [])])
    white_code = float(peak) if peak is not None else default_peak(headers[0].dtype)
    extremes = [_Extremes(white_code) for _ in headers]
    source = _Source(headers, window, values, Negatives(clip_negative), mask_hw, extremes)
    plan = _plan_memory(source, memory_bytes)

    with (
        create_stack(
            Path(os.fsdecode(out_path)),
            shape_ihwc=source.shape_ihwc,
            dtype=values.dtype,
            directions_i3=directions_i3,
            peak=values.peak,
            transfer=transfer,
            weights_i=None,
            mask_hw=mask_hw,
            name=name if name is not None else folder.resolve().name,
            chunk_lights=max(1, plan.n_held),
        ) as images_ihwc,
        # Closed in any case, so that no decoder still runs when an error leaves this block.
        closing(_fill(images_ihwc, source, plan)) as steps,
    ):
        for done in steps:
            if progress is not None:
                progress(done, len(headers))
        negative_notes = source.negatives.conclude(values.code_peak)

    elevations = np.degrees(np.arcsin(np.clip(directions_i3[:, 2], -1.0, 1.0)))
    return IngestSummary(
        n_light=len(headers),
        image_shape=source.shape_ihwc[1:],
        dtype=values.dtype.name,
        transfer=transfer,
        peak=values.peak,
        duplicates=count_duplicates(directions_i3),
        below_horizon=int(np.count_nonzero(directions_i3[:, 2] < 0)),
        elevation_range=(float(elevations.min()), float(elevations.max())),
        notes=(
            *table.notes,
            *length_note(written_i3),
            *horizon_note(written_i3, label, allow_below),
            *_notes(table, folder, mask_path, values),
            *mask_notes,
            *describe_headers(headers),
            *negative_notes,
            *_frame_notes(source, chosen),
        ),
    )


def _place_crop(header: ImageHeader, crop: tuple[int, int, int, int] | None) -> _Window:
    if crop is None:
        return _Window(0, 0, header.height, header.width)
    x, y, width, height = crop
    if min(x, y) < 0 or min(width, height) < 1 or x + width > header.width or y + height > header.height:
        raise InputError(
            f"crop x={x} y={y} width={width} height={height} is empty or not within the images of "
            f"{header.width}×{header.height} pixels"
        )
    return _Window(y, x, height, width)


def _choose_values(
    table: LightTable, header: ImageHeader, chosen: list[int], transfer: str, peak: float | None, divide: bool
) -> _Values:
    code_peak = float(peak) if peak is not None else default_peak(header.dtype)
    if table.intensities_ic is None or not divide:
        return _Values(header.dtype, code_peak, code_peak=code_peak)
    if transfer != "linear":
        raise InputError(f"light intensities divide linear values only, got transfer {transfer!r}: do not divide them")
    intensities = table.intensities_ic
    if intensities.shape[1] not in (1, header.channels):
        raise InputError(
            f"{table.source.parent} gives {intensities.shape[1]} intensities a light, but images have "
            f"{header.channels} channel: do not divide them"
        )
    relative = intensities.mean() / intensities
    factors_ic = relative / code_peak
    # Codes are integers, so the smallest value but 0 is that of code 1.
    in_half = factors_ic.min() >= _HALF_SMALLEST and factors_ic.max() * 255 <= _HALF_LARGEST
    dtype = np.dtype(np.float16 if header.dtype == np.uint8 and in_half else np.float32)
    return _Values(dtype, 1.0, factors_ic[chosen].astype(np.float32), code_peak)


def _read_mask(
    path: Path, header: ImageHeader, window: _Window, memory_bytes: int
) -> tuple[NDArray[np.bool_], list[str]]:
    whole_hw, notes = read_mask(path, (header.height, header.width), min(BAND_BYTES, memory_bytes // 2))
    mask_hw = np.ascontiguousarray(_columns(whole_hw[slice(*window.rows)], window))
    if not mask_hw.any():
        raise InputError(f"mask {path} is zero everywhere in the pixels that are kept")
    return mask_hw, [f"mask {path.name} keeps {np.count_nonzero(mask_hw)} of {mask_hw.size} pixels", *notes]


def _plan_memory(source: _Source, memory_bytes: int) -> _Plan:
    header, values = source.headers[0], source.values
    n_image, *image_shape = source.shape_ihwc
    # A band exists as read, where it is divided as float32, and as it is written; and the one before it is
    # still alive while it is decoded.
    sizes = (header.dtype.itemsize, 4 if values.factors_ic is not None else 0, values.dtype.itemsize)
    growth = 2 * sum(sizes) / header.dtype.itemsize
    # Tiles may differ from file to file.
    row_step = max(h.row_step for h in source.headers)
    smallest = header.row_bytes * row_step
    bands_budget = memory_bytes / 4 / growth
    workers = int(max(1, min(os.cpu_count() or 1, n_image, bands_budget // smallest)))
    band_bytes = int(max(smallest, min(BAND_BYTES, bands_budget / workers)))
    n_fitting = int((memory_bytes - workers * band_bytes * growth) // (math.prod(image_shape) * values.dtype.itemsize))
    if n_fitting >= 1:
        n_block = math.ceil(n_image / n_fitting)
        # Blocks of nearly equal size: a small last one would waste room in its chunks.
        return _Plan(workers, band_bytes, math.ceil(n_image / n_block))
    if smallest * growth > memory_bytes:
        raise InputError(
            f"memory of {memory_bytes} bytes cannot hold {row_step} row(s) of {header.path}; "
            f"expected at least {math.ceil(smallest * growth)}"
        )
    return _Plan(1, int(memory_bytes / growth), 0)


def _fill(images_ihwc: Any, source: _Source, plan: _Plan) -> Generator[int, None, None]:
    """Write all images, whole chunks at a time where possible; yield how many are decoded after each."""
    chunk_lights, chunk_rows = images_ihwc.chunks[:2]
    if plan.n_held == 0:
        row_bytes = source.headers[0].row_bytes
        band_bytes = _multiple(plan.band_bytes // row_bytes, chunk_rows) * row_bytes
        for light in range(len(source.headers)):
            for row, band_hwc in source.bands(light, band_bytes):
                written = np.ascontiguousarray(band_hwc, dtype=source.values.dtype)
                images_ihwc[light : light + 1, row : row + len(written)] = written[None]
            yield light + 1
        return
    n_light, *image_shape = source.shape_ihwc
    n_held = plan.n_held if plan.n_held == n_light else _multiple(plan.n_held, chunk_lights)
    block_ihwc = np.empty((n_held, *image_shape), source.values.dtype)
    with ThreadPoolExecutor(plan.workers) as pool:
        for start in range(0, n_light, n_held):
            stop = min(start + n_held, n_light)
            tasks = [
                pool.submit(_decode_into, block_ihwc[i - start], source, i, plan.band_bytes) for i in range(start, stop)
            ]
            try:
                for done, task in enumerate(tasks, start=start + 1):
                    task.result()
                    yield done
            finally:
                for task in tasks:
                    task.cancel()
            images_ihwc[start:stop, 0 : image_shape[0]] = block_ihwc[: stop - start]


def _multiple(count: int, of: int) -> int:
    """Return the largest multiple that is not over `count`, or `count` where there is none."""
    return count - count % of if count > of else count


def _decode_into(target_hwc: NDArray, source: _Source, light: int, band_bytes: int) -> None:
    for row, band_hwc in source.bands(light, band_bytes):
        target_hwc[row : row + len(band_hwc)] = band_hwc


def _columns(band_hwc: NDArray, window: _Window) -> NDArray:
    return band_hwc[:, window.column : window.column + window.width]


def _notes(table: LightTable, folder: Path, mask_path: Path | None, values: _Values) -> Iterator[str]:
    if values.factors_ic is not None:
        yield f"divided by the light intensities; {values.peak:g} is white under a light of mean intensity"
    elif table.intensities_ic is not None:
        yield "not divided by the light intensities"
    if mask_path is None and (folder / MASK_FILE).is_file():
        yield f"{MASK_FILE} lies in the folder but was not asked for"


def _frame_notes(source: _Source, chosen: list[int]) -> Iterator[str]:
    """Yield which images are wholly black or white, as where a lamp failed, and what leaves them out."""
    sound = [light for light, each in zip(chosen, source.extremes, strict=True) if not (each.black or each.white)]
    subset = _subset_of(sound)
    instead = f"; --subset {subset} leaves them out" if sound and len(subset) <= 60 else ""
    for what, why, found in (
        ("black", "did the light fail?", [each.black for each in source.extremes]),
        ("white", "is it overexposed?", [each.white for each in source.extremes]),
    ):
        names = [header.path.name for header, is_so in zip(source.headers, found, strict=True) if is_so]
        if names:
            which = f"{len(names)} images are" if len(names) > 1 else "1 image is"
            listed = ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
            yield f"{which} wholly {what} ({why}): {listed}{instead}"


def _subset_of(lights: list[int]) -> str:
    """Return the subset that `parse_subset` reads as these lights."""
    runs: list[list[int]] = []
    for light in lights:
        if runs and light == runs[-1][1]:
            runs[-1][1] += 1
        else:
            runs.append([light, light + 1])
    return ",".join(f"{first}:{end}" for first, end in runs)
