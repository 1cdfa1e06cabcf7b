"""The convolution formula of general materials, and what it lets one undo (illumination-variation, 0.5).

``B(R, v) = integral L(R s) rho(s, v) ds`` over tangent frames ``R = Rz(beta) Ry(alpha) Rz(gamma)`` of a surface.
Coefficients are those of complex harmonics without Condon and Shortley's sign (`harmonics.wigner`), k = l (l + 1) + m.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import band, coefficient_count, degree_of
from clrelight.harmonics.wigner import turn_functions


def complex_basis(directions_i3: NDArray[np.float64], degree: int) -> NDArray[np.complex128]:
    """Return the complex harmonics ``Y_k`` at unit directions, (n, n_coeff)."""
    return evaluate_basis(directions_i3, degree) @ _to_complex(degree).conj().T


def complex_light(light_k: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Return the coefficients ``L_lm`` of complex harmonics, (n_coeff,), from those of the real ones."""
    return _to_complex(degree_of(len(light_k))) @ light_k


def _to_complex(degree: int) -> NDArray[np.complex128]:
    """Return the unitary matrix from coefficients of real harmonics to complex ones': ``(c_m - i c_-m) / sqrt 2``."""
    matrix = np.zeros((coefficient_count(degree),) * 2, np.complex128)
    half = np.sqrt(0.5)
    for l in range(degree + 1):
        matrix[l * (l + 1), l * (l + 1)] = 1.0
        for m in range(1, l + 1):
            plus, minus = l * (l + 1) + m, l * (l + 1) - m
            matrix[plus, plus], matrix[plus, minus] = half, -1j * half
            matrix[minus, plus], matrix[minus, minus] = half, 1j * half
    return matrix


def material_coefficients(rho_xx: NDArray[np.float64], degree: int, order: int) -> NDArray[np.complex128]:
    """Return ``rho_ln,pq`` of a reflectance in the frame of its tangent and normal, (n_coeff of light, of view).

    ``rho(s, v) = sum rho_ln,pq Y*_ln(s) Y_pq(v)`` (frequency-space-environment-maps, eq. 33).

    Parameters
    ----------
    rho_xx : ndarray, shape (n_coeff of light, n_coeff of view), float64
        Coefficients of products of real harmonics ``y_k(s) y_j(v)``.
    degree, order : int
        Of light and view.
    """
    if rho_xx.shape != (coefficient_count(degree), coefficient_count(order)):
        raise InputError(f"degrees {degree} and {order} do not have coefficients of shape {rho_xx.shape}")
    return _to_complex(degree).conj() @ rho_xx @ _to_complex(order).T


def reflected_coefficients(
    light_k: NDArray[np.complex128], rho_kj: NDArray[np.complex128]
) -> list[NDArray[np.complex128]]:
    """Return ``B_lmn,pq = sqrt(8 pi^2 / (2 l + 1)) L_lm rho_ln,pq``: for each l, (2 l + 1, 2 l + 1, n_view).

    By frequency-space-environment-maps, eq. 37.

    They belong to the orthonormal functions ``sqrt((2 l + 1) / (8 pi^2)) D^l_mn Y_pq`` of eq. 34.
    """
    degree = min(degree_of(len(light_k)), degree_of(len(rho_kj)))
    return [_frame_factor(l) * light_k[band(l), None, None] * rho_kj[band(l)] for l in range(degree + 1)]


def _frame_factor(l: int) -> float:
    return float(np.sqrt(8.0 * np.pi**2 / (2 * l + 1)))


