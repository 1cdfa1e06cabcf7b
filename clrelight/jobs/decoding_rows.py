"""Some rows of an encoding, decoded to a fit of theirs: one of the tiles in which a large one is decoded."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.workspace import BoundedWorkspace
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.inputs import lend_encoded, opened_on, whole
from clrelight.jobs.outputs import claimed
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import create_fit
from clrelight.store.coding import RowTarget
from clrelight.tiles import row_tiles


class _SomeRows(RowTarget):
    """A target of which only some rows are to be filled."""

    wanted = (0, 0)

    def row_parts(self, multiple: int = 1) -> list[slice]:
        """See `Target`; parts of the wanted rows."""
        first, end = self.wanted
        step = max(part.stop - part.start for part in super().row_parts(multiple))
        return [slice(*part) for part in row_tiles((first, end), step)]


def decode_rows(
    source: str | os.PathLike[str],
    rows: Sequence[int],
    *,
    out: str | os.PathLike[str],
    memory: int | str = DEFAULT_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Decode some rows into a fit file of theirs.

    Parameters
    ----------
    source : path
        An encoded file whose parts can be decoded alone: codecs ``klt`` and ``wavelet``.
    rows : (first, end)
        Best where both are multiples of a precinct (`clrelight.codec.entropy.units.PRECINCT`).
    out : path
        The shard to write.
    memory : int or str
        Bytes that decoding takes.
    device, progress, report
        As of `clrelight.jobs.decode.decode`.

    Raises
    ------
    InputError
        If the file is damaged there, or of a codec without parts; there are no such rows; or `out` cannot be written.
    """
    kept, budget = report_for(report), count_bytes(memory)
    first, end = (whole(each, "rows") for each in rows)
    with (
        claimed([out], [source], kept),
        opened_on(device, kept) as opened,
        lend_encoded(source, kept, parts=True) as packed,
    ):
        regions, encoded = packed.regions(), packed.encoded
        if regions is None:
            raise InputError(f"an encoding by {encoded.codec} is decoded as a whole: tiles are for klt and wavelet")
        if not 0 <= first < end <= encoded.shape[1]:
            raise InputError(f"there are no rows {first} to {end} of {encoded.shape[1]}")
        since = time.perf_counter()
        with (
            create_fit(out, packed.record, (end - first, *encoded.shape[2:])) as sink,
            stage(progress, f"decoding {encoded.codec}") as tell,
        ):

            def write(row: int, coeffs_khwc: NDArray[np.float32]) -> None:
                sink.write_rows(row - first, coeffs_khwc, None, None)
                tell(row - first + coeffs_khwc.shape[1], end - first)

            workspace = BoundedWorkspace(budget)
            target = _SomeRows(
                encoded.shape, opened, workspace, write, codec_id=encoded.codec, row_step=sink.coeffs_khwc.chunks[1]
            )
            target.wanted = first, end
            regions.put_rows(target, opened)
        kept.add("decode", since)
    return kept
