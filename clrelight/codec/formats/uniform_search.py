"""Choose the interval of a uniform quantiser by its measured (operational) distortion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import round_up, slabs
from clrelight.codec.transforms.vectors import golden_indices
from clrelight.device import Device

STRETCH = 4096
"""Coefficients of one work-item, on a GPU of one group: 16 kB, which stay in the first cache (in registers) while many
quantisers are measured."""

_GROUP, _PACKED = 256, 8
"""Work-items of a GPU's group, and the codes that each of them packs: the fewest that fill whole bytes."""

SAMPLES = 8192
"""Values of a map that the search looks at; the decision is measured on all of them."""

# The interval is anchor - (anchor - least) 2**-a to anchor + (greatest - anchor) 2**-b, around the median. Rounds
# try offsets of (a, b) from the best so far: on the sample all pairs, coarse to fine; then on all values wider
# intervals, since the sample may have missed rare large values, and the neighbours of the best.
_COARSE, _MIDDLE, _FINE = np.arange(8.0), np.array([0, -0.66, -0.33, 0.33, 0.66]), np.array([0, -0.2, -0.1, 0.1, 0.2])
_WIDER, _NEAR = np.array([0, -0.1, -0.3, -1.0, -2.5, -5.0]), np.array([0, -0.07, 0.07])
SAMPLE_ROUNDS = tuple(tuple(np.meshgrid(e, e)) for e in (_COARSE, _MIDDLE, _FINE))
FULL_ROUNDS = ((_WIDER, _WIDER), tuple(np.meshgrid(_NEAR, _NEAR)))

_FLOAT32 = np.finfo(np.float32)


