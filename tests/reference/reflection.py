"""Reflection in float64 by brute quadrature over two hemispheres; imports nothing of ours."""

import numpy as np

from tests.reference.basis import real_harmonics


def hemisphere(rows, columns):
    """Return directions (q, 3) and solid angles (q,): Gauss's rule in z, equal steps around."""
    node, weight = np.polynomial.legendre.leggauss(rows)
    z, azimuth = np.meshgrid(0.5 * (node + 1), 2 * np.pi * (np.arange(columns) + 0.37) / columns, indexing="ij")
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(azimuth), r * np.sin(azimuth), z], axis=-1).reshape(-1, 3)
    return directions, np.repeat(0.5 * weight * 2 * np.pi / columns, columns)


def phong(light, view, exponent):
    cosine = (view * (2 * light[..., 2:] * np.array([0, 0, 1.0]) - light)).sum(-1)
    return (exponent + 2) / (2 * np.pi) * np.clip(cosine, 0, 1) ** exponent


def blinn(light, view, exponent):
    half = light + view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    scale = (exponent + 2) * (exponent + 4) / (8 * np.pi * (2 ** (-exponent / 2) + exponent))
    return scale * half[..., 2] ** exponent


def ggx(light, view, roughness, f0):
    """Cook and Torrance's quotient with Smith's lambda written out, as Heitz (2014, eq. 72 and 99) has it."""
    alpha = roughness**2
    half = light + view
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    tan2 = 1 / half[..., 2] ** 2 - 1
    density = np.exp(-2 * np.log(1 + tan2 / alpha**2)) / (np.pi * alpha**2 * half[..., 2] ** 4)

    def tail(z):
        return (np.sqrt(1 + alpha**2 * (1 / z**2 - 1)) - 1) / 2

    shadow = 1 / (1 + tail(light[..., 2]) + tail(view[..., 2]))
    fresnel = f0 + (1 - f0) * (1 - (light * half).sum(-1)) ** 5
    return fresnel * density * shadow / (4 * light[..., 2] * view[..., 2])


def view_moments(brdf, degree, rows=48, columns=96, visible=None):
    """Return ``int int y_o(v) f(s, v) s_z V(s) y_i(s) ds dv`` over both hemispheres, in the frame of the normal."""
    nodes, weights = hemisphere(rows, columns)
    basis = real_harmonics(nodes, degree)
    seen = np.ones(len(nodes)) if visible is None else visible(nodes)
    right = basis * (weights * nodes[:, 2] * seen)[:, None]
    total = np.zeros((basis.shape[1], basis.shape[1]))
    for first in range(0, len(nodes), 256):
        part = slice(first, first + 256)
        total += (basis[part] * weights[part, None]).T @ (brdf(nodes[None], nodes[part, None]) @ right)
    return total


def half_gram(degree):
    """Return ``int_(z > 0) y y^T``."""
    nodes, weights = hemisphere(degree + 1, 2 * degree + 1)
    basis = real_harmonics(nodes, degree)
    return (basis * weights[:, None]).T @ basis
