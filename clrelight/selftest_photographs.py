"""Statements on what a photograph goes through: samples of each kind, searches for lambda, codecs, lights of maps."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import codec_class, decode, encode
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.fit import collect_fit, prepare_fit
from clrelight.harmonics.basis import evaluate_basis
from clrelight.lighting.environment import Environment
from clrelight.lighting.irradiance import integrate_irradiance
from clrelight.lighting.projection import project_environment
from clrelight.metrics import measure_errors
from clrelight.sampling import make_pattern
from clrelight.statements import Statement

KINDS = (("uint8", 255, "linear"), ("uint8", 255, "srgb"), ("uint16", 65535, "linear"), ("uint16", 65535, "srgb"),
         ("float16", 1, "linear"), ("float32", 1, "srgb"))  # fmt: skip
"""Types of samples, the code value of the peak, and the transfer."""
SOLVERS = ("newton", "bisection", "paper")

_IMAGE_LIMIT = 2e-5
_BOUND_LIMIT = 1e-5
_LIGHTS, _WIDTH, _DEGREE = 70, 97, 4
_PAPER_STEPS = 20


def check_photographs(device: Device) -> Iterator[Statement]:
    """Yield the statements, each as soon as it is measured."""
    for dtype, peak, transfer in KINDS:
        stack = _photographs(dtype, peak, transfer)
        for solver in SOLVERS:
            yield from _search(device, stack, solver, f"{dtype} {transfer}")
        yield from _quality(device, stack, f"{dtype} {transfer}")
    yield from _blocks(device)
    yield from _codebook(device)
    yield from _rate(device)
    for layout, shape in (("latlong", (24, 48)), ("angular", (40, 40))):
        yield from _light(device, layout, shape)
    yield from _curved(device)
    yield from _choice(device)


def _photographs(dtype: str, peak: int, transfer: str) -> LightStack:
    """Return matte pixels with highlights, some of them saturated and some in shadow, as code values."""
    rng = np.random.default_rng(5)
    lights_i3 = make_pattern("uniform", _LIGHTS)
    normals, mirrors = (vectors / np.linalg.norm(vectors, axis=0) for vectors in rng.standard_normal((2, 3, _WIDTH)))
    radiance_ip = rng.random(_WIDTH) * np.maximum(lights_i3 @ normals, 0.0)
    radiance_ip += 1.2 * np.exp(30.0 * (lights_i3 @ mirrors - 1.0))
    coded_ip = _to_srgb(np.minimum(radiance_ip, 1.0)) if transfer == "srgb" else np.minimum(radiance_ip, 1.0)
    coded_ip = coded_ip * peak if dtype.startswith("float") else np.rint(coded_ip * peak)
    return LightStack(coded_ip.astype(dtype)[:, None, :, None], lights_i3, float(peak), transfer)


def _to_srgb(radiance: NDArray) -> NDArray[np.float64]:
    """Encode as IEC 61966-2-1 has it."""
    return np.where(radiance <= 0.0031308, 12.92 * radiance, 1.055 * np.maximum(radiance, 1e-9) ** (1 / 2.4) - 0.055)


def _radiance(stack: LightStack) -> NDArray[np.float64]:
    """Return the samples as radiance in units of the peak, (light, pixel)."""
    coded_ip = stack.images_ihwc.reshape(stack.n_light, -1).astype(np.float64) / stack.peak
    if stack.transfer == "linear":
        return coded_ip
    return np.asarray(np.where(coded_ip <= 0.04045, coded_ip / 12.92, ((coded_ip + 0.055) / 1.055) ** 2.4), np.float64)


def _fit(device: Device, stack: LightStack, solver: str) -> CoefficientMap:
    options = {"solver": solver, "iterations": _PAPER_STEPS} if solver == "paper" else {"solver": solver}
    return collect_fit(prepare_fit(stack, "cls", _DEGREE, options=options, device=device))


def _search(device: Device, stack: LightStack, solver: str, samples: str) -> Iterator[Statement]:
    """Coefficients are noise-resistant-fitting, eq. 19, at the lambda found, and that lambda is the one sought."""
    fitted = _fit(device, stack, solver)
    found_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
    lambda_p = np.zeros(_WIDTH) if fitted.lambda_hwc is None else fitted.lambda_hwc.ravel().astype(np.float64)
    basis_ik, sample_ip = evaluate_basis(stack.directions_i3, _DEGREE), _radiance(stack)
    matrix_kk, right_kp = basis_ik.T @ basis_ik, basis_ik.T @ sample_ip

    def solve(lambda_p: NDArray) -> NDArray[np.float64]:
        matrix_pkk = matrix_kk + lambda_p[:, None, None] * np.eye(len(matrix_kk))
        return np.asarray(np.linalg.solve(matrix_pkk, right_kp.T[..., None])[..., 0].T, np.float64)

    bound_p = 4.0 * math.pi * np.mean(sample_ip**2, axis=0)
    error = np.abs(basis_ik @ (found_kp - solve(lambda_p))).max() / sample_ip.max()
    part, case = f"cls {solver}", f"degree {_DEGREE}, {samples}"
    yield Statement(part, case, "image error at its lambda, of the brightest", float(error), _IMAGE_LIMIT)
    excess_p = np.sum(found_kp**2, axis=0) / bound_p - 1.0
    yield Statement(part, case, "energy above the bound, of the bound", float(max(excess_p.max(), 0.0)), _BOUND_LIMIT)
    if solver == "paper":
        # From 1, doubled and halved: lambda is a whole number of last steps, and one less would not keep the bound.
        step = 2.0 ** (1 - _PAPER_STEPS)
        less_p = np.maximum(lambda_p - step, 0.0)
        late_p = np.where(lambda_p > 4.0, 0.0, 1.0 - np.sum(solve(less_p) ** 2, axis=0) / bound_p)
        late = float(max(late_p[lambda_p > 0.0].max(initial=0.0), 0.0))
        yield Statement(part, case, "room below the bound a step earlier, of the bound", late, _BOUND_LIMIT)
    else:
        short = float(np.max(-excess_p[lambda_p > 1e-6], initial=0.0))
        yield Statement(part, case, "energy short of the bound where lambda binds", short, _BOUND_LIMIT)


def _quality(device: Device, stack: LightStack, samples: str) -> Iterator[Statement]:
    fitted = _fit(device, stack, "newton")
    coeffs_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
    image_ip = np.clip(evaluate_basis(stack.directions_i3, _DEGREE) @ coeffs_kp, 0.0, 1.0)
    image_ip = _to_srgb(image_ip) if stack.transfer == "srgb" else image_ip
    sample_ip = stack.images_ihwc.reshape(image_ip.shape).astype(np.float64) / stack.peak
    mse_i = np.mean((image_ip - np.clip(sample_ip, 0.0, 1.0)) ** 2, axis=1)
    off_db = np.abs(10.0 * np.log10(measure_errors(fitted, stack, device=device) / mse_i)).max()
    yield Statement("psnr", f"degree {_DEGREE}, {samples}", "error in dB", float(off_db), 1e-3)


def _maps(shape: tuple[int, int, int, int], noise: float) -> NDArray[np.float32]:
    k, y, x, c = np.indices(shape)
    smooth = np.sin(y / 5.0 + x / 7.0 + k) / (1.0 + k) + 0.2 * c
    return (smooth + noise * np.random.default_rng(7).standard_normal(shape)).astype(np.float32)


def _blocks(device: Device) -> Iterator[Statement]:
    """Decoded from the words in float64; and what 2 and 4 bits per texel on a line cost."""
    coeffs = _maps((4, 18, 22, 3), 0.05)
    encoded = encode(coeffs, codec_class("s3tc")(), device)
    found = decode(encoded, device)
    words_gjb = np.frombuffer(bytes(encoded.body[:]), "<u4").reshape(4, 7, 5, 6)
    ends = words_gjb[:, :6].view("<f4").astype(np.float64)[..., None]
    share = ((words_gjb[:, 6, :, :, None] >> (2 * np.arange(16, dtype=np.uint32))) & 3)[:, None] / 3.0
    texels = (ends[:, :3] * (1.0 - share) + ends[:, 3:] * share).reshape(4, 3, 5, 6, 4, 4)
    exact = texels.transpose(0, 2, 4, 3, 5, 1).reshape(4, 20, 24, 3)[:, :18, :22]
    error = float(np.abs(found - exact).max() / np.abs(exact).max())
    yield Statement("s3tc", "smooth maps", "texels that are not those of the words, of the largest", error, 1e-6)
    yield Statement("s3tc", "smooth maps", "error, of the spread", _relative(found, coeffs), 0.12)
    coeffs = _maps((4, 18, 22, 3), 0.0)
    found = decode(encode(coeffs, codec_class("bc6h")(), device), device)
    yield Statement("bc6h", "texels on lines", "error, of the spread", _relative(found, coeffs), 0.1)
    flat = np.repeat(np.repeat(_maps((4, 3, 5, 3), 1.0), 4, axis=1), 4, axis=2)
    found = decode(encode(flat, codec_class("bc6h")(), device), device)
    error = float(np.max(np.abs(found - flat) / np.abs(flat).max(axis=3, keepdims=True)))
    yield Statement("bc6h", "blocks of one colour", "error, of the colour", error, 2e-3)


def _relative(found: NDArray, exact: NDArray) -> float:
    return float(np.sqrt(np.mean((found.astype(np.float64) - exact) ** 2)) / exact.astype(np.float64).std())


def _codebook(device: Device) -> Iterator[Statement]:
    coeffs = _maps((4, 19, 23, 3), 0.3)
    encoded = encode(coeffs, codec_class("vq").from_config({"bits": 5}), device)
    body = bytes(encoded.body[:])
    exponent = struct.unpack_from("<BBh", body)[2]
    words_jd = np.frombuffer(body, "<f2", 12 << 5, 4).reshape(1 << 5, 12).astype(np.float64) * 2.0**exponent
    vectors_pd = coeffs.transpose(1, 2, 0, 3).reshape(-1, 12).astype(np.float64)
    found_pd = decode(encoded, device).transpose(1, 2, 0, 3).reshape(-1, 12)
    nearest_p = np.min(np.sum((vectors_pd[:, None] - words_jd) ** 2, axis=2), axis=1)
    farther = np.max(np.sum((vectors_pd - found_pd) ** 2, axis=1) - nearest_p) / nearest_p.mean()
    yield Statement("vq", "5 bits", "squared error above the nearest codeword's, of the mean", float(farther), 1e-5)


def _rate(device: Device) -> Iterator[Statement]:
    """White noise: by its rate-distortion function R bits leave 2^-R of the spread, uniform steps 1.53 dB more."""
    for rate, channels, limit in ((1.0, 1, 1.4), (4.0, 1, 1.55), (8.0, 3, 1.55)):  # contexts learn, which takes bytes
        coeffs = np.random.default_rng(8).standard_normal((4, 67, 90, channels)).astype(np.float32)
        encoded = encode(coeffs, codec_class("wavelet").from_config({"rate": rate}), device)
        case = f"white noise, {channels} x {rate:g} bits"
        above = float(8.0 * encoded.encoded_bytes / coeffs.size / rate - 1.0)
        yield Statement("wavelet", case, "bytes above the rate, of the rate", max(above, 0.0), 0.0)
        error = _relative(decode(encoded, device), coeffs) * 2.0**rate
        yield Statement("wavelet", case, "error, of the least that any code leaves", error, limit)


def _light(device: Device, layout: str, shape: tuple[int, int]) -> Iterator[Statement]:
    radiance = np.random.default_rng(9).random((*shape, 3)).astype(np.float32) ** 4
    environment = Environment(radiance, layout)
    towards_t3, weight_t = environment.geometry()
    weighted_tc = np.where(weight_t[:, None] > 0, weight_t[:, None] * radiance.reshape(-1, 3), 0.0)
    exact_kc = evaluate_basis(towards_t3, 8).T @ weighted_tc
    found_kc = project_environment(environment, 8, method="direct", device=device).coeffs_kc
    error = float(np.abs(found_kc - exact_kc).max() / np.abs(exact_kc).max())
    yield Statement("projection", f"degree 8, {layout}", "error, of the largest coefficient", error, 1e-5)
    normals_n3 = make_pattern("uniform", 37, sphere=True)
    exact_nc = np.maximum(normals_n3 @ towards_t3.T, 0.0) @ weighted_tc
    found_nc = integrate_irradiance(environment, normals_n3, device=device)
    error = float(np.abs(found_nc - exact_nc).max() / exact_nc.max())
    yield Statement("irradiance", layout, "error, of the largest", error, 1e-5)


def _curved(device: Device) -> Iterator[Statement]:
    """Values as displayed that are one function for all pixels but for a factor: radiance between the lights."""
    lights_i3, between_t3 = make_pattern("uniform", 40), make_pattern("uniform", 97)
    factor_p = np.linspace(0.2, 0.9, _WIDTH)
    shown_ip, shown_tp = (
        np.outer(0.5 + 0.3 * s_n3[:, 0] + 0.2 * s_n3[:, 2], factor_p) for s_n3 in (lights_i3, between_t3)
    )
    codes = np.rint(65535.0 * shown_ip).astype(np.uint16)
    stack = LightStack(codes[:, None, :, None], lights_i3, 65535.0, "srgb")
    found_kp = collect_fit(prepare_fit(stack, "spectrum-curve", 6, device=device)).coeffs_khwc.reshape(-1, _WIDTH)
    exact_tp = ((shown_tp + 0.055) / 1.055) ** 2.4
    error = float(np.abs(evaluate_basis(between_t3, 6) @ found_kp - exact_tp)[shown_tp > 0.05].max())
    yield Statement("spectrum-curve", "a ramp as displayed", "error between the lights, of the peak", error, 0.01)


def _choice(device: Device) -> Iterator[Statement]:
    """Functions of degree 3 in 8 bits: what auto takes, and what it makes of lights that it has not seen."""
    lights_i3, between_t3 = make_pattern("uniform", 40), make_pattern("uniform", 97)
    coeffs_kp = 0.03 * np.random.default_rng(7).standard_normal((16, _WIDTH))
    coeffs_kp[0] += 1.7
    value_ip, truth_tp = (evaluate_basis(directions, 3) @ coeffs_kp for directions in (lights_i3, between_t3))
    codes = np.rint(255.0 * value_ip).astype(np.uint8)
    prepared = prepare_fit(LightStack(codes[:, None, :, None], lights_i3, 255.0), "auto", "auto", device=device)
    yield Statement(
        "auto", "functions of degree 3", "degrees above or below theirs", float(abs(prepared.degree - 3)), 0.0
    )
    found_kp = collect_fit(prepared).coeffs_khwc.reshape(-1, _WIDTH)
    error = float(np.abs(evaluate_basis(between_t3, prepared.degree) @ found_kp - truth_tp).max() / truth_tp.max())
    yield Statement("auto", "functions of degree 3", "error between the lights, of the brightest", error, 0.01)
