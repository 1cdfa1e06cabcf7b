"""Light files: which image was taken under which light, from ``.lp`` files, tables of numbers and DiLiGenT folders."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.images import IMAGE_EXTENSIONS
from clrelight.store.durable import replacing

DIRECTIONS_FILE = "light_directions.txt"
INTENSITIES_FILE = "light_intensities.txt"
NAMES_FILE = "filenames.txt"
MASK_FILE = "mask.png"

_MAX_FILE_BYTES = 64 << 20
_UNIT_TOLERANCE = 0.01
_SAME_DIRECTION = 1e-9


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
    notes : tuple of str
        What the user should know about how the files were understood.
    """

    source: Path
    images: tuple[Path, ...]
    directions_i3: NDArray[np.float64]
    intensities_ic: NDArray[np.float64] | None = None
    mask: Path | None = None
    notes: tuple[str, ...] = ()

    def label(self, light: int) -> str:
        """Return how messages call a light: its number, counted from 0, and its image."""
        return f"light {light} ({self.images[light].name}) of {self.source}"


def find_lights(folder: Path, lights: Path | None = None) -> LightTable:
    """Return the images and lights of a folder.

    Parameters
    ----------
    folder : Path
        Where the images are.
    lights : Path, optional
        An ``.lp`` file, or a table of numbers. By default, what `folder` holds of: the three text files of
        DiLiGenT, exactly one ``.lp`` file, ``light_directions.txt``.

    Notes
    -----
    A table that lies beside DiLiGenT's other two files is read as DiLiGenT's. With any other table the images
    are all those in `folder` in natural order (``9.png`` before ``10.png``), without ``mask.*``.

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
    if source.suffix.lower() == ".lp":
        return _table_of_lp(folder, source)
    if all((source.parent / name).is_file() for name in (NAMES_FILE, INTENSITIES_FILE)):
        return _table_of_diligent(folder, source)
    return _table_of_numbers(folder, source)


def read_lp(path: Path) -> tuple[list[str], NDArray[np.float64]]:
    """Return image names and (n_light, 3) directions of an ``.lp`` file: a count, then ``name x y z`` lines.

    Names may contain spaces. InputError names the line that is wrong.
    """
    lines = _lines(path)
    if not lines or not lines[0][1].isascii() or not lines[0][1].isdigit():
        raise InputError(f"{path} line {lines[0][0] if lines else 1}: expected the number of images alone")
    names, directions = [], []
    for number, line in lines[1:]:
        parts = line.rsplit(None, 3)
        if len(parts) != 4:
            raise InputError(f"{path} line {number}: expected an image name and x y z, got {line[:80]!r}")
        names.append(parts[0].strip())
        directions.append([_number(part, path, number) for part in parts[1:]])
    if len(names) != int(lines[0][1]):
        raise InputError(f"{path} announces {lines[0][1]} images on line {lines[0][0]}, but {len(names)} lines follow")
    if not names:
        raise InputError(f"{path} names no image")
    return names, np.array(directions, dtype=np.float64)


def write_lp(path: str | os.PathLike[str], names: Sequence[str], directions_i3: NDArray[np.float64]) -> None:
    """Write an ``.lp`` file that `read_lp` reads back, directions to 1e-9; InputError if it cannot be written."""
    lines = [f"{name} {x:.9f} {y:.9f} {z:.9f}\n" for name, (x, y, z) in zip(names, directions_i3, strict=True)]
    with replacing(path) as part:
        part.write("".join([f"{len(lines)}\n", *lines]).encode("utf-8"))


def read_numbers(path: Path) -> NDArray[np.float64]:
    """Return a rectangular table of numbers, with blanks or commas between them and comments from ``#`` on.

    InputError names the line that is wrong.
    """
    rows: list[list[float]] = []
    for number, line in _lines(path):
        text = line.split("#", 1)[0].replace(",", " ")
        if text.strip():
            rows.append([_number(part, path, number) for part in text.split()])
            if len(rows[-1]) != len(rows[0]):
                raise InputError(f"{path} line {number}: expected {len(rows[0])} numbers, got {len(rows[-1])}")
    if not rows:
        raise InputError(f"{path} holds no numbers")
    return np.array(rows, dtype=np.float64)


def read_directions(path: Path) -> NDArray[np.float64]:
    """Return (n_light, 3) directions from a table of N×3 or 3×N numbers.

    A 3×3 table has one light a row, unless its columns alone are unit vectors (within 1%).
    """
    table = read_numbers(path)
    if 3 not in table.shape:
        raise InputError(f"{path} holds {table.shape[0]}×{table.shape[1]} numbers, expected N×3 or 3×N")
    if table.shape == (3, 3):
        return table.T.copy() if _all_unit(table.T) and not _all_unit(table) else table
    return table if table.shape[1] == 3 else table.T.copy()


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


def unit_directions(
    directions_i3: NDArray[np.float64], label: Callable[[int], str], allow_below: bool = False
) -> NDArray[np.float64]:
    """Return the directions with unit length.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        Vectors of any length.
    label : callable
        Gives the name of a light for messages.
    allow_below : bool
        Accept lights with z < 0, which a function on the upper hemisphere cannot use.

    Raises
    ------
    InputError
        Naming the first light that is not finite, has no length, or lies below the horizon.
    """
    finite = np.isfinite(directions_i3).all(axis=1)
    if not finite.all():
        light = int(np.flatnonzero(~finite)[0])
        raise InputError(f"{label(light)} has direction {_vector(directions_i3[light])}, expected finite numbers")
    # Divided by the largest component first, so that no square over- or underflows.
    largest = np.abs(directions_i3).max(axis=1, keepdims=True)
    if not np.all(largest > 0):
        light = int(np.flatnonzero(largest[:, 0] == 0)[0])
        raise InputError(f"{label(light)} has direction 0 0 0, expected a vector towards the light")
    scaled = directions_i3 / largest
    unit_i3 = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    below = np.flatnonzero(unit_i3[:, 2] < 0)
    if below.size and not allow_below:
        others = f" (and {below.size - 1} more)" if below.size > 1 else ""
        raise InputError(
            f"{label(int(below[0]))}{others} is below the horizon: {_vector(directions_i3[below[0]])}; "
            "expected z >= 0, or allow lights below"
        )
    return unit_i3


def count_duplicates(directions_i3: NDArray[np.float64]) -> int:
    """Return how many lights have the direction of an earlier one, within 1e-9 in each component."""
    same = (np.abs(directions_i3[:i] - d) <= _SAME_DIRECTION for i, d in enumerate(directions_i3))
    return sum(bool(s.all(axis=1).any()) for s in same)


def length_note(directions_i3: NDArray[np.float64]) -> list[str]:
    """Return a note if directions as written are not of unit length within 1%, else nothing."""
    lengths = np.linalg.norm(directions_i3, axis=1)
    off = np.flatnonzero(~(np.abs(lengths - 1.0) <= _UNIT_TOLERANCE))
    if not off.size:
        return []
    worst = float(lengths[off][np.argmax(np.abs(lengths[off] - 1.0))])
    return [f"{off.size} directions were not of unit length (worst {worst:.4g}) and were normalised"]


def natural_key(name: str) -> tuple[list[str | int], str]:
    """Return a sort key that orders numbers within names by value: ``9.png`` before ``10.png``."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], name


