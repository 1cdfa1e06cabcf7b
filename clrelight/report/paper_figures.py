"""The paper's figures of surfaces: what a method's pictures become as its coefficients are coded."""

from __future__ import annotations

from typing import Any

from clrelight.report import paper
from clrelight.report.canvas import Page
from clrelight.report.contact_sheet import picture_psnr, show_picture
from clrelight.report.rows import Setting, method_label
from clrelight.results import NO_CODEC, Results

SETTINGS = (Setting(NO_CODEC, ""), Setting("uniform", "8"), Setting("wavelet", "4"), Setting("wavelet", "1"))
"""Original, uniform at 8 bits and wavelet at 4 as in the paper; 1 bit, where our wavelet's noise is the paper's."""

FIGURE_1 = (("uls", SETTINGS[0]), ("uls", SETTINGS[2]), ("uls", SETTINGS[3]), ("cls", SETTINGS[3]))
MARGIN, GAP, LABEL = 20, 10, 26  # pixels


def figure_of_method(results: Results, scene: str, degree: int, method: str) -> Any | None:
    """Draw one method's pictures below each other: as fitted, then coded; None where there are fewer than two."""
    return _draw(results, scene, degree, [(method, setting) for setting in SETTINGS])


def figure_1(results: Results, scene: str, degree: int) -> Any | None:
    """Draw ULS as fitted and coded, and CLS coded alike; None where there are fewer than two."""
    return _draw(results, scene, degree, list(FIGURE_1))


def figures_of(scene: str) -> dict[str, int]:
    """Return the numbers of the paper's figures by method, none where a scene is not of a surface in the paper."""
    return paper.FIGURES.get(scene.rsplit("-", 1)[-1], {})


def _draw(results: Results, scene: str, degree: int, wanted: list[tuple[str, Setting]]) -> Any | None:
    found = {}
    for method, setting in wanted:
        key = f"{scene}/{method}/{degree}/{'@'.join(filter(None, setting))}"
        if key in results.pictures:
            found[method, setting] = results.pictures[key]
    reference = results.pictures.get(f"{scene}/reference")
    if len(found) < 2 or reference is None:
        return None
    height, width = reference.shape[:2]
    page = Page(width + 2 * MARGIN, MARGIN + len(found) * (LABEL + height + GAP) + MARGIN)
    y = MARGIN
    for (method, setting), picture in found.items():
        label = f"{method_label(method)}, {'32 bit' if setting.codec == NO_CODEC else setting.label}"
        page.write(MARGIN, y + LABEL - 8, label, fontweight="bold", fontsize=8)
        page.write(MARGIN + width, y + LABEL - 8, picture_psnr(picture, reference), ha="right", fontsize=8)
        show_picture(page, (MARGIN, y + LABEL, width, height), picture)
        y += LABEL + height + GAP
    return page.figure
