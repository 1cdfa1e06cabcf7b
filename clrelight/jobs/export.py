"""Write the coefficient maps as textures."""

from __future__ import annotations

import os
import time

from clrelight.codec import Encoded
from clrelight.device import Device
from clrelight.export import check_export, export_textures
from clrelight.jobs.inputs import (
    FittedLike,
    Packed,
    decoded_of,
    lend_fitted,
    opened_on,
    path_text,
    paths_among,
)
from clrelight.jobs.report import Progress, Report, report_for, stage


def export(
    source: FittedLike,
    out: str | os.PathLike[str],
    format: str = "dds",
    *,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Write the coefficient maps as textures, with a JSON file that says what they mean (docs/textures.md).

    Parameters
    ----------
    source : path, CoefficientMap or Encoded
        Blocks of an encoding by bc6h are passed on as they are.
    out : path
        A new folder, which gets one texture for each coefficient; or a name that ends in ``.dds``, which becomes one
        texture array.
    format : str
        ``"dds"``: BC6H blocks that GPUs sample; ``"exr"`` or ``"exr-half"``: images of floats.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).

    Returns
    -------
    Report
        Its facts hold ``files``, the JSON file last, ``format`` and ``bytes``.

    Raises
    ------
    InputError
        If the format is unknown, a file is damaged or none of ours, or `out` cannot be written.
    """
    check_export(path_text(out, "a folder or file to write"), str(format), paths_among(source))
    kept = report_for(report)
    with opened_on(device, kept) as opened:
        since = time.perf_counter()
        with lend_fitted(source, kept) as packed:
            kept.add("read", since)
            blocks: Encoded | None = None
            if format == "dds" and isinstance(packed, Packed) and packed.encoded.codec == "bc6h":
                blocks = packed.encoded
            held = decoded_of(packed, source, opened, kept, progress)
            with stage(progress, "exporting") as tell:
                since = time.perf_counter()
                files = export_textures(held, out, format, blocks=blocks, device=opened, progress=tell)
                kept.add("export", since)
    size = sum(file.stat().st_size for file in files)
    kept.facts = {"files": [str(file) for file in files], "format": format, "bytes": size}
    return kept
