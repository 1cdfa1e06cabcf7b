"""What photographs of a glossy ball show beside its highlights: what stays as the lamp moves, and matte shading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_TIMES, _LEAST, _MOST = 4.0, 12.0, 60.0
"""Spreads of a highlight, and degrees, at least and at most, off a lamp within which a pixel may show it."""
_FEW, _LEAST_FREE = 3, 30
"""Photographs without a highlight that tell what a pixel shows beside; pixels that tell a photograph's shading."""
_FITTED, _ROUNDS = 1500, 6
"""Pixels that a photograph's shading is fitted to at most, and rounds of weights."""
_PIECE = 1 << 18
"""Samples whose medians are taken at once."""


def _without_outliers(columns_pk: NDArray[np.float64], values_p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return least squares of values, those far above the fit counting little: Cauchy's weights, squared above."""
    weight_p = np.ones_like(values_p)
    for _ in range(_ROUNDS):
        found_k = np.linalg.lstsq(columns_pk * weight_p[:, None], values_p * weight_p, rcond=None)[0]
        off_p = values_p - columns_pk @ found_k
        off_p /= 2.0 * float(np.median(np.abs(off_p))) + 1e-12
        weight_p = 1.0 / np.sqrt(1.0 + off_p**2) / (1.0 + np.maximum(off_p, 0.0) ** 2) ** 0.5
    return np.asarray(found_k, np.float64)


def _medians(
    samples_ip: NDArray[np.floating], shading_ip: NDArray[np.floating] | None, free_ip: NDArray[np.bool_] | None
) -> NDArray[np.float32]:
    """Return of each pixel the median of what shading leaves, of free samples alone where there are a few, (P,)."""
    still_p = np.empty(samples_ip.shape[1], np.float32)
    step = max(1, _PIECE // len(samples_ip))
    for first in range(0, len(still_p), step):  # pieces, for a median takes three arrays of the samples' size
        piece = slice(first, first + step)
        left_ip = samples_ip[:, piece] if shading_ip is None else samples_ip[:, piece] - shading_ip[:, piece]
        found_p = np.median(left_ip, axis=0)
        if free_ip is not None:
            told_p = free_ip[:, piece].sum(axis=0) >= _FEW
            if told_p.any():
                found_p[told_p] = np.nanmedian(np.where(free_ip[:, piece], left_ip, np.nan)[:, told_p], axis=0)
        still_p[piece] = found_p
    return still_p


def _beside(
    samples_ihw: NDArray[np.floating],
    is_ball_hw: NDArray[np.bool_],
    shading_ip: NDArray[np.float32],
    still_p: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Return shading and what stays on a ball, and the median of all photographs beside it."""
    beside_ihw = np.empty(samples_ihw.shape, np.float32)
    beside_ihw[:, is_ball_hw] = shading_ip + still_p
    beside_ihw[:, ~is_ball_hw] = _medians(samples_ihw[:, ~is_ball_hw], None, None)
    return beside_ihw


@dataclass(frozen=True)
class Ball:
    """The part of the photographs around a ball, pixel by pixel.

    Attributes
    ----------
    normals_hw3 : ndarray, shape (height, width, 3), float64
        Unit normals; 0 beside the ball.
    mirrored_hw3 : ndarray, shape (height, width, 3), float64
        Unit vectors to the lamps that are mirrored to the eye.
    radius : float
        In the part's pixels.
    """

    normals_hw3: NDArray[np.float64]
    mirrored_hw3: NDArray[np.float64]
    radius: float

    def first_guess(self, samples_ihw: NDArray[np.floating]) -> NDArray[np.float32]:
        """Return what photographs show beside highlights whose places are not known yet, (n_light, height, width).

        Matte shading is within a hundredth a polynomial of degree 2 in the normal, whatever the light (Basri and Jacobs
        2003): that of each photograph by reweighted least squares, for which gloss is an outlier; then the median over
        the photographs of what it leaves.
        """
        is_ball_hw: NDArray[np.bool_] = np.any(self.normals_hw3 != 0.0, axis=2)
        samples_ip = samples_ihw[:, is_ball_hw]
        shading_ip = self._shading(samples_ip, is_ball_hw, np.ones(samples_ip.shape, bool))
        return _beside(samples_ihw, is_ball_hw, shading_ip, _medians(samples_ip, shading_ip, None))

    def _shading(
        self, samples_ip: NDArray[np.floating], is_ball_hw: NDArray[np.bool_], free_ip: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        x_p, y_p, z_p = self.normals_hw3[is_ball_hw].T
        products = x_p * y_p, x_p * z_p, y_p * z_p, x_p**2, y_p**2
        powers_p9 = np.stack([np.ones_like(x_p), x_p, y_p, z_p, *products], axis=1)
        shading_ip = np.empty(samples_ip.shape, np.float32)
        for sample_p, free_p, shading_p in zip(samples_ip, free_ip, shading_ip, strict=True):
            some = np.flatnonzero(free_p) if np.count_nonzero(free_p) > _LEAST_FREE else np.arange(len(free_p))
            some = some[:: max(1, len(some) // _FITTED)]
            shading_p[:] = powers_p9 @ _without_outliers(powers_p9[some], sample_p[some].astype(np.float64))
        return shading_ip

    def beside(
        self,
        samples_ihw: NDArray[np.floating],
        lights_i3: NDArray[np.float64],
        spread_i: NDArray[np.float64],
        most: float,
    ) -> NDArray[np.float32]:
        """Return what each photograph shows beside its highlight, (n_light, height, width).

        As `first_guess`, but without the pixels that may show the highlight: else shading takes up a part of a wide
        one, and where highlights crowd, the median does.

        Parameters
        ----------
        samples_ihw : ndarray, shape (n_light, height, width)
            Linear grey.
        lights_i3 : ndarray, shape (n_light, 3), float64
            Unit vectors to lamps, as far as they are known.
        spread_i : ndarray, shape (n_light,), float64
            Degrees by which a highlight's pixels' lights are off their mean.
        most : float
            Radiance from which on samples are clipped.
        """
        is_ball_hw: NDArray[np.bool_] = np.any(self.normals_hw3 != 0.0, axis=2)
        reach_i = np.radians(np.clip(_TIMES * spread_i, _LEAST, _MOST))
        samples_ip = samples_ihw[:, is_ball_hw]
        free_ip = lights_i3 @ self.mirrored_hw3[is_ball_hw].T < np.cos(reach_i)[:, None]
        free_ip &= samples_ip < most
        shading_ip = self._shading(samples_ip, is_ball_hw, free_ip)
        return _beside(samples_ihw, is_ball_hw, shading_ip, _medians(samples_ip, shading_ip, free_ip))
