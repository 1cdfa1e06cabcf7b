"""How much noise a codec adds to the images, before and after it has run (Lam, Leung and Wong, section IV-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.metric import hemisphere_metric
from clrelight.codec.slabs import slabs

_SAMPLED_COLUMNS = 16384
_SAMPLED_BLOCKS = 1024
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class Noise:
    """Errors ``e = basis n`` of the coefficients, with the mean of ``n n'`` over all columns (pixel and channel).

    Attributes
    ----------
    covariance_jj : ndarray, shape (n_component, n_component), float64
        Second moments in the coordinates that the codec quantises, in squared units of the coefficients.
    basis_kj : ndarray, shape (n_coeff, n_component), float64
        From those coordinates to coefficients.

    Notes
    -----
    The image's error under light s is ``e' y(s)``, its square's mean over the hemisphere ``e' G e / 2 pi`` with
    ``G = integral y y'``. Equation (10) of the paper is this with ``e_k = delta_k c_k``.
    """

    covariance_jj: NDArray[np.float64]
    basis_kj: NDArray[np.float64]

    @classmethod
    def of_coefficients(cls, covariance_kk: NDArray[np.float64]) -> Self:
        """Return noise that is given in coefficients themselves."""
        return cls(covariance_kk, np.eye(len(covariance_kk)))

    def image_error(self) -> float:
        """Return the mean over columns and hemisphere of the squared image error, ``tr(G C) / 2 pi``."""
        seen_jj = self._image_basis()
        return float(np.einsum("ij,jl,il->", seen_jj, self.covariance_jj, seen_jj, optimize=True)) / (2.0 * np.pi)

    def image_error_if_independent(self) -> float:
        """Return the same if no two coordinates' errors had anything to do with each other: equation (11).

        In coefficients the integral of ``y_k^2`` is 1/2 for every k, so that this is ``sum sigma_k^2 / 4 pi``, and with
        errors of one relative size, ``sigma_k^2 = sigma^2 c_k^2``, the paper's ``sigma^2 |c|^2 / 2`` (a mean over the
        hemisphere here, an integral there). In whitened coordinates the integral is 1: ``sum sigma_j^2 / 2 pi``.
        """
        integral_j = (self._image_basis() ** 2).sum(axis=0)
        return float(integral_j @ np.diag(self.covariance_jj)) / (2.0 * np.pi)

    def _image_basis(self) -> NDArray[np.float64]:
        return hemisphere_metric(len(self.basis_kj), "singular").forward_jk @ self.basis_kj


def measure_image_error(coeffs_khwc: NDArray[np.float32], decoded_khwc: NDArray[np.float32]) -> float:
    """Return the mean over columns and hemisphere of the squared image error that decoded coefficients make.

    In units of the peak squared, nothing clipped: 0 where nothing is lost. Computed in float64.
    """
    forward_jk = hemisphere_metric(len(coeffs_khwc), "singular").forward_jk
    original_kp, decoded_kp = (values.reshape(len(coeffs_khwc), -1) for values in (coeffs_khwc, decoded_khwc))
    total = 0.0
    for columns in slabs(original_kp.shape[1], 8 * len(original_kp)):
        seen_jp = forward_jk @ (decoded_kp[:, columns] - original_kp[:, columns].astype(np.float64))
        total += float(np.vdot(seen_jp, seen_jp))
    return total / original_kp.shape[1] / (2.0 * np.pi)


def second_moments(errors_kp: NDArray) -> NDArray[np.float64]:
    """Return the mean over columns of ``e e'``, float64."""
    errors = errors_kp.astype(np.float64)
    return errors @ errors.T / errors.shape[1]


def sample_columns(coeffs_khwc: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return up to 16384 columns (n_coeff, 1, column, 1) that are spread evenly and follow no row or channel."""
    coeffs_kp = coeffs_khwc.reshape(len(coeffs_khwc), -1)
    count = coeffs_kp.shape[1]
    chosen_kp = coeffs_kp if count <= _SAMPLED_COLUMNS else coeffs_kp[:, _spread(count, _SAMPLED_COLUMNS)]
    return np.ascontiguousarray(chosen_kp)[:, None, :, None]


def sample_blocks(coeffs_khwc: NDArray[np.float32], side: int) -> NDArray[np.float32]:
    """Return up to 1024 square blocks (n_coeff, side, side * block, channel), in a row; whole maps of fewer."""
    n_coeff, height, width, channel = coeffs_khwc.shape
    rows, columns = height // side, width // side
    if rows * columns <= _SAMPLED_BLOCKS:
        return coeffs_khwc
    y, x = np.divmod(_spread(rows * columns, _SAMPLED_BLOCKS), columns)
    whole = coeffs_khwc[:, : rows * side, : columns * side].reshape(n_coeff, rows, side, columns, side, channel)
    blocks_bkyxc = whole[:, y, :, x]  # indices that a slice parts come first
    return np.ascontiguousarray(blocks_bkyxc.transpose(1, 2, 0, 3, 4)).reshape(n_coeff, side, -1, channel)


def _spread(count: int, wanted: int) -> NDArray[np.int64]:
    # Multiples of the golden ratio spread evenly over any extent.
    return (np.arange(wanted) * _GOLDEN % 1.0 * count).astype(np.int64)
