"""Ramamoorthi and Hanrahan, *An Efficient Representation for Irradiance Environment Maps* (2001)."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.reflection.bench import best_seconds
from clrelight.lighting import layouts
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.irradiance import (
    compare_irradiance,
    cosine_coefficients,
    evaluate_irradiance,
    integrate_irradiance,
    irradiance_matrix,
)
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.lighting.relighting import automatic_exposure
from clrelight.reproduction import surface_figures
from clrelight.reproduction.rows import SHORT, Bench, Between, Found, Holds, Near, Out, Paper, Row, Work, yes
from clrelight.transfer.mesh_files import read_mesh
from clrelight.variation.subspaces import energy_bound

FACTORS = (3.141593, 2.094395, 0.785398, 0.0, -0.130900, 0.0, 0.049087)
CONSTANTS = (0.429043, 0.511664, 0.743125, 0.886227, 0.247708)
NAMES = ("L00", "L1-1", "L10", "L11", "L2-2", "L2-1", "L20", "L21", "L22")
GRACE = (
    *((0.79, 0.44, 0.54), (0.39, 0.35, 0.60), (-0.34, -0.18, -0.27), (-0.29, -0.06, 0.01), (-0.11, -0.05, -0.12)),
    *((-0.26, -0.22, -0.47), (-0.16, -0.09, -0.15), (0.56, 0.21, 0.14), (0.21, -0.05, -0.30)),
)
"""Figure 2, Grace Cathedral."""

GRACE_SCALE = 0.0782
"""Of the published cross, whose unit is not the figure's."""

PROBES = {
    "Grace Cathedral": "probes/grace_cross.hdr",
    "beach": "probes/beach_probe.hdr",
    "Galileo's tomb": "probes/galileo_cross.dds",
}
MAP = 32


def _formulas(bench: Bench) -> Found:
    """Return equations 3, 8, 9, 12, and the bounds of section 3.1."""
    factors_l = cosine_coefficients(64)
    even_l = np.arange(16, 65, 2)
    slope = float(np.polyfit(np.log(even_l), np.log(np.abs(factors_l[even_l])), 1)[0])
    at = evaluate_basis(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]]), 2)
    harmonics = (at[0, 0], at[0, 2], at[2, 7] / 0.48, at[0, 6] / 2.0, at[1, 8])
    c1, c2, c3 = (float(_matrix_of(k)[place]) for k, place in ((8, (0, 0)), (3, (0, 3)), (6, (2, 2))))
    constants = (c1, c2, c3, float(_matrix_of(0)[3, 3]), -float(_matrix_of(6)[3, 3]))
    # A lamp of total light 1 in the direction z: the error at normals of cosine z to it.
    nine = np.polynomial.Polynomial([3 / 32, 1 / 2, 15 / 32])
    off = lambda z: abs(max(z, 0.0) - nine(z))  # noqa: E731
    places = np.linspace(-1.0, 1.0, 20001)
    worst = float(np.abs(np.maximum(places, 0.0) - nine(places)).max())
    mean = 0.5 * quad(off, -1.0, 1.0, points=[0.0], limit=200)[0]
    return Found(
        {
            "factors": tuple(factors_l[:7].tolist()),
            "fall": slope,
            "harmonics": tuple(float(each) for each in harmonics),
            "constants": constants,
            "worst": 100.0 * worst,
            "mean": 100.0 * mean,
            "energy": 100.0 * (1.0 - energy_bound(2)),
        }
    )


def _matrix_of(k: int) -> NDArray[np.float64]:
    return irradiance_matrix(Light(np.eye(9)[:, k : k + 1].copy()))[0]


def _grace(bench: Bench) -> Found:
    environment, _ = read_environment(bench.file(PROBES["Grace Cathedral"]), axes="probe")
    coeffs_kc = GRACE_SCALE * project_environment(environment, 2, device=bench.open_device()).coeffs_kc
    return Found({name: tuple(row.tolist()) for name, row in zip(NAMES, coeffs_kc, strict=True)})


