"""What a fit or an encoding shows, which is what is measured of it."""

from __future__ import annotations

import time
from dataclasses import dataclass

from clrelight.codec import bent_regions, decode_shown
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.jobs.inputs import FittedLike, Packed, decoded_of
from clrelight.jobs.perceived import Relit, relit_map, relit_regions
from clrelight.jobs.report import Progress, Report, stage


@dataclass(frozen=True)
class Shown:
    """What is relit, before it is a picture.

    Attributes
    ----------
    coefficients : CoefficientMap
        Of radiance, or of values behind a curve: see `clrelight.codec.viewing.decode_shown`.
    curve : str
        ``"linear"`` or ``"srgb"``.
    relit : callable
        Relights parts.
    """

    coefficients: CoefficientMap
    curve: str
    relit: Relit


def shown_of(
    held: CoefficientMap | Packed, source: FittedLike, device: Device, report: Report, progress: Progress | None
) -> Shown:
    """Return what a fit or an encoding that is lent shows, decoded where it is encoded; the report gets the seconds."""
    regions = bent_regions(held.encoded) if isinstance(held, Packed) else None
    if not isinstance(held, Packed) or regions is None:
        coefficients = decoded_of(held, source, device, report, progress)
        return Shown(coefficients, "linear", relit_map(coefficients, device))
    since = time.perf_counter()
    with stage(progress, "decoding"):
        shown_khwc, curve = decode_shown(held.encoded, device)
    report.add("decode", since)
    return Shown(held.record.to_map(shown_khwc), curve, relit_regions(regions, device))
