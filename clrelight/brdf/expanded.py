"""Reflectances that are known by their coefficients, as estimates are, and the files that hold them."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CENTRES, CentredBrdf
from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.durable import replacing
from clrelight.errors import InputError

SCHEMA = "brdf-coefficients/1"
_MOST_BYTES = 1 << 28


@dataclass(frozen=True, eq=False)
class ExpandedBrdf(CentredBrdf):
    """What coefficients add up to; it has no others, and its own are all its energy.

    Attributes
    ----------
    coefficients : BrdfCoefficients
    """

    coefficients: BrdfCoefficients = field(repr=False)

    id: ClassVar[str] = "coefficients"

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", self.coefficients.centre)
        object.__setattr__(self, "is_radial", self.coefficients.order == 0)
        object.__setattr__(self, "has_azimuth", self.coefficients.has_azimuth)

    @property
    def channels(self) -> int:
        """1 or 3."""
        return self.coefficients.channels

    def expanded(self, degree: int, order: int) -> BrdfCoefficients:
        """Return the coefficients up to F and P, no more than there are."""
        held = self.coefficients
        return held.cut(min(degree, held.degree), min(order, held.order))

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`; may be negative where orders are missing."""
        angles = np.broadcast_arrays(theta_i, theta_o, phi)
        values_nc = self.coefficients.evaluate(*(np.ravel(each).astype(np.float64) for each in angles))
        return values_nc.reshape(*angles[0].shape, self.channels)

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return dict(self.coefficients.config) or {"brdf": self.id}


def own_energy(rho_lpqc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the energy (channel,) that coefficients hold: ``sum U_q rho_lpq^2``."""
    twice_q = np.where(np.arange(rho_lpqc.shape[2]) == 0, 1.0, 2.0)
    return np.asarray(np.einsum("lpqc,q->c", rho_lpqc**2, twice_q))


def write_coefficients(path: str | os.PathLike[str], coefficients: BrdfCoefficients) -> None:
    """Write coefficients as a JSON file; InputError if it cannot be written."""
    facts = {"clrelight_schema": SCHEMA, "centre": coefficients.centre, "config": dict(coefficients.config)}
    facts |= {"energy": coefficients.energy_c.tolist(), "rho_lpqc": coefficients.rho_lpqc.tolist()}
    with replacing(path) as part:
        part.write((json.dumps(facts) + "\n").encode("utf-8"))


def read_coefficients(path: str | os.PathLike[str]) -> BrdfCoefficients:
    """Read what `write_coefficients` wrote; InputError if it is anything else."""
    file = Path(path)
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise InputError(f"{file} is larger than coefficients of a reflectance are")
        held = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{file} is no JSON file") from None
    if not isinstance(held, dict) or held.get("clrelight_schema") != SCHEMA:
        raise InputError(f"{file} holds no coefficients of a reflectance: expected {SCHEMA}")
    try:
        rho_lpqc, energy_c = np.array(held["rho_lpqc"], np.float64), np.array(held["energy"], np.float64)
        if held["centre"] not in CENTRES or not isinstance(held["config"], dict):
            raise ValueError
        return BrdfCoefficients(rho_lpqc, energy_c, held["centre"], held["config"])
    except InputError as error:
        raise InputError(f"{file}: {error}") from None
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{file} is damaged: its coefficients are no table of numbers") from None