def _natural(bench: Bench) -> Found:
    """Return errors of nine coefficients under each probe, and figure 3: both maps, and 20 times their gap."""
    device = bench.open_device()
    normals_n3, weights_n = layouts.texel_geometry("latlong", MAP, 2 * MAP)
    values, rows, apart = {}, [], []
    for name, file in PROBES.items():
        environment, _ = read_environment(bench.file(file))
        light = project_environment(environment, 2, device=device)
        exact_nc = integrate_irradiance(environment, normals_n3, device=device)
        nine_nc = evaluate_irradiance(light, normals_n3)
        error = compare_irradiance(nine_nc, exact_nc, weights_n, light)
        gap, whole = (weights_n @ (each_nc**2.0).sum(axis=1) for each_nc in (nine_nc - exact_nc, exact_nc))
        apart.append(math.sqrt(gap / whole))
        values[f"{name} mean"], values[f"{name} most"] = 100.0 * error.mean, 100.0 * error.maximum
        if bench.draws:
            rows.append(_maps(environment, light, bench))
    values["map"] = max(apart)
    return Found(values, {"irradiance_figure3.jpg": np.concatenate(rows)} if rows else {})


def _maps(environment: Environment, light: Light, bench: Bench) -> NDArray[np.uint8]:
    """Return the paper's discs (theta outwards from +z): by integration, by nine coefficients, and the difference."""
    side = 128
    x, y = np.meshgrid(*[(np.arange(side) + 0.5) / side * 2.0 - 1.0] * 2)
    radius, azimuth = np.hypot(x, y), np.arctan2(-y, x)
    inside = radius < 1.0
    theta = np.pi * radius[inside]
    normals_n3 = np.stack([np.sin(theta) * np.cos(azimuth[inside]), np.sin(theta) * np.sin(azimuth[inside]),
                           np.cos(theta)], axis=1)  # fmt: skip
    exact_nc = integrate_irradiance(environment, normals_n3, device=bench.open_device())
    nine_nc = evaluate_irradiance(light, normals_n3)
    scale = 2.0 ** automatic_exposure(exact_nc[None].astype(np.float32))
    discs = []
    for values_nc in (exact_nc, nine_nc, 20.0 * np.abs(nine_nc - exact_nc)):
        disc = np.zeros((side, side, values_nc.shape[1]), np.float32)
        disc[inside] = scale * values_nc
        discs.append(surface_figures.shown(disc))
    return np.concatenate(discs, axis=1)


def _speed(bench: Bench) -> Found:
    """Return how much faster nine coefficients make a 64 × 64 irradiance map of 300 × 300 texels than sums over all."""
    device = bench.open_device()
    rng = np.random.default_rng(0)
    environment = Environment(rng.random((300, 300, 3), np.float32), "angular")
    normals_n3 = layouts.texel_geometry("latlong", 46, 92)[0][:4096]

    def nine() -> NDArray[np.float64]:
        return evaluate_irradiance(project_environment(environment, 2, device=device), normals_n3)

    def alone() -> Light:
        return project_environment(environment, 2, device=device)

    def sums() -> NDArray[np.float32]:
        return integrate_irradiance(environment, normals_n3, device=device)

    seconds = [best_seconds(work, 3) for work in (alone, nine, sums)]
    return Found({"project": seconds[0], "ratio": seconds[2] / seconds[1], "texels a coefficient": 4096 / 9})


def _figure_1(bench: Bench) -> Found:
    """Return the picture, and how far its matte vertices are from irradiance summed over all texels."""
    device = bench.open_device()
    armadillo = read_mesh(bench.file("meshes/armadillo.ply"), up="y")
    grace, _ = read_environment(bench.file(PROBES["Grace Cathedral"]))
    light = project_environment(grace, 2, device=device)
    normals_n3 = armadillo.normals_v3[::8].astype(np.float64)
    nine_nc = evaluate_irradiance(light, normals_n3)
    exact_nc = integrate_irradiance(grace, normals_n3, device=device)
    values = {"off": float(np.linalg.norm(nine_nc - exact_nc) / np.linalg.norm(exact_nc))}
    pictures = {"surface_objects.jpg": surface_figures.objects(armadillo, grace, 480)} if bench.draws else {}
    return Found(values, pictures)


def _figure_4(bench: Bench) -> Found:
    """Return the nine functions' pictures, and by how much those of degree 2 are dimmer."""
    nodes_n3 = layouts.texel_geometry("latlong", 32, 64)[0]
    factors_k = cosine_coefficients(2)[[0, 1, 1, 1, 2, 2, 2, 2, 2]]
    largest_k = np.abs(evaluate_basis(nodes_n3, 2) * factors_k).max(axis=0)
    values = {"dimmer": yes(largest_k[4:].max() < largest_k[:4].min())}
    right = evaluate_basis(np.array([[-1.0, 0.0, 0.0]]), 2)[0, 3]
    values["side"] = yes(right < 0.0)
    if not bench.draws:
        return Found(values)
    armadillo = read_mesh(bench.file("meshes/armadillo.ply"), up="y")
    return Found(values, {"surface_basis.jpg": surface_figures.basis(armadillo, 60)})


