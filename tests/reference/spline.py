"""The smoothing spline and its cross-validation by the book: dense matrices, and lights literally left out."""

import numpy as np


def penalty(degree, epsilon=1e-2):
    return np.diag([epsilon + (n * (n + 1.0)) ** 2 for n in range(degree + 1) for _ in range(2 * n + 1)])


def operator(basis_ik, penalty_kk, lam, weights_i):
    """Return ``(Y'WY + lambda P)^-1 Y'W``; the weights' mean is made 1."""
    weighted_ki = basis_ik.T * (weights_i / weights_i.mean())
    return np.linalg.solve(weighted_ki @ basis_ik + lam * penalty_kk, weighted_ki)


def gcv(basis_ik, penalty_kk, lam, weights_i, sample_ip):
    """Return ``n |W^1/2 (I - H) beta|^2 / tr(I - H)^2`` with the hat matrix written out."""
    rest_ii = np.eye(len(basis_ik)) - basis_ik @ operator(basis_ik, penalty_kk, lam, weights_i)
    residual_ip = np.sqrt(weights_i / weights_i.mean())[:, None] * (rest_ii @ sample_ip)
    return len(basis_ik) * (residual_ip**2).sum() / np.trace(rest_ii) ** 2


def leave_out(basis_ik, sample_ip, weights_i, penalty_kk):
    """Return each sample as the penalised fit to all the others gives it."""
    left_out_ip = np.empty_like(sample_ip)
    for i in range(len(basis_ik)):
        kept = np.arange(len(basis_ik)) != i
        weighted_ki = basis_ik[kept].T * weights_i[kept]
        coeffs_kp = np.linalg.solve(weighted_ki @ basis_ik[kept] + penalty_kk, weighted_ki @ sample_ip[kept])
        left_out_ip[i] = basis_ik[i] @ coeffs_kp
    return left_out_ip
