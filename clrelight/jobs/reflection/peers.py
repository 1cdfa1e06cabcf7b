"""How near reflection maps and earlier methods come to integration over angles.

frequency-space-environment-maps, figures 7, 9 and 10.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.harmonics.latlong import project_latlong
from clrelight.jobs.reflection.bench import square_light
from clrelight.lighting.light import Light
from clrelight.shrm.angular import integrate_directions
from clrelight.shrm.explicit import (
    icosahedron,
    interpolate_icosahedron,
    interpolate_texture,
    view_map,
    view_texture,
)
from clrelight.shrm.lookup import local_views
from clrelight.shrm.prefilter import build_shrm, to_global
from clrelight.shrm.record import grid_directions

VIEWS = ((0.36, -0.8, 0.48), (-0.6, -0.48, 0.64), (0.0, -0.96, -0.28))
"""Distant views that are compared: none is a vertex of the icosahedron."""

_TEXTURE_ANGLES = 64
_TEXTURE_ORDER = 12


def compare_peers(
    light: Light,
    brdf: CentredBrdf,
    *,
    orders: Sequence[int] = (0, 1, 2, 3, 4, 5),
    degree: int = 30,
    texels: int = 64,
    rows: int = 16,
    views: Sequence[Sequence[float]] = VIEWS,
) -> dict[str, Any]:
    """Return relative RMS errors over maps of some views, by each order P and by the two earlier methods.

    ``orders``: by P, with the share of the reflectance's energy; ``texture``: Kautz and McCool's 3-D texture, what
    q = 0 holds of order `_TEXTURE_ORDER`; ``icosahedron``: Cabral's twelve maps, integrated over angles and weighed.

    Parameters
    ----------
    light : Light
        Taken as a map of `texels` × `texels`; up to ``(texels - 1) / 2``.
    brdf : CentredBrdf
    orders : sequence of int
    degree : int
        F of all reflection maps.
    texels, rows : int
        Rows of the light's map, and of the maps that are compared (which have ``2 degree + 1`` columns).
    views : sequence of three numbers
    """
    map_hwc, directions_t3, weighted_tc = square_light(light, texels)
    projected = Light(project_latlong(map_hwc, degree))
    width = 2 * degree + 1
    central_n3 = grid_directions(rows, width).reshape(-1, 3)

    def integrate(view: NDArray[np.float64]) -> NDArray[np.float64]:
        found_nc = integrate_directions(directions_t3, weighted_tc, brdf, central_n3, view)
        return found_nc.reshape(rows, width, -1)

    distant = [np.asarray(view, np.float64) / np.linalg.norm(view) for view in views]
    truths = [integrate(view) for view in distant]
    high = brdf_coefficients(brdf, degree, max(_TEXTURE_ORDER, *orders))
    local = build_shrm(projected, high.cut(degree, _TEXTURE_ORDER), rows, width)
    theta_o = np.linspace(0.0, np.pi, _TEXTURE_ANGLES)
    texture = view_texture(local, theta_o)
    twelve = np.stack([integrate(vertex) for vertex in icosahedron()[0]])
    # Rows have their solid angles: those near the poles are small.
    weight_h11 = np.sin(local.angles()[0])[:, None, None]

    def error(maps: Sequence[NDArray]) -> float:
        off = sum(float((weight_h11 * (a - b) ** 2).sum()) for a, b in zip(maps, truths, strict=True))
        return float(np.sqrt(off / sum(float((weight_h11 * b**2).sum()) for b in truths)))

    by_order = {}
    for order in orders:
        shrm = to_global(build_shrm(projected, high.cut(degree, order), rows, width))
        share = float(high.cut(degree, order).shares()[-1, -1].mean())
        by_order[order] = {"error": error([view_map(shrm, view) for view in distant]), "share": share}
    angles = [np.arccos(np.clip(local_views(local, view)[..., 2], -1.0, 1.0)) for view in distant]
    return {
        "brdf": brdf.to_config()["brdf"],
        "orders": by_order,
        "texture": error([interpolate_texture(texture, theta_o, angle) for angle in angles]),
        "icosahedron": error([interpolate_icosahedron(twelve, view) for view in distant]),
    }
