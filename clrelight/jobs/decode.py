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
from clrelight.codec.workspace import Workspace
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.jobs.inputs import Packed, lend_encoded, opened_on, paths_among
from clrelight.jobs.outputs import claimed
from clrelight.jobs.parts import check_memory, fits
from clrelight.jobs.region import Part, decode_part, take_part
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.sizes import size_facts
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import create_fit, write_fit
from clrelight.store.coding import RowTarget
from clrelight.store.scratch import ScratchWorkspace, scratch_workspace
from clrelight.streaming import writing_behind


@overload
def decode(
    source: str | os.PathLike[str] | Encoded,
    *,
    out: None = None,
    region: Sequence[int] | None = None,
    level: int = 0,
    salvage: bool = False,
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
    salvage: bool = False,
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
    salvage: bool = False,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> CoefficientMap | Report:
    """Turn an encoding back into a fit.

    Parameters
    ----------
    source : path, URL or Encoded
    out : path, optional
        A fit file to write, piece by piece; without it the map is returned.
    region : four whole numbers, optional
        Column and row of the first pixel, width and height: this part alone, in pixels of the whole image.
    level : int
        Width and height are halved so often, without decoding what is not needed (files of codec klt or wavelet).
    salvage : bool
        Decode what is left of a damaged file of codec klt or wavelet: notes, and ``damaged`` in the report, say what is
        filled.
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
        if not part.is_all or (salvage and out is None):
            return _take_part(source, part, salvage, out, opened, kept)
        since = time.perf_counter()
        if out is None:
            with lend_encoded(source, kept) as packed:
                since = kept.add("read", since)
                _tell(packed.encoded, limit, kept)
                with stage(progress, f"decoding {packed.encoded.codec}"):
                    coefficients = packed.record.to_map(decode_payload(packed.encoded, opened))
            kept.add("decode", since)
            return coefficients
        with (
            scratch_workspace(Path(os.fsdecode(out)).parent, limit or DEFAULT_MEMORY) as workspace,
            lend_encoded(source, kept, salvage=salvage, workspace=workspace) as packed,
        ):
            kept.add("read", since)
            _tell(packed.encoded, limit, kept)
            _write(out, packed, opened, workspace, kept, progress)
    kept.facts = {"file": os.fsdecode(out), **kept.facts}
    return kept


def _take_part(
    source: str | os.PathLike[str] | Encoded,
    part: Part,
    salvage: bool,
    out: str | os.PathLike[str] | None,
    device: Device,
    report: Report,
) -> CoefficientMap | Report:
    """Decode a part of an image, which is held in memory."""
    since = time.perf_counter()
    with lend_encoded(source, report, parts=True, salvage=salvage) as packed:
        report.facts |= size_facts(packed.encoded)
        since = report.add("read", since)
        coefficients = decode_part(packed, part, device)
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
    packed: Packed,
    device: Device,
    workspace: ScratchWorkspace,
    report: Report,
    progress: Progress | None,
) -> None:
    """Decode to a file, which stands once it is whole."""
    encoded = packed.encoded
    regions = None if packed.damage is None else packed.regions()
    with create_fit(out, packed.record, encoded.shape[1:]) as sink:

        def write(rows: tuple[int, NDArray[np.float32]]) -> None:
            sink.write_rows(*rows, None, None)

        since = time.perf_counter()
        with stage(progress, f"decoding {encoded.codec}") as workspace.progress, writing_behind(write) as put:

            def hand_on(first: int, coeffs_khwc: NDArray[np.float32]) -> None:
                put((first, coeffs_khwc))

            target = RowTarget(
                encoded.shape,
                device,
                Workspace() if fits(workspace, encoded.shape) else workspace,
                hand_on,
                codec_id=encoded.codec,
                row_step=sink.coeffs_khwc.chunks[1],
            )
            if regions is None:
                decode_stream(encoded, target, device)
            else:
                regions.put_rows(target, device)
            since = report.add("decode", since)
    report.add("write", since)
