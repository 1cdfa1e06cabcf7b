"""Text files of lights, as people write them: what each line says, whatever its separators, headings and counts."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dome_files import ENDINGS, read_dome
from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.light_columns import find_axes, read_directions, refuse_angles
from clrelight.text_rows import NUMBER, read_lines, split_fields

_LONGEST_NAMED_LINE = 1 << 13
_TRAILING_COMMENT = re.compile(r"(?:#|%|//).*")
_COMMENT_AFTER_NAME = re.compile(r"\s(?:#|%|//).*")
_NAME_HEADING = re.compile(r"name|file|image|img|photo|picture", re.IGNORECASE)
_IMAGE_NAME = re.compile(r".+\.[a-z][a-z0-9]{1,4}", re.IGNORECASE)
_QUOTED_NAME = re.compile(r"""(["'])(?P<name>.+?)\1[\s,;]*(?P<rest>.*)""")
_COUNT = re.compile(r"[^0-9]*?([0-9]{1,9})[^0-9]*")
_ANGLES = re.compile(r"azim|elev|theta|phi|zenith|inclin|altitude|colat|longitude|latitude|polar|degree", re.IGNORECASE)


@dataclass(frozen=True)
class LightFile:
    """What a file of lights says.

    Attributes
    ----------
    source : Path
    names : tuple of str
        The image of each light, as written but for quotes; empty where the file names none.
    directions_i3 : ndarray, shape (n_light, 3), float64
        As written: neither checked nor of unit length.
    lines : tuple of int
        The line of each light, from 1; empty where a line is no light.
    announced : int, optional
        The number of lights that a line of its own announces.
    notes : tuple of str
        What the user should know about how the file was understood.
    """

    source: Path
    names: tuple[str, ...]
    directions_i3: NDArray[np.float64]
    lines: tuple[int, ...]
    announced: int | None
    notes: tuple[str, ...]

    def label(self, light: int) -> str:
        """Return how messages call a light: its number, counted from 0, and its line."""
        return f"light {light} of {self.source}" + (f" line {self.lines[light]}" if self.lines else "")

    def count_notes(self, taken: int | None = None) -> list[str]:
        """Return a note where the file announces another number of lights than it lists, or an .lp file none."""
        listed = len(self.directions_i3)
        taken = taken if taken is not None else listed
        if self.announced is None and self.source.suffix.lower() == ".lp":
            return [f"{self.source.name} does not open with the number of its lights; all {taken} were taken"]
        if self.announced in (None, listed):
            return []
        which = "all" if taken == listed else "the first"
        return [f"{self.source.name} announces {self.announced} lights, but lists {listed}; {which} {taken} were taken"]


@dataclass(frozen=True)
class _Row:
    """The name and the fields of a line."""

    line: int
    text: str
    name: str
    fields: tuple[str, ...]


def read_light_file(path: Path) -> LightFile:
    """Return the lights of a file: lines of ``x y z`` or ``name x y z``, or three lines of numbers.

    Between fields are blanks, tabs, commas or semicolons. Read as well: decimal commas, Fortran's exponents, quotes,
    names with blanks, comments (a line from ``#``, ``%``, ``;`` or ``//`` on), a line with the number of lights, a
    heading that says which columns are x, y and z, a column that numbers the lines, and one column more in which all
    lines are alike. Numbers of a transposed table (3×N) are one light a column. Also domes and projects of relight.

    Raises
    ------
    InputError
        Naming the line that is wrong, or what in the table has no plain meaning.
    """
    if path.suffix.lower() in ENDINGS:
        dome_names, vectors_i3, dome_notes = read_dome(path)
        return LightFile(path, dome_names, vectors_i3, (), None, dome_notes)
    lines, notes = read_lines(path)
    named = path.suffix.lower() == ".lp" or _names_images(path, lines)
    rows = [_parse_line(path, number, line, named) for number, line in lines]
    announced, heading = _take_opening(path, rows, named)
    if not rows:
        raise InputError(f"{path} names no image" if named else f"{path} holds no numbers")
    values = _numbers(path, rows, named)
    directions_i3, column_notes = read_directions(path, values, heading, named)
    names = tuple(row.name for row in rows) if named else ()
    by_line = len(directions_i3) == len(rows) and (named or values.shape != (3, 3))
    refuse_angles(path, directions_i3)
    if announced is not None and abs(announced - len(directions_i3)) > 1:
        raise InputError(
            f"{path} announces {announced} lights, but lists {len(directions_i3)}; expected as many as announced"
        )
    at = tuple(row.line for row in rows) if by_line else ()
    return LightFile(path, names, directions_i3, at, announced, (*notes, *column_notes))


def write_lp(path: str | os.PathLike[str], names: Sequence[str], directions_i3: NDArray[np.float64]) -> None:
    """Write an ``.lp`` file as `read_light_file` reads it, directions to 1e-9; InputError if it cannot be written."""
    lines = [f"{name} {x:.9f} {y:.9f} {z:.9f}\n" for name, (x, y, z) in zip(names, directions_i3, strict=True)]
    with replacing(path) as part:
        part.write("".join([f"{len(lines)}\n", *lines]).encode("utf-8"))


def read_table(path: Path) -> NDArray[np.float64]:
    """Return a rectangular table of numbers that are no directions; InputError names the line that is wrong."""
    rows = [_parse_line(path, number, line, False) for number, line in read_lines(path)[0]]
    _take_opening(path, rows, False)
    if not rows:
        raise InputError(f"{path} holds no numbers")
    return _numbers(path, rows, False)


def _names_images(path: Path, lines: list[tuple[int, str]]) -> bool:
    """Tell whether the first lines of a file, other than a heading and a count, name images."""
    first = [(number, line) for number, line in lines[:8] if len(line) <= _LONGEST_NAMED_LINE]
    rows = [_parse_line(path, number, line, True, strict=False) for number, line in first]
    return any(
        row.name
        and len(row.fields) > 2
        and _all_numbers(row.fields)
        and not _all_numbers(re.split(r"[\s,;]+", row.name))
        for row in rows
    )


def _all_numbers(fields: Sequence[str]) -> bool:
    return all(map(NUMBER.fullmatch, fields))


def _parse_line(path: Path, number: int, line: str, named: bool, strict: bool = True) -> _Row:
    if named and len(line) > _LONGEST_NAMED_LINE:
        raise InputError(f"{path} line {number}: expected an image name and x y z, got {len(line)} characters")
    text = (_COMMENT_AFTER_NAME if named else _TRAILING_COMMENT).sub("", line)
    name, rest = _split_name(text) if named else ("", text)
    fields = split_fields(path, number, rest, strict)
    if named and not name and len(fields) > 3:
        # No extension tells where the name ends: it is all before the last three fields.
        name, fields = _before_last_fields(text), fields[-3:]
    return _Row(number, text, name, tuple(fields))


def _split_name(line: str) -> tuple[str, str]:
    """Return the name of an image in a line and the rest, or no name where none is quoted or has an extension."""
    quoted = _QUOTED_NAME.fullmatch(line)
    if quoted and not NUMBER.fullmatch(quoted["name"]):
        return quoted["name"].strip(), quoted["rest"]
    ends = [token.end() for token in re.finditer(r"[^\s,;]+", line) if _is_image_name(token[0])]
    if not ends:
        return "", line
    name, rest = line[: ends[-1]], line[ends[-1] :].lstrip(" \t,;")
    if not rest:
        for between in (r"\s;", r"\s,;"):
            before = re.fullmatch(rf"((?:[^{between}]+[{between}]+){{3}})(.+)", line)
            numbers = re.split(rf"[{between}]+", before[1].strip()) if before else []
            if before and all(NUMBER.fullmatch(each.replace(",", ".")) for each in numbers if each):
                name, rest = before[2], before[1]  # the name comes last
                break
    return name.strip("\"' \t"), rest


def _is_image_name(token: str) -> bool:
    token = token.strip("\"'")
    return bool(_IMAGE_NAME.fullmatch(token)) and not NUMBER.fullmatch(token)


def _before_last_fields(line: str) -> str:
    name, *last = line.rstrip(" \t,;").rsplit(None, 3)
    if len(last) < 3 or not all(NUMBER.fullmatch(each.strip(",;").replace(",", ".")) for each in last):
        name = re.sub(r"(?:[\s,;]+[^\s,;]+){3}$", "", line.rstrip(" \t,;"))
    return name.strip("[](){}\"' \t,;")


def _take_opening(path: Path, rows: list[_Row], named: bool) -> tuple[int | None, tuple[str, ...] | None]:
    """Take what opens a file off its rows: the number of lights, and the words over the columns of numbers."""
    announced, words = None, None
    while rows:
        if announced is None and (count := _count(rows, named)) is not None:
            announced = count
        elif (found := _heading(path, rows[0], named)) is not None:
            words = found
        else:
            break
        rows.pop(0)
    if named and rows and not rows[0].name and len(rows[0].fields) < 3 and announced is None:
        raise InputError(
            f"{path} line {rows[0].line}: expected the number of images, or an image name and x y z, "
            f"got {rows[0].text[:80]!r}"
        )
    return announced, words


def _count(rows: list[_Row], named: bool) -> int | None:
    """Return the number that the first row announces, if it is one, maybe with words beside it."""
    first = rows[0]
    found = _COUNT.fullmatch(first.text)
    if found and not re.search(r"[-.]\s*[0-9]", first.text) and not any(map(_is_image_name, first.text.split())):
        alone = sum(bool(NUMBER.fullmatch(field)) for field in first.fields) <= 1
        wordy = len(first.fields) < 3 or re.search(r"[a-z]{3}", first.text, re.IGNORECASE)
        if alone and (named or (wordy and len(rows) > 1 and len(rows[1].fields) >= 3)):
            return int(found[1])
    width = len(rows[1].fields) if len(rows) > 1 else 0
    if not named and width > 2 and first.fields == (str(len(rows) - 1), str(width)):
        return len(rows) - 1  # rows and columns
    return None


def _heading(path: Path, row: _Row, named: bool) -> tuple[str, ...] | None:
    """Return the words of a heading over the columns of numbers, or None; InputError if it announces angles."""
    words = split_fields(path, row.line, row.text, False)
    if any(map(NUMBER.fullmatch, words)) or any(map(_is_image_name, words)):
        return None
    angles = [word for word in words if _ANGLES.search(word)]
    if len(angles) > 1:
        raise InputError(f"{path} line {row.line}: {' and '.join(angles)} are angles, expected directions as x y z")
    if named:
        # What is before the name, such as a number of the line, is read with the name.
        name = next((i for i, word in enumerate(words) if _NAME_HEADING.search(word)), 0)
        words = words[:name] if name == len(words) - 1 else words[name + 1 :]
        return tuple(words) if find_axes(words) else None
    return tuple(words)


def _numbers(path: Path, rows: list[_Row], named: bool) -> NDArray[np.float64]:
    for row in rows:
        if named and (not row.name or len(row.fields) < 3):
            angles = " (two numbers look like angles)" if len(row.fields) == 2 and row.name else ""
            text = " ".join((row.name, *row.fields)).strip()
            raise InputError(f"{path} line {row.line}: expected an image name and x y z{angles}, got {text[:80]!r}")
        bad = next((field for field in row.fields if not NUMBER.fullmatch(field)), None)
        if bad is not None:
            raise InputError(f"{path} line {row.line}: expected a number, got {bad[:40]!r}")
        if len(row.fields) != len(rows[0].fields):
            raise InputError(f"{path} line {row.line}: expected {len(rows[0].fields)} numbers, got {len(row.fields)}")
    return np.array([[float(field.lower().replace("d", "e")) for field in row.fields] for row in rows])
