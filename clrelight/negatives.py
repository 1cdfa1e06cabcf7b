"""Radiance below zero: what lossy codecs and reconstruction filters leave is set to zero, and counted."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import is_radiance
from clrelight.errors import InputError

TINY = 1e-3
"""Negative values down to this share of what is bright are set to zero unasked."""

_ADVICE = "--clip-negative sets such values to 0"


@dataclass
class _Seen:
    """Of one picture: how many values were below zero, the least and where it is, and the largest of all values."""

    count: int = 0
    least: float = 0.0
    place: str = ""
    largest: float = 0.0


@dataclass
class Negatives:
    """Sets values below zero to zero, band by band, and in the end says how many there were or that they are too many.

    Attributes
    ----------
    allowed : bool
        Whether the user wants any to be set to zero; otherwise tiny ones only.
    """

    allowed: bool = False
    _seen: dict[int, _Seen] = field(default_factory=dict)

    def clip(self, band_hwc: NDArray, picture: int, what: str, row: int = 0, column: int = 0) -> NDArray:
        """Return values of a picture with none below zero; a picture's bands come from one thread.

        Parameters
        ----------
        band_hwc : ndarray, shape (height, width, channel), float16 or float32
        picture : int
            Which picture it is of.
        what : str
            Names it in messages.
        row, column : int
            Where the band begins in the picture, for messages.

        Raises
        ------
        InputError
            Where a value is not finite.
        """
        seen = self._seen.setdefault(picture, _Seen())
        if is_radiance(band_hwc):
            # Bits of numbers >= 0 are in the numbers' order, and compared many times as fast as halves.
            bits = np.ascontiguousarray(band_hwc).view(band_hwc.dtype.str.replace("f", "u"))
            top = bits.max(initial=0).view(band_hwc.dtype)
            seen.largest = max(seen.largest, float(top) if np.signbit(top) == 0 else float(band_hwc.max(initial=0)))
            return band_hwc
        finite = np.isfinite(band_hwc)
        if not finite.all():
            raise InputError(
                f"{what} has radiance {_describe(band_hwc, ~finite, row, column)}; expected a finite number >= 0"
            )
        below = band_hwc < 0
        seen.count += int(np.count_nonzero(below))
        seen.largest = max(seen.largest, float(band_hwc.max()))
        if float(band_hwc.min()) < seen.least:
            seen.least = float(band_hwc.min())
            seen.place = f"{what} has radiance {_describe(band_hwc, band_hwc == band_hwc.min(), row, column)}"
        return np.maximum(band_hwc, band_hwc.dtype.type(0))

    def conclude(self, bright: float) -> list[str]:
        """Return a note on what was set to zero; InputError if that is more than is tiny, and not allowed.

        Parameters
        ----------
        bright : float
            Radiance that counts as bright; less where no picture reaches it.
        """
        with_some = [seen for seen in self._seen.values() if seen.count]
        if not with_some:
            return []
        least = min(with_some, key=lambda seen: seen.least)
        bound = TINY * min(bright, max(seen.largest for seen in self._seen.values()))
        if not self.allowed and -least.least > bound:
            raise InputError(f"{least.place}; expected a finite number >= 0 ({_ADVICE})")
        count = sum(seen.count for seen in with_some)
        where = f" in {len(with_some)} of {len(self._seen)} images" if len(self._seen) > 1 else ""
        return [f"{count} negative values{where} are set to 0; the least is {least.least:.3g}"]


def _describe(band_hwc: NDArray, chosen: NDArray[np.bool_], row: int, column: int) -> str:
    r, c, channel = (int(v) for v in np.argwhere(chosen)[0])
    return f"{band_hwc[r, c, channel]} at row {r + row}, column {c + column}, channel {channel}"
