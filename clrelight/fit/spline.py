"""The smoothing spline on the sphere: least squares that knows smoothness instead of size."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import basis_of
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit.columns import launch_columns
from clrelight.fit.places import merge_photographs
from clrelight.fit.plan import FitPlan, Lighting, plan_least_squares, scale_components
from clrelight.fit.registry import Columns, FitMethod, Shrunk, register
from clrelight.fit.samples import Samples
from clrelight.harmonics.index import coefficient_count

REFERENCE_DEGREE = 15
"""Lambda is found at this degree where a lower one is asked for.

How rough a scene is does not depend on where its series is cut. At a low degree cross-validation would find that the
cut has smoothed enough already and leave lambda near 0: coefficients as large as those of ULS.
"""

_EXPONENTS = np.arange(-10.0, 6.01, 0.25)
"""Where the grid of ``log10(lambda)`` looks before the minimum is refined."""
_EXPONENT_TOLERANCE = 1e-4


@register
@dataclass(frozen=True)
class SmoothingSpline(FitMethod):
    """``c = (Y'Y + lambda P)^-1 Y' beta`` with ``P = diag(EPSILON + (l (l + 1))^2)``.

    P is the basis' `roughness`, and a hemispherical basis is fitted at degree `REFERENCE_DEGREE` or more and then cut.
    Of spherical harmonics the penalty is the energy of the function's Laplacian over the
    sphere (Wahba 1981, Spline interpolation and smoothing on the sphere). One linear map for all pixels, so it costs
    what a projection costs.

    Attributes
    ----------
    lam : float, tuple of float, or None
        lambda > 0: one, or one for each channel. None: by generalised cross-validation (`minimize_gcv`).
    per : str
        ``"stack"`` or ``"channel"``: what shares one lambda.
    """

    id = "spline"
    title = "Spline"
    summary = "smoothing spline: least squares with a penalty on roughness, lambda by cross-validation"
    settled_from = REFERENCE_DEGREE
    takes_bases = True
    lam: float | tuple[float, ...] | None = None
    per: str = "stack"

    def __post_init__(self) -> None:
        if self.per not in ("stack", "channel"):
            raise InputError(f"per must be stack or channel, got {self.per!r}")
        if self.lam is None:
            return
        each = isinstance(self.lam, list | tuple)
        if each and self.per == "stack":
            raise InputError(f"lam must be one number where per is stack, got {self.lam!r}")
        values = tuple(_positive(value) for value in (self.lam if each else [self.lam]))  # type: ignore[union-attr]
        object.__setattr__(self, "lam", values if each else values[0])  # JSON makes lists of tuples

    @property
    def is_linear(self) -> bool:
        """See `FitMethod`."""
        return self.per == "stack"

    def settle(self, lighting: Lighting, degree: int, samples: Samples) -> FitMethod:
        """Return the method with lambda found, for each channel where asked for."""
        channels = samples.channels
        if self.lam is None:
            # Photographs of one light err alike, so one is no check on another: cross-validation sees their mean.
            lighting, radiance_ip = merge_photographs(lighting, samples.radiance_ip)
            plan = self._components(lighting, max(degree, REFERENCE_DEGREE))
            groups = [radiance_ip[:, c::channels] for c in range(channels)] if self.per == "channel" else [radiance_ip]
            found = tuple(minimize_gcv(plan.singular_r, *_split_energy(plan, lighting, group)) for group in groups)
            return replace(self, lam=found if self.per == "channel" else found[0])
        if isinstance(self.lam, tuple) and len(self.lam) != channels:
            raise InputError(f"lam must have one number for each of {channels} channels, got {len(self.lam)}")
        return self

    def plan(self, lighting: Lighting, degree: int) -> FitPlan:
        """Return the matrices; fewer lights than coefficients is legal."""
        if self.lam is None:
            raise ValueError("lambda is not settled yet: settle the method, or give lam")
        # Of functions that are orthonormal on the hemisphere the first are the nearest to the whole: cut last.
        wide = max(degree, REFERENCE_DEGREE) if basis_of(lighting.basis).hemispherical else degree
        plan = _first_of(self._components(lighting, wide), coefficient_count(degree))
        freedom = [(plan.singular_r**2 / (plan.singular_r**2 + value)).sum() for value in np.atleast_1d(self.lam)]
        notes = (
            f"spline: lambda {_listing(np.atleast_1d(self.lam), '.3g')}, which leaves {_listing(freedom, '.1f')} "
            f"degrees of freedom for {coefficient_count(degree)} coefficients",
        )
        if self.per == "stack":
            return replace(scale_components(plan, self._factors_rc(plan)[:, 0]), notes=notes)
        return replace(plan, notes=notes)

    def shrink(self, device: Device, plan: FitPlan, columns: Columns) -> Shrunk:
        """Scale the components by their channel's factors; nothing to do where one lambda is in the synthesis."""
        if self.per == "channel":
            factor_rc = device.upload(self._factors_rc(plan).astype(columns.z_rq.dtype))
            launch_columns(
                device,
                "fit/spline.cl",
                "scale_rq",
                columns.z_rq,
                factor_rc,
                *columns.z_rq.shape,
                factor_rc.shape[1],
                defines={},
            )
        return Shrunk()

    def find_gains(
        self, plan: FitPlan, z_rp: NDArray[np.float64], energy_p: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return each channel's factors; 1 where they are in the synthesis."""
        if self.per == "stack":
            return np.ones((len(z_rp), 1))
        factors_rc = self._factors_rc(plan)
        return np.take(factors_rc, np.arange(z_rp.shape[1]) % factors_rc.shape[1], axis=1)

    def to_config(self) -> dict[str, Any]:
        """Return the options as a JSON object."""
        return {"lam": list(self.lam) if isinstance(self.lam, tuple) else self.lam, "per": self.per}

    def _components(self, lighting: Lighting, degree: int) -> FitPlan:
        return plan_least_squares(lighting, degree, penalty_k=basis_of(lighting.basis).roughness(degree))

    def _factors_rc(self, plan: FitPlan) -> NDArray[np.float64]:
        singular_r1 = plan.singular_r[:, None]
        return singular_r1 / (singular_r1**2 + np.atleast_1d(np.asarray(self.lam, np.float64)))


def _first_of(plan: FitPlan, n_coeff: int) -> FitPlan:
    """Return the plan of the first coefficients alone, which are what they are among all."""
    return plan if plan.synthesis_kr is None else replace(plan, synthesis_kr=plan.synthesis_kr[:n_coeff])


def minimize_gcv(singular_r: NDArray[np.float64], energy_r: NDArray[np.float64], outside: float, n_light: int) -> float:
    """Return the lambda that minimises generalised cross-validation (Golub, Heath and Wahba 1979).

    ``V = n |(I - H) beta|^2 / tr(I - H)^2``. In the components of the SVD ``I - H`` is ``lambda / (sigma^2 + lambda)``
    inside the span of the basis and 1 outside, so V takes a few operations per component, however many columns.

    Where there are no more lights than components, V may fall again towards lambda = 0, where the fit meets every
    sample (Wahba and Wang 1995, Behavior near zero of the distribution of GCV smoothing parameter estimates): an end of
    the range counts only where there is no minimum inside it.

    Parameters
    ----------
    singular_r : ndarray, shape (rank,), float64
    energy_r : ndarray, shape (rank,), float64
        Sum over the columns of each component's square.
    outside : float
        Energy of the columns outside the span.
    n_light : int
    """
    from scipy.optimize import minimize_scalar  # slow to load, and of no use to other methods

    def log_gcv(exponent: float) -> float:
        left_r = 1.0 / (1.0 + singular_r**2 / 10.0**exponent)
        residual = outside + (left_r**2 * energy_r).sum()
        return float(np.log(residual) - 2.0 * np.log(n_light - len(singular_r) + left_r.sum()))

    if not energy_r.sum() + outside > 0.0:
        return 1.0  # a black stack: any lambda gives zeros
    values = np.array([log_gcv(exponent) for exponent in _EXPONENTS])
    inside = 1 + np.flatnonzero((values[1:-1] < values[:-2]) & (values[1:-1] <= values[2:]))
    candidates = inside if len(inside) else np.arange(len(values))
    best = int(candidates[np.argmin(values[candidates])])
    low, high = _EXPONENTS[max(best - 1, 0)], _EXPONENTS[min(best + 1, len(values) - 1)]
    found = minimize_scalar(log_gcv, bounds=(low, high), method="bounded", options={"xatol": _EXPONENT_TOLERANCE})
    return float(10.0 ** (found.x if found.fun < values[best] else _EXPONENTS[best]))


def _split_energy(
    plan: FitPlan, lighting: Lighting, radiance_ip: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, int]:
    """Return the energy of the columns in each component, the energy outside them, and the number of lights."""
    # The weighted samples; a light of weight 0 is none.
    root_i = np.sqrt(lighting.row_weights_i)
    counted = root_i > 0.0
    energy_r = ((plan.analysis_ri @ radiance_ip) ** 2).sum(axis=1)
    total = float(((root_i[:, None] * radiance_ip) ** 2).sum())
    n_light = int(counted.sum())
    outside = max(total - float(energy_r.sum()), 0.0) if n_light > len(energy_r) else 0.0
    return energy_r, outside, n_light


def _positive(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value < float("inf"):
        raise InputError(f"lam must be a positive number, got {value!r}")
    return float(value)


def _listing(values: Any, form: str) -> str:
    return ", ".join(f"{value:{form}}" for value in values)
