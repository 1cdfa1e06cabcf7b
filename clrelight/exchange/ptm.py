"""Polynomial texture maps, ``.ptm`` 1.2 (Malzbender, Gelb, Wolters 2001): written as RGB, read as RGB or LRGB.

A code value is ``a_0 u² + a_1 v² + a_2 u v + a_3 u + a_4 v + a_5``, (u, v) being x and y of the light; rows go from
the bottom up, and a coefficient is ``(byte - bias) · scale``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.exchange.coded_maps import CodedMap, Refit
from clrelight.exchange.files import read_bytes

TERMS = 6
_HEADER = re.compile(
    rb"(PTM_1\.2)\s+(PTM_FORMAT_\w+)\s+(\d{1,7})\s+(\d{1,7})((?:\s+[-+.\deE]+){6})((?:\s+[-+.\d]+){6})[ \t]*\r?\n"
)
_MOST_HEADER = 1024
_FORMATS = {"PTM_FORMAT_RGB": 3 * TERMS, "PTM_FORMAT_LRGB": TERMS + 3}
"""Formats, and the bytes of a pixel in each."""


def polynomial_terms(directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return u², v², u v, u, v and 1 of directions, (n, 6)."""
    u, v = directions_i3[:, 0], directions_i3[:, 1]
    return np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)], axis=1)


def write_ptm(
    coefficients: CoefficientMap,
    out: str | os.PathLike[str],
    *,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Write a fit as a polynomial texture map in RGB; return what is left of it, a PSNR in decibel (see `Refit`)."""
    refit = Refit(coefficients, polynomial_terms, whole_bias=True)
    height, width, _ = coefficients.image_shape
    scale_t, bias_t = refit.quantiser(progress)
    words = [f"{255.0 * each:.9g}" for each in scale_t]
    scale_t = np.array([float(word) for word in words]) / 255.0  # as the header says them
    biases = " ".join(f"{each:.0f}" for each in bias_t)
    head = f"PTM_1.2\nPTM_FORMAT_RGB\n{width}\n{height}\n{' '.join(words)}\n{biases}\n".encode("ascii")
    with replacing(out) as part, naming(out):
        part.write(head)
        for _, end, codes_hwp in refit.pieces(scale_t, bias_t, progress):
            for channel in range(3):
                rows = codes_hwp[::-1, :, channel * TERMS : (channel + 1) * TERMS]
                place = len(head) + (channel * height + height - end) * width * TERMS
                _put(part.descriptor, np.ascontiguousarray(rows).tobytes(), place)
    return refit.decibels


def _put(descriptor: int, content: bytes, place: int) -> None:
    view = memoryview(content)
    while view:
        done = os.pwrite(descriptor, view, place)
        view, place = view[done:], place + done


def read_ptm(path: str | os.PathLike[str]) -> CodedMap:
    """Read a polynomial texture map; InputError where it is none, is cut short, or is compressed by JPEG."""
    name, content = os.fsdecode(path), read_bytes(path)
    match = _HEADER.match(content[:_MOST_HEADER])
    if match is None:
        raise InputError(f"{name} is no polynomial texture map of version 1.2: it starts with {content[:7]!r}")
    kind, width, height = match[2].decode("ascii"), int(match[3]), int(match[4])
    if kind not in _FORMATS:
        raise InputError(f"{name} is {kind}: {' and '.join(_FORMATS)} can be read, compressed ones cannot")
    size, there = _FORMATS[kind] * width * height, len(content) - match.end()
    if not 0 < size <= there:
        raise InputError(f"{name}: {width} × {height} pixels take {size} bytes, {there} are there")
    try:
        scale_t, bias_t = (np.array([float(word) for word in match[group].split()]) for group in (5, 6))
    except ValueError:
        raise InputError(f"{name}: its scales and biases are no numbers") from None
    if not (np.isfinite(scale_t).all() and np.isfinite(bias_t).all()):
        raise InputError(f"{name}: its scales and biases are not finite")
    codes = np.frombuffer(content, np.uint8, size, match.end())
    if kind == "PTM_FORMAT_RGB":
        whole_hwp = np.concatenate(list(codes.reshape(3, height, width, TERMS)), axis=2)
    else:
        split = TERMS * width * height
        parts = [codes[:split].reshape(height, width, TERMS), codes[split:].reshape(height, width, 3)]
        whole_hwp = np.concatenate(parts, axis=2)
    return CodedMap(np.ascontiguousarray(whole_hwp[::-1]), scale_t / 255.0, bias_t, polynomial_terms)
