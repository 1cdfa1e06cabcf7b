"""``report.html``: the tables, charts and pictures of an experiment in one file that needs nothing else."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from clrelight.report.comparing import MOST_BYTES, compare_html
from clrelight.report.document import Part, degrees_of, measured, paper_note
from clrelight.report.html import Section, data_link, image_html, list_html, page, table_html
from clrelight.report.records import rows_csv
from clrelight.report.tables import Table
from clrelight.results import Results

Made = Sequence[tuple[str, Sequence[tuple[Part, Table | str | None]]]]
"""By scene: the parts, each with its Table, the path of its picture, or None where it was left out."""

_SHEET = "contact_sheet"
"""The part whose pictures are compared on this page instead."""


def experiment_page(results: Results, made: Made, charts: Mapping[str, str], folder: Path) -> str:
    """Return the page.

    Parameters
    ----------
    results : Results
        The experiment.
    made : sequence of (scene, sequence of (Part, content))
        As of `document`.
    charts : mapping of str to str
        The SVG of a picture that is a chart, by its path.
    folder : Path
        Where the other pictures are.
    """
    sections: list[Section] = []
    room = MOST_BYTES
    for scene, parts in made:
        sections.append(Section(f"Scene {scene}", 2))
        compared, room = _compared(results, scene, room)
        sections += [*compared, *_parts(scene, parts, charts, folder)]
    whole = f'<p class="downloads">{data_link("rows.csv", "text/csv", rows_csv(results).encode())}</p>'
    sections.append(Section("All columns of all rows", 2, ("As comma-separated values, every digit kept.",), whole))
    return page("Relighting experiment", list(measured(results)), sections)


def _compared(results: Results, scene: str, room: int) -> tuple[list[Section], int]:
    found = []
    degrees = degrees_of(results, scene)
    for degree in degrees:
        body, notes, taken = compare_html(results, scene, degree, room)
        room -= taken
        if body:
            title = f", degree {degree}" if len(degrees) > 1 else ""
            found.append(Section(f"Pictures side by side{title}", 3, notes, body))
    return found, room


def _parts(
    scene: str, parts: Sequence[tuple[Part, Table | str | None]], charts: Mapping[str, str], folder: Path
) -> Iterator[Section]:
    left_out = []
    for part, content in parts:
        if content is None:
            left_out.append(f"{part.heading}: left out, {part.missing}.")
        elif isinstance(content, Table):
            notes = tuple(note for note in (part.how_to_read, paper_note(content)) if note)
            yield Section(part.heading, 3, notes, table_html(content, file=f"{part.name}.csv"))
        elif content in charts:
            yield Section(part.heading, 3, (part.how_to_read,), f"<figure>{charts[content]}</figure>")
        elif not part.name.startswith(_SHEET):
            body = image_html((folder / content).read_bytes(), f"{part.heading}, {scene}")
            yield Section(part.heading, 3, (part.how_to_read,), body)
    if left_out:
        yield Section("Left out", 3, (), list_html(left_out))
