"""``light/1``: distant light as spherical-harmonic coefficients."""

from __future__ import annotations

import os

from clrelight.conventions import degree_of
from clrelight.errors import StoreFormatError
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
    """Read a light.

    Raises
    ------
    InputError
        If there is no such file.
    StoreFormatError
        If it holds no sound light.
    """
    with opening(path, "light") as opened, refusing(opened.path):
        return light_of(opened)


def light_of(opened: Opened) -> Light:
    """Return the light in an open file; StoreFormatError or InputError if it is not sound."""
    held = opened.attributes()
    coeffs_kc = opened.arrays["coefficients"][...]
    if degree_of(len(coeffs_kc)) != held["degree"]:
        raise StoreFormatError(f"attribute degree is {held['degree']}, but there are {len(coeffs_kc)} coefficients")
    return Light(coeffs_kc, held["source"], held["axes"], parse_config(held["config"], "config"))
