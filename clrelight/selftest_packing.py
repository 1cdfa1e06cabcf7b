"""Statements about what makes a small file of photographs, and an image of that: the curve, planes, and units."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import codec_class, decode, decode_view, encode
from clrelight.codec.streams import Linear, Source
from clrelight.codec.transforms.code_values import bent, node_matrices
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.workspace import Shape, Workspace
from clrelight.conventions import TRANSFERS, linear_to_srgb, srgb_to_linear
from clrelight.device import Device
from clrelight.harmonics.basis import evaluate_basis
from clrelight.matmul import SampleCurve
from clrelight.sampling import make_pattern
from clrelight.statements import Statement

_LIGHTS, _DEGREE = 20, 2


def check_packing(device: Device) -> Iterator[Statement]:
    """Yield the statements."""
    values = np.linspace(0.0, 1.0, 4099, dtype=np.float32)
    for decodes, curve in ((False, linear_to_srgb), (True, srgb_to_linear)):
        error = np.abs(bent(values, device, decode=decodes) - curve(values.astype(np.float64))).max()
        yield Statement("curve", "code values" if decodes else "radiance", "error", float(error), 1e-6)
    for transfer in TRANSFERS:
        yield _planes(device, transfer)
    yield from _units(device)


class _Photographs(Source):
    """Random photographs, as a fit that is linear in them gives them to a codec."""

    sample_type: np.dtype = np.dtype(np.uint8)

    def __init__(self, device: Device, shape: Shape, linear: Linear) -> None:
        super().__init__(shape, device, Workspace())
        self.linear = linear
        rng = np.random.default_rng(3)
        self.samples_ihwc = rng.integers(0, 256, (linear.analysis_ri.shape[1], *shape[1:]), np.uint8)

    def read_rows(self, first: int, end: int) -> NDArray[np.float32]:
        """See `Source`; nothing here asks for it."""
        raise NotImplementedError

    def read_samples(self, rows: tuple[int, int], columns: tuple[int, int]) -> NDArray:
        """See `Source`."""
        return self.samples_ihwc[:, slice(*rows), slice(*columns)].copy()


def _planes(device: Device, transfer: str) -> Statement:
    """State how far planes of photographs, coded behind a transfer, are from float64's."""
    shape = ((_DEGREE + 1) ** 2, 5, 37, 3)
    basis_ik = evaluate_basis(make_pattern("uniform", _LIGHTS), _DEGREE)
    linear = Linear(np.linalg.pinv(basis_ik).astype(np.float64), np.eye(shape[0]), SampleCurve(255.0, "srgb"))
    source = _Photographs(device, shape, linear)
    operator_jq = np.random.default_rng(4).standard_normal((11, shape[0] * shape[3]))
    offset_j = np.linspace(-1.0, 1.0, 11)
    made = Pixels(source, transfer).planes((1, 4), (2, 35), (operator_jq, offset_j))
    found_jhw = device.download(made)[:, :, :33]
    radiance = srgb_to_linear(source.samples_ihwc[:, 1:4, 2:35] / 255.0)
    coeffs = np.einsum("ki,ihwc->khwc", linear.analysis_ri, radiance)
    if transfer == "srgb":
        synthesis_nk, analysis_kn = node_matrices(shape[0])
        shown = np.einsum("nk,khwc->nhwc", synthesis_nk, coeffs)
        coeffs = np.einsum("kn,nhwc->khwc", analysis_kn, np.copysign(linear_to_srgb(np.abs(shown)), shown))
    exact = np.einsum("jkc,khwc->jhw", operator_jq.reshape(11, shape[0], 3), coeffs) - offset_j[:, None, None]
    error = float(np.abs(found_jhw - exact).max() / np.abs(exact).max())
    return Statement("klt", f"planes of {transfer} values", "error, of the largest", error, 1e-5)


def _units(device: Device) -> Iterator[Statement]:
    """State how far a map that went through units is from itself, and its image from that of its coefficients."""
    y, x = np.mgrid[0:1:70j, 0:1:90j]
    waves = np.stack([np.cos(3 * k * x + k * y) / (1 + k) for k in range(9)])
    coeffs_khwc = np.stack([waves, 0.5 * waves[::-1], waves**2], axis=-1).astype(np.float32)
    step = 1 / 512
    encoded = encode(coeffs_khwc, codec_class("klt").from_config({"step": step}), device)
    found_khwc = decode(encoded.to_bytes(), device)
    error = float(np.sqrt(np.mean((found_khwc - coeffs_khwc.astype(np.float64)) ** 2)))
    yield Statement("klt", "units at a fine step", "error, of the step", error / step, 1.0)
    light_i3 = np.array([[0.48, 0.6, 0.64]])
    view = decode_view(encoded.to_bytes(), device)
    if view is None:
        raise TypeError("klt relights without coefficients")
    image = view.relight(light_i3, device)[0]
    exact = np.einsum("k,khwc->hwc", evaluate_basis(light_i3, 2)[0], found_khwc.astype(np.float64))
    yield Statement("klt", "relit from units", "error, of the brightest", float(np.abs(image - exact).max()), 1e-5)
