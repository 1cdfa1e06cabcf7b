"""Reflectances by the names and numbers that people write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
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
"""Names that `make_brdf` knows; beside them, a ``.brdf`` file."""


def make_brdf(name: str, *, sigma: float | None = None, exponent: float | None = None) -> CentredBrdf:
    """Return the reflectance of a name of `BRDF_NAMES` or of a ``.brdf`` file, with its number where it has one.

    Raises
    ------
    InputError
        If there is no such name, a number is not one of its own, or the file cannot be read.
    """
    numbers = {"sigma": sigma, "exponent": exponent}
    given = {key: value for key, value in numbers.items() if value is not None}
    if name not in _MAKERS and Path(name).suffix.lower() != ".brdf":
        raise InputError(f"a reflectance is {', '.join(BRDF_NAMES)} or a .brdf file, got {name!r}")
    maker, own = _MAKERS.get(name, (None, None))
    foreign = [key for key in given if key != own]
    if foreign:
        raise InputError(f"{name} takes {'no number' if own is None else own}, got {foreign[0]}")
    return MeasuredBrdf(read_brdf(name)) if maker is None else maker(**given)
