"""Ramamoorthi, *Modeling Illumination Variation with Spherical Harmonics* (2006)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.harmonics.quadrature import product_rule
from clrelight.harmonics.rotation import rotation_blocks, rotation_matrix
from clrelight.lighting.irradiance import cosine_coefficients
from clrelight.relight import to_display
from clrelight.report.canvas import house_style, new_figure
from clrelight.reproduction import surface_figures
from clrelight.reproduction.figure_surfaces import plain
from clrelight.reproduction.heads import lamps_at, photograph, sky_light_at
from clrelight.reproduction.rows import SHORT, Bench, Between, Found, Holds, Near, Out, Paper, Row, Work, yes
from clrelight.sampling import make_pattern
from clrelight.transfer.cameras import frame_surface
from clrelight.transfer.rays import RayScene
from clrelight.transfer.views import look
from clrelight.variation.recognition import spaces_of_normals
from clrelight.variation.subspaces import analytic_subspace, empirical_subspace, energy_bound, kernel_energy
from datasets_synth.heads import Head, make_head, shade_head

IRRADIANCE = (3.142, 2.094, 0.785, 0.0, -0.131, 0.0, 0.049)
"""Equation 29."""

EIGENVALUES = (0.42, 0.33, 0.16, 0.035, 0.021)
"""Figure 9."""

HEAD, SUBJECTS, PHOTOGRAPHS = 3, 12, 3
APPROXIMATIONS = (0, 1, 2, 4)


def _formulas(bench: Bench) -> Found:
    """Return equations 28 and 29, the energies of section 0.3.2, and figures 7 and 8."""
    factors_l = cosine_coefficients(40)
    zonal_l = factors_l * np.sqrt((2.0 * np.arange(41) + 1.0) / (4.0 * np.pi))
    even_l = np.arange(10, 41, 2)
    cumulative = 100.0 * np.cumsum(kernel_energy(2))
    angle_a = np.linspace(0.0, np.pi, 721)
    cosine_a = np.maximum(np.cos(angle_a), 0.0)
    sums = _approximations(zonal_l, angle_a)
    errors = [float(np.abs(sums[degree] - cosine_a).max()) for degree in APPROXIMATIONS]
    values: dict[str, Any] = {
        "irradiance": tuple(factors_l[:7].tolist()),
        "fall": float(np.polyfit(np.log(even_l), np.log(np.abs(zonal_l[even_l])), 1)[0]),
        "irradiance fall": float(np.polyfit(np.log(even_l), np.log(np.abs(factors_l[even_l])), 1)[0]),
        "odd": float(np.abs(zonal_l[3::2]).max()),
        "fourth": 100.0 * abs(factors_l[4]) / factors_l[0],
        "order 2": float(cumulative[2]),
        "order 1": float(cumulative[1]),
        "any light": 100.0 * energy_bound(2),
        "closer": yes(np.all(np.diff(errors) < 0.0)),
        "at 2": errors[2],
    }
    if not bench.draws:
        return Found(values)
    with house_style():
        figure = new_figure(1200, 420, layout="constrained")
        left, right = figure.subplots(1, 2)
        left.plot(np.arange(21), zonal_l[:21], marker="o")
        left.axhline(0.0, color="#b8b8b8", linewidth=0.7)
        left.set_xlabel("l")
        left.set_title("A_l")
        right.plot(angle_a, cosine_a, color="#333333", label="clamped cosine")
        for degree in APPROXIMATIONS:
            right.plot(angle_a, sums[degree], linewidth=1.0, label=f"l ≤ {degree}")
        right.set_xlabel("θ")
        right.legend(frameon=False)
    return Found(values, {"variation_figures7_8.png": figure})


def _approximations(zonal_l: NDArray[np.float64], angle_a: NDArray[np.float64]) -> dict[int, NDArray[np.float64]]:
    along_a3 = np.stack([np.sin(angle_a), np.zeros_like(angle_a), np.cos(angle_a)], axis=1)
    top = max(APPROXIMATIONS)
    basis_ak = evaluate_basis(along_a3, top)
    return {
        degree: basis_ak[:, [l * (l + 1) for l in range(degree + 1)]] @ zonal_l[: degree + 1]
        for degree in APPROXIMATIONS
    }


def _rotation(bench: Bench) -> Found:
    """Return figure 6: the matrix by projecting turned functions, off its blocks, and off the blocks of ours."""
    turn = rotation_matrix("euler", (25.0, 50.0, -65.0))
    nodes_q3, weights_q = product_rule(16, sphere=True)
    matrix_kk = evaluate_basis(nodes_q3, 3).T @ (weights_q[:, None] * evaluate_basis(nodes_q3 @ turn, 3))
    degree_k = degrees_of_coefficients(3)
    off = degree_k[:, None] != degree_k[None, :]
    own_kk = np.zeros_like(matrix_kk)
    for l, block in enumerate(rotation_blocks(turn, 3)):
        own_kk[l * l : (l + 1) ** 2, l * l : (l + 1) ** 2] = block
    values = {"off": float(np.abs(matrix_kk[off]).max()), "apart": float(np.abs(matrix_kk - own_kk).max())}
    if not bench.draws:
        return Found(values)
    with house_style():
        figure = new_figure(420, 400, layout="constrained")
        axes = figure.subplots()
        axes.imshow(own_kk, cmap="RdBu_r", vmin=-1, vmax=1)
        axes.set_title("rotation, l = 0 to 3")
        axes.set_axis_off()
    return Found(values, {"variation_figure6.png": figure})


def _harmonics(bench: Bench) -> Found:
    """Return figure 5: the nine real functions seen from the front, green where positive, blue where negative."""
    at = evaluate_basis(np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]), 2)
    values: dict[str, Any] = {"count": float(at.shape[1])}
    values["axes"] = tuple(float(each) for each in (at[0, 1], at[1, 2], at[2, 3]))
    if not bench.draws:
        return Found(values)
    ball = plain("ball")
    view = look(RayScene(ball), frame_surface(ball, (0.0, -1.0, 0.0)), 96)
    panels = []
    for values_v in evaluate_basis(ball.vertices_v3, 2).T:
        coloured = view.interpolate(surface_figures.signed(values_v[:, None], 0.9))
        panels.append(surface_figures.shown(coloured + (1.0 - view.coverage_hw[..., None])))
    return Found(values, {"variation_figure5.jpg": surface_figures.strip(panels)})


def _faces(bench: Bench) -> Found:
    """Return figure 1: heads under lamps; what differs more, light or people; and what Epstein measured of faces."""
    heads = [make_head(seed, 48) for seed in range(4)]
    inside_hw = np.stack([head.mask_hw for head in heads]).all(axis=0)
    lamps_i3 = make_pattern("uniform", 12)
    pictures = np.stack([_lit(head, lamps_i3)[:, inside_hw] for head in heads])  # (heads, lights, P, 3)
    pictures = pictures / np.linalg.norm(pictures, axis=(2, 3), keepdims=True)
    by_light = np.mean(np.sum((pictures[:, :, None] - pictures[:, None]) ** 2, axis=(-1, -2)))
    by_person = np.mean(np.sum((pictures[:, None] - pictures[None]) ** 2, axis=(-1, -2)))
    whole_i3 = make_pattern("uniform", 64)
    shade_ip = shade_head(make_head(HEAD, 64), whole_i3)
    found = empirical_subspace([shade_ip])
    values = {
        "light over people": float(by_light / by_person),
        "three": 100.0 * found.cumulative(3),
        "five": 100.0 * found.cumulative(5),
    }
    if not bench.draws:
        return Found(values)
    large = make_head(HEAD, 128)
    shown = np.concatenate(list(_lit(large, lamps_i3[::2])), axis=1)
    return Found(values, {"variation_figure1.jpg": to_display((shown / shown.max()).astype(np.float32), "srgb")})


def _lit(head: Head, lamps_i3: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return photographs of a head under single lamps, (n_light, height, width, 3)."""
    shade_ip = shade_head(head, lamps_i3)
    pictures = np.zeros((len(lamps_i3), *head.mask_hw.shape, 3), np.float32)
    pictures[:, head.mask_hw] = shade_ip[:, :, None] * head.albedo_hwc[head.mask_hw]
    return pictures