def evaluate_reflected(
    reflected_lmnj: list[NDArray[np.complex128]], frames_f3: NDArray[np.float64], views_f3: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the radiance (n,) of frames (alpha, beta, gamma) towards views in them.

    By frequency-space-environment-maps, eq. 34 and 36.

    Parameters
    ----------
    reflected_lmnj : list
        As of `reflected_coefficients`.
    frames_f3 : ndarray, shape (n, 3)
        alpha, beta, gamma in radians.
    views_f3 : ndarray, shape (n, 3)
        Unit vectors in the frames.
    """
    alpha, beta, gamma = frames_f3.T
    view_fj = complex_basis(views_f3, degree_of(reflected_lmnj[0].shape[2]))
    total_f = np.zeros(len(frames_f3), np.complex128)
    for l, block_mnj in enumerate(reflected_lmnj):
        for m in range(-l, l + 1):
            for n in range(-l, l + 1):
                turn_f = turn_functions(alpha, l, m, n)[-1] * np.exp(1j * (m * beta + n * gamma))
                total_f += turn_f / _frame_factor(l) * (view_fj @ block_mnj[m + l, n + l])
    return total_f.real


@dataclass(frozen=True)
class Estimate:
    """Material coefficients found from a reflected light field under known light, and how well each degree can be.

    Attributes
    ----------
    rho_kj : ndarray, shape (n_coeff of light, n_coeff of view), complex128
    condition_l : ndarray, shape (degree + 1,)
        The largest ``sqrt(8 pi^2 / (2 l + 1)) ||L_l||`` over that of this degree: by how much more errors of B grow in
        it than in the best one; 1 throughout under a distant lamp.
    """

    rho_kj: NDArray[np.complex128]
    condition_l: NDArray[np.float64]


def estimate_material(reflected_lmnj: list[NDArray[np.complex128]], light_k: NDArray[np.complex128]) -> Estimate:
    """Return the material from reflected light and known light by least squares over m (0.5.2 and 0.5.3).

    ``rho_ln,pq = sum_m L*_lm B_lmn,pq / (sqrt(8 pi^2 / (2 l + 1)) sum_m |L_lm|^2)``. InputError where the light lacks a
    degree altogether.
    """
    parts, norms = [], []
    for l, block_mnj in enumerate(reflected_lmnj):
        own_m = light_k[band(l)]
        square = float(np.sum(np.abs(own_m) ** 2))
        if square == 0.0:
            raise InputError(f"the light has nothing of degree {l}: no material can be told from what it reflects")
        parts.append(np.einsum("m,mnj->nj", own_m.conj(), block_mnj) / (_frame_factor(l) * square))
        norms.append(_frame_factor(l) * np.sqrt(square))
    norm_l = np.array(norms)
    return Estimate(np.concatenate(parts), norm_l.max() / norm_l)


def factorise(
    reflected_lmnj: list[NDArray[np.complex128]],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return light (n_coeff,) and material (n_coeff, n_view) whose reflected light this is, up to one factor.

    Each degree is a product of a vector over m and one over n, p, q, found by a singular value decomposition, which
    leaves a complex factor a degree. Reciprocity, ``rho(s, v) = rho(v, s)`` and so ``rho_ln,00 = rho_00,l-n``, ties the
    degrees to degree 0, whose own factor is left. It needs a material whose view has the degrees of its light, and of
    which ``rho_ln,00`` is not 0 for some n of each l.
    """
    degree = len(reflected_lmnj) - 1
    if reflected_lmnj[0].shape[2] != coefficient_count(degree):
        raise InputError("light and material are told apart by reciprocity: the view must have the light's degrees")
    light_k = np.zeros(coefficient_count(degree), np.complex128)
    rho_kj = np.zeros((coefficient_count(degree),) * 2, np.complex128)
    for l, block_mnj in enumerate(reflected_lmnj):
        left_mr, singular_r, right_rx = np.linalg.svd(
            block_mnj.reshape(2 * l + 1, -1) / _frame_factor(l), full_matrices=False
        )
        own_nj = (singular_r[0] * right_rx[0]).reshape(2 * l + 1, -1)
        factor = 1.0 + 0.0j
        if l:
            # rho(s, v) has Y*_ln(s) Y_pq(v) and Y_ln(v) Y*_pq(s) alike: rho_ln,00 = rho_00,l-n.
            wanted_n, found_n = rho_kj[0, band(l)][::-1], own_nj[:, 0]
            square = float(np.sum(np.abs(found_n) ** 2))
            if square <= 1e-24 * singular_r[0] ** 2:
                raise InputError(f"degree {l} of the material has no part that reciprocity ties to degree 0")
            factor = complex(np.sum(found_n.conj() * wanted_n) / square)
            if factor == 0.0:
                raise InputError(f"degree {l} of the material has no part that reciprocity ties to degree 0")
        rho_kj[band(l)] = factor * own_nj
        light_k[band(l)] = left_mr[:, 0] / factor
    return light_k, rho_kj
