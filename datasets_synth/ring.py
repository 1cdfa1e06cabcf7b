"""The "ring" scene: rings on a tiled ground, one view, lights on the upper hemisphere (noise-resistant-fitting, III-A).

Axes: x right, y away from the eye along the ground, z up from the ground, so the hemisphere z > 0 is the one
above the ground; light directions are in these axes. Units: the picture shows about 3 by 3 of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from datasets_synth.render import GROUND, SUBSAMPLES, Camera, Material, Samples, TorusTracer, shade_pixels
from datasets_synth.shapes import Torus, torus_on_ground
from datasets_synth.texture import tile_albedo

DTYPES = ("uint8", "float16", "float32")
"""Sample types that `render_ring` writes."""

SMALLEST_SIZE = 8

EXPOSURE = 1.4
"""Code value 1.0 is reached by a Lambertian of reflectance 0.71 that faces the light."""

# A band of rows with all its temporaries stays within some tens of megabytes, whatever the picture's size.
_BAND_SAMPLES = 1 << 16

CAMERA = Camera(eye=(0.0, -4.2, 4.6), target=(0.05, -0.02, 0.15), width=0.46)


@dataclass(frozen=True)
class Ring:
    """A torus and what it is made of."""

    torus: Torus
    material: Material


LEANING = (0.45, -0.21, 0.87)

RINGS = (
    # Gold, lying.
    Ring(
        torus_on_ground((-0.50, -0.20), (0.0, 0.0, 1.0), major=0.58, minor=0.13),
        Material(diffuse=(0.46, 0.29, 0.08), specular=(0.95, 0.70, 0.30), roughness=0.28),
    ),
    # Silver, standing in the ground.
    Ring(
        torus_on_ground((0.50, 0.72), (0.45, -0.89, 0.0), major=0.52, minor=0.095, sink=0.12),
        Material(diffuse=(0.36, 0.37, 0.39), specular=(0.92, 0.91, 0.88), roughness=0.22),
    ),
    # Copper, leaning on the gold one: the two all but touch.
    Ring(
        torus_on_ground((0.002, -0.434), LEANING, major=0.44, minor=0.075),
        Material(diffuse=(0.42, 0.20, 0.13), specular=(0.93, 0.60, 0.48), roughness=0.32),
    ),
    # Blue enamel, lying.
    Ring(
        torus_on_ground((0.92, -0.42), (0.0, 0.0, 1.0), major=0.26, minor=0.085),
        Material(diffuse=(0.05, 0.14, 0.50), specular=(0.05, 0.05, 0.05), roughness=0.12),
    ),
    # Red enamel, small, inside the gold one.
    Ring(
        torus_on_ground((-0.68, -0.22), (0.0, 0.0, 1.0), major=0.17, minor=0.055),
        Material(diffuse=(0.58, 0.05, 0.06), specular=(0.05, 0.05, 0.05), roughness=0.12),
    ),
    # Green enamel, standing askew in the ground.
    Ring(
        torus_on_ground((-0.75, 0.85), (-0.70, -0.62, 0.35), major=0.24, minor=0.06, sink=0.06),
        Material(diffuse=(0.06, 0.36, 0.14), specular=(0.05, 0.05, 0.05), roughness=0.15),
    ),
)


def render_ring(
    *,
    size: int = 256,
    lights: int = 256,
    pattern: str = "uniform",
    seed: int = 0,
    dtype: str = "uint8",
    progress: Callable[[int, int], None] | None = None,
) -> LightStack:
    """Render the rings under each light of a pattern, with hard shadows, highlights and a textured ground.

    A light is distant, of unit irradiance at normal incidence; there is no other light and no reflection from
    one surface to another. Equal arguments give equal bytes.

    Parameters
    ----------
    size : int
        Height and width in pixels, at least 8.
    lights : int
        Number of lights, at least 1.
    pattern : str
        One of `clrelight.sampling.PATTERNS`.
    seed : int
        Seed of the ground's texture and of the scattered pattern, at least 0.
    dtype : str
        One of `DTYPES`. ``"uint8"`` is linear, clipped and rounded, with peak 255; the floats have peak 1 and
        keep the highlights above it.
    progress : callable, optional
        Called as ``progress(done, total)``, from this thread.

    Returns
    -------
    LightStack
        ``images_ihwc`` of shape (lights, size, size, 3), transfer ``"linear"``, name ``"ring"``.

    Raises
    ------
    InputError
        A bad argument, or the packages for ray tracing are not installed.
    """
    if size < SMALLEST_SIZE:
        raise InputError(f"size must be at least {SMALLEST_SIZE} pixels, got {size}")
    if dtype not in DTYPES:
        raise InputError(f"dtype must be one of {', '.join(DTYPES)}, got {dtype!r}")
    directions_i3 = make_pattern(pattern, lights, seed)
    tracer = TorusTracer([ring.torus for ring in RINGS])
    materials = [ring.material for ring in RINGS]
    images_ihwc = np.empty((lights, size, size, 3), dtype=dtype)
    step = max(1, _BAND_SAMPLES // (size * SUBSAMPLES**2))
    bands = [range(top, min(top + step, size)) for top in range(0, size, step)]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for n_band, rows in enumerate(bands):
            samples = tracer.see(CAMERA, size, rows)
            albedo_s3 = sample_albedo(samples, seed)

            def render_light(index: int) -> None:
                pixels_p3 = shade_pixels(tracer, samples, albedo_s3, materials, directions_i3[index])  # noqa: B023
                values_hwc = expose(pixels_p3, images_ihwc.dtype).reshape(-1, size, 3)
                images_ihwc[index, rows.start : rows.stop] = values_hwc  # noqa: B023

            for done, _ in enumerate(pool.map(render_light, range(lights)), start=1):
                if progress is not None:
                    progress(n_band * lights + done, len(bands) * lights)
    peak = 255.0 if dtype == "uint8" else 1.0
    return LightStack(images_ihwc, directions_i3, peak=peak, transfer="linear", name="ring")


def sample_albedo(samples: Samples, seed: int) -> NDArray[np.float32]:
    """Return each sample's diffuse reflectance, shape (n_sample, 3): the tiles' on the ground, else the ring's."""
    albedo_s3 = np.empty(samples.points_s3.shape, dtype=np.float32)
    on_ground_s = samples.owner_s == GROUND
    albedo_s3[on_ground_s] = tile_albedo(samples.points_s3[on_ground_s, :2].astype(np.float64), seed)
    for index, ring in enumerate(RINGS):
        albedo_s3[samples.owner_s == index] = ring.material.diffuse
    return albedo_s3


def expose(pixels_p3: NDArray[np.float32], dtype: np.dtype) -> NDArray:
    """Scale radiance times pi to code values of `dtype`; integers are clipped to their range and rounded."""
    values_p3 = np.float32(EXPOSURE) * pixels_p3
    if np.issubdtype(dtype, np.integer):
        return np.rint(np.clip(values_p3, 0.0, 1.0) * np.float32(np.iinfo(dtype).max)).astype(dtype)
    return values_p3.astype(dtype)
