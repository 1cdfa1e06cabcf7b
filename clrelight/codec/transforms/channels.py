"""Rotations of a map's channels as angles: exactly orthogonal, whatever the angles are rounded to."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray


def count_angles(channel: int) -> int:
    """Return the number of angles of a rotation."""
    return channel * (channel - 1) // 2


def rotations_of(angle_ma: NDArray[np.unsignedinteger], channel: int) -> NDArray[np.float64]:
    """Return rotations (n, component, channel) of angles in turns of the whole range of their type.

    Columns are turned in planes of two channels, whose angles come as (0, 1), (0, 2), ..., (1, 2), ...; the last first.
    """
    turn = 2.0 * np.pi / (1 << 8 * angle_ma.dtype.itemsize)
    rotation_mdc = np.broadcast_to(np.eye(channel), (len(angle_ma), channel, channel)).copy()
    pairs = list(itertools.combinations(range(channel), 2))
    for number in range(len(pairs) - 1, -1, -1):
        angle_m = turn * angle_ma[:, number]
        _turn(rotation_mdc, *pairs[number], np.cos(angle_m), np.sin(angle_m))
    return rotation_mdc


def angles_of(rotation_mdc: NDArray[np.float64], dtype: np.dtype) -> NDArray[np.unsignedinteger]:
    """Return the angles (n, n_angle) next to rotations; rows that mirror are turned about."""
    left = rotation_mdc.copy()
    left[:, -1] *= np.sign(np.linalg.det(left))[:, None]
    channel, full = left.shape[1], 1 << 8 * dtype.itemsize
    found = []
    for i, j in itertools.combinations(range(channel), 2):
        found.append(np.arctan2(left[:, i, j], left[:, i, i]))  # makes row i zero in column j
        _turn(left, i, j, np.cos(found[-1]), -np.sin(found[-1]))
    turns = np.stack(found, axis=1) / (2.0 * np.pi)
    return (np.rint(turns * full).astype(np.int64) % full).astype(dtype)


def _turn(
    rotation_mdc: NDArray[np.float64], i: int, j: int, cosine: NDArray[np.float64], sine: NDArray[np.float64]
) -> None:
    """Turn columns i and j."""
    first, second = rotation_mdc[:, :, i].copy(), rotation_mdc[:, :, j].copy()
    rotation_mdc[:, :, i] = cosine[:, None] * first - sine[:, None] * second
    rotation_mdc[:, :, j] = sine[:, None] * first + cosine[:, None] * second