def _detect(folder: Path) -> Path:
    directions = folder / DIRECTIONS_FILE
    if all((folder / name).is_file() for name in (NAMES_FILE, DIRECTIONS_FILE, INTENSITIES_FILE)):
        return directions
    found = sorted(p for p in folder.iterdir() if p.suffix.lower() == ".lp" and not p.name.startswith("."))
    if len(found) > 1:
        raise InputError(f"{folder} holds {len(found)} .lp files ({', '.join(p.name for p in found[:4])}): name one")
    if found:
        return found[0]
    if directions.is_file():
        return directions
    raise InputError(
        f"no lights in {folder}: looked for {NAMES_FILE} with {DIRECTIONS_FILE} and {INTENSITIES_FILE}, "
        f"for one .lp file, and for {DIRECTIONS_FILE}; name a light file"
    )


def _table_of_lp(folder: Path, source: Path) -> LightTable:
    names, directions_i3 = read_lp(source)
    return LightTable(source, _resolve(folder, names, source), directions_i3)


def _table_of_diligent(folder: Path, source: Path) -> LightTable:
    directions_i3 = read_directions(source)
    names = [line for _, line in _lines(source.parent / NAMES_FILE)]
    _check_pairing(len(names), f"{source.parent / NAMES_FILE} names", directions_i3, source)
    intensities = read_numbers(source.parent / INTENSITIES_FILE)
    if intensities.shape not in ((len(names), 1), (len(names), 3)):
        raise InputError(
            f"{source.parent / INTENSITIES_FILE} holds {intensities.shape[0]}×{intensities.shape[1]} numbers, "
            f"expected {len(names)}×3"
        )
    images = _resolve(folder, names, source.parent / NAMES_FILE)
    bad = np.flatnonzero(~(np.isfinite(intensities) & (intensities > 0)).all(axis=1))
    if bad.size:
        raise InputError(
            f"light {bad[0]} ({images[bad[0]].name}) has intensity {_vector(intensities[bad[0]])} in "
            f"{source.parent / INTENSITIES_FILE}, expected positive numbers"
        )
    mask = folder / MASK_FILE
    return LightTable(source, images, directions_i3, intensities, mask if mask.is_file() else None)


