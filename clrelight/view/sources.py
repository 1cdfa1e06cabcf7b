"""What the viewer shows: payloads that the page decodes by itself, and planes of all other files, tile by tile."""

from __future__ import annotations

import base64
import os
import threading
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body
from clrelight.codec.formats.klt_units import VERSION as UNITS_VERSION
from clrelight.codec.formats.klt_units import parse_body
from clrelight.codec.minimum_size import drop_padding
from clrelight.codec.transforms.code_values import node_matrices
from clrelight.codec.views import Region, Regions
from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.index import cosine_indices, degree_of
from clrelight.jobs.inputs import Packed, decoded_of, lend_fitted
from clrelight.jobs.report import Report
from clrelight.store import file_schema, open_stack
from clrelight.surface import surface_facts
from clrelight.tiles import read_rows_into
from clrelight.transfer.reflection import OPERATOR
from clrelight.view.texels import TILE, count_levels, halve, level_side, pack_bytes, pack_half, tile_place

_KEPT_BYTES = 1 << 28
"""Bytes of rows of tiles that stay for the tiles beside them."""


def floats_text(values: NDArray) -> str:
    """Return numbers as the page reads them: little-endian float32 in base64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


class Source(ABC):
    """A file that is shown; its parts are read by several threads, one at a time."""

    kind = ""

    def __init__(self, name: str, n_bytes: int, shape: tuple[int, int, int], record: dict[str, Any]) -> None:
        height, width, channel = shape
        if channel not in (1, 3):
            raise InputError(f"{name} has {channel} channels: the viewer shows 1 or 3")
        self.name, self.n_bytes, self.image_shape, self.record = name, n_bytes, shape, record
        self.levels = count_levels(height, width)
        self.lock = threading.Lock()

    def facts(self) -> dict[str, Any]:
        """Return what the page is told of the file, JSON values only."""
        height, width, channel = self.image_shape
        shared = {"name": self.name, "kind": self.kind, "bytes": self.n_bytes, "levels": self.levels}
        return {**shared, "height": height, "width": width, "channels": channel, "tile": TILE, **self.record}

    @abstractmethod
    def tile(self, level: int, row: int, column: int, light: int, planes: str) -> bytes:
        """Return the texels of a tile, ``planes`` being ``half`` or ``uint8``; LookupError where there is none."""


class PayloadSource(Source):
    """Body 4 of `klt`, which the page decodes by itself: its bytes, and the matrix from planes to coefficients."""

    kind = "klt"

    def __init__(self, name: str, packed: Packed) -> None:
        shape = packed.encoded.shape
        super().__init__(name, len(packed.encoded.body), shape[1:], _record_facts(packed.record, packed.encoded.codec))
        self.body: Body = drop_padding(packed.encoded.body, shape)
        parsed = parse_body(self.body, shape)
        operator_kcj = parsed.operator_kcj
        # Texels are planes in units in which coefficients hold them at most once: halves have room for those.
        unit_j = np.abs(operator_kcj[:, :, :-1]).max(axis=(0, 1))
        scaled_kcj = operator_kcj.copy()
        scaled_kcj[:, :, :-1] /= np.where(unit_j > 0, unit_j, 1.0)
        self._operator, self._units = scaled_kcj, unit_j
        self._front = int(parsed.stored.start_t[0])
        self._shape, self._bent = shape, parsed.head.transfer == "srgb"

    def facts(self) -> dict[str, Any]:
        """See `Source`."""
        facts = {**super().facts(), "shape": list(self._shape), "front": self._front, "length": len(self.body)}
        facts |= {"planes": len(self._units), "units": floats_text(self._units)}
        facts |= {"operator": floats_text(self._operator), "bent": self._bent}
        if self._bent:
            facts["analysis"] = floats_text(analysis_columns(self._shape[0]))
        return facts

    def read(self, begin: int, end: int) -> bytes:
        """Return bytes of the body."""
        with self.lock:
            return bytes(self.body[begin:end])

    def tile(self, level: int, row: int, column: int, light: int, planes: str) -> bytes:
        """See `Source`: the page makes tiles of the body."""
        raise LookupError("a payload has no tiles")


def analysis_columns(n_coeff: int) -> NDArray[np.float64]:
    """Return what makes coefficients of radiance at the nodes behind the curve, ((l, m >= 0), node of azimuth 0).

    About z all of it follows: rows of order m go as cos(m azimuth), those of -m as the sine.
    """
    degree = degree_of(n_coeff)
    return node_matrices(n_coeff)[1][cosine_indices(degree), :: 2 * degree + 1]


class _TiledSource(Source):
    """A file whose tiles are made here, a row of them at a time."""

    def __init__(self, name: str, n_bytes: int, shape: tuple[int, int, int], record: dict[str, Any]) -> None:
        super().__init__(name, n_bytes, shape, record)
        self._rows: OrderedDict[tuple[int, int, int], NDArray[np.float32]] = OrderedDict()

    def tile(self, level: int, row: int, column: int, light: int, planes: str) -> bytes:
        """See `Source`."""
        if level > self.levels:
            raise LookupError(f"there is no level {level}")
        place = tile_place(*self.image_shape[:2], level, row, column)
        with self.lock:
            planes_phw = self._row(level, row, light)[:, :, place.left : place.right]
        if planes == "uint8":
            return pack_bytes(planes_phw)
        return pack_half(planes_phw)

    def _row(self, level: int, row: int, light: int) -> NDArray[np.float32]:
        """Return the planes of a row of tiles, kept for its other tiles."""
        key = (level, row, light)
        if key not in self._rows:
            place = tile_place(*self.image_shape[:2], level, row, 0)
            made = self._make(level, place.top, place.bottom, light)
            held = sum(each.nbytes for each in self._rows.values())
            while self._rows and held + made.nbytes > _KEPT_BYTES:
                held -= self._rows.popitem(last=False)[1].nbytes
            self._rows[key] = made
        self._rows.move_to_end(key)
        return self._rows[key]

    def _make(self, level: int, top: int, bottom: int, light: int) -> NDArray[np.float32]:
        """Return planes (plane, row, column) of rows of a level, halved from those of the image strip by strip."""
        height, width, _ = self.image_shape
        if level == 0:
            return self._read(top, bottom, light)
        made = []
        step = max((_KEPT_BYTES >> 2) // max(4 * self.n_plane * width, 1) >> level, 1)
        for first in range(top, bottom, step):
            end = min(first + step, bottom)
            strip = self._read(first << level, min(end << level, height), light)
            for _ in range(level):
                strip = halve(strip)
            made.append(strip)
        return np.concatenate(made, axis=1)

    n_plane = 0

    @abstractmethod
    def _read(self, first: int, end: int, light: int) -> NDArray[np.float32]:
        """Return planes (plane, row, column) of rows of the image."""


class MapSource(_TiledSource):
    """Coefficients: a plane for each of them and channel."""

    kind = "planes"

    def __init__(self, name: str, n_bytes: int, fit: CoefficientMap, codec: str) -> None:
        super().__init__(name, n_bytes, fit.image_shape, _record_facts(FitRecord.of(fit), codec))
        self._fit, self.n_plane = fit, fit.n_coeff * fit.image_shape[2]

    def facts(self) -> dict[str, Any]:
        """See `Source`."""
        return {**super().facts(), "planes": self.n_plane, "bent": False}

    def _read(self, first: int, end: int, light: int) -> NDArray[np.float32]:
        rows_khwc = np.empty((self._fit.n_coeff, end - first, *self._fit.image_shape[1:]), np.float32)
        return _planes_of(self._fit.read_rows(first, end, rows_khwc))


class RegionSource(_TiledSource):
    """An encoding of which parts are decoded alone, at a level too."""

    kind = "planes"

    def __init__(self, name: str, packed: Packed, regions: Regions, device: Device) -> None:
        shape = packed.encoded.shape
        super().__init__(name, len(packed.encoded.body), shape[1:], _record_facts(packed.record, packed.encoded.codec))
        self._regions, self._device, self.n_plane = regions, device, shape[0] * shape[3]

    def facts(self) -> dict[str, Any]:
        """See `Source`."""
        return {**super().facts(), "planes": self.n_plane, "bent": False}

    def _make(self, level: int, top: int, bottom: int, light: int) -> NDArray[np.float32]:
        width = level_side(self.image_shape[1], level)
        return _planes_of(self._regions.coefficients(Region(top, 0, bottom, width, level), self._device))

    def _read(self, first: int, end: int, light: int) -> NDArray[np.float32]:
        return self._make(0, first, end, light)


class StackSource(_TiledSource):
    """Photographs: what is shown is the one whose light is nearest."""

    kind = "photographs"

    def __init__(self, name: str, n_bytes: int, stack: LightStack) -> None:
        facts = {"transfer": stack.transfer, "directions": floats_text(stack.directions_i3), "lights": stack.n_light}
        super().__init__(name, n_bytes, stack.image_shape, {"codec": "photographs", **facts})
        self._stack, self.n_plane = stack, stack.image_shape[2]

    def tile(self, level: int, row: int, column: int, light: int, planes: str) -> bytes:
        """See `Source`; halves always."""
        if not 0 <= light < self._stack.n_light:
            raise LookupError(f"there is no light {light}")
        return super().tile(level, row, column, light, "half")

    def _read(self, first: int, end: int, light: int) -> NDArray[np.float32]:
        one = self._stack.select(np.array([light]))
        values_hwc = read_rows_into(
            one.images_ihwc, first, end, np.empty((1, end - first, *one.image_shape[1:]), one.images_ihwc.dtype)
        )[0]
        scaled = values_hwc.astype(np.float32) / np.float32(one.peak)
        linear = srgb_to_linear(scaled, np.float32) if one.transfer == "srgb" else scaled
        return np.moveaxis(linear, 2, 0)


def _planes_of(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return planes ``k C + c`` of coefficients."""
    n_coeff, height, width, channel = coeffs_khwc.shape
    return coeffs_khwc.transpose(0, 3, 1, 2).reshape(n_coeff * channel, height, width)


