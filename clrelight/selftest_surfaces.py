"""Statements on bounded values, on surfaces behind photographs, and on maps of light: what later kernels compute."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.radial import Phong
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.fit import collect_fit, prepare_fit
from clrelight.fit.precision import MIXED, SINGLE
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.latlong import project_latlong
from clrelight.lighting.projection_device import project_latlong_on_device
from clrelight.sampling import make_pattern
from clrelight.shrm.angular import integrate_directions, integrate_on_device
from clrelight.shrm.expansion import expand_orders
from clrelight.statements import Statement
from clrelight.variation.kernel import LANES, NormalSolver
from clrelight.variation.reflectance import Law, fit_law
from clrelight.variation.reflectance_kernel import LawSolver

_ACTIVE = 1e-4
"""Of the root of E_c: a value as near to its bound as that may press on it."""
_ANGLE = 1e-3
"""Of normals without noise, in radians, and part of an albedo."""


def check_surfaces(device: Device) -> Iterator[Statement]:
    """Yield the statements, each as soon as it is measured."""
    for degree in (1, 4, 8):
        if device.info.float64:  # double is what mixed does
            yield from _bounded(device, degree, MIXED, 1e-6, 1e-5)
        yield from _bounded(device, degree, SINGLE, 1e-5, 1e-3)
    yield from _normals(device)
    yield from _lobes(device)
    yield from _azimuths(device)


def _bounded(device: Device, degree: int, precision: str, least: float, descent: float) -> Iterator[Statement]:
    """Karush, Kuhn and Tucker: within all bounds, and what would lessen the error is pushed back by those that bind."""
    lights_i3, at_j3 = make_pattern("uniform", 90), make_pattern("uniform", 64)
    rng = np.random.default_rng(11)
    mirrors = make_pattern("uniform", 24)
    sample_ip = np.exp(20.0 * (lights_i3 @ mirrors.T - 1.0)) + 0.02 * rng.random((90, 24))
    stack = LightStack(sample_ip.astype(np.float32)[:, None, :, None], lights_i3, 1.0)
    options = {"nonnegative": True, "at": tuple(map(tuple, at_j3.tolist()))}
    fitted = collect_fit(prepare_fit(stack, "constrained", degree, options=options, precision=precision, device=device))
    found_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
    basis_ik, rows_jk = (evaluate_basis(each, degree) for each in (lights_i3, at_j3))
    sample_ip = sample_ip.astype(np.float32).astype(np.float64)
    energy_p = 4.0 * np.pi * np.mean(sample_ip**2, axis=0)
    part, case = f"constrained {precision}", f"degree {degree}"
    excess = np.max(np.sum(found_kp**2, axis=0) / energy_p - 1.0)
    yield Statement(part, case, "energy above the bound, of the bound", float(max(excess, 0.0)), 1e-5)
    value_jp = rows_jk @ found_kp / np.sqrt(energy_p)
    yield Statement(part, case, "values below 0, of the root of the bound", float(max(-value_jp.min(), 0.0)), least)
    slope_kp = basis_ik.T @ (sample_ip - basis_ik @ found_kp)
    worst = 0.0
    for p in range(sample_ip.shape[1]):
        binding = [found_kp[:, p], *-rows_jk[value_jp[:, p] < _ACTIVE]]
        left = scipy.optimize.nnls(np.stack(binding, axis=1), slope_kp[:, p])[1]
        worst = max(worst, left / np.linalg.norm(basis_ik.T @ sample_ip[:, p]))
    yield Statement(part, case, "descent that no bound stops, of the steepest", float(worst), descent)


def _normals(device: Device) -> Iterator[Statement]:
    """Matte pixels without noise, that most lights reach: their normals are known."""
    lights_i3 = make_pattern("uniform", 40)
    towards_p3 = make_pattern("uniform", 5 * LANES) * [0.6, 0.6, 1.0]
    towards_p3 /= np.linalg.norm(towards_p3, axis=1, keepdims=True)
    albedo_p = np.random.default_rng(12).uniform(0.1, 0.9, len(towards_p3))
    matte_ip = np.maximum(lights_i3 @ towards_p3.T, 0.0) * albedo_p
    samples_cip = np.stack([matte_ip, 0.5 * matte_ip]).astype(np.float32)
    view_3p = np.zeros((3, len(towards_p3)), np.float32)
    view_3p[2] = 1.0
    pixels = NormalSolver(device, lights_i3, 0.0)(samples_cip, 2.0)
    apart_p = np.linalg.norm(pixels.normals_p3 - towards_p3, axis=1)
    yield Statement("normals", "quick", "angle off, in radians", float(apart_p.max()), _ANGLE)
    off_p = np.abs(pixels.albedo_pc[:, 0] / albedo_p - 1.0)
    yield Statement("normals", "quick", "error of the albedo, of it", float(off_p.max()), _ANGLE)
    for law in (Law(glossy=False), Law(), Law((True, True, True))):
        found_p3 = LawSolver(device, lights_i3, law)(samples_cip, view_3p, 2.0).found.normals_p3
        exact_p3 = fit_law(samples_cip, lights_i3, view_3p.T, law, most=2.0).found.normals_p3
        apart = float(np.linalg.norm(found_p3 - exact_p3, axis=1).max())
        yield Statement("normals", law.text, "angle from that of float64, in radians", apart, _ANGLE)


def _lobes(device: Device) -> Iterator[Statement]:
    rng = np.random.default_rng(13)
    light_t3, central_n3, view_n3 = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in _vectors(rng))
    weighted_tc = rng.random((len(light_t3), 3))
    for brdf in (Phong(40), Microfacet(0.3), KajiyaKay(16)):
        exact_nc = integrate_directions(light_t3, weighted_tc, brdf, central_n3, view_n3)
        found_nc = integrate_on_device(device, light_t3, weighted_tc, brdf, central_n3, view_n3)
        yield Statement("reflection", brdf.id, "error, of the largest", _error(found_nc, exact_nc), 1e-4)
    sums_hkmc = rng.standard_normal((5, 3, 9, 3)) + 1j * rng.standard_normal((5, 3, 9, 3))
    for width in (32, 37):
        exact, found = expand_orders(sums_hkmc, width, "product"), expand_orders(sums_hkmc, width, "device", device)
        case = f"9 orders in {width} columns"
        yield Statement("reflection", case, "error, of the largest", _error(found, exact), 2e-6)


def _vectors(rng: np.random.Generator) -> Iterator[NDArray[np.float64]]:
    yield from (rng.standard_normal((count, 3)) for count in (700, 37, 37))


def _azimuths(device: Device) -> Iterator[Statement]:
    for shape in ((24, 48, 3), (17, 33, 1)):
        radiance_hwc = np.random.default_rng(14).random(shape).astype(np.float32) ** 4
        exact_kc = project_latlong(radiance_hwc.astype(np.float64), 8)
        found_kc = project_latlong_on_device(radiance_hwc, 8, device)
        case = f"degree 8, {shape[0]} x {shape[1]}, by azimuths"
        error = _error(found_kc, exact_kc)
        yield Statement("projection", case, "error, of the largest coefficient", error, 2e-6)


def _error(found: NDArray, exact: NDArray) -> float:
    return float(np.abs(found - exact).max() / np.abs(exact).max())
