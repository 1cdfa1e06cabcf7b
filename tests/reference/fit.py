"""Fits in float64, column by column, from the formulas of the paper (Lam, Leung and Wong, noise-resistant fitting).

Samples are (n_light, P) in units of the peak, `weight_i` is any multiple of each light's solid angle.
"""

import numpy as np
from scipy.optimize import brentq


def project(basis_ik, sample_ip, angle_i):
    """Return the quadrature ``sum_i w_i beta_i y_k(s_i)``."""
    return np.einsum("i,ik,ip->kp", angle_i, basis_ik, sample_ip)


def bound(sample_ip, weight_i):
    """Return E_c: twice the mean of beta^2 over the hemisphere times its area (eq. 16)."""
    return 4.0 * np.pi * np.average(sample_ip**2, axis=0, weights=weight_i)


def decomposed(basis_ik, sample_ip, weight_i):
    """Return U (k, r), sigma (r, 1) and W' beta (r, p) of the basis with rows weighted to mean 1.

    Without the components that rounding errors of the basis made: those of equal lights, for one.
    """
    root_i = np.sqrt(weight_i / np.mean(weight_i))[:, None]
    left, sigma, right = np.linalg.svd(root_i * basis_ik, full_matrices=False)
    rank = np.linalg.matrix_rank(root_i * basis_ik)
    return right[:rank].T, sigma[:rank, None], left[:, :rank].T @ (root_i * sample_ip)


def least_squares(basis_ik, sample_ip, weight_i):
    """Return the coefficients of eq. 8 by LAPACK's least squares."""
    root_i = np.sqrt(weight_i)[:, None]
    return np.linalg.lstsq(root_i * basis_ik, root_i * sample_ip, rcond=None)[0]


def constrained(basis_ik, sample_ip, weight_i, factor=1.0):
    """Return coefficients, lambda and |c(0)|^2 of eq. 19-25, lambda by halving its logarithm 100 times."""
    rotation, sigma, z = decomposed(basis_ik, sample_ip, weight_i)
    energy = factor * bound(sample_ip, weight_i)

    def shrunk(lambda_p):
        return sigma * z / (sigma**2 + lambda_p)

    free = np.sum(shrunk(0.0) ** 2, axis=0)
    # |sigma z| / lambda is more than the norm, so this is an upper end.
    high = np.linalg.norm(sigma * z, axis=0) / np.sqrt(np.where(energy > 0, energy, 1.0)) + 1e-300
    low = 1e-30 * high
    for _ in range(100):
        middle = np.sqrt(low) * np.sqrt(high)
        held = np.sum(shrunk(middle) ** 2, axis=0) <= energy
        low, high = np.where(held, low, middle), np.where(held, middle, high)
    lambda_p = np.where(free <= energy, 0.0, high)
    return rotation @ shrunk(lambda_p), lambda_p, free


def constrained_as_printed(basis_ik, sample_ip, weight_i, steps, factor=1.0):
    """Return coefficients and lambda of eq. 25 by section V-C's search: from 1, lower bound 0, doubled, then halved."""
    rotation, sigma, z = decomposed(basis_ik, sample_ip, weight_i)
    energy = factor * bound(sample_ip, weight_i)
    lambda_p = np.zeros(sample_ip.shape[1])
    for p in range(sample_ip.shape[1]):

        def within(value, column=z[:, p], limit=energy[p]):
            return np.sum((sigma[:, 0] * column / (sigma[:, 0] ** 2 + value)) ** 2) <= limit

        if within(0.0):
            continue
        low, high, tried = 0.0, None, 1.0
        for _ in range(steps):
            if within(tried):
                high = tried
            else:
                low = tried
            tried = 2.0 * tried if high is None else 0.5 * (low + high)
        lambda_p[p] = high
    return rotation @ (sigma * z / (sigma**2 + lambda_p)), lambda_p


def truncated(basis_ik, sample_ip, weight_i, factor=1.0, crossing=False):
    """Return coefficients and ranks of eq. 31-35, stopping before the bound (or after the step that crosses it).

    A step is all components whose sigma is within 1e-4 of that of the first.
    """
    rotation, sigma, z = decomposed(basis_ik, sample_ip, weight_i)
    energy = factor * bound(sample_ip, weight_i)
    rank_p = np.zeros(sample_ip.shape[1], int)
    steps = []
    for r, value in enumerate(sigma[:, 0]):
        if not steps or value < (1 - 1e-4) * sigma[steps[-1][0], 0]:
            steps.append([])
        steps[-1].append(r)
    for p, column in enumerate((z / sigma).T):
        total = 0.0
        for step in steps:
            term = np.sum(column[step] ** 2)
            if (total >= energy[p]) if crossing else (total + term > energy[p]):
                break
            total += term
            rank_p[p] += len(step)
    kept = np.arange(len(sigma))[:, None] < rank_p
    return rotation @ np.where(kept, z / sigma, 0.0), rank_p


def constrained_dense(basis_ik, sample_i, scale_k, energy):
    """Return c and lambda of ``min |beta - Y c|^2 + lambda (c' D D c - E)`` (eq. 26) for one column.

    Without a decomposition: each lambda is one least-squares problem with ``sqrt(lambda) D`` below Y.
    """

    def solve(log_lambda):
        stacked = np.concatenate([basis_ik, np.exp(0.5 * log_lambda) * np.diag(scale_k)])
        return np.linalg.lstsq(stacked, np.concatenate([sample_i, np.zeros(len(scale_k))]), rcond=None)[0]

    root = brentq(lambda log: np.log(np.sum((scale_k * solve(log)) ** 2) / energy), -40.0, 30.0, xtol=1e-13)
    return solve(root), np.exp(root)
