"""What may be seen along a ball's outline: Fourier series in the angle times blurred functions of the distance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.interpolate import CubicSpline

_REACH = 5.0
"""Standard deviations of the blur beyond which nothing comes in."""
_LARGE = 50.0
_SERIES = (1.0, 1 / 8, 9 / 128, 75 / 1024, 3675 / 32768, 59535 / 262144)
"""From which argument on ``exp(-z) I0(z) sqrt(2 pi z)`` is this series in 1 / z to 4e-11 (DLMF 10.40.1)."""


@lru_cache(maxsize=8)
def radial_functions(radius: float, sigma: float, inner: float, outer: float) -> CubicSpline:
    """Return what is seen of a ball and beyond it by the distance from its middle: blurred 1, z, z^2; 1, distance.

    A disc's ring at distance s, blurred by a Gaussian, is ``s / sigma^2 exp(-(s^2 + d^2) / 2 sigma^2) I0(s d /
    sigma^2)`` at distance d; rings are summed by Gauss and Legendre's rule, inside with sqrt(radius - s) as variable,
    in which z is smooth.
    """
    lowest, highest = max(0.0, inner - _REACH * sigma), outer + _REACH * sigma
    counts = [int(np.clip(5.0 * span / sigma, 48, 240)) for span in (radius - lowest, highest - radius)]
    node_s, weight_s = _gauss(counts[0])
    root_s = 0.5 * (node_s + 1.0) * np.sqrt(radius - lowest)
    inside_s = radius - root_s**2
    inside_weight_s = weight_s * np.sqrt(radius - lowest) * root_s
    z_s = np.sqrt(np.maximum(1.0 - (inside_s / radius) ** 2, 0.0))
    node_s, weight_s = _gauss(counts[1])
    outside_s = radius + 0.5 * (node_s + 1.0) * (highest - radius)
    grid_d = np.arange(max(inner, 0.0), outer + 0.3 * sigma, 0.3 * sigma)
    inside_ds = _rings(grid_d, inside_s, inside_weight_s, sigma)
    outside_ds = _rings(grid_d, outside_s, 0.5 * weight_s * (highest - radius), sigma)
    beyond_s = (outside_s - radius) / (outer - radius)
    inner_df = inside_ds @ np.stack([np.ones_like(z_s), z_s, z_s**2], axis=1)
    outer_df = outside_ds @ np.stack([np.ones_like(beyond_s), beyond_s], axis=1)
    return CubicSpline(grid_d, np.concatenate([inner_df, outer_df], axis=1))


@cache
def _gauss(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return nodes and weights, kept: a descent asks for the same again and again."""
    node_s, weight_s = np.polynomial.legendre.leggauss(count)
    return node_s, weight_s


def _rings(grid_d: NDArray, ring_s: NDArray, weight_s: NDArray, sigma: float) -> NDArray[np.float64]:
    away_ds = (ring_s - grid_d[:, None]) / sigma
    spread_ds = np.exp(-0.5 * away_ds**2)
    if grid_d[0] * ring_s.min() < _LARGE * sigma**2:
        bessel_ds = special.ive(0, ring_s * grid_d[:, None] / sigma**2)
        rings_ds: NDArray[np.float64] = bessel_ds * spread_ds * (ring_s * weight_s / sigma**2)
        return rings_ds
    inverse_ds = (sigma**2 / grid_d)[:, None] / ring_s
    series_ds = np.full_like(inverse_ds, _SERIES[-1])
    for term in _SERIES[-2::-1]:
        series_ds *= inverse_ds
        series_ds += term
    spread_ds *= series_ds
    spread_ds *= (weight_s * np.sqrt(ring_s)) / (np.sqrt(2.0 * np.pi * grid_d)[:, None] * sigma)
    return spread_ds


