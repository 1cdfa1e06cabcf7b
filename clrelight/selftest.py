"""Whether a device computes what it should: statements with a figure and a limit, against float64 on the host."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import codec_class, decode, encode
from clrelight.codec.entropy.range_coding import Encoder
from clrelight.codec.entropy.subband_kernel import decoder_for
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.transforms.lifting import forward_transform, inverse_transform, list_subbands
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.fit import collect_fit, prepare_fit
from clrelight.fit.linear import LARGEST_CONDITION
from clrelight.fit.plan import IMAGE_ROUNDING
from clrelight.fit.precision import DOUBLE, MIXED, SINGLE
from clrelight.harmonics.basis import evaluate_basis
from clrelight.metrics import measure_errors
from clrelight.relight import relight
from clrelight.sampling import make_pattern
from clrelight.selftest_packing import check_packing
from clrelight.selftest_photographs import check_photographs
from clrelight.selftest_surfaces import check_surfaces
from clrelight.statements import Statement

IMAGE_LIMIT = 2e-5
"""Error of a fitted image as a part of the brightest sample."""
DOUBLE_LIMIT = 2e-7
"""The same in double precision, where only the coefficients are rounded."""
BOUND_LIMIT = 1e-5
"""Part of E_c that the energy of coefficients may be above it."""
DEGREES = (1, 2, 4, 6, 8, 10, 12, 15, 31)
CAPS = (60, 30, 10, 2)
"""Radii in degrees."""
PRECISION_DEGREES = (4, 8, 15, 31)
"""Those of single and double precision."""
SCALES = (1e-30, 1e-15, 1e15, 1e30)
FACTORS = (1e-12, 1e-6, 1e-2, 10.0, 1e3)

_PIXELS = 32
_HALVINGS = 100


def run_selftest(device: Device) -> Iterator[Statement]:
    """Yield the statements, each as soon as it is measured."""
    yield from _basis()
    for degree in DEGREES:
        yield from _fits(device, _dome(degree), degree, f"degree {degree}", ("cls", "ceb", "uls", "spline"))
    for radius in CAPS:
        yield from _fits(device, _cap(200, radius), 6, f"degree 6, cap of {radius}°", ("cls", "ceb", "uls"))
    clusters = make_pattern("scattered", 120, seed=3)
    yield from _fits(device, clusters, 10, "degree 10, clusters", ("cls", "ceb"))
    twice = np.repeat(make_pattern("uniform", 60), 2, axis=0)
    yield from _fits(device, twice, 8, "degree 8, equal lights", ("cls", "ceb"))
    lights = make_pattern("uniform", 90)
    yield from _fits(device, make_pattern("uniform", 8), 6, "degree 6, 8 lights", ("cls", "ceb"))
    for scale in SCALES:
        yield from _fits(device, lights, 4, f"degree 4, samples x {scale:g}", ("cls", "ceb"), scale=scale)
    for factor in FACTORS:
        yield from _fits(device, lights, 4, f"degree 4, energy {factor:g}", ("cls", "ceb"), energy=factor)
    for degree in PRECISION_DEGREES:
        case, bounded = f"degree {degree}", ("cls", "ceb", "spline")
        yield from _fits(device, _dome(degree), degree, case, ("cls",), precision=SINGLE)
        if device.info.float64:
            yield from _fits(device, _dome(degree), degree, case, bounded, precision=DOUBLE)
    yield from _powers_of_two(device, lights)
    yield from _codecs(device)
    yield from _codes(device)
    yield from _images(device, (2, 6, 10))
    yield from check_photographs(device)
    yield from check_packing(device)
    yield from check_surfaces(device)


def run_quick_selftest(device: Device) -> Iterator[Statement]:
    """Yield one statement or a few of each kind of kernel: what a driver that can be trusted computes right."""
    lights = make_pattern("uniform", 40)
    yield from _fits(device, lights, 3, "degree 3", ("cls", "ceb", "uls", "spline"))
    if device.info.float64:
        yield from _fits(device, lights, 3, "degree 3", ("cls", "ceb"), precision=DOUBLE)
    yield from _codes(device)
    yield from _transform(device, (1, 2, 5, 8, 13), (1, 7, 16, 33))
    yield from _indices(device)
    yield from _images(device, (3,), halves=False)
    yield from check_packing(device)


def _fit(
    device: Device, stack: LightStack, method: str, degree: int, options: dict[str, float], precision: str = MIXED
) -> CoefficientMap:
    return collect_fit(prepare_fit(stack, method, degree, options=options, precision=precision, device=device))


def _fits(
    device: Device,
    lights_i3: NDArray[np.float64],
    degree: int,
    case: str,
    methods: tuple[str, ...],
    *,
    scale: float = 1.0,
    energy: float = 1.0,
    precision: str = MIXED,
) -> Iterator[Statement]:
    stack = _stack(lights_i3, scale)
    sample_ip = stack.images_ihwc.reshape(stack.n_light, -1).astype(np.float64)
    basis_ik = evaluate_basis(lights_i3, degree)
    left, sigma, right = np.linalg.svd(basis_ik, full_matrices=False)
    held = sigma > sigma[0] * max(basis_ik.shape) * np.finfo(np.float64).eps
    left, sigma, rotation = left[:, held], sigma[held, None], right[held].T
    z_rp = left.T @ sample_ip
    condition = sigma[0, 0] / sigma[-1, 0]
    energy_p = energy * 4.0 * np.pi * np.mean(sample_ip**2, axis=0)
    for method in methods:
        if method == "uls" and len(lights_i3) < basis_ik.shape[1]:
            continue
        options = {"energy": energy} if method in ("cls", "ceb") else {"lam": 0.1} if method == "spline" else {}
        fitted = _fit(device, stack, method, degree, options, precision)
        found_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
        limit = DOUBLE_LIMIT if precision == DOUBLE else IMAGE_LIMIT
        if method == "cls":
            exact_kp = rotation @ _constrained(sigma, z_rp, energy_p)
        elif method == "ceb":
            # Where a sum meets the bound within rounding errors either rank is right: compared at the rank found.
            rank_p = np.zeros(len(energy_p)) if fitted.rank_hwc is None else fitted.rank_hwc.ravel()
            exact_kp = rotation @ np.where(np.arange(len(sigma))[:, None] < rank_p, z_rp / sigma, 0.0)
        elif method == "uls":
            kept = sigma * LARGEST_CONDITION >= sigma[0]
            exact_kp = rotation @ np.where(kept, z_rp / sigma, 0.0)
            limit = max(limit, IMAGE_ROUNDING * min(condition, LARGEST_CONDITION))
        else:
            exact_kp = _smoothed(basis_ik, sample_ip, degree)
        error = np.abs(basis_ik @ (found_kp - exact_kp)).max() / sample_ip.max()
        at = f"{case}, condition {condition:.0e}" if method == "uls" else case
        part = method if precision == MIXED else f"{method} {precision}"
        yield Statement(part, at, "image error, of the brightest sample", float(error), limit)
        if method in ("cls", "ceb"):
            excess = np.max(np.sum(found_kp**2, axis=0) / np.where(energy_p > 0.0, energy_p, 1.0) - 1.0)
            yield Statement(part, case, "energy above the bound, of the bound", float(max(excess, 0.0)), BOUND_LIMIT)


def _constrained(sigma: NDArray, z_rp: NDArray, energy_p: NDArray) -> NDArray[np.float64]:
    """Return the shrunk components of noise-resistant-fitting, eq. 19-25, lambda by halving its logarithm."""

    def shrink(lambda_p: NDArray | float) -> NDArray[np.float64]:
        return sigma * z_rp / (sigma**2 + lambda_p)

    high = np.linalg.norm(sigma * z_rp, axis=0) / np.sqrt(np.where(energy_p > 0.0, energy_p, 1.0)) + 1e-300
    low = 1e-30 * high
    for _ in range(_HALVINGS):
        middle = np.sqrt(low) * np.sqrt(high)
        within = np.sum(shrink(middle) ** 2, axis=0) <= energy_p
        low, high = np.where(within, low, middle), np.where(within, middle, high)
    free = np.sum(shrink(0.0) ** 2, axis=0) <= energy_p
    return shrink(np.where(free, 0.0, high))


def _smoothed(basis_ik: NDArray, sample_ip: NDArray, degree: int) -> NDArray[np.float64]:
    """Return the smoothing spline of lambda 0.1 by stacked least squares."""
    l_k = np.repeat(np.arange(degree + 1.0), 2 * np.arange(degree + 1) + 1)
    rows_kk = np.diag(np.sqrt(0.1 * (0.01 + (l_k * (l_k + 1.0)) ** 2)))
    stacked = np.concatenate([basis_ik, rows_kk])
    return np.linalg.lstsq(stacked, np.concatenate([sample_ip, np.zeros((len(l_k), sample_ip.shape[1]))]))[0]


def _basis() -> Iterator[Statement]:
    for degree in (6, 15, 31):
        nodes, weights = np.polynomial.legendre.leggauss(degree + 1)
        around = np.arange(2 * degree + 1) * (2.0 * np.pi / (2 * degree + 1))
        across = np.sqrt(1.0 - nodes**2)[:, None]
        z = np.broadcast_to(nodes[:, None], (degree + 1, len(around)))
        lights_i3 = np.stack([across * np.cos(around), across * np.sin(around), z], axis=2).reshape(-1, 3)
        basis_ik = evaluate_basis(lights_i3, degree)
        weight_i = np.repeat(weights, len(around)) * (2.0 * np.pi / len(around))
        error = np.abs((weight_i[:, None] * basis_ik).T @ basis_ik - np.eye(basis_ik.shape[1])).max()
        yield Statement("basis", f"degree {degree}", "integral of products, from orthonormal", float(error), 1e-12)


def _powers_of_two(device: Device, lights_i3: NDArray[np.float64]) -> Iterator[Statement]:
    stack = _stack(lights_i3)
    for method in ("cls", "ceb", "uls"):
        plain = _fit(device, stack, method, 6, {}).coeffs_khwc
        for power in (-90, 90):
            scaled = _fit(device, replace(stack, images_ihwc=np.ldexp(stack.images_ihwc, power)), method, 6, {})
            differ = int(np.sum(np.ldexp(plain, power) != scaled.coeffs_khwc))
            yield Statement(method, f"degree 6, samples x 2^{power}", "coefficients that are not x that", differ, 0.0)


def _codecs(device: Device) -> Iterator[Statement]:
    rng = np.random.default_rng(0)
    for shape in ((4, 1, 1, 1), (4, 1, 37, 3), (9, 13, 17, 3)):
        coeffs = rng.standard_normal(shape).astype(np.float32)
        case = " x ".join(map(str, shape))
        half = decode(encode(coeffs, codec_class("half")(), device), device)
        differ = int(np.sum(half != coeffs.astype(np.float16).astype(np.float32)))
        yield Statement("half", case, "values that are not the nearest", differ, 0.0)
        for scale in (1e-30, 1.0, 1e30):
            scaled = (coeffs * scale).astype(np.float32)
            found = decode(encode(scaled, codec_class("uniform")(), device), device)
            span_k111 = np.ptp(scaled.astype(np.float64), axis=(1, 2, 3), keepdims=True)
            error = float(np.max(np.abs(found.astype(np.float64) - scaled) / np.where(span_k111 > 0, span_k111, 1.0)))
            # 256 levels; the interval may be narrower than the range, at most by what costs less than it saves.
            yield Statement("uniform", f"{case}, x {scale:g}", "error, of a map's range", error, 0.02)
    yield from _transform(device, tuple(range(1, 41)), (1, 2, 5, 20, 41))
    yield from _indices(device)


def _indices(device: Device) -> Iterator[Statement]:
    """Indices of old bodies of `wavelet` and `klt`, as NumPy codes them."""
    shape, bands = (3, 21, 34), list_subbands(21, 34, 3)
    encoder, learnt = Encoder(), Statistics()
    rng = np.random.default_rng(2)
    maps = [np.rint(rng.laplace(scale=scale, size=shape)).astype(np.int32) for scale in (0.1, 2.0, 1e6)]
    for index in maps:
        code_indices(encoder, learnt, bands, shape, index)
    decoder, learnt, differing = decoder_for(encoder.to_bytes(), device), Statistics(), 0
    for index in maps:
        differing += int(np.count_nonzero(code_indices(decoder, learnt, bands, shape, None) != index))
    yield Statement("wavelet", "three maps", "indices of old bodies that are not those coded", float(differing), 0.0)


def _transform(device: Device, heights: tuple[int, ...], widths: tuple[int, ...]) -> Iterator[Statement]:
    rng = np.random.default_rng(1)
    worst, unit = 0.0, np.ones(1, np.float32)
    for height in heights:
        for width in {*widths, height, 41 - height}:
            coeffs = rng.standard_normal((1, height, width, 1)).astype(np.float32)
            planes = forward_transform(coeffs, unit, 3, device)
            back = inverse_transform(planes, coeffs.shape, unit, 3, device)
            worst = max(worst, float(np.abs(back - coeffs).max() / np.abs(coeffs).max()))
    case = f"heights {heights[0]} to {heights[-1]}"
    yield Statement("wavelet", case, "error there and back, unquantised", worst, 1e-6)


def _codes(device: Device) -> Iterator[Statement]:
    """Blocks whose texels lie on a line, which s3tc holds but for rounding; halves; levels."""
    rng = np.random.default_rng(2)
    ends, levels = rng.standard_normal((2, 4, 1, 1, 3)), rng.integers(0, 4, (4, 18, 21, 1))
    levels[:, ::4, ::4], levels[:, 1::4, ::4] = 0, 3
    on_line = (ends[0] + levels / 3.0 * (ends[1] - ends[0])).astype(np.float32)
    found = decode(encode(on_line, codec_class("s3tc")(), device), device)
    yield Statement("s3tc", "texels on lines", "error, of the largest", _largest_error(found, on_line), 1e-5)
    coeffs = rng.standard_normal((4, 13, 17, 3)).astype(np.float32)
    found = decode(encode(coeffs, codec_class("half")(), device), device)
    differ = int(np.sum(found != coeffs.astype(np.float16).astype(np.float32)))
    yield Statement("half", "normal numbers", "values that are not the nearest", differ, 0.0)
    found = decode(encode(coeffs, codec_class("uniform").from_config({"bits": 12}), device), device)
    yield Statement("uniform", "12 bits", "error, of the largest", _largest_error(found, coeffs), 2e-3)


def _largest_error(found: NDArray, exact: NDArray) -> float:
    return float(np.abs(found.astype(np.float64) - exact).max() / np.abs(exact).max())


def _images(device: Device, degrees: tuple[int, ...], *, halves: bool = True) -> Iterator[Statement]:
    lights_i3 = make_pattern("uniform", 256)
    stack = _stack(lights_i3)
    for degree in degrees:
        fitted = _fit(device, stack, "cls", degree, {})
        half = replace(fitted, coeffs_khwc=fitted.coeffs_khwc.astype(np.float16))
        basis_ik = evaluate_basis(lights_i3, degree)
        for case, stored in ((f"degree {degree}", fitted), (f"degree {degree}, float16", half))[: 1 + halves]:
            exact_ip = basis_ik @ stored.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
            found_ip = relight(stored, lights_i3, device=device).reshape(exact_ip.shape)
            error = float(np.abs(found_ip - exact_ip).max() / np.abs(exact_ip).max())
            yield Statement("relight", case, "error, of the brightest", error, 2e-6)
            sample_ip = stack.images_ihwc.reshape(exact_ip.shape).astype(np.float64)
            mse_i = np.mean((np.clip(exact_ip, 0.0, 1.0) - np.clip(sample_ip, 0.0, 1.0)) ** 2, axis=1)
            off_db = np.abs(10.0 * np.log10(measure_errors(stored, stack, device=device) / mse_i)).max()
            yield Statement("psnr", case, "error in dB", float(off_db), 1e-3)


def _dome(degree: int) -> NDArray[np.float64]:
    return make_pattern("uniform", 256 if degree <= 15 else 1024)


def _cap(count: int, radius: float) -> NDArray[np.float64]:
    """Return a uniform pattern of the hemisphere drawn together into a cap of this radius in degrees."""
    lights_i3 = make_pattern("uniform", count)
    z_i = 1.0 - (1.0 - np.cos(np.radians(radius))) * (1.0 - lights_i3[:, 2])
    across_i = np.sqrt((1.0 - z_i**2) / (1.0 - lights_i3[:, 2] ** 2))
    return np.stack([lights_i3[:, 0] * across_i, lights_i3[:, 1] * across_i, z_i], axis=1)


def _stack(lights_i3: NDArray[np.float64], scale: float = 1.0) -> LightStack:
    """Return pixels half in shadow, with highlights and noise, of all brightnesses; one black."""
    rng = np.random.default_rng(0)
    normals, mirrors = (vectors / np.linalg.norm(vectors, axis=0) for vectors in rng.standard_normal((2, 3, _PIXELS)))
    sample_ip = 0.4 * np.maximum(lights_i3 @ normals, 0.0) + 0.4 * np.exp(20.0 * (lights_i3 @ mirrors - 1.0))
    sample_ip += 0.2 * rng.random(_PIXELS) ** 4 * rng.random(sample_ip.shape)
    sample_ip *= scale * 2.0 ** rng.integers(-7, 1, _PIXELS)
    sample_ip[:, 0] = 0.0
    return LightStack(sample_ip.astype(np.float32)[:, None, :, None], lights_i3, 1.0)
