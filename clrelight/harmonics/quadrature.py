"""Quadrature on the hemisphere and the sphere: Gauss's rule in z times equal steps of azimuth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def product_rule(degree: int, *, sphere: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return directions (n_node, 3) and solid angles (n_node,), exact for products of two functions of the degree.

    Over the hemisphere, or the sphere; azimuths of one height follow each other.
    """
    node, weight = np.polynomial.legendre.leggauss(degree + 1)
    height, share = (node, weight) if sphere else ((node + 1.0) / 2.0, weight / 2.0)
    n_azimuth = 2 * degree + 1
    z, azimuth = np.meshgrid(height, 2.0 * np.pi * np.arange(n_azimuth) / n_azimuth, indexing="ij")
    radius = np.sqrt(1.0 - z * z)
    directions_i3 = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
    return directions_i3, np.repeat(share * (2.0 * np.pi / n_azimuth), n_azimuth)
