"""Many rotations, whose matrices are made once and turn any number of functions."""

from __future__ import annotations

import functools
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.harmonics.index import band, coefficient_count, degree_of
from clrelight.harmonics.rotation import nearest_rotations, rotation_blocks
from clrelight.threads import on_one_thread

_CACHED_BYTES = 1 << 18
"""Of matrices that are made together: what is left of each step stays in the processor's cache."""
_FEW = 16
_QUARTER_ABOUT_X = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Rotations:
    """Matrices of some rotations for every degree, made once by `make_rotations`.

    Attributes
    ----------
    blocks_lnij : tuple of ndarray, shape (rotation, 2 l + 1, 2 l + 1)
        For l = 0 .. degree, all of one dtype, float64 or float32: the precision of products with them.
    """

    blocks_lnij: tuple[NDArray[np.floating], ...]

    @property
    def degree(self) -> int:
        """Largest degree of functions that can be turned."""
        return len(self.blocks_lnij) - 1

    @property
    def dtype(self) -> np.dtype:
        """Of matrices and products."""
        return self.blocks_lnij[0].dtype

    def __len__(self) -> int:
        return len(self.blocks_lnij[0])

    def __getitem__(self, part: slice) -> Rotations:
        """Return some of the rotations, with the same matrices."""
        return Rotations(tuple(block[part] for block in self.blocks_lnij))

    def apply(self, coeffs_kx: NDArray) -> NDArray:
        """Return all functions after each rotation, (rotation, n_coeff, ...).

        With ``g(s) = f(R^T s)``, ``g_l = block_l f_l``: what a function says of d, the turned one says of R d.

        Parameters
        ----------
        coeffs_kx : ndarray, shape (n_coeff, ...)
            Any axes of functions behind their coefficients: channels, texels, maps. Real or complex; taken in the
            precision of the matrices. Of this degree or a smaller one.
        """
        values_kx = self._values(coeffs_kx, 0)
        flat_kx = values_kx.reshape(len(values_kx), -1)
        made_nkx = np.empty((len(self), *flat_kx.shape), self.dtype)
        for l in range(degree_of(len(flat_kx)) + 1):
            own = band(l)
            if len(self) == 1:
                np.matmul(self.blocks_lnij[l][0], flat_kx[own], out=made_nkx[0, own])
            else:
                rows_ix = self.blocks_lnij[l].reshape(-1, 2 * l + 1) @ flat_kx[own]
                made_nkx[:, own] = rows_ix.reshape(len(self), 2 * l + 1, -1)
        return self._like(made_nkx.reshape(len(self), *values_kx.shape), coeffs_kx)

    def apply_each(self, coeffs_nkx: NDArray) -> NDArray:
        """Return functions, each set turned by a rotation of its own, (rotation, n_coeff, ...)."""
        if len(coeffs_nkx) != len(self):
            raise InputError(f"{len(self)} rotations need as many functions, got {len(coeffs_nkx)}")
        values_nkx = self._values(coeffs_nkx, 1)
        flat_nkx = values_nkx.reshape(*values_nkx.shape[:2], -1)
        made_nkx = np.empty(flat_nkx.shape, self.dtype)
        for l in range(degree_of(flat_nkx.shape[1]) + 1):
            np.matmul(self.blocks_lnij[l], flat_nkx[:, band(l)], out=made_nkx[:, band(l)])
        return self._like(made_nkx.reshape(values_nkx.shape), coeffs_nkx)

    def _values(self, coeffs: NDArray, axis: int) -> NDArray[np.floating]:
        """Return coefficients in our precision, complex ones as pairs; InputError of a wrong count."""
        if coeffs.ndim <= axis or degree_of(coeffs.shape[axis]) > self.degree:
            raise InputError(
                f"rotations of degree {self.degree} turn up to {coefficient_count(self.degree)} coefficients, "
                f"got an array of shape {coeffs.shape}"
            )
        if np.iscomplexobj(coeffs):
            whole = np.ascontiguousarray(coeffs, np.result_type(self.dtype, np.complex64))
            return whole.view(self.dtype)
        return np.ascontiguousarray(coeffs, self.dtype)

    def _like(self, made: NDArray, given: NDArray) -> NDArray:
        return made.view(np.result_type(self.dtype, np.complex64)) if np.iscomplexobj(given) else made


