"""Write what a fit is expected to reach under each light as a picture."""

from __future__ import annotations

import os
import time

import numpy as np

from clrelight.fit import PreparedFit
from clrelight.fit.confidence import map_confidence
from clrelight.jobs.report import Report


def write_confidence(path: str | os.PathLike[str], prepared: PreparedFit, report: Report) -> None:
    """Write the PSNR in dB that a prepared fit is expected to reach; `report` gets the range.

    Raises
    ------
    InputError
        If the method has no variance to tell it from, or the picture cannot be written.
    """
    from clrelight.jobs.pictures import write_decibels  # libraries of images, which no other fit needs

    since, config = time.perf_counter(), prepared.config
    psnr_hw1 = map_confidence(prepared.stack, prepared.method, config["weights"], config["sampling"])
    inside = psnr_hw1[psnr_hw1 != 0.0]
    write_decibels(os.fsdecode(path), psnr_hw1)
    report.facts["confidence"] = {
        "file": os.fsdecode(path),
        "psnr_least": float(inside.min()),
        "psnr_median": float(np.median(inside)),
        "psnr_most": float(inside.max()),
    }
    report.add("confidence", since)
