"""All coefficients in one EXR image, a channel each, as compositors read them: ``SH.000.R``, ``SH.000.G``, ..."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.codec.formats.half import count_overflows
from clrelight.dataset import CoefficientMap
from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.memory import PIECE_BYTES
from clrelight.passes import map_rows

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
        If there are more channels than readers take, binary16 does not hold a coefficient, or the file cannot be
        written.
    """
    height, width, channel = coefficients.image_shape
    names = channel_names(coefficients.n_coeff, channel)
    if len(names) > _MOST_CHANNELS:
        raise InputError(f"an EXR image takes {_MOST_CHANNELS} channels at most, the fit has {len(names)}")
    spec = exr_spec(width, height, names, component)
    spec.attribute("clrelight:basis", "real spherical harmonics, no Condon-Shortley sign; k = l (l + 1) + m")
    spec.attribute("clrelight:axes", "light direction: x right, y up, z to the camera")
    spec.attribute("clrelight:degree", coefficients.degree)
    with replacing(out) as part, naming(out):
        _write(coefficients, part.path, spec, progress)


def _write(
    coefficients: CoefficientMap,
    path: Path,
    spec: oiio.ImageSpec,
    progress: Callable[[int, int], None] | None,
) -> None:
    height, width, _ = coefficients.image_shape
    output = ExrFile(path, spec)
    for (first, end), rows_khwc in map_rows(coefficients, PIECE_BYTES):
        if progress is not None:
            progress(first, height)
        if spec.format == oiio.HALF:
            count_overflows(rows_khwc, first, "binary16", clamp=False, otherwise="take --format channels")
        output.write(first, np.moveaxis(rows_khwc, 0, 2).reshape(end - first, width, -1))
    output.close()


def exr_spec(width: int, height: int, names: Sequence[str], component: str) -> oiio.ImageSpec:
    """Return what an EXR image of named channels is, without today's date: always the same bytes."""
    spec = oiio.ImageSpec(width, height, len(names), component)
    spec.channelnames = tuple(names)
    spec.alpha_channel = -1
    spec.attribute("compression", "zip")
    spec.attribute("DateTime", "0000:00:00 00:00:00")
    return spec


class ExrFile:
    """An EXR image whose rows come one after another; OSError or InputError where the disk refuses."""

    def __init__(self, path: Path, spec: oiio.ImageSpec) -> None:
        self._path = path
        self._output: Any = oiio.ImageOutput.create("x.exr")  # the name until it is whole ends otherwise
        if not self._output or not self._output.open(str(path), spec):
            raise InputError(f"cannot write the EXR image: {oiio.geterror()}")

    def write(self, first: int, pixels_hwc: NDArray[np.floating]) -> None:
        """Take rows, from number `first` on."""
        self._check(self._output.write_scanlines(first, first + len(pixels_hwc), 0, np.ascontiguousarray(pixels_hwc)))

    def close(self) -> None:
        """Finish the file."""
        self._check(self._output.close())

    def _check(self, done: bool) -> None:
        if done:
            return
        said = " ".join(self._output.geterror().split())
        with open(self._path, "ab") as file:  # OpenEXR does not say why; the system does, to whoever writes there next
            file.write(bytes(_PROBE_BYTES))
        raise InputError(f"cannot write the EXR image: {said}")
