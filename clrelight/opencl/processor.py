"""Which processor PoCL compiles for: it is told a name that it knows where its LLVM is older than the processor.

PoCL picks its library of functions by the processor's features, and compiles our code for the processor's name, which
its LLVM guesses. What LLVM does not know is ``generic``, which its own compiler refuses; the name of an older relative
lacks features that the library was compiled with, so that both pass vectors in different registers. PoCL has no option
for it, so the name is set where its record of the device holds it; the device is tested by numbers as ever.
"""

from __future__ import annotations

import ctypes
import functools
import os
import struct
import sys
from pathlib import Path
from typing import Any

PROCESSOR_VARIABLE = "CLRELIGHT_PROCESSOR"
DRIVERS_OWN = "driver"
"""Value of the variable that leaves the driver's own name in place."""

_UNKNOWN = b"generic"
_WIDE = "skylake-avx512"
# Features as Linux writes them, and the name that PoCL's library for them was compiled with.
_LIBRARIES: tuple[tuple[set[str], str], ...] = (
    ({"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}, _WIDE),
    ({"avx2", "fma", "bmi1", "bmi2", "f16c", "movbe", "abm"}, "haswell"),
    ({"avx"}, "sandybridge"),
    ({"sse4_1"}, "penryn"),
    ({"ssse3"}, "core2"),
    (set(), "x86-64"),
)
_OLDER_WITHOUT_WIDE = (b"znver", b"bdver", b"btver")
"""How LLVM 14 names AMD processors, none of them with AVX-512."""

_RECORD_BYTES = 2048
_NEAR_WORDS = 5
_POINTER = struct.Struct("P")


def name_processor(device: Any, version: str, *, packaged: bool) -> str:
    """Tell PoCL a processor that it can compile for, where it would not by itself, or where the user names one.

    Parameters
    ----------
    device : pyopencl.Device
        Of any driver; those that are no PoCL on an x86-64 CPU are left alone.
    version : str
        Of its platform.
    packaged : bool
        Whether it is the PoCL of the Python package index, whose library is chosen by features.

    Returns
    -------
    str
        The name that it compiles for now; empty where it keeps its own.
    """
    wanted = os.environ.get(PROCESSOR_VARIABLE, "")
    if "PoCL" not in version or sys.platform != "linux" or wanted == DRIVERS_OWN:
        return ""
    found = _find_name(device.int_ptr, packaged=packaged)
    if found is None:
        return ""
    place, own = found
    if not wanted:
        fitting = fitting_name(processor_features())
        passed_over = packaged and fitting == _WIDE and own.startswith(_OLDER_WITHOUT_WIDE)
        wanted = fitting if own == _UNKNOWN or passed_over else ""
    if wanted and wanted.encode() != own:
        ctypes.c_void_p.from_address(place).value = _lasting_text(wanted)
    return wanted


def fitting_name(features: frozenset[str]) -> str:
    """Return the most able x86-64 processor that PoCL has a library for and that has no feature beyond these."""
    return next(name for needed, name in _LIBRARIES if needed <= features)


@functools.cache
def processor_features() -> frozenset[str]:
    """Return the features of this machine's processor in Linux's words; none where they cannot be read."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return frozenset()
    return frozenset(next((line.partition(":")[2].split() for line in lines if line.startswith("flags")), ()))


def _find_name(record: int, *, packaged: bool) -> tuple[int, bytes] | None:
    """Return where PoCL's record of a device points to the processor's name, and that name.

    The pointer comes after that to ``x86_64-...``, LLVM's name of the platform: in the packaged PoCL right after, in
    others where there is a name that needs another. Memory is read through the kernel, which refuses what is not
    mapped.
    """
    try:
        memory = os.open("/proc/self/mem", os.O_RDONLY)
    except OSError:
        return None
    try:
        words = [word for (word,) in _POINTER.iter_unpack(_read(memory, record, _RECORD_BYTES))]
        texts = [_read(memory, word, 48).partition(b"\0")[0] for word in words]
    finally:
        os.close(memory)
    for at, text in enumerate(texts):
        if text.startswith(b"x86_64-"):
            for near in range(at + 1, min(at + 1 + _NEAR_WORDS, len(texts))):
                if texts[near] == _UNKNOWN or texts[near].startswith(_OLDER_WITHOUT_WIDE):
                    return record + near * _POINTER.size, texts[near]
            return (record + (at + 1) * _POINTER.size, texts[at + 1]) if packaged and at + 1 < len(texts) else None
    return None


def _read(memory: int, address: int, count: int) -> bytes:
    try:
        content = os.pread(memory, count, address)
    except (OSError, OverflowError):
        return b""
    return content[: len(content) // _POINTER.size * _POINTER.size]


def _lasting_text(text: str) -> int:
    """Return the address of a copy that outlives Python: PoCL looks at it until the process ends."""
    copy = ctypes.CDLL(None).strdup
    copy.restype = ctypes.c_void_p
    return int(copy(text.encode()))
