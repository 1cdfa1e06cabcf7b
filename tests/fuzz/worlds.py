"""What harnesses are compiled with: the layouts and tables that launchers pass, and inputs to start from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import codec_class, encode
from clrelight.codec.entropy.range_coding import Encoder
from clrelight.codec.entropy.subband_kernel import _SCRATCH, _TABLES, _describe_place, _largest_batch
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.entropy.unit_streams import _WORK_BYTES, default_tables, encode_streams
from clrelight.codec.entropy.units import (
    LEVELS,
    PRECINCT,
    Layout,
    Unit,
    Window,
    lay_out,
    list_units,
    low_side,
    place_units,
)
from clrelight.codec.formats.klt_regions import _cover, around
from clrelight.codec.transforms.lifting import list_subbands, padded_width
from clrelight.codec.views import Region

SMALL = [
    (1, 1),
    (1, 2),
    (2, 1),
    (3, 3),
    (8, 8),
    (9, 17),
    (16, 16),
    (1, 70),
    (33, 1),
    (24, 40),
    (47, 131),
    (64, 64),
    (70, 90),
    (5, 1100),
]
"""Sides of images whose streams are fuzzed both as one and as many."""
LARGE = [(560, 580), (513, 512), (5, 60000)]
"""Of images that are in units of their own, of which a region needs those of the last precinct."""
MAPS = [(1, 1, 1, 1), (2, 2, 3, 1), (1, 1, 33, 5), (3, 9, 7, 2), (2, 16, 16, 3), (4, 12, 20, 2), (1, 40, 40, 5)]
"""Channels, height, width and levels of maps of `wavelet` and `principal`."""


@dataclass(frozen=True)
class World:
    """Units as an encoder lays them out in whole planes, and as a decoder does that writes to a window at a level."""

    units: list[Unit]
    height: int
    width: int
    cover: Window
    together: bool
    window: Window
    level: int

    @property
    def pitch(self) -> int:
        """Of the encoder's planes."""
        return padded_width(self.cover.shape[1])

    @property
    def known(self) -> tuple[int, int]:
        """Rows and pitch of the decoder's sizes."""
        return low_side(self.cover.shape[0], 1), low_side(self.cover.shape[1], 1)

    @property
    def sides(self) -> tuple[int, int]:
        """Rows and pitch of the decoder's values."""
        rows, columns = (
            low_side(end, self.level) - (start >> self.level)
            for start, end in ((self.window.top, self.window.bottom), (self.window.left, self.window.right))
        )
        return rows, padded_width(columns)

    def layout(self, pitch: int, count: int = 1) -> Layout:
        """Return how so many planes lie."""
        return lay_out(self.units, (self.height, self.width), self.cover, pitch, self.together, [(0, count)])

    def places(self) -> NDArray[np.int32]:
        """Return where the decoder puts values."""
        return place_units(self.units, self.window, self.level)


