"""Lights as JSON: nine coefficients of red, green and blue, as three.js and engines take light probes."""

from __future__ import annotations

import json
import os

import numpy as np

from clrelight.durable import replacing
from clrelight.lighting.light import Light

COUNT = 9


def write_light_json(light: Light, out: str | os.PathLike[str]) -> None:
    """Write the coefficients of radiance up to degree 2; those of higher degrees are left out, as irradiance has none.

    ``sh`` is what ``SphericalHarmonics3.fromArray`` of three.js takes: 27 numbers, red, green and blue of each.
    InputError if the file cannot be written.
    """
    coeffs_kc = np.zeros((COUNT, light.channels))
    found = light.coeffs_kc[:COUNT]
    coeffs_kc[: len(found)] = found
    told = {
        "sh": np.repeat(coeffs_kc, 3 // light.channels, axis=1).ravel().tolist(),
        "order": "l, m = 0,0 1,-1 1,0 1,1 2,-2 2,-1 2,0 2,1 2,2; red, green, blue of each",
        "basis": "real spherical harmonics, orthonormal on the sphere, no Condon-Shortley sign",
        "axes": "x right, y up, z to the camera where the light was made for pictures",
        "quantity": "radiance",
        "source": light.source,
    }
    with replacing(out) as part:
        part.write((json.dumps(told, indent=1) + "\n").encode())