@dataclass(frozen=True)
class Quantiser:
    """First level and step of each map (float32, as stored), and the same in units of ``unscale_k``.

    The unit is a power of two near the map's largest magnitude, so that kernels compute with numbers near 1.
    """

    low_k: NDArray[np.float32]
    step_k: NDArray[np.float32]
    scaled_low_k: NDArray[np.float32]
    scaled_step_k: NDArray[np.float32]
    scale_k: NDArray[np.float32]
    unscale_k: NDArray[np.float32]

    def __getitem__(self, maps: slice) -> Self:
        """Return the quantisers of some of the maps."""
        return type(self)(*(getattr(self, field.name)[maps] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return the quantisers of the maps of all parts, in turn."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))

    @classmethod
    def of(cls, low_k: NDArray[np.float32], step_k: NDArray[np.float32], reach_k: NDArray[np.float64]) -> Self:
        """Return the quantisers of maps whose largest magnitude is `reach_k`; leading axes as in `low_k`."""
        exponent_k = np.clip(np.frexp(reach_k)[1], -126, 126)
        scale_k = np.ldexp(1.0, -exponent_k)
        per_map = scale_k if low_k.ndim == 1 else scale_k[:, None]
        return cls(
            low_k,
            step_k,
            scaled_low_k=(low_k * per_map).astype(np.float32),
            scaled_step_k=(step_k * per_map).astype(np.float32),
            scale_k=scale_k.astype(np.float32),
            unscale_k=np.ldexp(1.0, exponent_k).astype(np.float32),
        )


def choose_quantiser(coeffs_kp: NDArray[np.float32], bits: int, device: Device) -> Quantiser:
    """Return for each map the quantiser of ``2**bits`` levels with the least squared error found.

    Candidates are levels from least to greatest value, and intervals that clip either end; from each also the
    neighbour that has 0 as a level, which keeps black exactly black. The last choice is measured on all values,
    with the arithmetic of the encoder; ties go to the unclipped.

    Parameters
    ----------
    coeffs_kp : ndarray, shape (n_coeff, values of a map), float32
        Finite coefficients.
    bits : int
        Bits of a code, 1 to 16.
    device : Device
        Where to measure.

    Returns
    -------
    Quantiser
        With one first level and step for each map.
    """
    top = 2**bits - 1
    least_k, greatest_k = (f(coeffs_kp, axis=1).astype(np.float64) for f in (np.min, np.max))
    reach_k = np.maximum(np.abs(least_k), np.abs(greatest_k))
    n_value = coeffs_kp.shape[1]
    samples_kp = coeffs_kp
    if n_value > SAMPLES:
        samples_kp = np.ascontiguousarray(coeffs_kp[:, golden_indices(n_value, SAMPLES)])
    anchor_k = np.median(samples_kp.astype(np.float64), axis=1)

    def candidates(a_kj: NDArray[np.float64], b_kj: NDArray[np.float64]) -> Quantiser:
        low_kj = anchor_k[:, None] - (anchor_k - least_k)[:, None] * np.exp2(-a_kj)
        high_kj = anchor_k[:, None] + (greatest_k - anchor_k)[:, None] * np.exp2(-b_kj)
        return Quantiser.of(*_round_table(low_kj, high_kj, top), reach_k)

    maps = np.arange(len(coeffs_kp))
    a_k = b_k = np.zeros(len(coeffs_kp))
    for values_kp, rounds in ((samples_kp, SAMPLE_ROUNDS), (coeffs_kp, FULL_ROUNDS)):
        for a_offsets, b_offsets in rounds:
            a_kj = np.maximum(a_k[:, None] + a_offsets.ravel(), 0.0)
            b_kj = np.maximum(b_k[:, None] + b_offsets.ravel(), 0.0)
            best_k = measure_distortion(values_kp, candidates(a_kj, b_kj), bits, device).argmin(axis=1)
            a_k, b_k = a_kj[maps, best_k], b_kj[maps, best_k]

    none_k = np.zeros(len(coeffs_kp))
    ends = candidates(np.stack([none_k, a_k], axis=1), np.stack([none_k, b_k], axis=1))
    low_kj = np.hstack([ends.low_k, _align_zero(ends.low_k, ends.step_k, top)])
    step_kj = np.hstack([ends.step_k, ends.step_k])
    best_k = measure_distortion(coeffs_kp, Quantiser.of(low_kj, step_kj, reach_k), bits, device).argmin(axis=1)
    return Quantiser.of(low_kj[maps, best_k], step_kj[maps, best_k], reach_k)


def measure_distortion(
    coeffs_kp: NDArray[np.float32], quantisers: Quantiser, bits: int, device: Device
) -> NDArray[np.float64]:
    """Return the sum of squared errors (k, j) of each map under each of its quantisers, in ``unscale_k**2``."""
    n_map, n_value = coeffs_kp.shape
    stretches = -(-n_value // STRETCH)
    sums_kj = np.empty(quantisers.low_k.shape, np.float64)
    for maps in slabs(n_map, 4 * n_value):
        lows, steps = quantisers.scaled_low_k[maps], quantisers.scaled_step_k[maps]
        errors = device.empty((*lows.shape, stretches), np.float32)
        arrays = [device.upload(a) for a in (coeffs_kp[maps], lows, steps, quantisers.scale_k[maps])]
        sizes = (lows.shape[1], stretches, n_value)
        launch(device, "measure_uniform_kji", bits, n_value, len(lows), errors, *arrays, *sizes)
        sums_kj[maps] = device.download(errors).sum(axis=2, dtype=np.float64)
    return sums_kj


def launch(device: Device, kernel: str, bits: int, count: int, n_map: int, *arguments: object) -> None:
    """Launch a kernel of ``uniform.cl``, or of ``uniform_codes.cl``, over `count` values of each of `n_map` maps."""
    packs = kernel.startswith(("pack", "unpack"))
    stretch, group, items = STRETCH, 1, -(-count // STRETCH)
    extra: dict[str, int] = {}
    if device.style == "gpu":
        group = _GROUP
        if packs:
            stretch, items = _PACKED, -(-count // _PACKED)
        else:
            extra = {"GROUP": _GROUP}
            items = items * _GROUP if kernel.startswith("measure") else count
    across = round_up(items, group)
    device.launch(
        "codec/uniform_codes.cl" if packs else "codec/uniform.cl",
        kernel,
        (across,) if packs else (across, n_map),
        *arguments,
        defines={"BITS": bits, "STRETCH": stretch, **extra},
        local_size=(group,) if packs else (group, 1),
    )


def _round_table(
    low_kj: NDArray[np.float64], high_kj: NDArray[np.float64], top: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return first levels and steps in float32, the steps such that the last level reaches `high_kj`.

    A step is 0 only for an empty interval, and never infinite.
    """
    width_kj = high_kj - low_kj
    step_kj = np.minimum(width_kj / top, float(_FLOAT32.max)).astype(np.float32)
    # Subnormal steps round by much, or to 0.
    short_kj = step_kj.astype(np.float64) * top < width_kj * (1 - 2.0**-20)
    return low_kj.astype(np.float32), np.where(short_kj, _next_float(step_kj), step_kj)


def _next_float(values: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.minimum(np.nextafter(values, np.float32(np.inf)), _FLOAT32.max)


def _align_zero(low_kj: NDArray[np.float32], step_kj: NDArray[np.float32], top: int) -> NDArray[np.float32]:
    """Return first levels moved by at most half a step such that 0 is a level, where 0 is inside."""
    low, step = low_kj.astype(np.float64), step_kj.astype(np.float64)
    steps_below = np.rint(-low / np.where(step > 0, step, 1.0))
    aligned = -steps_below * step
    inside = (step > 0) & (steps_below >= 0) & (steps_below <= top) & (np.abs(aligned) <= float(_FLOAT32.max))
    return np.where(inside, aligned, low).astype(np.float32)
