"""Rays and an analytic torus about z, and rays and triangles one by one, in float64; imports nothing of ours."""

import numpy as np


def torus_is_hit(origin, direction, major, minor, least=1e-6):
    """Return whether a ray meets the torus further away than `least`: real roots of the quartic, well separated."""
    o, d = np.asarray(origin, np.float64), np.asarray(direction, np.float64)
    od, oo = o @ d, o @ o
    k = oo + major**2 - minor**2
    axial = 4.0 * major**2
    coefficients = [
        1.0,
        4.0 * od,
        2.0 * k + 4.0 * od**2 - axial * (d[0] ** 2 + d[1] ** 2),
        4.0 * k * od - 2.0 * axial * (o[0] * d[0] + o[1] * d[1]),
        k**2 - axial * (o[0] ** 2 + o[1] ** 2),
    ]
    roots = np.roots(coefficients)
    real = roots.real[np.abs(roots.imag) < 1e-7]
    return bool((real > least).any())


def torus_clearance(origin, direction, major, minor, reach=4.0, steps=4000):
    """Return the least signed distance from the ray, beyond its start, to the torus."""
    t = np.linspace(0.02, reach, steps)[:, None]
    p = np.asarray(origin) + t * np.asarray(direction)
    return float((np.hypot(np.hypot(p[:, 0], p[:, 1]) - major, p[:, 2]) - minor).min())


def triangles_hit(origin, direction, corners_f33, least):
    """Return whether a ray meets any triangle further away than `least` (Moeller and Trumbore)."""
    a, b, c = np.moveaxis(np.asarray(corners_f33, np.float64), 1, 0)
    p = np.cross(direction, c - a)
    determinant = np.einsum("fa,fa->f", b - a, p)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / determinant
        s = origin - a
        u = np.einsum("fa,fa->f", s, p) * inverse
        q = np.cross(s, b - a)
        v = q @ direction * inverse
        t = np.einsum("fa,fa->f", c - a, q) * inverse
    return bool(((np.abs(determinant) > 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > least)).any())


def phong(light, view, diffuse, specular, exponent):
    """Return the modified Phong BRDF of one pair of directions with the normal as z."""
    mirrored = np.array([-light[0], -light[1], light[2]])
    lobe = (exponent + 2.0) / (2.0 * np.pi) * max(mirrored @ view, 0.0) ** exponent
    return np.asarray(diffuse) / np.pi + np.asarray(specular) * lobe
