"""What other tools do with the same images, to compare with in the same tables."""

from clrelight.baseline.rti import BASES, RtiQuality, measure_rti

__all__ = ["BASES", "RtiQuality", "measure_rti"]
