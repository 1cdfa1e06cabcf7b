"""Figures 1, 5, 7, 8, 9 and 10 of frequency-space-environment-maps, as pictures and as tables of RMS errors."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.lafortune import SKIN
from clrelight.brdf.measured import MeasuredBrdf, read_brdf
from clrelight.brdf.radial import Phong
from clrelight.durable import replacing
from clrelight.harmonics.index import degrees_of_coefficients
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.report.canvas import house_style, new_figure
from clrelight.reproduction.reflection_stage import Shown, Stage, difference, paints, relative
from clrelight.shrm.orders import degree_energies, luminance
from clrelight.shrm.painting import Mesh
from clrelight.shrm.prefilter import build_shrm
from clrelight.transfer.cameras import Framing
from clrelight.transfer.mesh_files import read_mesh

DEGREE, SIZE = 30, 72
VIEWS = ((0.0, -1.0, 0.25), (0.8, -0.5, -0.3))
PROBES = {
    "Grace Cathedral": ("grace_latlong.exr", "right,forward,down"),
    "beach": ("beach_probe.hdr", "z-up"),
    "Galileo's tomb": ("galileo_cross.dds", "z-up"),
}
Panels = list[list[Shown]]
Table = tuple[list[str], list[list[str]]]


def figure_1(data: Path) -> tuple[Panels, Table]:
    """Return armadillos under three captured lights by one map each, and errors at some points."""
    surface = read_mesh(data / "meshes" / "armadillo.ply", up="y")
    krylon = MeasuredBrdf(read_brdf(data / "brdf" / "krylon_blue.brdf"))
    garnet = MeasuredBrdf(read_brdf(data / "brdf" / "garnet_red.brdf"))
    scenes = (
        ("microfacets, 0.2", Microfacet(0.2), "Grace Cathedral", (20, 5)),
        ("Krylon blue", krylon, "beach", (DEGREE, 5)),
        ("garnet red", garnet, "Galileo's tomb", (DEGREE, 5)),
        ("fibres, 32", KajiyaKay(32.0), "Grace Cathedral", (20, 10)),
    )
    camera = Framing(direction_3=(0.3, 1.0, 0.15), field_of_view=20.0).place(surface)
    mesh = Mesh(surface, (200, 200), 2)
    panels, rows = [], []
    for name, brdf, probe, orders in scenes:
        stage = Stage.of(data / "probes" / PROBES[probe][0], PROBES[probe][1])
        shrm = stage.shrm(brdf, *orders)
        picture = mesh.paint(shrm, camera, np.eye(3))
        errors = stage.errors_at(mesh, camera, shrm, brdf)
        rows.append([name, probe, f"{orders[0]}, {orders[1]}", *(f"{error:.3f}" for error in errors)])
        panels.append(Shown(stage.behind(picture, camera), f"{name.split(',')[0]}, {probe}", errors[0]))
    return [panels], (["reflectance", "light", "F, P", "one map", "own views"], rows)


def figure_5(data: Path) -> tuple[Panels, Table]:
    """Return spheres of sharper light to the top and sharper lobes to the right, and the degrees that they hold.

    The light is blurred by Gauss's window ``exp(-l^2 / 2 w^2)``, whose lobe of exponent ``w^2`` is Phong's; what is
    reflected holds 99% of its energy about up to the lesser of the degrees of both.
    """
    stage = Stage.of(data / "probes" / PROBES["Grace Cathedral"][0], PROBES["Grace Cathedral"][1])
    widths, exponents = (4.0, 8.0, 16.0, 32.0), (8.0, 32.0, 128.0, 512.0)
    degree = 60
    light = project_environment(stage.whole, degree)
    panels, rows = [], []
    for width in reversed(widths):
        blurred = filtered(light, np.exp(-0.5 * (np.arange(degree + 1) / width) ** 2))
        of_light = _held(blurred)
        line, row = [], [f"{of_light}"]
        for exponent in exponents:
            lobe = brdf_coefficients(Phong(exponent), degree, 0)
            reflected = filtered(blurred, Phong(exponent).factors(degree))
            shrm = build_shrm(blurred, lobe, 180, frame="global")
            line.append(Shown(stage.sphere(shrm, VIEWS[0], SIZE), f"light {of_light}, shown {_held(reflected)}"))
            row.append(f"{_held(reflected)}")
        panels.append(line)
        rows.append(row)
    white = Light(np.ones(((degree + 1) ** 2, 1)))  # as much in each order, as a lamp
    heads = [f"s = {s:g}, its own {_held(filtered(white, Phong(s).factors(degree)))}" for s in exponents]
    return panels, (["light alone", *heads], rows)


def filtered(light: Light, factors_l: NDArray[np.float64]) -> Light:
    """Return a light with each degree times a factor."""
    factors_k = factors_l[degrees_of_coefficients(light.degree)]
    return replace(light, coeffs_kc=factors_k[:, None] * light.coeffs_kc)


def _held(light: Light, share: float = 0.99) -> int:
    """Return up to which degree a light holds a share of its energy but for degree 0."""
    energies_l = degree_energies(luminance(light.coeffs_kc))
    energies_l[0] = 0.0
    return int(np.searchsorted(np.cumsum(energies_l), share * energies_l.sum()))


def figure_7(data: Path) -> tuple[Panels, Table]:
    """Return microfacets, 0.2, of orders P = 0 .. 5 in two views, their differences, and the truth."""
    stage, brdf = Stage.grace(data), Microfacet(0.2)
    truths = [stage.truth(brdf, view, SIZE) for view in VIEWS]
    panels: Panels = [[] for _ in range(2 * len(VIEWS))]
    row, shares = ["RMS error"], ["energy of the reflectance"]
    for order in range(6):
        shrm = stage.shrm(brdf, DEGREE, order)
        found = [stage.sphere(shrm, view, SIZE) for view in VIEWS]
        share = float(brdf_coefficients(brdf, DEGREE, order).shares()[-1, -1, 0])
        for i, (picture, truth) in enumerate(zip(found, truths, strict=True)):
            error = relative([picture], [truth])
            panels[2 * i].append(Shown(picture, f"P = {order}", error, truth))
            panels[2 * i + 1].append(Shown(difference(picture, truth), "difference", is_difference=True))
        row.append(f"{relative(found, truths):.3f}")
        shares.append(f"{share:.3f}")
    for i, truth in enumerate(truths):
        panels[2 * i].append(Shown(truth, "integrated"))
    return panels, (["σ = 0.2", *(f"P = {order}" for order in range(6))], [shares, row])


def figure_8(data: Path) -> tuple[Panels, Table]:
    """Return the energy of every reflectance up to P = 0 .. 5 at F = 30; the chart is drawn by `chart_8`."""
    rows = []
    for name, brdf in reflectances(data).items():
        shares_p = brdf_coefficients(brdf, DEGREE, 5).shares()[-1].mean(axis=1)
        rows.append([name, *(f"{share:.3f}" for share in shares_p)])
    return [], (["energy, F = 30", *(f"P = {order}" for order in range(6))], rows)


def reflectances(data: Path) -> dict[str, CentredBrdf]:
    """Return what figure 8 shows: five paints, skin, microfacets and fibres."""
    named: dict[str, CentredBrdf] = {name: MeasuredBrdf(read_brdf(file)) for name, file in paints(data).items()}
    named["skin"] = SKIN
    named |= {f"microfacets, {sigma:g}": Microfacet(sigma) for sigma in (0.1, 0.2, 0.3, 0.5)}
    return named | {"fibres, 8": KajiyaKay(8.0), "fibres, 32": KajiyaKay(32.0)}


def figure_9(data: Path) -> tuple[Panels, Table]:
    """Return the truth, P = 5, and Kautz and McCool's texture of 36 angles, as many maps."""
    krylon = MeasuredBrdf(read_brdf(paints(data)["Krylon blue"]))
    return _beside(data, {"Krylon blue": (krylon, 5), "skin": (SKIN, 5)}, texture=True)


