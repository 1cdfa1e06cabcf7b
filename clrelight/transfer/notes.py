"""What is to be said of a surface's rays."""

from __future__ import annotations

import numpy as np

from clrelight.surface import Surface
from clrelight.transfer.gathering import Tally
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import Samples

_PROBES = 1 << 17
"""Rays that are enough to know how many come from behind."""
_NOTED = 1e-3


def probe(surface: Surface, scene: RayScene, samples: Samples) -> Tally:
    """Return what some rays of all parts of the surface meet, evenly spread."""
    tally = Tally()
    count = max(1, min(surface.n_vertex, _PROBES // samples.count))
    chosen_n = np.unique(np.linspace(0, surface.n_vertex - 1, count).astype(np.intp))
    directions_s3 = samples.directions_s3.astype(np.float32)
    at_n, sample_n = np.nonzero(surface.normals_v3[chosen_n].astype(np.float32) @ directions_s3.T > 0.0)
    tally.rays = len(at_n)
    tally.count(scene.hit(chosen_n[at_n], directions_s3[sample_n]))
    return tally


def behind_note(tally: Tally) -> list[str]:
    """Return a note where rays meet the inner side of the surface, which sends on nothing."""
    share = tally.behind / max(tally.rays, 1)
    if share < _NOTED:
        return []
    return [
        f"{share:.1%} of the rays meet the surface from behind, where it is dark: it is open, inside out, or its parts "
        "cross each other"
    ]
