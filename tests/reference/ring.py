"""Float64 references for the ring scene: tori as quartic surfaces, and the GGX lobe in its textbook form."""

import numpy as np


def torus_roots(torus, origins, directions):
    """Distances along unit rays where they meet a torus, inf where they do not: the quartic's real roots.

    ``(|p|^2 + R^2 - r^2)^2 = 4 R^2 (|p|^2 - (p.a)^2)`` with p = o + t d relative to the centre.
    """
    axis = np.array(torus.axis) / np.linalg.norm(torus.axis)
    o = origins - np.array(torus.centre)
    b, c = np.sum(o * directions, axis=1), np.sum(o * o, axis=1)
    height, slope = o @ axis, directions @ axis
    k, four = c + torus.major**2 - torus.minor**2, 4.0 * torus.major**2
    coefficients = [
        4.0 * b,
        4.0 * b * b + 2.0 * k - four * (1.0 - slope * slope),
        4.0 * b * k - four * (2.0 * b - 2.0 * height * slope),
        k * k - four * (c - height * height),
    ]
    companion = np.zeros((len(o), 4, 4))
    companion[:, 1:, :-1] = np.eye(3)
    companion[:, 0] = -np.stack(coefficients, axis=1)
    roots = np.linalg.eigvals(companion)
    return np.where(np.abs(roots.imag) < 1e-6, roots.real, np.inf)


def first_hit(tori, origin, directions):
    """Distance and owner (-1: the ground z = 0) of what each ray from the eye meets first."""
    distances = [-origin[2] / directions[:, 2]]
    origins = np.broadcast_to(origin, directions.shape)
    for torus in tori:
        roots = torus_roots(torus, origins, directions)
        distances.append(np.where(roots > 0, roots, np.inf).min(axis=1))
    owner = np.argmin(distances, axis=0)
    return np.min(distances, axis=0), owner - 1


def is_visible(tori, points, normals, light, nearest=5e-3):
    """Whether surface points face a distant light and no torus is before it, farther than `nearest`."""
    open_way = normals @ light > 0
    for torus in tori:
        roots = torus_roots(torus, points, np.broadcast_to(light, points.shape))
        open_way &= ~np.any((roots > nearest) & np.isfinite(roots), axis=1)
    return open_way


def ggx_brdf(normals, views, light, specular, roughness):
    """``D F G2 / (4 (n.l) (n.v))``, with Smith's G2 from Heitz 2014: tan of the angles and the Lambda function."""
    half = views + light
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    n_l, n_v = normals @ light, np.sum(normals * views, axis=1)
    tan2_h = 1.0 / np.sum(normals * half, axis=1) ** 2 - 1.0
    cos4_h = np.sum(normals * half, axis=1) ** 4
    density = 1.0 / (np.pi * roughness**2 * cos4_h * (1.0 + tan2_h / roughness**2) ** 2)

    def smith_lambda(cosine):
        return 0.5 * (np.sqrt(1.0 + roughness**2 * (1.0 / cosine**2 - 1.0)) - 1.0)

    shadowing = 1.0 / (1.0 + smith_lambda(n_l) + smith_lambda(n_v))
    fresnel = np.array(specular) + (1.0 - np.array(specular)) * (1.0 - half @ light)[:, None] ** 5
    return (density * shadowing / (4.0 * n_l * n_v))[:, None] * fresnel
