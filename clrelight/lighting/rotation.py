"""Rotation of lights in float64, and of coefficient maps in float32 on a device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.harmonics.index import band, coefficient_count, degree_of
from clrelight.harmonics.rotation import rotation_blocks
from clrelight.harmonics.rotations import Rotations, make_rotations
from clrelight.lighting.light import Light
from clrelight.matmul import multiply_columns

_TURN_BYTES = 1 << 24
"""Of matrices of rotations that are made at once."""


def rotate_light(light: Light, matrix: NDArray[np.float64]) -> Light:
    """Return the light as it is after the rotation: what came from d comes from ``matrix @ d``; float64.

    Its configuration keeps the rotation, since its axes speak of the light before.
    """
    blocks = rotation_blocks(matrix, light.degree)
    turned = [block @ light.coeffs_kc[band(l)] for l, block in enumerate(blocks)]
    return _turned(light, np.concatenate(turned), matrix)


def rotate_lights(light: Light, matrices_n33: NDArray[np.float64]) -> Iterator[Light]:
    """Yield the light after each of some rotations, as `rotate_light` returns it, to rounding.

    Matrices of many rotations are made at once, which takes less time, as many as some megabytes hold.

    Parameters
    ----------
    light : Light
    matrices_n33 : ndarray, shape (n, 3, 3), float64
    """
    degrees = np.arange(light.degree + 1)
    at_once = max(1, _TURN_BYTES // int(8 * np.sum((2 * degrees + 1) ** 2)))
    for first in range(0, len(matrices_n33), at_once):
        some_n33 = matrices_n33[first : first + at_once]
        turned_nkc = make_rotations(some_n33, light.degree).apply(light.coeffs_kc)
        for matrix, coeffs_kc in zip(some_n33, turned_nkc, strict=True):
            yield _turned(light, coeffs_kc, matrix)


def _turned(light: Light, coeffs_kc: NDArray[np.float64], matrix: NDArray[np.float64]) -> Light:
    total = matrix @ np.asarray(light.config.get("rotation", np.eye(3)), dtype=np.float64)
    return replace(light, coeffs_kc=coeffs_kc, config={**light.config, "rotation": total.tolist()})


def rotate_maps(
    coeffs_khwc: NDArray[np.float32], turn: NDArray[np.float64] | Rotations, *, device: Device | None = None
) -> NDArray[np.float32]:
    """Return coefficient maps rotated on the device: one product per degree, whose rounding is float32's.

    Parameters
    ----------
    coeffs_khwc : ndarray, shape (n_coeff, ...), float32
        Maps of a fit, or any batch of functions.
    turn : ndarray, shape (3, 3), float64, or Rotations
        One rotation; its matrices are made here, or were before (`harmonics.rotations.make_rotations`).
    device : Device, optional

    Returns
    -------
    ndarray of the same shape, float32
        Functions of directions: what they said of direction d they say of ``R d``.
    """
    opened = device or open_device()
    degree = degree_of(len(coeffs_khwc))
    blocks = _blocks_of(turn, degree)
    coeffs_kp = np.ascontiguousarray(coeffs_khwc, dtype=np.float32).reshape(coefficient_count(degree), -1)
    turned_kp = np.empty_like(coeffs_kp)
    turned_kp[0] = coeffs_kp[0]
    for l, block in enumerate(blocks[1 : degree + 1], start=1):
        own = band(l)
        turned_kp[own] = multiply_columns(opened, block, coeffs_kp[own])
    return turned_kp.reshape(coeffs_khwc.shape)


def _blocks_of(turn: NDArray[np.float64] | Rotations, degree: int) -> Sequence[NDArray[np.floating]]:
    """Return the blocks of one rotation up to a degree."""
    if not isinstance(turn, Rotations):
        return rotation_blocks(turn, degree)
    if len(turn) != 1 or turn.degree < degree:
        raise InputError(
            f"maps of degree {degree} take one rotation of that degree, got {len(turn)} of degree {turn.degree}"
        )
    return [block_nij[0] for block_nij in turn.blocks_lnij]
