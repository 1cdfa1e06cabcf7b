"""Timing in turns; see `clrelight.speed.timing`."""

from clrelight.speed.timing import SETTLE_SECONDS, Quartiles, Timings, interleave, quartiles

__all__ = ["SETTLE_SECONDS", "Quartiles", "Timings", "interleave", "quartiles"]
