"""Transfer that is known in closed form or by plain integration, in float64, without an import of ours."""

import numpy as np
from scipy.special import eval_legendre

from tests.reference.basis import real_harmonics


def clamped_cosine(normals, degree):
    """Return coefficients of max(0, n . s) / pi at each normal, (n, k).

    Funk-Hecke: 2 pi times the integral of t P_l(t) over 0 .. 1, over pi.
    """
    t, w = np.polynomial.legendre.leggauss(64)
    t, w = (t + 1) / 2, w / 2
    factors = [2.0 * np.sum(w * t * eval_legendre(l, t)) for l in range(degree + 1)]
    l = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    return real_harmonics(normals, degree) * np.array(factors)[l]


def sphere_grid(n_height=240, n_azimuth=480):
    """Return directions in the middle of equal cells of the sphere, and the solid angle of each."""
    z = 1.0 - 2.0 * (np.arange(n_height) + 0.5) / n_height
    phi = 2.0 * np.pi * (np.arange(n_azimuth) + 0.5) / n_azimuth
    z, phi = (each.ravel() for each in np.meshgrid(z, phi, indexing="ij"))
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1), 4.0 * np.pi / len(z)


def visible_cosine(normal, is_seen, degree):
    """Return coefficients of max(0, n . s) V(s) / pi, with V a function of directions."""
    directions, solid = sphere_grid()
    values = np.maximum(directions @ normal, 0.0) * is_seen(directions)
    return values @ real_harmonics(directions, degree) * (solid / np.pi)


def meets_triangle(origin, directions, a, b, c):
    """Return which rays meet a triangle (Möller and Trumbore 1997)."""
    ab, ac = b - a, c - a
    p = np.cross(directions, ac)
    det = p @ ab
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (p @ (origin - a)) / det
        q = np.cross(origin - a, ab)
        v = (directions @ q) / det
        t = (ac @ q) / det
    return (np.abs(det) > 1e-14) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
