"""Universal ``.rti`` files of hemispherical harmonics (Gautron et al. 2004), as RTIViewer and relight have them.

Three lines of text behind ``#HSH1.2``, scales and biases as float32, then for each pixel, the first row on top, all
bytes of red, of green and of blue; a coefficient is ``byte / 255 · scale + bias``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.durable import naming, replacing
from clrelight.errors import InputError
from clrelight.exchange.coded_maps import CodedMap, Refit
from clrelight.exchange.files import MOST_NUMBER, read_start

TERMS = 9
_HEADER = re.compile(rb"(?:#[^\n]{0,200}\n)+(\d)\s+(\d{1,7}) (\d{1,7}) (\d)\s*?\n(\d{1,2}) (\d) (\d)\s*?\n")
_MOST_HEADER = 1024
_READ_TERMS = (4, 9)


def hemispherical_terms(directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the nine functions in the order of these files, (n, 9); c is the cosine from the zenith."""
    x, y, z = directions_i3.T
    c = np.clip(z, 0.0, 1.0)
    phi = np.arctan2(y, x)
    across, low, pi = np.sqrt(np.maximum(c - c * c, 0.0)), 2.0 * c - 1.0, np.pi
    return np.stack(
        [
            np.full_like(c, 1.0 / np.sqrt(2.0 * pi)),
            np.sqrt(6.0 / pi) * np.cos(phi) * across,
            np.sqrt(3.0 / (2.0 * pi)) * low,
            np.sqrt(6.0 / pi) * np.sin(phi) * across,
            np.sqrt(30.0 / pi) * np.cos(2.0 * phi) * (c * c - c),
            np.sqrt(30.0 / pi) * np.cos(phi) * low * across,
            np.sqrt(5.0 / (2.0 * pi)) * (1.0 - 6.0 * c + 6.0 * c * c),
            np.sqrt(30.0 / pi) * np.sin(phi) * low * across,
            np.sqrt(30.0 / pi) * np.sin(2.0 * phi) * (c * c - c),
        ],
        axis=1,
    )


def write_rti(
    coefficients: CoefficientMap,
    out: str | os.PathLike[str],
    device: Device,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> float:
    """Write a fit as hemispherical harmonics of order 2; return what is left of it, a PSNR in decibel (see `Refit`)."""
    refit = Refit(coefficients, hemispherical_terms, device)
    height, width, _ = coefficients.image_shape
    scale_t, bias_t = refit.quantiser(progress)
    stored = np.stack([255.0 * scale_t, -bias_t * scale_t]).astype("<f4")
    scale_t, bias_t = _numbers(stored)  # as the file says them
    with replacing(out) as part, naming(out):
        part.write(f"#HSH1.2\n3\n{width} {height} 3\n{TERMS} 2 1\n".encode("ascii") + stored.tobytes())
        for _, _, codes_chwt in refit.pieces(scale_t, bias_t, progress):
            part.write(np.moveaxis(codes_chwt, 0, 2).tobytes())
    return refit.decibels


def _numbers(stored_2t: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return scales and biases as `CodedMap` has them."""
    scale_t, least_t = stored_2t.astype(np.float64)
    safe_t = np.where(scale_t == 0.0, 1.0, scale_t)
    return safe_t / 255.0, -255.0 * least_t / safe_t


def read_rti(path: str | os.PathLike[str]) -> CodedMap:
    """Read a file of hemispherical harmonics of order 1 or 2; InputError where it is none, or is cut short."""
    name, content, length = os.fsdecode(path), *read_start(path, _MOST_HEADER)
    match = _HEADER.match(content)
    if match is None or not content.startswith(b"#HSH"):
        raise InputError(f"{name} is no .rti file of hemispherical harmonics: it starts with {content[:8]!r}")
    kind, width, height, channels, terms, _, size = (int(each) for each in match.groups())
    if (kind, channels, size) != (3, 3, 1) or terms not in _READ_TERMS:
        raise InputError(f"{name}: 3 channels of 4 or 9 harmonics in bytes can be read, it has {channels} of {terms}")
    wanted, there = 8 * terms + 3 * terms * width * height, length - match.end()
    if not width or not height or there < wanted:
        raise InputError(f"{name}: {width} × {height} pixels take {wanted} bytes, {there} are there")
    stored_2t = np.frombuffer(content, "<f4", 2 * terms, match.end()).reshape(2, terms)
    if not (np.abs(stored_2t) <= MOST_NUMBER).all():
        raise InputError(f"{name}: its scales and biases are not finite, or beyond {MOST_NUMBER:g}")
    scale_t, bias_t = _numbers(stored_2t)
    codes_hwp = np.memmap(path, np.uint8, "r", match.end() + 8 * terms, (height, width, 3 * terms))
    return CodedMap(codes_hwp, scale_t, bias_t, lambda directions_i3: hemispherical_terms(directions_i3)[:, :terms])
