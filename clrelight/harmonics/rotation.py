"""Rotations, and what they do to coefficients, degree by degree."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, evaluate_basis
from clrelight.harmonics.index import band
from clrelight.harmonics.quadrature import product_rule

FORMS = {"euler": 3, "quaternion": 4, "axis": 4}
"""Ways to write a rotation, and how many numbers each takes; see `rotation_matrix`."""

# Where x, y and z stand among the orders -1, 0, 1 of degree 1: y, z, x.
_ORDER_AXES = [1, 2, 0]
_ORTHOGONAL = 1e-6
NO_ROTATION = "a rotation is an orthogonal 3 by 3 matrix of determinant 1"
_NODES_AT_ONCE = 1024


def rotation_matrix(form: str, numbers: Sequence[float]) -> NDArray[np.float64]:
    """Return the matrix (3, 3) of a rotation; angles are in degrees, counterclockwise seen from the axis's tip.

    Parameters
    ----------
    form : str
        ``"euler"``: A, B, C stand for ``Rz(A) Ry(B) Rz(C)``, so the turn about z by C comes first. ``"quaternion"``:
        W, X, Y, Z of any length but 0. ``"axis"``: X, Y, Z and the angle about it.
    numbers : sequence of float

    Raises
    ------
    InputError
        If there is no such form, the count is not its own, or a number is not finite or a length 0.
    """
    from scipy.spatial.transform import Rotation

    if form not in FORMS:
        raise InputError(f"a rotation is one of {', '.join(FORMS)}, got {form!r}")
    if len(numbers) != FORMS[form] or not all(map(math.isfinite, numbers)):
        raise InputError(f"{form} takes {FORMS[form]} finite numbers, got {', '.join(f'{v:g}' for v in numbers)}")
    values = np.asarray(numbers, dtype=np.float64)
    if form == "euler":
        return np.asarray(Rotation.from_euler("ZYZ", values, degrees=True).as_matrix())
    largest = float(np.max(np.abs(values if form == "quaternion" else values[:3])))
    if largest == 0.0:
        raise InputError(f"the {form} of a rotation must not be all zeros")
    if form == "quaternion":
        return np.asarray(Rotation.from_quat(values[[1, 2, 3, 0]] / largest).as_matrix())
    axis = values[:3] / largest
    turn = math.radians(math.fmod(values[3], 360.0))
    return np.asarray(Rotation.from_rotvec(turn * axis / np.linalg.norm(axis)).as_matrix())


def rotation_blocks(matrix: NDArray[np.float64], degree: int) -> list[NDArray[np.float64]]:
    """Return one matrix per degree, (2 l + 1, 2 l + 1) for l = 0 .. degree, that rotates coefficients.

    With ``g(s) = f(R^T s)``, ``g_l = block_l f_l``; light from direction d then comes from R d. By the recursion of
    Ivanic and Ruedenberg (1996, with the corrections of 1998; spherical-harmonic-lighting, appendix 1): each degree
    from the one before and the rotation itself, no angle, no pole.

    Parameters
    ----------
    matrix : ndarray, shape (3, 3), float64
        Orthogonal (to 1e-6: the nearest rotation is taken), of determinant 1.
    degree : int
        0 to `harmonics.basis.MAX_DEGREE`.
    """
    turn = _checked(matrix, degree)
    first = turn[np.ix_(_ORDER_AXES, _ORDER_AXES)]
    blocks = [np.ones((1, 1)), first][: degree + 1]
    for l in range(2, degree + 1):
        block = _next_block(first, blocks[-1], l)
        # One Newton step back to the nearest orthogonal matrix: else errors grow from degree to degree, to 5e-8 at 100.
        blocks.append(1.5 * block - 0.5 * block @ (block.T @ block))
    return blocks


def _next_block(first: NDArray[np.float64], before: NDArray[np.float64], l: int) -> NDArray[np.float64]:
    """Return the block of degree l from that of degree l - 1 (tables 1 and 2 of the corrections).

    Rows are orders m, columns orders n. The paper's P(i, a, n) are ``products[i][a + l - 1]``.
    """
    products = {}
    for i in (-1, 0, 1):
        product = np.empty((2 * l - 1, 2 * l + 1))
        low, middle, high = first[i + 1]
        product[:, 1:-1] = middle * before
        product[:, -1] = high * before[:, -1] - low * before[:, 0]
        product[:, 0] = high * before[:, 0] + low * before[:, -1]
        products[i] = product

    # Orders s = 1 .. l and -1 .. -l at once: rows of P whose order is s - 1, 1 - s, and so on.
    s = np.arange(1, l + 1)[:, None]
    up, down = slice(l - 1, 2 * l - 1), slice(l - 1, None, -1)
    near = 0.5 * np.sqrt((l + s - 1) * (l + s))
    first_up, first_down, last_up, last_down = (products[i][rows].copy() for i in (1, -1) for rows in (up, down))
    first_down[0] = last_down[0] = 0.0
    first_up[0] *= math.sqrt(2.0)
    last_up[0] *= math.sqrt(2.0)
    positive, negative = near * (first_up - last_down), near * (first_down + last_up)
    same = np.sqrt(l * l - s[:-1] ** 2)
    positive[:-1] += same * products[0][l:]
    negative[:-1] += same * products[0][: l - 1][::-1]
    if l > 2:
        far = 0.5 * np.sqrt((l - s[:-2] - 1) * (l - s[:-2]))
        positive[:-2] -= far * (products[1][l + 1 :] + products[-1][: l - 2][::-1])
        negative[:-2] -= far * (products[1][: l - 2][::-1] - products[-1][l + 1 :])
    level = l * products[0][l - 1]
    level = level - math.sqrt(0.5 * l * (l - 1)) * (products[1][l] + products[-1][l - 2])
    n = np.arange(-l, l + 1)
    scale_n = np.where(np.abs(n) < l, (l + n) * (l - n), 2 * l * (2 * l - 1)) ** -0.5
    return np.concatenate([negative[::-1], level[None], positive]) * scale_n


def rotation_blocks_zyz(matrix: NDArray[np.float64], degree: int) -> list[NDArray[np.float64]]:
    """Return what `rotation_blocks` does, by turns about z alone and fixed quarter turns about x.

    ``R = Z(alpha) X(-90) Z(beta) X(90) Z(gamma)`` (spherical-harmonic-lighting, section Rotating Spherical Harmonics):
    a turn about y is one about z between two quarter turns, whose matrices are integrals found once per degree, which
    takes time of the fifth power of the degree.
    """
    from scipy.spatial.transform import Rotation

    turn = _checked(matrix, degree)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # at beta = 0 the split between alpha and gamma is free
        alpha, beta, gamma = Rotation.from_matrix(turn).as_euler("ZYZ")
    quarters = _quarter_turns(degree)
    return [
        _about_z(alpha, l) @ quarters[l].T @ _about_z(beta, l) @ quarters[l] @ _about_z(gamma, l)
        for l in range(degree + 1)
    ]


def _about_z(angle: float, l: int) -> NDArray[np.float64]:
    """Return the block of degree l of a turn about z: cosines on the diagonal, sines on the other."""
    m = np.arange(-l, l + 1)
    # The middle of the second diagonal, m = 0, is sin(0).
    return np.diag(np.cos(m * angle)) - np.diag(np.sin(m * angle))[:, ::-1]


@functools.lru_cache(maxsize=2)
def _quarter_turns(degree: int) -> list[NDArray[np.float64]]:
    """Return the blocks of the turn by 90 degrees about x, ``integral y_m(R s) y_n(s) ds``, by exact quadrature."""
    nodes_i3, weights_i = product_rule(degree, sphere=True)
    blocks = [np.zeros((2 * l + 1, 2 * l + 1)) for l in range(degree + 1)]
    for start in range(0, len(nodes_i3), _NODES_AT_ONCE):
        part = slice(start, start + _NODES_AT_ONCE)
        here_ik = evaluate_basis(nodes_i3[part], degree) * weights_i[part, None]
        turned_ik = evaluate_basis(nodes_i3[part][:, [0, 2, 1]] * [1.0, -1.0, 1.0], degree)
        for l, block in enumerate(blocks):
            own = band(l)
            block += turned_ik[:, own].T @ here_ik[:, own]
    return blocks


def _checked(matrix: NDArray[np.float64], degree: int) -> NDArray[np.float64]:
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be 0 to {MAX_DEGREE}, got {degree}")
    return nearest_rotation(matrix)


def nearest_rotation(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rotation (3, 3) nearest to a matrix that is one but for rounding; InputError if it is none."""
    turn = np.asarray(matrix, dtype=np.float64)
    if turn.shape != (3, 3):
        raise InputError(NO_ROTATION)
    return nearest_rotations(turn[None])[0]


def nearest_rotations(matrices_n33: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return what `nearest_rotation` does of many matrices (n, 3, 3)."""
    turn = np.asarray(matrices_n33, dtype=np.float64)
    if turn.ndim != 3 or turn.shape[1:] != (3, 3) or not np.isfinite(turn).all():
        raise InputError(NO_ROTATION)
    off = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    if (off > 2.0 * _ORTHOGONAL).any() or (np.linalg.det(turn) < 0).any():
        raise InputError(NO_ROTATION)
    left, _, right = np.linalg.svd(turn)
    return left @ right
