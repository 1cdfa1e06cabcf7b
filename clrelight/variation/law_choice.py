"""Which law a stack's pixels follow, and from where they are seen: what predicts lights best that were left out.

A fourth of the lights in turn is left out of the normals of some pixels, and predicted from them. A term is taken where
it lowers the error of the prediction, which more terms alone do not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.variation.near_lights import NearLights
from clrelight.variation.reflectance import HELD, LEAST_GLOSSY, MORE_STEPS, Law, fit_law
from clrelight.variation.reflectance_kernel import LANES, LawSolver

FOLDS = 4
_FIELDS, _FINER = (15.0, 30.0, 45.0, 60.0), (7.5, 3.75)
_WORTH_FIELD, _WORTH_TERM = 0.985, 0.9
"""Share of the error that has to be left for a near camera, and for another term, to be believed."""


@dataclass(frozen=True)
class Probe:
    """Some pixels of a stack.

    Attributes
    ----------
    samples_cip : ndarray, shape (channel, n_light, P), float32
        Linear radiance; of near lights times the squared distance.
    lights_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors, or positions where there is a place.
    most, floor : float
        As of `clrelight.variation.reflectance.fit_law`.
    look : callable
        Returns unit vectors to a camera of a field in degrees, (P, 3).
    place_3p : ndarray, shape (3, P), float32, optional
        Positions of the pixels.
    """

    samples_cip: NDArray[np.float32]
    lights_i3: NDArray[np.float64]
    most: float
    floor: float
    look: Callable[[float], NDArray[np.float32]]
    place_3p: NDArray[np.float32] | None = None

    def whole(self) -> Probe:
        """Return the first pixels only, so many that a device takes them."""
        count = self.samples_cip.shape[2] // LANES * LANES
        place_3p = None if self.place_3p is None else np.ascontiguousarray(self.place_3p[:, :count])
        samples_cip = np.ascontiguousarray(self.samples_cip[:, :, :count])
        return replace(self, samples_cip=samples_cip, look=lambda field: self.look(field)[:count], place_3p=place_3p)


def held_error(probe: Probe, law: Law, device: Device | None, held: float = HELD) -> float:
    """Return how far off lights are that were left out, from 0 to 1; 1 where none could be predicted."""
    n_light, error, count = len(probe.lights_i3), 0.0, 0.0
    view_p3 = probe.look(law.field)
    for fold in range(FOLDS):
        fitted_i = np.arange(n_light) % FOLDS != fold
        if device is not None:
            solver = LawSolver(
                device,
                probe.lights_i3,
                law,
                fitted_i=fitted_i,
                floor=probe.floor,
                near=probe.place_3p is not None,
                steps=MORE_STEPS,
                held=held,
            )
            found = solver(probe.samples_cip, np.ascontiguousarray(view_p3.T), probe.most, probe.place_3p)
        else:
            lights = probe.lights_i3 if probe.place_3p is None else NearLights(probe.lights_i3).towards(probe.place_3p)
            found = fit_law(
                probe.samples_cip,
                lights,
                view_p3,
                law,
                fitted_i=fitted_i,
                most=probe.most,
                floor=probe.floor,
                steps=MORE_STEPS,
                held=held,
            )
        error, count = error + found.error, count + found.count
    return error / count if count else 1.0


def choose_law(probe: Probe, device: Device | None, field: float | None = None) -> tuple[Law, dict[str, float]]:
    """Return the law that predicts best, and the errors of what was tried by its text.

    Parameters
    ----------
    probe : Probe
    device : Device, optional
    field : float, optional
        What the longer side of the images takes in the camera, in degrees, where it is known.
    """
    matte = Law(glossy=False, field=field or 0.0)
    if device is not None:
        probe = probe.whole()
    if len(probe.lights_i3) < LEAST_GLOSSY or probe.samples_cip.shape[2] == 0:
        return matte, {}
    tried: dict[Law, float] = {}

    def error_of(law: Law) -> float:
        if law not in tried:
            tried[law] = held_error(probe, law, device)
        return tried[law]

    seen = _choose_field(error_of) if field is None else field
    best = Law(field=seen)
    for _ in range(2):
        longer = [replace(best, matte=_with(best.matte, term)) for term in (1, 2) if not best.matte[term]]
        law = min(longer, key=error_of)
        if error_of(law) > _WORTH_TERM * error_of(best):
            break
        best = law
    # Without gloss the camera does not matter: it counts as far away, unless it is known.
    if error_of(matte) <= error_of(best):
        best = matte
    return best, {law.text: error for law, error in tried.items()}


def _with(matte: tuple[bool, bool, bool], term: int) -> tuple[bool, bool, bool]:
    return matte[0], matte[1] or term == 1, matte[2] or term == 2


def _choose_field(error_of: Callable[[Law], float]) -> float:
    """Return the camera's field by which gloss is explained best; 0 where that hardly matters."""
    law = Law(matte=(True, False, True))

    def error(field: float) -> float:
        return error_of(replace(law, field=field))

    best = min((0.0, *_FIELDS), key=error)
    if best == 0.0 or error(best) > _WORTH_FIELD * error(0.0):
        return 0.0
    for step in _FINER:
        best = min((best - step, best, best + step), key=error)
    return best
