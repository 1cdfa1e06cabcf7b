"""Light files: which image was taken under which light, from ``.lp`` files, tables of numbers and DiLiGenT folders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.directions import vector_text
from clrelight.errors import InputError
from clrelight.image_names import has_image, list_photographs, resolve_names
from clrelight.light_files import LightFile, read_light_file, read_table
from clrelight.text_rows import read_lines

DIRECTIONS_FILE = "light_directions.txt"
INTENSITIES_FILE = "light_intensities.txt"
NAMES_FILE = "filenames.txt"
MASK_FILE = "mask.png"

TABLE_STEMS = frozenset(("light_directions", "lights", "directions", "light_dirs", "dirs", "lightdirections"))
"""What a table of lights may be called that is found by itself, with the extension txt or csv."""


@dataclass(frozen=True)
class LightTable:
    """The images of a folder and the lights they were taken under, in the order of the light file.

    Attributes
    ----------
    source : Path
        The light file.
    images : tuple of Path
    directions_i3 : ndarray, shape (n_light, 3), float64
        As written: neither checked nor of unit length, see `unit_directions`.
    intensities_ic : ndarray, shape (n_light, 1 or 3), float64, optional
        Intensity of each light that is still in the images; positive.
    mask : Path, optional
        The mask that belongs to this layout of a folder.
    lines : tuple of int
        The line of each light in its file, from 1; empty where a line is no light.
    notes : tuple of str
        What the user should know about how the files were understood.
    """

    source: Path
    images: tuple[Path, ...]
    directions_i3: NDArray[np.float64]
    intensities_ic: NDArray[np.float64] | None = None
    mask: Path | None = None
    lines: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()

    def label(self, light: int) -> str:
        """Return how messages call a light: its number, counted from 0, and its image."""
        line = f" line {self.lines[light]}" if self.lines else ""
        return f"light {light} ({self.images[light].name}) of {self.source}{line}"


def find_lights(folder: Path, lights: Path | None = None) -> LightTable:
    """Return the images and lights of a folder.

    Parameters
    ----------
    folder : Path
        Where the images are.
    lights : Path, optional
        An ``.lp`` file, or a table of numbers. By default, what `folder` holds of: the three text files of
        DiLiGenT, exactly one ``.lp`` file, ``light_directions.txt``, ``lights.txt`` or another of `TABLE_STEMS`.

    Notes
    -----
    A table that lies beside DiLiGenT's other two files is read as DiLiGenT's. With any other table that names no
    images, they are those in `folder` in natural order (``9.png`` before ``10.png``), see `list_photographs`. Where
    an ``.lp`` file announces one image less than it lists and the last is missing, that light is left out.

    Raises
    ------
    InputError
        If nothing is found, a file does not parse (its line is named), or images and lights do not pair up.
    """
    if not folder.is_dir():
        raise InputError(f"there is no folder {folder}")
    source = lights if lights is not None else _detect(folder)
    if not source.is_file():
        raise InputError(f"there is no light file {source}")
    file = read_light_file(source)
    if file.names:
        return _table_of_names(folder, file)
    if all((source.parent / name).is_file() for name in (NAMES_FILE, INTENSITIES_FILE)):
        return _table_of_diligent(folder, file)
    return _table_of_numbers(folder, file)


def parse_subset(text: str, count: int) -> list[int]:
    """Return the indices that ``"0:200:2"`` or ``"3,1,-1"`` (or a list of both) chooses among `count`.

    Slices and negative indices are Python's. InputError if nothing or something twice is chosen.
    """
    chosen: list[int] = []
    for item in text.split(","):
        try:
            parts = [int(part) if part.strip() else None for part in item.split(":")]
            if len(parts) > 3 or (len(parts) == 1 and parts[0] is None):
                raise ValueError
            picked = range(count)[slice(*parts)] if len(parts) > 1 else [range(count)[parts[0] or 0]]
        except IndexError:
            raise InputError(f"subset {text!r}: there is no light {item.strip()}, only 0 to {count - 1}") from None
        except ValueError:
            raise InputError(f"subset {text!r}: expected slices or indices such as 0:200:2 or 1,5,9") from None
        chosen.extend(picked)
    if not chosen:
        raise InputError(f"subset {text!r} chooses none of the {count} lights")
    if len(set(chosen)) != len(chosen):
        twice = next(i for i in chosen if chosen.count(i) > 1)
        raise InputError(f"subset {text!r} chooses light {twice} twice")
    return chosen


def subset_text(lights: list[int]) -> str:
    """Return the subset that `parse_subset` reads as these lights."""
    runs: list[list[int]] = []
    for light in lights:
        if runs and light == runs[-1][1]:
            runs[-1][1] += 1
        else:
            runs.append([light, light + 1])
    return ",".join(f"{first}:{end}" for first, end in runs)


def _detect(folder: Path) -> Path:
    directions = folder / DIRECTIONS_FILE
    if all((folder / name).is_file() for name in (NAMES_FILE, DIRECTIONS_FILE, INTENSITIES_FILE)):
        return directions
    files = sorted(p for p in folder.iterdir() if p.is_file() and not p.name.startswith("."))
    for found in (
        [p for p in files if p.suffix.lower() == ".lp"],
        [p for p in files if p.name.lower() == DIRECTIONS_FILE],
        [p for p in files if p.stem.lower() in TABLE_STEMS and p.suffix.lower() in (".txt", ".csv")],
    ):
        if len(found) > 1:
            what = f".lp files ({', '.join(p.name for p in found[:4])})"
            if found[0].suffix.lower() != ".lp":
                what = f"tables of lights ({', '.join(p.name for p in found[:4])})"
            raise InputError(f"{folder} holds {len(found)} {what}: name one with --lights")
        if found:
            return found[0]
    if not files:
        raise InputError(f"{folder} holds no files, so neither photographs nor their lights")
    raise InputError(
        f"no lights in {folder}: looked for {NAMES_FILE} with {DIRECTIONS_FILE} and {INTENSITIES_FILE}, "
        f"for one .lp file, for {DIRECTIONS_FILE} and for lights.txt; name a light file with --lights, "
        "or find the lights in the photographs (clrelight find-lights)"
    )


def _table_of_names(folder: Path, file: LightFile) -> LightTable:
    names, directions_i3, lines = file.names, file.directions_i3, file.lines
    if file.announced == len(names) - 1 > 0 and not has_image(folder, names[-1]):
        # The number says that there is one image less, and so does the folder.
        names, directions_i3, lines = names[:-1], directions_i3[:-1], lines[:-1]
    images, notes = resolve_names(folder, names, file.source, lambda light: f"light {light}{_at(lines, light)}")
    return LightTable(
        file.source, images, directions_i3, lines=lines, notes=(*file.notes, *file.count_notes(len(names)), *notes)
    )


def _at(lines: tuple[int, ...], light: int) -> str:
    return f" (line {lines[light]})" if lines else ""


def _table_of_diligent(folder: Path, file: LightFile) -> LightTable:
    directions_i3, beside = file.directions_i3, file.source.parent
    names = [line.strip("\"'") for _, line in read_lines(beside / NAMES_FILE)[0]]
    if names and names[0] == str(len(names) - 1) and not has_image(folder, names[0]):
        del names[0]  # a count
    if len(names) != len(directions_i3):
        raise InputError(
            f"{beside / NAMES_FILE} names {len(names)} images, but {file.source} {len(directions_i3)} light directions"
        )
    intensities_ic, intensity_notes = _intensities(beside / INTENSITIES_FILE, len(names))
    images, notes = resolve_names(folder, names, beside / NAMES_FILE, lambda light: f"light {light}")
    bad = np.flatnonzero(~(np.isfinite(intensities_ic) & (intensities_ic > 0)).all(axis=1))
    if bad.size:
        raise InputError(
            f"light {bad[0]} ({images[bad[0]].name}) has intensity {vector_text(intensities_ic[bad[0]])} in "
            f"{beside / INTENSITIES_FILE}, expected positive numbers"
        )
    mask = folder / MASK_FILE
    return LightTable(
        file.source,
        images,
        directions_i3,
        intensities_ic,
        mask if mask.is_file() else None,
        file.lines,
        (*file.notes, *file.count_notes(), *intensity_notes, *notes),
    )


def _intensities(path: Path, count: int) -> tuple[NDArray[np.float64], list[str]]:
    """Return (count, 1 or 3) intensities from a table with a line or, if that alone fits, a column a light."""
    values = read_table(path)
    if values.shape in ((count, 1), (count, 3)):
        return values, []
    if values.shape in ((1, count), (3, count)):
        return values.T.copy(), [f"{path.name} has one light a column"]
    raise InputError(f"{path} holds {values.shape[0]}×{values.shape[1]} numbers, expected {count}×3")


def _table_of_numbers(folder: Path, file: LightFile) -> LightTable:
    images, notes = list_photographs(folder, len(file.directions_i3), file.source)
    if len(file.directions_i3) == 3 and not file.lines:
        notes.append(f"{file.source.name}: a 3×3 table has one light a row, unless its columns alone are unit vectors")
    return LightTable(
        file.source, images, file.directions_i3, lines=file.lines, notes=(*file.notes, *file.count_notes(), *notes)
    )