def _components(bench: Bench) -> Found:
    """Return figure 9: eigenvalues of all pictures of a head, analytically, and pictures of its components."""
    head = make_head(HEAD, 160)
    found = analytic_subspace(head.normals_hw3[head.mask_hw])
    values: dict[str, Any] = {
        "eigenvalues": tuple(found.variance_r[:5].tolist()),
        "three": 100.0 * found.cumulative(3),
        "five": 100.0 * found.cumulative(5),
    }
    if not bench.draws:
        return Found(values)
    factors_k = cosine_coefficients(2)[degrees_of_coefficients(2)]
    basis_pk = evaluate_basis(head.normals_hw3[head.mask_hw].astype(np.float64), 2) * factors_k
    panels = []
    for component_k in found.components_rd[:5]:
        value_p = basis_pk @ component_k
        panel = np.full(head.mask_hw.shape, 128, np.uint8)
        panel[head.mask_hw] = np.clip(128.0 + 120.0 * value_p / np.abs(value_p).max(), 0, 255).astype(np.uint8)
        panels.append(np.repeat(panel[:, :, None], 3, axis=2))
    return Found(values, {"variation_figure9.jpg": surface_figures.strip(panels)})


def _recognition(bench: Bench) -> Found:
    """Return the share of photographs under skies and lamps whose subject is recognised by nine dimensions."""
    heads = [make_head(seed, 40) for seed in range(SUBJECTS)]
    inside_hw = np.stack([head.mask_hw for head in heads]).all(axis=0)
    lights_i3 = make_pattern("uniform", 300, sphere=True)
    gallery = [spaces_of_normals(each.normals_hw3[inside_hw], each.albedo_hwc[inside_hw]) for each in heads]
    rng, right, total = np.random.default_rng(1), {"3d": 0, "9d": 0}, 0
    for who, head in enumerate(heads):
        shade_ip = shade_head(head, lights_i3)
        for make in (sky_light_at, lamps_at):
            for _ in range(PHOTOGRAPHS):
                seen_pc = photograph(head, shade_ip, make(rng, lights_i3), rng)[inside_hw]
                total += 1
                for space in right:
                    right[space] += int(np.argmin([each[space].distance(seen_pc) for each in gallery])) == who
    return Found({name: 100.0 * count / total for name, count in right.items()})


