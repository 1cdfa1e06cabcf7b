"""Seconds and bytes of the whole job against pixels, lights, degree and threads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from clrelight.report.canvas import FAINT, INK, WIDTH, new_figure, plain_log_axis
from clrelight.speed.job import NUMPY, OURS, STAGES, TOTAL

AXES = {"size": "pixels", "lights": "lights", "degree": "degree", "threads": "threads"}
"""Axes of a growth, and what the charts call them."""

_OUR_COLOUR, _NUMPY_COLOUR = "#0072B2", "#D55E00"
_STAGE_COLOURS = dict(zip(STAGES, ("#009E73", "#CC79A7", "#E69F00", "#56B4E9"), strict=True))
_FILE_STYLES = {"stack": ":", "fit": "-.", "encoded": (0, (1, 3))}
_HEIGHT = 760  # pixels
_LEGEND = 80

Points = Sequence[Mapping[str, Any]]


def seconds_chart(record: Mapping[str, Any]) -> Any | None:
    """Draw the seconds of the job, ours with its stages and NumPy's, against each axis; None without points."""

    def draw(axes: Any, points: Points, x: list[float]) -> None:
        for stage in STAGES:
            values = [point["seconds"][OURS][stage][1] for point in points]
            axes.plot(x, values, "-", color=_STAGE_COLOURS[stage], linewidth=1.0, label=f"our {stage}")
        for way, name, colour in ((OURS, "ours", _OUR_COLOUR), (NUMPY, "NumPy", _NUMPY_COLOUR)):
            there = [(at, *point["seconds"][way][TOTAL]) for at, point in zip(x, points, strict=True)
                     if way in point["seconds"]]  # fmt: skip
            if there:
                at, low, middle, high = zip(*there, strict=True)
                axes.fill_between(at, low, high, color=colour, alpha=0.15, linewidth=0)
                axes.plot(at, middle, "o-", color=colour, label=f"{name}, whole job")

    return _panels(record, draw, "seconds", "Seconds from stack file to PSNR")


def memory_chart(record: Mapping[str, Any]) -> Any | None:
    """Draw the most resident bytes, ours and NumPy's, and those of the files; None without points."""

    def draw(axes: Any, points: Points, x: list[float]) -> None:
        for name, style in _FILE_STYLES.items():
            sizes = [point["bytes"][name] / 1e6 for point in points]
            axes.plot(x, sizes, linestyle=style, color=FAINT, label=f"{name} file")
        for way, name, colour in ((OURS, "ours", _OUR_COLOUR), (NUMPY, "NumPy", _NUMPY_COLOUR)):
            there = [(at, point["memory"][way] / 1e6) for at, point in zip(x, points, strict=True)
                     if way in point["memory"]]  # fmt: skip
            if there:
                axes.plot(*zip(*there, strict=True), "o-", color=colour, label=f"{name}, most resident")

    return _panels(record, draw, "MB", "Memory and files")


def _panels(record: Mapping[str, Any], draw: Any, unit: str, title: str) -> Any | None:
    from matplotlib.ticker import NullFormatter

    base = record["base"]
    series = {axis: found for axis in AXES if (found := _series(record, axis))}
    if not series:
        return None
    columns = min(len(series), 2)
    rows = -(-len(series) // columns)
    height = (_HEIGHT // 2) * rows + _LEGEND
    figure = new_figure(WIDTH, height, layout="constrained")
    figure.get_layout_engine().set(rect=(0, _LEGEND / height, 1, 1 - _LEGEND / height))
    panels = figure.subplots(rows, columns, squeeze=False).reshape(-1)
    for axes in panels[len(series) :]:
        axes.set_visible(False)
    for axes, (axis, points) in zip(panels, series.items(), strict=False):
        x = [float(point[axis]) ** (2 if axis == "size" else 1) for point in points]
        draw(axes, points, x)
        if axis != "degree":
            plain_log_axis(axes, x[0] / 1.2, x[-1] * 1.2, base=2)
        axes.set_xticks(x, [_value(point, axis) for point in points])
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.grid(True)
        axes.set_axisbelow(True)
        axes.set_xlabel(AXES[axis])
        axes.set_ylabel(f"{unit} (log scale)")
        named = {"size": f"{base['size']}² pixels", "lights": f"{base['lights']} lights"}
        named["degree"] = f"degree {base['degree']}"
        axes.set_title(", ".join(text for name, text in named.items() if name != axis), fontsize=9)
    figure.suptitle(title, x=0.01, ha="left", color=INK)
    handles = {
        label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="lower left", ncols=6, frameon=False)
    return figure


def _series(record: Mapping[str, Any], axis: str) -> Points:
    """Return the points that were measured along an axis, all else being that of the base."""
    base, values = record["base"], record["axes"][axis]
    return [
        point
        for point in sorted(record["points"], key=lambda point: point[axis] or 0)
        if point[axis] in values and "note" not in point and all(point[o] == base[o] for o in AXES if o != axis)
    ]


def _value(point: Mapping[str, Any], axis: str) -> str:
    return f"{point['size']}²" if axis == "size" else str(point[axis])
