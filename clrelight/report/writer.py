"""Writing a report: all of it in a folder aside, then file by file into place."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from clrelight.errors import InputError
from clrelight.report import canvas
from clrelight.report.document import Part, document, parts_of
from clrelight.report.markup import to_csv, to_latex, to_markdown
from clrelight.report.tables import Table
from clrelight.results import Results


def write_report(
    results: Results, out_dir: str | os.PathLike[str], *, progress: Callable[[int, int], None] | None = None
) -> list[Path]:
    """Write tables, pictures and ``report.md`` of an experiment into a folder.

    Files of an earlier report are replaced, all others are left alone. Nothing is replaced before everything is made,
    and ``report.md`` comes last. The same results give the same bytes.

    Parameters
    ----------
    results : Results
        The experiment: its table must have a row; pictures and profiles may be missing.
    out_dir : path
        Made if it does not exist.
    progress : callable, optional
        Called with (parts done, parts in all) before the first part and after each.

    Returns
    -------
    list of Path
        The files written, ``report.md`` first.

    Raises
    ------
    InputError
        If the table is empty, a picture or its key makes no sense, matplotlib is not installed, or `out_dir` cannot be
        written to.
    """
    if len(results.table) == 0:
        raise InputError("the results table is empty: there is nothing to report; run an experiment that has rows")
    canvas.require_matplotlib()
    out = Path(out_dir).resolve()
    if out.exists() and not out.is_dir():
        raise InputError(f"{out_dir} is a file; give a folder to write the report into")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))
        try:
            with canvas.house_style():
                written = _make(results, aside, progress or (lambda done, total: None))
            return _move(written, aside, out)
        finally:
            shutil.rmtree(aside, ignore_errors=True)
    except OSError as error:
        raise InputError(f"cannot write the report to {out_dir}: {error}") from error


def _make(results: Results, folder: Path, progress: Callable[[int, int], None]) -> list[str]:
    """Make every file within `folder`; return their relative paths in the order in which they may be moved."""
    (folder / "tables").mkdir()
    (folder / "figures").mkdir()
    scenes = parts_of(results)
    total = sum(len(parts) for _, parts in scenes)
    done = 0
    written: list[str] = []
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
                written.append(picture)
                content = picture
            contents.append((part, content))
            done += 1
            progress(done, total)
        made.append((scene, contents))
    _write_text(folder / "report.md", document(results, made))
    return [*written, "report.md"]


def _write_table(table: Table, name: str, folder: Path) -> list[str]:
    """Write a table three times; the CSV alone keeps the columns in which nothing was measured."""
    paths = [f"tables/{name}.{ending}" for ending in ("md", "csv", "tex")]
    shown = table.measured()
    for path, content in zip(paths, (to_markdown(shown), to_csv(table), to_latex(shown)), strict=True):
        _write_text(folder / path, content)
    return paths


def _write_text(path: Path, content: str) -> None:
    path.write_text(content, encoding="utf-8", newline="\n")


def _move(written: list[str], source: Path, out: Path) -> list[Path]:
    """Move the files into place; InputError before the first if something stands in the way of any."""
    for path in written:
        if (out / path).is_dir():
            raise InputError(f"{out / path} is a folder, but the report has a file of that name; move it away")
        if (out / path).parent.exists() and not (out / path).parent.is_dir():
            raise InputError(f"{(out / path).parent} is a file, but the report has a folder of that name; move it away")
    for path in written:
        (out / path).parent.mkdir(parents=True, exist_ok=True)
        os.replace(source / path, out / path)
    return [out / path for path in (*written[-1:], *written[:-1])]
