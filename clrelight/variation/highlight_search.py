"""Bumps of brightness on a sphere in photographs, of which the highest is the lamp's highlight."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from clrelight.variation.beside_highlights import Ball
from clrelight.variation.circles import Circle, scaled_places
from clrelight.variation.spheres import SphereView

_RIM, _MARGIN = 0.985, 1.5
"""Share of the radius, and pixels off the outline, within which a highlight is looked for: what lies behind is mixed
into the pixels beyond, and moves by noise alone."""
_FRONT, _BESIDE = 0.8, 0.15
"""Share of the radius within which lamps above the table are mirrored, and some below; share of the highest bump of all
that is a highlight there: nearer to the outline a ball mirrors the table, its own shadow on it too."""
_EDGES = (0.8, 0.65, 0.5, 0.35, 0.2)
"""Shares of its height above its surroundings from which on a highlight's pixels count: the last, unless its pixels run
into something else before."""
_RUNS, _FEW = 3.0, 12
"""By how much a highlight may grow from share to share, and by how many pixels beside."""
_LEAST_NOISE = 8.0
"""A highlight is at least so high beside the noise."""
_LOOKED_AT, _ALIKE = 3, 0.5


@dataclass(frozen=True)
class Highlight:
    """The brightest highlight of a photograph.

    Attributes
    ----------
    x, y : float
        Its middle, in pixels of what was looked at.
    light_3 : ndarray, shape (3,), float64
        Unit vector to the lamp.
    height : float
        Above its surroundings, in linear radiance.
    spread : float
        Degrees by which its pixels' lights are off their mean, root of the mean square.
    rival : float
        Light of the second brightest highlight as a share of its own.
    clipped : bool
        Whether its top is at the end of the range.
    off : float
        Standard deviation of its middle, in pixels; NaN where that is the mean of its pixels.
    """

    x: float
    y: float
    light_3: NDArray[np.float64]
    height: float
    spread: float
    rival: float
    clipped: bool
    off: float = np.nan


Seen = tuple[Highlight, NDArray[np.bool_], float]
"""A highlight, its pixels, and its height by the depth of hollows."""


def _noise(moved_ip: NDArray[np.floating]) -> float:
    """Return the standard deviation of single pixels, from the differences of neighbours."""
    if moved_ip.shape[1] < 2:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(moved_ip, axis=1))) / np.sqrt(2.0))


@dataclass(frozen=True)
class _Mean:
    """The mean over a pixel's neighbours inside a disc, by a Gaussian.

    Products of whole matrices: a Gaussian as wide as a large ball's surroundings takes ten times as long term by term.

    Attributes
    ----------
    sigma : float
        Pixels.
    inside_hw : ndarray, shape (height, width), bool
        The disc.
    down_hh, across_ww : ndarray, shape (height, height) and (width, width), float64
        What rows and columns add to each other.
    share_hw : ndarray, shape (height, width), float64
        How much of a pixel's neighbours is inside.
    """

    sigma: float
    inside_hw: NDArray[np.bool_]
    down_hh: NDArray[np.float64]
    across_ww: NDArray[np.float64]
    share_hw: NDArray[np.float64]

    @classmethod
    def of(cls, inside_hw: NDArray[np.bool_], sigma: float) -> _Mean:
        """Return the mean of a disc by a standard deviation in pixels."""
        down_hh, across_ww = (_gaussian(side, sigma) for side in inside_hw.shape)
        return cls(sigma, inside_hw, down_hh, across_ww, np.maximum(down_hh @ inside_hw @ across_ww, 1e-6))

    def __call__(self, values_hw: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the means of values."""
        return np.asarray(self.down_hh @ (values_hw * self.inside_hw) @ self.across_ww / self.share_hw)


def _gaussian(side: int, sigma: float) -> NDArray[np.float64]:
    """Return what each of so many pixels in a row adds to each, (side, side)."""
    away_ss = np.subtract.outer(np.arange(side), np.arange(side)) / sigma
    return np.exp(-0.5 * away_ss**2) / (np.sqrt(2.0 * np.pi) * sigma)


