"""Tables and pictures of docs/shrm.md: costs, errors and views of reflection maps under real light.

``python -m benchmarks.reflection --markdown docs/shrm.md --pictures docs/images`` renews both; it takes some minutes,
most of them for integration over angles. The probes are those of ``CLRELIGHT_DATA``;
numbered tables those of frequency-space-environment-maps.
"""

from __future__ import annotations

import io
import json
import os
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import click
import numpy as np

from benchmarks.commands import run_command
from benchmarks.pages import replace_block
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.named import make_brdf
from clrelight.cli.app import run
from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.lighting.environment import Environment, read_environment
from clrelight.lighting.projection import project_environment
from clrelight.lighting.relighting import automatic_exposure
from clrelight.relight import to_display
from clrelight.shrm.angular import integrate_directions, weighted_texels
from clrelight.shrm.explicit import view_map
from clrelight.shrm.lookup import look_up, view_sphere
from clrelight.shrm.prefilter import build_shrm

PROBE, AXES = "grace_latlong.exr", "right,forward,down"
_SIZE, _ROWS = 96, 64
_VIEW = np.array([0.0, -1.0, 0.25])


def shown(words: list[str]) -> dict:
    """Return what a command prints with --json."""
    out = io.StringIO()
    with redirect_stdout(out):
        code = run([*words, "--json"])
    if code != 0:
        raise InputError(f"clrelight {' '.join(words)} ended with exit code {code}")
    return json.loads(out.getvalue())


