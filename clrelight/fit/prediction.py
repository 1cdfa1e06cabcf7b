"""What a fit will reach at unseen lights, on a sample of the pixels: in closed form, and by leaving lights out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.basis import evaluate_basis
from clrelight.conventions import linear_to_srgb
from clrelight.fit.plan import Lighting, make_lighting
from clrelight.fit.registry import FitMethod
from clrelight.fit.samples import Samples
from clrelight.metrics import psnr_of

FOLDS = 5
_SEED = 0
_LEAST_FREEDOM = 1e-9
"""Least ``1 - H_ii``: a sample that its fit meets whatever it is tells nothing about unseen lights."""


def predict_left_out(method: FitMethod, degree: int, samples: Samples, lighting: Lighting) -> NDArray[np.float64]:
    """Return each sample as a fit to all the other lights predicts it, from one fit to all.

    With the hat matrix H of a linear fit, ``beta_i - (beta_i - f_i) / (1 - H_ii)`` is that prediction exactly (Cook
    1977), given lambda. For cls and ceb, H is that of each column's own lambda or rank.

    Returns
    -------
    ndarray, shape (n_light, P), float64
        Linear radiance in units of the peak.
    """
    basis_ir, analysis_ri, gain_rp, z_rp = _solve(method, degree, samples, lighting, lighting.directions_i3)
    hat_ip = (basis_ir * analysis_ri.T) @ gain_rp
    residual_ip = samples.radiance_ip - basis_ir @ (gain_rp * z_rp)
    return samples.radiance_ip - residual_ip / np.maximum(1.0 - hat_ip, _LEAST_FREEDOM)


def predict_in_folds(
    method: FitMethod, degree: int, samples: Samples, weights: str, sampling: str
) -> NDArray[np.float64]:
    """Return each sample as a fit without its fold of the lights predicts it; lambda is found anew for each fold.

    Folds are drawn by lot (the same each time), not every fifth light: lights often come in rows of a dome.
    """
    n_light = samples.stack.n_light
    # Only Generator.random is drawn, which NumPy versions have in common.
    fold_i = np.argsort(np.random.default_rng(_SEED).random(n_light)) % FOLDS
    predicted_ip = np.empty_like(samples.radiance_ip)
    for fold in range(min(FOLDS, n_light)):
        kept, left_out = np.flatnonzero(fold_i != fold), np.flatnonzero(fold_i == fold)
        seen = samples.select(kept)
        lighting = make_lighting(seen.stack, weights, sampling)
        directions_i3 = samples.stack.directions_i3[left_out]
        basis_ir, _, gain_rp, z_rp = _solve(method, degree, seen, lighting, directions_i3)
        predicted_ip[left_out] = basis_ir @ (gain_rp * z_rp)
    return predicted_ip


def measure_prediction(predicted_ip: NDArray[np.float64], samples: Samples) -> float:
    """Return the pooled PSNR in dB, of clipped values in the stack's own transfer as `measure_errors` compares them."""
    shown_ip = np.clip(predicted_ip, 0.0, 1.0)
    if samples.stack.transfer == "srgb":
        shown_ip = linear_to_srgb(shown_ip)
    return float(psnr_of(float(np.mean((shown_ip - samples.encoded_ip) ** 2))))


def _solve(
    method: FitMethod, degree: int, samples: Samples, lighting: Lighting, directions_i3: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return what maps components to radiance at these directions, the analysis, the gains, and the components."""
    method = method.settle(lighting, degree, samples)
    plan = method.plan(lighting, degree)
    basis_ir = evaluate_basis(directions_i3, degree)
    if plan.synthesis_kr is not None:
        basis_ir = basis_ir @ plan.synthesis_kr
    z_rp = plan.analysis_ri @ samples.radiance_ip
    gain_rp = method.find_gains(plan, z_rp, plan.energy_i @ samples.radiance_ip**2)
    return basis_ir, plan.analysis_ri, gain_rp, z_rp
