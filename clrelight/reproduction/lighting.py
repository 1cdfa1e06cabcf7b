"""Green, *Spherical Harmonic Lighting: The Gritty Details* (2003)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.montecarlo import project_function, sample_sphere
from clrelight.harmonics.product import transfer_matrix
from clrelight.harmonics.quadrature import product_rule
from clrelight.harmonics.rotation import rotation_blocks, rotation_matrix
from clrelight.lighting.irradiance import evaluate_irradiance
from clrelight.lighting.lamps import cap_light
from clrelight.lighting.layouts import texel_geometry
from clrelight.lighting.sky import sky_luminance
from clrelight.relight import to_display
from clrelight.reproduction import surface_figures
from clrelight.reproduction.figure_surfaces import object_scene
from clrelight.reproduction.rows import LONG, SHORT, Bench, Between, Found, Holds, Near, Out, Paper, Row, Work, yes
from clrelight.transfer.shading import shade_vertices
from clrelight.transfer.sources import DistantLight

TWO_LOBES = (
    *(0.3988, -0.2105, 0.2865, 0.2818, -0.3150, 0.0, 0.1314, 0.0),
    *(0.0932, -0.2496, 0.0, 0.1234, 0.3039, -0.1651, 0.0, -0.0922),
)
"""By quadrature, in the order k, with the sign of the page's functions of odd order."""

PAGE = (
    *(0.39925, -0.21075, 0.28687, 0.28277, -0.31530, -0.00040, 0.13159, 0.00098),
    *(-0.09359, None, -0.00072, 0.12290, 0.30458, -0.16427, -0.00062, -0.09126),
)
"""The page's fifteen numbers, each beside its own of ours; None is the one that it lacks."""

NAMES = tuple(f"c{k + 1}" for k in range(16))
RAYS = 1024


def _turned() -> NDArray[np.float64]:
    """Return -1 where the order m is odd: the page's functions have the Condon-Shortley sign there, ours have not."""
    return np.array([-1.0 if m % 2 else 1.0 for l in range(4) for m in range(-l, l + 1)])


def _lobes(bench: Bench) -> Found:
    nodes_q3, weights_q = product_rule(200, sphere=True)
    exact_k = _turned() * (evaluate_basis(nodes_q3, 3).T @ (weights_q * surface_figures.lamp_function(nodes_q3)))
    sampled_k = _turned() * project_function(surface_figures.lamp_function, 3, 10_000, seed=2)[:, 0]
    values = {f"exact {name}": float(value) for name, value in zip(NAMES, exact_k, strict=True)}
    errors = []
    for count in (100, 400, 1600, 6400):
        found = [project_function(surface_figures.lamp_function, 3, count, seed=seed)[:, 0] for seed in range(8)]
        errors.append(float(np.sqrt(np.mean([(_turned() * each - exact_k) ** 2 for each in found]))))
    fall = float(np.polyfit(np.log([100, 400, 1600, 6400]), np.log(errors), 1)[0])
    values |= {"sampled": float(np.abs(sampled_k - exact_k).max()), "fall": fall}
    return Found(values)


def _functions(bench: Bench) -> Found:
    """Return what figures 3 to 5 and the properties of SH say, as numbers, and figures 6 to 8 as a picture."""
    sphere_i3 = sample_sphere(10_000, seed=0)
    counts = np.histogram(sphere_i3[:, 2], 10, (-1.0, 1.0))[0]
    nodes_q3, weights_q = product_rule(16, sphere=True)
    basis_qk = evaluate_basis(nodes_q3, 5)
    apart = float(np.abs(basis_qk.T @ (weights_q[:, None] * basis_qk) - np.eye(36)).max())
    lamps_q = surface_figures.lamp_function
    fine_q3, fine_q = product_rule(120, sphere=True)
    left = []
    for degree in (1, 2, 3, 5, 8, 12):
        basis = evaluate_basis(fine_q3, degree)
        exact = lamps_q(fine_q3)
        rest = exact - basis @ (basis.T @ (fine_q * exact))
        left.append(float(np.sqrt((fine_q @ rest**2) / (fine_q @ exact**2))))
    light_k = evaluate_basis(fine_q3, 3).T @ (fine_q * lamps_q(fine_q3))
    fins = float((evaluate_basis(fine_q3, 3) @ light_k).min() / (evaluate_basis(fine_q3, 3) @ light_k).max())
    turn = rotation_matrix("euler", (20.0, 40.0, -70.0))
    turned_k = evaluate_basis(fine_q3, 3).T @ (fine_q * lamps_q(fine_q3 @ turn))
    blocks = rotation_blocks(turn, 3)
    by_blocks = np.concatenate([block @ light_k[l * l : (l + 1) ** 2] for l, block in enumerate(blocks)])
    values = {
        "even": float(np.abs(counts / 1000.0 - 1.0).max()),
        "orthonormal": apart,
        "falls": yes(np.all(np.diff(left) < 0.0)),
        "16": left[2],
        "fins": fins,
        "rotation": float(np.abs(turned_k - by_blocks).max()),
    }
    return Found(values, {"surface_functions.jpg": surface_figures.projections(96)} if bench.draws else {})


