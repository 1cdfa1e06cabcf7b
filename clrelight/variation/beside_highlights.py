"""What photographs of a glossy ball show beside its highlights: what stays as the lamp moves, and matte shading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_TIMES, _LEAST, _MOST = 4.0, 12.0, 60.0
"""Spreads of a highlight, and degrees, at least and at most, off a lamp within which a pixel may show it."""
_FEW = 3
"""Photographs without a highlight that tell what a pixel shows beside."""
_SMOOTH, _FLAT = 0.15, 0.02
"""Share of the radius over which the matte part is alike; variance of the cosine that pulls it to 0 as strongly."""


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

    def beside(
        self,
        samples_ihw: NDArray[np.floating],
        lights_i3: NDArray[np.float64],
        spread_i: NDArray[np.float64],
        most: float,
    ) -> NDArray[np.float64]:
        """Return what each photograph shows beside its highlight, (n_light, height, width).

        ``still + k max(n . l, 0)``: k by least squares over the photographs whose highlight is elsewhere, alike in
        neighbours; `still` is the median of what is left of these. The median of all photographs instead holds tails
        of highlights, and shading.

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
        is_ball_hw = self.normals_hw3.any(axis=2)
        cosine_ip = np.maximum(lights_i3 @ self.normals_hw3[is_ball_hw].T, 0.0)
        reach_i = np.radians(np.clip(_TIMES * spread_i, _LEAST, _MOST))
        samples_ip = samples_ihw[:, is_ball_hw].astype(np.float64)
        free_ip = lights_i3 @ self.mirrored_hw3[is_ball_hw].T < np.cos(reach_i)[:, None]
        free_ip &= samples_ip < most
        count_p = np.maximum(free_ip.sum(axis=0), 1)

        def off_mean(values_ip: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.asarray(np.where(free_ip, values_ip - np.sum(values_ip * free_ip, axis=0) / count_p, 0.0))

        turned_ip = off_mean(cosine_ip)
        shared_hw, varied_hw = np.zeros(is_ball_hw.shape), np.zeros(is_ball_hw.shape)
        shared_hw[is_ball_hw] = np.sum(turned_ip * off_mean(samples_ip), axis=0)
        varied_hw[is_ball_hw] = np.sum(turned_ip**2, axis=0) + _FLAT
        near = _SMOOTH * self.radius
        gain_hw = ndimage.gaussian_filter(shared_hw, near) / ndimage.gaussian_filter(varied_hw + 1e-9, near)
        shading_ip = np.maximum(gain_hw[is_ball_hw], 0.0) * cosine_ip
        left_ip = samples_ip - shading_ip
        still_p = np.median(left_ip, axis=0)
        told_p = free_ip.sum(axis=0) >= _FEW
        still_p[told_p] = np.nanmedian(np.where(free_ip, left_ip, np.nan)[:, told_p], axis=0)
        beside_ihw = np.broadcast_to(np.median(samples_ihw, axis=0), samples_ihw.shape).astype(np.float64)
        beside_ihw[:, is_ball_hw] = still_p + shading_ip
        return beside_ihw
