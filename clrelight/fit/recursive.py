"""Recursive least squares: more photographs for a fit whose own are no longer there.

A least-squares fit is settled by its coefficients and its information matrix: ``A = Y' W Y``, and lambda P with it
where there is a penalty. The matrix follows from the lights and the options, which a fit holds. With photographs beta
under new lights (Haykin, Adaptive filter theory, ch. 9; noise-resistant-fitting, section IV-A)

    c <- c + K (beta - Y_new c),    K = (A + Y_new' W Y_new)^-1 Y_new' W,

which is the fit of all photographs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import FitRecord
from clrelight.errors import InputError
from clrelight.fit.plan import FitPlan, Lighting, is_sphere
from clrelight.fit.registry import FitMethod, method_class
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import group_directions

UPDATABLE = ("uls", "sloan", "spline")
_LOST = {
    "cls": "the energy of the samples where its bound does not bind (lambda 0), which the new bound needs",
    "ceb": "the components that the bound cut off, and what the samples say of them",
    "ceb-crossing": "the components that the bound cut off, and what the samples say of them",
    "constrained": "what the samples say beyond the bounds that its values stop at",
    "spectrum": "the samples' moments, from which its prior is learnt",
    "project": "its weights, which are areas around the lights and change with new ones",
}
"""What a fit does not keep that adding photographs to it needs."""
_FIT_OPTIONS = ("weights", "sampling", "precision", "holdout", "holdout_by", "lights")
"""What a fit's config holds beside the options of its method."""


@dataclass(frozen=True)
class Update:
    """What adds photographs to the coefficients of a fit.

    Attributes
    ----------
    gain_ki : ndarray, shape (n_coeff, n_new), float64
        K.
    basis_ik : ndarray, shape (n_new, n_coeff), float64
        Y at the new lights.
    directions_j3 : ndarray, shape (n_old + n_new, 3), float64
    condition : float
        Of the basis at all lights.
    """

    gain_ki: NDArray[np.float64]
    basis_ik: NDArray[np.float64]
    directions_j3: NDArray[np.float64]
    condition: float

    def apply(self, coeffs_kp: NDArray[np.float64], radiance_ip: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coefficients with these samples, in units of the fit's peak, added."""
        return coeffs_kp + self.gain_ki @ (radiance_ip - self.basis_ik @ coeffs_kp)


def plan_update(record: FitRecord, new_i3: NDArray[np.float64]) -> Update:
    """Return what adds photographs under new lights to a fit.

    Raises
    ------
    InputError
        If its method or its options leave no way to do so, or a new light is one of the fit's.
    """
    method = _method_of(record)
    old_i3 = record.directions_i3
    all_j3 = np.concatenate([old_i3, new_i3])
    group_j = group_directions(all_j3)
    again = np.flatnonzero(np.isin(group_j[len(old_i3) :], group_j[: len(old_i3)]))
    if len(again):
        same = int(np.flatnonzero(group_j == group_j[len(old_i3) + again[0]])[0])
        raise InputError(
            f"new light {again[0]} has the direction of the fit's light {same}: photographs of one light share its "
            "weight, so the fit would have to forget a part of the old one; leave it out, or fit all photographs"
        )
    if is_sphere(old_i3) != is_sphere(all_j3) and method.id == "sloan":
        raise InputError("sloan leaves y10 out for lights above the horizon only; some of the new ones are below")
    plan, old = (
        method.plan(_lighting(at_j3, str(record.config.get("sampling", "hemisphere"))), record.degree)
        for at_j3 in (all_j3, old_i3)
    )
    _require_whole(method, plan, old, record.degree)
    if plan.synthesis_kr is None:
        raise ValueError("expected a least-squares plan, got one without a synthesis")
    gain_kj = plan.synthesis_kr @ plan.analysis_ri
    basis_ik = evaluate_basis(new_i3, record.degree)
    return Update(gain_kj[:, len(old_i3) :], basis_ik, all_j3, plan.condition)


def _method_of(record: FitRecord) -> FitMethod:
    """Return the method of a fit with its options; InputError if its coefficients do not settle it."""
    if record.method not in UPDATABLE:
        lost = _LOST.get(record.method, "what its photographs leave behind")
        raise InputError(
            f"photographs cannot be added to a fit by {record.method}, which does not keep {lost}: fit all photographs "
            f"again, or keep a fit by one of {', '.join(UPDATABLE)}, which can grow"
        )
    config = record.config
    if "fitted_basis" in config:
        raise InputError(
            f"this was a fit of basis {config['fitted_basis']}, whose information matrix is not that of harmonics: "
            "photographs are added to fits of harmonics"
        )
    if config.get("weights", "uniform") != "uniform":
        raise InputError(
            "solid-angle weights of the old lights change with the new ones: only uniform weights can grow"
        )
    method = method_class(record.method).from_config(_method_options(config))
    if not method.is_linear:
        raise InputError(f"a fit by {method.id} with a lambda for each channel cannot grow; per stack it can")
    if getattr(method, "lam", 0.0) is None:
        raise InputError(f"this fit by {method.id} does not say which lambda it took: fit again")
    return method


def _method_options(config: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in config.items() if name not in _FIT_OPTIONS}


def _lighting(directions_j3: NDArray[np.float64], sampling: str) -> Lighting:
    _, group_j, count_g = np.unique(group_directions(directions_j3), return_inverse=True, return_counts=True)
    copies_j = count_g[group_j]
    area = (4.0 if is_sphere(directions_j3) else 2.0) * np.pi
    return Lighting(directions_j3, area / len(count_g) / copies_j, copies_j, sampling)


def _require_whole(method: FitMethod, plan: FitPlan, old: FitPlan, degree: int) -> None:
    """Raise InputError where least squares without a penalty left components out: their samples are lost."""
    if method.id == "spline":
        return
    wanted = coefficient_count(degree) - (method.id == "sloan")
    for which, each in (("old", old), ("all", plan)):
        if len(each.singular_r) < wanted:
            raise InputError(
                f"{method.id} left out {wanted - len(each.singular_r)} of {wanted} components at the {which} lights "
                "(truncated singular value decomposition), and what the photographs say of them: fit all photographs, "
                "take a lower degree, or spline"
            )
