"""What all pictures of a report share: matplotlib (imported late), colours, labels that do not overlap, saving."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from clrelight.errors import InputError

DPI = 150
WIDTH, LEFT = 1350, 100  # pixels: a chart, and the margin left of its axes
INK = "#333333"
FAINT = "#b8b8b8"

# Okabe and Ito's palette, told apart by colour-blind readers, less its yellow, which paper swallows.
_METHOD_COLOURS = {"uls": "#D55E00", "sloan": "#E69F00", "cls": "#0072B2", "ceb": "#009E73"}
_OTHER_COLOURS = ("#CC79A7", "#56B4E9", "#000000", "#7F7F7F", "#882255", "#999933")

_STYLE = {
    "font.size": 9.0,
    "text.parse_math": False,  # a scene's name may hold a dollar sign
    "axes.titlesize": 10.0,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
}


def require_matplotlib() -> None:
    """Raise InputError if pictures cannot be drawn."""
    try:
        import matplotlib.backends.backend_agg  # noqa: F401
    except ImportError:
        raise InputError("pictures need matplotlib: pip install 'clrelight[report]'") from None


@contextmanager
def house_style() -> Iterator[None]:
    """Draw alike for every user: matplotlib's own defaults and ours, whatever matplotlibrc says."""
    import matplotlib.style

    with matplotlib.style.context(["default", _STYLE]):
        yield


def new_figure(width_px: float, height_px: float, **options: Any) -> Any:
    """Return a figure of that size for the Agg renderer, which leaves the user's own backend alone."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_px / DPI, height_px / DPI), dpi=DPI, **options)
    FigureCanvasAgg(figure)
    return figure


class Page:
    """A figure on which things are placed in pixels, from its upper left corner."""

    def __init__(self, width: int, height: int) -> None:
        self.width, self.height = width, height
        self.figure = new_figure(width, height)

    def write(self, x: float, y: float, text: str, **style: Any) -> None:
        """Write a line of text whose baseline is at y."""
        self.figure.text(x / self.width, 1 - y / self.height, text, va="baseline", **style)

    def add_axes(self, x: float, y: float, width: float, height: float) -> Any:
        """Return axes that fill a box."""
        w, h = self.width, self.height
        return self.figure.add_axes((x / w, 1 - (y + height) / h, width / w, height / h))


def save(figure: Any, path: Path) -> None:
    """Write a PNG whose bytes depend on the picture alone: no date, no program."""
    figure.savefig(path, format="png", dpi=DPI, metadata={"Software": None})


def method_colours(methods: Sequence[str]) -> dict[str, str]:
    """Return a colour per method, the same in every picture that shows the same methods."""
    others = [method for method in methods if method not in _METHOD_COLOURS]
    spare = {method: _OTHER_COLOURS[i % len(_OTHER_COLOURS)] for i, method in enumerate(others)}
    return {method: _METHOD_COLOURS.get(method, spare.get(method, INK)) for method in methods}


def spread(positions: Sequence[float], gap: float) -> NDArray[np.float64]:
    """Move positions as little as possible (least squares), in order, until they are `gap` apart within 0 to 1.

    Where there is no room for that gap, they are equally spaced.
    """
    values = np.asarray(positions, dtype=np.float64)
    if values.size == 0:
        return values
    order = np.argsort(values, kind="stable")
    steps = min(gap, 1.0 / max(len(values) - 1, 1)) * np.arange(len(values))
    moved = np.empty_like(values)
    moved[order] = np.clip(isotonic_regression(values[order] - steps).x, 0.0, max(1.0 - steps[-1], 0.0)) + steps
    return moved


def label_ends(axes: Any, ends: Sequence[tuple[float, float, str, str]], gap: float = 0.06) -> None:
    """Write (x, y, text, colour) labels right of the axes, at their heights where there is room.

    The axes, of a chart `WIDTH` wide, become as narrow as the longest label asks.
    """
    box = axes.get_position()
    longest = max((len(text) for _, _, text, _ in ends), default=0)
    right = max(WIDTH - 65 - 13 * longest, WIDTH // 2)
    axes.set_position((box.x0, box.y0, right / WIDTH - box.x0, box.height))
    low, high = axes.get_ylim()
    wanted = [(y - low) / (high - low) for _, y, _, _ in ends]
    places = spread(wanted, gap)
    for (x, y, text, colour), place in zip(ends, places, strict=True):
        axes.annotate(
            text,
            xy=(x, y),
            xytext=(1.035, place),
            textcoords="axes fraction",
            ha="left",
            color=colour,
            fontweight="bold",
            va="center",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": colour,
                "linewidth": 0.6,
                "shrinkA": 2,
                "shrinkB": 3,
                "relpos": (0.0, 0.5),
            },
        )


def plain_log_axis(axes: Any, low: float, high: float, base: int) -> None:
    """Make x logarithmic with plain numbers: the powers of base 2, or 1, 2 and 5 in each decade of base 10."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

    axes.set_xscale("log", base=base)
    axes.set_xlim(low, high)
    exponents = np.arange(np.floor(np.log(low) / np.log(base)), np.ceil(np.log(high) / np.log(base)) + 1)
    steps = (1.0, 2.0, 5.0) if base == 10 and high / low < 3000 else (1.0,)
    ticks = [step * base**exponent for exponent in exponents for step in steps]
    axes.xaxis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.10g}"))
    axes.xaxis.set_minor_locator(NullLocator())
