"""The parts of a report, and ``report.md``, which says what was measured and how each part is read.

Figures and equations are those of noise-resistant-fitting.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from clrelight.errors import counted
from clrelight.report import paper
from clrelight.report.charts import figure_7, figure_15
from clrelight.report.contact_sheet import AMPLIFICATION, MAX_SETTINGS, contact_sheet
from clrelight.report.markup import escape_markdown, to_markdown
from clrelight.report.paper_figures import SETTINGS, figure_1, figure_of_method, figures_of
from clrelight.report.rows import (
    file_suffixes,
    method_label,
    parse_picture_key,
    parse_profile_key,
    scene_names,
    scene_rows,
    text,
)
from clrelight.report.size_chart import quality_vs_size
from clrelight.report.tables import Table, all_rows, noise_table, repeated_rows, table_i, table_iii
from clrelight.results import Results


@dataclass(frozen=True)
class Part:
    """A table or figure of the report.

    Attributes
    ----------
    name : str
        File name, less folder and ending.
    heading : str
    how_to_read : str
        One or two sentences that hold for any results.
    make : callable
        Returns the Table, the Figure, or None where the results hold nothing to show.
    missing : str
        Why there would be nothing.
    """

    name: str
    heading: str
    how_to_read: str
    make: Callable[[], Table | Any | None]
    missing: str


def parts_of(results: Results) -> list[tuple[str, list[Part]]]:
    """Return the parts in reading order, by scene; InputError if the key of a picture or profile makes no sense."""
    suffixes = file_suffixes(scene_names(results))
    return [(scene, list(_scene_parts(results, scene, suffix))) for scene, suffix in suffixes.items()]


def _scene_parts(results: Results, scene: str, suffix: str) -> Iterator[Part]:
    degrees = degrees_of(results, scene)
    yield Part(
        f"table_1{suffix}",
        "Table I: what the constraint costs before compression",
        "Mean over the fitted lights of each relit image's PSNR, from the float32 coefficients as they were fitted. "
        "Unconstrained least squares (ULS) fits the samples most closely; what CLS loses against it is the price of "
        "small coefficients.",
        partial(table_i, results, scene),
        "no plain rows of ULS or CLS",
    )
    yield Part(
        f"table_3{suffix}",
        "Table III: what compression costs",
        "The same PSNR from plain and from S3TC-compressed coefficients "
        f"(the paper's S3TC takes {paper.S3TC_BITS} bits per coefficient). "
        "The nearer the two numbers of a row, the better the method resists the coding noise.",
        partial(table_iii, results, scene),
        "no plain rows, or none of codec s3tc",
    )
    for degree in degrees:
        tail = suffix + (f"_degree_{degree}" if len(degrees) > 1 else "")
        title = f", degree {degree}" if len(degrees) > 1 else ""
        yield from _degree_parts(results, scene, degree, tail, title)
    yield Part(
        f"noise{suffix}",
        "Noise: predicted and measured",
        "What coding alone adds to the images, in dB below the squared peak, as a mean over the hemisphere, nothing "
        "clipped. Equation 11 takes the coefficients' errors to be independent; where its number is far below the "
        "predicted one, they are not. A dash is a codec without a model.",
        partial(noise_table, results, scene),
        "no row of a codec holds its noise",
    )
    yield Part(
        f"quality_vs_size{suffix}",
        "Quality against size",
        "Every row is a point, each method a colour, each codec a shape; higher and further left is better. "
        "The grey band joins the rows that no smaller row beats. Rows of infinite PSNR have no point.",
        partial(quality_vs_size, results, scene),
        "no row has a finite PSNR and a size",
    )
    yield Part(
        f"all_rows{suffix}",
        "All rows",
        "Sizes count every side table a decoder needs (1 kB is 1000 bytes); entropy bits are an estimate. "
        "PSNR mean averages the decibels of the images, PSNR pooled takes the decibels of their average error.",
        partial(all_rows, results, scene),
        "no rows",
    )


def _degree_parts(results: Results, scene: str, degree: int, tail: str, title: str) -> Iterator[Part]:
    yield Part(
        f"figure_15{tail}",
        f"Figure 15: PSNR against wavelet bit rate{title}",
        "One line per method; its dashed line is what the plain coefficients reach. The rate is that of the "
        "bytes really written, so a line that is high already at the left packs well.",
        partial(figure_15, results, scene, degree),
        "no rows of codec wavelet with a finite PSNR",
    )
    yield Part(
        f"figure_7{tail}",
        f"Figure 7: coefficient magnitudes of a typical pixel{title}",
        "Each method has its own vertical scale, stated at its right: compare those numbers first. "
        "Coding noise grows with ‖c‖² (equation 11), so large bars mean trouble after compression.",
        partial(figure_7, results, scene, degree),
        "the results hold no coefficient profiles",
    )
    yield from _surface_parts(results, scene, degree, tail, title)
    yield Part(
        f"contact_sheet{tail}",
        f"Contact sheet (figures 4, 8, 12){title}",
        "One light's picture per codec (down) and method (across), each above its error map, where brighter "
        f"is worse (×{AMPLIFICATION}, same scale throughout). The dB are those of the one 8-bit picture shown, "
        f"not the mean over lights of the tables. At most {MAX_SETTINGS} codec settings are shown.",
        partial(contact_sheet, results, scene, degree),
        "the results hold no pictures, or no reference to set them against",
    )


def _surface_parts(results: Results, scene: str, degree: int, tail: str, title: str) -> Iterator[Part]:
    """Yield the paper's figures of a scene that is a surface."""
    figures = figures_of(scene)
    shown = (
        "Left under an environment, right under one directional light" if 5 in figures.values() else "From two sides"
    )
    how = f"{shown}. The dB compare with the rendering of the samples themselves."
    missing = f"no pictures of two of {', '.join(setting.label for setting in SETTINGS)}"
    if 5 in figures.values():
        make = partial(figure_1, results, scene, degree)
        yield Part(f"figure_1{tail}", f"Figure 1: what coding does to coefficients{title}", how, make, missing)
    for method, number in figures.items():
        make = partial(figure_of_method, results, scene, degree, method)
        heading = f"Figure {number}: {method_label(method)}, as fitted and coded{title}"
        yield Part(f"figure_{number}{tail}", heading, how, make, missing)


