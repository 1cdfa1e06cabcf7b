"""How much noise a codec adds to the images, before and after it has run (noise-resistant-fitting, section IV-B)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.streams import Source
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.vectors import golden_indices
from clrelight.memory import PIECE_BYTES
from clrelight.tiles import read_rows_into, row_tiles

_SAMPLED_COLUMNS = 16384
_SAMPLED_BLOCKS = 1024


@dataclass(frozen=True)
class Noise:
    """Errors ``e = basis n`` of the coefficients, with the mean of ``n n'`` over all columns (pixel and channel).

    Attributes
    ----------
    covariance_jj : ndarray, shape (n_component, n_component), float64
        Second moments in the coordinates that the codec quantises, in squared units of the coefficients.
    basis_kj : ndarray, shape (n_coeff, n_component), float64
        From those coordinates to coefficients.
    basis : str
        What these are of (`clrelight.bases`).

    Notes
    -----
    The image's error under light s is ``e' y(s)``, its square's mean over the hemisphere ``e' G e / 2 pi`` with
    ``G = integral y y'``. noise-resistant-fitting, eq. 10, is this with ``e_k = delta_k c_k``.
    """

    covariance_jj: NDArray[np.float64]
    basis_kj: NDArray[np.float64]
    basis: str = SH

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
        return hemisphere_metric(len(self.basis_kj), "singular", self.basis).forward_jk @ self.basis_kj


def measure_image_error(coeffs_khwc: Any, decoded_khwc: Any, basis: str = SH) -> float:
    """Return the mean over columns and hemisphere of the squared image error that decoded coefficients make.

    In units of the peak squared, nothing clipped: 0 where nothing is lost. Computed in float64. Both are arrays in
    memory, or what is read some rows at a time.
    """
    n_coeff, height, width, channel = coeffs_khwc.shape
    forward_jk = hemisphere_metric(n_coeff, "singular", basis).forward_jk
    step = max(1, PIECE_BYTES // (8 * n_coeff * width * channel))
    total = 0.0
    for first, end in row_tiles((0, height), step):
        shape = (n_coeff, end - first, width, channel)
        original_kp, decoded_kp = (
            read_rows_into(values, first, end, np.empty(shape, np.float32)).reshape(n_coeff, -1)
            for values in (coeffs_khwc, decoded_khwc)
        )
        seen_jp = forward_jk @ (decoded_kp - original_kp.astype(np.float64))
        total += float(np.vdot(seen_jp, seen_jp))
    return total / (height * width * channel) / (2.0 * np.pi)


def second_moments(errors_kp: NDArray) -> NDArray[np.float64]:
    """Return the mean over columns of ``e e'``, float64."""
    errors = errors_kp.astype(np.float64)
    return errors @ errors.T / errors.shape[1]


def sample_columns(source: Source) -> NDArray[np.float32]:
    """Return up to 16384 columns (n_coeff, 1, column, 1) that are spread evenly and follow no row or channel."""
    n_coeff, height, width, channel = source.shape
    count = height * width * channel
    chosen = np.arange(count) if count <= _SAMPLED_COLUMNS else golden_indices(count, _SAMPLED_COLUMNS)
    sample_kp = np.empty((n_coeff, len(chosen)), np.float32)
    with source.rows() as parts:
        for first, coeffs_khwc in parts:
            coeffs_kp = coeffs_khwc.reshape(n_coeff, -1)
            column = chosen - first * width * channel
            here = np.flatnonzero((column >= 0) & (column < coeffs_kp.shape[1]))
            sample_kp[:, here] = coeffs_kp[:, column[here]]
    return sample_kp[:, None, :, None]


def sample_blocks(source: Source, side: int) -> NDArray[np.float32]:
    """Return up to 1024 square blocks (n_coeff, side, side * block, channel), in a row; whole maps of fewer."""
    n_coeff, height, width, channel = source.shape
    rows, columns = height // side, width // side
    if rows * columns <= _SAMPLED_BLOCKS:
        return source.whole()
    y, x = np.divmod(golden_indices(rows * columns, _SAMPLED_BLOCKS), columns)
    sample_kybxc = np.empty((n_coeff, side, len(y), side, channel), np.float32)
    with source.rows(side) as parts:
        for first, coeffs_khwc in parts:
            deep = coeffs_khwc.shape[1] // side
            whole = coeffs_khwc[:, : deep * side, : columns * side].reshape(n_coeff, deep, side, columns, side, channel)
            here = np.flatnonzero((y >= first // side) & (y < first // side + deep))
            blocks_bkyxc = whole[:, y[here] - first // side, :, x[here]]  # indices that a slice parts come first
            sample_kybxc[:, :, here] = blocks_bkyxc.transpose(1, 2, 0, 3, 4)
    return sample_kybxc.reshape(n_coeff, side, -1, channel)
