"""The report of a sweep: what each single step costs and saves, the settings that nothing beats, and a chart of all."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.experiment.axes import HALF
from clrelight.experiment.pareto import Trial, find_reference, pareto_front, recommend, search_label, storage_label
from clrelight.fit.cls import ConstrainedLeastSquares
from clrelight.fit.precision import MIXED
from clrelight.report import canvas
from clrelight.report.folder import fill_folder, write_text
from clrelight.report.html import Section, page, plain, table_html
from clrelight.report.markup import to_csv, to_markdown
from clrelight.report.rows import method_label, method_rank
from clrelight.report.tables import Cell, Column, Table, all_rows
from clrelight.report.vector import to_svg
from clrelight.results import Results

CHART = "trade.png"
_SHOWN_DB = 15.0
"""Decibels below the best that the charts show."""
_FIT_COLUMNS = (
    Column("what", "one step"),
    Column("psnr", "held out (dB)", 2),
    Column("change", "change (dB)", 3),
    Column("seconds", "time (s)", 3),
    Column("time", "time ×", 2),
    Column("size", "kB", 1),
    Column("bytes", "bytes ×", 3),
)
_FRONT_COLUMNS = (
    Column("label", "setting"),
    Column("psnr", "held out (dB)", 2),
    Column("fitted", "fitted (dB)", 2),
    Column("size", "kB", 1),
    Column("fit", "fit (s)", 3),
    Column("encode", "encode (s)", 3),
    Column("decode", "decode (s)", 3),
    Column("fronts", "best for its"),
)
_HALF_COLUMNS = (
    Column("method", "method"),
    Column("degree", "degree"),
    Column("energy", "mean ‖c‖²", 2),
    Column("psnr", "float32, held out (dB)", 2),
    Column("held", "half, change (dB)", 3),
    Column("fitted", "at fitted lights (dB)", 3),
)


def step_table(trials: Sequence[Trial]) -> Table:
    """Return what changing one thing of the reference changes.

    Fewer bisection steps start from the most that were tried, a precision from mixed precision of the same model.
    """
    reference = find_reference(trials)
    rows: list[tuple[Cell, ...]] = [(f"({reference.label})", *_changes(reference, reference))]
    rows += [(what, *_changes(base, trial)) for what, base, trial in _steps(trials, reference)]
    return Table("One step away from the reference", _FIT_COLUMNS, tuple(rows))


def _steps(trials: Sequence[Trial], reference: Trial) -> Iterator[tuple[str, Trial, Trial]]:
    """Yield name, starting point and trial of each single step that was measured."""
    model = reference.model
    plain = [trial for trial in trials if trial.setting.codec is None and trial.model.precision == MIXED]
    for trial in plain:
        if trial.model.lights is None and trial.model.method == model.method and trial.model.degree != model.degree:
            yield f"degree {model.degree} → {trial.model.degree}", reference, trial
    yield from _search_steps(plain, reference)
    yield from _precision_steps(trials, reference)
    for trial in plain:
        if trial.model.lights is not None and (trial.model.method, trial.model.degree) == (model.method, model.degree):
            yield f"lights {reference.row['n_light']} → {trial.model.lights}", reference, trial
    for trial in plain:
        if (
            trial.model.lights is None
            and trial.model.degree == model.degree
            and trial.model.method.id != model.method.id
        ):
            yield f"{model.method.id} → {trial.model.method.id}", reference, trial
    for trial in trials:
        if trial.setting.codec is not None and trial.model == model:
            yield f"float32 → {storage_label(trial.setting)}", reference, trial


def _search_steps(plain: Sequence[Trial], reference: Trial) -> Iterator[tuple[str, Trial, Trial]]:
    model = reference.model
    halved, newton = {}, {}
    for trial in plain:
        method = trial.model.method
        if trial.model == replace(model, method=method) and isinstance(method, ConstrainedLeastSquares):
            if method.solver == "bisection":
                halved[method.iterations] = trial
            elif not method.ends:
                newton[search_label(method)] = trial
    if halved:
        most = max(halved)
        for steps, trial in sorted(halved.items(), reverse=True):
            if steps != most:
                yield f"bisection steps {most} → {steps}", halved[most], trial
        yield f"bisection, {most} steps → newton", halved[most], reference
    for label, trial in newton.items():
        yield f"newton to its end → {label}", reference, trial


def _precision_steps(trials: Sequence[Trial], reference: Trial) -> Iterator[tuple[str, Trial, Trial]]:
    mixed = {(trial.model, trial.setting): trial for trial in trials if trial.model.precision == MIXED}
    pairs = [
        (mixed[replace(trial.model, precision=MIXED), trial.setting], trial)
        for trial in trials
        if trial.model.precision != MIXED
    ]
    for base, trial in sorted(pairs, key=lambda pair: pair[0] is not reference):
        of = "" if base is reference else f"{base.model.label}: "
        yield f"{of}{MIXED} precision → {trial.model.precision}", base, trial


def _changes(base: Trial, trial: Trial) -> tuple[float, ...]:
    seconds = trial.seconds if trial.seconds < math.inf else math.nan
    psnr = trial.psnr if trial.psnr > -math.inf else math.nan
    size = float(trial.size) or math.nan
    return psnr, psnr - base.psnr, seconds, seconds / base.seconds, size / 1000.0, size / base.size


def about_excerpt(trials: Sequence[Trial]) -> str:
    """Return what part of an image was measured, and what is reckoned from it."""
    row, scale = trials[0].row, trials[0].scale
    part = int(row["height"]) * int(row["width"]) / 1e6
    return f"{part:.2g} of {part * scale:.3g} megapixels, in windows; seconds and bytes are reckoned for all of them"


def half_table(trials: Sequence[Trial]) -> Table:
    """Return what half precision costs each method at each degree, fitted to all lights."""
    plain = {trial.model: trial for trial in trials if trial.setting.codec is None}
    rows = []
    for trial in trials:
        if trial.setting.id == HALF and trial.model in plain and trial.model.lights is None:
            full = plain[trial.model].row
            held, fitted = (float(trial.row[name] - full[name]) for name in ("psnr_pooled_holdout", "psnr_pooled"))
            rows.append(
                (trial.model.method.id, trial.model.degree, float(full["mean_energy"]),
                 float(full["psnr_pooled_holdout"]), held, fitted)
            )  # fmt: skip
    return Table("Half precision instead of float32", _HALF_COLUMNS, tuple(rows))


def front_table(trials: Sequence[Trial], taken: Trial | None = None) -> Table:
    """Return the settings that are optimal in bytes and PSNR, or in time and PSNR, the smallest first.

    `taken` is marked, by default what is recommended where nothing is asked for.
    """
    by_size, by_time = pareto_front(trials, "size", "psnr"), pareto_front(trials, "seconds", "psnr")
    taken = taken or recommend(trials)
    rows: list[tuple[Cell, ...]] = []
    for trial in sorted({*by_size, *by_time, taken}, key=lambda t: (t.size, t.seconds)):
        row = trial.row
        fronts = [name for name, kept in (("bytes", by_size), ("time", by_time)) if trial in kept]
        said = ", ".join([*([" and ".join(fronts)] if fronts else []), *(["taken"] if trial is taken else [])])
        rows.append((trial.label, trial.psnr, float(row["psnr_pooled"]), trial.size / 1000.0, *trial.stages, said))
    return Table("What nothing smaller, or nothing faster, beats", _FRONT_COLUMNS, tuple(rows))


def trade_chart(trials: Sequence[Trial], name: str, taken: Trial | None = None) -> Any:
    """Draw all trials as PSNR against time, PSNR against bytes, bytes against time; fronts; what is taken."""
    from matplotlib.lines import Line2D

    figure = canvas.new_figure(canvas.WIDTH, 560)
    usable = [trial for trial in trials if trial.psnr > -math.inf]
    methods = sorted({trial.model.method.id for trial in usable}, key=method_rank)
    colours = canvas.method_colours(methods)
    best = max(trial.psnr for trial in usable)
    panels = (("seconds", "psnr"), ("size", "psnr"), ("seconds", "size"))
    for index, (cost, value) in enumerate(panels):
        axes = figure.add_axes((_LEFTS[index], 0.25, 0.24, 0.64))
        points = [(_shown(t, cost), _shown(t, value)) for t in usable]
        for trial, (x, y) in zip(usable, points, strict=True):
            colour = colours[trial.model.method.id]
            axes.plot(
                x, y, _marker(trial), color=colour, markerfacecolor=colour if trial.model.lights is None else "white"
            )
        taken = taken or recommend(trials)
        ring: dict[str, Any] = {"markersize": 13, "markerfacecolor": "none", "markeredgecolor": canvas.INK}
        axes.plot(_shown(taken, cost), _shown(taken, value), "o", **ring)
        edge = [(_shown(t, cost), _shown(t, value)) for t in pareto_front(usable, cost, value)]
        axes.step(*zip(*edge, strict=True), where="post", color=canvas.FAINT, linewidth=5, alpha=0.6, zorder=0)
        axes.set_xscale("log")
        if value == "psnr":
            axes.set_ylim(max(best - _SHOWN_DB, min(y for _, y in points) - 0.5), best + 0.5)
        else:
            axes.set_yscale("log")
            _mark_decades(axes.yaxis, value)
        _mark_decades(axes.xaxis, cost)
        axes.set_xlabel(_TITLES[cost])
        axes.set_ylabel(_TITLES[value])
        axes.grid(True)
        axes.set_axisbelow(True)
    figure.suptitle(f"{name}: held-out lights", x=0.01, ha="left", fontsize=10)
    handles = [Line2D([], [], linestyle="", marker="o", color=colours[m], label=method_label(m)) for m in methods]
    for marker, text in (("o", "float32"), ("s", "half"), ("v", "other codecs")):
        handles.append(Line2D([], [], linestyle="", marker=marker, color=canvas.INK, label=text))
    handles.append(
        Line2D([], [], linestyle="", marker="o", color=canvas.INK, markerfacecolor="white", label="fewer lights")
    )
    handles.append(Line2D([], [], color=canvas.FAINT, linewidth=5, alpha=0.6, label="front"))
    handles.append(Line2D([], [], linestyle="", marker="o", label="taken", **ring))
    figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.05, 0.0),
        ncols=len(handles),
        frameon=False,
        columnspacing=1.2,
        handletextpad=0.4,
    )
    return figure


def _mark_decades(axis: Any, what: str) -> None:
    """Label few powers of ten with plain numbers, sizes with their units: the panels are too narrow for more."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(numticks=5))
    axis.set_major_formatter(FuncFormatter(lambda value, _: _size(value) if what == "size" else f"{value:,.10g}"))
    axis.set_minor_formatter(NullFormatter())


