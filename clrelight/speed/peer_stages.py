"""Stages beside the libraries that users would take instead: NumPy with its BLAS, SciPy, PyWavelets."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.transforms.lifting import forward_transform, inverse_transform
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.fit import PreparedFit, collect_fit, prepare_fit
from clrelight.harmonics.basis import evaluate_basis
from clrelight.matmul import apply_operator, pack_operator
from clrelight.speed.job import FIT_OPTIONS
from clrelight.speed.stage import Stage
from clrelight.store import open_stack

BRENT_COLUMNS = 2048
_CHECKED_COLUMNS = 1021
_LEVELS = 3
_WAVELET = "bior4.4"  # CDF 9/7
_IMAGE_ERROR = "largest image error / peak"
_RELATIVE = "largest error / largest value"


def missing_peers() -> list[str]:
    """Return a note for each library that is not installed, whose stages are left out."""
    if importlib.util.find_spec("pywt") is None:
        return ["PyWavelets is not installed, its stages are left out: pip install 'clrelight[speed]'"]
    return []


def peer_stages(path: Path, degree: int, device: Device) -> Iterator[Stage]:
    """Yield the stages on a stack file, made when it is their turn."""
    with open_stack(path) as opened:
        stack = LightStack(opened.images_ihwc[:], opened.directions_i3, opened.peak, opened.transfer)
    images_ip = stack.images_ihwc.reshape(stack.n_light, -1).astype(np.float32)
    yield _project(stack, images_ip, degree, device)
    yield _least_squares(stack, images_ip, degree, device)
    yield _brent(stack, degree, device)
    if not missing_peers():
        fitted = collect_fit(prepare_fit(stack, "cls", degree, options=FIT_OPTIONS, device=device))
        yield from _wavelets(np.ascontiguousarray(fitted.coeffs_khwc), device)


def _project(stack: LightStack, images_ip: NDArray[np.float32], degree: int, device: Device) -> Stage:
    analysis_ri = prepare_fit(stack, "uls", degree, device=device).plan.analysis_ri
    operator = pack_operator(device, analysis_ri)
    source_ip = device.upload(stack.images_ihwc.reshape(stack.n_light, -1))
    z_rp = device.empty((len(analysis_ri), images_ip.shape[1]), np.float32)
    peer_analysis_ri, peer_z_rp = analysis_ri.astype(np.float32), np.empty(z_rp.shape, np.float32)
    checked = _checked(images_ip)

    def error(found_rp: NDArray) -> float:
        exact_rs = analysis_ri @ images_ip[:, checked].astype(np.float64)
        return float(np.abs(found_rp[:, checked] - exact_rs).max() / np.abs(exact_rs).max())

    return Stage(
        f"project, {images_ip.shape[1]} columns",
        "NumPy float32 matmul",
        lambda: apply_operator(device, operator, source_ip, z_rp),
        lambda: np.matmul(peer_analysis_ri, images_ip, out=peer_z_rp),
        lambda: (error(device.download(z_rp)), error(peer_z_rp)),
        _RELATIVE,
        2.0 * analysis_ri.size * images_ip.shape[1],
    )


def _least_squares(stack: LightStack, images_ip: NDArray[np.float32], degree: int, device: Device) -> Stage:
    from scipy.linalg import cho_factor, cho_solve

    prepared = prepare_fit(stack, "uls", degree, device=device)
    basis_ik = evaluate_basis(stack.directions_i3, degree)
    samples_ip = images_ip.astype(np.float64)

    def solve() -> NDArray[np.float64]:
        found_kp: NDArray[np.float64] = cho_solve(cho_factor(basis_ik.T @ basis_ik), basis_ik.T @ samples_ip)
        return found_kp

    return Stage(
        f"fit ULS, {images_ip.shape[1]} columns",
        "SciPy cho_solve, float64",
        lambda: collect_fit(prepared),
        solve,
        _image_errors(
            basis_ik,
            lambda: _columns_of(prepared),
            solve,
            np.linalg.lstsq(basis_ik, samples_ip[:, _checked(images_ip)])[0],
            _checked(images_ip),
        ),
        _IMAGE_ERROR,
    )


def _brent(stack: LightStack, degree: int, device: Device) -> Stage:
    """CLS of some columns, whose lambda SciPy seeks column by column, as the equations are usually typed in."""
    from scipy.optimize import brentq

    flat_ip = stack.images_ihwc.reshape(stack.n_light, -1)
    count = min(BRENT_COLUMNS, flat_ip.shape[1])
    chosen = (np.arange(count) * flat_ip.shape[1] // count).astype(np.intp)
    some = LightStack(np.ascontiguousarray(flat_ip[:, chosen])[:, None, :, None], stack.directions_i3, stack.peak)
    prepared = prepare_fit(some, "cls", degree, options=FIT_OPTIONS, device=device)
    plan = prepared.plan
    if plan.synthesis_kr is None:
        raise ValueError("expected a least-squares plan, got one without a synthesis")
    synthesis_kr = plan.synthesis_kr
    samples_ip = flat_ip[:, chosen].astype(np.float64)
    square_r = plan.singular_r**2

    def solve(tolerance: float = 1e-6) -> NDArray[np.float64]:
        b_rp = plan.singular_r[:, None] * (plan.analysis_ri @ samples_ip)
        bound_p = plan.energy_i @ samples_ip**2
        c_rp = np.empty_like(b_rp)
        for p in range(count):
            b_r, bound = b_rp[:, p], bound_p[p]

            def excess(lam: float, b_r: NDArray = b_r, bound: float = bound) -> float:
                return float(np.sum((b_r / (square_r + lam)) ** 2) - bound)

            lam = 0.0
            if excess(0.0) > 0.0:
                lam = brentq(excess, 0.0, float(np.linalg.norm(b_r) / np.sqrt(bound)), rtol=tolerance, xtol=1e-12)
            c_rp[:, p] = b_r / (square_r + lam)
        return synthesis_kr @ c_rp

    basis_ik = evaluate_basis(stack.directions_i3, degree)
    everything = np.arange(count)
    return Stage(
        f"fit CLS, {count} columns",
        "SciPy brentq for each column",
        lambda: collect_fit(prepared),
        solve,
        _image_errors(basis_ik, lambda: _columns_of(prepared), solve, solve(1e-14), everything),
        _IMAGE_ERROR,
    )


def _wavelets(coeffs_khwc: NDArray[np.float32], device: Device) -> Iterator[Stage]:
    import pywt

    n_coeff, height, width, _ = coeffs_khwc.shape
    planes_khw = np.ascontiguousarray(coeffs_khwc[..., 0])
    ones_k = np.ones(n_coeff, np.float32)
    options = {"wavelet": _WAVELET, "mode": "periodization", "axes": (1, 2)}

    def analyse() -> Any:
        return pywt.wavedec2(planes_khw, level=_LEVELS, **options)

    ours, theirs = forward_transform(coeffs_khwc, ones_k, _LEVELS, device), analyse()
    kept = device.download(ours).copy()

    def synthesise() -> NDArray[np.float32]:
        # The transform back works in place, so that it gets its input anew each time.
        return inverse_transform(device.upload(kept.copy()), coeffs_khwc.shape, ones_k, _LEVELS, device)

    def errors() -> tuple[float, float]:
        back_khw = pywt.waverec2(theirs, **options)[:, :height, :width]
        largest = np.abs(planes_khw).max()
        differences = synthesise()[..., 0] - planes_khw, back_khw - planes_khw
        return tuple(float(np.abs(difference).max() / largest) for difference in differences)  # type: ignore[return-value]

    what = f"{n_coeff} maps of {height} × {width}, {_LEVELS} levels"
    there = lambda: forward_transform(coeffs_khwc, ones_k, _LEVELS, device)  # noqa: E731
    yield Stage(f"9/7 forward, {what}", f"PyWavelets wavedec2 {_WAVELET}", there, analyse, errors, _RELATIVE)
    back = lambda: pywt.waverec2(theirs, **options)  # noqa: E731
    yield Stage(f"9/7 inverse, {what}", f"PyWavelets waverec2 {_WAVELET}", synthesise, back, errors, _RELATIVE)


def _checked(images_ip: NDArray) -> NDArray[np.intp]:
    count = min(_CHECKED_COLUMNS, images_ip.shape[1])
    return (np.arange(count) * images_ip.shape[1] // count).astype(np.intp)


def _columns_of(prepared: PreparedFit) -> NDArray[np.float32]:
    fitted = collect_fit(prepared)
    return fitted.coeffs_khwc[:].reshape(fitted.n_coeff, -1)


def _image_errors(
    basis_ik: NDArray[np.float64],
    ours: Callable[[], NDArray],
    theirs: Callable[[], NDArray],
    exact_ks: NDArray,
    checked: NDArray[np.intp],
) -> Callable[[], tuple[float, float]]:
    def errors() -> tuple[float, float]:
        return tuple(float(np.abs(basis_ik @ (way()[:, checked] - exact_ks)).max()) for way in (ours, theirs))  # type: ignore[return-value]

    return errors