def figure_10(data: Path) -> tuple[Panels, Table]:
    """Return the truth, as many maps as P = 5 or fewer, and Cabral's twelve maps."""
    return _beside(data, {"skin": (SKIN, 5), "fibres, 32": (KajiyaKay(32.0), 11)}, texture=False)


def _beside(data: Path, chosen: dict, *, texture: bool) -> tuple[Panels, Table]:
    stage, panels, rows = Stage.grace(data), [], []
    peer_name = "3-D texture, 36 maps" if texture else "12 maps"
    for name, (brdf, order) in chosen.items():
        view = VIEWS[1] if texture else VIEWS[0]
        truth = stage.truth(brdf, view, SIZE)
        shrm = stage.shrm(brdf, DEGREE, order)
        found = stage.sphere(shrm, view, SIZE)
        peer = stage.texture(brdf, view, SIZE, 36) if texture else stage.icosahedron(brdf, view, SIZE)
        errors = [relative([each], [truth]) for each in (found, peer)]
        ours = f"P = {order}, {len(shrm.maps_khwc)} maps"
        panels.append([Shown(truth, f"{name}, integrated"), Shown(found, ours, errors[0], truth)])
        panels[-1].append(Shown(peer, peer_name, errors[1], truth))
        rows.append([name, f"{order}", f"{len(shrm.maps_khwc)}", *(f"{error:.3f}" for error in errors)])
    return panels, (["reflectance", "P", "maps", "RMS error", peer_name], rows)


