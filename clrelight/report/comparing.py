"""Pictures of a scene to be compared on a page: beside the reference, as errors, and as FLIP where it is installed."""

from __future__ import annotations

import importlib.util
import io

import numpy as np
from numpy.typing import NDArray

from clrelight.perception import display_of, flip_of
from clrelight.report.contact_sheet import AMPLIFICATION, ERROR_COLOURS, picture_psnr, scene_pictures
from clrelight.report.html import data_uri, json_block, plain
from clrelight.report.rows import method_label, method_rank
from clrelight.results import Results

LONGEST_SIDE = 1024
"""Pixels of a picture on a page; larger ones are averaged over squares."""

MOST_BYTES = 24_000_000
"""Of PNGs on a page: a browser opens it at once, and a mail takes it."""

FLIP_COLOURS = "magma"  # as its authors show it
NARROWEST = 512  # pixels on the screen: small pictures are enlarged by whole numbers


def compare_html(results: Results, scene: str, degree: int, room: int = MOST_BYTES) -> tuple[str, tuple[str, ...], int]:
    """Return the comparison of a scene's pictures at one degree, notes on it, and the bytes of PNG that it took.

    The HTML is empty where there is nothing to compare. Errors as of `contact_sheet`.
    """
    reference, pictures = scene_pictures(results, scene, degree)
    if reference is None or not pictures:
        return "", (), 0
    sheet = Comparison(reference.shape, f"{scene}, degree {degree}")
    sheet.add("reference", reference)
    left_out = 0
    for method, setting in sorted(pictures, key=lambda key: (method_rank(key[0]), key[1].rank)):
        if sheet.taken > room and len(sheet.shown) > 1:
            left_out += 1
            continue
        sheet.add(f"{method_label(method)}, {setting.label}", pictures[method, setting], reference)
    more = (f"{left_out} more pictures are left out, for the page would become too large: see the figures.",)
    return sheet.html(), (*sheet.notes(), *(more if left_out else ())), sheet.taken