@cache
def unit_layouts() -> list[World]:
    """Return what is fuzzed: whole images, and parts of them at levels."""
    worlds = []
    for number, (height, width) in enumerate(SMALL):
        whole, units = Window(0, 0, height, width), list_units(height, width)
        for together in (True, False):
            worlds.append(World(units, height, width, whole, together, whole, 0))
        level = 1 + number % LEVELS
        rows, columns = low_side(height, level), low_side(width, level)
        part = around(Region(rows // 2, columns // 2, rows, columns, level), height, width)
        worlds.append(World(units, height, width, whole, True, part, level))
    for number, (height, width) in enumerate(LARGE):
        units = list_units(height, width)
        top, left = (height - 1) // PRECINCT * PRECINCT, (width - 1) // PRECINCT * PRECINCT
        chosen = [u for u in units if u.row << (u.level or LEVELS) >= top and u.column << (u.level or LEVELS) >= left]
        cover = _cover(chosen, height, width)
        part = around(Region(top, left, height, width), height, width)
        for window, level in ((cover, 0), (part, number), (Window(0, 0, 32, min(64, width)), 0)):
            worlds.append(World(chosen, height, width, cover, False, window, level))
    return worlds


def headers(harness: str) -> dict[str, str]:
    """Return the headers that a harness includes, by name."""
    if harness == "units.c":
        return {"units_world.h": _units_header()}
    if harness == "subbands.c":
        return {"subbands_world.h": _subbands_header()}
    return {}


def _numbers(values: object) -> str:
    return "{" + ",".join(map(str, np.asarray(values).ravel().tolist())) + "}"


def _units_header() -> str:
    tables, lines, entries = default_tables(), [], []
    for number, world in enumerate(unit_layouts()):
        layout = world.layout(world.known[1])
        n_unit, n_stream = len(layout.unit_uf), len(layout.part_t4)
        lines.append(f"static const int unit_{number}[] = {_numbers(layout.unit_uf)};")
        lines.append(f"static const int first_{number}[] = {_numbers(layout.part_t4[:, :2])};")
        lines.append(f"static const int placed_{number}[] = {_numbers(world.places())};")
        most_planes = max(min(12, (1 << 15) // max(math.prod(world.sides), math.prod(world.known))), 1)
        sides = ",".join(map(str, (*world.sides, *world.known)))
        entries.append(f"{{{n_unit},{n_stream},{sides},{most_planes},unit_{number},first_{number},placed_{number}}}")
    return "\n".join(
        [
            "typedef struct { int units, streams, rows, pitch, known_rows, known_pitch, most_planes; "
            "const int *unit, *first, *placed; } layout_t;",
            *lines,
            f"static const layout_t layouts[] = {{{','.join(entries)}}};",
            f"enum {{ LAYOUTS = {len(entries)}, UNIT_FIELDS = 19, WORK_SIZE = {_WORK_BYTES} }};",
            f"static const uint16_t start_counts[] = {_numbers(tables.count_ms)};",
            f"static const uint16_t start_flags[] = {_numbers(tables.flag_f2)};\n",
        ]
    )


def _subbands_header() -> str:
    lines, entries, statistics = [], [], Statistics()
    for number, (channels, height, width, levels) in enumerate(MAPS):
        bands = list_subbands(height, width, levels)
        by_name = {(band.name, band.level): band for band in bands}
        places = [_describe_place(band, by_name) for band in bands]
        lines += [f"static const int place_{number}_{b}[] = {_numbers(place)};" for b, place in enumerate(places)]
        names = ",".join(f"place_{number}_{b}" for b in range(len(places)))
        sizes = ",".join(str(len(place)) for place in places)
        most = max(map(_largest_batch, bands))
        entries.append(f"{{{channels},{height},{width},{len(bands)},{most},{{{names}}},{{{sizes}}}}}")
    counts, signs = statistics.magnitudes.counts, statistics.signs.counts
    return "\n".join(
        [
            "typedef struct { int channels, height, width, bands, largest_batch; const int *place[20]; "
            "int place_size[20]; } map_t;",
            *lines,
            f"static const map_t maps[] = {{{','.join(entries)}}};",
            f"enum {{ MAPS = {len(entries)}, SUBBAND_SCRATCH = {_SCRATCH}, SUBBAND_TABLES = {_TABLES} }};",
            f"enum {{ START_COUNTS = {counts.size} }};",
            f"static const int64_t start_counts[] = {_numbers(counts)};",
            f"static const int64_t start_signs[] = {_numbers(signs)};\n",
        ]
    )


def seeds(name: str, device) -> list[bytes]:
    """Return inputs of a target that hold what encoders made."""
    if name == "units":
        return _unit_seeds(device)
    if name == "subbands":
        return _subband_seeds(device)
    codec = codec_class(name.split()[0])
    rng = np.random.default_rng(0)
    return [
        bytes([k - 1, h - 1, w - 1])
        + encode(rng.standard_normal((k, h, w, 1)).astype(np.float32), codec.from_config({}), device).body
        for k, h, w in [(1, 1, 1), (4, 5, 9), (1, 16, 40), (4, 33, 70)]
    ]


def _unit_seeds(device) -> list[bytes]:
    found = []
    for number, world in enumerate(unit_layouts()):
        rows, pitch = world.cover.shape[0], world.pitch
        for scale, planes in [(0.3, 3), (2.0, 1), (300.0, 2), (1e7, 1)]:
            if rows * pitch * planes > 1 << 15:
                continue
            rng = np.random.default_rng(number)
            values = np.clip(rng.laplace(size=(planes, rows, pitch)) * scale, -1e8, 1e8).astype(np.float32)
            taken, index = device.empty(values.shape, np.float32, values), device.empty(values.shape, np.int32)
            layout = world.layout(pitch, planes)
            streams = encode_streams(device, layout, taken, index, default_tables(), 0.05).streams
            for first in {0, len(streams) // 2, len(streams) - 1}:
                # `units.c` multiplies by 37, modulo the number of streams, to reach those beyond 255.
                at = next((i for i in range(256) if i * 37 % len(streams) == first), 0)
                chosen = [number, planes - 1, first % 4, scale > 1, 0, at, 0, first % 8, 0, 0]
                found.append(bytes(chosen) + streams[first])
    return [seed for seed in found if len(seed) <= 1024]


def _subband_seeds(device) -> list[bytes]:
    found = []
    for number, (channels, height, width, levels) in enumerate(MAPS):
        for scale in (0.3, 5.0, 1e4, 1e8):
            rng = np.random.default_rng(number)
            index = (
                np.rint(rng.laplace(size=(channels, height, width)) * scale).clip(-(1 << 28), 1 << 28).astype(np.int32)
            )
            coder, bands = Encoder(), list_subbands(height, width, levels)
            code_indices(coder, Statistics(), bands, index.shape, index)
            found.append(bytes([number]) + bytes([128]) * (channels - 1) + coder.to_bytes())
    return found
