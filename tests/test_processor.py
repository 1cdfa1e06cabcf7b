"""PoCL is told a processor that it can compile for, where its LLVM is older than the machine."""

import ctypes
import subprocess
import sys
from types import SimpleNamespace

import pytest

from clrelight.opencl import processor
from clrelight.opencl.devices import loaded_devices
from clrelight.opencl.processor import DRIVERS_OWN, PROCESSOR_VARIABLE, fitting_name, name_processor

POCL = "OpenCL 3.0 PoCL 3.0-rc2  Linux, LLVM 14.0.6"
NEHALEM = {"sse2", "ssse3", "sse4_1", "sse4_2", "popcnt"}
IVY_BRIDGE = NEHALEM | {"avx", "f16c"}
ZEN_3 = IVY_BRIDGE | {"avx2", "fma", "bmi1", "bmi2", "movbe", "abm"}
ZEN_4 = ZEN_3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "avx512_bf16"}
KNIGHTS_LANDING = ZEN_3 | {"avx512f", "avx512cd", "avx512er", "avx512pf"}


@pytest.mark.parametrize(
    ("features", "name"),
    [
        (ZEN_4, "skylake-avx512"),
        (KNIGHTS_LANDING, "haswell"),
        (ZEN_3, "haswell"),
        (IVY_BRIDGE, "sandybridge"),
        (NEHALEM, "penryn"),
        ({"sse2"}, "x86-64"),
        (set(), "x86-64"),
    ],
)
def test_a_name_has_no_feature_that_the_processor_lacks(features, name):
    assert fitting_name(frozenset(features)) == name


class Record:
    """What a driver keeps of a device: some words, and pointers to texts."""

    def __init__(self, *texts):
        self._texts = [ctypes.create_string_buffer(text.encode()) for text in texts]
        words = [7, 2**64 - 1, 4096, *map(ctypes.addressof, self._texts), 0, 3]
        self._words = (ctypes.c_uint64 * 512)(*words)
        self.device = SimpleNamespace(int_ptr=ctypes.addressof(self._words))

    def texts(self):
        return [ctypes.string_at(self._words[3 + at]).decode() for at in range(len(self._texts))]


@pytest.fixture
def zen_4(monkeypatch):
    if sys.platform != "linux":
        pytest.skip("memory is read through Linux's /proc")
    monkeypatch.delenv(PROCESSOR_VARIABLE, raising=False)
    monkeypatch.setattr(processor, "processor_features", lambda: frozenset(ZEN_4))


TRIPLE = "x86_64-unknown-linux-gnu"


@pytest.mark.parametrize(
    ("texts", "packaged", "said"),
    [
        ([TRIPLE, "generic"], True, "skylake-avx512"),
        ([TRIPLE, "generic"], False, "skylake-avx512"),
        ([TRIPLE, "kernel-lib", "/share", "generic"], False, "skylake-avx512"),
        ([TRIPLE, "znver3"], True, "skylake-avx512"),
        ([TRIPLE, "znver3"], False, ""),
        ([TRIPLE, "icelake-server"], True, ""),
        (["generic", TRIPLE, "icelake-server"], True, ""),
        (["aarch64-linux-gnu", "generic"], True, ""),
        ([], True, ""),
    ],
)
def test_only_a_name_that_does_not_fit_is_replaced(zen_4, texts, packaged, said):
    record = Record(*texts)
    assert name_processor(record.device, POCL, packaged=packaged) == said
    assert record.texts() == ([*texts[:-1], said] if said else texts)


def test_an_older_name_stays_where_its_library_fits(zen_4, monkeypatch):
    monkeypatch.setattr(processor, "processor_features", lambda: frozenset(ZEN_3))
    assert name_processor(Record(TRIPLE, "znver3").device, POCL, packaged=True) == ""
    assert name_processor(Record(TRIPLE, "generic").device, POCL, packaged=True) == "haswell"


def test_the_user_names_a_processor_or_keeps_the_drivers_own(zen_4, monkeypatch):
    record = Record(TRIPLE, "generic")
    monkeypatch.setenv(PROCESSOR_VARIABLE, DRIVERS_OWN)
    assert name_processor(record.device, POCL, packaged=True) == ""
    monkeypatch.setenv(PROCESSOR_VARIABLE, "znver2")
    assert name_processor(record.device, POCL, packaged=True) == "znver2"
    assert record.texts() == [TRIPLE, "znver2"]


def test_another_drivers_record_is_changed_at_a_name_only(zen_4, monkeypatch):
    """What comes behind the platform's name is something else there, a library's name for example."""
    monkeypatch.setenv(PROCESSOR_VARIABLE, "haswell")
    record = Record(TRIPLE, "kernel-library", "haswell")
    assert name_processor(record.device, POCL, packaged=False) == ""
    assert record.texts() == [TRIPLE, "kernel-library", "haswell"]
    assert name_processor(Record(TRIPLE, "kernel-library", "znver3").device, POCL, packaged=False) == "haswell"


@pytest.mark.parametrize("address", [0, 8, 2**47, 2**64 - 8])
def test_memory_that_is_not_there_is_not_touched(zen_4, address):
    assert name_processor(SimpleNamespace(int_ptr=address), POCL, packaged=True) == ""


def test_other_drivers_are_left_alone(zen_4):
    record = Record(TRIPLE, "generic")
    assert name_processor(record.device, "OpenCL 3.0 LINUX", packaged=False) == ""
    assert record.texts() == [TRIPLE, "generic"]


SUM = """
import numpy as np
from clrelight.device import make_device
from clrelight.matmul import apply_operator, pack_operator, pad_columns
device = make_device("{index}@4", style="cpu")
out = device.empty((2, pad_columns(5)), np.float32)
apply_operator(device, pack_operator(device, np.ones((2, 3))), device.upload(np.ones((3, 5), np.float32)), out)
print(device.info.processor, device.download(out)[0, :5].tolist())
"""


def run_told(name):
    packaged = [info for info, _ in loaded_devices() if info.packaged and info.kind == "cpu"]
    if sys.platform != "linux" or not packaged:
        pytest.skip("the PoCL of the Python package index is not installed")
    code = f"import os; os.environ[{PROCESSOR_VARIABLE!r}] = {name!r}\n{SUM.format(index=packaged[0].index)}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)


def test_the_packaged_driver_compiles_for_the_name():
    assert run_told("x86-64").stdout.split(maxsplit=1) == ["x86-64", "[3.0, 3.0, 3.0, 3.0, 3.0]\n"]


def test_the_packaged_driver_refuses_a_name_that_is_none():
    run = run_told("zx-spectrum")
    assert run.returncode != 0
    assert "unknown target CPU 'zx-spectrum'" in run.stderr
