"""Highlights on a glossy sphere: where the lamp is mirrored in each photograph, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from clrelight.variation.circles import Circle
from clrelight.variation.lobes import LobeFit, Shown
from clrelight.variation.spheres import SphereView

_RIM = 0.985
"""Share of the radius within which a highlight is looked for: beyond is the outline, which moves by noise alone."""
_EDGE = 0.2
"""Share of its height above its surroundings from which on a highlight's pixels count."""
_LEAST_HEIGHT, _LEAST_NOISE = 0.1, 8.0
"""A highlight is at least so high beside the median over all photographs, and beside the noise."""
_RIVAL = 0.5
"""Share of the brightest highlight's light from which on a second one is told of."""
_LOOKED_AT, _ALIKE = 3, 0.5
_MANY = 5
"""Photographs whose median shows what does not move with the lamp."""
_OUTSTANDING = 1.5
"""Noise has hollows as deep as its bumps are high; beside a median, lamps have none. How much higher bumps must be."""


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


def find_highlights(
    samples_ihw: NDArray[np.floating],
    circle: Circle,
    sphere: SphereView,
    factor: float,
    corner_xy: tuple[int, int],
    most: float = np.inf,
    blur: float | None = None,
) -> list[Highlight | None]:
    """Return the brightest highlight of each photograph on a sphere; None where there is none.

    What stays as the lamp moves, such as the room in the sphere, is taken off: the median over the photographs. A
    highlight is looked for by its size, so that broad shading is none. Of five photographs and more, bumps that are no
    higher than hollows are deep are noise or texture, and none is a highlight.

    Parameters
    ----------
    samples_ihw : ndarray, shape (n_light, height, width)
        Linear grey of the part of each photograph around the sphere.
    circle : Circle
        In that part's pixels.
    sphere : SphereView
        In pixels of the photographs.
    factor, corner_xy
        Pixels of the photographs in one of the part's, and where it begins: see `Circle.scaled`.
    most : float
        Radiance from which on samples are clipped.
    blur : float, optional
        Standard deviation of lens and pixel in the part's pixels. With it a highlight's middle is that of a lobe that
        looks like it (`LobeFit`), where one does; else it is the mean of its pixels' lights.
    """
    height, width = samples_ihw.shape[1:]
    y_hw, x_hw = np.mgrid[:height, :width]
    inside_hw = np.hypot(x_hw - circle.x, y_hw - circle.y) < _RIM * circle.radius
    still_hw = np.median(samples_ihw, axis=0) if len(samples_ihw) >= _MANY else samples_ihw.min(axis=0)
    if len(samples_ihw) == 1:
        still_hw = np.full((height, width), np.median(samples_ihw[0][inside_hw]))
    search = _Search(inside_hw, circle, sphere, factor, corner_xy)
    noise = _noise(samples_ihw[:, inside_hw] - still_hw[inside_hw])
    found = [search.run(each_hw - still_hw, each_hw, noise, most) for each_hw in samples_ihw]
    if len(samples_ihw) >= _MANY and not _stand_out([each[2] for each in found if each is not None]):
        return [None] * len(samples_ihw)
    heights = [each[0].height for each in found if each is not None]
    least = _LEAST_HEIGHT * float(np.median(heights)) if heights else 0.0
    kept = [each if each is not None and each[0].height >= least else None for each in found]
    if blur is None or not any(kept):
        return [None if each is None else each[0] for each in kept]
    seen = [
        None if each is None else (each[0], (samples_hw - still_hw, samples_hw, each[1]))
        for each, samples_hw in zip(kept, samples_ihw, strict=True)
    ]
    return _settled(seen, LobeFit(circle, sphere, factor, corner_xy, blur, noise), most)


def _settled(seen: list[tuple[Highlight, Shown] | None], fit: LobeFit, most: float) -> list[Highlight | None]:
    """Return highlights whose middles are those of lobes, where these look like them."""
    lobe = fit.choose([each[1] for each in seen if each is not None], most)
    settled: list[Highlight | None] = []
    found = fit.fit([None if each is None else each[1] for each in seen], most, lobe)
    for each, better in zip(seen, found, strict=True):
        if each is None or better is None:
            settled.append(None if each is None else each[0])
            continue
        x, y, light_3 = fit.light(better)
        settled.append(replace(each[0], x=x, y=y, light_3=light_3, off=better.off * fit.factor))
    return settled