class Comparison:
    """Pictures of one size that a page shows two of at a time, with a bar between.

    Parameters
    ----------
    shape : tuple of int
        Of the pictures: height, width, 1 or 3.
    what : str
        What they show, for screen readers.

    Attributes
    ----------
    shown : list of dict
        Of each picture its ``name``, ``facts``, and addresses of PNGs: ``picture``, and ``error`` and ``flip``.
    taken : int
        Characters of those.
    """

    def __init__(self, shape: tuple[int, ...], what: str) -> None:
        self.shown: list[dict[str, str]] = []
        self.taken = 0
        self._width, self._what = shape[1], what
        self._step = -(-max(shape[:2]) // LONGEST_SIDE)
        self._with_flip = importlib.util.find_spec("flip_evaluator") is not None

    def add(self, name: str, picture: NDArray[np.uint8], reference: NDArray[np.uint8] | None = None) -> None:
        """Add a picture; with what it is to be equal to, also its errors."""
        step, facts = self._step, ""
        maps = {"picture": _png(_shrunk(picture, step))}
        if reference is not None:
            facts = picture_psnr(picture, reference)
            maps["error"] = _error_png(picture, reference, step)
            if self._with_flip:
                flip_hw = flip_of(*(_display(_shrunk(each, step)) for each in (reference, picture)))
                maps["flip"] = _map_png(flip_hw, FLIP_COLOURS)
                facts += f", FLIP {float(flip_hw.mean()):.4f}"
        self.shown.append({"name": name, "facts": facts, **maps})
        self.taken += sum(map(len, maps.values()))

    def notes(self) -> tuple[str, ...]:
        """Return what to say of them."""
        notes = [f"Errors are shown ×{AMPLIFICATION}, brighter is worse; the dB are those of the one 8-bit picture."]
        if self._with_flip:
            notes.append("FLIP is the difference that an eye sees between two pictures that take turns, from 0 to 1.")
        else:
            notes.append("Maps of FLIP need the package flip-evaluator: pip install 'clrelight[flip]'.")
        if self._step > 1:
            notes.append(
                f"Pictures are averaged over {self._step}×{self._step} pixels, FLIP too; the dB are of all pixels."
            )
        return tuple(notes)

    def html(self) -> str:
        """Return the element; there must be two pictures."""
        shown, width = self.shown, -(-self._width // self._step)
        left = [f'<option value="{i}">{plain(each["name"])}</option>' for i, each in enumerate(shown)]
        right = [name.replace("<option ", "<option selected ", 1) if i == 1 else name for i, name in enumerate(left)]
        kinds = f'<option value="picture">picture</option><option value="error">error ×{AMPLIFICATION}</option>'
        kinds += '<option value="flip">FLIP</option>' if self._with_flip else ""
        wide = width * max(1, NARROWEST // width)
        still = "".join(
            f'<img src="{each["picture"]}" alt="{plain(each["name"])}" width="{width}"> ' for each in shown[:2]
        )
        return "\n".join(
            [
                f'<div class="compare" role="group" aria-label="Compare pictures of {plain(self._what)}">',
                '<div class="choices">',
                f'<label>Left <select name="left">{"".join(left)}</select></label>',
                f'<label>Right <select name="right">{"".join(right)}</select></label>',
                f'<label>Right shows <select name="kind">{kinds}</select></label>',
                "</div>",
                f'<div class="pair" style="max-width:{wide}px"><img class="left" alt=""><img class="right" alt="">'
                '<div class="bar"></div></div>',
                '<p class="drag">Drag the line, or use the arrow keys on the slider.</p>',
                '<input type="range" name="at" min="0" max="100" value="50" aria-label="Where left meets right">',
                "<output></output>",
                json_block(shown),
                "</div>",
                f'<div class="no-script"><p>Without scripts: {plain(shown[0]["name"])}, {plain(shown[1]["name"])}.</p>'
                f"{still}</div>",
            ]
        )


def _display(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    return display_of(picture / 255.0, "srgb")


def _error_png(picture: NDArray[np.uint8], reference: NDArray[np.uint8], step: int) -> str:
    error_hw1 = np.abs(picture.astype(np.int16) - reference).mean(axis=2, keepdims=True)
    return _map_png(_shrunk(error_hw1, step)[..., 0] * (AMPLIFICATION / 255.0), ERROR_COLOURS)


def _shrunk(values_hwc: NDArray, step: int) -> NDArray:
    """Return means over squares, in the type that values have; the last may be cut off."""
    if step == 1:
        return values_hwc
    rows, columns = (np.arange(0, extent, step) for extent in values_hwc.shape[:2])
    sums = np.add.reduceat(np.add.reduceat(values_hwc.astype(np.float64), rows, axis=0), columns, axis=1)
    heights, widths = (
        np.diff([*starts, extent]) for starts, extent in zip((rows, columns), values_hwc.shape[:2], strict=True)
    )
    means = sums / (heights[:, None, None] * widths[None, :, None])
    return np.rint(means).astype(values_hwc.dtype) if values_hwc.dtype.kind == "u" else means.astype(values_hwc.dtype)


def _png(picture_hwc: NDArray[np.uint8], palette: list[int] | None = None) -> str:
    from PIL import Image

    picture = Image.fromarray(picture_hwc[..., 0] if picture_hwc.shape[2] == 1 else picture_hwc)
    if palette is not None:
        picture.putpalette(palette)
    stream = io.BytesIO()
    picture.save(stream, "PNG")
    return data_uri("image/png", stream.getvalue())


def _map_png(values_hw: NDArray, colours: str) -> str:
    """Return values from 0 to 1, and those above as 1, in a colour map."""
    import matplotlib

    table = np.rint(255 * matplotlib.colormaps[colours](np.arange(256))[:, :3]).astype(int)
    codes_hw = np.rint(255 * np.clip(np.nan_to_num(values_hw), 0.0, 1.0)).astype(np.uint8)
    return _png(codes_hw[..., None], table.ravel().tolist())
