"""Reflection maps under turned light: one set of matrices for all their maps and all their coefficients."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.latlong import project_latlong, synthesize_latlong
from clrelight.harmonics.rotations import Rotations, make_rotations
from clrelight.shrm.prefilter import to_global
from clrelight.shrm.record import Shrm


def rotate_shrm(shrm: Shrm, matrix: NDArray[np.float64]) -> Shrm:
    """Return the reflection map under light turned by a rotation (3, 3): what came from d then comes from R d."""
    return next(turn_shrm(shrm, make_rotations(np.asarray(matrix, np.float64)[None], map_degree(shrm))))


def turn_shrm(shrm: Shrm, rotations: Rotations) -> Iterator[Shrm]:
    """Yield the global reflection map under light turned by each rotation, as prefiltering the turned light gives it.

    ``B'(d, v) = B(R^T d, R^T v)``. A global map of one coefficient of the view holds degrees up to F + P: the maps are
    projected once, and the same matrices turn their coefficients and those of the view.

    Parameters
    ----------
    shrm : Shrm
        Of more than ``2 (F + P)`` rows and columns; a local one is made global.
    rotations : Rotations
        Of degree F + P at least (`map_degree`), in float64.

    Raises
    ------
    InputError
        If the map has too few rows or columns, or the rotations too low a degree.
    """
    degree = map_degree(shrm)
    world = to_global(shrm)
    count, height, width, channel = world.maps_khwc.shape
    if min(height, width) <= 2 * degree:
        raise InputError(
            f"orders F = {shrm.degree}, P = {shrm.order} need more than {2 * degree} rows and columns to be turned, "
            f"the map has {height} and {width}"
        )
    if rotations.degree < degree:
        raise InputError(f"the map has degree {degree}, the rotations {rotations.degree}")
    maps_hwx = np.ascontiguousarray(world.maps_khwc.transpose(1, 2, 0, 3)).reshape(height, width, count * channel)
    coeffs_jx = project_latlong(maps_hwx, degree)
    for i in range(len(rotations)):
        one = rotations[i : i + 1]
        turned_jkc = one.apply(coeffs_jx)[0].reshape(-1, count, channel)
        viewed_kjc = one.apply(np.moveaxis(turned_jkc, 1, 0))[0]
        flat_jx = np.ascontiguousarray(np.moveaxis(viewed_kjc, 0, 1), np.float64).reshape(-1, count * channel)
        turned_hwkc = synthesize_latlong(flat_jx, height, width).reshape(height, width, count, channel)
        maps_khwc = np.ascontiguousarray(turned_hwkc.transpose(2, 0, 1, 3), shrm.maps_khwc.dtype)
        yield replace(world, maps_khwc=maps_khwc)


def map_degree(shrm: Shrm) -> int:
    """Return F + P, the largest degree that a global map of one coefficient holds."""
    return shrm.degree + shrm.order
