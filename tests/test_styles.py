"""Kernels for CPUs and for GPUs must agree wherever they do the same arithmetic."""

import numpy as np
import pytest

from clrelight.codec import codec_class, decode, encode
from clrelight.codec.transforms.lifting import forward_transform, inverse_transform
from clrelight.device import open_device

# Around the 4 x 4 blocks, the vectors of 8, the groups of 128 and the stretches of 1024 and 4096 values, and a prime.
SHAPES = [(1, 1, 1, 1), (4, 5, 7, 3), (4, 8, 32, 1), (4, 3, 129, 3), (1, 1, 1023, 1), (1, 1, 1025, 1), (4, 64, 67, 1)]
CODECS = {"half": {}, "s3tc": {}, "uniform": {"bits": 5}}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("codec", CODECS)
def test_bytes_and_values_are_the_same(codec, shape):
    coeffs = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
    devices = [open_device(style=style) for style in ("cpu", "gpu")]
    encoded = [encode(coeffs, codec_class(codec).from_config(CODECS[codec]), device) for device in devices]
    assert encoded[0].body == encoded[1].body
    decoded = [decode(encoded[0], device) for device in devices]
    np.testing.assert_array_equal(*decoded)


@pytest.mark.parametrize("shape", SHAPES)
def test_wavelets_are_the_same(shape):
    coeffs = np.random.default_rng(2).standard_normal(shape).astype(np.float32)
    scale = np.ones(len(coeffs), np.float32)
    planes, back = [], []
    for style in ("cpu", "gpu"):
        device = open_device(style=style)
        bands = forward_transform(coeffs, scale, 3, device)
        planes.append(device.download(bands)[:, :, : shape[2]].copy())
        back.append(inverse_transform(bands, shape, scale, 3, device))
    np.testing.assert_array_equal(*planes)
    np.testing.assert_array_equal(*back)
