"""The report of one fit or encoding against its photographs: PSNR by light, and pictures side by side."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.views import Region
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.holdout import split_by_fit
from clrelight.jobs.inputs import lend_fitted, lend_stack, opened_on
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.shown import Shown, shown_of
from clrelight.jobs.split_quality import summarize_split
from clrelight.metrics import check_view, domain_note, measure_errors, psnr_of
from clrelight.relight import to_display
from clrelight.report import canvas
from clrelight.report.comparing import Comparison
from clrelight.report.folder import fill_folder, write_text
from clrelight.report.html import Section, page, plain, table_html
from clrelight.report.markup import to_csv
from clrelight.report.tables import Column, Table
from clrelight.report.vector import to_svg
from clrelight.store import describe

_MOST_DECODED = 4 << 30
"""Bytes of coefficients that an encoding may decode to here."""


def write_file_report(
    source: str | os.PathLike[str],
    stack: str | os.PathLike[str] | LightStack,
    out_dir: str | os.PathLike[str],
    *,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report,
) -> list[Path]:
    """Write ``report.html``, ``lights.csv`` and ``psnr_by_light.png`` of a fit or an encoding into a folder.

    Parameters
    ----------
    source : path
        A fit or an encoded file.
    stack : path or LightStack
        The photographs to compare with.
    out_dir : path
        Made if it does not exist; files of an earlier report are replaced.
    device, progress
        As of `clrelight.jobs.measure.measure`.
    report : Report
        Gets notes, and PSNRs.

    Returns
    -------
    list of Path
        The files written, ``report.html`` first.

    Raises
    ------
    InputError
        If the file is not of this view, matplotlib is not installed, or `out_dir` cannot be written to.
    """
    canvas.require_matplotlib()
    facts = describe(source)
    _check_size(facts)
    with (
        opened_on(device, report) as opened,
        lend_stack(stack, report) as photographs,
        lend_fitted(source, report) as held,
    ):
        shown = shown_of(held, source, opened, report, progress)
        coefficients = shown.coefficients
        check_view(coefficients, photographs)
        report.note(*filter(None, [domain_note(coefficients, photographs)]))
        since = time.perf_counter()
        with stage(progress, "measuring") as tell:
            mse_i = measure_errors(coefficients, photographs, behind=shown.curve, device=opened, progress=tell)
        split = split_by_fit(photographs, coefficients)
        report.psnr = summarize_split(mse_i, coefficients.directions_i3, photographs, split)
        since = report.add("measure", since)
        table = _table(photographs, psnr_of(mse_i), split[1])
        sheet = _compared(shown, photographs, psnr_of(mse_i), split[1])
        report.add("draw", since)
    title = f"{Path(os.fsdecode(source)).name} beside its photographs"
    sections = [
        Section("Pictures side by side", 2, sheet.notes(), sheet.html()),
        Section("PSNR by light", 2, (_HOW,)),
        Section(table.caption, 2, (), table_html(table, file="lights.csv")),
    ]

    def make(aside: Path) -> list[str]:
        with canvas.house_style():
            figure = _draw(photographs.directions_i3, psnr_of(mse_i), split[1])
            canvas.save(figure, aside / "psnr_by_light.png")
            svg = to_svg(figure, "lights", plain(f"PSNR by light. {_HOW}"))
        sections[1] = Section("PSNR by light", 2, (_HOW,), f"<figure>{svg}</figure>")
        write_text(aside / "lights.csv", to_csv(table))
        write_text(aside / "report.html", page(title, _facts(facts, report.psnr or {}), sections))
        return ["lights.csv", "psnr_by_light.png", "report.html"]

    return fill_folder(out_dir, make)


_HOW = (
    "Left: each light in its direction, the view's in the middle, the horizon at the rim. Right: over its elevation. "
    "Squares are lights that the fit has not seen."
)


def _check_size(facts: dict[str, Any]) -> None:
    """Raise InputError if a file is none of these, or decodes to more than should be held."""
    if not str(facts["schema"]).startswith(("fit/", "encoded/")):
        raise InputError(f"{facts['file']} is a {facts['schema']} file: --stack goes with a fit or an encoding")
    if 4 * math.prod(facts.get("shape", [0])) > _MOST_DECODED:
        raise InputError(
            f"{facts['file']} decodes to over {_MOST_DECODED >> 30} GiB: decode it to a fit, and report that"
        )


def _table(stack: LightStack, psnr_i: NDArray[np.float64], held: NDArray[np.intp]) -> Table:
    x, y, z = stack.directions_i3.T
    azimuth, elevation = np.degrees(np.arctan2(y, x)) % 360, np.degrees(np.arcsin(np.clip(z, -1, 1)))
    unseen = set(held.tolist())
    rows = [
        (i, float(azimuth[i]), float(elevation[i]), "held out" if i in unseen else "fitted", float(psnr_i[i]))
        for i in range(stack.n_light)
    ]
    columns = (
        Column("light", "light"),
        Column("azimuth", "azimuth (°)", 1),
        Column("elevation", "elevation (°)", 1),
        Column("seen", "in the fit"),
        Column("psnr", "PSNR (dB)", 2),
    )
    return Table(f"All {stack.n_light} lights of {stack.name}", columns, tuple(rows))


def _compared(shown: Shown, stack: LightStack, psnr_i: NDArray[np.float64], held: NDArray[np.intp]) -> Comparison:
    """Return photographs and what is relit, at the worst, the middle and the best light, and the worst unseen."""
    order = np.argsort(psnr_i, kind="stable")
    named = {int(order[0]): "worst", int(order[len(order) // 2]): "middle", int(order[-1]): "best"}
    if len(held):
        named.setdefault(int(held[np.argmin(psnr_i[held])]), "worst held out")
    sheet, whole = Comparison(stack.image_shape, stack.name), Region(0, 0, *stack.image_shape[:2])
    for light, name in named.items():
        photograph = np.asarray(stack.images_ihwc[light], np.float64) / stack.peak
        relit = shown.relit(stack.directions_i3[light][None], whole)[0]
        pictures = _codes(photograph), to_display(_grey(relit), stack.transfer)
        sheet.add(f"photograph, {name} light ({light})", pictures[0])
        sheet.add(f"relit, {name} light ({light})", pictures[1], pictures[0])
    return sheet


def _codes(values_hwc: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(_grey(values_hwc), 0, 1)).astype(np.uint8)


def _grey(values_hwc: NDArray) -> NDArray:
    """Return 1 or 3 channels: the mean of others."""
    return values_hwc if values_hwc.shape[2] in (1, 3) else values_hwc.mean(axis=2, keepdims=True)


def _draw(directions_i3: NDArray[np.float64], psnr_i: NDArray[np.float64], held: NDArray[np.intp]) -> Any:
    figure = canvas.new_figure(canvas.WIDTH, 620)
    disc, curve = figure.add_axes((0.03, 0.1, 0.4, 0.82)), figure.add_axes((0.58, 0.13, 0.39, 0.79))
    finite = np.isfinite(psnr_i)
    seen = finite.copy()
    seen[held] = False
    unseen = finite & ~seen
    zenith = np.degrees(np.arccos(np.clip(directions_i3[:, 2], -1, 1)))
    radius = np.where(zenith > 0, zenith, 0) / np.maximum(np.hypot(*directions_i3[:, :2].T), 1e-12)
    at = directions_i3[:, :2] * radius[:, None]
    scale = {"vmin": psnr_i[finite].min(), "vmax": psnr_i[finite].max()} if finite.any() else {}
    for chosen, marker in ((seen, "o"), (unseen, "s")):
        points = disc.scatter(*at[chosen].T, c=psnr_i[chosen], marker=marker, s=34, cmap="viridis", **scale)
    disc.add_patch(_circle(90.0))
    disc.set_aspect("equal")
    disc.set_axis_off()
    reach = max(95.0, float(np.abs(at).max(initial=0)) * 1.05)
    disc.set(xlim=(-reach, reach), ylim=(-reach, reach), title="PSNR (dB) by direction; squares: held out")
    bar = figure.colorbar(points, cax=figure.add_axes((0.45, 0.2, 0.012, 0.6)))
    bar.solids.set_rasterized(False)
    elevation = 90 - zenith
    curve.plot(elevation[seen], psnr_i[seen], "o", color="#0072B2", label="fitted")
    if unseen.any():
        curve.plot(elevation[unseen], psnr_i[unseen], "s", color="#D55E00", markerfacecolor="none", label="held out")
    curve.set(xlabel="elevation of the light (°)", ylabel="PSNR (dB)", title="PSNR by elevation")
    curve.grid(True)
    curve.legend(frameon=False)
    return figure


def _circle(radius: float) -> Any:
    from matplotlib.patches import Circle

    return Circle((0, 0), radius, fill=False, color=canvas.FAINT)


def _facts(facts: dict[str, Any], psnr: dict[str, float]) -> list[tuple[str, str]]:
    about = facts["attributes"]
    told = [
        ("File", f"{facts['schema']}, {facts['bytes_on_disk']} bytes"),
        ("Fit", f"{about['method']}, degree {about['degree']}, of {about['name']}"),
    ]
    if "codec" in about:
        told.append(("Codec", f"{about['codec']}, {about['bits_per_coefficient']:.4g} bit per coefficient"))
    for name, title in (("fitted", "PSNR, fitted lights"), ("holdout", "PSNR, held out")):
        if f"mean_{name}" in psnr:
            told.append(
                (title, f"{psnr[f'mean_{name}']:.2f} dB mean over lights, {psnr[f'pooled_{name}']:.2f} dB pooled")
            )
    return told
