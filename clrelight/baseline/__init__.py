"""What other tools do with the same images, to compare with in the same tables."""

from clrelight.baseline.rti import BASES, RtiFit, RtiQuality, fit_rti, measure_rti

__all__ = ["BASES", "RtiFit", "RtiQuality", "fit_rti", "measure_rti"]
