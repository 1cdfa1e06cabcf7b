"""Reflection maps by the formulas as printed: complex harmonics with Condon and Shortley's sign, Wigner's sum."""

from math import factorial

import numpy as np
from scipy.special import sph_harm_y


def small_d(l, m, q, alpha):
    """Return d^l_mq(alpha) of zyz angles by Wigner's sum: d^1_10 = -sin(alpha) / sqrt(2)."""
    total = 0.0
    for k in range(max(0, q - m), min(l + q, l - m) + 1):
        sign = (-1.0) ** (m - q + k)
        below = factorial(l + q - k) * factorial(k) * factorial(m - q + k) * factorial(l - m - k)
        powers = np.cos(alpha / 2) ** (2 * l + q - m - 2 * k) * np.sin(alpha / 2) ** (m - q + 2 * k)
        total = total + sign / below * powers
    return total * np.sqrt(float(factorial(l + m) * factorial(l - m) * factorial(l + q) * factorial(l - q)))


def complex_light(coeffs_k):
    """Return L_lm by (l, m) of real coefficients without Condon and Shortley's sign."""
    light, degree = {}, int(np.sqrt(len(coeffs_k))) - 1
    for l in range(degree + 1):
        light[l, 0] = complex(coeffs_k[l * (l + 1)])
        for m in range(1, l + 1):
            value = (coeffs_k[l * (l + 1) + m] - 1j * coeffs_k[l * (l + 1) - m]) / np.sqrt(2)
            light[l, m], light[l, -m] = (-1) ** m * value, np.conj(value)
    return light


def local_coefficient(light, rho_lpq, p, q, alpha, beta):
    """Return B_pq(alpha, beta) = sum_lm L_lm rho_lpq d^l_mq(alpha) e^(i m beta), q of either sign."""
    return sum(
        value * rho_lpq[l, p, abs(q)] * small_d(l, m, q, alpha) * np.exp(1j * m * beta)
        for (l, m), value in light.items()
        if abs(q) <= l < len(rho_lpq)
    )


def global_coefficient(local_q, p, q, alpha, beta):
    """Return B_pq = sum_s B_ps d^p_sq(-alpha) e^(-i q beta) of the local ones s = -p .. p (eq. 8)."""
    turned = sum(local_q[s + p] * small_d(p, s, q, -alpha) for s in range(-p, p + 1))
    return turned * np.exp(-1j * q * beta)


def radiance(coefficients, theta, phi):
    """Return sum B_pq Y_pq(theta, phi) of {(p, q): B_pq}."""
    return sum(value * sph_harm_y(p, q, theta, phi) for (p, q), value in coefficients.items())


def frame(alpha, beta):
    """Return Rz(beta) Ry(alpha)."""
    about_z = [[np.cos(beta), -np.sin(beta), 0], [np.sin(beta), np.cos(beta), 0], [0, 0, 1]]
    about_y = [[np.cos(alpha), 0, np.sin(alpha)], [0, 1, 0], [-np.sin(alpha), 0, np.cos(alpha)]]
    return np.array(about_z) @ np.array(about_y)


def reflectance(rho_lpq, theta_i, theta_o, phi):
    """Return sum rho_lpq Y*_lq(theta_i, 0) Y_pq(theta_o, phi) over q of both signs (eq. 13)."""
    total = 0.0
    for l in range(rho_lpq.shape[0]):
        for p in range(rho_lpq.shape[1]):
            for q in range(-min(l, p), min(l, p) + 1):
                light = np.conj(sph_harm_y(l, q, theta_i, 0.0))
                total = total + rho_lpq[l, p, abs(q)] * light * sph_harm_y(p, q, theta_o, phi)
    return np.real(total)


def microfacet(sigma, light, view, normal):
    """Return eq. 11 of unit vectors (..., 3)."""
    half = light + view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    angle = np.arccos(np.clip(np.sum(half * normal, axis=-1), -1, 1))
    lobe = np.exp(-((angle / sigma) ** 2)) / (4 * np.pi * sigma**2)
    return np.where(np.sum(light * normal, axis=-1) > 0, lobe, 0.0)


def lafortune(diffuse, lobes, light, view):
    """Return one channel's BRDF times the cosine, of unit vectors (..., 3) in the normal's frame."""
    total = diffuse / np.pi
    for flat, upright, exponent in lobes:
        across = light[..., 0] * view[..., 0] + light[..., 1] * view[..., 1]
        base = flat * across + upright * light[..., 2] * view[..., 2]
        total = total + np.where(base > 0, np.abs(base), 0.0) ** exponent
    return np.where(light[..., 2] > 0, total * light[..., 2], 0.0)
