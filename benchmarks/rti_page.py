"""The tables and pictures of the RTI benchmark."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.rti_ways import Coded, Found, Way

GROUPS = ("Single", "Multi", "Real")
_PANEL_PIXELS = 128
_PANELS = 5
_SEEN = 40.0
"""Decibels above which nobody sees that an image is not the photograph."""
_ERROR_GAIN = 8.0
"""By which errors are brighter in their panels."""


@dataclass(frozen=True)
class StackResult:
    """What all ways gave on one stack, and the photograph that pictures are beside."""

    name: str
    group: str
    pixels: int
    photograph: NDArray
    mask_hw: NDArray[np.bool_]
    found: Mapping[Way, Found]

    def psnr(self, way: Way) -> float:
        """Mean PSNR of a way; NaN where it cannot do this stack."""
        score = self.found[way].score
        return np.nan if score is None else score.psnr_mean

    @property
    def best(self) -> float:
        """The mean PSNR of the best way."""
        return float(np.nanmax([self.psnr(way) for way in self.found]))


def quality_table(results: Sequence[StackResult], ways: Sequence[Way]) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows: each group's means, and how far every way is behind the best of its stack."""
    groups = [g for g in GROUPS if any(result.group == g for result in results)]
    counts = {g: sum(result.group == g for result in results) for g in groups}
    headers = ["way", "values a pixel", *(f"{g} ({counts[g]})" for g in groups)]
    headers += ["behind the best, median", "at worst", "on", "seconds"]
    rows = []
    for way in ways:
        done = [result for result in results if result.found[way].score is not None]
        values = sorted({result.found[way].values for result in done})
        row = [way.label, "–" if not values else f"{values[0]}" if len(values) == 1 else f"{values[0]}–{values[-1]}"]
        for group in groups:
            scores = [score for r in done if r.group == group and (score := r.found[way].score) is not None]
            whole = len(scores) == counts[group]
            row.append(
                f"{np.mean([s.psnr_mean for s in scores]):.2f} / {np.mean([s.psnr_pooled for s in scores]):.2f}"
                f" / {np.mean([s.ssim for s in scores]):.3f}{'' if whole else f' ({len(scores)} stacks)'}"
                if scores
                else "–"
            )
        behind = [result.best - result.psnr(way) for result in done]
        if done:
            worst = int(np.argmax(behind))
            seconds = np.median([result.found[way].seconds for result in done])
            row += [f"{np.median(behind):.2f}", f"{behind[worst]:.2f}", done[worst].name, f"{seconds:.2f}"]
        else:
            row += ["–"] * 4
        rows.append(row)
    return headers, rows


def size_table(results: Sequence[StackResult], ways: Sequence[Way]) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows of each way's compressed sizes, in bits a pixel that counts, and PSNR over all stacks."""
    headers = ["way", "coded", "bits a pixel", "PSNR, mean over stacks (dB)", "median", "least", "on"]
    rows = []
    for way in ways:
        settings = {coded.setting: None for result in results for coded in result.found[way].coded}
        for setting in settings:
            pairs = [(r, coded) for r in results if (coded := _with_setting(r.found[way], setting)) is not None]
            quality = [coded.score.psnr_mean for _, coded in pairs]
            bits = np.mean([8.0 * coded.byte_count / result.pixels for result, coded in pairs])
            least = int(np.argmin(quality))
            figures = [f"{np.mean(quality):.2f}", f"{np.median(quality):.2f}", f"{quality[least]:.2f}"]
            rows.append([way.label, setting, f"{bits:.2f}", *figures, pairs[least][0].name])
    return headers, rows


def stack_table(results: Sequence[StackResult], ways: Sequence[Way]) -> tuple[list[str], list[list[str]]]:
    """Return headers and rows: the mean PSNR of each way on each stack, the best in bold type."""
    rows = []
    for result in results:
        figures = [result.psnr(way) for way in ways]
        texts = ["–" if np.isnan(figure) else f"{figure:.2f}" for figure in figures]
        best = int(np.nanargmax(figures))
        texts[best] = f"**{texts[best]}**"
        rows.append([result.name, *texts])
    return ["stack", *(way.label for way in ways)], rows


