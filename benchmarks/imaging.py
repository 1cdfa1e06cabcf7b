"""Stages behind the fit: relighting, and measuring PSNR."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.coding import KLT_RATE
from benchmarks.workload import Workload
from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.conventions import linear_to_srgb
from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.fit import fit
from clrelight.metrics import measure_errors, psnr_of
from clrelight.relight import relight
from clrelight.speed.peers import squared_errors
from clrelight.speed.stage import Stage

RELIGHT_GOAL = 0.6
KLT_RELIGHT_GOAL = 1.0
PSNR_GOAL = 2.0
PSNR_OF_FIT_GOAL = 1.0
MANY_LIGHTS = 16
MANY_COPIES = 16

_CHECKED_LIGHTS = 8


def imaging_stages(work: Workload) -> Iterator[Stage]:
    """Yield relighting by one light and by many, without coefficients too, and the PSNR of all lights."""
    yield _relight(work, 1)
    yield _relight_stored(work, "float16", 1, RELIGHT_GOAL)
    yield _relight_stored(work, "float32", MANY_COPIES)
    yield _relight_stored(work, "float16", MANY_COPIES)
    yield _relight(work, MANY_LIGHTS)
    yield _relight_view(work, "klt", {"rate": KLT_RATE}, KLT_RELIGHT_GOAL)
    yield _relight_view(work, "whitened", {"codec": "half"}, None)
    yield _measure_psnr(work)
    yield _measure_psnr_of_photographs(work)


def _relight(work: Workload, lights: int) -> Stage:
    fitted, coeffs_kp = work.fitted, work.fitted.coeffs_khwc.reshape(work.fitted.n_coeff, -1)
    directions_i3 = _directions(work, lights)
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


def _relight_stored(work: Workload, dtype: str, copies: int, goal: float | None = None) -> Stage:
    """Return relighting of coefficients as they are stored, beside float32 ones: the error has that of rounding them.

    Several copies of the view make one that no cache holds.
    """
    directions_i3 = _directions(work, 1)
    coeffs_khwc = np.tile(work.fitted.coeffs_khwc, (1, copies, 1, 1))
    coeffs_kp = coeffs_khwc.reshape(len(coeffs_khwc), -1)
    stored = replace(work.fitted, coeffs_khwc=coeffs_khwc.astype(dtype), lambda_hwc=None)
    basis_ik = evaluate_basis(directions_i3, work.degree)
    factors = basis_ik[0].astype(np.float32)
    exact_is = basis_ik @ coeffs_kp[:, work.checked_s]

    def errors() -> tuple[float, float]:
        images = (relight(stored, directions_i3, device=work.device), factors @ coeffs_kp)
        ours, theirs = (np.abs(image.reshape(1, -1)[:, work.checked_s] - exact_is).max() for image in images)
        return float(ours), float(theirs)

    return Stage(
        f"relight 1 light, {dtype}" + f", {coeffs_kp.shape[1]} columns" * (copies > 1),
        "NumPy float32 matrix-vector",
        lambda: relight(stored, directions_i3, device=work.device),
        lambda: factors @ coeffs_kp,
        errors,
        "largest image error / peak" + ", the rounding to binary16 in it" * (dtype == "float16"),
        2.0 * coeffs_kp.size,
        goal,
    )


def _relight_view(work: Workload, codec_id: str, config: dict[str, object], goal: float | None) -> Stage:
    """Return relighting of decoded bytes in their own basis, beside that of the coefficients they decode to."""
    directions_i3 = _directions(work, 1)
    encoded = encode(
        work.fitted.coeffs_khwc,
        codec_class(codec_id).from_config(config),
        work.device,
        work.fitted.basis,
        work.fitted.fitted_lights,
    )
    view, decoded = decode_view(encoded, work.device), replace(work.fitted, coeffs_khwc=decode(encoded, work.device))
    assert view is not None
    coeffs_ks = decoded.coeffs_khwc.reshape(decoded.n_coeff, -1)[:, work.checked_s].astype(np.float64)
    exact_is = evaluate_basis(directions_i3, work.degree) @ coeffs_ks

    def errors() -> tuple[float, float]:
        images = (view.relight(directions_i3, work.device), relight(decoded, directions_i3, device=work.device))
        ours, theirs = (np.abs(image.reshape(1, -1)[:, work.checked_s] - exact_is).max() for image in images)
        return float(ours), float(theirs)

    name = " ".join([codec_id, *(f"{key} {value}" for key, value in config.items())])
    return Stage(
        f"relight 1 light, as {name} decodes",
        "ours, from the SH coefficients",
        lambda: view.relight(directions_i3, work.device),
        lambda: relight(decoded, directions_i3, device=work.device),
        errors,
        "largest image error / peak",
        goal=goal,
    )


def _directions(work: Workload, lights: int) -> NDArray[np.float64]:
    """Return directions between the lights of the stack, as a user would choose them."""
    directions_i3 = work.stack.directions_i3[:lights] + work.stack.directions_i3[1 : lights + 1]
    return directions_i3 / np.linalg.norm(directions_i3, axis=1, keepdims=True)


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


def _measure_psnr_of_photographs(work: Workload) -> Stage:
    """Return measuring in sRGB code values beside fitting the same stack: quality is printed after every fit."""
    stack = replace(work.stack, transfer="srgb")
    fitted = fit(stack, "cls", work.degree, device=work.device)
    coeffs_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1)
    some_i = np.arange(_CHECKED_LIGHTS) * stack.n_light // _CHECKED_LIGHTS

    def errors() -> tuple[float, None]:
        relit_ip = np.clip(work.basis_ik[some_i] @ coeffs_kp.astype(np.float64), 0.0, 1.0)
        given_ip = stack.images_ihwc[some_i].reshape(len(some_i), -1) / stack.peak
        exact_i = psnr_of(np.square(linear_to_srgb(relit_ip) - given_ip).mean(axis=1))
        ours_i = psnr_of(measure_errors(fitted, stack, device=work.device))[some_i]
        return float(np.abs(ours_i - exact_i).max()), None

    return Stage(
        f"PSNR at {stack.n_light} lights, sRGB",
        "ours, the CLS fit of the same stack",
        lambda: measure_errors(fitted, stack, device=work.device),
        lambda: fit(stack, "cls", work.degree, device=work.device),
        errors,
        "largest error in dB",
        goal=PSNR_OF_FIT_GOAL,
    )
