"""Normals under general unknown lighting: photographs factored into light and the harmonics of a convex matte surface.

illumination-variation, section 0.6.2, and Basri, Jacobs and Kemelmacher (2007): ``M = L S``, with S of each pixel
``rho (1, n)`` (degree 1, 4D) or ``rho (1, n, products of two n)`` (degree 2, 9D). The singular value decomposition
tells S up to a matrix, of which the constraints leave a Lorentz transformation and a scale in both:

* 4D: ``s_0^2 = s_1^2 + s_2^2 + s_3^2``, a cone, which Lorentz transformations keep;
* 9D: S is the outer product of the null vector ``t = sqrt(rho) (1, n)`` with itself, and stays one as t is transformed:
  no light of degree 2 tells these conformal maps of the sphere of normals apart.

That slopes belong to a surface leaves of that a surface and its inverse: `clrelight.variation.integrable`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError

COMPONENTS = {1: 4, 2: 9}
"""Components of each degree."""
AMBIGUITY = "a Lorentz transformation and a scale"
_STEPS, _SETTLED = 200, 1e-13
_TINY = 1e-30


@dataclass(frozen=True)
class Factored:
    """What makes vectors on a cone of the components of photographs.

    Attributes
    ----------
    rows_4k : ndarray, shape (4, 4 or 9), float64
        By which components become ``rho (1, n)`` up to a Lorentz transformation; of nine, up to a conformal map.
    residual : float
        Root mean square of what the constraint of the degree does not explain, as a share of the components.
    """

    rows_4k: NDArray[np.float64]
    residual: float


def harmonics(normals_3p: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return 1, n and the products of two n that are harmonics of degree 2, (9, P), up to a factor each."""
    x_p, y_p, z_p = normals_3p
    products = (x_p * y_p, x_p * z_p, y_p * z_p, x_p**2 - y_p**2, 2.0 * z_p**2 - x_p**2 - y_p**2)
    return np.stack([np.ones_like(x_p), x_p, y_p, z_p, *products])


def factor_four(components_4p: NDArray[np.float64]) -> Factored:
    """Return the rows that make albedo and normals of four components of photographs.

    Parameters
    ----------
    components_4p : ndarray, shape (4, P), float64

    Raises
    ------
    InputError
        If the components are not those of a convex matte surface: no cone of the signature + - - - holds them.
    """
    length_p = np.maximum(np.linalg.norm(components_4p, axis=0), _TINY)
    unit_4p = components_4p / length_p
    first_e, second_e = np.triu_indices(4)
    double_e = np.where(first_e == second_e, 1.0, 2.0)
    monomials_ep = unit_4p[first_e] * unit_4p[second_e] * double_e[:, None]
    value_e, vector_ee = np.linalg.eigh(monomials_ep @ monomials_ep.T / monomials_ep.shape[1])
    cone_44 = np.zeros((4, 4))
    cone_44[first_e, second_e] = cone_44[second_e, first_e] = vector_ee[:, 0]
    own_r, axes_4r = np.linalg.eigh(cone_44)
    if np.count_nonzero(own_r > 0.0) > 2:
        own_r = -own_r
    order_r = np.argsort(-own_r)
    own_r, axes_4r = own_r[order_r], axes_4r[:, order_r]
    if not (own_r[0] > 0.0 > own_r[1]):
        raise InputError(
            "the photographs' four components do not lie on the cone of a matte surface's albedo and normals: "
            "try degree 2, or more lights"
        )
    rows_44 = np.sqrt(np.abs(own_r))[:, None] * axes_4r.T
    if np.median(rows_44[0] @ components_4p) < 0.0:
        rows_44 = -rows_44
    return Factored(rows_44, float(np.sqrt(max(value_e[0], 0.0))))


def null_vectors(scaled_4p: NDArray[np.floating], degree: int) -> NDArray[np.floating]:
    """Return vectors that Lorentz transformations act on: ``rho (1, n)``, of degree 2 ``sqrt(rho) (1, n)``."""
    if degree == 1:
        return scaled_4p
    root_p = np.sqrt(np.maximum(scaled_4p[0], 0.0))
    length_p = np.maximum(np.sqrt(np.sum(scaled_4p[1:] ** 2, axis=0)), _TINY)
    return np.concatenate([root_p[None], root_p * scaled_4p[1:] / length_p])


def factor_nine(components_9p: NDArray[np.float64], starts: tuple[NDArray[np.float64], ...]) -> Factored:
    """Return the rows that make albedo and normals of nine components of photographs.

    Gauss-Newton steps on all pixels' normals and albedos and the matrix that makes components of their harmonics;
    the pixels' own unknowns are eliminated.

    Parameters
    ----------
    components_9p : ndarray, shape (9, P), float64
        Of about one length each.
    starts : tuple of ndarray, shape (4, P)
        Albedo and scaled normals to start from; the end with the least residual counts.
    """
    ends = [_descend(components_9p, start_4p) for start_4p in starts]
    return min(ends, key=lambda end: end.residual)