FIGURES: dict[str, Callable[[Path], tuple[Panels, Table]]] = {
    "1": figure_1,
    "5": figure_5,
    "7": figure_7,
    "8": figure_8,
    "9": figure_9,
    "10": figure_10,
}


def draw(path: Path, panels: Panels, across: int = 130) -> None:
    """Write rows of pictures with what they are below them."""
    columns = max(len(row) for row in panels)
    side = max(across, 220) if columns <= 4 and len(panels) <= 2 else across
    width, height = columns * (side + 6), len(panels) * (side + 30)
    with house_style():
        figure = new_figure(width, height)
        for i, row in enumerate(panels):
            for j, shown in enumerate(row):
                below = 1 - (i * (side + 30) + side) / height
                axes = figure.add_axes(((j * (side + 6) + 3) / width, below, side / width, side / height))
                axes.imshow(shown.display(), interpolation="antialiased")
                axes.set_axis_off()
                axes.text(
                    0.5,
                    -0.1 * 130 / side,
                    shown.label(),
                    fontsize=5.2,
                    ha="center",
                    va="center",
                    transform=axes.transAxes,
                )
        content = io.BytesIO()
        figure.savefig(content, format="jpg", dpi=150, pil_kwargs={"quality": 88})
    with replacing(path) as part:
        part.write(content.getvalue())


def chart_8(path: Path, table: Table) -> None:
    """Draw one row of six marks for each reflectance, the last one filled (figure 8)."""
    rows = table[1]
    with house_style():
        figure = new_figure(1000, 90 + 42 * len(rows))
        axes = figure.add_axes((0.2, 0.12, 0.76, 0.85))
        for y, row in enumerate(rows):
            values = [float(value) for value in row[1:]]
            axes.plot(values, [y] * 6, color="#b8b8b8", linewidth=0.8, zorder=1)
            axes.scatter(values[:-1], [y] * 5, marker="D", s=16, color="#b8b8b8", zorder=2)
            axes.scatter(values[-1:], [y], s=26, color="#333333", zorder=3)
        axes.set_yticks(range(len(rows)), [row[0] for row in rows])
        axes.invert_yaxis()
        axes.set_xlim(0, 1)
        axes.set_xlabel("energy up to P = 0 … 5 (black: 5), F = 30")
        axes.grid(True, axis="x")
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=150, metadata={"Software": None})
    with replacing(path) as part:
        part.write(content.getvalue())
