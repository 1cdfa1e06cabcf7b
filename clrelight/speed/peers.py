"""The same work in NumPy, as a careful user would write it: float32, no needless copies, blocks that fit a cache."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.plan import FitPlan

Array = NDArray[np.float32]

_NEWTON_BLOCK = 2048
_PSNR_BLOCK = 16384


class NewtonFit:
    """CLS with Newton's iteration for lambda (see kernels/fit/cls.cl), in vectorised float32."""

    def __init__(self, plan: FitPlan, iterations: int) -> None:
        if plan.synthesis_kr is None:
            raise ValueError("expected a least-squares plan, got one without a synthesis")
        self.analysis_ri = plan.analysis_ri.astype(np.float32)
        self.synthesis_kr = plan.synthesis_kr.astype(np.float32)
        self.singular_r1 = plan.singular_r.astype(np.float32)[:, None]
        self.energy_i = plan.energy_i.astype(np.float32)
        self.iterations = iterations

    def __call__(self, images_ip: Array) -> Array:
        """Return the coefficients, shape (n_coeff, P)."""
        z_rp = self.analysis_ri @ images_ip
        for first in range(0, z_rp.shape[1], _NEWTON_BLOCK):
            block = slice(first, first + _NEWTON_BLOCK)
            images_iq = images_ip[:, block]
            energy_q = self.energy_i @ (images_iq * images_iq)
            z_rp[:, block] = self._shrink(self.singular_r1 * z_rp[:, block], energy_q)
        return self.synthesis_kr @ z_rp

    def _shrink(self, b_rq: Array, energy_q: Array) -> Array:
        square_r1 = self.singular_r1**2
        energy_q = np.maximum(energy_q, np.float32(1e-30))  # black columns: b is 0, any lambda will do
        norm_q = np.einsum("rq,rq->q", b_rq, b_rq)
        lambda_q = np.maximum(np.sqrt(norm_q / energy_q) - square_r1[0], 0.0)
        for _ in range(self.iterations):
            inverse_rq = np.reciprocal(square_r1 + lambda_q)
            t_rq = b_rq * inverse_rq
            square_q = np.einsum("rq,rq->q", t_rq, t_rq)
            t_rq *= t_rq
            slope_q = np.maximum(np.einsum("rq,rq->q", t_rq, inverse_rq), np.float32(1e-30))
            step_q = square_q / slope_q * (np.sqrt(square_q / energy_q) - 1.0)
            after_q = np.maximum(lambda_q + step_q, 0.0)
            moved = np.abs(after_q - lambda_q) > 4e-7 * lambda_q
            lambda_q = after_q
            if not moved.any():
                break
        return b_rq / (square_r1 + lambda_q)


def squared_errors(basis_ik: NDArray, coeffs_kp: NDArray, codes_ip: NDArray, peak: float) -> NDArray[np.float64]:
    """Return each light's mean squared error of relit against given images, clipped, in units of the peak.

    Computes in the type of `coeffs_kp`: float32 for the peer, float64 for what both are compared with.
    """
    basis = basis_ik.astype(coeffs_kp.dtype)
    total_i = np.zeros(len(basis))
    for first in range(0, coeffs_kp.shape[1], _PSNR_BLOCK):
        block = slice(first, first + _PSNR_BLOCK)
        relit_iq = basis @ coeffs_kp[:, block]
        np.clip(relit_iq, 0.0, 1.0, out=relit_iq)
        relit_iq -= codes_ip[:, block] * coeffs_kp.dtype.type(1.0 / peak)
        total_i += np.einsum("iq,iq->i", relit_iq, relit_iq)
    return total_i / coeffs_kp.shape[1]
