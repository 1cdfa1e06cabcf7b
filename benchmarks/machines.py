"""The selftest under every processor that a driver can be told, every way to make work-groups, and few threads.

``python -m benchmarks.machines [--full]`` runs the statements of the quick selftest and of
`clrelight.selftest_surfaces` (``--full``: all of ``clrelight selftest``) in a process for each row, which starts
without compiled kernels. A name with features that this processor lacks is left out. ``--drivers`` tries all devices
in place of the default one, such as a PoCL of the system beside that of the Python package index.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor

from clrelight.opencl.devices import loaded_devices
from clrelight.opencl.processor import PROCESSOR_VARIABLE, processor_features

PROCESSORS = {
    "x86-64": "sse2",
    "core2": "ssse3",
    "nehalem": "sse4_2",
    "sandybridge": "avx",
    "haswell": "avx2 fma bmi2",
    "znver2": "avx2 fma bmi2 clwb",
    "znver3": "avx2 fma bmi2 vaes",
    "skylake-avx512": "avx512vl avx512dq clwb",
    "cascadelake": "avx512_vnni",
    "icelake-server": "avx512_vbmi2 avx512_vpopcntdq",
    "sapphirerapids": "avx512_vbmi2 avx512_bf16 avx512_fp16 amx_tile",
}
"""Names of LLVM 14, and features in Linux's words that tell whether code for them runs here."""
_WORK_GROUPS = "POCL_WORK_GROUP_METHOD"
_THREADS = "POCL_MAX_PTHREAD_COUNT"

_JOB = """
import json, sys
from clrelight.device import make_device
from clrelight.selftest import run_quick_selftest, run_selftest
from clrelight.selftest_surfaces import check_surfaces
device = make_device(sys.argv[1], style=sys.argv[2] or None)
parts = [run_selftest] if sys.argv[3] == "full" else [run_quick_selftest, check_surfaces]
said = []
for part in parts:
    for s in part(device):
        said.append([s.part, s.case, s.what, s.figure / s.limit if s.limit else s.figure, s.holds])
print(json.dumps({"device": device.info.label, "said": said}))
"""


def rows_of(device: str) -> list[tuple[str, str, str, dict[str, str]]]:
    """Return name, device with lanes, style and variables of each row."""
    here = processor_features()
    able = {name: needed for name, needed in PROCESSORS.items() if set(needed.split()) <= here}
    rows = [(name, f"{device}@{_lanes(needed)}", "", {PROCESSOR_VARIABLE: name}) for name, needed in able.items()]
    rows += [(f"{_WORK_GROUPS}={way}", f"{device}@8", "", {_WORK_GROUPS: way}) for way in ("loops", "loopvec", "cbs")]
    rows += [(f"{_THREADS}={count}", f"{device}@8", "", {_THREADS: count}) for count in ("1", "2", "7")]
    rows += [("kernels of GPUs", f"{device}@8", "gpu", {})]
    return rows


def _lanes(features: str) -> int:
    return 16 if "avx512" in features else 8 if "avx" in features else 4


def main() -> None:
    """Run all rows, some beside each other, and print them as they come."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--drivers", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="", help="rows whose name has one of these words in it, with commas between")
    asked = parser.parse_args()
    devices = [str(info.index) for info, _ in loaded_devices()] if asked.drivers else [""]
    words = asked.only.split(",")
    rows = [row for device in devices for row in rows_of(device) if any(word in row[0] for word in words)]
    wrong = 0
    print("| told | device | statements | hold | nearest to its limit |\n| --- | --- | ---: | ---: | --- |", flush=True)
    with ThreadPoolExecutor(asked.jobs) as pool:
        for line, missed in pool.map(lambda row: _run(*row, "full" if asked.full else "quick"), rows):
            print(line, flush=True)
            wrong += missed
    if wrong:
        sys.exit(f"{wrong} rows have statements that do not hold")


def _run(name: str, device: str, style: str, variables: dict[str, str], size: str) -> tuple[str, int]:
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, **variables, "CLRELIGHT_CACHE": folder}
        words = [sys.executable, "-c", _JOB, device, style, size]
        ended = subprocess.run(words, env=environment, capture_output=True, text=True)
    if ended.returncode != 0:
        last = (ended.stderr.strip().splitlines() or ["without a word"])[-1]
        return f"| {name} | {device} | | | exit code {ended.returncode}: {last} |", 1
    told = json.loads(ended.stdout.splitlines()[-1])
    said = told["said"]
    held = sum(holds for *_, holds in said)
    part, case, what, share, _ = max(said, key=lambda each: (not each[4], each[3]))
    near = f"{part}, {case}: {what}, {share:.2g} of it"
    return f"| {name} | {told['device']} | {len(said)} | {held} | {near} |", int(held < len(said))


if __name__ == "__main__":
    main()
