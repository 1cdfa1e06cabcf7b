"""Where coefficients stand: ``k = l (l + 1) + m`` for degree l and order m, -l <= m <= l."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def coefficient_count(degree: int) -> int:
    """Return the number of coefficients, ``(degree + 1)**2``, of all degrees up to ``degree``."""
    return (degree + 1) ** 2


def coefficient_index(l: int, m: int) -> int:
    """Return ``k = l (l + 1) + m``."""
    if abs(m) > l:
        raise ValueError(f"order m must satisfy |m| <= l, got l={l}, m={m}")
    return l * (l + 1) + m


def degree_and_order(k: int) -> tuple[int, int]:
    """Return l and m of ``k = l (l + 1) + m``."""
    l = math.isqrt(k)
    return l, k - l * (l + 1)


def degree_of(n_coeff: int) -> int:
    """Return the degree whose coefficient count is ``n_coeff``; ValueError if there is none."""
    root = math.isqrt(max(n_coeff, 0))
    if n_coeff < 1 or root * root != n_coeff:
        raise ValueError(f"a coefficient count is a square (1, 4, 9, ...), got {n_coeff}")
    return root - 1


def indices_of(l: NDArray[np.integer], m: int | NDArray[np.integer]) -> NDArray[np.intp]:
    """Return ``k = l (l + 1) + m`` of arrays."""
    return np.asarray(l * (l + 1) + m, np.intp)


def band(l: int) -> slice:
    """Return the 2 l + 1 coefficients of a degree."""
    return slice(l * l, (l + 1) * (l + 1))


def cosine_indices(degree: int) -> NDArray[np.intp]:
    """Return the k of orders m >= 0, by degree and order: all there is of what is the same at y and -y."""
    return np.array([coefficient_index(l, m) for l in range(degree + 1) for m in range(l + 1)])


def degrees_of_coefficients(degree: int) -> NDArray[np.intp]:
    """Return the degree l of every coefficient k."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
