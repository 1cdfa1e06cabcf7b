"""The light behind a picture of known normals, and the basis pictures behind photographs under known lights.

illumination-variation, section 0.4.3: a convex matte surface shows ``B = rho sum_lm A^_l L_lm Y_lm(n)`` with eq. 24 and
28, so that light follows by least squares. ``A^_l`` is 0 for odd l > 1: such light leaves no trace in any picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, counted
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients
from clrelight.variation.subspaces import half_cosine_factors

MOST_CONDITION = 100.0
"""Beyond, errors of a picture grow so often in the light; a ridge is then asked for, or a lower degree."""
_BLOCK = 1 << 16


@dataclass(frozen=True)
class InverseLight:
    """What a picture tells of its light.

    Attributes
    ----------
    coeffs_kc : ndarray, shape (n_coeff, channel), float64
        Light; 0 in degrees that leave no trace.
    condition_l : ndarray, shape (degree + 1,), float64
        Condition of the equations of all degrees up to each.
    unseen : tuple of int
        Degrees that leave no trace.
    residual : float
        Of the picture: root of the mean square of what the light does not explain, as a share of the picture's.
    """

    coeffs_kc: NDArray[np.float64]
    condition_l: NDArray[np.float64]
    unseen: tuple[int, ...]
    residual: float


def find_light(
    radiance_pc: NDArray[np.floating],
    normals_p3: NDArray[np.floating],
    albedo_pc: NDArray[np.floating] | None = None,
    *,
    degree: int | None = None,
    ridge: float = 0.0,
) -> InverseLight:
    """Return the light that a picture of a convex matte surface shows, by least squares.

    Parameters
    ----------
    radiance_pc : ndarray, shape (P, channel)
        Linear radiance.
    normals_p3 : ndarray, shape (P, 3)
        Unit vectors in the axes that the light is wanted in.
    albedo_pc : ndarray, shape (P, 1 or channel), optional
        Radiance under irradiance 1; default 1 everywhere.
    degree : int, optional
        Of the light; default: 2, or the largest below whose condition is at most `MOST_CONDITION`.
    ridge : float
        Added to the squared singular values, as a share of the largest: damps what the picture hardly tells.

    Raises
    ------
    InputError
        If an array does not fit, picture or albedo are black, or the equations' condition is above `MOST_CONDITION` and
        there is no ridge.
    """
    albedo = np.ones((len(radiance_pc), 1)) if albedo_pc is None else np.asarray(albedo_pc)
    if normals_p3.shape != (len(radiance_pc), 3) or len(albedo) != len(radiance_pc):
        raise InputError(f"{len(radiance_pc)} pixels need as many normals and albedos")
    if albedo.shape[1] not in (1, radiance_pc.shape[1]):
        raise InputError(f"albedo has {albedo.shape[1]} channels, the picture {radiance_pc.shape[1]}")
    if not ridge >= 0.0:
        raise InputError(f"ridge must be at least 0, got {ridge:g}")
    wanted = 2 if degree is None else degree
    if not np.any(albedo):
        raise InputError("the albedo is 0 everywhere: such a surface shows no light")
    moments, right_kc, energy = _moments(radiance_pc, normals_p3, albedo, wanted)
    if not energy > 0.0:
        raise InputError("the picture is black wherever there are normals: it tells no light")
    seen_k = half_cosine_factors(wanted) != 0.0
    condition_l = _conditions(moments[0], seen_k, wanted)
    if degree is None:
        fitting = np.flatnonzero(condition_l <= MOST_CONDITION)
        wanted = int(fitting[-1]) if len(fitting) else 0
    if condition_l[wanted] > MOST_CONDITION and ridge == 0.0:
        raise InputError(
            f"the normals that are seen do not tell light of degree {wanted}: the condition is "
            f"{condition_l[wanted]:.3g}, at most {MOST_CONDITION:g} without a ridge"
        )
    count = coefficient_count(wanted)
    kept_k = np.flatnonzero(seen_k[:count])
    coeffs_kc, left = np.zeros((count, radiance_pc.shape[1])), energy
    for channel in range(radiance_pc.shape[1]):
        energy_kk = moments[min(channel, len(moments) - 1)][np.ix_(kept_k, kept_k)]
        damped_kk = energy_kk + ridge * np.linalg.eigvalsh(energy_kk)[-1] * np.eye(len(kept_k))
        found_k = np.linalg.solve(damped_kk, right_kc[kept_k, channel])
        coeffs_kc[kept_k, channel] = found_k
        left += float(found_k @ energy_kk @ found_k - 2.0 * found_k @ right_kc[kept_k, channel])
    unseen = tuple(sorted({int(l) for l in degrees_of_coefficients(wanted)[~seen_k[:count]]}))
    residual = float(np.sqrt(max(left, 0.0) / energy))
    return InverseLight(coeffs_kc, condition_l[: wanted + 1], unseen, residual)


def _moments(
    radiance_pc: NDArray[np.floating], normals_p3: NDArray[np.floating], albedo: NDArray[np.floating], degree: int
) -> tuple[list[NDArray[np.float64]], NDArray[np.float64], float]:
    """Return products of the equations' columns for each albedo, with the picture, and the picture's own."""
    factor_k, channels = half_cosine_factors(degree), radiance_pc.shape[1]
    moments = [np.zeros((len(factor_k), len(factor_k))) for _ in range(albedo.shape[1])]
    right_kc, energy = np.zeros((len(factor_k), channels)), 0.0
    for start in range(0, len(radiance_pc), _BLOCK):
        part = slice(start, start + _BLOCK)
        basis_pk = evaluate_basis(np.asarray(normals_p3[part], np.float64), degree) * factor_k
        seen_pc = np.asarray(radiance_pc[part], np.float64)
        energy += float(np.sum(seen_pc**2))
        for channel in range(channels):
            which = min(channel, len(moments) - 1)
            column_pk = basis_pk * np.asarray(albedo[part, which], np.float64)[:, None]
            if channel == which:
                moments[which] += column_pk.T @ column_pk
            right_kc[:, channel] += column_pk.T @ seen_pc[:, channel]
    return moments, right_kc, energy


def _conditions(energy_kk: NDArray[np.float64], seen_k: NDArray[np.bool_], degree: int) -> NDArray[np.float64]:
    found = []
    for l in range(degree + 1):
        kept_k = np.flatnonzero(seen_k[: coefficient_count(l)])
        variance_r = np.linalg.eigvalsh(energy_kk[np.ix_(kept_k, kept_k)])
        floor = variance_r[-1] * len(kept_k) * np.finfo(np.float64).eps
        found.append(float(np.sqrt(variance_r[-1] / variance_r[0])) if variance_r[0] > floor else np.inf)
    return np.array(found)


@dataclass(frozen=True)
class BasisPictures:
    """The pictures under harmonics as light: ``image = sum_k Y_k(d) picture_k`` under a lamp at d.

    Attributes
    ----------
    pictures_kp : ndarray, shape (n_coeff, P), float64
    degree : int
    condition_l : ndarray, shape (asked degree + 1,), float64
        Condition of the lights' harmonics up to each degree, times the half-cosine's coefficients.
    """

    pictures_kp: NDArray[np.float64]
    degree: int
    condition_l: NDArray[np.float64]


def basis_pictures(
    samples_ip: NDArray[np.floating], directions_i3: NDArray[np.float64], degree: int | None = None
) -> BasisPictures:
    """Return the nine pictures (of degree 2), or fewer, that photographs under known lights are made of.

    Parameters
    ----------
    samples_ip : ndarray, shape (n_light, P)
        Linear radiance.
    directions_i3 : ndarray, shape (n_light, 3), float64
    degree : int, optional
        Default: 2, or the largest below whose condition is at most `MOST_CONDITION`, as of lights in a cap.

    Raises
    ------
    InputError
        If the lights' condition for a degree that is asked for is above `MOST_CONDITION`.
    """
    chosen, condition_l = told_degree(directions_i3, degree)
    kept_ik = evaluate_basis(directions_i3, chosen)
    return BasisPictures(np.linalg.lstsq(kept_ik, samples_ip, rcond=None)[0], chosen, condition_l)


def told_degree(directions_i3: NDArray[np.float64], degree: int | None = None) -> tuple[int, NDArray[np.float64]]:
    """Return the degree of the pictures that lights tell apart, and their condition up to each degree.

    Parameters and errors as of `basis_pictures`.
    """
    most = 2 if degree is None else degree
    basis_ik = evaluate_basis(directions_i3, most)
    # As matte surfaces see lamps: pictures of degree 2 count for less (eq. 28), as all of higher ones do.
    factor_k = half_cosine_factors(most)
    factor_k[coefficient_count(2) :] = half_cosine_factors(2)[-1]
    condition_l = np.array([_condition((basis_ik * factor_k)[:, : coefficient_count(l)]) for l in range(most + 1)])
    fitting = np.flatnonzero(condition_l <= MOST_CONDITION)
    chosen = int(fitting[-1])
    if degree is not None and condition_l[degree] > MOST_CONDITION:
        raise InputError(
            f"{counted(len(directions_i3), 'light does', 'lights do')} not tell {coefficient_count(degree)} pictures "
            "apart: the condition is "
            f"{condition_l[degree]:.3g}, at most {MOST_CONDITION:g}; degree {chosen} can be had"
        )
    return chosen, condition_l


def _condition(basis_ik: NDArray[np.float64]) -> float:
    if basis_ik.shape[0] < basis_ik.shape[1]:
        return float("inf")
    singular_r = np.linalg.svd(basis_ik, compute_uv=False)
    return float(singular_r[0] / singular_r[-1]) if singular_r[-1] > 1e-14 * singular_r[0] else float("inf")