PAPER = Paper(
    "irradiance",
    "Ramamoorthi and Hanrahan: An Efficient Representation for Irradiance Environment Maps, SIGGRAPH 2001",
    (
        Work("formulas", (
            Row("equation 3", "constants of the nine harmonics", "0.282095, 0.488603, 1.092548, 0.315392, 0.546274",
                "section 2", "harmonics", Near((0.282095, 0.488603, 1.092548, 0.315392, 0.546274), 1e-6)),
            Row("equation 9", "Â0 to Â6", ", ".join(f"{each:g}" for each in FACTORS), "section 2", "factors",
                Near(FACTORS, 5e-7)),
            Row("equation 8", "Âl of even l falls as l to the", "-5/2", "section 2", "fall", Near(-2.5, 0.1)),
            Row("equation 12", "c1 to c5 of the matrix M", ", ".join(f"{each:g}" for each in CONSTANTS),
                "section 3.2", "constants", Near(CONSTANTS, 1.5e-6)),
            Row("bounds", "largest error of nine coefficients under any light, %", "9", "section 3.1", "worst",
                Near(9.0, 0.5)),
            Row("bounds", "energy that nine coefficients miss under any light, %", "under 3", "section 3.1",
                "energy", Between(0.0, 3.0)),
            Row("bounds", "mean absolute error under any light, % of the light", "under 3", "section 3.1", "mean",
                Between(0.0, 3.0), Near(3.07, 0.01),
                "a single lamp has 3.07; what Basri and Jacobs bound is energy, the row above"),
        ), _formulas),
        Work("natural light", (
            *(Row("bounds", f"{what} error under {name}, %", printed, "section 3.1", f"{name} {value}",
                  Between(0.0, most))
              for name in PROBES
              for what, printed, value, most in (("mean", "under 1", "mean", 1.0), ("largest", "under 5", "most", 5.0))
            ),
            Row("figure 3", "RMS of nine coefficients' map off standard prefiltering, of three probes the worst",
                "perceptually accurate", "section 3.1", "map", Between(0.0, 0.05)),
        ), _natural, takes=SHORT, needs=tuple(PROBES.values()), pictures={"irradiance_figure3.jpg": "figure 3"}),
        Work("Grace Cathedral", tuple(
            Row("figure 2", f"{name} of Grace Cathedral, RGB", ", ".join(f"{each:.2f}" for each in row), "figure 2",
                name, Near(row, 0.008))
            for name, row in zip(NAMES, GRACE, strict=True)
        ), _grace, needs=(PROBES["Grace Cathedral"],)),
        Work("speed", (
            Row("500×", "texels of a 64 × 64 map over 9 (T / 9)", "nearly 500", "section 3.1", "texels a coefficient",
                Near(500.0, 50.0)),
            Row("500×", "64 × 64 irradiance map of 300 × 300 texels, times as fast", "nearly 500", "section 3.1",
                "ratio", Near(500.0, 50.0), Between(5.0, 5000.0),
                "T / 9 counts additions alone; here both run compiled on all cores, and 9 coefficients need little "
                "more time than it takes to read the map"),
            Row("500×", "nine coefficients of 300 × 300 texels, s", "less than 1", "section 3.1", "project",
                Between(0.0, 1.0)),
        ), _speed, takes=SHORT),
        Work("objects", (
            Row("figure 1", "RMS of irradiance at an armadillo's normals, off the sum over all texels",
                "looks identical", "section 3.2", "off", Between(0.0, 0.05)),
        ), _figure_1, takes=SHORT, needs=("meshes/armadillo.ply", PROBES["Grace Cathedral"]), surfaces=True,
            pictures={"surface_objects.jpg": "figure 1"}),
        Work("basis functions", (
            Row("figure 4", "all five functions of degree 2 are dimmer than those below", "yes", "figure 4", "dimmer",
                Holds()),
            Row("figure 4", "function (1, 1) is negative towards -x", "yes", "figure 4", "side", Holds()),
        ), _figure_4, takes=SHORT, needs=("meshes/armadillo.ply",), surfaces=True,
            pictures={"surface_basis.jpg": "figure 4"}),
    ),
    (
        Out("figure 2", "Eucalyptus Grove, St. Peter's Basilica",
            "these two probes cannot be had freely, so their 54 numbers are not recomputed"),
        Out("section 3.1", "two hours for the standard method",
            "the time of a program of 2001; ours is under 500×"),
        Out("section 3.2", "frame rates on PCs and SGIs", "hardware of 2001"),
    ),
)  # fmt: skip
