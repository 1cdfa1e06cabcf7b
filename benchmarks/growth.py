"""Put a record of ``bench --speed`` into the documentation: ``python -m benchmarks.growth results/speed.json``."""

from __future__ import annotations

import sys
from pathlib import Path

from benchmarks.pages import replace_block
from clrelight.errors import InputError
from clrelight.report import canvas
from clrelight.speed.charts import memory_chart, seconds_chart
from clrelight.speed.record import read_record
from clrelight.speed.report import page

DOCS = Path(__file__).resolve().parents[1] / "docs"
BEGIN, END = "<!-- growth -->", "<!-- /growth -->"


def main() -> None:
    """Draw the pictures and replace what stands between the markers of ``docs/performance.md``."""
    if len(sys.argv) != 2:
        raise InputError("usage: python -m benchmarks.growth results/speed.json")
    record = read_record(sys.argv[1])
    pictures: dict[str, str] = {}
    canvas.require_matplotlib()
    with canvas.house_style():
        for name, chart in (("seconds", seconds_chart), ("memory", memory_chart)):
            figure = chart(record)
            if figure is not None:
                pictures[name] = f"images/speed_{name}.png"
                canvas.save(figure, DOCS / pictures[name])
    replace_block(DOCS / "performance.md", page(record, pictures), BEGIN, END)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"benchmarks.growth: {error}")