def _products(bench: Bench) -> Found:
    """Return the matrix of figure 9, whose shadow is y22, and whether figure 10's light is that of the product."""
    shadow_k = np.eye(coefficient_count(8))[8]
    matrix = transfer_matrix(shadow_k, 4)
    fine_q3, fine_q = product_rule(60, sphere=True)
    basis_qk = evaluate_basis(fine_q3, 4)
    light_k = np.random.default_rng(0).standard_normal(25)
    product_k = basis_qk.T @ (fine_q * basis_qk[:, 8] * (basis_qk @ light_k))
    values = {
        "filled": float((np.abs(matrix) > 1e-10).mean()),
        "symmetric": float(np.abs(matrix - matrix.T).max()),
        "product": float(np.abs(matrix @ light_k - product_k).max()),
    }
    return Found(values, {"surface_product.jpg": surface_figures.products(128)} if bench.draws else {})


def _transfer(bench: Bench) -> Found:
    """Return what figures 11, 13, 14 and 15 show of a scene under a white hemisphere."""
    surface, _ = object_scene()
    light = cap_light((0.0, 0.0, 1.0), 90.0, surface_figures.DEGREE)
    maps = surface_figures.object_maps(RAYS)
    plain_vc, shadow_vc, all_vc = (shade_vertices(made, [DistantLight(light)]) for made in maps.values())
    albedo_vc = np.asarray(surface.albedo_vc)
    exact_vc = albedo_vc * evaluate_irradiance(light, surface.normals_v3) / np.pi
    nine = float(np.linalg.norm(plain_vc - exact_vc) / np.linalg.norm(exact_vc))
    floor_v = (surface.vertices_v3[:, 2] < 1e-6) & (surface.normals_v3[:, 2] > 0.99)
    share_v = shadow_vc[floor_v, 0] / np.percentile(shadow_vc[floor_v, 0], 99)
    wall_v = floor_v & (surface.vertices_v3[:, 0] < -2.6)
    colour_c = (all_vc - shadow_vc)[wall_v].mean(axis=0)
    values = {
        "unshadowed": nine,
        "darker": yes(shadow_vc.mean() < plain_vc.mean()),
        "half": float(((share_v > 0.2) & (share_v < 0.8)).mean()),
        "brighter": yes(all_vc.mean() > shadow_vc.mean()),
        "bleeding": float(colour_c[0] / colour_c[1]),
        "smooth": 25.0 if next(iter(maps.values())).coeffs_khwc.shape[0] == 25 else 0.0,
    }
    if not bench.draws:
        return Found(values)
    drawn = surface_figures.transfers(210, RAYS)
    return Found(values, {"surface_transfer.jpg": drawn["transfer"], "surface_bounce.jpg": drawn["bounce"]})


def _skies(bench: Bench) -> Found:
    """Return what the CIE skies of figures 16 to 18 print, and pictures of them, the sun at 40 degrees."""
    up, level = np.array([[0.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 1e-9]])
    ratio = float(sky_luminance(up, "overcast", 40.0)[0] / sky_luminance(level, "overcast", 40.0)[0])
    sides = []
    for sky in ("clear", "partly-cloudy"):
        sun = np.array([[np.cos(np.radians(40.0)), 0.0, np.sin(np.radians(40.0))]])
        away = sun * (-1.0, 1.0, 1.0)
        towards = [float(sky_luminance(each, sky, 40.0, 0.0)[0]) for each in (sun, away)]
        sides.append(max(towards) / min(towards))
    values = {"overcast": ratio, "sun": yes(min(sides) > 1.5)}
    if not bench.draws:
        return Found(values)
    directions_n3 = texel_geometry("latlong", 96, 192)[0].reshape(96, 192, 3)[:48].reshape(-1, 3)
    panels = []
    for sky in ("overcast", "clear", "partly-cloudy"):
        value = sky_luminance(directions_n3, sky, 40.0, 180.0).reshape(48, 192, 1)
        panels.append(to_display(np.repeat(value / (1.0 + value), 3, axis=2).astype(np.float32), "srgb"))
        panels.append(np.full((4, 192, 3), 255, np.uint8))
    return Found(values, {"lighting_skies.png": np.concatenate(panels[:-1])})


def _caps(bench: Bench) -> Found:
    """Return the largest difference between the page's closed form of a cap and ours, bands 0 to 3."""
    off = []
    for angle in (10.0, 30.0, 60.0, 90.0, 150.0):
        t5, t14 = np.cos(np.radians(angle)), np.sin(np.radians(angle))
        printed = [
            3.544907702 - 1.772453851 - 1.772453851 * t5,
            1.534990062 * t14**2,
            -1.98166365 * t5**3 + 1.98166365 * t5,
            2.930920062 - 2.930920062 * t5**4 - 3.517104075 * t14**2,
        ]
        ours = cap_light((0.0, 0.0, 1.0), angle, 3).coeffs_kc[[0, 2, 6, 12], 0]
        off.append(np.abs(np.array(printed) - ours).max())
    return Found({"cap": float(max(off))})


