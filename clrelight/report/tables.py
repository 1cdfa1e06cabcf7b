"""The tables of a report as data: noise-resistant-fitting, table I and III, with ours, and all rows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from clrelight.report import paper
from clrelight.report.rows import (
    Setting,
    differing_options,
    method_label,
    rows_by_key,
    scene_names,
    scene_rows,
    setting_of,
    text,
)
from clrelight.results import NO_CODEC, Results

Cell = str | int | float
PLAIN = Setting(NO_CODEC, "")
S3TC = Setting("s3tc", "")


@dataclass(frozen=True)
class Column:
    """A column: its name for machines, its title for people, and the decimals shown (CSV holds them all)."""

    key: str
    title: str
    digits: int = 0
    tex: str = ""  # title in LaTeX where it needs mathematics


@dataclass(frozen=True)
class Table:
    """A table as data; a NaN cell is one that was not measured."""

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def values(self, key: str) -> list[Cell]:
        """Return one column's cells; KeyError if there is no such column."""
        keys = [column.key for column in self.columns]
        if key not in keys:
            raise KeyError(f"no column {key!r}; the columns are {', '.join(keys)}")
        return [row[keys.index(key)] for row in self.rows]

    def without(self, *keys: str) -> Table:
        """Return the table less some columns."""
        kept = [i for i, column in enumerate(self.columns) if column.key not in keys]
        return Table(
            self.caption, tuple(self.columns[i] for i in kept), tuple(tuple(row[i] for i in kept) for row in self.rows)
        )

    def measured(self) -> Table:
        """Return the table less the columns in which nothing was measured."""
        return self.without(*(c.key for c in self.columns if all(_is_nan(v) for v in self.values(c.key))))


def _is_nan(value: Cell) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _psnr(rows: dict, method: str, degree: int, setting: Setting) -> float:
    row = rows.get((method, degree, setting))
    return math.nan if row is None else float(row["psnr_mean"])


def _paper_table(caption: str, columns: tuple[Column, ...], rows: list[tuple[Cell, ...]]) -> Table | None:
    """Make a table of the paper: without the paper's columns where it has no number, None without ours."""
    table = Table(caption, columns, tuple(rows))
    ours = [c.key for c in columns if c.key.startswith("psnr") and not c.key.endswith("_paper")]
    if not rows or any(all(_is_nan(v) for v in table.values(key)) for key in ours):
        return None
    table = table.without(
        *(c.key for c in columns if c.key.endswith("_paper") and all(_is_nan(v) for v in table.values(c.key)))
    )
    return table.without("degree") if len(set(table.values("degree"))) == 1 else table


def table_i(results: Results, scene: str) -> Table | None:
    """Return table I (section V-B): mean PSNR of the images relit from plain ULS and CLS coefficients.

    None if neither method has a row. The paper's numbers stand beside ours for its scene and degree only.
    """
    rows: list[tuple[Cell, ...]] = []
    for (method, degree, setting), row in rows_by_key(scene_rows(results, scene)).items():
        if method in paper.TABLE_I and setting == PLAIN:
            printed = paper.TABLE_I[method] if paper.is_paper_setting(scene, degree) else math.nan
            rows.append((degree, method_label(method), float(row["psnr_mean"]), printed))
    return _paper_table(
        f"Table I for {scene}: mean PSNR in dB of the images relit at the fitted lights from plain coefficients",
        (
            Column("degree", "degree"),
            Column("method", "method"),
            Column("psnr", "PSNR (dB)", 2),
            Column("psnr_paper", "paper (dB)", 2),
        ),
        rows,
    )


def table_iii(results: Results, scene: str) -> Table | None:
    """Return table III (section VI): mean PSNR from plain and from S3TC-compressed coefficients, per method.

    None if there are no plain or no S3TC rows. The paper's numbers stand beside ours for its scene and degree only.
    """
    by_key = rows_by_key(scene_rows(results, scene))
    pairs = dict.fromkeys((method, degree) for method, degree, setting in by_key if setting in (PLAIN, S3TC))
    rows: list[tuple[Cell, ...]] = []
    for method, degree in pairs:
        known = method in paper.TABLE_III and paper.is_paper_setting(scene, degree)
        plain_paper, s3tc_paper = paper.TABLE_III[method] if known else (math.nan, math.nan)
        s3tc_row = by_key.get((method, degree, S3TC))
        rows.append(
            (
                degree,
                method_label(method),
                _psnr(by_key, method, degree, PLAIN),
                plain_paper,
                _psnr(by_key, method, degree, S3TC),
                s3tc_paper,
                math.nan if s3tc_row is None else float(s3tc_row["bits_per_coefficient"]),
            )
        )
    return _paper_table(
        f"Table III for {scene}: mean PSNR in dB of the images relit at the fitted lights from plain and from "
        "S3TC-compressed coefficients",
        (
            Column("degree", "degree"),
            Column("method", "method"),
            Column("psnr_plain", "plain (dB)", 2),
            Column("psnr_plain_paper", "plain, paper (dB)", 2),
            Column("psnr_s3tc", "S3TC (dB)", 2),
            Column("psnr_s3tc_paper", "S3TC, paper (dB)", 2),
            Column("s3tc_bits_per_coefficient", "S3TC bits/coefficient", 3),
        ),
        rows,
    )


