"""Real spherical harmonics in float64 from SciPy's complex ones, and quadrature on the sphere."""

import numpy as np
from scipy.special import sph_harm_y_all


def real_harmonics(directions_i3, degree):
    """Return (n_light, (degree + 1)^2), column l (l + 1) + m, without the Condon-Shortley sign.

    ``sqrt(2) Re`` of the complex function for m > 0, ``sqrt(2) Im`` of that of order |m| for m < 0.
    """
    x, y, z = directions_i3.T
    complex_lmi = sph_harm_y_all(degree, degree, np.arctan2(np.hypot(x, y), z), np.arctan2(y, x))
    basis_ik = np.empty((len(directions_i3), (degree + 1) ** 2))
    for l in range(degree + 1):
        basis_ik[:, l * l + l] = complex_lmi[l, 0].real
        for m in range(1, l + 1):
            unsigned_i = (-1.0) ** m * np.sqrt(2.0) * complex_lmi[l, m]
            basis_ik[:, l * l + l + m] = unsigned_i.real
            basis_ik[:, l * l + l - m] = unsigned_i.imag
    return basis_ik


def closed_forms(directions_i3):
    """Return the nine functions of degree 0 to 2 as printed by Ramamoorthi and Hanrahan 2001, eq. 3."""
    x, y, z = directions_i3.T
    columns = [
        np.full_like(x, 0.282095),
        *(0.488603 * y, 0.488603 * z, 0.488603 * x),
        *(1.092548 * x * y, 1.092548 * y * z, 0.315392 * (3 * z * z - 1), 1.092548 * x * z),
        0.546274 * (x * x - y * y),
    ]
    return np.stack(columns, axis=1)


def sphere_quadrature(degree):
    """Return directions and weights that integrate every product of two harmonics up to `degree` exactly.

    Gauss-Legendre in z times equal steps of azimuth.
    """
    z, weight_z = np.polynomial.legendre.leggauss(degree + 1)
    n_azimuth = 2 * degree + 1
    azimuth = 2.0 * np.pi * np.arange(n_azimuth) / n_azimuth
    radius = np.sqrt(1.0 - z * z)[:, None]
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    directions_i3 = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=2).reshape(-1, 3)
    return directions_i3, np.repeat(weight_z, n_azimuth) * (2.0 * np.pi / n_azimuth)
