"""What fits reach at lights that are left out together with their neighbours, on a sample of the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import linear_to_srgb
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.left_out import solve_zones
from clrelight.fit.places import Places, find_gap_radii, find_places, find_zones, pick_spread, stack_zones
from clrelight.fit.plan import Lighting, make_lighting
from clrelight.fit.registry import FitMethod
from clrelight.fit.samples import Samples
from clrelight.harmonics.basis import evaluate_basis

LEAST_FREEDOM = 0.02
"""Least reciprocal norm of ``(I - H_ZZ)^-1``: below it a fit follows the samples of the zone whatever they are, and
what is left of them tells nothing."""
LEAST_ERROR = 1e-13
"""A smaller mean squared error, in units of the squared peak, counts as this."""
REFITS = 6
"""Zones in which methods are fitted anew that are not one linear map."""
_REFIT_COLUMNS = 300
_MAX_VALUES = 1 << 19
"""Samples, over all lights, that predictions are made for."""
_COLUMNS = 2000


@dataclass
class Trials:
    """The lights of a fit, who is left out with whom, and a sample of pixels; the same for every model.

    Attributes
    ----------
    samples : Samples
    weights, sampling : str
        As in `clrelight.fit.fit`.
    """

    samples: Samples
    weights: str
    sampling: str

    @classmethod
    def make(cls, samples: Samples, weights: str, sampling: str) -> Trials:
        """Return the trials of a sample, of which as many columns are taken as are quick to try."""
        columns = max(1, min(_COLUMNS, _MAX_VALUES // samples.stack.n_light))
        return cls(samples.thin(columns), weights, sampling)

    @cached_property
    def lighting(self) -> Lighting:
        """The lights, and how much each counts."""
        return make_lighting(self.samples.stack, self.weights, self.sampling)

    @cached_property
    def places(self) -> Places:
        """The distinct lights."""
        return find_places(self.lighting)

    @cached_property
    def gap(self) -> float:
        """Radius of a typical gap between lights in radians."""
        return float(np.median(find_gap_radii(self.places.directions_g3)))

    @cached_property
    def zones(self) -> list[NDArray[np.intp]]:
        """The places that are left out together with each, itself first."""
        return find_zones(self.places.directions_g3, self.gap)

    @cached_property
    def stacked(self) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """The photographs of each zone, those of equally many together: `stack_zones`."""
        return stack_zones([self.photographs(zone) for zone in self.zones])

    @cached_property
    def mean_gp(self) -> NDArray[np.float64]:
        """Radiance under each distinct light, the mean of its photographs."""
        return self.places.mean_gi @ self.samples.radiance_ip

    @cached_property
    def few(self) -> NDArray[np.intp]:
        """The columns that are fitted anew, evenly spread."""
        count = self.samples.radiance_ip.shape[1]
        return np.unique(np.linspace(0, count - 1, min(count, _REFIT_COLUMNS)).astype(np.intp))

    def measure(self, predicted_gp: NDArray[np.float64], true_gp: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mean squared error under each light, of values as `measure_errors` compares them."""
        return np.asarray(np.mean((self.show(predicted_gp) - self.show(true_gp)) ** 2, axis=1))

    def show(self, radiance: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return clipped values in the stack's own transfer."""
        shown = np.clip(radiance, 0.0, 1.0)
        return linear_to_srgb(shown) if self.samples.stack.transfer == "srgb" else shown

    def photographs(self, places: NDArray[np.intp]) -> NDArray[np.intp]:
        """Return the photographs of some places."""
        return np.flatnonzero(self.places.mean_gi[places].any(axis=0))

    @cached_property
    def refits(self) -> list[tuple[int, NDArray[np.intp], Lighting]]:
        """Where methods are fitted anew, places far from each other: place, photographs left, and their lights."""
        made = []
        for place in pick_spread(self.places.directions_g3, REFITS).tolist():
            left = np.setdiff1d(np.arange(self.samples.stack.n_light), self.photographs(self.zones[place]))
            if len(left):
                made.append((place, left, make_lighting(self.samples.stack.select(left), self.weights, self.sampling)))
        return made


def krige_left_out(
    model: KrigingModel, mean_gp: NDArray[np.float64], zones: list[NDArray[np.intp]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what a model says at each light without its zone, (n_place, P), and the variance it gives that."""
    errors_gz, variance_z = solve_zones(model.inverse_gg, zones)
    return mean_gp - errors_gz.T @ (model.inverse_gg @ mean_gp), variance_z


def try_method(method: FitMethod, degree: int, trials: Trials) -> NDArray[np.float64]:
    """Return the mean squared error of a fit at each place left out with its zone; NaN where it is not known.

    With the hat matrix H of a linear fit, ``(I - H_ZZ)^-1 (beta - H beta)_Z`` are the errors at a zone left out
    exactly (Cook 1977 for zones of one), given lambda. Where a fit follows the samples of any zone, nothing is known.
    cls and ceb are no linear map: they are fitted anew for each of `Trials.refits`.
    """
    settled = method.settle(trials.lighting, degree, trials.samples)
    plan = settled.plan(trials.lighting, degree)
    basis_ir = evaluate_basis(trials.lighting.directions_i3, degree)
    basis_ir = basis_ir if plan.synthesis_kr is None else basis_ir @ plan.synthesis_kr
    radiance_ip = trials.samples.radiance_ip
    z_rp = plan.analysis_ri @ radiance_ip[:, trials.few]
    gain_rp = settled.find_gains(plan, z_rp, plan.energy_i @ radiance_ip[:, trials.few] ** 2)
    if gain_rp.shape[1] > 1:
        return _refit(settled, degree, trials)
    hat_ii = (basis_ir * gain_rp[:, 0]) @ plan.analysis_ri
    left_ii = np.eye(len(hat_ii)) - hat_ii
    rows_gi = _leave_zones(left_ii, trials)
    if rows_gi is None:
        return np.full(len(trials.places), np.nan)
    # Of many lights, of which fewer columns are tried, the product of the matrices alone would be most of the work.
    error_gp = np.linalg.multi_dot([rows_gi, left_ii, radiance_ip])
    return trials.measure(trials.mean_gp - error_gp, trials.mean_gp)


def _leave_zones(left_ii: NDArray[np.float64], trials: Trials) -> NDArray[np.float64] | None:
    """Return what makes errors at places left out of residuals, (n_place, n_light); None where nothing is known."""
    rows_gi = np.zeros_like(trials.places.mean_gi)
    for which, out_zm in trials.stacked:
        if out_zm.shape[1] == len(left_ii):
            return None
        try:
            inverse_zmm = np.linalg.inv(left_ii[out_zm[:, :, None], out_zm[:, None, :]])
        except np.linalg.LinAlgError:
            return None
        if not np.linalg.norm(inverse_zmm, axis=(1, 2)).max() < 1.0 / LEAST_FREEDOM:
            return None
        mean_zm = trials.places.mean_gi[which[:, None], out_zm]
        rows_gi[which[:, None], out_zm] = np.einsum("zi,zij->zj", mean_zm, inverse_zmm)
    return rows_gi


def _refit(method: FitMethod, degree: int, trials: Trials) -> NDArray[np.float64]:
    radiance_ip = trials.samples.radiance_ip[:, trials.few]
    error_g = np.full(len(trials.places), np.nan)
    basis_gk = evaluate_basis(trials.places.directions_g3, degree)
    for place, left, lighting in trials.refits:
        plan = method.plan(lighting, degree)
        z_rp = plan.analysis_ri @ radiance_ip[left]
        gain_rp = method.find_gains(plan, z_rp, plan.energy_i @ radiance_ip[left] ** 2)
        basis_1r = basis_gk[[place]] if plan.synthesis_kr is None else basis_gk[[place]] @ plan.synthesis_kr
        true_1p = trials.mean_gp[[place]][:, trials.few]
        error_g[place] = trials.measure(basis_1r @ (gain_rp * z_rp), true_1p)[0]
    return error_g
