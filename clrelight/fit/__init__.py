"""Fits: samples of every pixel to spherical-harmonic coefficients. Importing this package registers all methods."""

from clrelight.fit import linear  # noqa: F401, I001 - the order of registration is the order of tables
from clrelight.fit import cls, ceb, spline, spectrum, curved, constrained  # noqa: F401
from clrelight.fit.prepare import FitReport, PreparedFit, prepare_fit
from clrelight.fit.registry import FitMethod, method_class, method_ids, register
from clrelight.fit.run import collect_fit, fit_tiles
from clrelight.fit.tile import FittedTile

__all__ = [
    "FitMethod",
    "FitReport",
    "FittedTile",
    "PreparedFit",
    "collect_fit",
    "fit_tiles",
    "method_class",
    "method_ids",
    "prepare_fit",
    "register",
]
