"""Light from everywhere, as the page turns it: coefficients about their own zenith, and what a picture sees of them."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count, cosine_indices
from clrelight.lighting.environment import read_environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.lighting.sky import sky_light
from clrelight.store import read_light
from clrelight.view.sources import floats_text

SKIES = {"clear": 19, "partly-cloudy": 19, "overcast": 1}
"""Skies of the CIE that the page offers, and of how many heights of the sun from 0 to 90 degrees it has each."""
_TABLE = "skies.npy"
_LEAST_DEGREE, MOST_DEGREE = 12, 20


def light_degree(degrees: Sequence[int]) -> int:
    """Return the degree of lights for fits of some degrees: the horizon mixes what lies beyond a fit's own."""
    return min(max(_LEAST_DEGREE, *degrees), MOST_DEGREE)


def sun_heights(count: int) -> NDArray[np.float64]:
    """Return the heights of the sun, in degrees, between which the page interpolates; the zenith where it is one."""
    return np.linspace(0.0, 90.0, count) if count > 1 else np.array([90.0])


def make_sky_table() -> NDArray[np.float32]:
    """Return skies (sky and height, n_coeff), the sun at azimuth 0, of total 1: what ``skies.npy`` holds.

    It takes seconds, which nobody should wait for: ``python -m benchmarks.viewer skies`` writes that file.
    """
    rows = [
        _normalised(sky_light(name, height, degree=MOST_DEGREE), 1.0).coeffs_kc[:, 0]
        for name, count in SKIES.items()
        for height in sun_heights(count)
    ]
    return np.array(rows, np.float32)


def sky_tables(degree: int) -> list[dict[str, Any]]:
    """Return the skies up to a degree as the page takes them: orders from 0 on, for the sun is at azimuth 0."""
    with resources.files("clrelight.view").joinpath(_TABLE).open("rb") as file:
        table_sk = np.load(file)[:, cosine_indices(degree)]
    tables, first = [], 0
    for name, count in SKIES.items():
        rows = table_sk[first : first + count]
        tables.append({"name": name, "heights": sun_heights(count).tolist(), "table": floats_text(rows)})
        first += count
    return tables


def read_surroundings(
    path: str | os.PathLike[str], degree: int, device: Callable[[], Device]
) -> tuple[dict[str, Any], list[str]]:
    """Return an environment, an image or a light file, as the page takes it, and notes; of total 2.

    InputError where it is neither, or dark.
    """
    name = os.fspath(path)
    notes: list[str] = []
    if str(name).lower().endswith((".h5", ".hdf5")):
        light = read_light(path)
        count = coefficient_count(degree)
        cut_kc = np.zeros((count, light.channels))
        cut_kc[: len(light.coeffs_kc)] = light.coeffs_kc[:count]
        light = replace(light, coeffs_kc=cut_kc)
    else:
        environment, notes = read_environment(path)
        light = project_environment(environment, degree, device=device())
    if not light.coeffs_kc[0].sum() > 0:
        raise InputError(f"{name}: no light comes from it")
    made = _normalised(light, 2.0)
    label = os.path.splitext(os.path.basename(name))[0]
    return {"name": label, "channels": made.channels, "table": floats_text(made.coeffs_kc)}, notes


def _normalised(light: Light, total: float) -> Light:
    """Return a light whose integral over the sphere, the mean over its channels, is `total`.

    Where 1 of it comes from above the horizon, pictures are about as bright as under a lamp of unit strength.
    """
    found = float(light.coeffs_kc[0].mean()) * math.sqrt(4.0 * math.pi)
    return replace(light, coeffs_kc=light.coeffs_kc * (total / found))
