"""Procedural colour of the ground: seeded, the same on every machine, band-limited enough for one pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TILE_SIZE = 0.5
GROUT_WIDTH = 0.016
NOISE_CELL = 0.28
NOISE_OCTAVES = 4

# Linear reflectances in RGB: two glazes that each tile mixes anew, and the grout between them.
CLAY = np.array([0.62, 0.36, 0.22])
SAND = np.array([0.74, 0.62, 0.44])
GROUT = np.array([0.30, 0.28, 0.26])


def hash_lattice(i: NDArray[np.int64], j: NDArray[np.int64], seed: int) -> NDArray[np.float64]:
    """Return a number in [0, 1) for each integer point (i, j), by integer mixing (murmur3's finaliser)."""
    word = np.uint32
    h = i.astype(word) * word(0x8DA6B343) + j.astype(word) * word(0xD8163841) + word(seed * 0x9E3779B1 & 0xFFFFFFFF)
    h ^= h >> word(16)
    h *= word(0x85EBCA6B)
    h ^= h >> word(13)
    h *= word(0xC2B2AE35)
    h ^= h >> word(16)
    return h.astype(np.float64) * 2.0**-32


def value_noise(xy_s2: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return smooth noise in [0, 1) with unit cells: lattice values blended by the quintic of Perlin 2002."""
    cell_s2 = np.floor(xy_s2)
    t_s2 = xy_s2 - cell_s2
    blend_s2 = t_s2 * t_s2 * t_s2 * (t_s2 * (t_s2 * 6.0 - 15.0) + 10.0)
    i, j = cell_s2.astype(np.int64).T
    u, v = blend_s2.T
    low = hash_lattice(i, j, seed) * (1 - u) + hash_lattice(i + 1, j, seed) * u
    high = hash_lattice(i, j + 1, seed) * (1 - u) + hash_lattice(i + 1, j + 1, seed) * u
    return low * (1 - v) + high * v


def fractal_noise(xy_s2: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return `NOISE_OCTAVES` octaves of `value_noise`, each of half the size and half the height, in [0, 1)."""
    octaves = range(NOISE_OCTAVES)
    total = sum(0.5**n * value_noise(xy_s2 * 2.0**n, seed * NOISE_OCTAVES + n) for n in octaves)
    return np.asarray(total / sum(0.5**n for n in octaves))


def tile_albedo(xy_s2: NDArray[np.float64], seed: int) -> NDArray[np.float64]:
    """Return the diffuse reflectance of a floor of mottled tiles with grout between them.

    Parameters
    ----------
    xy_s2 : ndarray, shape (n_sample, 2), float64
        Positions on the ground, in scene units.
    seed : int
        Seed of the tiles' colours and their mottling.

    Returns
    -------
    ndarray, shape (n_sample, 3), float64
        Linear RGB reflectance in [0, 1].
    """
    tile_s2 = np.floor(xy_s2 / TILE_SIZE)
    inside_s2 = xy_s2 - tile_s2 * TILE_SIZE
    to_edge_s = np.minimum(inside_s2, TILE_SIZE - inside_s2).min(axis=1)
    i, j = tile_s2.astype(np.int64).T
    # Each tile takes its own part of the noise, so that the mottling breaks at the joints.
    shift_s2 = 64.0 * np.stack([hash_lattice(i, j, seed + 1), hash_lattice(i, j, seed + 2)], axis=1)
    mottle_s = fractal_noise(xy_s2 / NOISE_CELL + shift_s2, seed)
    mix_s = 0.6 * hash_lattice(i, j, seed + 3) + 0.4 * mottle_s
    glaze_s3 = CLAY + mix_s[:, None] * (SAND - CLAY)
    glaze_s3 *= (0.7 + 0.5 * mottle_s)[:, None]
    grout_s = np.clip(1.5 - to_edge_s / GROUT_WIDTH, 0.0, 1.0)[:, None]
    return glaze_s3 * (1 - grout_s) + GROUT * grout_s
