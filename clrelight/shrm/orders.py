"""How many coefficients and samples are needed: energy up to orders, bounds, widths and costs.

Sections and figures are those of frequency-space-environment-maps (5 and 6).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_of, degrees_of_coefficients
from clrelight.harmonics.latlong import synthesize_latlong
from clrelight.harmonics.montecarlo import sample_sphere
from clrelight.shrm.lookup import look_up
from clrelight.shrm.record import grid_directions

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of linear sRGB (IEC 61966-2-1): energies of coloured light are those of its luminance."""

_PLACES = 40_000
_TRIALS = ((32, 4), (64, 8), (100, 16))
"""Orders F and P that are tried for an accuracy, one pair after the other."""


def luminance(values_kc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (n, 1) of 1 or 3 channels."""
    return values_kc @ LUMINANCE[:, None] if values_kc.shape[1] == 3 else values_kc


def degree_energies(light_kc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return ``sum_m L_lm^2`` of each degree, summed over channels, (degree + 1,)."""
    energies_k = np.sum(light_kc**2, axis=1)
    return np.bincount(degrees_of_coefficients(degree_of(len(light_kc))), weights=energies_k).astype(np.float64)


@dataclass(frozen=True)
class Accuracy:
    """Part of the reflected energy that orders up to F = 0, 1, ... hold, ``1 - epsilon``, and estimates of it (fig. 6).

    Attributes
    ----------
    reflected_l : ndarray, shape (degree + 1,)
        The truth, taken the largest degree as all.
    light_l, brdf_l : ndarray, shape (degree + 1,)
        Of the light alone, whose energy beyond its degree counts where it is known, and of the reflectance alone.
    bound_l : ndarray, shape (degree + 1,)
        What the residual energy guarantees (appendix B); 0 where nothing.
    """

    reflected_l: NDArray[np.float64]
    light_l: NDArray[np.float64]
    brdf_l: NDArray[np.float64]
    bound_l: NDArray[np.float64]

    @property
    def least_l(self) -> NDArray[np.float64]:
        """``1 - min(epsilon_light, epsilon_brdf)``: the paper's first estimate."""
        return np.maximum(self.light_l, self.brdf_l)


def reflected_accuracy(
    light_kc: NDArray[np.float64], brdf: BrdfCoefficients, light_energy: float | None = None
) -> Accuracy:
    """Return how much of the reflected energy each degree F holds, and what light and reflectance alone say of it.

    ``|B_lmpq|^2 = Lambda_l^2 |L_lm|^2 rho_lpq^2``, with ``Lambda_l^2 = 4 pi / (2 l + 1)``. In the worst case all that
    both hold beyond F lies in degree F + 1: ``B_res = Lambda_(F+1)^2 (epsilon_L L) (epsilon_rho rho)``, ``epsilon_B``
    at most ``B_res / (sum_(l <= F) |B|^2 + B_res)`` (appendix B, which prints Lambda for its square).

    Parameters
    ----------
    light_kc : ndarray, shape (n_coeff, channel)
        Of several channels, the luminance counts; the reflectance's first channel does where it has one.
    brdf : BrdfCoefficients
        Of all p that it needs.
    light_energy : float, optional
        ``integral L^2 ds``; by default what the coefficients hold.
    """
    rho_l, rho_total = degree_weights(brdf)
    light_l = degree_energies(luminance(light_kc))
    degree = min(len(rho_l), len(light_l)) - 1
    rho_l, light_l = rho_l[: degree + 1], light_l[: degree + 1]
    light_total = float(light_l.sum()) if light_energy is None else light_energy
    squared_l = 4.0 * np.pi / (2.0 * np.arange(degree + 2) + 1.0)
    reflected_l = squared_l[:-1] * light_l * rho_l
    left_light = np.maximum(1.0 - np.cumsum(light_l) / light_total, 0.0)
    left_brdf = np.maximum(1.0 - np.cumsum(rho_l) / rho_total, 0.0)
    residual_l = squared_l[1:] * left_light * light_total * left_brdf * rho_total
    held_l = np.cumsum(reflected_l)
    return Accuracy(held_l / held_l[-1], 1.0 - left_light, 1.0 - left_brdf, held_l / (held_l + residual_l))


def degree_weights(brdf: BrdfCoefficients) -> tuple[NDArray[np.float64], float]:
    """Return ``sum_pq rho_lpq^2`` of each degree, (degree + 1,), mean over channels, and the whole energy."""
    twice_q = np.where(np.arange(brdf.order + 1) == 0, 1.0, 2.0)
    return np.einsum("lpqc,q->l", brdf.rho_lpqc**2, twice_q) / brdf.channels, float(brdf.energy_c.mean())


def minimal_orders(brdf: BrdfCoefficients, epsilon: float) -> tuple[int, int]:
    """Return the least P, then the least F, at which a reflectance lacks at most `epsilon` of its energy (5.1, app. C).

    Of several channels the worst one decides. InputError where even all coefficients lack more.
    """
    if not 0.0 < epsilon < 1.0:
        raise InputError(f"epsilon must be above 0 and below 1, got {epsilon!r}")
    enough_lp = brdf.shares().min(axis=2) >= 1.0 - epsilon
    if not enough_lp[-1, -1]:
        held = float(brdf.shares()[-1, -1].min())
        raise InputError(
            f"orders up to F = {brdf.degree}, P = {brdf.order} hold {held:.4f} of the reflectance's energy, "
            f"less than 1 - epsilon = {1.0 - epsilon:g}: ask for more orders or a larger epsilon"
        )
    order = int(np.argmax(enough_lp[-1]))
    return int(np.argmax(enough_lp[:, order])), order


def sufficient_coefficients(brdf: CentredBrdf, epsilon: float) -> BrdfCoefficients:
    """Return a reflectance's coefficients of the least orders that lack at most `epsilon` (appendix C).

    Few orders are tried first, more where they do not suffice.
    """
    for degree, order in _TRIALS:
        found = brdf_coefficients(brdf, degree, 0 if brdf.is_radial else order)
        if found.shares()[-1, -1].min() >= 1.0 - epsilon or (degree, order) == _TRIALS[-1]:
            break
    return found.cut(*minimal_orders(found, epsilon))


def phong_degree(exponent: float, epsilon: float) -> float:
    """Return ``F = sqrt(-s ln(epsilon))``, about which a Phong lobe lacks `epsilon` of its energy (appendix D)."""
    if not 0.0 < epsilon < 1.0:
        raise InputError(f"epsilon must be above 0 and below 1, got {epsilon!r}")
    return math.sqrt(-exponent * math.log(epsilon))


def phong_width(exponent: float, epsilon: float) -> float:
    """Return ``W = (1 - epsilon^(1 / (s + 1))) / 2``, the part of the sphere that a Phong lobe fills (appendix D)."""
    return 0.5 * (1.0 - epsilon ** (1.0 / (exponent + 1.0)))


def crossover_exponent(rows: int) -> float:
    """Return ``s* = S^(4/3)``, above which integrating a Phong lobe over S × S texels costs less than orders (6.3)."""
    return float(rows) ** (4.0 / 3.0)


def bilinear_error(coeffs_kc: NDArray[np.float64], rows: int, seed: int = 0) -> float:
    """Return the error of looking a band-limited function up in a map of S × S texels, as a part of its norm.

    Parameters
    ----------
    coeffs_kc : ndarray, shape (n_coeff, channel)
        Of several channels, the luminance counts.
    rows : int
        S, rows and columns of the lat-long map.
    seed : int
        Of the directions where it is compared.
    """
    values_kc = luminance(coeffs_kc)
    degree = degree_of(len(values_kc))
    if rows > 2 * degree:
        map_hwc = synthesize_latlong(values_kc, rows, rows)
    else:
        map_hwc = (evaluate_basis(grid_directions(rows, rows).reshape(-1, 3), degree) @ values_kc).reshape(
            rows, rows, 1
        )
    places_n3 = sample_sphere(_PLACES, seed=seed)
    exact_nc = evaluate_basis(places_n3, degree) @ values_kc
    return float(np.linalg.norm(look_up(map_hwc, places_n3) - exact_nc) / np.linalg.norm(exact_nc))
