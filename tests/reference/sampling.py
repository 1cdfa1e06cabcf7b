"""Float64 references for light sampling: cell areas by counting, and by SciPy's spherical Voronoi diagram."""

import numpy as np
from scipy.spatial import SphericalVoronoi


def count_solid_angles(directions_i3, n_point=200_000, sphere=False):
    """Areas of the nearest-neighbour cells, by counting the points of a spiral of equal areas."""
    step = np.arange(n_point) + 0.5
    z = 1.0 - step * (2.0 if sphere else 1.0) / n_point
    azimuth = step * np.pi * (1.0 + np.sqrt(5.0))
    radius = np.sqrt(1.0 - z * z)
    points = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
    area_i = np.zeros(len(directions_i3))
    for block in np.array_split(points, 50):
        area_i += np.bincount(np.argmax(block @ directions_i3.T, axis=1), minlength=len(directions_i3))
    return area_i * ((4.0 if sphere else 2.0) * np.pi / n_point)


def voronoi_solid_angles(directions_i3):
    """Cell areas of lights above the horizon: with their mirror images below, no cell crosses z = 0.

    Only for sets in general position, which is all that SciPy's diagram can do.
    """
    mirrored = directions_i3 * np.array([1.0, 1.0, -1.0])
    return SphericalVoronoi(np.concatenate([directions_i3, mirrored])).calculate_areas()[: len(directions_i3)]
