"""Ramamoorthi and Hanrahan, *Frequency Space Environment Map Rendering* (2002)."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.radial import Phong
from clrelight.jobs.reflection.bench import (
    EXPONENTS,
    SIGMAS,
    cost_slopes,
    frame_rates,
    time_microfacets,
    time_phong,
)
from clrelight.jobs.reflection.plan import accuracy_rows, map_energy
from clrelight.lighting.environment import read_environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.report.reflection import write_accuracy
from clrelight.reproduction.reflection_figures import FIGURES, chart_8, draw
from clrelight.reproduction.rows import LONG, SHORT, Bench, Between, Found, Holds, Near, Out, Paper, Row, Work, yes
from clrelight.shrm.orders import crossover_exponent, minimal_orders, phong_degree, reflected_accuracy

GRACE = "probes/grace_latlong.exr"
AXES = "right,forward,down"
PHONG = (830.6, 333.6, 137.1, 52.6, 21.9, 7.7, 3.3)
"""Table 4, ratios of angular to frequency space."""

FACETS = ((24, 3), (12, 2), (7, 2), (5, 2), (5, 2))
"""Table 5, F and P."""

FACET_RATIOS = (923 / 2.70, 2744 / 1.55, 5731 / 1.49, 9034 / 1.47, 12580 / 1.45)
PAINTS = ("acryl_blue", "cayman", "garnet_red", "krylon_blue", "mystique")
PAINT_FILES = tuple(f"brdf/{name}.brdf" for name in PAINTS)
_MACHINE = "ratios of times on a Pentium IV of 2001; both of ours run compiled, on this machine's cores"


def _formulas(bench: Bench) -> Found:
    """Return what appendices D and section 6.3 print, and the orders of three reflectances for 97% (section 7.1)."""
    off = []
    for s in (8.0, 32.0, 128.0):
        needed = minimal_orders(brdf_coefficients(Phong(s), 60, 0), 0.01)[0]
        off.append(abs(phong_degree(s, 0.01) - needed))
    values = {"crossover": crossover_exponent(100), "phong": max(off)}
    for name, brdf, order in (("facets", Microfacet(0.2), 2), ("skin", SKIN, 4), ("fibres", KajiyaKay(32.0), 8)):
        found = brdf_coefficients(brdf, 30, order)
        values[name] = float(1.0 - found.shares()[-1, -1].min())
    values["maps"] = (10 * 2) ** 2 / 9.0
    return Found(values)


def _light(bench: Bench, degree: int = 63) -> Light:
    environment, _ = read_environment(bench.file(GRACE), axes=AXES)
    return project_environment(environment, degree, device=bench.open_device())


def _accuracy(bench: Bench) -> Found:
    """Return figure 6: what F holds of Phong 32 under Grace Cathedral, and what is said of it beforehand."""
    environment, _ = read_environment(bench.file(GRACE), axes=AXES)
    light_kc = project_environment(environment, 60, device=bench.open_device()).coeffs_kc
    found = reflected_accuracy(light_kc, brdf_coefficients(Phong(32.0), 60, 0), map_energy(environment))
    rows = np.array(accuracy_rows(found, 30))
    reflected, of_light, of_brdf, bound = rows[:, 1:].T
    best = np.maximum(of_light, of_brdf)  # the minimum of errors
    values = {
        "careful": yes(np.all(best <= reflected + 1e-9) and np.all(bound <= reflected + 1e-9)),
        "brdf decides": float((best == of_brdf)[2:].mean()),
        "at 12": float(reflected[12]),
        "gap": float((reflected - best)[12:].max()),
    }
    return Found(values, {"shrm_accuracy.png": _as_picture(partial(write_accuracy, rows=rows.tolist(), epsilon=0.03))}
                 if bench.draws else {})  # fmt: skip


def _as_picture(write: Callable[[Path], None], name: str = "picture.png") -> bytes:
    """Return the file that a function writes."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path)
        return path.read_bytes()


