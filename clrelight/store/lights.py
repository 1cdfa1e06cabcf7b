"""``light/1``: distant light as spherical-harmonic coefficients."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import StoreFormatError
from clrelight.harmonics.index import degree_of
from clrelight.lighting.light import Light
from clrelight.store.opening import Opened, opening, parse_config, refusing
from clrelight.store.schemas import LIGHT
from clrelight.store.writing import config_text, drafting


def write_light(path: str | os.PathLike, light: Light) -> None:
    """Write a light; InputError if the file cannot be written."""
    with drafting(path, LIGHT, 2 * light.coeffs_kc.nbytes) as draft:
        draft.attributes({"degree": light.degree, "source": light.source, "axes": light.axes})
        draft.attributes({"config": config_text(light.config)})
        draft.dataset("coefficients", light.coeffs_kc, ("coefficient", "channel"))


def read_light(path: str | os.PathLike) -> Light:
    """Read a light; errors as of `open_fit`."""
    with opening(path, "light") as opened, refusing(opened.path):
        return light_of(opened)


def light_of(opened: Opened) -> Light:
    """Return the light in an open file; StoreFormatError or InputError if it is not sound."""
    held = opened.attributes()
    coeffs_kc = opened.arrays["coefficients"][...]
    if degree_of(len(coeffs_kc)) != held["degree"]:
        raise StoreFormatError(f"attribute degree is {held['degree']}, but there are {len(coeffs_kc)} coefficients")
    config = parse_config(held["config"], "config")
    _check_config(config)
    return Light(coeffs_kc, held["source"], held["axes"], config)


def _check_config(config: dict[str, Any]) -> None:
    """Refuse what turning or shading the light would add to, where it is not as they write it."""
    from clrelight.harmonics.rotation import nearest_rotation

    shadows = _numbers(config.get("shadows", []))
    if shadows is None or not (shadows.size == 0 or shadows.shape[1:] == (4,)):
        raise StoreFormatError("attribute config: shadows must be rows of X, Y, Z, ANGLE")
    if "rotation" in config:
        rotation = _numbers(config["rotation"])
        if rotation is None:
            raise StoreFormatError("attribute config: a rotation is an orthogonal 3 by 3 matrix of determinant 1")
        nearest_rotation(rotation)


def _numbers(value: Any) -> NDArray[np.float64] | None:
    """Return finite numbers in lists of equal lengths as an array, None if they are anything else."""
    if not isinstance(value, list):
        return None
    try:
        numbers = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        return None
    return numbers if np.isfinite(numbers).all() else None
