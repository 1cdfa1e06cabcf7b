"""Stacks that several tests fit, and their samples and coefficients as float64 columns."""

import functools

import numpy as np

from clrelight.dataset import LightStack
from clrelight.sampling import make_pattern
from datasets_synth.ring import render_ring
from tests.reference.psnr import decode

BLACK, FLAT, VARYING = 0, 1, slice(2, None)
"""Columns of `make_stack`: 0 under every light, the same under every light, and all others."""


@functools.cache
def ring_stack():
    return render_ring(size=48, lights=256)


def make_samples(directions_i3, shape_hwc, seed=0):
    """Return samples (n_light, h, w, c) in [0, 1]: half shadowed, with highlights and noise, of all brightnesses."""
    rng = np.random.default_rng(seed)
    count = int(np.prod(shape_hwc))
    normals, mirrors = rng.standard_normal((2, 3, count))
    cosine = np.maximum(directions_i3 @ (normals / np.linalg.norm(normals, axis=0)), 0.0)
    highlight = np.exp(20.0 * (directions_i3 @ (mirrors / np.linalg.norm(mirrors, axis=0)) - 1.0))
    noise = rng.random((len(directions_i3), count))
    albedo, gloss, grain = rng.random((3, count)) ** np.array([[1.0], [3.0], [6.0]])
    sample_ip = 0.4 * albedo * cosine + 0.4 * gloss * highlight + 0.2 * grain * noise
    sample_ip *= 2.0 ** rng.integers(-7, 1, count)
    sample_ip[:, BLACK] = 0.0
    sample_ip[:, FLAT] = 0.5
    return sample_ip.reshape(len(directions_i3), *shape_hwc)


def make_stack(n_light=90, shape_hwc=(5, 61, 3), *, directions_i3=None, seed=0, weights_i=None, mask_hw=None):
    if directions_i3 is None:
        directions_i3 = make_pattern("uniform", n_light)
    images = make_samples(directions_i3, shape_hwc, seed).astype(np.float32)
    return LightStack(images, directions_i3, 1.0, weights_i=weights_i, mask_hw=mask_hw)


def samples_of(stack):
    """Return linear radiance (n_light, P), float64."""
    values = np.asarray(stack.images_ihwc[:], np.float64).reshape(stack.n_light, -1) / stack.peak
    return decode(values) if stack.transfer == "srgb" else values


def columns_of(fitted):
    """Return coefficients (n_coeff, P), float64."""
    return fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
