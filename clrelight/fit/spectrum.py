"""Kriging on the sphere: the fit whose smoothness is learnt from lights that are left out with their neighbours."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.fit.axial import AxialStep, learn_step
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.learning import learn_theta
from clrelight.fit.leave_out_error import Trials
from clrelight.fit.left_out import FEWEST, Moments
from clrelight.fit.places import find_places, spread_points
from clrelight.fit.plan import FitPlan, Lighting, is_sphere
from clrelight.fit.registry import FitMethod, register
from clrelight.fit.samples import Samples
from clrelight.fit.zonal import LARGEST_DEGREE, Theta
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.threads import on_one_thread

_RANGES = {"slope": (-3.0, 6.0), "azimuth": (-3.0, 3.0), "share": (0.0, 1.0)}
_RANGE = 1e-12, 1e6
"""Of the others."""
_NAMES = "level", "slope", "edge", "heat", "noise", "azimuth", "tilt"
"""In the order of `Theta.to_logs`."""
_PLAIN = "slope", "azimuth"
"""Those that are no logarithm there."""


@register
@dataclass(frozen=True)
class SpectrumFit(FitMethod):
    """``c = A Y' (Y A Y' + N)^-1 beta``, the posterior mean of coefficients of covariance A.

    A is diagonal at first, with the variances of `clrelight.fit.zonal.Theta`, one set for a stack; to these a share of
    what the samples' moments add is added (`clrelight.fit.axial`). One linear map for all pixels.

    Attributes
    ----------
    level, slope, edge, heat, noise, azimuth, tilt : float or None
    limit : int or None
        As in `Theta`. None: learnt from the samples.
    share : float or None
        As in `AxialStep`. None: learnt from the samples.
    """

    id = "spectrum"
    title = "Spectrum"
    summary = "kriging: the energy of each degree, and the noise, learnt from lights that are left out"
    level: float | None = None
    slope: float | None = None
    edge: float | None = None
    heat: float | None = None
    noise: float | None = None
    azimuth: float | None = None
    tilt: float | None = None
    limit: int | None = None
    share: float | None = None
    step: ClassVar[AxialStep | None] = None
    """Of an instance that is settled; no option, since it is thousands of numbers that the samples tell again."""

    def __post_init__(self) -> None:
        if self.limit is not None and (type(self.limit) is not int or not 1 <= self.limit <= LARGEST_DEGREE):
            raise InputError(f"limit must be a degree from 1 to {LARGEST_DEGREE}, got {self.limit!r}")
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "limit" or value is None:
                continue
            low, high = _RANGES.get(field.name, _RANGE)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (is_number and low <= value <= high):
                raise InputError(f"{field.name} must be a number from {low:g} to {high:g}, got {value!r}")
            object.__setattr__(self, field.name, float(value))

    def settle(self, lighting: Lighting, degree: int, samples: Samples) -> FitMethod:
        """Return the method with every parameter found that is not given."""
        values = asdict(self)
        if None not in values.values() and (self.share == 0.0 or self.step is not None):
            return self
        places = find_places(lighting)
        # Scaled by the brightest: squares of samples far from the peak would leave float64.
        mean_gp = places.mean_gi @ samples.radiance_ip
        most = float(np.abs(mean_gp).max())
        mean_gp = mean_gp / most if most > 0.0 else mean_gp
        stack = samples.stack
        quantum = 1.0 / stack.peak / most if stack.images_ihwc.dtype.kind == "u" and most > 0.0 else 0.0
        given = {
            k: float(values[name] if name in _PLAIN else np.log(values[name]))
            for k, name in enumerate(_NAMES)
            if values[name] is not None
        }
        with on_one_thread():
            moments = Moments.make(mean_gp, quantum)
            theta = learn_theta(places, moments, given, self.limit)
            # Numbers that were given are told as they were, not as their logarithms' exponentials.
            theta = replace(theta, **{name: values[name] for name in _NAMES if values[name] is not None})
            step = learn_step(places, theta, moments.product_gg, self.share)
        share = 0.0 if step is None and self.share is None else self.share
        settled = type(self)(**asdict(theta), share=step.share if step is not None else share)
        object.__setattr__(settled, "step", step)
        return settled

    def model(self, lighting: Lighting) -> KrigingModel:
        """Return the settled model of these lights."""
        values = asdict(self)
        share = values.pop("share")
        if values["limit"] is None:  # as those that were learnt before there were limits
            values["limit"] = LARGEST_DEGREE
        if None in values.values() or share is None:
            raise ValueError("parameters are not settled yet: settle the method, or give all of them")
        return KrigingModel.make(find_places(lighting), Theta(**values), self.step)

    def view(self, trials: Trials) -> Trials:
        """Return trials of the values that this krigs."""
        return trials

    def relit(
        self, model: KrigingModel, samples: Samples, degree: int, targets_t3: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return a degree's series at directions, (n_target, P), made of samples of what this krigs."""
        return np.asarray(evaluate_basis(targets_t3, degree) @ model.map_samples(degree) @ samples.radiance_ip)

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices; any number of lights is legal."""
        with on_one_thread():
            model = self.model(lighting)
            map_ki = model.map_samples(degree)
            turn_ri = _order_components(map_ki, degree, is_sphere(lighting.directions_i3))
            condition = float(np.linalg.cond(model.covariance_gg))
        energy_i = 4.0 * np.pi * lighting.solid_angles_i / lighting.solid_angles_i.sum()
        notes = describe(model, degree)
        return FitPlan(turn_ri, map_ki @ turn_ri.T, np.ones(len(turn_ri)), energy_i, condition, notes)


def _order_components(map_ki: NDArray[np.float64], degree: int, sphere: bool) -> NDArray[np.float64]:
    """Return orthonormal directions of the samples, by what each puts into the image.

    Components first, then coefficients: large coefficients of rough components, whose samples are small, round in
    proportion to these, as `clrelight.fit.plan.scale_components` has it.
    """
    kept = min(degree, LARGEST_DEGREE)
    n_coeff = coefficient_count(kept)
    points = spread_points(4 * n_coeff + 50, sphere)
    image_ti = evaluate_basis(points, kept) @ map_ki[:n_coeff]
    _, turn_ir = np.linalg.eigh(image_ti.T @ image_ti)
    return np.ascontiguousarray(turn_ir.T[::-1][: min(map_ki.shape)])


def describe(model: KrigingModel, degree: int) -> tuple[str, ...]:
    """Return what a user should know of a model, and of this degree."""
    theta, count = model.theta, len(model.places)
    photographs = model.places.mean_gi.shape[1]
    notes = [
        f"spectrum: slope {theta.slope:.2f}, heat {theta.heat:.2g}, edges {theta.edge:.2g}, level {theta.level:.2g}, "
        f"noise {theta.noise:.2g} of the variance, azimuth {theta.azimuth:.2g}, tilt {theta.tilt:.2g}"
        + (f", nothing above degree {theta.limit}" if theta.limit < LARGEST_DEGREE else "")
        + (f", {100.0 * model.step.share:g}% of what moments add to the covariance" if model.step is not None else "")
    ]
    if count < FEWEST:
        notes.append(
            f"spectrum: {counted(count, 'light')} cannot tell how smooth a scene is: it is taken to be as most are"
        )
    if count < photographs:
        notes.append(
            f"spectrum: {photographs} photographs of {counted(count, 'light')}; those of one light count as their mean"
        )
    if degree > LARGEST_DEGREE:
        notes.append(f"spectrum: coefficients above degree {LARGEST_DEGREE} are 0")
    return tuple(notes)
