"""The report of a growth: the page, its pictures, and its figures for other programs."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clrelight.report import canvas
from clrelight.report.folder import fill_folder, write_text
from clrelight.speed.charts import memory_chart, seconds_chart
from clrelight.speed.growth_tables import points_csv, points_markdown, stages_csv, stages_markdown

PICTURES = {"seconds": "Seconds", "memory": "Memory and files"}

EXPLANATION = """\
The job: a stack file of grey float16 pictures (rings on a plane, tiled) is fitted (CLS, Newton), encoded (half),
decoded and measured (PSNR), from file to file. *NumPy* is the same mathematics, all in memory: float32 products by its
BLAS, Newton's iteration vectorised, plain files without checksums. Both run in turns in one process; times are medians,
with lower and upper quartile in brackets, and *speed* is NumPy's time over ours, round by round. *MB* are the most that
a process of its own had resident, interpreter and driver included, until its first run had ended."""


def write_speed_report(record: Mapping[str, Any], out_dir: str | os.PathLike[str]) -> list[Path]:
    """Write ``speed.md``, pictures and tables of a record into a folder; return the files, ``speed.md`` first.

    Raises
    ------
    InputError
        If matplotlib is not installed, or `out_dir` cannot be written to.
    """
    canvas.require_matplotlib()

    def make(aside: Path) -> list[str]:
        written = []
        with canvas.house_style():
            for name, chart in (("seconds", seconds_chart), ("memory", memory_chart)):
                figure = chart(record)
                if figure is not None:
                    canvas.save(figure, aside / f"{name}.png")
                    written.append(f"{name}.png")
        pictures = {name: f"{name}.png" for name in PICTURES if f"{name}.png" in written}
        texts = {"points.csv": points_csv(record), "stages.csv": stages_csv(record)}
        texts["speed.md"] = "# Speed\n\n" + page(record, pictures) + "\n"
        for name, text in texts.items():
            write_text(aside / name, text)
        return [*written, *texts]

    return fill_folder(out_dir, make)


def page(record: Mapping[str, Any], pictures: Mapping[str, str]) -> str:
    """Return the text of the report; `pictures` says where those of `PICTURES` are that there are."""
    parts = [EXPLANATION, "\n".join(f"- {name}: {value}" for name, value in record["environment"].items())]
    parts += [f"![{PICTURES[name]}]({path})" for name, path in pictures.items()]
    parts += [points_markdown(record), "Single stages beside other libraries:", stages_markdown(record)]
    return "\n\n".join(parts)