def _lobe_rows() -> tuple[Row, ...]:
    rows = []
    for name, printed, ours in zip(NAMES, PAGE, TWO_LOBES, strict=True):
        text, near = "missing" if printed is None else f"{printed:.5f}", Near(ours, 5e-4)
        reason = "the page lists fifteen numbers" if printed is None else "the page has the other sign"
        agrees = Near(float("nan") if printed is None else printed, 0.002)
        rows.append(Row("two lobes", f"{name} of 16", text, "SH projection", f"exact {name}", agrees, near, reason))
    return tuple(rows)


PAPER = Paper(
    "gritty",
    "Green: Spherical Harmonic Lighting: The Gritty Details, 2003",
    (
        Work("functions", (
            Row("figure 3", "10 000 samples: share of a tenth of the heights, off by at most", "even", "figure 3",
                "even", Between(0.0, 0.02)),
            Row("figure 4", "basis functions orthonormal to", "1 and 0", "properties of SH functions", "orthonormal",
                Between(0.0, 1e-12)),
            Row("figure 6", "error falls with the order of approximation", "yes", "figure 6", "falls", Holds()),
            Row("figure 8", "RMS error of 16 coefficients, of the lamps' RMS", "not a bad approximation",
                "SH projection", "16", Between(0.2, 0.6)),
            Row("figure 8", "residual fins: least value over largest", "some", "SH projection", "fins",
                Between(-0.3, -0.02)),
            Row("rotation", "projecting the turned light and turning the projection, apart", "exactly the same",
                "properties of SH functions", "rotation", Between(0.0, 1e-3)),
        ), _functions, takes=SHORT, surfaces=True, pictures={"surface_functions.jpg": "figures 6 to 8"}),
        Work("two lobes", (*_lobe_rows(),
            Row("two lobes", "10 000 stratified samples, off quadrature by at most", "10,000 samples", "SH projection",
                "sampled", Between(0.0, 0.02)),
            Row("two lobes", "power of the number of stratified samples by which errors fall", "-1/2 or faster",
                "Monte Carlo integration", "fall", Between(-1.2, -0.4)),
        ), _lobes),
        Work("products", (
            Row("figure 9", "part of the 25 × 25 matrix of y22 that is not 0", "mostly sparse", "figure 9", "filled",
                Between(0.01, 0.25)),
            Row("figure 9", "matrix and its transpose apart", "symmetric", "equation 8", "symmetric",
                Between(0.0, 1e-12)),
            Row("figure 10", "matrix times light and projection of the product, apart", "exactly the same",
                "equation 9", "product", Between(0.0, 1e-10)),
        ), _products, surfaces=True, pictures={"surface_product.jpg": "figures 9 and 10"}),
        Work("transfer", (
            Row("figure 11", "coefficients of a function", "25", "figure 11", "smooth", Near(25.0, 0.0)),
            Row("figure 11", "RMS of unshadowed transfer off the irradiance's formula", "geometric term", "figure 11",
                "unshadowed", Between(0.0, 0.02)),
            Row("figure 13", "shadows make it darker", "yes", "figure 13", "darker", Holds()),
            Row("figure 13", "part of the floor in half shadow (20 to 80% of its brightest)", "soft shadows",
                "figure 13", "half", Between(0.05, 0.95)),
            Row("figure 14", "what light sent on adds is brighter", "yes", "figure 14", "brighter", Holds()),
            Row("figure 15", "red over green of what the floor beside the red wall gets", "color bleeding",
                "figure 15", "bleeding", Between(1.5, 20.0)),
        ), _transfer, takes=LONG, surfaces=True,
            pictures={"surface_transfer.jpg": "figures 11, 13 and 15", "surface_bounce.jpg": "figure 14"}),
        Work("skies", (
            Row("figure 16", "overcast sky: zenith over horizon", "3 (1 + 2 cos β, over 3)", "figure 16", "overcast",
                Near(3.0, 1e-6)),
            Row("figure 17", "clear and partly cloudy: brighter at the sun than opposite", "yes",
                "figures 17 and 18", "sun", Holds()),
        ), _skies, pictures={"lighting_skies.png": "figures 16 to 18"}),
        Work("caps", (
            Row("synth_light", "round lamp: printed closed form and ours, apart", "nine digits",
                "creating light sources", "cap", Between(0.0, 1e-7)),
        ), _caps),
    ),
    (
        Out("figures 1, 2, 5 and 12", "diagrams", "nothing is computed in them"),
        Out("figure 19", "a light probe as a picture", "a photograph; ours is read by any command that takes --env"),
        Out("glossy surfaces", "an extended version that was announced",
            "not printed; clrelight has operators ([glossy.md](glossy.md))"),
        Out("subsurface scattering, caustics", "named as further work", "declared out of clrelight"),
    ),
)  # fmt: skip