def _table_of_numbers(folder: Path, source: Path) -> LightTable:
    directions_i3 = read_directions(source)
    listed = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_EXTENSIONS and not p.name.startswith(".")]
    images = tuple(sorted((p for p in listed if p.stem.lower() != "mask"), key=lambda p: natural_key(p.name)))
    if not images:
        raise InputError(f"there are no images in {folder}")
    _check_pairing(len(images), f"{folder} holds", directions_i3, source)
    notes = [f"images in the order of their names, {images[0].name} to {images[-1].name}"]
    if len(directions_i3) == 3:
        notes.append(f"{source.name}: a 3×3 table has one light a row, unless its columns alone are unit vectors")
    return LightTable(source, images, directions_i3, notes=tuple(notes))


def _check_pairing(n_image: int, who: str, directions_i3: NDArray, source: Path) -> None:
    if n_image != len(directions_i3):
        raise InputError(f"{who} {n_image} images, but {source} {len(directions_i3)} light directions")


def _resolve(folder: Path, names: Sequence[str], source: Path) -> tuple[Path, ...]:
    """Return the named files: as written relative to the folder, else by base name in the folder.

    Light files keep the folders of the machine they were made on, also Windows's.
    """
    images: dict[Path, int] = {}
    for light, name in enumerate(names):
        written = PurePosixPath(name.replace("\\", "/"))
        candidates = [folder / written.name] if written.is_absolute() else [folder / written, folder / written.name]
        found = next((path for path in candidates if path.is_file()), None)
        if found is None:
            raise InputError(f"there is no image {candidates[0]}, which {source} names for light {light}")
        if found in images:
            raise InputError(f"{source} names image {found.name} for light {images[found]} and for light {light}")
        images[found] = light
    return tuple(images)


def _lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines that are not blank, stripped, with their numbers from 1."""
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise InputError(f"{path} is larger than {_MAX_FILE_BYTES >> 20} MiB, which no light file is")
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path} is no text file (UTF-8)") from None
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    return [(i, line.strip()) for i, line in enumerate(text.splitlines(), start=1) if line.strip()]


def _number(text: str, path: Path, line: int) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(f"{path} line {line}: expected a number, got {text[:40]!r}") from None


def _all_unit(vectors: NDArray[np.float64]) -> bool:
    return bool(np.all(np.abs(np.linalg.norm(vectors, axis=1) - 1.0) <= _UNIT_TOLERANCE))


def _vector(values: NDArray[np.float64]) -> str:
    return " ".join(f"{v:g}" for v in values)