ALL_COLUMNS = (
    Column("scene", "scene"),
    Column("method", "method"),
    Column("degree", "degree"),
    Column("codec", "codec"),
    Column("options", "options"),
    Column("rate", "rate asked", 2),
    Column("bits_per_coefficient", "bits/coefficient", 3),
    Column("entropy_bits", "entropy bits", 3),
    Column("kilobytes", "kB", 1),
    Column("mean_energy", "mean ‖c‖²", 2, r"mean $\|c\|^2$"),
    Column("coding_psnr_independent", "coding noise, eq. 11 (dB)", 2),
    Column("coding_psnr_predicted", "coding noise, predicted (dB)", 2),
    Column("coding_psnr", "coding noise (dB)", 2),
    Column("psnr_mean", "PSNR mean, fitted", 2),
    Column("psnr_pooled", "PSNR pooled, fitted", 2),
    Column("psnr_mean_holdout", "PSNR mean, held out", 2),
    Column("psnr_pooled_holdout", "PSNR pooled, held out", 2),
    Column("seconds_fit", "fit (s)", 3),
    Column("seconds_encode", "encode (s)", 3),
    Column("seconds_decode", "decode (s)", 3),
    Column("seconds_measure", "measure (s)", 3),
)


def _table_of(caption: str, columns: tuple[Column, ...], rows: list[np.void]) -> Table:
    """Make a table of results rows; the column of options is there only where rows differ in any."""
    options = differing_options(rows)
    cells = [
        tuple(words if column.key == "options" else _cell(row, column.key) for column in columns)
        for row, words in zip(rows, options, strict=True)
    ]
    table = Table(caption, columns, tuple(cells))
    return table if any(options) else table.without("options")


def _cell(row: np.void, key: str) -> Cell:
    if key == "kilobytes":
        # A row that could not be measured has a note and no size.
        return float(row["encoded_bytes"]) / 1000.0 if np.isfinite(row["bits_per_coefficient"]) else math.nan
    if key == "setting":
        return setting_of(row).label
    value = row[key].item()
    return text(value) if isinstance(value, bytes) else value


def all_rows(results: Results, scene: str | None = None) -> Table:
    """Return every row of one scene, or of all: sizes, PSNRs and seconds. A kB is 1000 bytes."""
    scenes = scene_names(results) if scene is None else [scene]
    rows = [row for name in scenes for row in scene_rows(results, name)]
    of = "" if scene is None else f" of {scene}"
    return _table_of(f"All rows{of}: sizes with every side table, PSNR in dB, seconds", ALL_COLUMNS, rows)


NOISE_COLUMNS = (
    Column("method", "method"),
    Column("degree", "degree"),
    Column("setting", "codec"),
    Column("options", "options"),
    Column("bits_per_coefficient", "bits/coefficient", 3),
    Column("mean_energy", "mean ‖c‖²", 2, r"mean $\|c\|^2$"),
    Column("coding_psnr_independent", "eq. 11 (dB)", 2),
    Column("coding_psnr_predicted", "predicted (dB)", 2),
    Column("coding_psnr", "measured (dB)", 2),
)


def noise_table(results: Results, scene: str) -> Table | None:
    """Return the noise that each codec was predicted to add to the images, and the one that it did; None without any.

    In dB below the squared peak, mean over the whole hemisphere, nothing clipped.
    """
    rows = [row for row in scene_rows(results, scene) if text(row["codec"]) != NO_CODEC]
    if all(np.isnan(row["coding_psnr"]) for row in rows):
        return None
    return _table_of(f"Coding noise of {scene}: predicted before encoding, and measured, in dB", NOISE_COLUMNS, rows)


SUMMARY_COLUMNS = (
    Column("scene", "scene"),
    Column("method", "method"),
    Column("degree", "degree"),
    Column("setting", "codec"),
    Column("options", "options"),
    Column("bits_per_coefficient", "bits per coeff.", 3),
    Column("kilobytes", "kB", 1),
    Column("psnr_mean", "PSNR mean (dB)", 2),
    Column("coding_psnr_predicted", "noise, predicted (dB)", 2),
    Column("coding_psnr", "noise (dB)", 2),
    Column("psnr_pooled_holdout", "held out, pooled (dB)", 2),
    Column("seconds_fit", "fit (s)", 3),
    Column("seconds_encode", "encode (s)", 3),
)


def summary(results: Results) -> Table:
    """Return the few columns of every row that fit a terminal; those about held-out lights only if there are any."""
    rows = [row for name in scene_names(results) for row in scene_rows(results, name)]
    table = _table_of("Summary", SUMMARY_COLUMNS, rows)
    unmeasured = all(_is_nan(value) for value in table.values("psnr_pooled_holdout"))
    return table.without("psnr_pooled_holdout") if unmeasured else table


def repeated_rows(results: Results) -> int:
    """Count the rows that share scene, method, degree, codec and rate with an earlier one."""
    return sum(len(rows := scene_rows(results, scene)) - len(rows_by_key(rows)) for scene in scene_names(results))
