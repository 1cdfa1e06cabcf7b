"""Coordinates in which one unit of error costs the same image error everywhere on the hemisphere."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH, gram_matrix
from clrelight.errors import PayloadError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_of, indices_of

MAX_METRIC_DEGREE = 40
"""Largest degree of whitened coding: its matrices grow with the fourth power."""

_KEPT = 1e-7
"""Components whose share of an image is below this are not kept: no float32 coefficient shows them."""


@dataclass(frozen=True)
class Metric:
    """A change of coordinates ``z = forward c`` with ``|z|^2 = integral over the hemisphere of (c' y)^2``.

    Attributes
    ----------
    forward_jk : ndarray, shape (n_component, n_coeff), float64
    inverse_kj : ndarray, shape (n_coeff, n_component), float64
        ``c = inverse z``, exact up to what the hemisphere cannot see.
    """

    forward_jk: NDArray[np.float64]
    inverse_kj: NDArray[np.float64]


def metric_degree(n_coeff: int) -> int:
    """Return the degree of so many coefficients; PayloadError beyond `MAX_METRIC_DEGREE`."""
    degree = degree_of(n_coeff)
    if degree > MAX_METRIC_DEGREE:
        raise PayloadError(f"klt and whitened hold degrees up to {MAX_METRIC_DEGREE}, got {degree}")
    return degree


@functools.lru_cache(maxsize=16)
def hemisphere_metric(n_coeff: int, axes: str = "smooth", basis: str = SH) -> Metric:
    """Return the metric of the whole hemisphere, ``G = integral y y' = V S^2 V'``, in coordinates orthonormal in it.

    ``axes="damped"`` rotates the whitened coordinates ``S V' c`` to the principal axes of ``(1 + l (l + 1))^-1`` in
    them, from smooth to rough: each eigenvalue of an order is at least a tenth smaller than the one before, so that
    every machine finds the same axes. ``"singular"`` is ``S V' c`` itself, and ``"smooth"`` the axes of the
    Laplace-Beltrami operator, which old payloads have: above degree 8 a decoder on another processor may find others.
    G couples only functions of one order m, so all steps run order by order. Nothing but the degree enters: a decoder
    needs no table.

    Components are listed like basis functions: the j-th of order m stands where ``l = |m| + j`` would.

    Another `basis` has the metric of its Gram matrix G = L L': z = L' c, which is c itself where it is orthonormal over
    the hemisphere, whatever the axes.
    """
    degree = metric_degree(n_coeff)
    if basis != SH:
        root_jk = np.asarray(np.linalg.cholesky(gram_matrix(basis, degree)).T, np.float64)
        return Metric(root_jk, np.asarray(np.linalg.inv(root_jk), np.float64))
    nodes, weights = np.polynomial.legendre.leggauss(degree + 2)
    z = (nodes + 1.0) / 2.0
    meridian = np.stack([np.sqrt(1.0 - z * z), np.zeros_like(z), z], axis=-1)
    values = evaluate_basis(meridian, degree) * np.sqrt(weights / 2.0 * np.pi)[:, None]
    forward, inverse = np.zeros((n_coeff, n_coeff)), np.zeros((n_coeff, n_coeff))
    kept = np.zeros(n_coeff, bool)
    for m in range(degree + 1):
        degrees = np.arange(m, degree + 1)
        scale = np.sqrt(2.0) if m == 0 else 1.0  # the integral of 1, or of cos^2, over the azimuth
        into, out_of = _axes(scale * values[:, indices_of(degrees, m)], degrees, axes)
        for order in {m, -m}:
            rows = degrees * (degrees + 1) + order
            forward[np.ix_(rows[: len(into)], rows)] = into
            inverse[np.ix_(rows, rows[: len(into)])] = out_of
            kept[rows[: len(into)]] = True
    return Metric(forward[kept], inverse[:, kept])


def _axes(block: NDArray[np.float64], degrees: NDArray[np.integer], axes: str) -> tuple[NDArray, NDArray]:
    """Return forward and inverse of the functions of one order, given at quadrature points with their weights."""
    _, singular, right = np.linalg.svd(block, full_matrices=False)
    held = singular > _KEPT
    inverse = right[held].T / singular[held]
    forward = singular[held, None] * right[held]
    if axes == "damped":
        _, turn = np.linalg.eigh(-(forward / (1.0 + degrees * (degrees + 1.0))) @ forward.T)
        forward, inverse = turn.T @ forward, inverse @ turn
    elif axes == "smooth":
        _, turn = np.linalg.eigh((inverse * (degrees * (degrees + 1.0))[:, None] ** 2).T @ inverse)
        forward, inverse = turn.T @ forward, inverse @ turn
    # The sign that LAPACK leaves open: the first entry that is nearly the largest is positive.
    size = np.abs(forward)
    first = np.argmax(size > 0.7 * size.max(axis=1, keepdims=True), axis=1)
    signs = np.sign(forward[np.arange(len(forward)), first])
    return forward * signs[:, None], inverse * signs
