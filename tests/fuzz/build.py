"""Compile kernels and harnesses by clang, with libFuzzer and its sanitisers."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from clrelight.kernel_source import read_kernel_source
from tests.fuzz import worlds

_HERE = Path(__file__).resolve().parent
_CHECKS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
_PLAIN = ["-O2", "-g", "-march=native", "-fno-omit-frame-pointer", f"-I{_HERE}", *_CHECKS]
_OPENCL = ["-x", "cl", "-cl-std=CL1.2", "-cl-no-stdinc", "-cl-mad-enable", "-Wno-psabi"]


@dataclass(frozen=True)
class Target:
    """A kernel file, the harness that calls it, and what both are compiled with."""

    kernels: str
    harness: str
    defines: dict[str, int] = field(default_factory=dict)
    largest_input: int = 1024
    """Bytes."""


TARGETS = {
    "units": Target("codec/units_decode.cl", "units.c"),
    "subbands": Target("codec/subbands.cl", "subbands.c"),
    "bc6h": Target("codec/bc6h.cl", "blocks.c", {"TARGET": 0, "CHANNELS": 3}),
    "bc6h of planes": Target("codec/bc6h.cl", "blocks.c", {"TARGET": 0, "CHANNELS": 1}),
    "s3tc": Target("codec/s3tc.cl", "blocks.c", {"TARGET": 1, "CHANNELS": 3, "LANES": 8}),
    "s3tc of planes": Target("codec/s3tc.cl", "blocks.c", {"TARGET": 1, "CHANNELS": 1, "LANES": 8}),
    "half": Target("codec/half.cl", "blocks.c", {"TARGET": 2, "CHANNELS": 1, "VECTORS": 128, "CLAMP": 0}),
    "uniform of 5 bits": Target(
        "codec/uniform.cl", "blocks.c", {"TARGET": 3, "CHANNELS": 1, "BITS": 5, "STRETCH": 512}
    ),
    "uniform of 11 bits": Target(
        "codec/uniform.cl", "blocks.c", {"TARGET": 3, "CHANNELS": 1, "BITS": 11, "STRETCH": 512}
    ),
}


class NoCompilerError(Exception):
    """Why nothing can be fuzzed here."""


@cache
def find_clang() -> str:
    """Return a clang that links fuzzers; NoCompilerError if there is none."""
    names = ["clang", *(f"clang-{version}" for version in range(22, 12, -1))]
    found = [path for path in map(shutil.which, names) if path]
    if not found:
        raise NoCompilerError("fuzzing needs clang with compiler-rt (Debian: apt-get install clang libclang-rt-14-dev)")
    nothing = "#include <stddef.h>\nint LLVMFuzzerTestOneInput(const unsigned char *b, size_t n) { return 0; }\n"
    for clang in found:
        command = [clang, "-x", "c", "-fsanitize=fuzzer,address,undefined", "-", "-o", "/dev/null"]
        done = subprocess.run(command, input=nothing, capture_output=True, text=True)
        if done.returncode == 0:
            return clang
    raise NoCompilerError(f"{found[0]} links no fuzzer (is compiler-rt there?): {done.stderr.strip().splitlines()[-1]}")


def build(name: str, folder: Path, edit: Callable[[str], str] = str) -> Path:
    """Compile a target in a folder, its kernels as `edit` changes them; return the fuzzer."""
    target, clang = TARGETS[name], find_clang()
    for header, text in worlds.headers(target.harness).items():
        (folder / header).write_text(text)
    kernels = folder / "kernels.cl"
    kernels.write_text('#include "opencl.clh"\n' + _with_gaps(edit(read_kernel_source(target.kernels))))
    defines = [f"-D{key}={value}" for key, value in target.defines.items()]
    resources = Path(_run(clang, "-print-resource-dir").strip()) / "include"
    cover = "-fsanitize-coverage=inline-8bit-counters,pc-table"  # comparisons of numbers tell a fuzzer nothing here
    _run(
        clang, *_OPENCL, *_PLAIN, cover, f"-I{resources}", *defines, "-c", str(kernels), "-o", str(folder / "kernels.o")
    )
    objects = [str(folder / "kernels.o")]
    for source in (target.harness, "host.c"):
        objects.append(str(folder / f"{source}.o"))
        _run(clang, *_PLAIN, f"-I{folder}", *defines, "-c", str(_HERE / source), "-o", objects[-1])
    fuzzer = folder / "fuzzer"
    _run(clang, *_CHECKS, "-fsanitize=fuzzer", *objects, "-lm", "-o", str(fuzzer))
    return fuzzer


def _run(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command)}\n{done.stderr}")
    return done.stdout


def _with_gaps(source: str) -> str:
    """Return a kernel source in which gaps that can be poisoned lie behind all members of work_t, if it is there."""
    found = re.search(r"typedef struct \{([^}]*)\} work_t;", source)
    if found is None:
        return source
    members = re.sub(r"/\*.*?\*/", "", found[1], flags=re.S)
    lines, gaps = [], 0
    for kind, names in re.findall(r"(\w+) ([^;]+);", members):
        for name in names.split(","):
            lines.append(f"    {kind} {name.strip()}; uchar gap_{gaps}[72] __attribute__((aligned(8)));")
            gaps += 1
    changes = "".join(f"    CHANGE(work->gap_{number});\n" for number in range(gaps))
    setter = f'#include "gaps.clh"\n{{\n    __global work_t *work = given;\n{changes}}}\n'
    return source.replace(found[0], "typedef struct {\n" + "\n".join(lines) + "\n} work_t;") + setter
