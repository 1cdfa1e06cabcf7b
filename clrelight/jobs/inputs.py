"""What jobs take: paths or records alike, devices by name or opened, bytes as a number or as people write them."""

from __future__ import annotations

import operator
import os
import pathlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import require_sh
from clrelight.codec import Encoded, decode, decode_regions
from clrelight.codec.damage import Damage
from clrelight.codec.views import Regions
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.device import Device, open_device
from clrelight.directions import unit_directions
from clrelight.errors import InputError
from clrelight.jobs.report import Progress, Report, stage
from clrelight.light_files import read_light_file
from clrelight.store import open_fit, open_fitted, open_stack
from clrelight.store.scratch import ScratchWorkspace
from clrelight.tiles import Rectangle, read_tile

Path = str | os.PathLike[str]
StackLike = Path | LightStack
FitLike = Path | CoefficientMap
FittedLike = Path | CoefficientMap | Encoded
Held = TypeVar("Held", bound="CoefficientMap | Packed")


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
def lend_fit(source: FitLike, *, any_basis: bool = False) -> Iterator[CoefficientMap]:
    """Lend a fit, read from its file as it is needed; InputError of what is not of spherical harmonics, as a rule."""
    if _is_path(source, CoefficientMap, "the path of a fit, or a CoefficientMap"):
        with open_fit(source) as coefficients:  # type: ignore[arg-type]
            yield _of_basis(coefficients, any_basis)
    else:
        yield _of_basis(source, any_basis)  # type: ignore[misc, type-var]


def _of_basis(held: Held, any_basis: bool) -> Held:
    """Return what is lent; InputError where it is of another basis than its borrower takes."""
    if not any_basis:
        require_sh((held.record if isinstance(held, Packed) else held).basis)
    return held


def record_of(encoded: Encoded) -> FitRecord:
    """Return the record of the fit that was encoded; InputError where the bytes come without one."""
    if encoded.record is None:
        raise InputError("these encoded bytes come without the record of their fit: encode a CoefficientMap or a file")
    return encoded.record


@dataclass(frozen=True)
class Packed:
    """An encoding that is lent.

    Attributes
    ----------
    encoded : Encoded
        Its checksum may be due, where only parts were asked for.
    record : FitRecord
    damage : Damage, optional
        Told of damaged parts, where they are let pass.
    """

    encoded: Encoded
    record: FitRecord
    damage: Damage | None = None

    def regions(self) -> Regions | None:
        """Return what decodes parts alone, None where there is no such thing; InputError if it is to be salvaged."""
        found = decode_regions(self.encoded, self.damage)
        if found is None and self.damage is not None:
            refuse_salvage(f"an encoding by {self.encoded.codec}")
        return found

    def regions_of(self, name: str) -> Regions:
        """Return what decodes parts alone, of a file of a name; InputError where there is no such thing."""
        found = self.regions()
        if found is None:
            raise InputError(f"{name} holds no parts that can be decoded alone")
        return found


def refuse_salvage(what: str) -> NoReturn:
    """Raise InputError: what is no file in units cannot be salvaged."""
    raise InputError(f"{what} holds no units that stand alone, so none can be salvaged: those by klt or wavelet do")


@contextmanager
def lend_fitted(
    source: FittedLike,
    report: Report,
    *kinds: str,
    parts: bool = False,
    salvage: bool = False,
    workspace: ScratchWorkspace | None = None,
    any_basis: bool = False,
) -> Iterator[CoefficientMap | Packed]:
    """Lend a fit, or an encoding and its record.

    Parameters
    ----------
    source : path, CoefficientMap or Encoded
    report : Report
        Gets what is to be said of the file, what is damaged of it, and what was ``fetched`` of one behind a URL.
    *kinds : str
        What a file may be: ``"fit"``, ``"encoded"``; by default either.
    parts : bool
        Of an encoding parts are wanted, not all of it: it is read as it is sliced.
    salvage : bool
        Let parts be damaged.
    workspace : ScratchWorkspace, optional
        Where a payload goes that is large for its memory.
    any_basis : bool
        Lend coefficients of other bases than spherical harmonics too; an InputError without.
    """
    damage = Damage() if salvage else None
    if isinstance(source, Encoded):
        yield _of_basis(Packed(source, record_of(source), damage), any_basis)
        _tell_damage(damage, report)
        return
    wanted = "the path of a fit or an encoded file, a CoefficientMap or an Encoded"
    if not _is_path(source, CoefficientMap, wanted):
        yield _of_basis(source, any_basis)  # type: ignore[misc, type-var]
        return
    with open_fitted(source, *kinds, salvage=salvage) as opened:  # type: ignore[arg-type]
        report.note(*opened.notes)
        if not opened.is_encoded:
            yield _of_basis(opened.fit(), any_basis)
        else:
            held = opened.parts(compared=not salvage) if parts or salvage else opened.whole(workspace)
            yield _of_basis(Packed(*held, damage), any_basis)
        _tell_damage(damage, report)
        if traffic := opened.traffic():
            report.facts["fetched"] = traffic