def degrees_of(results: Results, scene: str) -> list[int]:
    """Return the degrees that a scene was fitted at."""
    found = {int(row["degree"]) for row in scene_rows(results, scene)}
    found |= {p.degree for key in results.pictures if (p := parse_picture_key(key)) and p.scene == scene}
    found |= {degree for name, _, degree in map(parse_profile_key, results.profiles) if name == scene}
    return sorted(found)


def _distinct(values: np.ndarray | list[Any]) -> str:
    """Return the distinct values as comma-separated words, in order of appearance."""
    words = dict.fromkeys(text(v) if isinstance(v, bytes) else str(v) for v in values)
    return ", ".join(word for word in words if word) or "not recorded"


def measured(results: Results) -> Iterator[tuple[str, str]]:
    """Yield names and texts that say what was measured, scene by scene, and on what."""
    for scene in scene_names(results):
        rows = np.array(scene_rows(results, scene), dtype=results.table.dtype)
        sizes = sorted({(int(r["width"]), int(r["height"]), int(r["channel"])) for r in rows})
        size = ", ".join(f"{w}×{h} pixels of {c} channel{'s' * (c != 1)}" for w, h, c in sizes)
        held_out = " and ".join(str(n) for n in sorted({int(n) for n in rows["n_holdout"]}))
        degrees = ", ".join(
            f"{d} ({n} coefficients)" for d, n in sorted({(int(r["degree"]), int(r["n_coeff"])) for r in rows})
        )
        yield (
            scene,
            f"{size}; {_distinct(rows['n_light'])} fitted lights, {held_out} held out; "
            f"degree {degrees}; {len(rows)} rows",
        )
    table = results.table
    yield "Device", _distinct(table["device"])
    yield "Versions", _distinct(table["versions"])
    yield "Commit", f"{_distinct(table['commit'])}; seed: {_distinct(table['seed'].tolist())}"
    if repeated := repeated_rows(results):
        yield (
            f"{counted(repeated, 'row shares', 'rows share')} scene, method, degree, codec and rate with "
            "an earlier row",
            "all are in the full table, tables I and III and figure 15 show the first of each",
        )


def _measured_lines(results: Results) -> Iterator[str]:
    scenes = len(scene_names(results))
    for i, (name, words) in enumerate(measured(results)):
        mark = "**" if i < scenes else ""
        yield f"- {mark}{escape_markdown(name)}{mark}: {escape_markdown(words)}"


def document(results: Results, made: list[tuple[str, list[tuple[Part, Table | str | None]]]]) -> str:
    """Return ``report.md``.

    Parameters
    ----------
    results : Results
        The experiment.
    made : list of (scene, list of (Part, content))
        The content of a part is its Table, the path of its picture, or None where it was left out.
    """
    lines = ["# Relighting experiment", "", "## What was measured", "", *_measured_lines(results)]
    for scene, parts in made:
        lines += ["", f"## Scene {escape_markdown(scene)}"]
        left_out = []
        for part, content in parts:
            if content is None:
                left_out.append(f"- {part.heading}: left out, {part.missing}.")
                continue
            lines += ["", f"### {part.heading}", "", part.how_to_read]
            if isinstance(content, Table):
                files = f"As files: [CSV](tables/{part.name}.csv), [LaTeX](tables/{part.name}.tex)."
                lines += ["", note] if (note := paper_note(content)) else []
                lines += [
                    "",
                    escape_markdown(content.caption) + ".",
                    "",
                    to_markdown(content.measured()).rstrip(),
                    "",
                    files,
                ]
            else:
                lines += ["", f"![{escape_markdown(f'{part.heading}, {scene}')}]({content})"]
        if left_out:
            lines += ["", "### Left out", "", *left_out]
    return "\n".join(lines) + "\n"


def paper_note(table: Table) -> str:
    """Return what must be said of a table that has the paper's numbers; empty of others."""
    if not any(column.key.endswith("_paper") for column in table.columns):
        return ""
    return f'The paper\'s numbers are those of its own "ring" ({paper.CITATION}); our scene only resembles it.'
