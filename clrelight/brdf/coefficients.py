"""Coefficients rho_lpq of a reflectance by sums over one angle after the other, and how its energy falls to orders."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.radial import Phong
from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE, legendre_tables

MAX_ORDER = 32
"""Largest order P of the view."""

MOST_ANGLES = 1024
"""Of ``theta_i``, that a lobe may take: nodes of more would take seconds, and maps show a mirror long before."""
_VALUES_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class Resolution:
    """How many angles a reflectance is sampled at: S of ``theta_i``, T of ``theta_o``, and azimuths in 0 .. pi."""

    light: int
    view: int
    azimuth: int

    def __post_init__(self) -> None:
        if min(self.light, self.view, self.azimuth) < 1:
            raise InputError(f"a reflectance is sampled at 1 angle or more of each kind, got {self}")


@dataclass(frozen=True)
class BrdfCoefficients:
    """Coefficients of a reflectance in angles from its central direction; checked when made.

    ``rho(theta_i, theta_o, phi) = sum_lpq U_q rho_lpq f_lq(theta_i) f_pq(theta_o) cos(q phi)``, with U_0 = 1 and else 2
    (frequency-space-environment-maps, eq. 13), where f_lq is the part in theta of a complex harmonic.

    Attributes
    ----------
    rho_lpqc : ndarray, shape (F + 1, P + 1, P + 1, channel), float64
        0 where q exceeds l or p.
    energy_c : ndarray, shape (channel,), float64
        Integral of the square over light and view: what `rho_lpqc` of all orders would hold.
    centre : str
        One of `centred.CENTRES`.
    config : mapping
        What it is of, JSON values only.
    """

    rho_lpqc: NDArray[np.float64]
    energy_c: NDArray[np.float64]
    centre: str = "reflection"
    config: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shape = self.rho_lpqc.shape
        if len(shape) != 4 or shape[1] != shape[2] or shape[3] not in (1, 3) or self.energy_c.shape != shape[3:]:
            raise InputError(f"coefficients of a reflectance are (F + 1, P + 1, P + 1, 1 or 3), got {shape}")
        if not np.isfinite(self.rho_lpqc).all():
            raise InputError("coefficients of a reflectance must be finite numbers")

    @property
    def degree(self) -> int:
        """F, the largest l."""
        return self.rho_lpqc.shape[0] - 1

    @property
    def order(self) -> int:
        """P, the largest p."""
        return self.rho_lpqc.shape[1] - 1

    @property
    def channels(self) -> int:
        """1 or 3."""
        return self.rho_lpqc.shape[3]

    @property
    def has_azimuth(self) -> bool:
        """Whether a coefficient of q > 0 is not 0."""
        return bool(self.rho_lpqc[:, :, 1:].any())

    def cut(self, degree: int, order: int) -> BrdfCoefficients:
        """Return the coefficients up to a degree and an order, no more than there are."""
        if not (0 <= degree <= self.degree and 0 <= order <= self.order):
            raise InputError(f"there are orders F = {self.degree}, P = {self.order}, got {degree}, {order}")
        part = self.rho_lpqc[: degree + 1, : order + 1, : order + 1].copy()
        return BrdfCoefficients(part, self.energy_c, self.centre, self.config)

    def shares(self) -> NDArray[np.float64]:
        """Return the part of the energy up to each F and P, (F + 1, P + 1, channel) float64: ``1 - epsilon`` (5.1)."""
        twice_q = np.where(np.arange(self.order + 1) == 0, 1.0, 2.0)
        square_lpc = np.einsum("lpqc,q->lpc", self.rho_lpqc**2, twice_q)
        total_c = np.where(self.energy_c > 0.0, self.energy_c, 1.0)
        return np.cumsum(np.cumsum(square_lpc, axis=0), axis=1) / total_c

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the values (n, channel) of the sum at angles (n,)."""
        light, view = theta_tables(theta_i, self.degree), theta_tables(theta_o, self.order)
        values_nc = np.zeros((len(theta_i), self.channels))
        for q in range(min(self.order, self.degree) + 1):
            rho_lpc = self.rho_lpqc[q:, q:, q]
            wave_n = (1.0 if q == 0 else 2.0) * np.cos(q * phi)
            values_nc += np.einsum("ln,pn,lpc,n->nc", light[q], view[q], rho_lpc, wave_n, optimize=True)
        return values_nc


def theta_tables(theta_h: NDArray[np.float64], degree: int) -> list[NDArray[np.float64]]:
    """Return, for q = 0 .. degree, the rows l = q .. degree of ``f_lq(theta)``, each (degree + 1 - q, n) float64.

    ``f_lq e^(i q phi)`` is a complex harmonic. The signs are those without Condon and Shortley's:
    in products of two of one q they do not matter.
    """
    tables = legendre_tables(theta_h, degree)
    return [table if q == 0 else table * np.sqrt(0.5) for q, table in enumerate(tables)]


def default_resolution(degree: int, order: int) -> Resolution:
    """Return a resolution that holds the energies of orders to some 1e-4: four samples a wave, and what edges need."""
    return Resolution(max(3 * degree, 48) + 16, 4 * order + 24, 4 * order + 24)


