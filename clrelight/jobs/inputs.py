"""What jobs take: paths or records alike, devices by name or opened, bytes as a number or as people write them."""

from __future__ import annotations

import operator
import os
import pathlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import read_rows_into
from clrelight.codec import Encoded, decode
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.device import Device, open_device
from clrelight.directions import unit_directions
from clrelight.errors import InputError
from clrelight.jobs.report import Progress, Report, stage
from clrelight.light_files import read_light_file
from clrelight.store import file_schema, open_fit, open_stack, read_encoded

Path = str | os.PathLike[str]
StackLike = Path | LightStack
FitLike = Path | CoefficientMap
FittedLike = Path | CoefficientMap | Encoded


@contextmanager
def opened_on(device: Device | str | int | None, report: Report) -> Iterator[Device]:
    """Lend an opened device, that of a name as ``--device`` takes it, or the default one; the report names it."""
    if isinstance(device, Device):
        opened = device
    elif device is None or isinstance(device, str | int):
        opened = open_device(None if device is None else str(device))
    else:
        raise InputError(f"expected a device, its name or its index, got {type(device).__name__}")
    report.device = opened.info.label
    yield opened


def whole(value: Any, what: str) -> int:
    """Return a whole number as an int; InputError if it is something else."""
    try:
        return operator.index(value)
    except TypeError:
        raise InputError(f"{what} must be a whole number, got {value!r}") from None


def path_text(path: object, what: str) -> str:
    """Return a path as text; InputError if it is none."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"expected the path of {what}, got {type(path).__name__}")
    return os.fsdecode(path)


def read_directions(path: Path, report: Report) -> NDArray[np.float64]:
    """Return unit vectors from a light file, those below the horizon too; what is to be said of it is noted."""
    file = read_light_file(pathlib.Path(path_text(path, "directions")))
    report.note(*file.notes, *file.count_notes())
    return unit_directions(file.directions_i3, file.label, allow_below=True)


def paths_among(*sources: object) -> list[Path]:
    """Return those that are paths."""
    return [source for source in sources if isinstance(source, str | os.PathLike)]


def _is_path(source: object, record: type | tuple[type, ...], wanted: str) -> bool:
    """Return whether a source is a path, not a record; InputError if it is neither."""
    if isinstance(source, str | os.PathLike):
        return True
    if isinstance(source, record):
        return False
    raise InputError(f"expected {wanted}, got {type(source).__name__}")


@contextmanager
def lend_stack(source: StackLike, report: Report) -> Iterator[LightStack]:
    """Lend a stack, read from its file as it is needed; what is to be said of it is noted."""
    if _is_path(source, LightStack, "the path of a stack, or LightStack(images, directions, peak)"):
        with open_stack(source) as stack:  # type: ignore[arg-type]
            report.note(*stack.notes)
            yield stack
    else:
        report.note(*source.notes)  # type: ignore[union-attr]
        yield source  # type: ignore[misc]


@contextmanager
def lend_fit(source: FitLike) -> Iterator[CoefficientMap]:
    """Lend a fit, read from its file as it is needed."""
    if _is_path(source, CoefficientMap, "the path of a fit, or a CoefficientMap"):
        with open_fit(source) as coefficients:  # type: ignore[arg-type]
            yield coefficients
    else:
        yield source  # type: ignore[misc]


def take_encoded(source: Path | Encoded) -> tuple[Encoded, FitRecord]:
    """Return an encoding and the record of its fit; InputError where it has none."""
    if _is_path(source, Encoded, "the path of an encoded file, or an Encoded"):
        return read_encoded(source)  # type: ignore[arg-type]
    return source, record_of(source)  # type: ignore[return-value,arg-type]


def record_of(encoded: Encoded) -> FitRecord:
    """Return the record of the fit that was encoded; InputError where the bytes come without one."""
    if encoded.record is None:
        raise InputError("these encoded bytes come without the record of their fit: encode a CoefficientMap or a file")
    return encoded.record


def is_encoded(source: FittedLike) -> bool:
    """Return whether a fit comes encoded; InputError if it is none."""
    if _is_path(
        source, (CoefficientMap, Encoded), "the path of a fit or an encoded file, a CoefficientMap or an Encoded"
    ):
        return file_schema(source).startswith("encoded/")  # type: ignore[arg-type]
    return isinstance(source, Encoded)


@contextmanager
def lend_coefficients(
    source: FittedLike, device: Device, report: Report, progress: Progress | None = None
) -> Iterator[CoefficientMap]:
    """Lend the coefficients of a fit, or of an encoding after decoding; `report` gets what it took.

    Those of a fit file stay in it until they are read. InputError where one that is read is not finite.
    """
    since = time.perf_counter()
    name = os.fsdecode(source) if isinstance(source, str | os.PathLike) else "the coefficients"
    if is_encoded(source):
        encoded, record = take_encoded(source)  # type: ignore[arg-type]
        since = report.add("read", since)
        with stage(progress, "decoding"):
            coefficients = record.to_map(decode(encoded, device))
            report.add("decode", since)
        _check_finite(name, coefficients.coeffs_khwc)
        yield coefficients
        return
    with lend_fit(source) as stored:  # type: ignore[arg-type]
        report.add("read", since)
        held_khwc = stored.coeffs_khwc
        if isinstance(held_khwc, np.ndarray):
            _check_finite(name, held_khwc)
            yield stored
        else:
            yield replace(stored, coeffs_khwc=_Finite(name, held_khwc))


class _Finite:
    """The coefficients of an open file, each checked when it is read."""

    def __init__(self, name: str, stored_khwc: Any) -> None:
        self.shape, self.dtype = stored_khwc.shape, stored_khwc.dtype
        self._name, self._stored = name, stored_khwc

    def read_rows_into(self, first: int, end: int, out: NDArray) -> None:
        read_rows_into(self._stored, first, end, out)
        _check_finite(self._name, out, first)


def _check_finite(name: str, coeffs_khwc: NDArray, first_row: int = 0) -> None:
    for k, plane_hwc in enumerate(coeffs_khwc):
        if not _all_finite(plane_hwc):
            row, column, channel = (int(v) for v in np.argwhere(~np.isfinite(plane_hwc))[0])
            raise InputError(
                f"{name}: coefficient {k} at row {first_row + row}, column {column}, channel {channel} is "
                f"{plane_hwc[row, column, channel]}, expected a finite number"
            )


def _all_finite(values: NDArray) -> bool:
    if values.dtype == np.float16:  # NumPy looks at halves one by one, and at their bits at the speed of memory
        return bool((values.view(np.uint16) & 0x7FFF).max() < 0x7C00)
    return bool(np.isfinite(values).all())
