"""How many Haar wavelets, or spherical harmonics, hold the light of probes and points; see `benchmarks.bases`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.lighting import Table
from clrelight.bases.haar import (
    HEMISPHERE,
    analyse,
    cells_of,
    evaluate_haar,
    integrate_triple,
    keep_largest,
    synthesise,
    terms_for_energy,
)
from clrelight.bases.octahedral import cell_nodes, sphere_to_square, square_to_sphere
from clrelight.device import Device
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.layouts import texel_geometry
from clrelight.lighting.lookup import look_up
from clrelight.lighting.projection import project_environment

PROBES = {
    "Grace Cathedral": ("grace_cross.hdr", "z-up"),
    "Beach": ("beach_probe.hdr", "z-up"),
    "Galileo's tomb": ("galileo_cross.dds", "z-up"),
}
LEVEL = 7
SHARES = (0.9, 0.99, 0.999)
SH_DEGREE = 100
_PER_CELL = 4
SPHERE = 4.0 * np.pi


def light_parts(data: Path, device: Device) -> dict[str, Table]:
    """Return the tables of light, by name."""
    found = {}
    for name, (file, axes) in PROBES.items():
        path = data / "probes" / file
        if path.is_file():
            found[name] = read_environment(path, axes=axes)[0]
    return {"energy": energy_table(found, device), "triple": triple_table(found)}


def on_sphere(environment: Environment, level: int = LEVEL) -> NDArray[np.float64]:
    """Return the means over cells of the sphere's square, (side, side, channel)."""
    side, fine = 1 << level, (1 << level) * _PER_CELL
    at = (np.arange(fine) + 0.5) * (2.0 / fine) - 1.0
    v, u = np.meshgrid(at, at, indexing="ij")
    values = look_up(environment, square_to_sphere(np.stack([u.ravel(), v.ravel()], axis=1)))
    return values.reshape(side, _PER_CELL, side, _PER_CELL, -1).mean(axis=(1, 3), dtype=np.float64)


def as_latlong(values_yxc: NDArray[np.float64], height: int = 1024) -> Environment:
    """Return the same function, constant over cells, as a map that harmonics are projected from."""
    directions_t3, _ = texel_geometry("latlong", height, 2 * height)
    row, column = cells_of(sphere_to_square(directions_t3.reshape(-1, 3)), len(values_yxc))
    return Environment(values_yxc[row, column].reshape(height, 2 * height, -1).astype(np.float32), "latlong")


def on_hemisphere(environment: Environment, level: int = LEVEL) -> NDArray[np.float64]:
    """Return the means over cells of the upper hemisphere's square, (side, side, channel)."""
    side = 1 << level
    nodes = cell_nodes(side, 2)
    values = look_up(environment, nodes.reshape(-1, 3))
    return values.reshape(side, side, nodes.shape[2], -1).mean(axis=2, dtype=np.float64)


def energy_table(probes: dict[str, Environment], device: Device) -> Table:
    """Return the fewest functions that hold shares of a light's energy, all colours together."""
    rows = []
    for name, environment in probes.items():
        values = on_sphere(environment)
        coeffs_kc = analyse(values, SPHERE)
        harmonics_kc = project_environment(as_latlong(values), SH_DEGREE, device=device).coeffs_kc
        energy_l = np.bincount(degrees_of_coefficients(SH_DEGREE), weights=(harmonics_kc**2).sum(axis=1))
        held_l = np.cumsum(energy_l) / (coeffs_kc**2).sum()
        rows.append([name, *(f"{terms_for_energy(coeffs_kc, share)}" for share in SHARES)])
        for share in SHARES:
            degree = int(np.searchsorted(held_l, share))
            told = f"{(degree + 1) ** 2}" if degree <= SH_DEGREE else f"> {(SH_DEGREE + 1) ** 2} ({held_l[-1]:.1%})"
            rows[-1].append(told)
    point = evaluate_haar(np.array([[0.48, 0.36, 0.8]]), (1 << LEVEL) - 1)[0]
    counts = [str(terms_for_energy(point, share)) for share in SHARES]
    rows.append(["a point, in one cell", *counts, *("no end" for _ in SHARES)])
    return [
        "light",
        *(f"Haar, {share:.1%}" for share in SHARES),
        *(f"SH, {share:.1%}" for share in SHARES),
    ], rows


def triple_table(probes: dict[str, Environment]) -> Table:
    """Return the work of ``integral light visibility cosine`` by Haar wavelets, and the error of sparse light."""
    side = 1 << LEVEL
    middle = cell_nodes(side, 0)[:, :, 0]
    cosine_k = analyse(middle[..., 2])
    shadow = (middle @ np.array([0.6, 0.0, 0.8]) > 0.45) | (middle[..., 1] > 0.3)
    visible_k = analyse(shadow.astype(np.float64))
    rows = []
    for name, environment in probes.items():
        coeffs_kc = analyse(on_hemisphere(environment))
        gray_k = coeffs_kc.mean(axis=1)
        exact, terms = integrate_triple(gray_k, visible_k, cosine_k)
        dense = float((synthesise(gray_k) * shadow * synthesise(cosine_k)).mean() * HEMISPHERE)
        row = [name, f"{abs(exact - dense) / abs(dense):.0e}", str(terms)]
        for share in SHARES:
            count = terms_for_energy(gray_k, share)
            value, used = integrate_triple(keep_largest(gray_k, count), visible_k, cosine_k)
            row.append(f"{count}: {used} terms, {abs(value - exact) / abs(exact):.2%}")
        rows.append(row)
    return ["light", "from dense", "terms of all", *(f"light at {share:.1%}" for share in SHARES)], rows