@functools.lru_cache(maxsize=8)
def theta_rule(count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return angles in 0 .. pi and weights of ``integral f sin(theta) dtheta``: Gauss's rule in theta, (count,) each.

    Its nodes lie close near 0, where lobes about the central direction are narrow.
    """
    node, weight = np.polynomial.legendre.leggauss(count)
    theta = 0.5 * np.pi * (node + 1.0)
    return theta, 0.5 * np.pi * weight * np.sin(theta)


def brdf_coefficients(
    brdf: CentredBrdf, degree: int, order: int, resolution: Resolution | None = None
) -> BrdfCoefficients:
    """Return the coefficients of a reflectance in O(P S T^2) steps (frequency-space-environment-maps, appendix C).

    First the azimuth, ``rho_q = 2 pi integral rho cos(q phi) dphi``, then the view, ``rho_pq = integral rho_q f_pq``,
    last the light, ``rho_lpq = integral rho_pq f_lq``. Lambert's and Phong's have a closed form, and reflectances
    that are known by coefficients (`expanded`) have these, no more than there are.

    Parameters
    ----------
    brdf : CentredBrdf
    degree : int
        F, the largest l, 0 to `harmonics.basis.MAX_DEGREE`.
    order : int
        P, the largest p, 0 to `MAX_ORDER`.
    resolution : Resolution, optional
        By default `default_resolution` of the orders, with as many angles ``theta_i`` as its lobes take.

    Raises
    ------
    InputError
        If an order is too high, or a lobe so narrow that it takes more than `MOST_ANGLES`.
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"the degree F must be 0 to {MAX_DEGREE}, got {degree}")
    if not 0 <= order <= MAX_ORDER:
        raise InputError(f"the order P must be 0 to {MAX_ORDER}, got {order}")
    if hasattr(brdf, "expanded"):
        known: BrdfCoefficients = brdf.expanded(degree, order)
        return known
    if isinstance(brdf, Phong):
        rho_lpqc = np.zeros((degree + 1, order + 1, order + 1, 1))
        rho_lpqc[:, 0, 0, 0] = np.sqrt(2.0 * np.arange(degree + 1) + 1.0) * brdf.factors(degree)
        return BrdfCoefficients(rho_lpqc, np.array([brdf.energy]), brdf.centre, brdf.to_config())
    size = resolution or _resolution_of(brdf, degree, order)
    theta_i, weight_i = theta_rule(size.light)
    theta_o, weight_o = theta_rule(size.view)
    azimuths = size.azimuth if brdf.has_azimuth else 1
    phi_a = np.asarray((np.arange(azimuths) + 0.5) * (np.pi / azimuths), np.float64)
    wave_qa = 4.0 * np.pi * (np.pi / azimuths) * np.cos(np.outer(np.arange(order + 1), phi_a))
    view = theta_tables(theta_o, order)
    rho_pqic = np.zeros((order + 1, order + 1, size.light, brdf.channels))
    square_c = np.zeros(brdf.channels)
    for part in _slabs(size.view, size.light * azimuths * brdf.channels):
        values_oiac = brdf.evaluate(theta_i[:, None], theta_o[part, None, None], phi_a)
        area_oia = weight_o[part, None, None] * (weight_i[:, None] * np.full(azimuths, wave_qa[0, 0]))
        square_c += np.einsum("oiac,oiac,oia->c", values_oiac, values_oiac, area_oia, optimize=True)
        rho_oiqc = np.einsum("oiac,qa->oiqc", values_oiac, wave_qa, optimize=True)
        for q in range((order if brdf.has_azimuth else 0) + 1):
            rho_pqic[q:, q] += np.einsum("po,o,oic->pic", view[q][:, part], weight_o[part], rho_oiqc[:, :, q])
    light = theta_tables(theta_i, degree)
    rho_lpqc = np.zeros((degree + 1, order + 1, order + 1, brdf.channels))
    for q in range(min(order if brdf.has_azimuth else 0, degree) + 1):
        rho_lpqc[q:, q:, q] = np.einsum("li,i,pic->lpc", light[q], weight_i, rho_pqic[q:, q], optimize=True)
    return BrdfCoefficients(rho_lpqc, square_c, brdf.centre, brdf.to_config())


def _resolution_of(brdf: CentredBrdf, degree: int, order: int) -> Resolution:
    if brdf.least_angles > MOST_ANGLES:
        raise InputError(
            f"lobes of {brdf.to_config()} are too narrow for coefficients: they take {brdf.least_angles:.4g} angles, "
            f"{MOST_ANGLES} at most can be summed; take a greater roughness or a smaller exponent"
        )
    size = default_resolution(degree, order)
    return replace(size, light=max(size.light, brdf.least_angles))


def _slabs(count: int, each: int) -> list[slice]:
    """Return slices of 0 .. count whose parts hold `_VALUES_AT_ONCE` values at most, or one row."""
    step = max(1, _VALUES_AT_ONCE // max(each, 1))
    return [slice(first, min(first + step, count)) for first in range(0, count, step)]