def markdown_table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as Markdown has it."""
    lines = ["| " + " | ".join(headers) + " |", "|---" * len(headers) + "|"]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def draw_pictures(folder: Path, results: Sequence[StackResult], ways: Sequence[Way]) -> dict[Path, str]:
    """Draw the stacks on which the first way is at its median, worst and best; return the files and a line about each.

    That is by how much it lies above the best of the RTI tools' ways, or of all where none is measured. Stacks on which
    that one is above 40 dB are left out as far as there are others: there is nothing to be seen.
    """
    first = ways[0]
    theirs = [way for way in ways[1:] if not way.is_fit]
    others, whose = (theirs, "of the RTI tools' ways") if theirs else (list(ways[1:]), "other way")
    done = [r for r in results if np.isfinite(r.psnr(first)) and any(np.isfinite(r.psnr(way)) for way in others)]
    done = [r for r in done if np.nanmax([r.psnr(way) for way in others]) < _SEEN] or done
    if not done:
        return {}
    margin = [r.psnr(first) - np.nanmax([r.psnr(way) for way in others]) for r in done]
    order = np.argsort(margin, kind="stable")
    drawn = {}
    for what, place in (("median", order[len(order) // 2]), ("worst", order[0]), ("best", order[-1])):
        path = folder / f"rti_{what}.png"
        _draw(path, done[place], ways)
        beside = f"{abs(margin[place]):.2f} dB {'above' if margin[place] >= 0 else 'below'} the best {whose}"
        drawn[path] = (
            f"{done[place].name}, the {what} of the stacks that are not alike to the eye: {first.label} is {beside} "
            f"over all unseen lights; below, errors times {_ERROR_GAIN:g}"
        )
    return drawn


def _with_setting(found: Found, setting: str) -> Coded | None:
    return next((coded for coded in found.coded if coded.setting == setting), None)


def _where_they_differ(images: Sequence[NDArray], mask_hw: NDArray[np.bool_]) -> tuple[slice, slice]:
    """Return the rows and columns of a panel, where images differ most from each other."""
    spread_hw = np.where(mask_hw, np.var([image.mean(axis=2) for image in images], axis=0), 0.0)
    around_hw = ndimage.uniform_filter(spread_hw, _PANEL_PIXELS, mode="constant")
    middle = np.unravel_index(int(np.argmax(around_hw)), around_hw.shape)
    starts = [
        min(max(int(at) - _PANEL_PIXELS // 2, 0), max(n - _PANEL_PIXELS, 0))
        for at, n in zip(middle, mask_hw.shape, strict=True)
    ]
    rows, columns = (slice(start, start + _PANEL_PIXELS) for start in starts)
    return rows, columns


def _draw(path: Path, result: StackResult, ways: Sequence[Way]) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    able = [way for way in ways if result.found[way].example is not None]
    ranked = sorted(able[1:], key=lambda way: -result.psnr(way))
    # The first way, the two best of ours and theirs that are left, and the most usual one.
    theirs = [way for way in ranked if not way.is_fit]
    rivals = [way for way in ranked if way.is_fit and result.psnr(way) != result.psnr(able[0])]  # auto is one of ours
    shown = [able[0], *rivals[:1], *theirs[:1], *theirs[-1:]]
    panels = [("photograph, not fitted", result.photograph)]
    for way in dict.fromkeys(shown):
        image = result.found[way].example
        if image is not None:
            error = np.square((image - result.photograph)[result.mask_hw]).mean()
            panels.append((f"{way.label}\n{-10 * np.log10(max(error, 1e-12)):.1f} dB", image))
    panels = panels[:_PANELS]
    rows, columns = _where_they_differ([image for _, image in panels], result.mask_hw)
    figure = Figure(figsize=(2.3 * len(panels), 4.9), dpi=100)
    FigureCanvasAgg(figure)
    truth = result.photograph[rows, columns]
    for place, (title, image) in enumerate(panels):
        part = image[rows, columns]
        shown = [part] if place == 0 else [part, np.clip(_ERROR_GAIN * np.abs(part - truth), 0.0, 1.0)]
        for row, panel in enumerate(shown):
            axes = figure.add_subplot(2, len(panels), row * len(panels) + place + 1)
            axes.imshow(np.repeat(panel, 3, axis=2) if panel.shape[2] == 1 else panel, interpolation="nearest")
            axes.axis("off")
            if row == 0:
                axes.set_title(title, fontsize=8)
    figure.tight_layout()
    figure.savefig(path, metadata={"Software": None})
