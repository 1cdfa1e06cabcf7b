"""JPEG 2000 codestreams of one 16-bit plane (ISO/IEC 15444-1, annex A), by OpenJPEG through Pillow.

Of a stream only what carries information is kept: the quantiser steps, and the packets. Everything else, image size,
coding style and tile-part lengths, is written anew to decode, so that a hostile stream cannot choose it.
"""

from __future__ import annotations

import io
import struct
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError, PayloadError

MAX_PIXELS = 1 << 26
"""Pixels of a plane; Pillow takes somewhat more for an attack."""

MAX_LEVELS = 5
TRIES = 6

_SOC, _SOD, _EOC = b"\xff\x4f", b"\xff\x93", b"\xff\xd9"
_QCD, _COM, _SOT = b"\xff\x5c", b"\xff\x64", b"\xff\x90"


def require_pillow() -> Any:
    """Return Pillow's Image module; InputError that names the extra where it is absent or lacks OpenJPEG."""
    try:
        from PIL import Image, features
    except ImportError:
        raise InputError("codec jpeg2000 needs Pillow: pip install 'clrelight[codecs]'") from None
    if not features.check_codec("jpg_2000"):
        raise InputError(
            "codec jpeg2000 needs a Pillow with OpenJPEG, as in its wheels: pip install 'clrelight[codecs]'"
        )
    return Image


def levels_of(height: int, width: int) -> int:
    """Return the wavelet levels: the default 5, fewer where a side is short."""
    return min(MAX_LEVELS, min(height, width).bit_length() - 1)


def steps_size(height: int, width: int) -> int:
    """Return the bytes of the quantiser steps: a style byte and 16 bits for each subband (table A.27)."""
    return 1 + 2 * (3 * levels_of(height, width) + 1)


def encode_plane(codes_hw: NDArray[np.uint16], target: int) -> tuple[bytes, bytes]:
    """Return quantiser steps and packets of at most `target` bytes, close below it; none where that is too few."""
    image = require_pillow().fromarray(codes_hw)
    h, w = codes_hw.shape
    frame = len(_frame(bytes(steps_size(h, w)), b"", h, w))
    if 2 * target >= codes_hw.nbytes:
        steps, packets = _encode(image, 1.0, h, w)  # all that it has
        if len(packets) <= target:
            return steps, packets
    # OpenJPEG is asked for a size with all its markers; it hits it within some per cent, but not below some 30 bytes.
    # What it misses it by, not a slope, tells what to ask for next: `search_falling` took a twentieth more tries.
    low, high, ask = 0, codes_hw.nbytes, min(target, codes_hw.nbytes - 1)
    best = b""
    for _ in range(TRIES):
        steps, packets = _encode(image, max(1.001, codes_hw.nbytes / (ask + frame)), h, w)
        if len(packets) > target:
            high = ask
        else:
            low = ask
            best = packets if len(packets) > len(best) else best
            if len(packets) >= 0.9 * target:
                break
        if high - low < 2:
            break
        ask = min(max(ask + target - len(packets), low + 1), (low + high + 1) // 2, high - 1)
    return steps, best


def decode_plane(steps: bytes, packets: bytes, height: int, width: int) -> NDArray[np.uint16]:
    """Return the plane (h, w), or PayloadError."""
    image_module = require_pillow()
    stream = _frame(steps, packets, height, width)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with image_module.open(io.BytesIO(stream), formats=["JPEG2000"]) as image:
                codes_hw = np.array(image)
    except (OSError, SyntaxError, ValueError, image_module.DecompressionBombError) as error:
        raise PayloadError(f"codec jpeg2000: OpenJPEG refuses a stream: {error}") from None
    if codes_hw.shape != (height, width) or codes_hw.dtype != np.uint16:
        raise PayloadError(f"codec jpeg2000: a stream holds {codes_hw.dtype} {codes_hw.shape}, not the plane")
    return codes_hw


def _main_header(height: int, width: int) -> bytes:
    """Return SOC, SIZ and COD: one unsigned 16-bit component, one tile, one layer, 64 x 64 code blocks, 9/7."""
    size = struct.pack(">HH8IH3B", 41, 0, width, height, 0, 0, width, height, 0, 0, 1, 15, 1, 1)
    style = struct.pack(">HBBHBBBBBB", 12, 0, 0, 1, 0, levels_of(height, width), 4, 4, 0, 0)
    return _SOC + b"\xff\x51" + size + b"\xff\x52" + style


def _frame(steps: bytes, packets: bytes, height: int, width: int) -> bytes:
    quantiser = _QCD + struct.pack(">H", 2 + len(steps)) + steps
    tile = _SOT + struct.pack(">HHIBB", 10, 0, 14 + len(packets), 0, 1) + _SOD
    return _main_header(height, width) + quantiser + tile + packets + _EOC


def _encode(image: Any, ratio: float, height: int, width: int) -> tuple[bytes, bytes]:
    stream = io.BytesIO()
    image.save(
        stream,
        "JPEG2000",
        no_jp2=True,
        irreversible=True,
        num_resolutions=levels_of(height, width) + 1,
        codeblock_size=(64, 64),
        quality_mode="rates",
        quality_layers=[max(ratio, 1.0)],
    )
    coded = stream.getvalue()
    start = coded.index(_QCD, len(_main_header(height, width))) + 4
    steps = coded[start : start + steps_size(height, width)]
    start = coded.index(_SOT, start + len(steps)) + 14
    packets = coded[start:-2]
    # A comment with the library's version stands between steps and tile; nothing else may differ from our frame.
    head, tail = _frame(steps, packets, height, width).split(steps + _SOT, 1)
    if not coded.startswith(head + steps) or not coded.endswith(_SOT + tail):
        raise RuntimeError("OpenJPEG wrote a codestream of another layout than expected; please report its version")
    return steps, packets
