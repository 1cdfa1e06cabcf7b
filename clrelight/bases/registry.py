"""The registry of bases: what one is, and how it is found by name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, unknown

SH = "sh"
"""What files and calls mean that name no basis."""

Rule = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Directions (n_node, 3), and the solid angle that each stands for, (n_node,)."""

_REGISTRY: dict[str, Basis] = {}


def _accept(degree: int) -> None:
    return


@dataclass(frozen=True)
class Basis:
    """A family of bases, one for each degree, of ``(degree + 1)**2`` functions.

    So many functions have all of them: coefficient k of one stands for as much as coefficient k of another, and every
    array, file and codec holds any. Those in polar form list function (l, m), -l <= m <= l, at ``k = l (l + 1) + m``,
    with ``cos(m azimuth)`` for m >= 0 and ``sin`` for m < 0.

    Attributes
    ----------
    id, title, summary : str
    evaluate : callable
        Takes unit directions (n, 3) and a degree, and returns (n, (degree + 1)**2) float64.
    rule : callable
        Takes a degree and another, and returns a quadrature over the hemisphere for products of a function of the
        degree with a spherical harmonic of the other, to rounding (``haar``: to 2e-4).
    nodes : callable
        Takes a degree and returns a quadrature with few nodes that is exact for products of two functions.
    roughness : callable
        Takes a degree and returns the penalty of each coefficient, (n_coeff,), that a smoothing spline takes.
    hemispherical : bool
        Whether functions are defined for z >= 0 only; below the horizon they are then 0.
    weight : str
        What they are orthonormal under: ``"sphere"``, ``"hemisphere"`` or ``"cosine"`` (the hemisphere, times z).
    to_sh : callable, optional
        Takes a degree and returns the matrix (n_coeff, n_coeff) that makes spherical-harmonic coefficients of
        these, where that is exact.
    check : callable
        Raises InputError for a degree that the basis does not have.
    """

    id: str
    title: str
    summary: str
    evaluate: Callable[[NDArray[np.float64], int], NDArray[np.float64]]
    rule: Callable[[int, int], Rule]
    nodes: Callable[[int], Rule]
    roughness: Callable[[int], NDArray[np.float64]]
    hemispherical: bool = True
    weight: str = "hemisphere"
    to_sh: Callable[[int], NDArray[np.float64]] | None = None
    check: Callable[[int], None] = _accept

    def count(self, degree: int) -> int:
        """Return the number of functions; InputError for a degree that the basis does not have."""
        self.check(degree)
        return (degree + 1) ** 2


def register(basis: Basis) -> Basis:
    """Enter a basis under its id and return it; ValueError if the id is taken."""
    if basis.id in _REGISTRY:
        raise ValueError(f"a basis {basis.id!r} is registered already: {_REGISTRY[basis.id]!r}")
    _REGISTRY[basis.id] = basis
    return basis


def basis_ids() -> list[str]:
    """Return the known ids, in the order of tables."""
    return list(_REGISTRY)


def basis_of(basis_id: object) -> Basis:
    """Return the basis of an id; InputError lists the known ones."""
    if not isinstance(basis_id, str) or basis_id not in _REGISTRY:
        raise unknown("basis", basis_id, basis_ids())
    return _REGISTRY[basis_id]


def require_sh(basis_id: str) -> None:
    """Raise InputError where coefficients that are used as those of spherical harmonics are of another basis."""
    if basis_id != SH:
        exact = basis_of(basis_id).to_sh is not None
        advice = "clrelight to-sh turns this fit into one" if exact else "fit with --basis sh"
        raise InputError(f"this takes coefficients of spherical harmonics, these are of basis {basis_id}: {advice}")
