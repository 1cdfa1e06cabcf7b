"""Contact sheets: every relit picture of a scene with its error map, codecs down, methods across."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.report.canvas import INK, new_figure
from clrelight.report.rows import Setting, method_label, method_rank, parse_picture_key, rows_by_key, scene_rows
from clrelight.results import Results

AMPLIFICATION = 8
"""Error maps show 255/8 code values and more at full scale: a PSNR of 18 dB, by then plain to see."""

ERROR_COLOURS = "inferno"  # perceptually uniform, dark where the error is small
CELL = 300  # pixels, the longer side of a picture
GAP, LABEL, MARGIN, FOOT = 8, 30, 20, 130  # pixels
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
    degree : int

    Returns
    -------
    matplotlib Figure or None
        None without a reference or without a picture to set against it.

    Raises
    ------
    InputError
        If a picture is not uint8 (height, width, 1 or 3) of the reference's shape, or its key makes no sense.
    """
    pictures = _scene_pictures(results, scene, degree)
    reference = results.pictures.get(f"{scene}/reference")
    if reference is None or not pictures:
        return None
    _check(f"{scene}/reference", reference, reference.shape)
    for (method, setting), picture in pictures.items():
        _check(f"{scene}/{method}/{degree}/{'@'.join(filter(None, setting))}", picture, reference.shape)
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


def _scene_pictures(results: Results, scene: str, degree: int) -> dict[tuple[str, Setting], NDArray[np.uint8]]:
    found = {}
    for key, picture in results.pictures.items():
        parts = parse_picture_key(key)
        if parts and (parts.scene, parts.degree) == (scene, degree):
            found[parts.method, parts.setting] = picture
    return found


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
    shown = reference[crop]
    scale = CELL / max(shown.shape[:2])
    width, height = round(shown.shape[1] * scale), round(shown.shape[0] * scale)
    column_step, row_step = max(width, 170) + GAP, LABEL + 2 * height + GAP // 2 + 2 * GAP
    methods = sorted({method for method, _ in pictures}, key=method_rank)
    total = 2 * MARGIN + (len(methods) + 1) * column_step - GAP, MARGIN + len(settings) * row_step + FOOT
    figure = new_figure(*total)

    def write(x: float, y: float, text: str, **style: Any) -> None:
        figure.text(x / total[0], 1 - y / total[1], text, va="baseline", **style)

    def show(x: float, y: float, picture: NDArray, **style: Any) -> Any:
        box = (x / total[0], 1 - (y + height) / total[1], width / total[0], height / total[1])
        axes = figure.add_axes(box)
        axes.set_axis_off()
        return axes.imshow(picture, aspect="auto", **style)

    def show_picture(x: float, y: float, picture: NDArray[np.uint8]) -> None:
        grey = {"cmap": "gray", "vmin": 0, "vmax": 255} if picture.shape[2] == 1 else {}
        show(x, y, picture[crop].squeeze(axis=2) if grey else picture[crop], **grey)

    columns = {method: MARGIN + (i + 1) * column_step for i, method in enumerate(methods)}
    bar_source = None
    for i, setting in enumerate(settings):
        top = MARGIN + i * row_step
        write(MARGIN, top + LABEL - 8, "reference")
        show_picture(MARGIN, top + LABEL, reference)
        write(MARGIN, top + LABEL + height + GAP + 22, setting.label, fontweight="bold", fontsize=10)
        write(MARGIN, top + LABEL + height + GAP + 46, _bits_label(results, scene, degree, setting), fontsize=7.5)
        for method, x in columns.items():
            picture = pictures.get((method, setting))
            write(x, top + LABEL - 8, method_label(method), fontweight="bold", fontsize=8)
            psnr = math.nan if picture is None else psnr_8bit(picture, reference)
            worth = "no picture" if picture is None else "identical" if math.isinf(psnr) else f"{psnr:.2f} dB"
            write(x + width, top + LABEL - 8, worth, ha="right", fontsize=8)
            if picture is None:
                continue
            show_picture(x, top + LABEL, picture)
            error = np.abs(picture.astype(np.int16) - reference).mean(axis=2)
            bar_source = show(
                x, top + LABEL + height + GAP // 2, error[crop], cmap=ERROR_COLOURS, vmin=0, vmax=255 / AMPLIFICATION
            )
    _colour_bar(figure, bar_source, total)
    write(
        MARGIN,
        total[1] - 14,
        f"{scene}, degree {degree}. dB: PSNR of the whole 8-bit picture shown. "
        f"Shown: rows {_span(crop.rows, reference.shape[0])}, columns {_span(crop.columns, reference.shape[1])}.",
        fontsize=7.5,
    )
    return figure


def _span(part: slice, size: int) -> str:
    start, stop, _ = part.indices(size)
    return f"{start}–{stop - 1} of {size}"


def _colour_bar(figure: Any, source: Any, total: tuple[int, int]) -> None:
    axes = figure.add_axes(
        (MARGIN / total[0], 84 / total[1], min(420, total[0] - 2 * MARGIN) / total[0], 16 / total[1])
    )
    bar = figure.colorbar(source, cax=axes, orientation="horizontal", extend="max", ticks=[0, 8, 16, 24])
    bar.outline.set_edgecolor(INK)
    bar.outline.set_linewidth(0.5)
    bar.ax.tick_params(labelsize=7.5, length=2, pad=2)
    bar.set_label(
        f"error map: |difference| to the reference, mean over channels, in code values of 255 (shown ×{AMPLIFICATION})",
        fontsize=7.5,
        loc="left",
    )
