"""Pictures on terminals: in the form that the terminal says it knows, or in half blocks of two colours."""

from __future__ import annotations

import base64
import os
import shutil
import struct
import sys
import zlib
from collections.abc import Iterator, Mapping
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

SIDES = {"kitty": 256, "iterm": 256, "sixel": 256, "blocks": 48}
"""Pixels of the longer side, by form."""

_KITTY_PIECE = 4096
_SIXEL_LEVELS = 6  # of red, green and blue: 216 colours, which every terminal with sixels has


def picture_form(stream: IO[Any] | None = None, environ: Mapping[str, str] | None = None) -> str | None:
    """Return how to draw a picture: ``kitty``, ``iterm``, ``sixel``, ``blocks``, or None where it cannot be.

    A terminal is not asked, which could wait for ever: the variables that it sets are looked at. Within tmux and
    screen, which pass on no pictures, and where nothing is known, colours of 24 bits must be announced (``COLORTERM``).
    """
    stream = sys.stdout if stream is None else stream
    known = os.environ if environ is None else environ
    term, program = known.get("TERM", ""), known.get("TERM_PROGRAM", "")
    if not stream.isatty() or term in ("", "dumb") or known.get("NO_COLOR"):
        return None
    within = "TMUX" in known or term.startswith(("screen", "tmux"))
    if not within:
        if "KITTY_WINDOW_ID" in known or "kitty" in term or "ghostty" in (term.removeprefix("xterm-"), program):
            return "kitty"
        if program in ("iTerm.app", "WezTerm", "mintty") or known.get("LC_TERMINAL") == "iTerm2":
            return "iterm"
        if "sixel" in term or term.startswith(("foot", "mlterm", "contour", "yaft")):
            return "sixel"
    coloured = known.get("COLORTERM", "").lower() in ("truecolor", "24bit") or term.endswith("-direct")
    return "blocks" if coloured and _writes_blocks(stream) else None


def picture_text(picture_hwc: NDArray[np.uint8], form: str) -> str:
    """Return what draws a picture of 1 or 3 channels, with the end of its line."""
    import numpy as np

    rgb_hwc = np.ascontiguousarray(np.broadcast_to(picture_hwc, (*picture_hwc.shape[:2], 3)))
    return {"kitty": _kitty, "iterm": _iterm, "sixel": _sixel, "blocks": _blocks}[form](rgb_hwc) + "\n"


def longest_side(form: str) -> int:
    """Return the pixels that a picture may have on this terminal."""
    if form != "blocks":
        return SIDES[form]
    columns, lines = shutil.get_terminal_size()
    return max(8, min(SIDES[form], columns - 1, 2 * (lines - 4)))


def _writes_blocks(stream: IO[Any]) -> bool:
    try:
        "▀".encode(getattr(stream, "encoding", None) or "utf-8")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _kitty(rgb_hwc: NDArray[np.uint8]) -> str:
    """Kitty's graphics protocol: raw pixels, deflated, in pieces; the terminal is told not to answer."""
    height, width, _ = rgb_hwc.shape
    text = base64.b64encode(zlib.compress(rgb_hwc.tobytes())).decode()
    pieces = [text[at : at + _KITTY_PIECE] for at in range(0, len(text), _KITTY_PIECE)]
    found = []
    for i, piece in enumerate(pieces):
        about = f"a=T,q=2,f=24,o=z,s={width},v={height}," if i == 0 else ""
        found.append(f"\x1b_G{about}m={int(i + 1 < len(pieces))};{piece}\x1b\\")
    return "".join(found)


def _iterm(rgb_hwc: NDArray[np.uint8]) -> str:
    """iTerm2's inline images: a PNG."""
    content = _png(rgb_hwc)
    text = base64.b64encode(content).decode()
    return f"\x1b]1337;File=inline=1;size={len(content)};width={rgb_hwc.shape[1]}px:{text}\a"


def _png(rgb_hwc: NDArray[np.uint8]) -> bytes:
    height, width, _ = rgb_hwc.shape
    lines = b"".join(b"\0" + row.tobytes() for row in rgb_hwc)

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")


def _sixel(rgb_hwc: NDArray[np.uint8]) -> str:
    """DEC's sixels: bands of six rows, each colour of a band in turn, runs counted."""
    import numpy as np

    height, width, _ = rgb_hwc.shape
    most = _SIXEL_LEVELS - 1
    steps = np.rint(rgb_hwc.astype(np.float64) * (most / 255)).astype(int)
    codes_hw = (steps[..., 0] * _SIXEL_LEVELS + steps[..., 1]) * _SIXEL_LEVELS + steps[..., 2]
    used = np.unique(codes_hw)
    colours = [
        f"#{code};2;{';'.join(str(round(100 * step / most)) for step in (code // 36, code // 6 % 6, code % 6))}"
        for code in used
    ]
    bands = []
    for top in range(0, height, 6):
        band_hw = codes_hw[top : top + 6]
        weights_h = 1 << np.arange(len(band_hw))
        parts = []
        for code in np.unique(band_hw):
            bits_w = (band_hw == code).T @ weights_h
            parts.append(f"#{code}" + "".join(_runs(bits_w)))
        bands.append("$".join(parts))
    return f'\x1bP0;1q"1;1;{width};{height}' + "".join(colours) + "-".join(bands) + "\x1b\\"


def _runs(bits_w: NDArray[np.integer]) -> Iterator[str]:
    import numpy as np

    starts = np.flatnonzero(np.append(True, bits_w[1:] != bits_w[:-1]))
    for start, end in zip(starts, [*starts[1:], len(bits_w)], strict=True):
        sign, count = chr(63 + int(bits_w[start])), int(end - start)
        yield f"!{count}{sign}" if count > 3 else sign * count


def _blocks(rgb_hwc: NDArray[np.uint8]) -> str:
    """Upper half blocks: two pixels a character, its colour above, its background below."""
    lines = []
    for top in range(0, len(rgb_hwc), 2):
        upper_wc = rgb_hwc[top]
        lower_wc = rgb_hwc[top + 1] if top + 1 < len(rgb_hwc) else None
        cells = []
        for column, (r, g, b) in enumerate(upper_wc.tolist()):
            below = "49" if lower_wc is None else "48;2;{};{};{}".format(*lower_wc[column].tolist())
            cells.append(f"\x1b[38;2;{r};{g};{b};{below}m▀")
        lines.append("".join(cells) + "\x1b[0m")
    return "\n".join(lines)