def _costs(bench: Bench) -> Found:
    return Found({name: float(found["slope"]) for name, found in cost_slopes(rounds=6).items()})


def _phong(bench: Bench) -> Found:
    rows = time_phong(_light(bench), bench.open_device())
    values = {f"s {row['s']}": float(row["ratio"]) for row in rows}
    ratios = [float(row["ratio"]) for row in rows]
    values["falls"] = float(np.polyfit(np.log(EXPONENTS), np.log(ratios), 1)[0])
    values["apart"] = max(float(row["apart"]) for row in rows)
    values["slowest"] = max(float(row["frequency"]) for row in rows)
    return Found(values)


def _microfacets(bench: Bench) -> Found:
    rows = time_microfacets(_light(bench), bench.open_device())
    values: dict[str, Any] = {}
    for row in rows:
        values[f"orders {row['sigma']}"] = (float(row["degree"]), float(row["order"]))
        values[f"ratio {row['sigma']}"] = float(row["ratio"])
    values["whole beats one"] = yes(all(row["shrm"] < row["image"] for row in rows))
    rates = frame_rates(2, bench.open_device())
    values["rate"] = max(rates.values())
    return Found(values)


def _figure(number: str, judge: Callable[[list[list[str]]], dict[str, float]], bench: Bench) -> Found:
    """Return what a figure's table says, and the figure."""
    panels, (_, rows) = FIGURES[number](bench.file(""))
    values = judge(rows)
    if not bench.draws:
        return Found(values)
    name = f"shrm_figure{number}." + ("jpg" if panels else "png")
    make = partial(draw, panels=panels) if panels else partial(chart_8, table=([], rows))
    return Found(values, {name: _as_picture(make, name)})


def _of_1(rows: list[list[str]]) -> dict[str, float]:
    return {name: float(row[-1]) for name, row in zip(("facets", "krylon", "garnet", "fibres"), rows, strict=True)}


def _of_5(rows: list[list[str]]) -> dict[str, float]:
    """Return by how many degrees what is shown exceeds the lesser of light and lobe, and falls short of it."""
    own = (6, 12, 24, 48)
    over = [int(cell) - min(int(row[0]), lobe) for row in rows for cell, lobe in zip(row[1:], own, strict=True)]
    shown = [int(cell) for row in rows for cell in row[1:]]
    less = [min(int(row[0]), lobe) for row in rows for lobe in own]
    together = float(np.corrcoef(np.log(shown), np.log(less))[0, 1])
    return {"over": float(max(over)), "together": together}


def _of_7(rows: list[list[str]]) -> dict[str, float]:
    shares, errors = ([float(cell) for cell in row[1:]] for row in rows)
    return {
        "97": 1.0 - shares[2],
        "falls": yes(np.all(np.diff(errors) < 0.0)),
        "at 2": errors[2],
        "careful": yes(all(error**2 <= 1.0 - share for error, share in zip(errors, shares, strict=True))),
    }


def _of_8(rows: list[list[str]]) -> dict[str, float]:
    at_5 = np.array([float(row[6]) for row in rows])
    return {"paints": float((at_5[:5] > 0.9).mean()), "others": float((at_5[5:] > 0.85).mean())}


def _of_peers(rows: list[list[str]]) -> dict[str, float]:
    values = {name: float(row[4]) / float(row[3]) for name, row in zip(("first", "second"), rows, strict=True)}
    return values | {"own": max(float(row[3]) for row in rows)}


_TABLE_2 = (
    Row("table 2", "compact: maps of 20 × 20 views over the 9 of P = 2", "SHRM yes, tabular no", "table 2", "maps",
        Between(10.0, 100.0)),
)  # fmt: skip