def _record_facts(record: FitRecord, codec: str) -> dict[str, Any]:
    facts = {"method": record.method, "degree": record.degree, "transfer": record.transfer, "codec": codec}
    return {**facts, "directions": floats_text(record.directions_i3)}


@contextmanager
def opened_source(path: str | os.PathLike[str], device: Callable[[], Device], report: Report) -> Iterator[Source]:
    """Open a fit, an encoding or a stack; InputError where it is none, or nothing that a page can show.

    The device is opened where something is decoded here: what the page decodes is shown sooner without.
    """
    name = Path(os.fsdecode(path)).name
    n_bytes = os.path.getsize(path) if os.path.exists(path) else 0
    if os.path.exists(path) and (file_schema(path) or "").startswith("stack"):
        with open_stack(path) as stack:
            if stack.surface is not None:
                raise _surface_error(name)
            report.note(*stack.notes)
            yield StackSource(name, n_bytes, stack)
        return
    with lend_fitted(path, report, parts=True) as held:
        record = held.record if isinstance(held, Packed) else FitRecord.of(held)
        if record.method == OPERATOR:
            raise InputError(f"{name} holds operators, from light to views: clrelight reflect makes radiance of them")
        if surface_facts(record.surface, record.config) is not None:
            raise _surface_error(name)
        if not isinstance(held, Packed):
            yield MapSource(name, n_bytes, held, "fit")
            return
        encoded = held.encoded
        if encoded.codec == "klt" and drop_padding(encoded.body, encoded.shape)[:1] == bytes([UNITS_VERSION]):
            yield PayloadSource(name, held)
        elif (regions := held.regions()) is not None:
            yield RegionSource(name, held, regions, device())
        else:
            fit = decoded_of(held, path, device(), report, None)
            yield MapSource(name, len(encoded.body), fit, encoded.codec)


def _surface_error(name: str) -> InputError:
    return InputError(
        f"{name} holds functions of a surface, and the viewer shows those of a picture: clrelight render makes "
        "pictures of them, and with --turntable one that goes round"
    )
