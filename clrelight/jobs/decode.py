"""Turn an encoding back into a fit."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import overload

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Encoded, bytes_to_decode, decode_stream
from clrelight.codec import decode as decode_payload
from clrelight.codec.rooms import Room
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.jobs.inputs import opened_on, paths_among, take_encoded
from clrelight.jobs.outputs import claimed
from clrelight.jobs.parts import DEFAULT_MEMORY, check_memory, fits
from clrelight.jobs.region import Part, decode_part, take_part
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.sizes import size_facts
from clrelight.jobs.written import count_bytes
from clrelight.store import create_fit, write_fit
from clrelight.store.coding import RowTarget
from clrelight.store.encodings import stage_encoded
from clrelight.store.scratch import ScratchRoom, scratch_room
from clrelight.streaming import writing_behind


@overload
def decode(
    source: str | os.PathLike[str] | Encoded,
    *,
    out: None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap: ...


@overload
def decode(
    source: str | os.PathLike[str] | Encoded,
    *,
    out: str | os.PathLike[str],
    region: Sequence[int] | None = None,
    level: int = 0,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report: ...


def decode(
    source: str | os.PathLike[str] | Encoded,
    *,
    out: str | os.PathLike[str] | None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Turn an encoding back into a fit.

    Parameters
    ----------
    source : path or Encoded
    out : path, optional
        A fit file to write, piece by piece; without it the map is returned.
    region : four whole numbers, optional
        Column and row of the first pixel, width and height: this part alone, in pixels of the whole image.
    level : int
        Width and height are halved so often, without decoding what is not needed (files of codec klt or wavelet).
    memory : int or str, optional
        Bytes for parts of the map, such as ``"1GiB"``: a codec that needs more is refused. Without it parts take
        256 MiB, and a codec that needs more says so in a note.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    CoefficientMap
        With `out` instead the report.

    Raises
    ------
    InputError
        If a file is damaged or none of ours, `memory` does not do, or `out` cannot be written.
    """
    part, kept = take_part(region, level), report_for(report)
    limit = None if memory is None else count_bytes(memory)
    with claimed([out], paths_among(source), kept), opened_on(device, kept) as opened:
        since = time.perf_counter()
        if not part.is_all:
            return _take_part(source, part, out, opened, kept)
        if out is None:
            encoded, record = take_encoded(source)
            since = kept.add("read", since)
            _tell(encoded, limit, kept)
            with stage(progress, f"decoding {encoded.codec}"):
                coefficients = record.to_map(decode_payload(encoded, opened))
            kept.add("decode", since)
            return coefficients
        with scratch_room(Path(os.fsdecode(out)).parent, limit or DEFAULT_MEMORY) as room:
            encoded, record = take_encoded(source) if isinstance(source, Encoded) else stage_encoded(source, room)
            kept.add("read", since)
            _tell(encoded, limit, kept)
            _write(out, encoded, record, opened, room, kept, progress)
    kept.facts = {"file": os.fsdecode(out), **kept.facts}
    return kept


def _take_part(
    source: str | os.PathLike[str] | Encoded,
    part: Part,
    out: str | os.PathLike[str] | None,
    device: Device,
    report: Report,
) -> CoefficientMap | Report:
    """Decode a part of an image, which is held in memory."""
    since = time.perf_counter()
    encoded, record = take_encoded(source)  # type: ignore[arg-type]
    report.facts |= size_facts(encoded)
    since = report.add("read", since)
    coefficients = decode_part(encoded, record, part, device)
    since = report.add("decode", since)
    if out is None:
        return coefficients
    write_fit(os.fsdecode(out), coefficients)
    report.add("write", since)
    report.facts = {"file": os.fsdecode(out), **report.facts}
    return report


def _tell(encoded: Encoded, memory: int | None, report: Report) -> None:
    report.note(*check_memory(f"decoding {encoded.codec}", bytes_to_decode(encoded), memory))
    report.facts |= size_facts(encoded)


def _write(
    out: str | os.PathLike[str],
    encoded: Encoded,
    record: FitRecord,
    device: Device,
    room: ScratchRoom,
    report: Report,
    progress: Progress | None,
) -> None:
    """Decode to a file, which stands once it is whole."""
    with create_fit(out, record, encoded.shape[1:]) as sink:

        def write(rows: tuple[int, NDArray[np.float32]]) -> None:
            sink.write_rows(*rows, None, None)

        since = time.perf_counter()
        with stage(progress, f"decoding {encoded.codec}") as room.progress, writing_behind(write) as put:

            def hand_on(first: int, coeffs_khwc: NDArray[np.float32]) -> None:
                put((first, coeffs_khwc))

            target = RowTarget(
                encoded.shape,
                device,
                Room() if fits(room, encoded.shape) else room,
                hand_on,
                codec_id=encoded.codec,
                row_step=sink.coeffs_khwc.chunks[1],
            )
            decode_stream(encoded, target, device)
            since = report.add("decode", since)
    report.add("write", since)
