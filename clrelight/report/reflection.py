"""The chart of accuracy over orders (frequency-space-environment-maps, figure 6)."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence

from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.report.canvas import DPI, INK, WIDTH, house_style, label_ends, new_figure, require_matplotlib

_CURVES = (
    ("reflected", INK, "-"),
    ("light alone", "#E69F00", "--"),
    ("reflectance alone", "#0072B2", "-"),
    ("bound", "#D55E00", "-"),
)


def write_accuracy(path: str | os.PathLike[str], rows: Sequence[Sequence[float]], epsilon: float) -> None:
    """Draw rows of F and four accuracies, of the truth, light, reflectance and bound, as a PNG."""
    if not os.fsdecode(path).lower().endswith(".png"):
        raise InputError(f"charts are .png files, got {os.fsdecode(path)}")
    require_matplotlib()
    with house_style():
        figure = new_figure(WIDTH, 700)
        axes = figure.add_axes((0.08, 0.12, 0.72, 0.78))
        degrees = [row[0] for row in rows]
        axes.axhline(1.0 - epsilon, color="#b8b8b8", linewidth=0.8, linestyle=":")
        ends = []
        for column, (label, colour, line) in enumerate(_CURVES, start=1):
            values = [row[column] for row in rows]
            axes.plot(degrees, values, color=colour, linestyle=line)
            ends.append((degrees[-1], values[-1], label, colour))
        axes.set_ylim(0.0, 1.02)
        axes.set_xlim(0, degrees[-1])
        axes.set_xlabel("orders up to F")
        axes.set_title("part of the energy, 1 − ε")
        axes.grid(True, axis="y")
        label_ends(axes, ends)
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=DPI, metadata={"Software": None})
    with replacing(path) as part:
        part.write(content.getvalue())
