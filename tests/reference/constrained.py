"""Several constraints at once, column by column, in float64: the interior-point solver Clarabel, and Newton from there.

Clarabel alone finds coefficients to some 1e-4 of their norm: what lights hardly see changes the objective by less than
its tolerance. It tells, though, which constraints bind; with those, Newton's iteration meets the optimality conditions.
"""

import itertools

import clarabel
import numpy as np
from scipy import sparse

_NEWTON_STEPS = 30
_CERTAIN = 1e-12
_SHARES = (1.0, 1e-2, 1e2, 1e-3, 1e3)
"""Where a constraint hardly binds, its multiplier and its slack are alike: which it is shows afterwards."""


def solve_column(basis_ik, sample_i, weight_i, energy, rows_jk, limit_j):
    """Return c with the least ``sum w (Y c - beta)^2 / mean w``, ``|c|^2 <= energy`` and ``rows c <= limit``.

    None where there is none. The second value is by how much the optimality conditions are missed, in units of the
    samples: the gradient, the constraints, and the signs of their multipliers.
    """
    root_i = np.sqrt(weight_i / np.mean(weight_i))[:, None]
    unit = np.sqrt(energy)  # the solver's tolerances are absolute
    system, target, limit_j = root_i * basis_ik, root_i[:, 0] * sample_i / unit, limit_j / unit
    solved = _by_interior_points(system, target, rows_jk, limit_j)
    if "Infeasible" in str(solved.status):
        return None
    found = None
    for solver, share in itertools.product((_solve, _least_squares), _SHARES):
        c, missed = _polish(system, target, rows_jk, limit_j, solved, share, solver)
        if found is None or missed < found[1]:
            found = c, missed
        if missed < _CERTAIN:
            break
    return unit * found[0], found[1]


def _solve(matrix, right):
    try:
        return np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        return np.full(len(right), np.inf)


def _least_squares(matrix, right):
    """Return the least solution where constraints depend on each other."""
    return np.linalg.lstsq(matrix, right, rcond=1e-15)[0] if np.isfinite(matrix).all() else np.full(len(right), np.inf)


def _polish(system, target, rows_jk, limit_j, solved, share, solver):
    """Return c and by how much it misses; constraints bind whose multiplier is above their slack times `share`."""
    count = len(limit_j)
    slack, dual = np.array(solved.s), np.array(solved.z)
    binds_j = dual[:count] > share * slack[:count]
    norm_binds = dual[count] > share * (slack[count] - np.linalg.norm(slack[count + 1 :]))
    start = np.array(solved.x), 0.5 * dual[count] * norm_binds, 0.5 * dual[:count][binds_j]
    c, multiplier, mu_a = _newton(system, target, rows_jk[binds_j], limit_j[binds_j], norm_binds, *start, solver)
    gradient = system.T @ (system @ c - target) + multiplier * c + rows_jk[binds_j].T @ mu_a
    missed = [np.abs(gradient).max(), (rows_jk @ c - limit_j).max(), c @ c - 1.0, -multiplier, *-mu_a]
    return c, max(missed) if np.isfinite(missed).all() else np.inf


def _by_interior_points(system, target, rows_jk, limit_j):
    n = system.shape[1]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    return clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(2.0 * system.T @ system)),
        -2.0 * system.T @ target,
        sparse.csc_matrix(np.vstack([rows_jk, np.zeros((1, n)), -np.eye(n)])),
        np.concatenate([limit_j, [1.0], np.zeros(n)]),
        [clarabel.NonnegativeConeT(len(limit_j)), clarabel.SecondOrderConeT(n + 1)],
        settings,
    ).solve()


def _newton(system, target, rows_ak, limit_a, norm_binds, c, multiplier, mu_a, solver):
    """Solve ``A'(A c - t) + lambda c + rows' mu = 0``, ``rows c = limit``, and ``|c|^2 = 1`` where that binds."""
    n, count = len(c), len(limit_a)
    square, projected = system.T @ system, system.T @ target
    for _ in range(_NEWTON_STEPS):
        matrix = np.zeros((n + count + 1, n + count + 1))
        matrix[:n, :n] = square + multiplier * np.eye(n)
        matrix[:n, n : n + count] = rows_ak.T
        matrix[n : n + count, :n] = rows_ak
        right = [-(matrix[:n, :n] @ c - projected + rows_ak.T @ mu_a), limit_a - rows_ak @ c]
        if norm_binds:
            matrix[:n, -1] = matrix[-1, :n] = c
            right.append([0.5 * (1.0 - c @ c)])
        else:
            matrix[-1, -1] = 1.0
            right.append([0.0])
        step = solver(matrix, np.concatenate(right))
        if not np.isfinite(step).all():
            break
        c, mu_a, multiplier = c + step[:n], mu_a + step[n : n + count], multiplier + step[-1]
        if np.abs(step[:n]).max() < 1e-14:
            break
    return c, multiplier, mu_a
