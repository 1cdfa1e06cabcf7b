"""How many orders a reflectance needs, what a light makes of it (frequency-space-environment-maps, figure 6)."""

from __future__ import annotations

import os
import time
from typing import Any

import numpy as np

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import BrdfCoefficients, brdf_coefficients
from clrelight.brdf.expanded import read_coefficients
from clrelight.brdf.measured import MeasuredBrdf, read_brdf
from clrelight.brdf.named import BRDF_NAMES, as_brdf, parse_brdf
from clrelight.brdf.radial import Phong
from clrelight.device import Device
from clrelight.harmonics.index import coefficient_count, degrees_of_coefficients
from clrelight.jobs.inputs import opened_on
from clrelight.jobs.report import Report, report_for
from clrelight.lighting.environment import Environment
from clrelight.lighting.projection import project_environment
from clrelight.shrm.orders import (
    LUMINANCE,
    Accuracy,
    bilinear_error,
    crossover_exponent,
    phong_degree,
    phong_width,
    reflected_accuracy,
    sufficient_coefficients,
)

MOST_ORDER = 5
"""Orders P whose energies are told."""

_DEGREE_OF_TRUTH = 60
_TOLD_DEGREE = 30
_SAMPLES = (2, 3, 5, 10, 20)


def plan_reflection(
    brdf: CentredBrdf | str | os.PathLike[str],
    environment: Environment | None = None,
    *,
    epsilon: float = 0.03,
    degree: int = _TOLD_DEGREE,
    device: Device | str | None = None,
    report: Report | None = None,
) -> Report:
    """Return a report of the orders that a reflectance needs for an accuracy, and of their accuracy under a light.

    Its facts: ``degree`` and ``order``, the least F and P; ``rows`` and ``views``, S = 10 F and T = 10 P; ``shares``,
    the energy up to each P at F = `degree`; of Phong's lobes ``estimate``, ``width`` and ``crossover`` (section 6.3);
    of a map ``accuracy``, rows of F and of ``1 - epsilon`` of the truth, light, reflectance and bound, and, of one
    lobe, ``bilinear``, the error of lookups at S = 2, 3, 5, 10 and 20 F.

    Parameters
    ----------
    brdf : CentredBrdf, or a text as of `brdf.named.parse_brdf`
    environment : Environment, optional
    epsilon : float
    degree : int
        Largest F that is told.
    device : Device or str, optional
        Of the projection of maps that are not lat-long.
    """
    kept, brdf = report_for(report), as_brdf(brdf)
    since = time.perf_counter()
    told = _orders_of(brdf, degree)
    least = sufficient_coefficients(brdf, epsilon)
    kept.add("reflectance", since)
    facts: dict[str, Any] = {"config": brdf.to_config(), "epsilon": epsilon}
    facts |= {"degree": least.degree, "order": least.order, "share": float(least.shares()[-1, -1].min())}
    facts |= {"rows": 10 * least.degree, "views": 10 * least.order, "shares": told.shares()[-1]}
    if isinstance(brdf, Phong):
        facts |= {"estimate": phong_degree(brdf.exponent, epsilon), "width": phong_width(brdf.exponent, epsilon)}
        facts |= {"crossover": crossover_exponent(10 * least.degree)}
    if environment is not None:
        with opened_on(device, kept) as opened:
            facts |= _under(brdf, environment, degree, least.degree, opened, kept)
    kept.facts = facts
    return kept


def _orders_of(brdf: CentredBrdf, degree: int) -> BrdfCoefficients:
    return brdf_coefficients(brdf, degree, 0 if brdf.is_radial else MOST_ORDER)


def _under(
    brdf: CentredBrdf, environment: Environment, degree: int, least: int, device: Device, report: Report
) -> dict[str, Any]:
    since = time.perf_counter()
    top = min(_DEGREE_OF_TRUTH, environment.resolved_degree)
    light_kc = project_environment(environment, top, device=device).coeffs_kc
    energy = map_energy(environment)
    since = report.add("project", since)
    found = reflected_accuracy(light_kc, brdf_coefficients(brdf, top, 0 if brdf.is_radial else 8), energy)
    facts: dict[str, Any] = {"accuracy": accuracy_rows(found, min(degree, top))}
    if isinstance(brdf, Phong):
        factors = brdf.factors(least)[degrees_of_coefficients(least)]
        reflected_kc = factors[:, None] * light_kc[: coefficient_count(least)]
        facts["bilinear"] = {f"{n} F": bilinear_error(reflected_kc, n * least) for n in _SAMPLES if least}
    report.add("analyse", since)
    return facts


def map_energy(environment: Environment) -> float:
    """Return ``integral L^2 ds`` of a map's luminance, or of its one channel."""
    _, weights_t = environment.geometry()
    radiance_tc = environment.radiance_hwc.reshape(len(weights_t), -1).astype(np.float64)
    value_t = radiance_tc @ LUMINANCE if radiance_tc.shape[1] == 3 else radiance_tc[:, 0]
    return float(weights_t @ value_t**2)


def accuracy_rows(found: Accuracy, degree: int) -> list[list[float]]:
    """Return rows of F, and ``1 - epsilon`` of the truth, the light, the reflectance and the bound."""
    columns = (found.reflected_l, found.light_l, found.brdf_l, found.bound_l)
    return [[l, *(float(column[l]) for column in columns)] for l in range(min(degree + 1, len(found.reflected_l)))]


def describe_brdf(path: str, *, degree: int = _TOLD_DEGREE, report: Report | None = None) -> Report:
    """Return a report of a ``.brdf`` file: its measurements, and the energy up to each order P.

    Of a ``.json`` file that `reflection_estimate` wrote, or a text as of `brdf.named.parse_brdf`: its orders, and the
    energy up to each.
    """
    kept = report_for(report)
    since = time.perf_counter()
    is_named = path.partition(":")[0] in BRDF_NAMES
    if is_named or path.lower().endswith(".json"):
        held = _orders_of(parse_brdf(path), degree) if is_named else read_coefficients(path)
        kept.add("reflectance" if is_named else "read", since)
        kept.facts = {"file": path, "degree": held.degree, "order": held.order, "centre": held.centre}
        kept.facts |= {"channels": held.channels, "shares": held.shares()[-1], "energy": held.energy_c}
        kept.facts |= {"config": dict(held.config)}
        return kept
    samples = read_brdf(path)
    since = kept.add("read", since)
    found = brdf_coefficients(MeasuredBrdf(samples), degree, MOST_ORDER)
    kept.add("reflectance", since)
    theta_j2 = np.degrees(samples.angles_j4[:, [0, 2]])
    wavelengths = samples.wavelength_w
    kept.facts = {"file": path, "pairs": len(samples.angles_j4), "wavelengths": wavelengths.tolist()}
    kept.facts |= {"light_degrees": [theta_j2[:, 0].min(), theta_j2[:, 0].max()]}
    kept.facts |= {"view_degrees": [theta_j2[:, 1].min(), theta_j2[:, 1].max()]}
    kept.facts |= {"least": float(samples.spectra_jw.min()), "largest": float(samples.spectra_jw.max())}
    kept.facts |= {"degree": degree, "shares": found.shares()[-1], "energy": found.energy_c}
    return kept