@dataclass(frozen=True)
class HighlightSearch:
    """Looks for the brightest bump of photographs of a sphere.

    Attributes
    ----------
    inside_hw, front_hw : ndarray, shape (height, width), bool
        Where highlights may be, and where the sphere mirrors lamps above the table.
    circle : Circle
        In the part's pixels.
    sphere : SphereView
        In pixels of the photographs.
    factor, corner_xy
        See `Circle.scaled`.
    narrow, wide : _Mean
        Of what is as small as a highlight, and of its surroundings.
    """

    inside_hw: NDArray[np.bool_]
    front_hw: NDArray[np.bool_]
    circle: Circle
    sphere: SphereView
    factor: float
    corner_xy: tuple[int, int]
    narrow: _Mean
    wide: _Mean

    @classmethod
    def of(
        cls,
        shape_hw: tuple[int, int],
        circle: Circle,
        sphere: SphereView,
        factor: float,
        corner_xy: tuple[int, int],
    ) -> HighlightSearch:
        """Return the search of a part of photographs, of so many rows and columns."""
        y_hw, x_hw = np.ogrid[: shape_hw[0], : shape_hw[1]]
        away_hw = np.hypot(x_hw - circle.x, y_hw - circle.y)
        inside_hw = away_hw < min(_RIM * circle.radius, circle.radius - _MARGIN)
        front_hw = away_hw < _FRONT * circle.radius
        means = _Mean.of(inside_hw, max(0.7, 0.015 * circle.radius)), _Mean.of(inside_hw, 0.16 * circle.radius)
        return cls(inside_hw, front_hw, circle, sphere, factor, corner_xy, *means)

    def noise(self, samples_ihw: NDArray[np.floating], still_ihw: NDArray[np.floating]) -> float:
        """Return the standard deviation of single pixels."""
        return _noise(samples_ihw[:, self.inside_hw] - still_ihw[:, self.inside_hw])

    def run_all(
        self, samples_ihw: NDArray[np.floating], still_ihw: NDArray[np.floating], most: float
    ) -> list[Seen | None]:
        """Return of each photograph what `run` does, beside what each shows without a highlight."""
        noise = self.noise(samples_ihw, still_ihw)
        return [
            self.run(samples_hw - still_hw, samples_hw, noise, most)
            for samples_hw, still_hw in zip(samples_ihw, still_ihw, strict=True)
        ]

    def ball(self) -> Ball:
        """Return the normals and mirrored lamps of the part's pixels."""
        y_hw, x_hw = np.indices(self.inside_hw.shape)
        x_p, y_p = self._places(x_hw.ravel(), y_hw.ravel())
        shape = *x_hw.shape, 3
        normals_hw3 = self.sphere.normals(x_p, y_p).reshape(shape)
        mirrored_hw3 = self.sphere.mirrored(x_p, y_p).reshape(shape)
        return Ball(normals_hw3, mirrored_hw3, self.circle.radius)

    def _places(
        self, columns_p: NDArray[np.integer], rows_p: NDArray[np.integer]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return scaled_places(columns_p.astype(np.float64), rows_p.astype(np.float64), self.factor, self.corner_xy)

    def run(
        self, moved_hw: NDArray[np.floating], samples_hw: NDArray[np.floating], noise: float, most: float
    ) -> Seen | None:
        """Return the brightest highlight of a photograph, its pixels, and its height by the depth of hollows."""
        bumps_hw = self.narrow(moved_hw) - self.wide(moved_hw)
        # Where most photographs have one lamp, its highlight is the median's, and missing from the others: no hollow.
        still_hw = samples_hw - moved_hw
        kept_hw = self.narrow(still_hw) - self.wide(still_hw)
        within_hw, tops_hw = self._within(bumps_hw)
        deepest = -float((bumps_hw + np.maximum(kept_hw, 0.0))[within_hw].min(initial=0.0))
        bumps_hw[~tops_hw] = -np.inf
        tops: list[tuple[float, float, Highlight, NDArray[np.bool_]]] = []
        for _ in range(_LOOKED_AT):
            row, column = np.unravel_index(int(bumps_hw.argmax()), bumps_hw.shape)
            top = float(bumps_hw[row, column])
            # The narrow mean leaves this much of a pixel's own noise.
            if not top > _LEAST_NOISE * noise / max(1.0, 2.0 * np.sqrt(np.pi) * self.narrow.sigma) or top <= 0.0:
                break
            blob_hw, weight_hw, base = self._blob(moved_hw, int(row), int(column), top)
            if weight_hw[blob_hw].min() <= 0.0:  # no pixel is above the edge: the bump is a hollow's rim, no highlight
                blob_hw = np.zeros_like(blob_hw)
                blob_hw[row, column] = True
            else:
                measured = self._measure(blob_hw, weight_hw, samples_hw, base, moved_hw, most)
                tops.append((top, float(weight_hw.sum()), measured, blob_hw))
            bumps_hw[ndimage.binary_dilation(blob_hw, iterations=max(2, int(0.05 * self.circle.radius)))] = -np.inf
        if not tops:
            return None
        # The sharpest bump is the lamp, not the shading; of those about as high, as clipped ones are, the largest.
        sharpest = tops[0][0]
        alike = [each for each in tops if each[0] >= _ALIKE * sharpest]
        light, best, blob_hw = max((each[1:] for each in alike), key=lambda each: each[0])
        rival = max((each[1] for each in alike if each[2] is not best), default=0.0) / light
        return replace(best, rival=rival), blob_hw, sharpest / max(deepest, 1e-3 * sharpest)

    def _within(self, bumps_hw: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return where bumps are looked for, in front if there is one, and where there their tops may be."""
        front_hw = self.inside_hw & self.front_hw
        within_hw = np.where(self.inside_hw, bumps_hw, -np.inf)
        reach = 2 * int(np.ceil(0.06 * self.circle.radius)) + 3
        # Not the flanks of what lies beyond.
        tops_hw = front_hw & (within_hw == ndimage.maximum_filter(within_hw, reach))
        most = float(within_hw.max())
        if tops_hw.any() and bumps_hw[tops_hw].max() >= _BESIDE * most > 0.0:
            return front_hw, tops_hw
        return self.inside_hw, self.inside_hw

    def _blob(
        self, moved_hw: NDArray[np.floating], row: int, column: int, top: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], float]:
        """Return the pixels of a highlight, what they are above its edge, and what surrounds it."""
        y_hw, x_hw = np.ogrid[: moved_hw.shape[0], : moved_hw.shape[1]]
        away_hw = np.hypot(x_hw - column, y_hw - row)
        around_hw = self.inside_hw & self.front_hw if self.front_hw[row, column] else self.inside_hw
        ring_hw = around_hw & (away_hw > 0.2 * self.circle.radius) & (away_hw < 0.4 * self.circle.radius)
        base = float(np.median(moved_hw[ring_hw])) if ring_hw.any() else 0.0
        near_hw = self.inside_hw & (away_hw <= max(1.5, 0.015 * self.circle.radius))
        peak = max(float(moved_hw[near_hw].max()), base + top)
        at, count, edge = np.where(near_hw, moved_hw, -np.inf).argmax(), 0, peak
        blob_hw = np.zeros_like(near_hw)
        for share in _EDGES:
            lower = base + share * (peak - base)
            labels_hw, _ = ndimage.label((moved_hw > lower) & self.inside_hw)
            wider_hw = labels_hw == labels_hw.flat[at]
            size = int(np.count_nonzero(wider_hw))
            if count and size > _RUNS * count + _FEW:
                break
            blob_hw, count, edge = wider_hw, size, lower
        return blob_hw, np.where(blob_hw, moved_hw - edge, 0.0), base

    def _measure(
        self,
        blob_hw: NDArray[np.bool_],
        weight_hw: NDArray[np.float64],
        samples_hw: NDArray[np.floating],
        base: float,
        moved_hw: NDArray[np.floating],
        most: float,
    ) -> Highlight:
        """Return a highlight of the mean of its pixels' lights.

        Every pixel of a sphere seen from afar mirrors the same solid angle of light, 4 dA / r^2: so their plain mean
        is the middle of the lamp, near the outline too, where the middle of the pixels is not.
        """
        rows, columns = np.nonzero(blob_hw)
        weight_p = weight_hw[rows, columns]
        x_p, y_p = self._places(columns, rows)
        lights_p3 = self.sphere.mirrored(x_p, y_p)
        mean_3 = weight_p @ lights_p3
        light_3 = mean_3 / max(float(np.linalg.norm(mean_3)), 1e-12)
        off_p = np.degrees(np.arccos(np.clip(lights_p3 @ light_3, -1.0, 1.0)))
        return Highlight(
            float(weight_p @ x_p / weight_p.sum()),
            float(weight_p @ y_p / weight_p.sum()),
            light_3,
            float(moved_hw[blob_hw].max() - base),
            float(np.sqrt(weight_p @ off_p**2 / weight_p.sum())),
            0.0,
            bool(samples_hw[blob_hw].max() >= most),
        )
