"""Light on surfaces in float64, by its definitions: every vertex and every direction one by one."""

import numpy as np

from tests.reference.basis import real_harmonics


def quadrature(degree):
    """Return directions and solid angles, exact on the sphere for polynomials of twice the degree."""
    z, weight = np.polynomial.legendre.leggauss(degree + 1)
    azimuth = 2 * np.pi * (np.arange(2 * degree + 1) + 0.25) / (2 * degree + 1)
    radius = np.sqrt(1 - z * z)
    nodes = np.stack(
        [radius[:, None] * np.cos(azimuth), radius[:, None] * np.sin(azimuth), z[:, None] + 0 * azimuth], axis=-1
    )
    return nodes.reshape(-1, 3), np.repeat(weight * 2 * np.pi / (2 * degree + 1), 2 * degree + 1)


def degree_of(coeffs):
    return int(np.sqrt(len(coeffs))) - 1


def received(coeffs_kvc, frames_v33, light_kc, upper_only=False):
    """Return the integral of each function, in its frame, and a light, in global axes: by quadrature, (v, c)."""
    degree, wide = degree_of(coeffs_kvc), degree_of(light_kc)
    if upper_only:  # Gauss's rule over the upper half alone
        z, weight = np.polynomial.legendre.leggauss(degree + wide + 1)
        count = 2 * (degree + wide) + 1
        azimuth = 2 * np.pi * np.arange(count) / count
        height = (z + 1) / 2
        radius = np.sqrt(1 - height * height)
        nodes_q3 = np.stack(
            [radius[:, None] * np.cos(azimuth), radius[:, None] * np.sin(azimuth), height[:, None] + 0 * azimuth], -1
        ).reshape(-1, 3)
        weights_q = np.repeat(weight / 2 * 2 * np.pi / count, count)
    else:
        nodes_q3, weights_q = quadrature((degree + wide + 2) // 2 + 1)
    values_qvc = np.einsum("qk,kvc->qvc", real_harmonics(nodes_q3, degree), coeffs_kvc)
    total = np.zeros(coeffs_kvc.shape[1:])
    for v, frame in enumerate(frames_v33):
        light_qc = real_harmonics(nodes_q3 @ frame, wide) @ light_kc
        total[v] = np.einsum(
            "qc,qc,q->c", values_qvc[:, v], np.broadcast_to(light_qc, values_qvc[:, v].shape), weights_q
        )
    return total


def at_direction(coeffs_kvc, frames_v33, directions_v3):
    """Return each function at its own direction of the global axes, (v, c)."""
    local_v3 = np.einsum("vab,vb->va", frames_v33, directions_v3)
    return np.einsum("vk,kvc->vc", real_harmonics(local_v3, degree_of(coeffs_kvc)), coeffs_kvc)


def triangle_coefficients(corners_33, point_3, degree, nodes=200):
    """Return the projection of a triangle as a point sees it, by a grid of Gauss's rule over its area."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    a, b = np.meshgrid((node + 1) / 2, (node + 1) / 2, indexing="ij")
    share = np.outer(weight, weight).ravel() / 4
    a, b = a.ravel(), b.ravel()
    edges = corners_33[1:] - corners_33[0]
    places = corners_33[0] + a[:, None] * (edges[0] + b[:, None] * (edges[1] - edges[0]))
    area = np.cross(edges[0], edges[1])
    way = places - point_3
    distance = np.linalg.norm(way, axis=1)
    solid = a * share * np.abs(way @ area) / distance**3
    return solid @ real_harmonics(way / distance[:, None], degree)
