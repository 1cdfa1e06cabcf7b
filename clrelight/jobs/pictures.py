"""Pictures as files: their names, radiance in floats or in 8 bits for display, animations."""

from __future__ import annotations

import importlib.util
import io
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.image_encoding import png_rows
from clrelight.images import write_image
from clrelight.lighting.relighting import map_tones
from clrelight.relight import to_display
from clrelight.streaming import writing_behind

FLOAT_FORMATS = (".exr", ".hdr", ".tif", ".tiff")
"""Images that hold linear radiance as floats."""

DISPLAY_FORMATS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga")
"""Images that hold 8-bit values of one channel or three."""

ANIMATIONS = (".gif", ".apng")
"""Files that hold several pictures: GIFs of 256 colours, animated PNGs of all."""

CODES_PER_DECIBEL = 5
"""8-bit code values, in pictures of decibels."""

_FRAME_MILLISECONDS = 80
_NUMBER_FIELD = re.compile(r"%0[1-9]d|%[1-9]?d(?![A-Za-z])")
"""Where the number of a picture goes: ``%03d``, or ``%d`` that is no part of a word, as in ``50%done``."""


def name_pictures(image: str, count: int) -> list[str]:
    """Return the names of so many images; InputError where several have no number field to tell them apart."""
    folder, name = os.path.split(image)
    fields = list(_NUMBER_FIELD.finditer(name))
    if len(fields) > 1:
        raise InputError(f"{image} has {len(fields)} number fields, expected one, such as relit%03d.png")
    if fields:
        before, after = name[: fields[0].start()], name[fields[0].end() :]
        return [os.path.join(folder, before + fields[0][0] % index + after) for index in range(count)]
    if count > 1:
        raise InputError(f"{count} images need a number field in their name, such as relit%03d.png, got {image!r}")
    return [image]


def list_pictures(image: str) -> list[str]:
    """Return the names of the pictures that are there under a name with a number field; the name where none is."""
    folder, name = os.path.split(image)
    field = _NUMBER_FIELD.search(name)
    if field is None:
        return [image]
    wanted = re.compile(rf"{re.escape(name[: field.start()])}[0-9]+{re.escape(name[field.end() :])}")
    try:
        found = [os.path.join(folder, each) for each in os.listdir(folder or ".") if wanted.fullmatch(each)]
    except OSError:  # there is no such folder yet
        found = []
    return sorted(found) or [image]


def holds_floats(name: str) -> bool:
    """Return whether an image of this name holds linear radiance."""
    return name.lower().endswith(FLOAT_FORMATS)


def is_animation(name: str) -> bool:
    """Return whether all images go to the one file of this name."""
    return name.lower().endswith(ANIMATIONS)


def check_animation() -> None:
    """Raise InputError if animations cannot be written here."""
    if importlib.util.find_spec("PIL") is None:
        raise InputError("a .gif or .apng needs Pillow: pip install 'clrelight[codecs]', or write .png files")


def check_display(name: str) -> None:
    """Raise InputError where no display values can be written under a name; `write_image` would, after long work."""
    if not name.lower().endswith(DISPLAY_FORMATS):
        raise InputError(f"cannot write {name}: a picture for display ends in {', '.join(DISPLAY_FORMATS)}")


def show(image_hwc: NDArray[np.float32], tonemap: str | None, transfer: str) -> NDArray[np.uint8]:
    """Return 8-bit display values of linear radiance."""
    clips = tonemap in (None, "clip")  # display values are clipped anyway
    return to_display(image_hwc if clips else map_tones(image_hwc, str(tonemap)), transfer)


@dataclass(frozen=True)
class Rows:
    """Linear radiance of a picture whose rows come once, from top to bottom.

    Attributes
    ----------
    shape : tuple of int
        Height, width and channels.
    bands : iterator of ndarray, shape (rows, width, channel), float32
    """

    shape: tuple[int, int, int]
    bands: Iterator[NDArray[np.float32]]

    def array(self) -> NDArray[np.float32]:
        """Return all of them."""
        image_hwc, row = np.empty(self.shape, np.float32), 0
        for band in self.bands:
            image_hwc[row : row + len(band)] = band
            row += len(band)
        return image_hwc


def array_of(image_hwc: NDArray[np.float32] | Rows) -> NDArray[np.float32]:
    """Return a picture's values, whether they are there or come in rows."""
    return image_hwc.array() if isinstance(image_hwc, Rows) else image_hwc


def write_view(name: str, image_hwc: NDArray[np.float32] | Rows, tonemap: str | None, transfer: str) -> None:
    """Write linear radiance, as the name wants it: in floats, or for display.

    Rows of a PNG are packed while the next are made.
    """
    if isinstance(image_hwc, Rows):
        if name.lower().endswith(".png") and tonemap is None and image_hwc.shape[2] in (1, 3):
            with png_rows(name, image_hwc.shape) as put:

                def write(band_hwc: NDArray[np.float32]) -> None:
                    put(show(band_hwc, None, transfer))

                with writing_behind(write) as behind:
                    for band_hwc in image_hwc.bands:
                        behind(band_hwc)
            return
        image_hwc = image_hwc.array()
    write_image(name, image_hwc if holds_floats(name) else show(image_hwc, tonemap, transfer))


def write_decibels(name: str, psnr_hw1: NDArray[np.float32]) -> None:
    """Write decibels, as the name wants it: in floats, or `CODES_PER_DECIBEL` to each, up to 51 dB."""
    codes_hw1 = np.rint(np.clip(CODES_PER_DECIBEL * psnr_hw1, 0.0, 255.0)).astype(np.uint8)
    write_image(name, psnr_hw1 if holds_floats(name) else codes_hw1)


def write_animation(name: str, frames: list[NDArray[np.uint8]]) -> None:
    """Write a .gif or an animated PNG that goes round for ever."""
    from PIL import Image

    pictures = [Image.fromarray(each[..., 0] if each.shape[2] == 1 else each) for each in frames]
    content = io.BytesIO()
    kind = "GIF" if name.lower().endswith(".gif") else "PNG"
    pictures[0].save(content, kind, save_all=True, append_images=pictures[1:], duration=_FRAME_MILLISECONDS, loop=0)
    with replacing(name) as part:
        part.write(content.getvalue())
