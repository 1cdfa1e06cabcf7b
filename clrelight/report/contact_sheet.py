"""Contact sheets: every relit picture of a scene with its error map, codecs down, methods across."""

from __future__ import annotations

import math
import textwrap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.report.canvas import INK, Page
from clrelight.report.rows import Setting, method_label, method_rank, parse_picture_key, rows_by_key, scene_rows
from clrelight.results import Results

AMPLIFICATION = 8
"""Error maps show 255/8 code values and more at full scale: a PSNR of 18 dB, by then plain to see."""

ERROR_COLOURS = "inferno"  # perceptually uniform, dark where the error is small
CELL = 300  # pixels, about the longer side of a picture
GAP, LABEL, MARGIN, LINE = 8, 30, 20, 22  # pixels
NARROWEST = 220  # pixels of a column: a method's name and its PSNR
MAX_SETTINGS = 24  # rows of a sheet; more would be no longer readable, nor fit the renderer


class Crop(NamedTuple):
    """The part of a picture that is shown."""

    rows: slice
    columns: slice


def contact_sheet(results: Results, scene: str, degree: int) -> Any | None:
    """Draw a scene's pictures at one degree beside their reference.

    Parameters
    ----------
    results : Results
        With pictures ``SCENE/reference`` and ``SCENE/METHOD/DEGREE/CODEC[@RATE]``.
    scene : str
        Name of one of its scenes.
    degree : int
        Of the fits whose pictures are shown.

    Returns
    -------
    matplotlib Figure or None
        None without a reference or without a picture to set against it.

    Raises
    ------
    InputError
        If a picture is not uint8 (height, width, 1 or 3) of the reference's shape, or its key makes no sense.
    """
    reference, pictures = scene_pictures(results, scene, degree)
    if reference is None or not pictures:
        return None
    settings = sorted({setting for _, setting in pictures}, key=lambda setting: setting.rank)[:MAX_SETTINGS]
    return _draw(results, scene, degree, reference, pictures, settings)


def psnr_8bit(picture: NDArray[np.uint8], reference: NDArray[np.uint8]) -> float:
    """Return the PSNR in dB of two 8-bit pictures at peak 255, ``inf`` where identical."""
    error = np.mean((picture.astype(np.float64) - reference) ** 2)
    return math.inf if error == 0 else float(10.0 * np.log10(255.0**2 / error))


def lit_part(reference: NDArray[np.uint8]) -> Crop:
    """Return what lies within a picture's black margins, with a little air around it."""
    lit = reference.max(axis=2) > 8
    if not lit.any():
        return Crop(slice(None), slice(None))
    air = round(0.03 * max(lit.shape))
    slices = []
    for axis in (1, 0):
        inside = np.flatnonzero(lit.any(axis=axis))
        slices.append(slice(max(int(inside[0]) - air, 0), int(inside[-1]) + 1 + air))
    return Crop(*slices)


def scene_pictures(
    results: Results, scene: str, degree: int
) -> tuple[NDArray[np.uint8] | None, dict[tuple[str, Setting], NDArray[np.uint8]]]:
    """Return the reference of a scene, if it has one, and its pictures at one degree; errors as of `contact_sheet`."""
    found = {}
    for key, picture in results.pictures.items():
        parts = parse_picture_key(key)
        if parts and (parts.scene, parts.degree) == (scene, degree):
            found[parts.method, parts.setting] = picture
    reference = results.pictures.get(f"{scene}/reference")
    if reference is not None and found:
        _check(f"{scene}/reference", reference, reference.shape)
        for (method, setting), picture in found.items():
            _check(f"{scene}/{method}/{degree}/{'@'.join(filter(None, setting))}", picture, reference.shape)
    return reference, found


def _check(key: str, picture: NDArray, shape: tuple[int, ...]) -> None:
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] not in (1, 3) or 0 in picture.shape:
        raise InputError(
            f"picture {key} is {picture.dtype} {picture.shape}, expected uint8 (height, width, 1 or 3 channels)"
        )
    if picture.shape != shape:
        raise InputError(f"picture {key} has shape {picture.shape}, its reference has {shape}")


def _bits_label(results: Results, scene: str, degree: int, setting: Setting) -> str:
    """Return the real bits per coefficient of a setting's rows: one number, or a range over the methods."""
    rows = rows_by_key(scene_rows(results, scene))
    bits = [float(row["bits_per_coefficient"]) for (_, d, s), row in rows.items() if (d, s) == (degree, setting)]
    bits = [b for b in bits if math.isfinite(b)]
    low, high = (f"{f(bits):.3g}" for f in (min, max)) if bits else ("", "")
    return "" if not bits else f"{low if low == high else f'{low} – {high}'} bits/coefficient"