def _size(kilobytes: float) -> str:
    """Return a size in six characters or fewer."""
    for unit, each in (("GB", 1e6), ("MB", 1e3), ("kB", 1.0)):
        if kilobytes >= each:
            return f"{kilobytes / each:.3g} {unit}"
    return f"{kilobytes * 1000:.3g} B"


_LEFTS = 0.055, 0.375, 0.725
"""Of the panels; the third one's ticks are the widest."""
_TITLES = {"seconds": "fit, encode and decode (s)", "size": "bytes", "psnr": "PSNR (dB)"}


def _shown(trial: Trial, axis: str) -> float:
    return trial.size / 1000.0 if axis == "size" else float(getattr(trial, axis))


def _marker(trial: Trial) -> str:
    if trial.setting.codec is None:
        return "o"
    return "s" if trial.setting.id == HALF else "v"


def write_trade_report(
    trials: Sequence[Trial], name: str, out_dir: str | os.PathLike[str], taken: Trial | None = None
) -> list[Path]:
    """Write the tables (Markdown, HTML; all rows as CSV) and the chart into a folder; the page's path comes first.

    Rows are as measured; tables and chart have seconds and bytes of the whole image.

    Raises
    ------
    InputError
        If matplotlib is not installed, or the folder cannot be written to.
    """
    canvas.require_matplotlib()

    def make(aside: Path) -> list[str]:
        title = f"{name}: what each choice costs"
        with canvas.house_style():
            chart = trade_chart(trials, name, taken)
            canvas.save(chart, aside / CHART)
            svg = to_svg(chart, "trade", plain(f"{title}: held-out PSNR, size and time of each setting"))
        rows = all_rows(Results(np.array([trial.row for trial in trials])))
        write_text(aside / "rows.csv", to_csv(rows))
        tables = [made for made in (step_table(trials), front_table(trials, taken), half_table(trials)) if made.rows]
        parts = [f"# {title}\n", f"{about_excerpt(trials)}\n\n" * (trials[0].scale > 1.0) + f"![fronts]({CHART})\n"]
        for made in tables:
            parts += [f"## {made.caption}\n", to_markdown(made)]
        write_text(aside / "trade.md", "\n".join(parts))
        lead = f"<p>{about_excerpt(trials)}</p>" * (trials[0].scale > 1.0)
        sections = [Section("Fronts", 2, (), f"{lead}<figure>{svg}</figure>")]
        sections += [Section(made.caption, 2, (), table_html(made)) for made in tables]
        sections.append(Section("All settings that were tried", 2, (), table_html(rows, file="rows.csv")))
        write_text(aside / "trade.html", page(title, [], sections))
        return [CHART, "rows.csv", "trade.html", "trade.md"]

    return fill_folder(out_dir, make)
