"""Hemispherical bases in float64 by their published formulas, Haar wavelets by brute force, and quadrature."""

from math import factorial

import numpy as np
from numpy.polynomial import Legendre
from scipy.special import eval_jacobi, gammaln

from tests.reference.basis import real_harmonics


def hemisphere_quadrature(degree):
    """Return directions and weights of Gauss's rule in z and equal steps of azimuth, over z > 0."""
    node, weight = np.polynomial.legendre.leggauss(degree + 1)
    steps = 2 * degree + 1
    z, azimuth = np.repeat((node + 1) / 2, steps), np.tile(2 * np.pi * np.arange(steps) / steps, degree + 1)
    radius = np.sqrt(1 - z * z)
    directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    return directions, np.repeat(weight / 2, steps) * 2 * np.pi / steps


def root_quadrature(count, steps):
    """Return the same with z = t^2 and Gauss's rule in t: for half powers of z."""
    node, weight = np.polynomial.legendre.leggauss(count)
    t = (node + 1) / 2
    z, azimuth = np.repeat(t * t, steps), np.tile(2 * np.pi * np.arange(steps) / steps, count)
    radius = np.sqrt(1 - z * z)
    directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    return directions, np.repeat(weight * t, steps) * 2 * np.pi / steps


def _polar(directions_i3, degree, radial):
    """Return radial(l, m, z) times sqrt(2) cos, 1 or sqrt(2) sin, in columns l (l + 1) + m."""
    x, y, z = directions_i3.T
    azimuth = np.arctan2(y, x)
    basis_ik = np.empty((len(directions_i3), (degree + 1) ** 2))
    for l in range(degree + 1):
        for m in range(l + 1):
            value = radial(l, m, z) * (np.sqrt(2) if m else 1)
            basis_ik[:, l * l + l + m] = value * np.cos(m * azimuth)
            if m:
                basis_ik[:, l * l + l - m] = value * np.sin(m * azimuth)
    return basis_ik


def hsh(directions_i3, degree):
    """Return Gautron et al. 2004, eq. 6 to 8: P_l^m(2 z - 1) without its sign, and their constants."""

    def radial(l, m, z):
        x = 2 * z - 1
        associated = np.sqrt(1 - x * x) ** m * Legendre.basis(l).deriv(m)(x)
        return np.sqrt((2 * l + 1) * factorial(l - m) / (2 * np.pi * factorial(l + m))) * associated

    return _polar(directions_i3, degree, radial)


