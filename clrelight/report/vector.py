"""Charts as SVG within a page: text stays text, colours follow the reader's light or dark system."""

from __future__ import annotations

import io
import re
from typing import Any

from clrelight.report.canvas import FAINT, INK

_COLOURS = {
    INK: "var(--ink)",
    FAINT: "var(--faint)",
    "#e4e4e4": "var(--grid)",
    "#f1f1f1": "var(--band)",
    "#000000": "var(--black)",
    "#0072b2": "var(--blue)",
    "#882255": "var(--wine)",
}
"""Greys and dark colours of the charts, and what the page's style sheet makes of each."""


_UNSAID = ("Date", "Creator", "Format", "Type")
"""What matplotlib writes of its own accord."""


def is_chart(figure: Any) -> bool:
    """Return whether a figure is drawn of lines and text alone, and so is best as SVG."""
    return not any(axes.images for axes in figure.axes)


def to_svg(figure: Any, prefix: str, label: str) -> str:
    """Return a matplotlib figure as an SVG element whose bytes depend on the picture alone.

    Parameters
    ----------
    figure : Figure
    prefix : str
        What its identities begin with, for a page holds several.
    label : str
        What a screen reader says of it, escaped for an attribute.
    """
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "clrelight"}):
        figure.savefig(stream, format="svg", transparent=True, metadata=dict.fromkeys(_UNSAID))
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"\s*<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    # Within tags alone: in what is written a name may look like a reference.
    text = re.sub(r"<[^>]*>", lambda tag: _within_page(tag[0], prefix), text)
    opening = f'<svg role="img" aria-label="{label}" fill="var(--black)" '  # matplotlib names no colour of black text
    return re.sub(r"^<svg ", opening, re.sub(r'\s(width|height)="[\d.]+pt"', "", text, count=2)).strip()


def _within_page(tag: str, prefix: str) -> str:
    """Return a tag whose identities are its figure's own, and whose dark colours are the page's."""
    tag = re.sub(r'(?<= id=")(?=[^"])', f"{prefix}-", tag)
    tag = re.sub(r'(?<==")#(?=[A-Za-z])', f"#{prefix}-", tag)
    tag = tag.replace("url(#", f"url(#{prefix}-")
    for colour, named in _COLOURS.items():
        tag = re.sub(rf"(?<=[:\s]){colour}(?=[;\"])", named, tag)
    return tag