PAPER = Paper(
    "variation",
    "Ramamoorthi: Modeling Illumination Variation with Spherical Harmonics, 2006",
    (
        Work("faces", (
            Row("figure 1", "pictures of a head under lamps apart, over heads under one lamp", "much greater",
                "introduction", "light over people", Between(2.0, 100.0)),
            Row("section 0.2.2", "first three components of a head's photographs, %", "90", "Epstein et al.", "three",
                Near(90.0, 4.0), Between(80.0, 98.0), "rendered heads under 64 lamps of a hemisphere, with shadows"),
            Row("section 0.2.2", "first five components, %", "94", "Epstein et al.", "five", Near(94.0, 4.0),
                Between(85.0, 99.0), "rendered heads under 64 lamps of a hemisphere, with shadows"),
        ), _faces, pictures={"variation_figure1.jpg": "figure 1"}),
        Work("harmonics", (
            Row("figure 5", "functions of the first three orders", "9", "figure 5", "count", Near(9.0, 0.0)),
            Row("figure 5", "order 1 is y, z, x: at their axes", "0.489 (√(3/4π))", "equation 12", "axes",
                Near((0.4886, 0.4886, 0.4886), 1e-4)),
        ), _harmonics, surfaces=True, pictures={"variation_figure5.jpg": "figure 5"}),
        Work("rotation", (
            Row("figure 6", "entries between orders, by quadrature, at most", "0", "figure 6", "off",
                Between(0.0, 1e-12)),
            Row("figure 6", "quadrature and recurrence apart", "0", "equation 16", "apart", Between(0.0, 1e-12)),
        ), _rotation, pictures={"variation_figure6.png": "figure 6"}),
        Work("formulas", (
            Row("equation 29", "E over L of l = 0 to 6", ", ".join(f"{each:g}" for each in IRRADIANCE), "equation 29",
                "irradiance", Near(IRRADIANCE, 0.0005)),
            Row("figure 7", "odd terms above l = 1, at most", "0", "figure 7", "odd", Between(0.0, 1e-15)),
            Row("figure 7", "even A_l fall as l to the", "-2", "below equation 28", "fall", Near(-2.0, 0.1)),
            Row("figure 7", "E of even l fall as l to the", "-5/2", "below equation 28", "irradiance fall",
                Near(-2.5, 0.1)),
            Row("equation 29", "coefficient of l = 4, % of that of l = 0", "about 1", "below equation 29", "fourth",
                Between(0.5, 1.5), Near(4.17, 0.01),
                "π/24 over π is 4.2%; of the energy it is 1.6%"),
            Row("figure 8", "largest error falls with l", "yes", "figure 8", "closer", Holds()),
            Row("figure 8", "largest error of l ≤ 2", "good", "figure 8", "at 2", Near(0.094, 0.001)),
            Row("energy", "half-cosine's in orders 0 to 2, %", "over 99.2", "section 0.3.2", "order 2",
                Between(99.2, 100.0), Near(99.2, 0.05), "99.22 before rounding"),
            Row("energy", "half-cosine's in orders 0 and 1, %", "87.5", "section 0.3.2", "order 1",
                Near(87.5, 0.05)),
            Row("energy", "4D subspace, %", "almost 90", "section 0.3.3", "order 1", Near(90.0, 3.0)),
            Row("energy", "least accuracy of order 2 under any light, %", "at least 98", "section 0.3.2", "any light",
                Near(98.0, 0.05)),
        ), _formulas, pictures={"variation_figures7_8.png": "figures 7 and 8"}),
        Work("components", (
            Row("figure 9", "first five eigenvalues", ", ".join(f"{each:g}" for each in EIGENVALUES), "figure 9",
                "eigenvalues", Near(EIGENVALUES, 0.05)),
            Row("figure 9", "first three eigenmodes, %", "91", "figure 9", "three", Near(91.0, 2.0)),
            Row("figure 9", "first five eigenmodes, %", "97", "figure 9", "five", Near(97.0, 2.0)),
        ), _components, pictures={"variation_figure9.jpg": "figure 9"}),
        Work("recognition", (
            Row("section 0.4.1", "photographs recognised by nine dimensions, %", "over 95", "section 0.4.1", "9d",
                Between(95.0, 100.0)),
            Row("section 0.4.1", "photographs recognised by three, %", "inadequate", "section 0.2.2", "3d",
                Between(0.0, 95.0)),
        ), _recognition, takes=SHORT),
    ),
    (
        Out("figures 2, 3, 4 and 12", "notation, diagrams", "nothing is computed in them; the chapter has no tables"),
        Out("figure 10", "vases and glass that were recognised", "photographs of others, with highlights"),
        Out("figure 11", "objects in Grace Cathedral", "is figure 1 of irradiance environment maps"),
        Out("section 0.6", "near-field illumination, gradients", "declared out of clrelight"),
        Out("section 0.6", "translucency, subsurface scattering, participating media", "declared out of clrelight"),
        Out("section 0.4.3", "structure from video", "declared out of clrelight; normals of a stack are found"),
    ),
)  # fmt: skip
