"""Highlights on a glossy sphere: where the lamp is mirrored in each photograph, to a fraction of a pixel."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from clrelight.variation.circles import Circle
from clrelight.variation.highlight_search import Highlight, HighlightSearch, Seen
from clrelight.variation.lobes import LobeFit, Shown
from clrelight.variation.spheres import SphereView

__all__ = ("Highlight", "find_highlights")
_LEAST_HEIGHT = 0.1
"""A highlight is at least so high beside the median over all photographs."""
_MANY = 5
"""Photographs whose median shows what does not move with the lamp."""
_WIDER = 1.6
"""How much wider than usual a highlight may be that tells what its photograph shows beside."""
_OUTSTANDING = 1.5
"""Noise has hollows as deep as its bumps are high; beside a median, lamps have none. How much higher bumps must be."""


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

    What stays as the lamp moves, such as the room in the sphere, is taken off, and of five photographs and more matte
    shading too (`Ball`). A highlight is looked for by its size, so that what is broad is none. Of five photographs and
    more, bumps that are no higher than hollows are deep are noise or texture, and none is a highlight.

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
    search = HighlightSearch.of(samples_ihw.shape[1:], circle, sphere, factor, corner_xy)
    if not search.inside_hw.any():  # beside the picture, or of a pixel or two
        return [None] * len(samples_ihw)
    is_many = len(samples_ihw) >= _MANY
    if is_many:
        still_ihw = search.ball().first_guess(samples_ihw)
    elif len(samples_ihw) > 1:
        still_ihw = np.broadcast_to(samples_ihw.min(axis=0), samples_ihw.shape)
    else:
        still_ihw = np.full(samples_ihw.shape, np.median(samples_ihw[0][search.inside_hw]))
    seen = search.run_all(samples_ihw, still_ihw, most)
    if is_many and not _stand_out([each[2] for each in seen if each is not None]):
        return [None] * len(samples_ihw)
    seen = _high_enough(seen)
    if blur is None or not any(seen):
        return [None if each is None else each[0] for each in seen]
    sound = _alike([None if each is None else each[0] for each in seen])
    if sum(each is not None for each in sound) >= _MANY:
        lights_i3 = np.array([np.zeros(3) if each is None else each.light_3 for each in sound])
        spread_i = np.array([0.0 if each is None else each.spread for each in sound])
        still_ihw = search.ball().beside(samples_ihw, lights_i3, spread_i, most)
        again = _high_enough(search.run_all(samples_ihw, still_ihw, most))
        seen = [after or before for before, after in zip(seen, again, strict=True)]
    noise = search.noise(samples_ihw, still_ihw)
    shown = [
        None if each is None else (each[0], (samples_hw - still_hw, samples_hw, each[1]))
        for each, samples_hw, still_hw in zip(seen, samples_ihw, still_ihw, strict=True)
    ]
    return _settled(shown, LobeFit(circle, sphere, factor, corner_xy, blur, noise), most)


def _high_enough(seen: list[Seen | None]) -> list[Seen | None]:
    """Return those not much lower than the others."""
    heights = [each[0].height for each in seen if each is not None]
    least = _LEAST_HEIGHT * float(np.median(heights)) if heights else 0.0
    return [each if each is not None and each[0].height >= least else None for each in seen]


def _alike(found: list[Highlight | None]) -> list[Highlight | None]:
    """Return those not much wider than the others, as what has run into something else is."""
    usual = float(np.median([each.spread for each in found if each is not None]))
    return [each if each is not None and each.spread <= _WIDER * usual else None for each in found]


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


def _stand_out(ratios: list[float]) -> bool:
    """Return whether in most photographs with bumps these are higher than hollows are deep, as those of lamps are."""
    return bool(ratios) and float(np.median(ratios)) > _OUTSTANDING
