"""Stages behind the fit: relighting, and measuring PSNR."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.peers import squared_errors
from benchmarks.stage import Stage
from benchmarks.workload import Workload
from clrelight.basis import evaluate_basis
from clrelight.metrics import measure_errors, psnr_of
from clrelight.relight import relight

RELIGHT_GOAL = 0.6
PSNR_GOAL = 2.0
MANY_LIGHTS = 16

_CHECKED_LIGHTS = 8


def imaging_stages(work: Workload) -> Iterator[Stage]:
    """Yield relighting by one light and by many, and the PSNR of all lights."""
    yield _relight(work, 1)
    yield _relight(work, MANY_LIGHTS)
    yield _measure_psnr(work)


def _relight(work: Workload, lights: int) -> Stage:
    fitted, coeffs_kp = work.fitted, work.fitted.coeffs_khwc.reshape(work.fitted.n_coeff, -1)
    # Between the lights of the stack, as a user would.
    directions_i3 = work.stack.directions_i3[:lights] + work.stack.directions_i3[1 : lights + 1]
    directions_i3 = directions_i3 / np.linalg.norm(directions_i3, axis=1, keepdims=True)
    basis_ik = evaluate_basis(directions_i3, work.degree)
    exact_is = basis_ik @ coeffs_kp[:, work.checked_s]
    factors = basis_ik.astype(np.float32) if lights > 1 else basis_ik[0].astype(np.float32)

    def errors() -> tuple[float, float]:
        ours_ip = relight(fitted, directions_i3, device=work.device).reshape(lights, -1)
        theirs_ip = (factors @ coeffs_kp).reshape(lights, -1)
        return tuple(float(np.abs(image[:, work.checked_s] - exact_is).max()) for image in (ours_ip, theirs_ip))  # type: ignore[return-value]

    return Stage(
        f"relight {lights} light{'s' * (lights > 1)}, float32",
        "NumPy float32 matmul" if lights > 1 else "NumPy float32 matrix-vector",
        lambda: relight(fitted, directions_i3, device=work.device),
        lambda: factors @ coeffs_kp,
        errors,
        "largest image error / peak",
        2.0 * lights * coeffs_kp.size,
        RELIGHT_GOAL if lights == 1 else None,
    )


def _measure_psnr(work: Workload) -> Stage:
    stack, coeffs_kp = work.stack, work.fitted.coeffs_khwc.reshape(work.fitted.n_coeff, -1)
    codes_ip = stack.images_ihwc.reshape(stack.n_light, -1)
    some_i = np.arange(_CHECKED_LIGHTS) * stack.n_light // _CHECKED_LIGHTS

    def errors() -> tuple[float, float]:
        exact_i = psnr_of(
            squared_errors(work.basis_ik[some_i], coeffs_kp.astype(np.float64), codes_ip[some_i], stack.peak)
        )
        ours_i = psnr_of(measure_errors(work.fitted, stack, device=work.device))[some_i]
        theirs_i = psnr_of(squared_errors(work.basis_ik[some_i], coeffs_kp, codes_ip[some_i], stack.peak))
        return float(np.abs(ours_i - exact_i).max()), float(np.abs(theirs_i - exact_i).max())

    return Stage(
        f"PSNR at {stack.n_light} lights",
        "the same in NumPy float32",
        lambda: measure_errors(work.fitted, stack, device=work.device),
        lambda: squared_errors(work.basis_ik, coeffs_kp, codes_ip, stack.peak),
        errors,
        "largest error in dB",
        goal=PSNR_GOAL,
    )