def _tell_damage(damage: Damage | None, report: Report) -> None:
    if damage is not None:
        report.note(*damage.notes())
        report.facts["damaged"] = damage.to_json()


@contextmanager
def lend_encoded(
    source: Path | Encoded,
    report: Report,
    *,
    parts: bool = False,
    salvage: bool = False,
    workspace: ScratchWorkspace | None = None,
) -> Iterator[Packed]:
    """Lend an encoding alone, of any basis, as `lend_fitted` does."""
    _is_path(source, Encoded, "the path of an encoded file, or an Encoded")
    kind = "encoded"
    with lend_fitted(source, report, kind, parts=parts, salvage=salvage, workspace=workspace, any_basis=True) as held:
        yield held  # type: ignore[misc]


@contextmanager
def lend_coefficients(
    source: FittedLike, device: Device, report: Report, progress: Progress | None = None
) -> Iterator[CoefficientMap]:
    """Lend the coefficients of a fit, or of an encoding after decoding; `report` gets what it took.

    Those of a fit file stay in it until they are read. InputError where one that is read is not finite.
    """
    since = time.perf_counter()
    with lend_fitted(source, report) as held:
        since = report.add("read", since)
        yield decoded_of(held, source, device, report, progress)


def decoded_of(
    held: CoefficientMap | Packed, source: FittedLike, device: Device, report: Report, progress: Progress | None
) -> CoefficientMap:
    """Return the coefficients of what is lent, decoded where it is encoded, and looked at before they are used."""
    name = os.fsdecode(source) if isinstance(source, str | os.PathLike) else "the coefficients"
    if isinstance(held, Packed):
        since = time.perf_counter()
        with stage(progress, "decoding"):
            held = held.record.to_map(decode(held.encoded, device))
            report.add("decode", since)
    held_khwc = held.coeffs_khwc
    if isinstance(held_khwc, np.ndarray):
        _check_finite(name, held_khwc)
        return held
    return replace(held, coeffs_khwc=_Finite(name, held_khwc))


class _Finite:
    """The coefficients of an open file, each checked when it is read."""

    def __init__(self, name: str, stored_khwc: Any) -> None:
        self.shape, self.dtype = stored_khwc.shape, stored_khwc.dtype
        self.chunks = getattr(stored_khwc, "chunks", None)
        self._name, self._stored = name, stored_khwc

    def read_into(self, tile: Rectangle, out: NDArray, picked_n: NDArray[np.intp] | None = None) -> None:
        read_tile(self._stored, tile, out, picked_n)
        _check_finite(self._name, out, tile.top, tile.left)


def _check_finite(name: str, coeffs_khwc: NDArray, top: int = 0, left: int = 0) -> None:
    for k, plane_hwc in enumerate(coeffs_khwc):
        if not _all_finite(plane_hwc):
            row, column, channel = (int(v) for v in np.argwhere(~np.isfinite(plane_hwc))[0])
            raise InputError(
                f"{name}: coefficient {k} at row {top + row}, column {left + column}, channel {channel} is "
                f"{plane_hwc[row, column, channel]}, expected a finite number"
            )


def _all_finite(values: NDArray) -> bool:
    if values.dtype == np.float16:  # NumPy looks at halves one by one, and at their bits at the speed of memory
        return bool((values.view(np.uint16) & 0x7FFF).max() < 0x7C00)
    return bool(np.isfinite(values).all())
