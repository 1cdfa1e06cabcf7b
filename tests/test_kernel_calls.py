"""Every program that any test builds is looked at (conftest.py); here: that looking finds what it should."""

import pytest

from clrelight import kernel_source
from clrelight.kernel_source import read_kernel_source
from clrelight.opencl import kernel_cache
from tests.calls import find_long_calls

CALLS = """
__kernel void call_p(__global float *out_p, __global const float *source_p, const int size_p)
{
    const int p = get_global_id(0);
    %s
}
"""


@pytest.mark.parametrize(
    "call",
    [
        "vstore8(sqrt(vload8(p, source_p)), p, out_p);",
        "vstore4(vload16(p, source_p).s048c, p, out_p);",
        "out_p[p] = fmax(convert_double4(vload4(p, source_p)), (double4)(1.0)).x;",
        "out_p[p] = any(vload8(p, source_p) > 1.0f);",
        "out_p[p] = convert_int8((float8)(source_p[p])).s3;",
    ],
)
def test_long_calls_are_found(tmp_path, monkeypatch, device, call):
    if "PoCL" not in device.info.version:
        pytest.skip("only PoCL shows what a program calls")
    if kernel_cache._run_folder is None:
        pytest.skip("POCL_CACHE_DIR is set: compiled files lie where the user wants them, not where they are looked at")
    file = f"call{abs(hash(call))}.cl"  # a device keeps its programs by their names
    (tmp_path / file).write_text("#pragma OPENCL EXTENSION cl_khr_fp64 : enable\n" + CALLS % call)
    monkeypatch.setattr(kernel_source, "kernel_folder", lambda: tmp_path)
    read_kernel_source.cache_clear()
    try:
        with pytest.raises(AssertionError, match=rf"{file} {{}} calls"):
            device._program(file, {})
    finally:
        read_kernel_source.cache_clear()


@pytest.mark.parametrize(
    ("names", "long"),
    [
        (b"_Z8_cl_sqrtDv4_f_Z8_cl_sqrtDv2_dllvm", False),
        (b"_Z13get_global_idj_Z7_cl_miniillvm", False),
        (b"_Z11_cl_vstore4Dv16_hmPU8CLglobalh", False),
        (b"_Z8_cl_sqrtDv8_fllvm", True),
        (b"_Z8_cl_sqrtDv16_f_Z13get_global_idj", True),
        (b"_Z7_cl_anyDv4_l", True),
        (b"_Z15_cl_convert_int8Dv8_h", True),
    ],
)
def test_names(names, long):
    assert bool(find_long_calls(names)) == long
