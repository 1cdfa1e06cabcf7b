"""Linear samples of a stack as its normals need them: decoded, by lights' gains and near lights' distances."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack

_PROBE_ROWS, _PROBE_PIXELS = 16, 1 << 13


class SampleReader:
    """What turns a stack's code values into linear radiance in units of its peak.

    Parameters
    ----------
    stack : LightStack
    transfer : str, optional
        ``"linear"`` or ``"srgb"`` instead of the stack's own.
    gains_ic : ndarray, shape (n_light, 1 or channel), optional
        Intensity of each light that is still in the samples.
    """

    def __init__(
        self, stack: LightStack, transfer: str | None = None, gains_ic: NDArray[np.float64] | None = None
    ) -> None:
        dtype = np.dtype(stack.images_ihwc.dtype)
        self._peak, self._is_srgb = stack.peak, (transfer or stack.transfer) == "srgb"
        self._is_integer = dtype.kind == "u"
        codes = np.arange(np.iinfo(dtype).max + 1) if self._is_integer else np.zeros(1)
        self._table = self._decode(codes)
        self._most = min(np.iinfo(dtype).max, stack.peak) if self._is_integer else np.inf
        self._factor_ci1 = None if gains_ic is None else (1.0 / gains_ic.T[..., None]).astype(np.float32)

    def _decode(self, values: NDArray) -> NDArray[np.float32]:
        radiance = values / np.float64(self._peak)
        return (srgb_to_linear(radiance) if self._is_srgb else radiance).astype(np.float32)

    @property
    def is_bounded(self) -> bool:
        """Whether what is read is within 2^-24 and 2^24, or 0, without a look at it."""
        if not self._is_integer or self._factor_ci1 is not None:
            return False
        return bool(self._table[1] > 2.0**-23 and self._table[-1] < 2.0**23)

    @property
    def most(self) -> float:
        """Radiance from which on samples are at the end of an integer type's range; inf of floats."""
        if not self._is_integer:
            return np.inf
        # Half a code below the last, whatever way radiance is rounded.
        return float(self._decode(np.array([self._most - 0.5]))[0])

    def linear(self, codes_ipc: NDArray, out_cip: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        """Return radiance as it was recorded, (channel, n_light, P), in `out_cip` where it is given."""
        codes_cip = codes_ipc.transpose(2, 0, 1)
        made_cip = np.empty(codes_cip.shape, np.float32) if out_cip is None else out_cip
        if not self._is_integer:
            made_cip[...] = self._decode(codes_cip)
        elif self._is_srgb:
            np.take(self._table, codes_cip, out=made_cip, mode="clip")  # other modes make the result twice
        else:
            np.multiply(codes_cip, np.float32(1.0 / self._peak), out=made_cip, dtype=np.float32)
        return made_cip

    def even(
        self, samples_cip: NDArray[np.float32], falloff_ip: NDArray[np.float32] | None = None
    ) -> tuple[NDArray[np.float32], float]:
        """Return radiance under lights of one intensity, and from where on it is clipped.

        Parameters
        ----------
        samples_cip : ndarray, shape (channel, n_light, P), float32
            As of `linear`.
        falloff_ip : ndarray, shape (n_light, P), float32, optional
            Squared distances of near lights, to be multiplied by.
        """
        factor = self._factor(falloff_ip)
        if factor is None:
            return samples_cip, self.most
        even_cip = samples_cip * factor
        if self.most == np.inf:
            return even_cip, np.inf
        # Beyond all others, which one number then tells apart.
        most = self.most * float(factor.max(initial=0.0))
        return np.where(samples_cip >= self.most, np.float32(most), even_cip), most * (1.0 - 1e-6)

    def scaled(
        self, samples_cip: NDArray[np.float32], falloff_ip: NDArray[np.float32] | None = None
    ) -> NDArray[np.float32]:
        """Return radiance under lights of one intensity, clipped or not; parameters as of `even`."""
        factor = self._factor(falloff_ip)
        return samples_cip if factor is None else samples_cip * factor

    def _factor(self, falloff_ip: NDArray[np.float32] | None) -> NDArray[np.float32] | None:
        if falloff_ip is None:
            return self._factor_ci1
        return falloff_ip[None] if self._factor_ci1 is None else self._factor_ci1 * falloff_ip


@dataclass(frozen=True)
class ProbePixels:
    """Some pixels of a stack, from rows that lie evenly.

    Attributes
    ----------
    codes_ipc : ndarray, shape (n_light, P, channel)
    rows_p, columns_p : ndarray, shape (P,), int
    """

    codes_ipc: NDArray
    rows_p: NDArray[np.intp]
    columns_p: NDArray[np.intp]


def read_probe(stack: LightStack) -> ProbePixels:
    """Return pixels of the mask from some rows of a stack."""
    height, width, _ = stack.image_shape
    inside_h = np.arange(height) if stack.mask_hw is None else np.flatnonzero(stack.mask_hw.any(axis=1))
    if not len(inside_h):
        inside_h = np.arange(height)
    chosen = np.unique(np.linspace(0, len(inside_h) - 1, min(len(inside_h), _PROBE_ROWS)).round().astype(int))
    stride = -(-len(chosen) * width // _PROBE_PIXELS)
    codes, rows, columns = [], [], []
    for row in inside_h[chosen].tolist():
        columns_p = np.arange(width) if stack.mask_hw is None else np.flatnonzero(stack.mask_hw[row])
        columns_p = columns_p[::stride]
        codes.append(stack.read_rows(row, row + 1)[:, 0][:, columns_p])
        rows.append(np.full(len(columns_p), row))
        columns.append(columns_p)
    return ProbePixels(np.concatenate(codes, axis=1), np.concatenate(rows), np.concatenate(columns))


def in_range(samples_cip: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """Return samples by a power of two nearer to 1 where their squares would leave float32, and its exponent."""
    exponent = int(np.frexp(samples_cip.max(initial=0.0))[1])
    if abs(exponent) < 24:
        return samples_cip, 0
    return np.ldexp(samples_cip, -exponent), exponent
