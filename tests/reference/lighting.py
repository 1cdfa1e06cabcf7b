"""Environment maps in float64: where each layout's texels look, and plain sums over them.

Directions are (right, up, forward), the axes of the published tables; written after Debevec's page on light probes and
Direct3D's table of cube faces, texel by texel, without any formula shared with the package.
"""

import math

import numpy as np

from tests.reference.basis import real_harmonics


def angular_direction(row, column, size):
    u, v = (2 * column + 1) / size - 1, 1 - (2 * row + 1) / size
    radius = math.hypot(u, v)
    if radius > 1:
        return None
    polar, turn = math.pi * radius, math.atan2(v, u)
    return math.sin(polar) * math.cos(turn), math.sin(polar) * math.sin(turn), math.cos(polar)


def latlong_direction(row, column, height, width):
    polar, longitude = math.pi * (row + 0.5) / height, 2 * math.pi * (column + 0.5) / width - math.pi
    return math.sin(polar) * math.sin(longitude), math.cos(polar), math.sin(polar) * math.cos(longitude)


def cube_direction(face, row, column, size):
    s, t = (2 * column + 1) / size - 1, (2 * row + 1) / size - 1
    x, y, z = ((1, -t, -s), (-1, -t, s), (s, 1, t), (s, -1, -t), (s, -t, 1), (-s, -t, -1))[face]
    length = math.sqrt(x * x + y * y + z * z)
    return x / length, y / length, z / length


def render(radiance, layout, height, width):
    """Return the map of a function of (n, 3) directions, 0 where the layout shows nothing."""
    picture = np.zeros((height, width, len(radiance(np.eye(3))[0])))
    size = {"vertical-cross": width // 3, "horizontal-cross": height // 3}.get(layout, min(height, width))
    # Face in each square of the picture; Debevec's vertical cross has the back upside down.
    squares = {
        "vertical-cross": [" 2 ", "140", " 3 ", " b "],
        "horizontal-cross": [" 2  ", "1405", " 3  "],
        "vertical-strip": list("012345"),
        "horizontal-strip": ["012345"],
    }.get(layout)
    for row in range(height):
        for column in range(width):
            if layout == "angular":
                direction = angular_direction(row, column, height)
            elif layout == "latlong":
                direction = latlong_direction(row, column, height, width)
            else:
                face = squares[row // size][column // size]
                inside = (row % size, column % size)
                if face == "b":
                    face, inside = "5", (size - 1 - inside[0], size - 1 - inside[1])
                direction = None if face == " " else cube_direction(int(face), *inside, size)
            if direction is not None:
                picture[row, column] = radiance(np.array([direction]))[0]
    return picture


def band_limited(degree, channels, seed):
    """Return a positive band-limited radiance, as a function of directions and as its coefficients."""
    rng = np.random.default_rng(seed)
    coeffs_kc = rng.standard_normal(((degree + 1) ** 2, channels)) * 0.1
    coeffs_kc[0] = 20.0
    return (lambda directions_i3: real_harmonics(directions_i3, degree) @ coeffs_kc), coeffs_kc


def irradiance(directions_t3, weights_t, radiance_tc, normals_n3):
    """Return ``sum_t w L max(0, n . s)`` (irradiance-environment-maps, eq. 1)."""
    return np.maximum(normals_n3 @ directions_t3.T, 0.0) @ (weights_t[:, None] * radiance_tc)
