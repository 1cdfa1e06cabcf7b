"""Which lamps that spheres tell of are not to be trusted, and why."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.variation.highlights import Highlight

RIVAL = 0.5
"""Share of the brightest highlight's light from which on a second one is told of."""
_WIDER, _DIMMER, _RIVALS, _OFTEN, _DEGREES = 1.6, 0.2, 0.7, 0.25, 2.0
"""How much wider than usual a highlight is that has run into something else; how much of the usual height is little;
share of the brightest from which on either may be the lamp; share of photographs with a second highlight from which on
two lamps burn; degrees of standard deviation that are many."""
CLIPPED = 0.25
"""Share of a sphere that a highlight, clipped as it may be, does not fill."""


def doubts(
    highlights: Sequence[Highlight | None],
    lights_i3: NDArray[np.float64],
    uncertain_i: NDArray[np.float64],
    is_outlined: bool,
    clipped_i: NDArray[np.floating],
) -> tuple[str, ...]:
    """Return of each lamp why it is not to be trusted, "" where there is no reason.

    Parameters
    ----------
    highlights : sequence of Highlight or None
        On one sphere, one for each photograph.
    lights_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors to lamps; 0 where there is none.
    uncertain_i : ndarray, shape (n_light,), float64
        Degrees, NaN where not known.
    is_outlined : bool
        Whether the sphere's outline was told by the photographs.
    clipped_i : ndarray, shape (n_light,)
        Share of the sphere that is at the end of the range.
    """
    seen = [each for each in highlights if each is not None]
    if not seen:
        return ("",) * len(lights_i3)
    spread, height = (float(np.median([getattr(each, name) for each in seen])) for name in ("spread", "height"))
    # A lamp that moves with the first is not always the dimmer one, nor always seen beside it.
    two_lamps = np.mean([each.rival > RIVAL for each in seen]) > _OFTEN
    told = []
    for each, light_3, uncertain, clipped in zip(highlights, lights_i3, uncertain_i, clipped_i, strict=True):
        reasons = {
            "no sure outline": not is_outlined,
            "wide": each is not None and each.spread > _WIDER * spread,
            "dim": each is not None and each.height < _DIMMER * height,
            "second highlight": each is not None and each.rival > _RIVALS,
            "two lamps": bool(two_lamps),
            "over-exposed": bool(clipped > CLIPPED),
            "below the horizon": bool(light_3[2] < 0.0),
            "uncertain": bool(uncertain > _DEGREES),
        }
        told.append("" if each is None else ", ".join(name for name, holds in reasons.items() if holds))
    return tuple(told)
