"""The smallest encoding that reaches a quality."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from clrelight.codec import Codec, Encoded, codec_class, decode_shown, encode
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.holdout import split_by_fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.search import search_falling

TOLERANCE = 0.3
"""Decibel above the target that are near enough; below it nothing is."""
BEST = 50.0
"""Decibel above which nobody sees what a fit gets wrong: a loss is counted from here."""
_TYPICAL_SLOPE = 2.0  # dB for twice the step, to make a second guess from
_MAX_TRIALS = 24
_ADVICE = "or fit with another method or degree (auto takes what is best at unseen lights)"


@dataclass(frozen=True)
class Trial:
    """One encoding that was tried.

    Attributes
    ----------
    setting : float
        Quantiser step (klt) or rate (wavelet).
    bytes : int
        Payload and every side table.
    psnr : float
        In decibel, at the lights that the target is about: pooled, or for a loss the mean.
    """

    setting: float
    byte_count: int
    psnr: float


def encode_to_quality(
    coefficients: CoefficientMap,
    stack: LightStack,
    target_psnr: float | None,
    *,
    loss: float = 0.0,
    tolerance: float = TOLERANCE,
    codec: str = "klt",
    metric: str = "radiance",
    device: Device,
    progress: Callable[[str], None] | None = None,
) -> tuple[Encoded, list[Trial], str]:
    """Encode with as few bytes as a pooled PSNR allows.

    Parameters
    ----------
    coefficients : CoefficientMap
    stack : LightStack
        What to measure against: at the lights that the fit has not seen, where there are any, else at those it has.
    target_psnr : float, optional
        Decibel, pooled. The result lies between it and `tolerance` above.
    loss : float
        Without a target: how many decibels less than the fit itself are enough, in the mean over the lights.
    tolerance : float
        Decibels.
    codec : str
        ``"klt"`` or ``"wavelet"`` (with one step for all maps).
    metric : str
        What errors cost (klt).
    device : Device
    progress : callable, optional
        Told what is tried.

    Returns
    -------
    encoded : Encoded
    trials : list of Trial
        In the order tried.
    why : str
        Why the search ended.

    Raises
    ------
    InputError
        If not even the uncompressed fit reaches the target.
    """
    coefficients = coefficients.to_float32()
    fitted, held = split_by_fit(stack, coefficients)
    lights = held if len(held) else fitted
    chosen = stack if len(lights) == stack.n_light else stack.select(lights)

    def measure(candidate: CoefficientMap, behind: str = "linear") -> float:
        found = summarize_errors(measure_errors(candidate, chosen, behind=behind, device=device))
        # Of a loss every light has its share; pooled, those that the fit shows worst would hide it from all others.
        return found.psnr_pooled if by_target else float(np.mean(np.minimum(found.psnr_i, BEST)))

    by_target = target_psnr is not None
    best = measure(coefficients)
    place = "at unseen lights" if len(held) else "at the fitted lights"
    target_psnr = best - loss if target_psnr is None else target_psnr
    if best < target_psnr:
        raise _too_much(target_psnr, best, place)
    make, bounds, start = _family(codec, coefficients.transfer, metric)
    trials: list[Trial] = []
    found: tuple[Encoded, Trial] | None = None

    def try_place(place: float) -> float:
        nonlocal found
        setting, made = make(place)
        encoded = encode(coefficients.coeffs_khwc, made, device, coefficients.basis, coefficients.fitted_lights)
        shown_khwc, curve = decode_shown(encoded.to_bytes(), device)
        psnr = measure(replace(coefficients, coeffs_khwc=shown_khwc), curve)
        trials.append(trial := Trial(setting, encoded.encoded_bytes, psnr))
        if progress is not None:
            progress(f"{trial.byte_count} bytes, {trial.psnr:.2f} dB")
        if trial.psnr >= target_psnr and (found is None or trial.byte_count < found[1].byte_count):
            found = encoded, trial
        return trial.psnr

    aim = target_psnr + tolerance / 3
    search_falling(
        try_place,
        start,
        bounds,
        aim,
        limit=target_psnr,
        is_enough=lambda psnr: target_psnr <= psnr <= target_psnr + tolerance,
        expect=lambda place, psnr: place + (psnr - aim) / _TYPICAL_SLOPE,
        most=_MAX_TRIALS,
        width=1e-3,
    )
    if found is None:
        raise InputError(f"codec {codec} does not reach {target_psnr:g} dB {place} at its finest setting")
    return found[0], trials, _why_ended(trials, target_psnr, tolerance)


def _too_much(target_psnr: float, best: float, place: str) -> InputError:
    reached, most = f"the fit itself reaches {best:.2f} dB {place}", math.floor(best * 10) / 10
    return InputError(f"{reached}, the target is {target_psnr:g} dB: ask for {most:g} dB at most, {_ADVICE}")


def _why_ended(trials: list[Trial], target: float, tolerance: float) -> str:
    if target <= trials[-1].psnr <= target + tolerance:
        return f"{trials[-1].psnr:.2f} dB is within {tolerance:g} dB of the target"
    if len(trials) == _MAX_TRIALS:
        return f"the search ended after {_MAX_TRIALS} trials"
    return "no coarser setting reaches the target"


def _family(
    codec: str, transfer: str, metric: str
) -> tuple[Callable[[float], tuple[float, Codec]], tuple[float, float], float]:
    """Return how to make setting and codec of a place, and the finest, the coarsest and the first place."""
    if codec == "klt":
        sign, bounds, start, name, options = 1.0, (-20.0, 2.5), -5.0, "step", {"transfer": transfer, "metric": metric}
    elif codec == "wavelet":
        sign, bounds, start, name, options = -1.0, (-4.0, 6.0), 1.0, "rate", {"allocation": "global"}
    else:
        raise InputError(f"a quality can be asked of klt and wavelet, not of {codec}")

    def make(place: float) -> tuple[float, Codec]:
        setting = 2.0 ** (sign * place)
        return setting, codec_class(codec).from_config({name: setting, **options})

    return make, bounds, start
