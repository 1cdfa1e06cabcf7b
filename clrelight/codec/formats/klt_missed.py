"""Pixels of a map that the sample of its axes has missed: looked for where it has no axis at all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clrelight.codec.entropy.units import LEVELS, Window
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.principal import each_channel
from clrelight.codec.transforms.whitening import Whitening

_MOST, _HELD = 256, 1 << 22
"""Pixels that are found at most, those farthest from the mean; values of the map that are looked at together."""


def missed_pixels(pixels: Pixels, whitening: Whitening, step: float) -> list[tuple[int, int]]:
    """Return row and column of pixels that lie over a step from the mean, the farthest first."""
    n_coeff, height, width, channel = pixels.shape
    rows, found = max(_HELD // (n_coeff * width * channel), 1), list[tuple[float, int, int]]()
    for top in range(0, height, rows):
        bottom = min(top + rows, height)
        coeffs_khwc = pixels.coefficients((top, bottom), (0, width))
        # Of a map that is the mean nearly everywhere, what differs from its neighbour is little.
        first_kc = coeffs_khwc[:, 0, 0]
        differs_hw = (coeffs_khwc != first_kc[:, None, None]).any(axis=(0, 3))
        differs_hw[0, 0] = True
        at_2p = np.argwhere(differs_hw)
        value_pq = coeffs_khwc[:, differs_hw].transpose(1, 0, 2).reshape(len(at_2p), -1)
        error_pd = value_pq.astype(np.float64) @ whitening.forward_dq.T - whitening.mean_d
        length_p = np.sqrt(np.square(each_channel(error_pd, whitening.root_nn.T)).sum(axis=1))
        kept = np.flatnonzero(length_p > step)
        found += [(float(length_p[p]), top + int(at_2p[p, 0]), int(at_2p[p, 1])) for p in kept]
        found = sorted(found, reverse=True)[:_MOST]
    return [(row, column) for _, row, column in found]


def around(windows: Sequence[Window], place: tuple[int, int], height: int, width: int) -> list[Window]:
    """Return windows of one size, of which the last lies around a pixel."""
    side_h, side_w = windows[-1].shape
    whole = (1 << LEVELS) - 1
    top, left = (
        max(min(at - side // 2, end - side), 0) & ~whole
        for at, side, end in zip(place, (side_h, side_w), (height, width), strict=True)
    )
    return [*windows[:-1], Window(top, left, top + side_h, left + side_w)]