def _descend(components_9p: NDArray[np.float64], start_4p: NDArray[np.float64]) -> Factored:
    normals_3p = start_4p[1:] / np.maximum(np.linalg.norm(start_4p[1:], axis=0), _TINY)
    albedo_p = np.maximum(start_4p[0], 1e-3 * np.abs(start_4p[0]).mean())
    energy = float(np.sum(components_9p**2))
    basis_9p = albedo_p * harmonics(normals_3p)
    mixing_99 = components_9p @ np.linalg.pinv(basis_9p)
    left_9p = components_9p - mixing_99 @ basis_9p
    error, damping = float(np.sum(left_9p**2)), 1e-3
    for _ in range(_STEPS):
        stepped = _step(left_9p, mixing_99, normals_3p, albedo_p, damping)
        basis_9p = stepped[2] * harmonics(stepped[1])
        next_9p = components_9p - stepped[0] @ basis_9p
        next_error = float(np.sum(next_9p**2))
        if not next_error < error:
            damping *= 8.0
            if damping > 1e8:
                break
            continue
        settled = error - next_error < _SETTLED * error or next_error < 1e-26 * energy
        mixing_99, normals_3p, albedo_p = stepped
        left_9p, error, damping = next_9p, next_error, max(damping * 0.2, 1e-12)
        if settled:
            break
    rows_99: NDArray[np.float64] = np.asarray(np.linalg.pinv(mixing_99), np.float64)
    return Factored(rows_99[:4], float(np.sqrt(error / energy)))


def _step(
    left_9p: NDArray[np.float64],
    mixing_99: NDArray[np.float64],
    normals_3p: NDArray[np.float64],
    albedo_p: NDArray[np.float64],
    damping: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the matrix, normals and albedos after a damped Gauss-Newton step."""
    across_3p = np.where(np.abs(normals_3p[2]) < 0.9, np.array([[0.0], [0.0], [1.0]]), np.array([[1.0], [0.0], [0.0]]))
    first_3p = np.cross(normals_3p, across_3p, axis=0)
    first_3p /= np.linalg.norm(first_3p, axis=0)
    second_3p = np.cross(normals_3p, first_3p, axis=0)
    basis_9p = harmonics(normals_3p)
    own_p9u = np.stack(
        [(mixing_99 @ each_9p).T for each_9p in (basis_9p * 1.0, *_slopes(normals_3p, first_3p, second_3p, albedo_p))],
        axis=2,
    )
    energy_puu = np.einsum("pku,pkv->puv", own_p9u, own_p9u)
    energy_puu += damping * np.einsum("puu->p", energy_puu)[:, None, None] * np.eye(3) + _TINY * np.eye(3)
    inverse_puu = np.linalg.inv(energy_puu)
    # What is left of each pixel's equations once its own three unknowns are taken out.
    taken_p9u = np.einsum("pku,puv->pkv", own_p9u, inverse_puu)
    kept_p99 = np.eye(9) - np.einsum("pku,plu->pkl", taken_p9u, own_p9u)
    scaled_9p = albedo_p * basis_9p
    hessian = np.einsum("ap,bp,pkl->kalb", scaled_9p, scaled_9p, kept_p99, optimize=True).reshape(81, 81)
    right = np.einsum("ap,pkl,lp->ka", scaled_9p, kept_p99, left_9p, optimize=True).reshape(81)
    hessian += np.eye(81) * (damping + 1e-10) * np.trace(hessian) / 81.0
    change_99 = np.linalg.solve(hessian, right).reshape(9, 9)
    rest_9p = left_9p - change_99 @ scaled_9p
    change_pu = np.einsum("pku,kp->pu", taken_p9u, rest_9p)
    normals_3p = normals_3p + change_pu[:, 1] * first_3p + change_pu[:, 2] * second_3p
    return mixing_99 + change_99, normals_3p / np.linalg.norm(normals_3p, axis=0), albedo_p + change_pu[:, 0]


def _slopes(
    normals_3p: NDArray[np.float64],
    first_3p: NDArray[np.float64],
    second_3p: NDArray[np.float64],
    albedo_p: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Return how albedo times harmonics change as normals turn along two directions, (9, P) each."""
    x_p, y_p, z_p = normals_3p
    found = []
    for u_p, v_p, w_p in (first_3p, second_3p):
        products = (
            u_p * y_p + x_p * v_p,
            u_p * z_p + x_p * w_p,
            v_p * z_p + y_p * w_p,
            2.0 * (x_p * u_p - y_p * v_p),
            4.0 * z_p * w_p - 2.0 * (x_p * u_p + y_p * v_p),
        )
        found.append(albedo_p * np.stack([np.zeros_like(x_p), u_p, v_p, w_p, *products]))
    return found