@dataclass(frozen=True)
class Design:
    """What may be seen of a ball and beyond, at pixels around its outline.

    Attributes
    ----------
    right_p, down_p : ndarray, float64
        Places from the ball's middle.
    radial : CubicSpline
        The functions f of the distance.
    waves_pk : ndarray, shape (P, 1 + 2 K), float64
        1, cosines and sines of 1 to K times the angle.
    radial_pf : ndarray, shape (P, f), float64
    picked : sequence of ndarray of int
        Which waves go with each function.
    """

    right_p: NDArray[np.float64]
    down_p: NDArray[np.float64]
    radial: CubicSpline
    waves_pk: NDArray[np.float64]
    radial_pf: NDArray[np.float64]
    picked: Sequence[NDArray[np.intp]]

    @classmethod
    def at(cls, right_p: NDArray, down_p: NDArray, radial: CubicSpline, orders: Sequence[int]) -> Design:
        """Return the design whose functions have Fourier series of these orders."""
        most, away_p = max(orders), np.hypot(right_p, down_p)
        turn_p = (right_p + 1j * down_p) / np.maximum(away_p, 1e-9)
        turns_pk = np.multiply.accumulate(np.repeat(turn_p[:, None], most, axis=1), axis=1)
        waves_pk = np.concatenate([np.ones((len(right_p), 1)), turns_pk.real, turns_pk.imag], axis=1)
        picked = [np.r_[: 1 + order, most + 1 : most + 1 + order] for order in orders]
        return cls(right_p, down_p, radial, waves_pk, radial(away_p), picked)

    @property
    def functions_pf(self) -> NDArray[np.float64]:
        """What may be seen, (P, number of functions)."""
        return np.concatenate([self.waves_pk[:, at] * self.radial_pf[:, [f]] for f, at in enumerate(self.picked)], 1)

    @property
    def share_p(self) -> NDArray[np.float64]:
        """Each pixel's share of the ball."""
        share_p: NDArray[np.float64] = self.radial_pf[:, 0]
        return share_p

    def moved(self, found_fm: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return how what is seen with factors changes as the middle goes right and down, each (P, m)."""
        away_p = np.maximum(np.hypot(self.right_p, self.down_p), 1e-9)
        along_pf = self.radial(away_p, 1)
        outward_pm = self._sum(along_pf, self._parts(found_fm))
        around_pm = self._sum(self.radial_pf, self._parts(found_fm, turned=True))
        right_p1, down_p1, away_p1 = self.right_p[:, None], self.down_p[:, None], away_p[:, None]
        around_pm /= away_p1
        return (
            (around_pm * down_p1 - outward_pm * right_p1) / away_p1,
            (-around_pm * right_p1 - outward_pm * down_p1) / away_p1,
        )

    def exchanged(self, found_fm: NDArray[np.float64], more: CubicSpline, less: CubicSpline) -> NDArray[np.float64]:
        """Return the difference of what is seen with factors by two other functions of the distance, (P, m)."""
        away_p = np.hypot(self.right_p, self.down_p)
        return self._sum(more(away_p) - less(away_p), self._parts(found_fm))

    def _parts(self, found_fm: NDArray[np.float64], *, turned: bool = False) -> NDArray[np.float64]:
        """Return each function's Fourier series, or its slope in the angle: (P, f, m)."""
        n_wave, held = self.waves_pk.shape[1], found_fm.shape[1]
        most = n_wave // 2
        factors_kfm = np.zeros((n_wave, len(self.picked), held))
        first = 0
        for f, at in enumerate(self.picked):
            factors_kfm[at, f] = found_fm[first : first + len(at)]
            first += len(at)
        if turned:
            order_k = np.arange(1, most + 1)[:, None, None]
            cosines_kfm, sines_kfm = factors_kfm[1 : most + 1], factors_kfm[most + 1 :]
            slopes = [np.zeros_like(factors_kfm[:1]), order_k * sines_kfm, -order_k * cosines_kfm]
            factors_kfm = np.concatenate(slopes)
        return (self.waves_pk @ factors_kfm.reshape(n_wave, -1)).reshape(-1, len(self.picked), held)

    @staticmethod
    def _sum(radial_pf: NDArray[np.float64], parts_pfm: NDArray[np.float64]) -> NDArray[np.float64]:
        summed_pm: NDArray[np.float64] = np.einsum("pf,pfm->pm", radial_pf, parts_pfm)
        return summed_pm
