"""Kriging on the sphere by the book: Gaussian coefficients with a variance for each degree, dense matrices."""

import numpy as np
from scipy.special import eval_legendre

DEGREE = 25


def variances(level, slope, edge, heat, limit=DEGREE):
    """Return a_l: one variance for each degree, that at a point being 1 without degree 0."""
    l = np.arange(1, DEGREE + 1)
    rough, share = l * (l + 1) / 2, (2 * l + 1) / (4 * np.pi)
    smooth = rough**-slope * np.exp(-heat * (rough - 1))
    edges = rough**-1.5
    smooth, edges = smooth * (l <= limit), edges * (l <= limit)
    mixed = (smooth / (share * smooth).sum() + edge * edges / (share * edges).sum()) / (1 + edge)
    return np.concatenate([[4 * np.pi * level], mixed])


def kernel(a_l, first_t3, second_i3):
    """Return ``sum_l a_l (2 l + 1) / (4 pi) P_l(s t)``."""
    cosine = np.clip(first_t3 @ second_i3.T, -1, 1)
    return sum(a * (2 * n + 1) / (4 * np.pi) * eval_legendre(n, cosine) for n, a in enumerate(a_l))


def noise_of(a_l, noise):
    return noise * ((2 * np.arange(DEGREE + 1) + 1) / (4 * np.pi) * a_l).sum()


def predict(a_l, noise, lights_i3, sample_ip, targets_t3):
    """Return the posterior mean at some directions, every photograph with its own noise."""
    covariance_ii = kernel(a_l, lights_i3, lights_i3) + noise_of(a_l, noise) * np.eye(len(lights_i3))
    return kernel(a_l, targets_t3, lights_i3) @ np.linalg.solve(covariance_ii, sample_ip)


def operator(a_l, noise, basis_ik):
    """Return the posterior mean's matrix, found in coefficients: ``(Y'Y / n + diag(1 / a))^-1 Y' / n``."""
    variance_k = np.repeat(a_l, 2 * np.arange(DEGREE + 1) + 1)
    n = noise_of(a_l, noise)
    root_k = np.sqrt(variance_k)
    scaled_ik = basis_ik * root_k
    return root_k[:, None] * np.linalg.solve(scaled_ik.T @ scaled_ik + n * np.eye(len(root_k)), scaled_ik.T)


def coefficient_variances(a_l, azimuth, tilt):
    """Return a variance for each coefficient: orders differ by ``exp(k (3 m^2 / (l (l + 1)) - 1))``."""
    found = []
    for n, a in enumerate(a_l):
        factors = [np.exp(azimuth * (3 * m * m / max(n * (n + 1), 1) - 1)) for m in range(-n, n + 1)]
        found += [a * factor / np.mean(factors) * (tilt if n == 1 else 1) for factor in factors]
    return np.array(found)


def moment_step(kernel, noise_i, lights_i3, moment_ii, first_t3, second_s3, turns=10):
    """Return what one step of EM adds to a kernel, averaged over turns about the zenith and over mirrors.

    In functions, not coefficients: ``k(s, lights) (Q S Q / scale - Q) k(lights, t)``, both directions turned together.
    More turns than twice the degree are as good as all.
    """
    inverse = np.linalg.inv(kernel(lights_i3, lights_i3) + np.diag(noise_i))
    scale = np.trace(inverse @ moment_ii) / len(inverse)
    middle = inverse @ moment_ii @ inverse / scale - inverse
    total = np.zeros((len(first_t3), len(second_s3)))
    for mirror in (1, -1):
        for angle in 2 * np.pi * np.arange(turns) / turns:
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) * [[1], [mirror], [1]]
            total += kernel(first_t3 @ turn.T, lights_i3) @ middle @ kernel(lights_i3, second_s3 @ turn.T)
    return total / (2 * turns)
