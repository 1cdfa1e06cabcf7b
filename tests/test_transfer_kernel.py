"""The sRGB curve of the kernels, against float64."""

import shutil

import numpy as np
import pytest

from clrelight import kernel_source
from clrelight.kernel_source import kernel_folder, read_kernel_source
from tests.reference import psnr
from tests.styles import every_width

KERNEL = """
#include "common/vector.clh"
#include "common/transfer.clh"

__kernel void encode_lanes_p(__global float *out_p, __global const float *in_p, const int size_p)
{
    const int start = get_global_id(0) * VECTOR;
    vecf value = 0.0f;
    for (int lane = 0; lane < VECTOR; lane++)
        if (start + lane < size_p) ((float *)&value)[lane] = in_p[start + lane];
    value = encode_srgb(value);
    for (int lane = 0; lane < VECTOR; lane++)
        if (start + lane < size_p) out_p[start + lane] = ((float *)&value)[lane];
}

__kernel void encode_each_p(__global float *out_p, __global const float *in_p, const int size_p)
{
    const int p = get_global_id(0);
    if (p < size_p) out_p[p] = encode_srgb(in_p[p]);
}
"""
ONE = 0x3F800000
"""The bits of 1.0: floats from 0 to 1 are the integers up to it."""


def some_of_every_octave():
    """Return floats of [0, 1]: evenly spread ones, the same number of every octave and subnormals, and the break."""
    bits = np.concatenate([np.arange(0, ONE, 4099), np.arange(16), np.arange(ONE - 16, ONE + 1)]).astype(np.uint32)
    near = (np.float32(0.0031308).view(np.uint32) + np.arange(-64, 65)).astype(np.uint32)
    return np.concatenate([bits.view(np.float32), near.view(np.float32), np.linspace(0, 1, 200_003)])


@pytest.fixture
def encode(tmp_path, monkeypatch, device):
    """Return what encodes an array by a kernel of the test's own, on the folder of the kernels' common files."""
    shutil.copytree(kernel_folder() / "common", tmp_path / "common")
    (tmp_path / "curve.cl").write_text(KERNEL)
    monkeypatch.setattr(kernel_source, "kernel_folder", lambda: tmp_path)
    read_kernel_source.cache_clear()

    def encode(kernel, values):
        source = device.upload(np.asarray(values, np.float32))
        out = device.empty(source.shape, np.float32)
        defines = {"VECTOR": device.info.lanes, "REAL_BITS": 32}
        device.launch("curve.cl", kernel, source.shape, out, source, len(values), defines=defines)
        return device.download(out)

    yield encode
    read_kernel_source.cache_clear()


@every_width
@pytest.mark.parametrize("kernel", ["encode_lanes_p", "encode_each_p"])
def test_the_curve_is_that_of_float64(encode, kernel):
    values = some_of_every_octave().astype(np.float32)
    exact = psnr.encode(values.astype(np.float64))
    found = encode(kernel, values)
    np.testing.assert_allclose(found, exact, rtol=0, atol=3e-7)
    assert found.min() >= 0
    assert found.max() <= 1


@every_width
@pytest.mark.parametrize("kernel", ["encode_lanes_p", "encode_each_p"])
def test_the_curve_s_ends_are_exact_and_nan_stays(encode, kernel):
    found = encode(kernel, [0.0, 1.0, np.nan, 0.5, np.nan])
    np.testing.assert_array_equal(found[[0, 1]], [0, 1])
    np.testing.assert_array_equal(np.isnan(found), [False, False, True, False, True])


@every_width
@pytest.mark.parametrize("kernel", ["encode_lanes_p", "encode_each_p"])
def test_every_code_value_of_16_bits_comes_back(encode, kernel):
    codes = np.arange(65536)
    found = encode(kernel, psnr.decode(codes / 65535.0))
    np.testing.assert_array_equal(np.rint(found * 65535.0), codes)
