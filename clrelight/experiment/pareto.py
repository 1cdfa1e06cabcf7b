"""Measured settings against each other: which are beaten in every respect, and which one keeps within given limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from clrelight.errors import InputError
from clrelight.experiment.grid import CodecSetting, Experiment
from clrelight.fit import FitMethod, method_class
from clrelight.fit.cls import ConstrainedLeastSquares
from clrelight.fit.precision import MIXED
from clrelight.results import NO_CODEC

WORSE = 0.3
"""Decibels at held-out lights that a setting may be below the best to be recommended for its size."""

REFERENCE_DEGREE = 6


@dataclass(frozen=True)
class Model:
    """What is fitted, to how many of the lights (None: all that are not held out), and in which precision."""

    method: FitMethod
    degree: int
    lights: int | None = None
    precision: str = MIXED

    @property
    def label(self) -> str:
        """What is fitted, for people, such as ``cls newton degree 4 double``."""
        search = [search_label(self.method)] if isinstance(self.method, ConstrainedLeastSquares) else []
        other = [] if self.precision == MIXED else [self.precision]
        return " ".join([self.method.id, *search, f"degree {self.degree}", *other])


@dataclass(frozen=True, eq=False)
class Trial:
    """A model as stored by a codec, and its row of the results.

    Attributes
    ----------
    model : Model
    setting : CodecSetting
    row : numpy.void
        As measured, of an excerpt of a large image.
    scale : float
        Pixels of the image for each that was measured: seconds and bytes here are those of the whole image.
    planned : float
        Seconds of a fit that an image takes whatever its size.
    """

    model: Model
    setting: CodecSetting
    row: np.void
    scale: float = 1.0
    planned: float = 0.0

    @property
    def stages(self) -> tuple[float, float, float]:
        """Seconds of fitting, encoding and decoding the whole image; NaN for what was refused."""
        fit, encode, decode = (float(self.row[f"seconds_{stage}"]) for stage in ("fit", "encode", "decode"))
        planned = min(self.planned, fit)
        return planned + (fit - planned) * self.scale, encode * self.scale, decode * self.scale

    @property
    def seconds(self) -> float:
        """Of fitting, encoding and decoding; inf for what was refused."""
        total = sum(self.stages)
        return math.inf if math.isnan(total) else total

    @property
    def size(self) -> int:
        """Bytes with every side table."""
        return round(int(self.row["encoded_bytes"]) * self.scale)

    @property
    def psnr(self) -> float:
        """Pooled PSNR in dB at the held-out lights; -inf for what was refused."""
        psnr = float(self.row["psnr_pooled_holdout"])
        return -math.inf if math.isnan(psnr) else psnr

    @property
    def label(self) -> str:
        """The setting for people, such as ``cls newton degree 4, 96 lights, klt 0.5 bit``."""
        return ", ".join([self.model.label, f"{int(self.row['n_light'])} lights", storage_label(self.setting)])

    def to_experiment(self, scene: str, holdout: int, holdout_by: str = "index") -> Experiment:
        """Return the experiment of this one row."""
        model = self.model
        return Experiment(
            (scene,),
            (model.method,),
            (model.degree,),
            (self.setting,),
            holdout,
            lights=model.lights,
            precision=model.precision,
            holdout_by=holdout_by,
        )


def search_label(method: ConstrainedLeastSquares) -> str:
    """Return how lambda is searched, for people: ``newton``, ``newton 2 steps``, or ``8 steps`` of the bisection."""
    steps = f"{method.iterations} step{'s' * (method.iterations > 1)}"
    if method.solver == "newton":
        return "newton" if method.ends else f"newton {steps}"
    return steps


def storage_label(setting: CodecSetting) -> str:
    """Return how coefficients are stored, for people."""
    if setting.id == NO_CODEC:
        return "float32"
    return setting.id if math.isnan(setting.rate) else f"{setting.id} {setting.rate:g} bit"


def recommend(trials: Sequence[Trial]) -> Trial:
    """Return the smallest trial that is at most `WORSE` dB below the best of all, the best of equally small ones."""
    least = max(trial.psnr for trial in trials) - WORSE
    return min((trial for trial in trials if trial.psnr >= least), key=lambda t: (t.size, -t.psnr, t.seconds))


def near_pareto_front(trials: Sequence[Trial], slack: float) -> list[Trial]:
    """Return the trials that no smaller and faster one beats by `slack` dB or more, the best first."""
    kept = [
        each
        for each in trials
        if each.psnr > -math.inf
        and not any(
            other.size <= each.size and other.seconds <= each.seconds and other.psnr >= each.psnr + slack
            for other in trials
            if other is not each
        )
    ]
    return sorted(kept, key=lambda each: -each.psnr)


def find_reference(trials: Sequence[Trial]) -> Trial:
    """Return what steps are compared with: ``cls`` where it was tried, degree 6 or nearly, float32, all lights."""
    plain = [t for t in trials if t.setting.codec is None and t.model.lights is None and t.model.precision == MIXED]
    default = [t for t in plain if t.model.method == method_class("cls")()]
    return min(default or plain, key=lambda t: abs(t.model.degree - REFERENCE_DEGREE))


def best_within(trials: Sequence[Trial], size: float) -> float:
    """Return the best PSNR of the trials that are no larger; -inf where there is none."""
    return max((trial.psnr for trial in trials if trial.size <= size), default=-math.inf)


def best_of_degrees(trials: Sequence[Trial], count: int) -> list[Trial]:
    """Return the `count` best trials of each degree, low degrees first."""
    kept: list[Trial] = []
    for degree in sorted({trial.model.degree for trial in trials}):
        of_degree = [trial for trial in trials if trial.model.degree == degree and trial.psnr > -math.inf]
        kept += sorted(of_degree, key=lambda trial: -trial.psnr)[:count]
    return kept


def pareto_front(trials: Sequence[Trial], cost: str, value: str) -> list[Trial]:
    """Return what is optimal in two of ``"seconds"``, ``"size"`` and ``"psnr"``, cheapest first.

    Less of `cost` is better; of `value` less is better too, unless it is the PSNR.
    """
    sign = -1.0 if value == "psnr" else 1.0
    best, found = math.inf, []
    usable = (each for each in trials if each.psnr > -math.inf)
    for each in sorted(usable, key=lambda t: (getattr(t, cost), sign * getattr(t, value))):
        if sign * getattr(each, value) < best:
            best = sign * getattr(each, value)
            found.append(each)
    return found


@dataclass(frozen=True)
class Limits:
    """What a setting must keep to; None is no limit.

    Attributes
    ----------
    seconds : float or None
        At most, for fitting, encoding and decoding.
    size : int or None
        At most, in bytes.
    psnr : float or None
        At least, pooled, in dB at held-out lights.
    """

    seconds: float | None = None
    size: int | None = None
    psnr: float | None = None

    def __post_init__(self) -> None:
        for name, value in (("seconds", self.seconds), ("bytes", self.size)):
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"a budget of {name} must be above 0, got {value:g}")
        if self.psnr is not None and not math.isfinite(self.psnr):
            raise InputError(f"the least PSNR must be a number of dB, got {self.psnr:g}")

    @property
    def are_set(self) -> bool:
        """Whether anything is limited."""
        return (self.seconds, self.size, self.psnr) != (None, None, None)

    def excess(self, trial: Trial) -> float:
        """Return by how much a trial misses the limits: the sum of the logarithms of the ratios; 0 within them."""
        if trial.psnr == -math.inf:
            return math.inf
        over = 0.0
        if self.seconds is not None:
            over += max(0.0, math.log(trial.seconds / self.seconds))
        if self.size is not None:
            over += max(0.0, math.log(trial.size / self.size))
        if self.psnr is not None:
            over += max(0.0, self.psnr - trial.psnr) * math.log(10.0) / 10.0
        return over

    def choose(self, trials: Sequence[Trial]) -> Trial:
        """Return the best trial within the limits, or what `recommend` does where nothing is limited.

        The best is the one with the highest PSNR; where a PSNR is asked for, the smallest; where bytes are limited too,
        the fastest; where all three are, again the one with the highest PSNR.

        Raises
        ------
        InputError
            If there is none; the message says which one misses the limits by the least.
        """
        if not self.are_set:
            return recommend(trials)
        within = [each for each in trials if self.excess(each) == 0.0]
        if not within:
            nearest = min(trials, key=self.excess)
            raise InputError(
                f"none of the {len(trials)} settings measured is within the limits; the nearest is {nearest.label}: "
                f"{nearest.psnr:.2f} dB, {nearest.size} bytes, {nearest.seconds:.3g} s"
            )
        if self.psnr is not None and self.size is None:
            return min(within, key=lambda t: (t.size, t.seconds))
        if self.psnr is not None and self.seconds is None:
            return min(within, key=lambda t: (t.seconds, t.size))
        return max(within, key=lambda t: (t.psnr, -t.size))
