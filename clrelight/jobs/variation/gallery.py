"""A folder of subjects, each of which is normals and albedo, a stack, or a few photographs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.errors import InputError
from clrelight.image_names import list_series, natural_key
from clrelight.images import IMAGE_EXTENSIONS, read_header, read_image
from clrelight.jobs.report import Report
from clrelight.jobs.variation.components import read_normals
from clrelight.jobs.variation.light_frames import Frames, lend_frames
from clrelight.light_files import read_light_file
from clrelight.variation.maps import SampleReader
from clrelight.variation.recognition import Space, spaces_of_normals, spaces_of_photographs

_STACK = (".h5", ".hdf5")
_MOST_PHOTOGRAPHS = 256


@dataclass(frozen=True)
class Subject:
    """What is kept of a subject, all pictures shrunk by the same factor.

    Attributes
    ----------
    name : str
    kind : str
        ``"normals"``, ``"stack"`` or ``"photographs"``.
    mask_hw : ndarray, shape (height, width), bool
    values : tuple
        Normals (height, width, 3) and albedo (height, width, channel); or photographs (n_light, height, width,
        channel) and directions, None where these are unknown.
    """

    name: str
    kind: str
    mask_hw: NDArray[np.bool_]
    values: tuple[NDArray, NDArray | None]

    @property
    def channels(self) -> int:
        """Channels of its pictures."""
        pictures = self.values[1] if self.kind == "normals" else self.values[0]
        assert pictures is not None
        return int(pictures.shape[-1])

    def grey(self) -> Subject:
        """Return it with the means of its channels, which white light shows."""
        first, second = self.values
        if self.kind != "normals":
            return replace(self, values=(first.mean(axis=-1, keepdims=True), second))
        assert second is not None
        return replace(self, values=(first, second.mean(axis=-1, keepdims=True)))

    def spaces(self, inside_hw: NDArray[np.bool_], names: tuple[str, ...]) -> dict[str, Space]:
        """Return its spaces over some pixels."""
        first, second = self.values
        if self.kind == "normals":
            assert second is not None
            inside_p = self.mask_hw[inside_hw][:, None]
            return spaces_of_normals(first[inside_hw], np.where(inside_p, second[inside_hw], 0.0), names)
        return spaces_of_photographs(first[:, inside_hw], second, names)


def read_gallery(folder: Path, side: int, transfer: str, green: str, report: Report) -> tuple[list[Subject], int]:
    """Return the subjects of a folder in the order of their names, and the factor that pictures were shrunk by.

    Folders without pictures are left out, with a note.

    Raises
    ------
    InputError
        If there are fewer than two, one cannot be read, or sizes differ.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}")
    entries = sorted(
        (p for p in folder.iterdir() if not p.name.startswith(".") and (p.is_dir() or p.suffix.lower() in _STACK)),
        key=lambda p: natural_key(p.name),
    )
    empty = [entry for entry in entries if entry.is_dir() and not _holds_pictures(entry)]
    entries = [entry for entry in entries if entry not in empty]
    if len(entries) < 2:
        without = f", and {len(empty)} folders without pictures" if empty else ""
        raise InputError(f"{folder} holds {len(entries)} subjects{without}; expected two or more folders or stacks")
    for entry in empty:
        report.note(f"{entry.name} holds no pictures: left out")
    subjects, first = [], ""
    shape: tuple[int, int] | None = None
    factor = 1
    for entry in entries:
        found = _normals_of(entry)
        whole_hw = _size_of(entry, found, transfer, report)
        if shape is None:
            shape, first = whole_hw, entry.name
            factor = max(1, -(-max(shape) // side))
        if whole_hw != shape:
            raise InputError(
                f"{entry} is {whole_hw[1]}×{whole_hw[0]}, but {first} {shape[1]}×{shape[0]}: subjects must lie alike"
            )
        subjects.append(_read(entry, found, factor, transfer, green, report))
    return subjects, factor


def _holds_pictures(entry: Path) -> bool:
    if _normals_of(entry) is not None:
        return True
    try:
        return bool(list_series(entry))
    except InputError:
        return False


def _normals_of(entry: Path) -> tuple[Path, Path | None] | None:
    """Return the pictures of normals and of albedo in a folder, if it holds any."""
    if not entry.is_dir():
        return None
    found = {
        what: [p for p in sorted(entry.iterdir()) if p.stem.lower() == what and p.suffix.lower() in IMAGE_EXTENSIONS]
        for what in ("normals", "albedo")
    }
    for what, files in found.items():
        if len(files) > 1:
            raise InputError(f"{entry} holds {files[0].name} and {files[1].name}: which {what} are meant?")
    return (found["normals"][0], found["albedo"][0] if found["albedo"] else None) if found["normals"] else None


def _size_of(entry: Path, found: tuple[Path, Path | None] | None, transfer: str, report: Report) -> tuple[int, int]:
    if found is not None:
        header = read_header(found[0])
    elif entry.is_dir():
        header = read_header(list_series(entry)[0])
    else:
        with lend_frames(entry, transfer, report) as frames:
            return frames.shape_hw
    return header.height, header.width


def _read(
    entry: Path, found: tuple[Path, Path | None] | None, factor: int, transfer: str, green: str, report: Report
) -> Subject:
    if found is not None:
        normals_p3, inside_hw = read_normals(found[0], green)
        normals_hw3 = np.zeros((*inside_hw.shape, 3), np.float32)
        normals_hw3[inside_hw] = normals_p3
        albedo_hwc = np.ones((*inside_hw.shape, 1), np.float32)
        if found[1] is not None:
            albedo_hwc = read_linear(found[1], "linear")
            if albedo_hwc.shape[:2] != inside_hw.shape:
                raise InputError(f"{found[1]} and {found[0].name} differ in size")
        return _of_normals(entry.name, normals_hw3, albedo_hwc, inside_hw, factor)
    with lend_frames(entry, transfer, report) as frames:
        directions_i3 = frames.stack.directions_i3 if frames.is_lit else _lights_of(entry, frames)
        if len(frames.names) > _MOST_PHOTOGRAPHS:
            chosen = np.linspace(0, len(frames.names) - 1, _MOST_PHOTOGRAPHS).round().astype(int)
        else:
            chosen = np.arange(len(frames.names))
        samples_ihwc = _colours(frames, chosen.tolist(), factor)
        mask_hw = frames.stack.mask_hw
        small_hw = shrink((np.ones(frames.shape_hw, bool) if mask_hw is None else mask_hw)[:, :, None], factor)
        known = None if directions_i3 is None else directions_i3[chosen]
        kind = "photographs" if known is None else "stack"
        return Subject(
            entry.stem if entry.is_file() else entry.name, kind, small_hw[:, :, 0] > 0.5, (samples_ihwc, known)
        )


def _of_normals(name: str, normals_hw3: NDArray, albedo_hwc: NDArray, inside_hw: NDArray, factor: int) -> Subject:
    small_hw3, albedo_hwc = shrink(normals_hw3, factor), shrink(albedo_hwc, factor)
    length_hw = np.linalg.norm(small_hw3, axis=2)
    mask_hw = (shrink(inside_hw[:, :, None], factor)[:, :, 0] > 0.5) & (length_hw > 0.1)
    small_hw3 = np.where(mask_hw[:, :, None], small_hw3 / np.maximum(length_hw, 1e-9)[:, :, None], [0.0, 0.0, 1.0])
    return Subject(name, "normals", mask_hw, (small_hw3, albedo_hwc))


def _lights_of(entry: Path, frames: Frames) -> NDArray[np.float64] | None:
    """Return the unit directions of the one .lp file in a folder, in the order of its photographs."""
    files = sorted(p for p in entry.iterdir() if p.suffix.lower() == ".lp")
    if not files:
        return None
    if len(files) > 1:
        raise InputError(f"{entry} holds {len(files)} .lp files, expected one")
    file = read_light_file(files[0])
    known = {Path(name.replace("\\", "/")).name: row for name, row in zip(file.names, file.directions_i3, strict=True)}
    missing = [name for name in frames.names if name not in known]
    if missing:
        raise InputError(f"{files[0]} does not name {missing[0]}")
    directions_i3 = np.array([known[name] for name in frames.names])
    return directions_i3 / np.linalg.norm(directions_i3, axis=1, keepdims=True)


def _colours(frames: Frames, lights: Sequence[int], factor: int) -> NDArray[np.float32]:
    """Return linear photographs, (n_light, height, width, channel), shrunk."""
    reader, pictures = SampleReader(frames.stack), []
    for light in lights:
        if frames.headers is not None:
            codes_hwc = read_image(frames.headers[light])
        else:
            codes_hwc = np.asarray(frames.stack.images_ihwc[light])
        linear_cip = reader.linear(codes_hwc.reshape(1, -1, codes_hwc.shape[2]))
        pictures.append(shrink(linear_cip[:, 0].T.reshape(codes_hwc.shape), factor))
    return np.stack(pictures)


def shrink(values_hwc: NDArray, factor: int) -> NDArray[np.float32]:
    """Return means of blocks of `factor` pixels squared; those at the right and lower edge hold what is left."""
    height, width = values_hwc.shape[:2]
    rows, columns = np.arange(0, height, factor), np.arange(0, width, factor)
    sums_hwc = np.add.reduceat(np.add.reduceat(values_hwc.astype(np.float32), rows, axis=0), columns, axis=1)
    counts = np.minimum(factor, height - rows)[:, None] * np.minimum(factor, width - columns)
    return sums_hwc / counts[:, :, None].astype(np.float32)


def read_linear(path: str | os.PathLike[str], transfer: str) -> NDArray[np.float32]:
    """Return a picture's linear values, (height, width, channel), the largest code of integers as 1."""
    image_hwc = read_image(path)
    values_hwc = image_hwc.astype(np.float32)
    if image_hwc.dtype.kind == "u":
        values_hwc /= np.float32(np.iinfo(image_hwc.dtype).max)
    if not np.isfinite(values_hwc).all():
        raise InputError(f"{os.fsdecode(path)} holds values that are not finite")
    return srgb_to_linear(values_hwc, np.float32) if transfer == "srgb" else values_hwc
