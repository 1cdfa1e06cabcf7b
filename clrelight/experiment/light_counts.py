"""What fewer lights cost: fits of some of a stack's lights, measured at lights that none of them has seen."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.fit.plan import is_sphere
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import split_chosen
from clrelight.jobs.fit import fit
from clrelight.jobs.report import Report
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.plan_lights import LightQuality, assess_lights, choose_lights

HOLDOUT = 5

_UNBOUNDED = ("uls", "sloan")
"""Methods that need a light for every coefficient."""


@dataclass(frozen=True)
class MeasuredChoice:
    """Some of a stack's lights, and what fits to them reach at the held-out ones.

    Attributes
    ----------
    choice : str
        How they were chosen, one of `clrelight.plan_lights.CHOICES`.
    quality : LightQuality
        What is predicted from the directions alone.
    psnr : dict of str to float
        Pooled PSNR in dB at the held-out lights by method; NaN where a method cannot fit so few lights.
    """

    choice: str
    quality: LightQuality
    psnr: dict[str, float]


def measure_choices(
    stack: LightStack,
    counts: Sequence[int] | None,
    choices: Sequence[str],
    methods: Sequence[str],
    degree: int,
    *,
    holdout: int = HOLDOUT,
    seed: int = 0,
    device: Device | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[MeasuredChoice]:
    """Fit every count and choice of the lights by every method, and measure at every `holdout`-th light of the stack.

    No choice ever holds one of the lights that are measured. Parameters are those of `clrelight.plan_lights` and
    `clrelight.fit`; without `counts`, a quarter, half and all of the lights that are not held out.

    Raises
    ------
    InputError
        If a count is more than the lights left beside the held-out ones, or a method or choice is unknown.
    """
    device = device or open_device()
    rest, held = split_chosen(stack.directions_i3, holdout)
    sphere = is_sphere(stack.directions_i3)
    counts = counts or sorted({max(1, len(rest) // 4), max(1, len(rest) // 2), len(rest)})
    if max(counts) > len(rest):
        raise InputError(
            f"{max(counts)} lights cannot be chosen: the stack has {stack.n_light}, of which {len(held)} are held out"
        )
    towards_i3 = stack.directions_i3[rest]
    # Chosen before the first fit, so that what is wrong is said at once.
    chosen = [
        (choice, rest[choose_lights(choice, towards_i3, count, degree, sphere=sphere, seed=seed)])
        for count in counts
        for choice in choices
    ]
    unseen = stack.select(held)
    measured = []
    for index, (choice, lights_i) in enumerate(chosen):
        psnr = {}
        for step, method in enumerate(methods):
            if progress is not None:
                progress(index * len(methods) + step, len(chosen) * len(methods))
            psnr[method] = _measure(stack.select(lights_i), unseen, method, degree, device)
        measured.append(
            MeasuredChoice(choice, assess_lights(stack.directions_i3[lights_i], degree, sphere=sphere), psnr)
        )
    return measured


def _measure(seen: LightStack, unseen: LightStack, method: str, degree: int, device: Device) -> float:
    if method in _UNBOUNDED and seen.n_light < coefficient_count(degree):
        return math.nan
    coefficients = fit(seen, method, degree, device=device, measure=False, report=Report())
    return summarize_errors(measure_errors(coefficients, unseen, device=device)).psnr_pooled
