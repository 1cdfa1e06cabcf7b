"""Bounds on the values of fitted functions: at which directions, and what energy they take at least."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import as_float64
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.sampling import from_height, make_pattern

PLACES = ("grid", "ring", "lights")
MOST_DIRECTIONS = 4096
_GRID_PER_COEFFICIENT, _RING_PER_DEGREE, _FEWEST = 2, 4, 32
LARGEST_BOUND, _NONE = 1e20, 1e30
"""A bound is no larger; and what stands for none in kernels: its multiples are float32."""

Direction = tuple[float, float, float]


def as_places(at: Any) -> str | tuple[Direction, ...]:
    """Return a name of `PLACES`, or directions as unit vectors; InputError for anything else."""
    if isinstance(at, str):
        if at not in PLACES:
            raise InputError(f"bounds stand at {', '.join(PLACES)}, or at directions of your own, not at {at!r}")
        return at
    at_j3 = as_float64(at, "directions of bounds")
    if at_j3.ndim != 2 or at_j3.shape[1] != 3 or not 1 <= len(at_j3) <= MOST_DIRECTIONS:
        raise InputError(f"directions of bounds must be 1 to {MOST_DIRECTIONS} rows of x y z, got shape {at_j3.shape}")
    length_j = np.linalg.norm(at_j3, axis=1)
    wrong = np.flatnonzero(~(np.isfinite(length_j) & (length_j > 0.0)))
    if len(wrong):
        raise InputError(f"direction {wrong[0]} of bounds is {at_j3[wrong[0]].tolist()}, which points nowhere")
    return tuple((float(x), float(y), float(z)) for x, y, z in at_j3 / length_j[:, None])


def check_places(where: str) -> bool:
    """Return whether `where` is one of `PLACES`; InputError if it is no file either."""
    if where not in PLACES and not Path(where).is_file():
        raise InputError(f"bounds stand at {', '.join(PLACES)}, or at the lights of a file; {where} is neither")
    return where in PLACES


def bound_directions(
    at: str | Sequence[Direction], degree: int, lights_i3: NDArray[np.float64], *, sphere: bool
) -> NDArray[np.float64]:
    """Return where bounds stand, shape (n_direction, 3), float64.

    Parameters
    ----------
    at : str or sequence of directions
        ``"grid"``: evenly over the hemisphere, two directions for each coefficient that tells functions apart there,
        and at least 32. ``"ring"``: on the horizon, four for each order. ``"lights"``: those of the fit.
    degree : int
    lights_i3 : ndarray, shape (n_light, 3), float64
    sphere : bool
        Whether a grid covers the sphere, as where lights stand below the horizon.
    """
    if not isinstance(at, str):
        return np.asarray(at, np.float64)
    if at == "lights":
        return np.unique(lights_i3, axis=0)
    if at == "ring":
        count = max(_RING_PER_DEGREE * (2 * degree + 1), _FEWEST)
        return from_height(np.zeros(count), 2.0 * np.pi * np.arange(count) / count)
    count = max(_GRID_PER_COEFFICIENT * coefficient_count(degree) * (2 if sphere else 1), _FEWEST)
    return make_pattern("uniform", count, sphere=sphere)


def limits_of(value: float | None, count: int, *, upper: bool) -> NDArray[np.float64]:
    """Return a bound for each direction, shape (count,), float64; what is not bounded is bounded far off."""
    return np.full(count, (_NONE if upper else -_NONE) if value is None else value, np.float64)


def least_energy(
    values_jr: NDArray[np.float64], low_j: NDArray[np.float64], high_j: NDArray[np.float64]
) -> float | None:
    """Return the least ``|t|^2`` with ``low <= values t <= high``, or None where no t has that.

    Least distance programming as non-negative least squares (Lawson and Hanson, Solving Least Squares Problems, 1974,
    ch. 23): with ``G = [values; -values]``, ``h = [low; -high]`` and u the least of ``|[G'; h'] u - e|``, e being 1 in
    its last place alone and r what is left of it, ``t = -r_t / r_last``.
    """
    if np.all((low_j <= 0.0) & (high_j >= 0.0)):
        return 0.0
    from scipy.optimize import nnls  # slow to load, and no other fit needs it

    # Bounds that t = 0 meets far off need not be there, nor would they do the arithmetic good.
    stated_l, stated_h = low_j > -_NONE, high_j < _NONE
    rows_sr = np.vstack([values_jr[stated_l], -values_jr[stated_h]])
    system = np.vstack([rows_sr.T, np.concatenate([low_j[stated_l], -high_j[stated_h]])])
    target = np.zeros(len(system))
    target[-1] = 1.0
    used, _ = nnls(system, target, maxiter=100 * system.shape[1])
    left = system @ used - target
    if np.linalg.norm(left) < 1e-7:
        return None
    t_r = -left[:-1] / left[-1]
    return float(t_r @ t_r)
