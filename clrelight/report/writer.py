"""Writing a report: its tables, its pictures, and the pages that tie them together."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from clrelight.errors import InputError
from clrelight.report import canvas
from clrelight.report.document import Part, document, parts_of
from clrelight.report.experiment_page import experiment_page
from clrelight.report.folder import fill_folder, write_text
from clrelight.report.html import plain
from clrelight.report.markup import to_csv, to_latex, to_markdown
from clrelight.report.records import check_parquet, rows_csv, write_parquet
from clrelight.report.tables import Table
from clrelight.report.vector import is_chart, to_svg
from clrelight.results import Results


def write_report(
    results: Results,
    out_dir: str | os.PathLike[str],
    *,
    parquet: bool = False,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write tables, pictures, all rows, ``report.html`` and ``report.md`` of an experiment into a folder.

    Files of an earlier report are replaced, all others are left alone. Nothing is replaced before everything is made,
    and ``report.md`` comes last. The same results give the same bytes. ``report.html`` holds all that it shows.

    Parameters
    ----------
    results : Results
        The experiment: its table must have a row; pictures and profiles may be missing.
    out_dir : path
        Made if it does not exist.
    parquet : bool
        Whether to write the rows as ``rows.parquet``, beside ``rows.csv``.
    progress : callable, optional
        Called with (parts done, parts in all) before the first part and after each.

    Returns
    -------
    list of Path
        The files written, ``report.md`` first.

    Raises
    ------
    InputError
        If the table is empty, a picture or its key makes no sense, matplotlib (or, for `parquet`, pyarrow) is not
        installed, or `out_dir` cannot be written to.
    """
    if len(results.table) == 0:
        raise InputError("the results table is empty: there is nothing to report; run an experiment that has rows")
    canvas.require_matplotlib()
    if parquet:
        check_parquet()

    def make(aside: Path) -> list[str]:
        with canvas.house_style():
            written = _make(results, aside, progress or (lambda done, total: None))
        if parquet:
            write_parquet(results, aside / "rows.parquet")
        return [*(["rows.parquet"] if parquet else []), *written]

    return fill_folder(out_dir, make)


def _make(results: Results, folder: Path, progress: Callable[[int, int], None]) -> list[str]:
    """Make every file within `folder`; return their relative paths in the order in which they may be moved."""
    (folder / "tables").mkdir()
    (folder / "figures").mkdir()
    scenes = parts_of(results)
    total = sum(len(parts) for _, parts in scenes)
    done = 0
    written: list[str] = []
    charts: dict[str, str] = {}  # by the path of the picture
    made: list[tuple[str, list[tuple[Part, Table | str | None]]]] = []
    progress(done, total)
    for scene, parts in scenes:
        contents: list[tuple[Part, Table | str | None]] = []
        for part in parts:
            content = part.make()
            if isinstance(content, Table):
                written += _write_table(content, part.name, folder)
            elif content is not None:
                picture = f"figures/{part.name}.png"
                canvas.save(content, folder / picture)
                if is_chart(content):
                    charts[picture] = to_svg(content, part.name, plain(f"{part.heading}, {scene}. {part.how_to_read}"))
                written.append(picture)
                content = picture
            contents.append((part, content))
            done += 1
            progress(done, total)
        made.append((scene, contents))
    write_text(folder / "rows.csv", rows_csv(results))
    write_text(folder / "report.html", experiment_page(results, made, charts, folder))
    write_text(folder / "report.md", document(results, made))
    return [*written, "rows.csv", "report.html", "report.md"]


def _write_table(table: Table, name: str, folder: Path) -> list[str]:
    """Write a table three times; the CSV alone keeps the columns in which nothing was measured."""
    paths = [f"tables/{name}.{ending}" for ending in ("md", "csv", "tex")]
    shown = table.measured()
    for path, content in zip(paths, (to_markdown(shown), to_csv(table), to_latex(shown)), strict=True):
        write_text(folder / path, content)
    return paths
