"""A model that was tried, and what a choice among such came to."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.curved import CurvedSpectrumFit
from clrelight.fit.registry import FitMethod

CLEAR = 0.5
"""Decibels by which another method than spectrum must be better."""
IN_GAPS, AT_GIVEN = "unseen lights", "the lights held out"


@dataclass(frozen=True)
class Candidate:
    """A model, and what it is expected to reach at unseen lights.

    Attributes
    ----------
    method : FitMethod
    degree : int
    predicted : float or None
        Mean PSNR in dB between the lights; None where that is unknown.
    in_folds : float or None
        Mean PSNR in dB at lights left out with their neighbours; None where nothing can be left out.
    error_g : ndarray
        Mean squared error at each of them, NaN where it was not tried.
    """

    method: FitMethod
    degree: int
    predicted: float | None = None
    in_folds: float | None = None
    error_g: NDArray[np.float64] = field(default_factory=lambda: np.zeros(0), compare=False, repr=False)

    def __str__(self) -> str:
        folds = "unknown" if self.in_folds is None else f"{self.in_folds:.2f} dB at lights left out with neighbours"
        return f"{self.method.id} at degree {self.degree} ({folds})"

    def to_config(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "method": self.method.id,
            "degree": self.degree,
            "psnr_predicted": self.predicted,
            "psnr_folds": self.in_folds,
        }


@dataclass(frozen=True)
class Choice:
    """The model taken, the next best, all that were tried, and why the prediction is unknown where it is.

    `settled` is the method taken with what it has learnt, where it is known already; `at` says which lights the
    prediction is for. `code_gain` are the decibels by which values as displayed are fitted better, at left-out lights.
    `most` is the degree that would have been taken where coefficients cost nothing.
    """

    chosen: Candidate
    runner_up: Candidate | None
    tried: tuple[Candidate, ...]
    spread: float = 0.0
    why_unknown: str | None = None
    settled: FitMethod | None = None
    at: str = IN_GAPS
    code_gain: float | None = None
    most: int = 0

    @property
    def note(self) -> str:
        """What the user should know."""
        after = f"; next {self.runner_up}" if self.runner_up else ""
        if self.chosen.predicted is None:
            expected = f"PSNR at {self.at} unknown: {self.why_unknown}"
        else:
            expected = f"{self.chosen.predicted:.2f} dB (+- {self.spread:.2f}) predicted at {self.at}"
        if self.most > self.chosen.degree:
            times = ((self.most + 1) / (self.chosen.degree + 1)) ** 2
            expected += f"; degree {self.most}, {times:.1f} times the coefficients, would likely gain less than 0.1 dB"
        took = f"{self.chosen.method.id} at degree {self.chosen.degree}"
        return f"auto took {took} of {len(self.tried)} models; {expected}{after}{self._domain}"

    @property
    def _domain(self) -> str:
        if self.code_gain is None or self.code_gain < CLEAR:
            return ""
        if isinstance(self.chosen.method, CurvedSpectrumFit):
            return f"; {self.code_gain:.1f} dB better there than fitted as radiance"
        return f"; spectrum-curve, which fits values as displayed, could be {self.code_gain:.1f} dB better"

    def to_config(self) -> dict[str, Any]:
        """Return it as a JSON object."""
        return {
            "chosen": self.chosen.to_config(),
            "runner_up": None if self.runner_up is None else self.runner_up.to_config(),
            "tried": [candidate.to_config() for candidate in self.tried],
            "spread": self.spread,
            "why_unknown": self.why_unknown,
            "code_gain": self.code_gain,
        }
