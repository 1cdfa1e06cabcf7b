"""Charts: coefficient magnitudes (figure 7), PSNR against wavelet rate (figure 15), PSNR against bytes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from clrelight.report.canvas import FAINT, INK, label_ends, label_width, method_colours, new_figure, plain_log_axis
from clrelight.report.rows import (
    Setting,
    method_label,
    method_rank,
    parse_profile_key,
    rows_by_key,
    scene_rows,
    setting_of,
    text,
)
from clrelight.report.tables import PLAIN
from clrelight.results import Results

WIDTH, LEFT = 1350, 100  # pixels: a chart, and the margin left of its axes

RATE_RANGE = (0.25, 8.0)
"""Bits per coefficient shown in figure 15, at least."""

CODEC_MARKERS = {"none": "o", "half": "s", "s3tc": "^", "uniform": "D", "wavelet": "."}
CURVE_MARKERS = "os^Dv"
OTHER_MARKERS = ("v", "P", "X", "*", "<", ">")


def all_methods(results: Results) -> list[str]:
    """Return the methods in the paper's order: what colours follow, in every picture alike."""
    named = {text(name) for name in results.table["method"]}
    return sorted(named | {parse_profile_key(key)[1] for key in results.profiles}, key=method_rank)


def figure_7(results: Results, scene: str, degree: int) -> Any | None:
    """Draw |c_k| of a typical pixel per method, each on its own scale (figure 7); None without profiles."""
    profiles = {
        method: np.abs(np.asarray(values, dtype=np.float64))
        for key, values in results.profiles.items()
        for name, method, profile_degree in [parse_profile_key(key)]
        if (name, profile_degree) == (scene, degree)
    }
    methods = sorted(profiles, key=method_rank)
    if not methods:
        return None
    figure = new_figure(WIDTH, 165 + 230 * len(methods), layout="constrained")
    panels = figure.subplots(len(methods), 1, sharex=True, squeeze=False)[:, 0]
    colours = method_colours(all_methods(results))
    bands = math.isqrt(max(len(values) for values in profiles.values()) - 1) + 1
    for axes, method in zip(panels, methods, strict=True):
        values = profiles[method]
        finite = np.where(np.isfinite(values), values, 0.0)
        for band in range(0, bands, 2):
            axes.axvspan(band**2 - 0.5, (band + 1) ** 2 - 0.5, color="#f1f1f1", linewidth=0)
        axes.bar(np.arange(len(values)), finite, width=0.72, color=colours[method])
        largest = int(np.argmax(finite))
        scale = f"largest |c| = {finite[largest]:.3g} at k = {largest},  ‖c‖² = {np.sum(finite**2):.3g}"
        if lost := int(np.sum(~np.isfinite(values))):
            scale += f",  {lost} not finite"
        axes.set_title(method_label(method), color=colours[method], fontweight="bold")
        axes.set_title(scale, loc="right", fontsize=9)
        axes.set_ylabel("$|c_k|$", parse_math=True)
        axes.set_ylim(0, 1.08 * max(finite[largest], np.finfo(float).tiny))
        axes.margins(x=0)
        axes.locator_params(axis="y", nbins=4)
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.tick_params(axis="x", length=0)
    panels[-1].set_xlim(-0.5, bands**2 - 0.5)
    panels[-1].set_xticks([(band**2 + (band + 1) ** 2 - 1) / 2 for band in range(bands)], range(bands))
    panels[-1].set_xlabel("coefficients k = l² … (l+1)² − 1, in bands of equal l (numbered)")
    figure.suptitle(f"{scene}, degree {degree}: one typical pixel", x=0.01, ha="left", fontsize=10)
    return figure


def figure_15(results: Results, scene: str, degree: int) -> Any | None:
    """Draw mean PSNR against the real wavelet rate, plain PSNR dashed (figure 15); None without wavelet rows."""
    rows = rows_by_key(row for row in scene_rows(results, scene) if row["degree"] == degree)
    curves: dict[str, list[tuple[float, float]]] = {}
    for (method, _, setting), row in rows.items():
        point = float(row["bits_per_coefficient"]), float(row["psnr_mean"])
        if setting.codec == "wavelet" and np.isfinite(point).all() and point[0] > 0:
            curves.setdefault(method, []).append(point)
    if not curves:
        return None
    figure = new_figure(WIDTH, 810)
    axes = figure.add_axes((LEFT / WIDTH, 0.115, 0.7, 0.825))
    colours = method_colours(all_methods(results))
    ends = []
    for i, method in enumerate(sorted(curves, key=method_rank)):
        bits, psnr = np.array(sorted(curves[method])).T
        axes.plot(bits, psnr, CURVE_MARKERS[i % len(CURVE_MARKERS)] + "-", color=colours[method], zorder=3)
        plain_row = rows.get((method, degree, PLAIN))
        plain = math.nan if plain_row is None else float(plain_row["psnr_mean"])
        label = method_label(method)
        if math.isfinite(plain):
            dashes = (5 * (i % 2), (5, 5))  # shifted, so that of two equal lines both are seen
            axes.axhline(plain, color=colours[method], linestyle=dashes, linewidth=0.9)
            label += f"   plain {plain:.2f}"
        ends.append((float(bits[-1]), float(psnr[-1]), label, colours[method]))
    every_bit = [bits for curve in curves.values() for bits, _ in curve]
    plain_log_axis(axes, min(RATE_RANGE[0], *every_bit) / 1.08, max(RATE_RANGE[1], *every_bit) * 1.08, base=2)
    axes.grid(True)
    axes.set_axisbelow(True)
    axes.set_xlabel("bits per coefficient, every side table included (log scale)")
    axes.set_ylabel("mean PSNR at the fitted lights (dB)")
    axes.set_title(f"{scene}, degree {degree}: wavelet coding (solid), plain coefficients (dashed)")
    _leave_room(axes, ends)
    label_ends(axes, ends)
    return figure


