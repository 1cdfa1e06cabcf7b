"""Projection by Monte Carlo integration, for functions that can only be evaluated (a ray tracer's visibility)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.index import coefficient_count

_SAMPLES_AT_ONCE = 4096


def sample_sphere(count: int, *, stratified: bool = True, seed: int = 0) -> NDArray[np.float64]:
    """Return directions spread evenly over the sphere by area, at random.

    ``z = 1 - 2 u``, azimuth ``2 pi v`` (spherical-harmonic-lighting, eq. 4). Stratified, the square of u and v is cut
    into n × n cells with one random point in each.

    Parameters
    ----------
    count : int
        Number of directions; a square where stratified.
    stratified : bool
    seed : int
        At least 0.

    Returns
    -------
    ndarray, shape (count, 3), float64
        Unit vectors.
    """
    if count < 1 or seed < 0:
        raise InputError(f"sampling needs at least 1 direction and a seed of at least 0, got {count} and {seed}")
    # Only Generator.random is drawn: the one stream that NumPy versions have in common.
    u_i2 = np.random.default_rng(seed).random((count, 2))
    if stratified:
        side = math.isqrt(count)
        if side * side != count:
            raise InputError(f"stratified samples need a square count, got {count}: {side**2} or {(side + 1) ** 2}")
        u_i2 = (np.indices((side, side)).reshape(2, -1).T + u_i2) / side
    z_i, azimuth_i = 1.0 - 2.0 * u_i2[:, 0], 2.0 * np.pi * u_i2[:, 1]
    radius_i = np.sqrt(np.maximum(1.0 - z_i * z_i, 0.0))
    return np.stack([radius_i * np.cos(azimuth_i), radius_i * np.sin(azimuth_i), z_i], axis=1)


def project_function(
    function: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    degree: int,
    count: int,
    *,
    stratified: bool = True,
    seed: int = 0,
) -> NDArray[np.float64]:
    """Return coefficients of a function, ``4 pi / N sum f(s_j) y(s_j)`` over random directions.

    The error falls as 1 / sqrt(N) with independent directions, faster with stratified ones: nearly as 1 / N where the
    function is smooth, as N^(-3/4) where it jumps.

    Parameters
    ----------
    function : callable
        From unit vectors (n, 3) to values (n,) or (n, channel).
    degree : int
    count : int
        Number N of directions; a square where stratified.
    stratified : bool
    seed : int

    Returns
    -------
    ndarray, shape ((degree + 1)**2, channel), float64
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    directions_i3 = sample_sphere(count, stratified=stratified, seed=seed)
    total: NDArray[np.float64] | float = 0.0
    for start in range(0, count, _SAMPLES_AT_ONCE):
        part_i3 = directions_i3[start : start + _SAMPLES_AT_ONCE]
        values_ic = np.asarray(function(part_i3), dtype=np.float64).reshape(len(part_i3), -1)
        total = total + evaluate_basis(part_i3, degree).T @ values_ic
    return np.asarray(total).reshape(coefficient_count(degree), -1) * (4.0 * np.pi / count)
