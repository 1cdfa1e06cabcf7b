"""A stack's photographs, summed as a light from everywhere weighs them: what relighting should give."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import LightStack
from clrelight.lighting.environment import Environment
from clrelight.lighting.relighting import check_channels


def gather_light(environment: Environment, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how much light of the upper hemisphere belongs to each direction, (n_light, channel) float64.

    Every texel above the horizon goes to the nearest direction: ``E_i = sum w L`` over the direction's Voronoi cell.
    """
    texel_t3, weights_t = environment.geometry()
    above_t = (texel_t3[:, 2] > 0) & (weights_t > 0)
    nearest_t = cKDTree(directions_i3).query(texel_t3[above_t])[1]
    radiance_tc = environment.radiance_hwc.reshape(-1, environment.channels)[above_t].astype(np.float64)
    weighted_tc = weights_t[above_t, None] * radiance_tc
    return np.stack([np.bincount(nearest_t, column, len(directions_i3)) for column in weighted_tc.T], axis=1)


def sum_photographs(stack: LightStack, light_ic: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the sum of a stack's photographs, each times its light, in linear radiance: what relighting should give.

    Parameters
    ----------
    stack : LightStack
    light_ic : ndarray, shape (n_light, 1 or 3), float64
        From `gather_light`.

    Returns
    -------
    ndarray, shape (height, width, channel), float64
    """
    height, width, channel = stack.image_shape
    if channel > 1 and light_ic.shape[1] > 1:
        check_channels(channel, light_ic.shape[1])
    image_hwc = np.zeros((height, width, max(channel, light_ic.shape[1])))
    for index, light_c in enumerate(light_ic):
        values_hwc = np.asarray(stack.images_ihwc[index : index + 1])[0] / stack.peak
        image_hwc += light_c * (srgb_to_linear(values_hwc) if stack.transfer == "srgb" else values_hwc)
    return image_hwc
