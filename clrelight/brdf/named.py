"""Reflectances by the names and numbers that people write."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.expanded import ExpandedBrdf, read_coefficients
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.measured import MeasuredBrdf, read_brdf
from clrelight.brdf.radial import Lambert, Phong
from clrelight.errors import InputError

_MAKERS: dict[str, tuple[Callable[..., CentredBrdf], str | None]] = {
    "lambert": (Lambert, None),
    "phong": (Phong, "exponent"),
    "microfacet": (Microfacet, "sigma"),
    "kajiya-kay": (KajiyaKay, "exponent"),
    "skin": (lambda: SKIN, None),
}

BRDF_NAMES = tuple(_MAKERS)
"""Names that `make_brdf` knows; beside them, a ``.brdf`` file, or a ``.json`` file of estimated coefficients."""


def make_brdf(name: str, *, sigma: float | None = None, exponent: float | None = None) -> CentredBrdf:
    """Return the reflectance of a name of `BRDF_NAMES` or of a file, with its number where it has one.

    A ``.brdf`` file holds measurements, a ``.json`` file what `expanded.write_coefficients` wrote.

    Raises
    ------
    InputError
        If there is no such name, a number is not one of its own, or the file cannot be read.
    """
    numbers = {"sigma": sigma, "exponent": exponent}
    given = {key: value for key, value in numbers.items() if value is not None}
    if name not in _MAKERS and Path(name).suffix.lower() not in (".brdf", ".json"):
        known = ", ".join(f"{each}:{key.upper()}" if key else each for each, (_, key) in _MAKERS.items())
        raise InputError(f"a reflectance is {known}, or a .brdf or .json file, got {name!r}")
    maker, own = _MAKERS.get(name, (None, None))
    foreign = [key for key in given if key != own]
    if foreign:
        raise InputError(f"{name} takes {'no number' if own is None else own}, got {foreign[0]}")
    if maker is not None:
        return maker(**given)
    if Path(name).suffix.lower() == ".json":
        return ExpandedBrdf(read_coefficients(name))
    return MeasuredBrdf(read_brdf(name))


def parse_brdf(text: str, *, sigma: float | None = None, exponent: float | None = None) -> CentredBrdf:
    """Return the reflectance that a text such as ``microfacet:0.2``, ``skin`` or ``paint.brdf`` names.

    What stands behind the colon is the name's own number, which may be given by its own name instead. InputError as of
    `make_brdf`, and where the number comes twice.
    """
    name, colon, number = text.partition(":")
    if not colon or name not in _MAKERS:
        return make_brdf(text, sigma=sigma, exponent=exponent)
    own = _MAKERS[name][1]
    if own is None:
        raise InputError(f"{name} takes no number, got {text!r}")
    given = {key: value for key, value in (("sigma", sigma), ("exponent", exponent)) if value is not None}
    if given:
        raise InputError(f"{text} has its number behind the colon: leave {' and '.join(given)} out")
    try:
        value = float(number)
    except ValueError:
        raise InputError(f"{name} takes a number behind the colon, got {text!r}") from None
    return make_brdf(name, **{own: value})


def as_brdf(brdf: CentredBrdf | str | os.PathLike[str]) -> CentredBrdf:
    """Return a reflectance, or that of a text as of `parse_brdf`."""
    return brdf if isinstance(brdf, CentredBrdf) else parse_brdf(os.fspath(brdf))
