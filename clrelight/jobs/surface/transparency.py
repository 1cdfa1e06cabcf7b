"""Pictures with alpha as files: floats times alpha, display values not, as their formats define them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.image_sink import sink_for
from clrelight.jobs.pictures import holds_floats, show

ALPHA_FORMATS = (".png", ".exr", ".tif", ".tiff")


def check_alpha(name: str) -> None:
    """Raise InputError if an image of this name holds no alpha."""
    if not name.lower().endswith(ALPHA_FORMATS):
        raise InputError(f"a transparent background goes to {', '.join(ALPHA_FORMATS)}, got {name}")


def write_transparent(name: str, image_hwc: NDArray[np.float32], tonemap: str | None, transfer: str) -> None:
    """Write a picture whose last channel is alpha and whose others are multiplied by it, (height, width, 2 or 4)."""
    check_alpha(name)
    values, stored = np.ascontiguousarray(image_hwc), oiio.FLOAT
    if not holds_floats(name):
        alpha_hw1 = image_hwc[..., -1:]
        colours_hwc = image_hwc[..., :-1] / np.where(alpha_hw1 > 0.0, alpha_hw1, 1.0)
        codes_hw1 = np.rint(255.0 * np.clip(alpha_hw1, 0.0, 1.0)).astype(np.uint8)
        values = np.concatenate([show(np.ascontiguousarray(colours_hwc), tonemap, transfer), codes_hw1], axis=2)
        stored = oiio.UINT8
    height, width, channels = values.shape
    spec = oiio.ImageSpec(width, height, channels, stored)
    spec.attribute("DateTime", "0000:00:00 00:00:00")
    spec.channelnames = ("Y", "A") if channels == 2 else ("R", "G", "B", "A")
    spec.alpha_channel = channels - 1
    spec.attribute("oiio:UnassociatedAlpha", int(values.dtype.kind == "u"))
    path = Path(name)
    extension = path.suffix.lower()
    with replacing(path) as part, naming(path), sink_for(part, extension, values.nbytes) as place:
        writer = oiio.ImageOutput.create(extension.removeprefix("."))
        done = writer is not None and writer.open(str(place), spec) and writer.write_image(values)
        if writer is None or not (writer.close() and done):
            raise InputError(f"cannot write {path}: {oiio.geterror() or 'no reason given'}")