def _noise(moved_ip: NDArray[np.floating]) -> float:
    """Return the standard deviation of single pixels, from the differences of neighbours."""
    if moved_ip.shape[1] < 2:
        return 0.0
    return float(1.4826 * np.median(np.abs(np.diff(moved_ip, axis=1))) / np.sqrt(2.0))


def _stand_out(ratios: list[float]) -> bool:
    """Return whether in most photographs with bumps these are higher than hollows are deep, as those of lamps are."""
    return bool(ratios) and float(np.median(ratios)) > _OUTSTANDING


@dataclass(frozen=True)
class _Search:
    inside_hw: NDArray[np.bool_]
    circle: Circle
    sphere: SphereView
    factor: float
    corner_xy: tuple[int, int]

    def run(
        self, moved_hw: NDArray[np.floating], samples_hw: NDArray[np.floating], noise: float, most: float
    ) -> tuple[Highlight, NDArray[np.bool_], float] | None:
        """Return the brightest highlight of a photograph, its pixels, and its height by the depth of hollows."""
        narrow = max(0.7, 0.015 * self.circle.radius)
        bumps_hw = self._blurred(moved_hw, narrow) - self._blurred(moved_hw, 0.16 * self.circle.radius)
        # Where most photographs have one lamp, its highlight is the median's, and missing from the others: no hollow.
        still_hw = samples_hw - moved_hw
        kept_hw = self._blurred(still_hw, narrow) - self._blurred(still_hw, 0.16 * self.circle.radius)
        deepest = -float((bumps_hw + np.maximum(kept_hw, 0.0))[self.inside_hw].min(initial=0.0))
        bumps_hw[~self.inside_hw] = -np.inf
        tops: list[tuple[float, float, Highlight, NDArray[np.bool_]]] = []
        for _ in range(_LOOKED_AT):
            row, column = np.unravel_index(int(bumps_hw.argmax()), bumps_hw.shape)
            top = float(bumps_hw[row, column])
            # Blurring by `narrow` leaves this much of a pixel's own noise.
            if not top > _LEAST_NOISE * noise / max(1.0, 2.0 * np.sqrt(np.pi) * narrow) or top <= 0.0:
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

    def _blurred(self, values_hw: NDArray[np.floating], sigma: float) -> NDArray[np.float64]:
        """Return the mean over the neighbours inside the disc."""
        inside_hw = self.inside_hw.astype(np.float64)
        sums_hw = ndimage.gaussian_filter(values_hw * inside_hw, sigma, mode="constant")
        return sums_hw / np.maximum(ndimage.gaussian_filter(inside_hw, sigma, mode="constant"), 1e-6)

    def _blob(
        self, moved_hw: NDArray[np.floating], row: int, column: int, top: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64], float]:
        """Return the pixels of a highlight, what they are above its edge, and what surrounds it."""
        y_hw, x_hw = np.ogrid[: moved_hw.shape[0], : moved_hw.shape[1]]
        away_hw = np.hypot(x_hw - column, y_hw - row)
        ring_hw = self.inside_hw & (away_hw > 0.2 * self.circle.radius) & (away_hw < 0.4 * self.circle.radius)
        base = float(np.median(moved_hw[ring_hw])) if ring_hw.any() else 0.0
        near_hw = self.inside_hw & (away_hw <= max(1.5, 0.015 * self.circle.radius))
        peak = max(float(moved_hw[near_hw].max()), base + top)
        edge = base + _EDGE * (peak - base)
        labels_hw, _ = ndimage.label((moved_hw > edge) & self.inside_hw)
        at = np.where(near_hw, moved_hw, -np.inf).argmax()
        blob_hw = labels_hw == labels_hw.flat[at]
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
        x_p = (columns + 0.5) * self.factor - 0.5 + self.corner_xy[0]
        y_p = (rows + 0.5) * self.factor - 0.5 + self.corner_xy[1]
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
