"""The singular value decomposition of a basis at some directions, which every fit shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_SAME_ABSOLUTE, _SAME_RELATIVE = 1e-13, 1e-10
"""Singular values coincide where they differ by no more than rounding errors: this part of the largest, and of them."""
_NEARLY = 1.0 - 1e-6


@dataclass(frozen=True)
class Decomposition:
    """Thin singular value decomposition ``basis = left diag(singular) right.T``, float64.

    Attributes
    ----------
    left_ir : ndarray, shape (n_light, rank)
    singular_r : ndarray, shape (rank,)
        Descending, all positive.
    right_kr : ndarray, shape (n_coeff, rank)
    """

    left_ir: NDArray[np.float64]
    singular_r: NDArray[np.float64]
    right_kr: NDArray[np.float64]

    @property
    def condition(self) -> float:
        """Largest over smallest singular value."""
        return float(self.singular_r[0] / self.singular_r[-1])


def decompose(basis_ik: NDArray[np.float64]) -> Decomposition:
    """Return the thin SVD of the basis matrix, without the components that float64 cannot tell from zero.

    The paper decomposes ``A = Y^T Y`` (noise-resistant-fitting, eq. 12); its condition is the square of this one's,
    which float64 cannot hold from degree 10 on a hemisphere, so A is never formed. Signs, and the vectors of coinciding
    singular values, which symmetric sets of lights have, are made unique (`_turn_canonical`); those of singular values
    below some 1e-10 of the largest are rounding errors' as far as float64 goes.
    """
    left_ir, singular_r, right_rk = np.linalg.svd(basis_ik, full_matrices=False)
    rank = int(np.sum(singular_r > singular_r[0] * max(basis_ik.shape) * np.finfo(np.float64).eps))
    left_ir, singular_r, right_kr = left_ir[:, :rank], singular_r[:rank], right_rk[:rank].T
    # Files shall depend neither on LAPACK's version nor on the order of the lights.
    gap_r = singular_r[:-1] - singular_r[1:]
    apart_r = (gap_r > _SAME_ABSOLUTE * singular_r[0]) | (gap_r > _SAME_RELATIVE * singular_r[:-1])
    for members in np.split(np.arange(rank), 1 + np.flatnonzero(apart_r)):
        turned_kd = _turn_canonical(right_kr[:, members])
        left_ir[:, members] = left_ir[:, members] @ (right_kr[:, members].T @ turned_kd)
        right_kr[:, members] = turned_kd
        singular_r[members] = singular_r[members].mean()
    return Decomposition(left_ir, singular_r, right_kr)


def _turn_canonical(vectors_kd: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the one basis of the vectors' span that the span alone determines.

    Singular vectors of coinciding singular values are any basis of their span, a single one has any sign. Taken is the
    pivoted Cholesky factor of the projection ``V V'``: each vector is positive at a pivot, where its successors are 0.
    """
    if vectors_kd.shape[1] == 1:
        return vectors_kd * np.sign(vectors_kd[_first_largest(vectors_kd[:, 0] ** 2), 0])
    projection_kk = vectors_kd @ vectors_kd.T
    turned_kd = np.empty_like(vectors_kd)
    for d in range(vectors_kd.shape[1]):
        pivot = _first_largest(np.diagonal(projection_kk))
        turned_kd[:, d] = projection_kk[:, pivot] / np.sqrt(projection_kk[pivot, pivot])
        projection_kk -= np.outer(turned_kd[:, d], turned_kd[:, d])
    return turned_kd


def _first_largest(square_k: NDArray[np.float64]) -> int:
    # Of equal ones the first, so that rounding errors decide no tie.
    return int(np.argmax(square_k > _NEARLY * square_k.max()))
