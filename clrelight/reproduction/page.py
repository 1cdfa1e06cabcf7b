"""The page of what was reproduced: a table of rows a paper, and its pictures."""

from __future__ import annotations

import io
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.durable import replacing
from clrelight.images import write_image
from clrelight.report.canvas import DPI, save
from clrelight.reproduction.rows import Paper
from clrelight.reproduction.run import Outcome, Reproduction
from clrelight.speed.tables import markdown_table

HEADERS = ("item", "what", "printed", "where", "ours", "tolerance", "verdict", "why")
_INTRO = """\
# What the papers print, recomputed

`clrelight reproduce` computes what five papers print and tells it beside ours. This page is what

```
clrelight reproduce --data FOLDER --markdown docs/reproduction.md --pictures docs/images
```

writes. FOLDER holds `probes`, `meshes` and `brdf`; without it the rows that need none are computed.

| verdict | what it means |
|---|---|
| agrees | ours is within the tolerance of what is printed |
| differs | it is not, for the reason that is given, and it is where that says: the second tolerance |
| FAILS | neither; the command ends with exit code 1 |
| needs data | a file of FOLDER is missing |
| out | nothing is computed, and why |"""


def page(made: Reproduction, papers: Sequence[Paper], pictures: str) -> str:
    """Return the page in Markdown; pictures are linked from the folder `pictures`, none where it is empty."""
    counts = ", ".join(f"{count} {name}" for name, count in made.counts().items())
    parts = [_INTRO, f"{len(made.outcomes)} rows: {counts}. They took {sum(made.seconds.values()) / 60.0:.1f} minutes."]
    for paper in papers:
        rows = [each for each in made.outcomes if each.paper == paper.id]
        parts.append(f"## {paper.citation}\n\n`clrelight reproduce {paper.id}`")
        parts.append(markdown_table(HEADERS, [_cells(each) for each in rows]))
        if pictures:
            shown = [(name, item) for name, (owner, item) in made.shows.items() if owner == paper.id]
            parts += [f"![{item}]({pictures}/{name})\n\n{item[0].upper()}{item[1:]}." for name, item in shown]
    return "\n\n".join(parts) + "\n"


def _cells(outcome: Outcome) -> list[str]:
    cells = (
        *(outcome.item, outcome.what, outcome.printed, outcome.where, outcome.ours, outcome.tolerance, outcome.verdict),
        outcome.reason,
    )
    return [cell.replace("|", "\\|") for cell in cells]


def write_page(path: str | os.PathLike[str], made: Reproduction, papers: Sequence[Paper], folder: Path | None) -> None:
    """Write the page whole; pictures are linked relative to it."""
    link = "" if folder is None else os.path.relpath(folder, Path(path).parent).replace(os.sep, "/")
    with replacing(path) as part:
        part.write(page(made, papers, link).encode("utf-8"))


def write_pictures(folder: Path, made: Reproduction) -> list[str]:
    """Write every picture into a folder, and return their names."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, picture in made.pictures.items():
        if isinstance(picture, np.ndarray):
            write_image(folder / name, picture)
        elif isinstance(picture, bytes):
            with replacing(folder / name) as part:
                part.write(picture)
        else:
            _save(picture, folder / name)
    return list(made.pictures)


def _save(figure: Any, path: Path) -> None:
    """Write a chart as PNG, photographs below each other as JPEG."""
    if path.suffix != ".jpg":
        save(figure, path)
        return
    content = io.BytesIO()
    figure.savefig(content, format="jpg", dpi=DPI, pil_kwargs={"quality": 85})
    with replacing(path) as part:
        part.write(content.getvalue())
