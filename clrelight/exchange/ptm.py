"""Polynomial texture maps, ``.ptm`` 1.2 (Malzbender, Gelb, Wolters 2001): RGB or LRGB, as bytes or compressed by JPEG.

A code value is ``a_0 u² + a_1 v² + a_2 u v + a_3 u + a_4 v + a_5``, (u, v) being x and y of the light; rows go from
the bottom up, and a coefficient is ``(byte - bias) · scale``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.durable import folder_aside, naming, replacing
from clrelight.errors import InputError
from clrelight.exchange.coded_maps import CodedMap, Refit
from clrelight.exchange.files import MOST_NUMBER, read_start
from clrelight.exchange.ptm_planes import TERMS, JpegPlanes, find_jpeg_planes, map_planes, read_jpeg_planes
from clrelight.images import MAX_PIXELS
from clrelight.streaming import write_at

_HEADER = re.compile(
    rb"(PTM_1\.2)\s+(PTM_FORMAT_\w+)\s+(\d{1,7})\s+(\d{1,7})((?:\s+[-+.\deE]+){6})((?:\s+[-+.\d]+){6})[ \t]*\r?\n"
)
_MOST_HEADER = 1 << 14
_BLOCKS = {"PTM_FORMAT_RGB": (TERMS, TERMS, TERMS), "PTM_FORMAT_LRGB": (TERMS, 3)}
"""Formats, and the planes that lie beside each other in each block of their files."""
_COMPRESSED = {"PTM_FORMAT_JPEG_RGB": 3 * TERMS, "PTM_FORMAT_JPEG_LRGB": TERMS + 3}
"""Formats of a JPEG for each plane, and how many."""


def polynomial_terms(directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return u², v², u v, u, v and 1 of directions, (n, 6)."""
    u, v = directions_i3[:, 0], directions_i3[:, 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=1)


def write_ptm(
    coefficients: CoefficientMap,
    out: str | os.PathLike[str],
    device: Device,
    *,
    quality: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Write a fit as a polynomial texture map in RGB.

    Parameters
    ----------
    coefficients : CoefficientMap
    out : path
    device : Device
    quality : int, optional
        1 to 100: compress its planes by JPEG. Without, they are bytes.
    progress : callable, optional

    Returns
    -------
    float
        What is left of the fit, a PSNR in decibel (see `Refit`), what JPEG costs included.
    """
    refit = Refit(coefficients, polynomial_terms, device, whole_bias=True)
    height, width, _ = coefficients.image_shape
    scale_t, bias_t = refit.quantiser(progress)
    words = [f"{255.0 * each:.9g}" for each in scale_t]
    scale_t = np.array([float(word) for word in words]) / 255.0  # as the header says them
    kind = "PTM_FORMAT_RGB" if quality is None else "PTM_FORMAT_JPEG_RGB"
    biases = " ".join(f"{each:.0f}" for each in bias_t)
    head = f"PTM_1.2\n{kind}\n{width}\n{height}\n{' '.join(words)}\n{biases}\n".encode("ascii")
    if quality is not None:
        _write_compressed(refit, out, head, (scale_t, bias_t), quality, progress)
        return refit.measure(read_ptm(out))
    with replacing(out) as part, naming(out):
        part.write(head)
        for _, end, codes_chwt in refit.pieces(scale_t, bias_t, progress):
            for channel, codes_hwt in enumerate(codes_chwt):
                place = len(head) + (channel * height + height - end) * width * TERMS
                write_at(part.descriptor, memoryview(codes_hwt[::-1].tobytes()), place)
    return refit.decibels


def _write_compressed(
    refit: Refit,
    out: str | os.PathLike[str],
    head: bytes,
    quantiser: tuple[NDArray, NDArray],
    quality: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    height, width, _ = refit.coefficients.image_shape
    with (
        replacing(out) as part,
        naming(out),
        folder_aside(part.target) as folder,
        closing(JpegPlanes(folder, height, width, 3 * TERMS, quality)) as planes,
    ):
        for _, _, codes_chwt in refit.pieces(*quantiser, progress, from_bottom=True):
            codes_cthw = np.moveaxis(codes_chwt[:, ::-1], 3, 1)
            planes.add(codes_cthw.reshape(3 * TERMS, *codes_cthw.shape[2:]))
        part.write(head)
        for piece in planes.pieces():
            part.write(piece)


@dataclass(frozen=True)
class PtmHeader:
    """What a polynomial texture map says of itself, in text, and how much of it there is.

    Attributes
    ----------
    path : Path
    kind : str
        Its format, ``PTM_FORMAT_RGB`` or the like.
    size : (int, int)
        Height and width.
    scale_t, bias_t : ndarray, shape (6,), float64
        As written.
    start : bytes
        How the file begins, with all of its text.
    end : int
        Where scales and biases end.
    """

    path: Path
    kind: str
    size: tuple[int, int]
    scale_t: NDArray[np.float64]
    bias_t: NDArray[np.float64]
    start: bytes
    end: int

    @property
    def planes(self) -> int:
        """Bytes of a pixel, once its planes are decoded."""
        return _COMPRESSED[self.kind] if self.is_compressed else sum(_BLOCKS[self.kind])

    @property
    def is_compressed(self) -> bool:
        """Whether its planes are JPEGs."""
        return self.kind in _COMPRESSED


def read_ptm(path: str | os.PathLike[str]) -> CodedMap:
    """Read a polynomial texture map; InputError where it is none, is cut short, or predicts planes by motion.

    Bytes stay in the file until rows are asked for; planes of a compressed one are held, 18 or 9 bytes a pixel.
    """
    head = read_ptm_header(path)
    if head.is_compressed:
        rows = read_jpeg_planes(head.path, head.start, head.end, *head.size, head.planes)
    else:
        rows = map_planes(head.path, head.end, [(*head.size, count) for count in _BLOCKS[head.kind]])
    return CodedMap(rows, head.scale_t / 255.0, head.bias_t, polynomial_terms)


def read_ptm_header(path: str | os.PathLike[str]) -> PtmHeader:
    """Read the text of a polynomial texture map, and see that what it tells of is there; InputError as of `read_ptm`.

    JPEGs are not decoded.
    """
    name, content, length = Path(os.fsdecode(path)), *read_start(path, _MOST_HEADER)
    match = _HEADER.match(content)
    if match is None:
        raise InputError(f"{name} is no polynomial texture map of version 1.2: it starts with {content[:7]!r}")
    kind, width, height = match[2].decode("ascii"), int(match[3]), int(match[4])
    if kind not in _BLOCKS and kind not in _COMPRESSED:
        raise InputError(f"{name} is {kind}: {', '.join([*_BLOCKS, *_COMPRESSED])} can be read")
    try:
        scale_t, bias_t = (np.array([float(word) for word in match[group].split()]) for group in (5, 6))
    except ValueError:
        raise InputError(f"{name}: its scales and biases are no numbers") from None
    if not (np.abs([scale_t, bias_t]) <= MOST_NUMBER).all():
        raise InputError(f"{name}: its scales and biases are not finite, or beyond {MOST_NUMBER:g}")
    if not 0 < height * width <= MAX_PIXELS:
        raise InputError(f"{name}: {width} × {height} pixels are no picture, or too many")
    head = PtmHeader(name, kind, (height, width), scale_t, bias_t, content, match.end())
    wanted = head.planes * width * height
    if head.is_compressed:
        find_jpeg_planes(name, content, head.end, head.planes)
    elif wanted > length - head.end:
        raise InputError(f"{name}: {width} × {height} pixels take {wanted} bytes, {length - head.end} are there")
    return head
