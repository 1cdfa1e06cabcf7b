"""Lamps that several spheres tell of: their means, and how far these are apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.jobs.variation.sphere_lights import SphereLights

_STRAY = 6.0
"""Degrees off what other spheres say beyond which one of several is left out."""


def agree(spheres: Sequence[SphereLights]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return each lamp's mean over the spheres that tell of it, and how far these are apart in degrees (NaN of one).

    Of three and more, those far off the one in the middle are left out; of any, those in doubt beside others that are
    not.
    """
    lights_si3 = np.stack([each.lights_i3 for each in spheres])
    doubted_si = np.array([[bool(each) for each in sphere.doubts] for sphere in spheres])
    mean_i3, apart_i = np.zeros(lights_si3.shape[1:]), np.full(lights_si3.shape[1], np.nan)
    for i in range(lights_si3.shape[1]):
        tells_s: NDArray[np.bool_] = np.any(lights_si3[:, i] != 0.0, axis=1)
        sure_s = tells_s & ~doubted_si[:, i]
        told_s3 = lights_si3[sure_s if sure_s.any() else tells_s, i]
        if not len(told_s3):
            continue
        off_ss = np.degrees(np.arccos(np.clip(told_s3 @ told_s3.T, -1.0, 1.0)))
        if len(told_s3) > 2:
            middle = int(np.median(off_ss, axis=1).argmin())
            told_s3 = told_s3[off_ss[middle] < max(_STRAY, 3.0 * float(np.median(off_ss[middle])))]
        mean_3 = told_s3.sum(axis=0)
        mean_i3[i] = mean_3 / np.linalg.norm(mean_3)
        if len(told_s3) > 1:
            apart_i[i] = float(np.degrees(np.arccos(np.clip(told_s3 @ mean_i3[i], -1.0, 1.0))).max())
    return mean_i3, apart_i