def zernike(directions_i3, degree):
    """Return Zernike's R_n^m(sqrt(1 - z)) of n = 2 l - m, by their sums of factorials, of mean square 1 / (2 pi)."""

    def radial(l, m, z):
        n, rho = 2 * l - m, np.sqrt(1 - z)
        powers = range((n - m) // 2 + 1)
        terms = [
            (-1) ** j
            * factorial(n - j)
            / (factorial(j) * factorial((n + m) // 2 - j) * factorial((n - m) // 2 - j))
            * rho ** (n - 2 * j)
            for j in powers
        ]
        return np.sqrt((n + 1) / (2 * np.pi)) * np.sum(terms, axis=0)

    return _polar(directions_i3, degree, radial)


def makhotkin(directions_i3, degree):
    """Return ``(1 - x^2)^(m/2) d^m/dx^m P_l^(0,1)(x)``, x = 2 z - 1, orthonormal under z: P_(l-m)^(m, m+1)."""

    def radial(l, m, z):
        x, n, a, b = 2 * z - 1, l - m, m, m + 1
        log_norm = (a + b + 1) * np.log(2) - np.log(2 * n + a + b + 1)
        log_norm += gammaln(n + a + 1) + gammaln(n + b + 1) - gammaln(n + 1) - gammaln(n + a + b + 1)
        # dz z = dx (1 + x) / 4, and 2 pi of azimuth
        return np.sqrt(4 / (2 * np.pi)) * np.exp(-log_norm / 2) * np.sqrt(1 - x * x) ** m * eval_jacobi(n, a, b, x)

    return _polar(directions_i3, degree, radial)


def gram_schmidt(directions_i3, degree):
    """Return harmonics that were made orthonormal over the hemisphere one after another, by QR at quadrature nodes."""
    nodes, weights = hemisphere_quadrature(degree)
    _, triangle = np.linalg.qr(real_harmonics(nodes, degree) * np.sqrt(weights)[:, None])
    triangle *= np.sign(np.diag(triangle))[:, None]
    return np.linalg.solve(triangle.T, real_harmonics(directions_i3, degree).T).T


def square_of(directions_i3):
    """Return Shirley and Chiu's square of Lambert's disc, turned so that the corners are the axes."""
    x, y, z = directions_i3.T
    radius, azimuth = np.sqrt(1 - z), np.arctan2(y, x) - np.pi / 4
    turn = np.mod(azimuth + np.pi / 4, 2 * np.pi) - np.pi / 4  # from -45 to 315 degrees
    quarter = np.clip(((turn + np.pi / 4) // (np.pi / 2)).astype(int), 0, 3)
    along = (turn - quarter * np.pi / 2) / (np.pi / 4)
    a = np.choose(quarter, [radius, -along * radius, -radius, along * radius])
    b = np.choose(quarter, [along * radius, radius, -along * radius, -radius])
    return a, b


def haar_images(side):
    """Return all functions as images of cells (k, side, side), drawn one by one, orthonormal over an area of 2 pi."""
    images = [np.full((side, side), 1 / np.sqrt(2 * np.pi))]
    cells = 1
    while cells < side:
        width = side // cells
        left = np.repeat([1.0, -1.0], width // 2)
        value = 1 / np.sqrt(2 * np.pi / cells**2)
        for patch in (
            np.outer(np.ones(width), left),
            np.outer(left, np.ones(width)),
            np.outer(left, left),
        ):
            for row in range(cells):
                for column in range(cells):
                    image = np.zeros((side, side))
                    image[row * width : (row + 1) * width, column * width : (column + 1) * width] = value * patch
                    images.append(image)
        cells *= 2
    return np.array(images)


def cell_centres(side):
    """Return directions at the centres of the square's cells, row by row, and their solid angles."""
    at = (np.arange(side) + 0.5) * 2 / side - 1
    b, a = (grid.ravel() for grid in np.meshgrid(at, at, indexing="ij"))
    wide = np.abs(a) >= np.abs(b)
    radius = np.where(wide, np.abs(a), np.abs(b))
    ratio = np.where(wide, b, a) / np.where(wide, a, b)
    azimuth = np.where(wide, ratio * np.pi / 4, np.pi / 2 - ratio * np.pi / 4) + np.where(
        np.where(wide, a, b) < 0, np.pi, 0
    )
    azimuth += np.pi / 4
    sine = radius * np.sqrt(2 - radius**2)
    directions = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), 1 - radius**2], axis=1)
    return directions, np.full(side * side, 2 * np.pi / side**2)


def haar(directions_i3, degree):
    """Return the functions at directions."""
    side = degree + 1
    a, b = square_of(directions_i3)
    row, column = (np.clip(((v + 1) / 2 * side).astype(int), 0, side - 1) for v in (b, a))
    return haar_images(side)[:, row, column].T


FUNCTIONS = {
    "sh": real_harmonics,
    "hsh": hsh,
    "gram-schmidt": gram_schmidt,
    "zernike": zernike,
    "makhotkin": makhotkin,
    "haar": haar,
}


def gram(name, degree):
    """Return the integrals over the hemisphere of the products of all functions."""
    if name == "haar":
        return np.eye((degree + 1) ** 2)
    nodes, weights = hemisphere_quadrature(degree + 1)
    values = FUNCTIONS[name](nodes, degree)
    return (values * weights[:, None]).T @ values