def make_rotations(matrices_n33: NDArray[np.float64], degree: int, dtype: DTypeLike = np.float64) -> Rotations:
    """Return the matrices that turn coefficients, for every degree up to one.

    ``R = Z(alpha) X(-90) Z(beta) X(90) Z(gamma)`` (spherical-harmonic-lighting, section Rotating Spherical Harmonics):
    those about x are two for all rotations (`rotation.rotation_blocks`), those about z mix orders m and -m alone.

    Parameters
    ----------
    matrices_n33 : ndarray, shape (n, 3, 3), float64
        Orthogonal (to 1e-6: the nearest rotations are taken), of determinant 1.
    degree : int
        0 to `harmonics.basis.MAX_DEGREE`.
    dtype : float64 or float32
        The matrices are made in float64, and rounded once.

    Raises
    ------
    InputError
        Of another degree, dtype or matrix.
    """
    matrices = np.asarray(matrices_n33, np.float64)
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    if np.dtype(dtype) not in (np.float32, np.float64):
        raise InputError(f"rotations are float32 or float64, got {dtype!r}")
    if matrices.ndim != 3 or len(matrices) == 0:
        raise InputError(f"rotations are matrices of shape (n, 3, 3), got {matrices.shape}")
    turn = nearest_rotations(matrices)
    alpha_n1, beta_n1, gamma_n1 = (angle_n[:, None] for angle_n in zyz_angles(turn))
    m = np.arange(-degree, degree + 1)
    waves = [np.stack([np.cos(m * angle_n), np.sin(m * angle_n)]) for angle_n in (alpha_n1, beta_n1, gamma_n1)]
    blocks = []
    with on_one_thread() if len(turn) > _FEW else nullcontext():  # for many small products BLAS's threads would wait
        for l, quarter_ij in enumerate(quarter_turns(degree)):
            own = [wave[:, :, degree - l : degree + l + 1] for wave in waves]
            block_nij = np.empty((len(turn), 2 * l + 1, 2 * l + 1), dtype)
            step = max(1, _CACHED_BYTES // block_nij[:1].nbytes)
            for first in range(0, len(turn), step):
                part = slice(first, first + step)
                block_nij[part] = _turn_blocks(quarter_ij, *(wave[:, part] for wave in own))
            blocks.append(block_nij)
    return Rotations(tuple(blocks))


def _turn_blocks(
    quarter_ij: NDArray[np.float64],
    alpha_jni: NDArray[np.float64],
    beta_jni: NDArray[np.float64],
    gamma_jni: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the blocks of one degree, from cosines and sines of m times the angles.

    Turns about z have cosines on the diagonal and sines on the other one: they mix rows, or columns, of m and -m.
    """
    turned_nij = beta_jni[0, :, :, None] * quarter_ij - beta_jni[1, :, :, None] * quarter_ij[::-1]
    about_y_nij = quarter_ij.T @ turned_nij
    turned_nij = alpha_jni[0, :, :, None] * about_y_nij - alpha_jni[1, :, :, None] * about_y_nij[:, ::-1]
    return gamma_jni[0, :, None] * turned_nij + gamma_jni[1, :, None] * turned_nij[:, :, ::-1]


@functools.lru_cache(maxsize=8)
def turns_about_y(angles: tuple[float, ...], degree: int, dtype: str = "float64") -> Rotations:
    """Return the turns about y by some angles, in radians."""
    cosine, sine = np.cos(angles), np.sin(angles)
    matrices_n33 = np.zeros((len(angles), 3, 3))
    matrices_n33[:, 0, 0] = matrices_n33[:, 2, 2] = cosine
    matrices_n33[:, 0, 2], matrices_n33[:, 2, 0] = sine, -sine
    matrices_n33[:, 1, 1] = 1.0
    return make_rotations(matrices_n33, degree, dtype)


def zyz_angles(
    turn_n33: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return alpha, beta and gamma of ``R = Rz(alpha) Ry(beta) Rz(gamma)``, in radians.

    Whatever alpha is where beta is 0 or 180 degrees, gamma makes good for it.
    """
    alpha_n = np.arctan2(turn_n33[:, 1, 2], turn_n33[:, 0, 2])
    cosine_n, sine_n = np.cos(alpha_n), np.sin(alpha_n)
    beta_n = np.arctan2(cosine_n * turn_n33[:, 0, 2] + sine_n * turn_n33[:, 1, 2], turn_n33[:, 2, 2])
    gamma_n = np.arctan2(
        cosine_n * turn_n33[:, 1, 0] - sine_n * turn_n33[:, 0, 0],
        cosine_n * turn_n33[:, 1, 1] - sine_n * turn_n33[:, 0, 1],
    )
    return alpha_n, beta_n, gamma_n


@functools.lru_cache(maxsize=4)
def quarter_turns(degree: int) -> list[NDArray[np.float64]]:
    """Return the blocks of the turn by 90 degrees about x."""
    return rotation_blocks(_QUARTER_ABOUT_X, degree)
