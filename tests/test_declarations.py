"""Programs are built with the declarations of what they call alone: that changes nothing but the time."""

import re

import pytest

from clrelight import kernel_source
from clrelight.device import open_device
from clrelight.errors import KernelBuildError
from clrelight.kernel_source import read_kernel_source
from clrelight.opencl import declarations, kernel_cache
from clrelight.opencl.declarations import GUARD, declare_called

PASTED = """
#define CALL(begin, end) begin##end
__kernel void call_p(__global float *out_p, const int size_p)
{
    const int p = get_global_id(0);
    out_p[p] = CALL(hyp, ot)(3.0f * p, 4.0f * p);
}
"""


@pytest.fixture
def opened():
    device = open_device()
    if not device.info.packaged or kernel_cache._run_folder is None:
        pytest.skip("of the packaged PoCL, in a folder of ours")
    return device


def functions_called(device, source, options):
    """Return the names of functions, which tell their arguments' types, in the bitcode of a new program."""
    before = kernel_cache._program_folders()
    device._cl.Program(device._context, source).build(options, cache_dir=False)
    (made,) = kernel_cache._program_folders() - before
    return re.findall(rb"_Z\d+[A-Za-z_0-9]+", (kernel_cache._run_folder / made / "program.bc").read_bytes())


@pytest.mark.parametrize(
    ("file", "defines"),
    [("codec/half.cl", {"VECTORS": 5, "CLAMP": 1}), ("lighting/irradiance.cl", {"VECTOR": 8, "CHANNELS": 1, "RUN": 8})],
)
def test_the_same_functions_are_called_as_with_the_whole_header(opened, file, defines):
    source, options = read_kernel_source(file), ["-cl-std=CL1.2", *(f"-D{k}={v}" for k, v in defines.items())]
    called = functions_called(opened, source, options)
    assert any(b"get_global_id" in name for name in called)
    assert functions_called(opened, declare_called(source) + source, [*options, f"-D{GUARD}"]) == called


@pytest.fixture
def own_kernel(tmp_path, monkeypatch):
    """Give a kernel file of the test to the devices."""
    monkeypatch.setattr(kernel_source, "kernel_folder", lambda: tmp_path)
    read_kernel_source.cache_clear()
    yield lambda name, text: (tmp_path / name).write_text(text)
    read_kernel_source.cache_clear()


def test_a_name_that_a_macro_puts_together_is_found_in_the_whole_header(opened, own_kernel):
    assert "hypot" not in declare_called(PASTED)
    own_kernel("pasted.cl", PASTED)
    with pytest.raises(AssertionError, match=r"pasted\.cl calls a function whose name it does not spell"):
        opened._program("pasted.cl", {})  # of ours none is to: the driver complains before (conftest.py)


def test_what_does_not_build_is_told_of_the_source_alone(opened, own_kernel):
    own_kernel("wrong.cl", PASTED.replace("hyp", "hop"))
    with pytest.raises(KernelBuildError, match=r"wrong.cl:6:\d+ .*hopot") as told:
        opened._program("wrong.cl", {})
    assert GUARD not in str(told.value)


HEADER = """//===--- a header
#ifndef _OPENCL_H_
#define _OPENCL_H_
#define __ovld __attribute__((overloadable))
#include "opencl-c-base.h"
/* float wrong(float); */
float __ovld sin(float x); // and float wrong(float);
#if defined(two) || \\
    defined(three)
double __ovld sin(double x);
double __ovld cos(
    double x);
#endif
__attribute__((overloadable)) int odd(int);
int printf(__constant const char *st, ...) __attribute__((format(printf, 1, 2)));
void __ovld barrier(int flags) __conv;
#endif
"""


@pytest.fixture
def header(tmp_path, monkeypatch):
    """Have the driver's headers in a folder of the test."""
    folder = tmp_path / "package" / declarations._FOLDER
    folder.mkdir(parents=True)
    monkeypatch.setattr(declarations, "package_folders", lambda: (tmp_path / "none", tmp_path / "package"))
    (folder / "opencl-c-base.h").write_text("typedef float real;\n")
    declarations._read_header.cache_clear()
    yield folder / "opencl-c.h"
    declarations._read_header.cache_clear()


def test_of_a_function_all_forms_are_declared_and_of_others_none(header):
    header.write_text(HEADER)
    lines = declare_called("y = sin(x); barrier(1);").splitlines()
    kept = [*HEADER.splitlines()[:4], "typedef float real;", "float __ovld sin(float x); "]
    kept += [*HEADER.splitlines()[7:10], "#endif", "__attribute__((overloadable)) int odd(int);"]
    assert [line for line in lines if line] == [
        f"#undef {GUARD}",
        *kept,
        "void __ovld barrier(int flags) __conv;",
        "#endif",
    ]
    other = declare_called("cos(printf)")
    assert "cos(\n    double x);\n" in other
    assert "printf(" in other
    assert "sin" not in other


@pytest.mark.parametrize("text", [None, "float sin(float);\n", HEADER.replace(GUARD, "_OTHER_H_")])
def test_another_header_is_read_by_the_driver(header, text):
    if text is not None:
        header.write_text(text)
    assert declare_called("sin(x)") is None
