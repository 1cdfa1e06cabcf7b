"""The "dama" scene: a glossy sculpture, radiance by view at every vertex (noise-resistant-fitting, fig. 3c)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.transfer.brdfs import BlinnPhong, Brdf, Ggx, Phong
from clrelight.transfer.functions import sample_views
from datasets_synth.codes import check_dtype, to_codes
from datasets_synth.lady import lady_surface
from datasets_synth.studio import studio_lights

SMALLEST_SIZE = 8

_MATTE, _GLOSS = (0.40, 0.34, 0.27), 0.33
MATERIALS: dict[str, Brdf] = {
    "phong": Phong(_MATTE, _GLOSS, exponent=24.0),
    "blinn": BlinnPhong(_MATTE, _GLOSS, exponent=80.0),
    "ggx": Ggx(_MATTE, _GLOSS, roughness=0.55),
}
"""Polished stone, by models."""

EXPOSURE = 0.5
"""Code value 1.0 is reached by a radiance of 2: white marble that faces the key light squarely is just below."""


def render_dama(
    *,
    size: int = 128,
    lights: int = 256,
    pattern: str = "uniform",
    seed: int = 0,
    dtype: str = "float32",
    material: str = "phong",
    progress: Callable[[int, int], None] | None = None,
) -> LightStack:
    """Return the sculpture's radiance towards eyes all over each vertex's hemisphere, in the studio's light.

    Parameters
    ----------
    size : int
        Rows and columns of the grid, at least 8.
    lights : int
        Number of directions, here to eyes.
    pattern : str
        One of `clrelight.sampling.PATTERNS`.
    seed : int
        Seed of the scattered pattern.
    dtype : str
        One of `datasets_synth.codes.DTYPES`; the floats keep highlights above the peak.
    material : str
        One of `MATERIALS`: modified Phong, Blinn-Phong, or microfacets.
    progress : callable, optional
        Called as ``progress(done, total)``.

    Returns
    -------
    LightStack
        ``images_ihwc`` of shape (lights, size, size, 3), with its surface, name ``"dama"``.

    Raises
    ------
    InputError
        A bad argument, or the packages for ray tracing are not installed.
    """
    if size < SMALLEST_SIZE:
        raise InputError(f"size must be at least {SMALLEST_SIZE} rows and columns, got {size}")
    if material not in MATERIALS:
        raise InputError(f"material must be one of {', '.join(MATERIALS)}, got {material!r}")
    check_dtype(dtype)
    views_i3 = make_pattern(pattern, lights, seed)
    surface, light = lady_surface(size, size), studio_lights()
    stack = sample_views(surface, views_i3, light, MATERIALS[material], progress=progress)
    return to_codes(replace(stack, images_ihwc=np.float32(EXPOSURE) * stack.images_ihwc), dtype)