def quality_vs_size(results: Results, scene: str) -> Any | None:
    """Draw mean PSNR against encoded bytes for all rows of a scene; None if no row has both finite."""
    rows = scene_rows(results, scene)
    panels = [
        (title, points)
        for field, title in (("psnr_mean", "fitted lights"), ("psnr_mean_holdout", "held-out lights"))
        if (points := _size_points(rows, field))
    ]
    if not panels:
        return None
    bottom, step = 140, 660  # pixels
    total = bottom + step * len(panels) - 45
    figure = new_figure(WIDTH, total)
    methods = all_methods(results)
    codecs = sorted({point[2].codec for _, points in panels for point in points}, key=lambda c: Setting(c, "").rank)
    markers = _codec_markers(codecs)
    for i, (title, points) in enumerate(reversed(panels)):
        axes = figure.add_axes((LEFT / WIDTH, (bottom + i * step) / total, 0.77, 570 / total))
        _draw_sizes(axes, points, method_colours(methods), markers)
        axes.set_title(f"{scene}: {title}")
        axes.set_ylabel("mean PSNR (dB)")
        if i == 0:
            axes.set_xlabel("encoded size in kB, every side table included (log scale)")
    _codec_legend(figure, codecs, markers)
    return figure


_SizePoint = tuple[str, int, Setting, float, float]  # method, degree, setting, kB, dB


def _size_points(rows: Sequence[np.void], field: str) -> list[_SizePoint]:
    points = [
        (text(r["method"]), int(r["degree"]), setting_of(r), float(r["encoded_bytes"]) / 1000.0, float(r[field]))
        for r in rows
    ]
    return [point for point in points if math.isfinite(point[4]) and point[3] > 0]


def _codec_markers(codecs: Sequence[str]) -> dict[str, str]:
    others = [codec for codec in codecs if codec not in CODEC_MARKERS]
    spare = {codec: OTHER_MARKERS[i % len(OTHER_MARKERS)] for i, codec in enumerate(others)}
    return {codec: CODEC_MARKERS.get(codec, spare.get(codec, "o")) for codec in codecs}


def _draw_sizes(axes: Any, points: Sequence[_SizePoint], colours: dict[str, str], markers: dict[str, str]) -> None:
    """Draw one panel: a point per row, rates of one codec joined, the front of what nothing smaller beats in grey."""
    front: list[tuple[float, float]] = []
    for size, psnr in sorted({(size, -psnr) for *_, size, psnr in points}):
        if not front or -psnr > front[-1][1]:
            front.append((size, -psnr))
    axes.step(*zip(*front, strict=True), where="post", color=FAINT, linewidth=5, alpha=0.6, solid_capstyle="butt")
    degrees = {degree for _, degree, *_ in points}
    series: dict[tuple[str, int, str], list[tuple[float, float]]] = {}
    for method, degree, setting, size, psnr in points:
        series.setdefault((method, degree, setting.codec), []).append((size, psnr))
    ends: dict[tuple[str, int], tuple[float, float, str, str]] = {}
    for (method, degree, codec), line in series.items():
        sizes, psnrs = np.array(sorted(line)).T
        axes.plot(sizes, psnrs, color=colours[method], linewidth=0.9, zorder=2)
        axes.plot(
            sizes,
            psnrs,
            markers[codec],
            markersize=8 if markers[codec] == "." else 6,
            markerfacecolor=colours[method] if markers[codec] == "." else "white",
            markeredgecolor=colours[method],
            zorder=3,
        )
        label = f"{method_label(method)} {degree}" if len(degrees) > 1 else method_label(method)
        end = (float(sizes[-1]), float(psnrs[-1]), label, colours[method])
        ends[method, degree] = max(ends.get((method, degree), end), end)
    low, high = (f(size for *_, size, _ in points) for f in (min, max))
    plain_log_axis(axes, low / 1.25, high * 1.25, base=10)
    axes.grid(True)
    axes.set_axisbelow(True)
    _leave_room(axes, list(ends.values()))
    label_ends(axes, list(ends.values()))


def _leave_room(axes: Any, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Narrow the axes so that the labels of line ends fit beside them."""
    box = axes.get_position()
    right = max(WIDTH - label_width([label for _, _, label, _ in ends]), WIDTH // 2)
    axes.set_position((box.x0, box.y0, right / WIDTH - box.x0, box.height))


def _codec_legend(figure: Any, codecs: Sequence[str], markers: dict[str, str]) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D([], [], linestyle="", marker=markers[c], markeredgecolor=INK, markersize=8 if markers[c] == "." else 6,
               markerfacecolor=INK if markers[c] == "." else "white", label=Setting(c, "").label)
        for c in codecs
    ]  # fmt: skip
    handles.append(Line2D([], [], color=FAINT, linewidth=5, alpha=0.6, label="best at this size or less"))
    figure.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(LEFT / WIDTH - 0.01, 0.0),
        ncols=min(len(handles), 7),
        frameon=False,
    )