PAPER = Paper(
    "frequency",
    "Ramamoorthi and Hanrahan: Frequency Space Environment Map Rendering, SIGGRAPH 2002",
    (
        Work("formulas", (
            *_TABLE_2,
            Row("section 6.3", "s* of S = 100", "≈ 464", "section 6.3", "crossover", Near(464.0, 0.5)),
            Row("appendix D", "F = √(-s log ε) off the least F of 1%, s = 8, 32, 128", "accurate", "appendix D",
                "phong", Between(0.0, 2.0)),
            Row("section 7.1", "microfacets 0.2, P = 2: energy missed", "ε < .03", "section 7.1", "facets",
                Between(0.0, 0.03)),
            Row("section 7.1", "skin (Lafortune), P = 4: energy missed", "ε < .03", "section 7.1", "skin",
                Between(0.0, 0.03), Between(0.0, 0.08),
                "the worst of three channels; P = 5 misses .02"),
            Row("section 7.1", "fibres (Kajiya-Kay), s = 32, P = 8: energy missed", "ε < .03", "section 7.1", "fibres",
                Between(0.0, 0.03)),
        ), _formulas),
        Work("accuracy", (
            Row("figure 6", "both estimates are conservative", "yes", "figure 6", "careful", Holds()),
            Row("figure 6", "part of F above 1 at which the reflectance alone decides", "almost always",
                "section 5.1", "brdf decides", Between(0.9, 1.0)),
            Row("figure 6", "accuracy of F = 12", "near 1", "figure 6", "at 12", Between(0.99, 1.0)),
            Row("figure 6", "largest gap of the estimate from F = 12 on", "fairly tight", "figure 6", "gap",
                Between(0.0, 0.05)),
        ), _accuracy, takes=SHORT, needs=(GRACE,), pictures={"shrm_accuracy.png": "figure 6"}),
        Work("costs", tuple(
            Row("table 3", f"power of {name} by which the SHRM's cost grows", f"{power} (F P² S²)", "table 3", name,
                Near(float(power), 0.3), Near(float(power), 0.6), "caches, on a machine that does other things too")
            for name, power in (("F", 1), ("P", 2), ("S", 2))
        ), _costs, takes=SHORT),
        Work("Phong", (
            *(Row("table 4", f"s = {s}: angular over frequency time", f"{printed}", "table 4", f"s {s}",
                  Near(printed, 0.35 * printed), Between(2.0, 20_000.0), _MACHINE)
              for s, printed in zip(EXPONENTS, PHONG, strict=True)),
            Row("table 4", "power of s by which the ratio falls", "-1.5 (eq. 9, 10)", "section 6.3", "falls",
                Near(-1.5, 0.3), Between(-2.0, -0.3), "of sharp lobes our sums over orders are bound by memory"),
            Row("table 4", "slowest map by orders, s", "0.686", "table 4", "slowest", Between(0.0, 0.686)),
            Row("table 4", "maps by angles (95%) and by orders apart", "ε = .05", "section 7.4", "apart",
                Between(0.0, 0.08)),
        ), _phong, takes=LONG, needs=(GRACE,)),
        Work("microfacets", (
            *(Row("table 5", f"σ = {sigma:g}: F, P", f"{f}, {p}", "table 5", f"orders {sigma}",
                  Near((float(f), float(p)), 1.0))
              for sigma, (f, p) in zip(SIGMAS, FACETS, strict=True)),
            *(Row("table 5", f"σ = {sigma:g}: 100 maps, angular over frequency time", f"{printed:.0f}", "table 5",
                  f"ratio {sigma}", Near(printed, 0.35 * printed), Between(50.0, 50_000.0), _MACHINE)
              for sigma, printed in zip(SIGMAS, FACET_RATIOS, strict=True)),
            Row("table 5", "a whole SHRM takes less than one map by angles", "usually", "table 5", "whole beats one",
                Holds()),
            Row("section 7.5", "dynamic maps of 6 × 64 × 64 texels a second, P = 2", "about 30", "section 7.5", "rate",
                Between(30.0)),
        ), _microfacets, takes=LONG, needs=(GRACE,)),
        Work("figure 1", tuple(
            Row("figure 1", f"{what}: RMS error of its own views", "each pixel's view", "figure 1", name,
                Between(0.0, 0.15))
            for name, what in (("facets", "microfacets, Grace"), ("krylon", "Krylon blue, beach"),
                               ("garnet", "garnet red, Galileo's tomb"), ("fibres", "fibres, Grace"))
        ), partial(_figure, "1", _of_1), takes=LONG, surfaces=True, pictures={"shrm_figure1.jpg": "figure 1"},
            needs=(GRACE, "probes/beach_probe.hdr", "probes/galileo_cross.dds", "meshes/armadillo.ply", *PAINT_FILES)),
        Work("figure 5", (
            Row("figure 5", "degrees shown above the lesser of light and lobe, at most", "the minimum", "figure 5",
                "over", Between(-50.0, 1.0)),
            Row("figure 5", "correlation of both in logarithms", "approximately", "figure 5", "together",
                Between(0.9, 1.0)),
        ), partial(_figure, "5", _of_5), needs=(GRACE,), pictures={"shrm_figure5.jpg": "figure 5"}),
        Work("figure 7", (
            Row("figure 7", "P = 2: energy missed", "ε < .03", "figure 7", "97", Between(0.0, 0.03)),
            Row("figure 7", "RMS error falls with P = 0 … 5", "yes", "figure 7", "falls", Holds()),
            Row("figure 7", "P = 2: RMS error of two views", "very accurate", "figure 7", "at 2", Between(0.0, 0.06)),
            Row("figure 7", "squared error is below the energy missed", "conservative", "section 7.1", "careful",
                Holds()),
        ), partial(_figure, "7", _of_7), takes=LONG, needs=(GRACE,), pictures={"shrm_figure7.jpg": "figure 7"}),
        Work("figure 8", (
            Row("figure 8", "part of measured reflectances with 90% at F = 30, P = 5", "56 of 61 (.92)", "figure 8",
                "paints", Between(0.9, 1.0), Between(0.0, 0.2),
                "CURET's files are not at hand; five paints of Cornell have most of their energy in a mirror-like peak "
                "at grazing angles"),
            Row("figure 8", "part of models (skin, microfacets, fibres) with 85%", "almost all", "section 7.2",
                "others", Between(0.99, 1.0)),
        ), partial(_figure, "8", _of_8), takes=SHORT, needs=PAINT_FILES, pictures={"shrm_figure8.png": "figure 8"}),
        Work("figure 9", (
            Row("figure 9", "Krylon blue: error of the 3-D texture over that of P = 5", "large errors", "figure 9",
                "first", Between(2.0, 50.0)),
            Row("figure 9", "skin: the same", "large errors", "figure 9", "second", Between(2.0, 50.0)),
            Row("figure 9", "largest RMS error of P = 5", "accurate", "figure 9", "own", Between(0.0, 0.1)),
        ), partial(_figure, "9", _of_peers), takes=LONG, needs=(GRACE, *PAINT_FILES),
            pictures={"shrm_figure9.jpg": "figure 9"}),
        Work("figure 10", (
            Row("figure 10", "skin: error of twelve maps over that of P = 5", "inadequate", "figure 10", "first",
                Between(1.5, 50.0)),
            Row("figure 10", "fibres: the same, of twelve zonal maps", "inadequate", "figure 10", "second",
                Between(5.0, 500.0)),
            Row("figure 10", "largest RMS error of ours", "accurate", "figure 10", "own", Between(0.0, 0.1)),
        ), partial(_figure, "10", _of_peers), takes=LONG, needs=(GRACE,), pictures={"shrm_figure10.jpg": "figure 10"}),
    ),
    (
        Out("table 1", "notation", "nothing is computed in it"),
        Out("figures 2, 3 and 4", "diagrams", "nothing is computed in them"),
        Out("figure 8", "61 reflectances of CURET", "its files cannot be had freely; five others stand in"),
        Out("section 7.4", "seconds of a Pentium IV", "times of 2001; their ratios are under tables 4 and 5"),
    ),
)  # fmt: skip
