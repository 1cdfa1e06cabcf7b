"""All coefficients in one EXR image, a channel each, as compositors read them: ``SH.000.R``, ``SH.000.G``, ..."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from clrelight.dataset import CoefficientMap
from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.memory import PIECE_BYTES
from clrelight.tiles import row_tiles

_PROBE_BYTES = 1 << 20
_MOST_CHANNELS = 1023
_LETTERS = {1: "Y", 3: "RGB"}


def channel_names(n_coeff: int, channel: int) -> list[str]:
    """Return the names of channels in the order [coefficient, channel]; numbers where there are neither 1 nor 3."""
    letters = _LETTERS.get(channel) or [f"C{c:03}" for c in range(channel)]
    return [f"SH.{k:03}.{letter}" for k in range(n_coeff) for letter in letters]


def write_channels(
    coefficients: CoefficientMap,
    out: str | os.PathLike[str],
    component: str = "float",
    *,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write all coefficients as one EXR image.

    Parameters
    ----------
    coefficients : CoefficientMap
    out : path
    component : str
        ``"float"`` or ``"half"``.
    progress : callable, optional
        Called with rows done and in all.

    Raises
    ------
    InputError
        If there are more channels than readers take, or the file cannot be written.
    """
    height, width, channel = coefficients.image_shape
    names = channel_names(coefficients.n_coeff, channel)
    if len(names) > _MOST_CHANNELS:
        raise InputError(f"an EXR image takes {_MOST_CHANNELS} channels at most, the fit has {len(names)}")
    spec = oiio.ImageSpec(width, height, len(names), component)
    spec.channelnames = tuple(names)
    spec.attribute("compression", "zip")
    spec.attribute("clrelight:basis", "real spherical harmonics, no Condon-Shortley sign; k = l (l + 1) + m")
    spec.attribute("clrelight:axes", "light direction: x right, y up, z to the camera")
    spec.attribute("clrelight:degree", coefficients.degree)
    step = max(PIECE_BYTES // (4 * len(names) * width), 1)
    with replacing(out) as part, naming(out):
        try:
            _write(coefficients, part.path, spec, step, progress)
        except RuntimeError as error:
            # OpenEXR does not say why; the system does, to whoever writes there next.
            os.lseek(part.descriptor, 0, os.SEEK_END)
            part.write(bytes(_PROBE_BYTES))
            raise InputError(f"cannot write {part.target}: {' '.join(str(error).split())}") from None


def _write(
    coefficients: CoefficientMap,
    path: Path,
    spec: oiio.ImageSpec,
    step: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    height, width, channel = coefficients.image_shape
    output = oiio.ImageOutput.create("x.exr")  # the name that it has until it is whole ends otherwise
    if not output or not output.open(str(path), spec):
        raise RuntimeError(oiio.geterror())
    for first, end in row_tiles((0, height), step):
        if progress is not None:
            progress(first, height)
        rows_khwc = np.empty((coefficients.n_coeff, end - first, width, channel), np.float32)
        coefficients.read_rows(first, end, rows_khwc)
        pixels = np.ascontiguousarray(np.moveaxis(rows_khwc, 0, 2).reshape(end - first, width, -1))
        if not output.write_scanlines(first, end, 0, pixels):
            raise RuntimeError(output.geterror())
    if not output.close():
        raise RuntimeError(output.geterror())
