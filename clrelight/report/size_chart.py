"""PSNR against encoded bytes: what each choice of method, degree and codec is worth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from clrelight.report.canvas import FAINT, INK, LEFT, WIDTH, label_ends, method_colours, new_figure, plain_log_axis
from clrelight.report.rows import Setting, all_methods, method_label, scene_rows, setting_of, text
from clrelight.results import Results

CODEC_MARKERS = {"none": "o", "half": "s", "s3tc": "^", "uniform": "D", "wavelet": "."}
OTHER_MARKERS = ("v", "P", "X", "*", "<", ">")


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
    series: dict[tuple[str, int, str], list[tuple[float, float]]] = {}
    for method, degree, setting, size, psnr in points:
        series.setdefault((method, degree, setting.codec), []).append((size, psnr))
    ends: dict[str, tuple[float, float, str, str]] = {}
    for (method, _, codec), line in series.items():
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
        end = (float(sizes[-1]), float(psnrs[-1]), method_label(method), colours[method])
        ends[method] = max(ends.get(method, end), end)
    low, high = (f(size for *_, size, _ in points) for f in (min, max))
    plain_log_axis(axes, low / 1.25, high * 1.25, base=10)
    axes.grid(True)
    axes.set_axisbelow(True)
    _mark_degrees(axes, points)
    label_ends(axes, list(ends.values()))


def _mark_degrees(axes: Any, points: Sequence[_SizePoint]) -> None:
    """Where there are several degrees, name each at its largest size, low down where few points are."""
    degrees = sorted({degree for _, degree, *_ in points})
    for degree in degrees if len(degrees) > 1 else []:
        largest = max(size for _, d, _, size, _ in points if d == degree)
        axes.text(largest, 0.02, f"degree {degree}", transform=axes.get_xaxis_transform(), rotation=90, ha="center")


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