def _draw(
    results: Results,
    scene: str,
    degree: int,
    reference: NDArray[np.uint8],
    pictures: dict[tuple[str, Setting], NDArray[np.uint8]],
    settings: list[Setting],
) -> Any:
    crop = lit_part(reference)
    shown = reference[crop].shape
    scale = CELL / max(shown[:2])
    scale = round(scale) if scale >= 0.75 else scale  # whole pixels, unless they have to be averaged
    width, height = (max(round(shown[axis] * scale), 1) for axis in (1, 0))
    column = max(width, NARROWEST)
    row_step = LABEL + 2 * height + 3 * GAP
    methods = sorted({method for method, _ in pictures}, key=method_rank)
    total_width = 2 * MARGIN + (len(methods) + 1) * (column + GAP) - GAP
    notes = _notes(scene, degree, crop, reference.shape[:2], characters=total_width // 9)
    foot = MARGIN + len(settings) * row_step
    page = Page(total_width, foot + 60 + LINE * len(notes) + GAP)
    for i, setting in enumerate(settings):
        y = MARGIN + i * row_step + LABEL
        page.write(MARGIN, y - 8, "reference", fontsize=8)
        show_picture(page, (MARGIN, y, width, height), reference[crop])
        page.write(MARGIN, y + height + 30, setting.label, fontweight="bold", fontsize=10)
        page.write(MARGIN, y + height + 54, _bits_label(results, scene, degree, setting), fontsize=7.5)
        for j, method in enumerate(methods):
            x = MARGIN + (j + 1) * (column + GAP)
            picture = pictures.get((method, setting))
            page.write(x, y - 8, method_label(method), fontweight="bold", fontsize=8)
            page.write(x + column, y - 8, picture_psnr(picture, reference), ha="right", fontsize=8)
            if picture is not None:
                error = np.abs(picture.astype(np.int16) - reference).mean(axis=2)
                show_picture(page, (x, y, width, height), picture[crop])
                show_picture(page, (x, y + height + GAP // 2, width, height), error[crop], **_error_scale())
    _colour_bar(page, foot + GAP)
    for i, note in enumerate(notes):
        page.write(MARGIN, foot + 60 + LINE * (i + 1) - 6, note, fontsize=7.5)
    return page.figure


def show_picture(page: Page, box: tuple[int, int, int, int], picture: NDArray, **style: Any) -> None:
    """Show a picture in a box (x, y, width, height) of a page."""
    if picture.ndim == 3 and picture.shape[2] == 1:
        picture, style = picture[:, :, 0], {"cmap": "gray", "vmin": 0, "vmax": 255}
    axes = page.add_axes(*box)
    axes.set_axis_off()
    whole = box[2] % picture.shape[1] == 0
    axes.imshow(picture, aspect="auto", interpolation="nearest" if whole else "antialiased", **style)


def picture_psnr(picture: NDArray[np.uint8] | None, reference: NDArray[np.uint8]) -> str:
    """Return what to write of a picture: its PSNR, or that there is none."""
    if picture is None:
        return "no picture"
    psnr = psnr_8bit(picture, reference)
    return "identical" if math.isinf(psnr) else f"{psnr:.2f} dB"


def _error_scale() -> dict[str, Any]:
    return {"cmap": ERROR_COLOURS, "vmin": 0.0, "vmax": 255.0 / AMPLIFICATION}


def _notes(scene: str, degree: int, crop: Crop, size: tuple[int, ...], characters: int) -> list[str]:
    """Return what a reader must know about the sheet, in lines of at most so many characters."""
    notes = (
        "Error maps: |difference| to the reference, mean over channels, in code values of 255, "
        f"shown ×{AMPLIFICATION}. {scene}, degree {degree}. dB: PSNR of the whole 8-bit picture."
    )
    shown = [_span(part, extent) for part, extent in zip(crop, size, strict=True)]
    if shown != [_span(slice(None), extent) for extent in size]:
        notes += f" Black margins are not shown: these are rows {shown[0]}, columns {shown[1]}."
    return textwrap.wrap(notes, characters)


def _span(part: slice, size: int) -> str:
    start, stop, _ = part.indices(size)
    return f"{start}–{stop - 1} of {size}"


def _colour_bar(page: Page, y: int) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    scale = _error_scale()
    source = ScalarMappable(Normalize(scale["vmin"], scale["vmax"]), scale["cmap"])
    axes = page.add_axes(MARGIN, y, min(420, page.width - 2 * MARGIN), 16)
    bar = page.figure.colorbar(source, cax=axes, orientation="horizontal", extend="max", ticks=[0, 8, 16, 24])
    bar.outline.set_edgecolor(INK)
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(labelsize=7.5, length=2, pad=2)