def to_table(headers: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    lines = ["| " + " | ".join(headers) + " |", "|" + "---|" * len(headers)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def orders_table(probe: Path, paint: Path) -> str:
    """Return the energy up to some orders."""
    accuracy = shown(["shrm", "plan", str(probe), "--axes", AXES, "--brdf", "phong", "--exponent", "32"])
    degrees = (4, 6, 8, 10, 12, 16)
    columns = list(zip(*accuracy["accuracy"], strict=True))
    names = ("reflected", "light alone", "reflectance alone", "bound")
    rows = [[name, *(f"{columns[i][f]:.4f}" for f in degrees)] for i, name in enumerate(names, start=1)]
    return to_table(["F", *map(str, degrees)], rows)


def costs_table(probe: Path, paint: Path) -> str:
    """Return table 3."""
    found = benched(probe, "costs")["rows"]
    rows = [[name, f"{each['theory']:g}", f"{each['slope']:.2f}"] for name, each in found.items()]
    return to_table(["cost of", "theory", "measured"], rows)


def phong_table(probe: Path, paint: Path) -> str:
    """Return table 4."""
    lobes = benched(probe, "phong")
    rows = [
        [f"{r['s']}", f"{r['degree']}", f"{r['angular']:.3f}", f"{r['frequency']:.4f}", f"{r['ratio']:.0f}"]
        for r in lobes["rows"]
    ]
    return f"Device: {lobes['device']}.\n\n" + to_table(["s", "F", "by angles, s", "by orders, s", "ratio"], rows)


def microfacets_table(probe: Path, paint: Path) -> str:
    """Return table 5."""
    rows = []
    for r in benched(probe, "microfacets")["rows"]:
        seconds = f"{r['image']:.2f}", f"{r['images']:.0f}", f"{r['frequency']:.3f}", f"{r['shrm']:.4f}"
        rows.append([f"{r['sigma']:g}", f"{r['degree']}, {r['order']}", *seconds])
    headers = ["σ", "F, P", "one map by angles, s", "100 maps, s", "100 maps by orders, s", "whole SHRM, s"]
    return to_table(headers, rows)


def peers_table(probe: Path, paint: Path) -> str:
    """Return errors beside those of two other ways."""
    names = ["microfacet", "skin", "kajiya-kay", str(paint)]
    found = benched(probe, "peers", *(word for name in names for word in ("--brdf", name)))["rows"]
    rows = []
    for name, r in zip(names, found, strict=True):
        errors = [*(r["orders"][str(p)]["error"] for p in range(6)), r["texture"], r["icosahedron"]]
        rows.append([Path(name).stem.replace("_", " "), *(f"{error:.3f}" for error in errors)])
    return to_table(["RMS error", *(f"P = {p}" for p in range(6)), "3-D texture", "12 maps"], rows)


def benched(probe: Path, table: str, *words: str) -> dict[str, Any]:
    """Return what ``clrelight shrm bench`` finds."""
    return shown(["shrm", "bench", str(probe), "--axes", AXES, "--table", table, *words])


TABLES = {
    "orders": orders_table,
    "costs": costs_table,
    "phong": phong_table,
    "microfacets": microfacets_table,
    "peers": peers_table,
}


def picture(probe: Path, paint: Path) -> np.ndarray:
    """Return spheres of six reflectances: the truth above, reflection maps below."""
    whole, _ = read_environment(probe, axes=AXES)
    height, width, channel = whole.radiance_hwc.shape
    blocks = whole.radiance_hwc.reshape(_ROWS, height // _ROWS, 2 * _ROWS, width // (2 * _ROWS), channel)
    environment = Environment(blocks.mean(axis=(1, 3)), "latlong", AXES)
    light = project_environment(environment, _ROWS // 2 - 1)
    directions, weighted = weighted_texels(environment)
    columns = []
    for name, numbers, orders in (
        ("lambert", {}, (2, 0)),
        ("phong", {"exponent": 32.0}, (15, 0)),
        ("microfacet", {"sigma": 0.2}, (20, 5)),
        ("skin", {}, (30, 5)),
        ("kajiya-kay", {"exponent": 32.0}, (20, 10)),
        (str(paint), {}, (30, 5)),
    ):
        brdf = make_brdf(name, **numbers)
        shrm = build_shrm(light, brdf_coefficients(brdf, *orders), 10 * orders[0], frame="global")
        sphere = view_sphere(_SIZE, _VIEW, brdf.centre)
        truth_nc = integrate_directions(directions, weighted, brdf, sphere.central_n3, sphere.view_3)
        found_nc = look_up(view_map(shrm, sphere.view_3), sphere.central_n3)
        truth, found = (sphere.picture(values).astype(np.float32) for values in (truth_nc, found_nc))
        scale = np.float32(2.0 ** automatic_exposure(truth))
        columns.append(np.concatenate([to_display(scale * each, "srgb") for each in (truth, found)]))
    return np.concatenate(columns, axis=1)


@click.command()
@click.option("--markdown", type=click.Path(path_type=Path), help="Page whose blocks are renewed.")
@click.option("--pictures", type=click.Path(path_type=Path), help="Folder of shrm_spheres.png and shrm_accuracy.png.")
@click.option("--only", type=click.Choice(list(TABLES)), multiple=True, help="These tables; repeatable.")
def main(markdown: Path | None, pictures: Path | None, only: tuple[str, ...]) -> None:
    """Renew the tables and pictures of docs/shrm.md."""
    data = Path(os.environ.get("CLRELIGHT_DATA") or "../shared/data")
    probe, paint = data / "probes" / PROBE, data / "brdf" / "krylon_blue.brdf"
    if not probe.is_file():
        raise click.UsageError(f"there is no {probe}: CLRELIGHT_DATA must name the folder of probes")
    if pictures is not None:
        chart = ["--brdf", "phong", "--exponent", "32", "--chart", str(pictures / "shrm_accuracy.png"), "--json"]
        run_command(["shrm", "plan", str(probe), "--axes", AXES, *chart])
        write_image(pictures / "shrm_spheres.png", picture(probe, paint))
    if markdown is not None:
        for name in only or TABLES:
            replace_block(markdown, TABLES[name](probe, paint), f"<!-- {name} -->", f"<!-- /{name} -->")


if __name__ == "__main__":
    main()
