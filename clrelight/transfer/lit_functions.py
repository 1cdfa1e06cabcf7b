"""Functions of directions at places of a surface, and what they make of light from one direction or from all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.harmonics.index import degree_of
from clrelight.lighting.relighting import check_channels


@dataclass(frozen=True)
class Functions:
    """Functions of directions, each at a place of its own: those of vertices, or of corners around points of a picture.

    Attributes
    ----------
    coeffs_knc : ndarray, shape (n_coeff, n, channel), float32 or float64
    points_n3 : ndarray, shape (n, 3), float64
        Where they are, in units of the positions.
    frames_n33 : ndarray, shape (n, 3, 3), float64, optional
        Axes of their directions as rows; None: those of the positions.
    hemispherical : bool
        They say something of directions with z >= 0 in their frames only; what comes from below is cut.
    """

    coeffs_knc: NDArray
    points_n3: NDArray[np.float64]
    frames_n33: NDArray[np.float64] | None = None
    hemispherical: bool = False

    @property
    def degree(self) -> int:
        """Largest degree."""
        return degree_of(len(self.coeffs_knc))

    @property
    def light_degree(self) -> int:
        """Largest degree of lights that has an effect; where the horizon mixes degrees, so far as it is followed."""
        return seen_degree(self.degree) if self.hemispherical else self.degree

    def local(self, vectors_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return vectors in the axes of the functions, (n, ..., 3); of positions' axes given as (n, ..., 3)."""
        if self.frames_n33 is None:
            return vectors_n3
        return np.einsum("nab,n...b->n...a", self.frames_n33, vectors_n3)

    def evaluate(self, directions_n3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return each function at its own unit direction, (n, channel) float64; 0 below its horizon."""
        local_n3 = self.local(directions_n3)
        basis_nk = evaluate_basis(local_n3, self.degree)
        values_nc = np.einsum("knc,nk->nc", self.coeffs_knc, basis_nk)
        return np.where(local_n3[:, 2:] < 0.0, 0.0, values_nc) if self.hemispherical else values_nc

    def receive(self, light_nkc: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return each function's integral with its own light, (n, channel), coefficients in its axes.

        A sum over coefficients (noise-resistant-fitting, eq. 5); where functions are hemispherical, with the
        autocorrelation of the basis over the hemisphere between them (eq. 4). A light of n = 1 is that of all.
        """
        degree = degree_of(light_nkc.shape[1])
        if self.hemispherical:
            light_nkc = hemisphere_autocorrelation(self.degree, degree) @ light_nkc
        shared = min(light_nkc.shape[1], len(self.coeffs_knc))
        coeffs_knc, light_nkc = self.coeffs_knc[:shared], light_nkc[:, :shared]
        channel, colours = coeffs_knc.shape[2], light_nkc.shape[2]
        if channel > 1 and colours > 1:
            check_channels(channel, colours)
        lit = [
            _sum_products(coeffs_knc[..., c % channel], light_nkc[..., c % colours])
            for c in range(max(channel, colours))
        ]
        return np.stack(lit, axis=1)


def seen_degree(degree: int) -> int:
    """Return the degree up to which hemispherical functions of a degree are followed: beyond, light adds under 1%."""
    return min(2 * degree + 12, MAX_DEGREE)


def _sum_products(coeffs_kn: NDArray, light_nk: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(light_nk) == 1:
        return light_nk[0] @ coeffs_kn
    return np.einsum("kn,nk->n", coeffs_kn, light_nk)
