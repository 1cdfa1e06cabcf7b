"""Directions at which visibility is looked at, and the solid angles that they stand for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_directions
from clrelight.errors import InputError
from clrelight.sampling import solid_angle_weights

DEFAULT_COUNT = 1024
LEAST_COUNT = 16
_WIDEST = 1.0
"""Steradian: directions of wider cells do not cover the sphere."""


@dataclass(frozen=True)
class Samples:
    """Directions and their weights.

    Attributes
    ----------
    directions_s3 : ndarray, shape (n_sample, 3), float64
        Unit vectors in the axes of the positions.
    weights_s : ndarray, shape (n_sample,), float64
        Solid angles in steradian.
    is_whole : bool
        Whether they cover the sphere: then a cosine lobe about any normal has the integral pi, nearly.
    """

    directions_s3: NDArray[np.float64]
    weights_s: NDArray[np.float64]
    is_whole: bool

    @property
    def count(self) -> int:
        """How many."""
        return len(self.directions_s3)


def make_samples(count: int = DEFAULT_COUNT, seed: int = 0) -> Samples:
    """Return stratified directions all over the sphere; InputError unless their number is a square of 4 or more."""
    if count < LEAST_COUNT:
        raise InputError(f"transfer needs at least {LEAST_COUNT} samples, got {count}")
    return Samples(stratify_sphere(count, seed), np.full(count, 4.0 * np.pi / count), True)


def stratify_sphere(count: int, seed: int = 0) -> NDArray[np.float64]:
    """Return random directions that are stratified three ways, (count, 3): by cells, by heights and by azimuths.

    As `clrelight.harmonics.montecarlo.sample_sphere` one in each of n × n cells of equal area, but also one in each of
    n² layers of height and n² sectors of azimuth (correlated multi-jittered samples, Kensler 2013): what is smooth has
    a seventh of the error.
    """
    if seed < 0:
        raise InputError(f"a seed is at least 0, got {seed}")
    side = math.isqrt(count)
    if side * side != count:
        raise InputError(f"stratified samples need a square count, got {count}: {side**2} or {(side + 1) ** 2}")
    # Only Generator.random is drawn: the one stream that NumPy versions have in common.
    rng = np.random.default_rng(seed)
    row_nn, column_nn = np.indices((side, side))
    layer_n, sector_n = (np.argsort(rng.random(side), kind="stable") for _ in range(2))
    jitter_2nn = rng.random((2, side, side))
    u_nn = (row_nn + (layer_n[column_nn] + jitter_2nn[0]) / side) / side
    azimuth_nn = 2.0 * np.pi * (column_nn + (sector_n[row_nn] + jitter_2nn[1]) / side) / side
    z_nn = 1.0 - 2.0 * u_nn
    radius_nn = np.sqrt(np.maximum(1.0 - z_nn * z_nn, 0.0))
    return np.stack([radius_nn * np.cos(azimuth_nn), radius_nn * np.sin(azimuth_nn), z_nn], axis=2).reshape(-1, 3)


def given_samples(directions_s3: NDArray[np.float64], weights_s: NDArray[np.float64] | None = None) -> Samples:
    """Return somebody's directions, such as those of a stack's lights.

    Parameters
    ----------
    directions_s3 : ndarray, shape (n_sample, 3), float64
        Unit vectors.
    weights_s : ndarray, shape (n_sample,), float64, optional
        Solid angles; default: those of the Voronoi cells, on the sphere where one is below the horizon, else on the
        hemisphere.
    """
    check_directions(directions_s3, None)
    if not len(directions_s3):
        raise InputError("transfer needs at least one direction, got none")
    is_below = bool((directions_s3[:, 2] < 0).any())
    if weights_s is None:
        weights_s = solid_angle_weights(directions_s3, sphere=is_below)
    return Samples(directions_s3, weights_s, is_below and bool(weights_s.max() < _WIDEST))


def as_samples(samples: Samples | NDArray[np.float64] | int | None, seed: int = 0) -> Samples:
    """Return samples of what a caller gave: a number of stratified ones, directions, or samples themselves."""
    if isinstance(samples, Samples):
        return samples
    if samples is None or isinstance(samples, int | np.integer):
        return make_samples(DEFAULT_COUNT if samples is None else int(samples), seed)
    return given_samples(np.asarray(samples, np.float64))
