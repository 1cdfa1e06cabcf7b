"""What a trade-off varies."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.experiment.grid import CodecSetting, Experiment, make_methods, make_settings
from clrelight.fit.cls import CONVERGED_AFTER, ConstrainedLeastSquares
from clrelight.fit.precision import MIXED
from clrelight.fit.selection import DEGREES, METHODS
from clrelight.holdout import split_chosen
from clrelight.results import NO_CODEC

HALF = "half"
LEAST_LIGHTS = 10
"""Fewer lights to fit make no sweep."""


@dataclass(frozen=True)
class Axes:
    """What is varied.

    Attributes
    ----------
    methods : tuple of str
        By default those that ``auto`` chooses from.
    degrees : tuple of int
        Tried upwards; by default those of ``auto``.
    iterations : tuple of int
        Steps of the bisection of ``cls``, tried beside its Newton search.
    newton_steps : tuple of int
        Steps of the Newton search, tried beside the one that ends by itself.
    precisions : tuple of str
        Tried beside mixed; empty: all whose kernels differ.
    lights : tuple of int
        Numbers of lights fitted beside all, well spread; empty: a half and a quarter.
    codecs : tuple of str
        Beside float32.
    rates : tuple of float
        Bits per coefficient of the codecs that take a rate, tried downwards.
    holdout : int
        Every `holdout`-th light is in no fit, and measures them all.
    holdout_by : str
        Which ones, one of `clrelight.holdout.HOLDOUTS`.
    megapixels : float
        Larger images are measured in windows of so many megapixels together; inf: whole.
    """

    methods: tuple[str, ...] = METHODS
    degrees: tuple[int, ...] = DEGREES
    iterations: tuple[int, ...] = (4, 8, 16, 32)
    newton_steps: tuple[int, ...] = (1, 2, 4, 8)
    precisions: tuple[str, ...] = ()
    lights: tuple[int, ...] = ()
    codecs: tuple[str, ...] = (HALF, "klt", "wavelet", "s3tc")
    rates: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1)
    holdout: int = 5
    holdout_by: str = "index"
    megapixels: float = 0.1

    def __post_init__(self) -> None:
        if not self.megapixels > 0.0:
            raise InputError(f"megapixels must be above 0, got {self.megapixels:g}")
        # Makes every setting once, so that what is unknown is said before anything is measured.
        plain = tuple(method for name in self.methods for method in make_methods(name, {}))
        if any(isinstance(method, str) for method in plain):
            raise InputError("the sweep chooses by measuring: leave auto out of the methods")
        codecs = tuple(setting for ladder in self.ladders() for setting in ladder)
        for precision in self.precisions or (MIXED,):
            Experiment(
                methods=plain,
                degrees=self.degrees,
                codecs=codecs or (CodecSetting(),),
                holdout=self.holdout,
                holdout_by=self.holdout_by,
                precision=precision,
            )
        self.searches()
        most = CONVERGED_AFTER["newton"] - 1
        if ending := [steps for steps in self.newton_steps if steps > most]:
            raise InputError(
                f"newton steps must be at most {most}, got {ending[0]}: with more it ends by itself, as it does anyway"
            )
        if bad := [number for number in self.lights if number < LEAST_LIGHTS]:
            raise InputError(f"numbers of lights must be at least {LEAST_LIGHTS}, got {bad[0]}")

    def split(self, directions_i3: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the lights that may be fitted, and those that measure all fits."""
        return split_chosen(directions_i3, self.holdout, by=self.holdout_by)

    def ladders(self) -> list[list[CodecSetting]]:
        """Return the settings of each codec, generous rates first; a codec without a rate has one."""
        found = []
        for name in self.codecs:
            if name == NO_CODEC:
                continue
            settings = make_settings(name, {})
            if not math.isnan(settings[0].rate) and "rate" in settings[0].config:
                settings = make_settings(name, {"rate": sorted(set(self.rates), reverse=True)})
            found.append(settings)
        return found

    def searches(self) -> list[ConstrainedLeastSquares]:
        """Return ``cls`` by bisection and by Newton with each number of steps."""
        asked = (("bisection", self.iterations), ("newton", self.newton_steps))
        return [ConstrainedLeastSquares(solver=name, iterations=steps) for name, each in asked for steps in each]
