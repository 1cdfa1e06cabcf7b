"""Luminance of three CIE skies relative to the zenith, and Green's light with two lobes.

Green, Spherical Harmonic Lighting: The Gritty Details (2003); the CIE formulas as the IES Lighting Handbook has them.
"""

import math

import numpy as np

from tests.reference.basis import real_harmonics


def luminance(sky, zenith_angle, angle_from_sun, sun_zenith_angle):
    """Return L / Lz; angles in radians, the zenith angle below 90 degrees."""
    if sky == "overcast":
        return (1 + 2 * np.cos(zenith_angle)) / 3
    if sky == "clear":
        rate, scatter = 0.32, lambda g: 0.91 + 10 * np.exp(-3 * g) + 0.45 * np.cos(g) ** 2
    else:
        rate, scatter = 0.80, lambda g: 0.526 + 5 * np.exp(-1.5 * g)
    gradation = (1 - np.exp(-rate / np.cos(zenith_angle))) / (1 - np.exp(-rate))
    return gradation * scatter(angle_from_sun) / scatter(sun_zenith_angle)


# CIE S 011: groups of the gradation (a, b) and of the indicatrix (c, d, e), and which of them each type takes.
_GRADATIONS = {
    "I": (4, -0.7),
    "II": (1.1, -0.8),
    "III": (0, -1),
    "IV": (-1, -0.55),
    "V": (-1, -0.32),
    "VI": (-1, -0.15),
}
_INDICATRICES = [(0, -1, 0), (2, -1.5, 0.15), (5, -2.5, 0.3), (10, -3, 0.45), (16, -3, 0.3), (24, -2.8, 0.15)]
GENERAL_TYPES = [
    *("I1", "I2", "II1", "II2", "III1", "III2", "III3", "III4"),
    *("IV2", "IV3", "IV4", "V4", "V5", "VI5", "VI6"),
]


def general_luminance(groups, zenith_angle, angle_from_sun, sun_zenith_angle):
    """Return L / Lz of a type given by its groups, such as V4."""
    (a, b), (c, d, e) = _GRADATIONS[groups[:-1]], _INDICATRICES[int(groups[-1]) - 1]

    def scatter(g):
        return 1 + c * (np.exp(d * g) - np.exp(d * np.pi / 2)) + e * np.cos(g) ** 2

    gradation = (1 + a * np.exp(b / np.cos(zenith_angle))) / (1 + a * np.exp(b))
    return gradation * scatter(angle_from_sun) / scatter(sun_zenith_angle)


def two_lobes(directions_i3):
    """Return ``max(0, 5 cos θ - 4) + max(0, -4 sin(θ - π) cos(φ - 2.5) - 3)``."""
    x, y, z = directions_i3.T
    theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
    first = np.maximum(0, 5 * np.cos(theta) - 4)
    return first + np.maximum(0, -4 * np.sin(theta - np.pi) * np.cos(phi - 2.5) - 3)


# Its 16 coefficients; the printed list lacks one and has lost a sign. Functions of odd order have the other sign there.
TWO_LOBES = np.array(
    [
        *(0.3988, -0.2105, 0.2865, 0.2818, -0.3150, 0.0, 0.1314, 0.0),
        *(0.0932, -0.2496, 0.0, 0.1234, 0.3039, -0.1651, 0.0, -0.0922),
    ]
)


def odd_orders_turned(degree):
    """Return 1 or -1 for each coefficient: -1 where the order is odd."""
    return np.array([-1.0 if m % 2 else 1.0 for l in range(degree + 1) for m in range(-l, l + 1)])


def project_upper(function, degree, rows):
    """Return coefficients of a function of (n, 3) directions above the horizon, by Gauss's rule in z on 0 .. 1."""
    node, weight = np.polynomial.legendre.leggauss(rows)
    azimuth = np.pi * (np.arange(2 * rows) + 0.5) / rows
    total = np.zeros((degree + 1) ** 2)
    for z, w in zip(0.5 * (node + 1), 0.5 * weight, strict=True):
        radius = math.sqrt(1 - z * z)
        ring = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.full(len(azimuth), z)])
        total += real_harmonics(ring, degree).T @ function(ring) * (w * np.pi / rows)
    return total
