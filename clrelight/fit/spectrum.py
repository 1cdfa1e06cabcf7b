"""Kriging on the sphere: the fit whose smoothness is learnt from lights that are left out with their neighbours."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.fit.left_out import FEWEST, learn_theta
from clrelight.fit.places import find_places, spread_points
from clrelight.fit.plan import FitPlan, Lighting, is_sphere
from clrelight.fit.registry import FitMethod, register
from clrelight.fit.samples import Samples
from clrelight.fit.zonal import LARGEST_DEGREE, Theta, ZonalModel
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.threads import on_one_thread

_SLOPES = -3.0, 6.0
_LARGEST = 1e6
_SMALLEST = 1e-12


@register
@dataclass(frozen=True)
class SpectrumFit(FitMethod):
    """``c = diag(a) Y' (Y diag(a) Y' + N)^-1 beta``, the posterior mean of coefficients with variance a_l.

    Variances and noise are those of `clrelight.fit.zonal.Theta`, one set for a stack. One linear map for all pixels.

    Attributes
    ----------
    level, slope, edge, heat, noise : float or None
    limit : int or None
        As in `Theta`. None: learnt from the samples.
    """

    id = "spectrum"
    title = "Spectrum"
    summary = "kriging: the energy of each degree, and the noise, learnt from lights that are left out"
    level: float | None = None
    slope: float | None = None
    edge: float | None = None
    heat: float | None = None
    noise: float | None = None
    limit: int | None = None

    def __post_init__(self) -> None:
        if self.limit is not None and (type(self.limit) is not int or not 1 <= self.limit <= LARGEST_DEGREE):
            raise InputError(f"limit must be a degree from 1 to {LARGEST_DEGREE}, got {self.limit!r}")
        for field in fields(self):
            if field.name == "limit":
                continue
            value = getattr(self, field.name)
            low, high = _SLOPES if field.name == "slope" else (_SMALLEST, _LARGEST)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if value is not None and not (is_number and low <= value <= high):
                raise InputError(f"{field.name} must be a number from {low:g} to {high:g}, got {value!r}")
            if value is not None:
                object.__setattr__(self, field.name, float(value))

    def settle(self, lighting: Lighting, degree: int, samples: Samples) -> FitMethod:
        """Return the method with every parameter found that is not given."""
        if None not in asdict(self).values():
            return self
        places = find_places(lighting)
        # Scaled by the brightest: squares of samples far from the peak would leave float64.
        mean_gp = places.mean_gi @ samples.radiance_ip
        most = float(np.abs(mean_gp).max())
        mean_gp = mean_gp / most if most > 0.0 else mean_gp
        stack = samples.stack
        quantum = 1.0 / stack.peak / most if stack.images_ihwc.dtype.kind == "u" and most > 0.0 else 0.0
        given = {
            k: value if name == "slope" else float(np.log(value))
            for k, (name, value) in enumerate(asdict(self).items())
            if value is not None and name != "limit"
        }
        with on_one_thread():
            theta = learn_theta(places, mean_gp @ mean_gp.T / mean_gp.shape[1], quantum, given, self.limit)
        return type(self)(**asdict(theta))

    def model(self, lighting: Lighting) -> ZonalModel:
        """Return the settled model of these lights."""
        values = asdict(self)
        if values["limit"] is None:  # as those that were learnt before there were limits
            values["limit"] = LARGEST_DEGREE
        if None in values.values():
            raise ValueError("parameters are not settled yet: settle the method, or give all of them")
        return ZonalModel.make(find_places(lighting), Theta(**values))

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices; any number of lights is legal."""
        with on_one_thread():
            model = self.model(lighting)
            map_ki = model.map_samples(degree)
            turn_ri = _order_components(map_ki, degree, is_sphere(lighting.directions_i3))
            condition = float(np.linalg.cond(model.covariance_gg))
        energy_i = 4.0 * np.pi * lighting.solid_angles_i / lighting.solid_angles_i.sum()
        notes = _describe(model, degree)
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


def _describe(model: ZonalModel, degree: int) -> tuple[str, ...]:
    theta, count = model.theta, len(model.places)
    photographs = model.places.mean_gi.shape[1]
    notes = [
        f"spectrum: slope {theta.slope:.2f}, heat {theta.heat:.2g}, edges {theta.edge:.2g}, level {theta.level:.2g}, "
        f"noise {theta.noise:.2g} of the variance"
        + (f", nothing above degree {theta.limit}" if theta.limit < LARGEST_DEGREE else "")
    ]
    if count < FEWEST:
        notes.append(f"spectrum: {count} light(s) cannot tell how smooth a scene is: it is taken to be as most are")
    if count < photographs:
        notes.append(f"spectrum: {photographs} photographs of {count} lights; those of one light count as their mean")
    if degree > LARGEST_DEGREE:
        notes.append(f"spectrum: coefficients above degree {LARGEST_DEGREE} are 0")
    return tuple(notes)
