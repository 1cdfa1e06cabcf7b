"""Quadrature over the directions that a lobe of reflected light fills, and frames of directions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.quadrature import product_rule

_MATTE_RULE = 16
_STEPS = 40, 64
"""Nodes from the mirror ray to the horizon, and steps around it."""
_LEAST_SHARE = 0.05


def matte_rule() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return views (q, 3) over the hemisphere and their solid angles (q,): exact for what is smooth."""
    return product_rule(_MATTE_RULE)


def lobe_rule(light_s3: NDArray[np.float64], width: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return, for each light, views (s, q, 3) and solid angles (s, q) that integrate a lobe over the hemisphere.

    Steps around the mirror ray, in each of them Gauss's rule along the great circle to the horizon, nodes as dense as
    ``1 / (1 + (angle / width)**2)``: the edge at the horizon, where functions jump, lies between no nodes.
    """
    node, weight = np.polynomial.legendre.leggauss(_STEPS[0])
    azimuth_b = 2.0 * np.pi * (np.arange(_STEPS[1]) + 0.5) / _STEPS[1]
    mirrored_s33 = frames_of(light_s3 * [-1.0, -1.0, 1.0])
    circle_b2 = np.stack([np.cos(azimuth_b), np.sin(azimuth_b)], axis=1)
    away_sb3 = np.einsum("ba,sax->sbx", circle_b2, mirrored_s33[:, :2])
    edge_sb = 0.5 * np.pi + np.arctan2(away_sb3[..., 2], mirrored_s33[:, 2, 2][:, None])
    narrow_s = width * np.maximum(light_s3[:, 2], _LEAST_SHARE)  # a lobe near the horizon is narrow across
    span_sb = np.arctan(edge_sb / narrow_s[:, None])
    turn_sba = span_sb[..., None] * 0.5 * (node + 1.0)
    angle_sba = narrow_s[:, None, None] * np.tan(turn_sba)
    step_sba = 0.5 * weight * span_sb[..., None] * narrow_s[:, None, None] / np.cos(turn_sba) ** 2
    views_sba3 = np.cos(angle_sba)[..., None] * mirrored_s33[:, None, None, 2]
    views_sba3 += np.sin(angle_sba)[..., None] * away_sb3[:, :, None]
    solid_sba = step_sba * np.sin(angle_sba) * (2.0 * np.pi / _STEPS[1])
    return views_sba3.reshape(len(light_s3), -1, 3), solid_sba.reshape(len(light_s3), -1)


def frames_of(normals_v3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return right-handed frames (v, 3, 3) of unit vectors: rows x and y of any direction, z the vector itself."""
    x, y, z = normals_v3.T
    sign = np.where(z >= 0.0, 1.0, -1.0)  # Duff et al. 2017: no pole
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    second = np.stack([b, sign + y * y * a, -y], axis=1)
    return np.stack([first, second, normals_v3], axis=1)
