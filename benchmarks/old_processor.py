"""One small fit on a processor that this machine is not, under QEMU: does it run, and are its numbers the same?

``python -m benchmarks.old_processor [--cpu Nehalem] [--lanes 4] [--qemu qemu-x86_64]`` needs QEMU in user mode, in
Debian the package qemu-user. It takes minutes: every instruction of the driver's compiler is emulated. Lanes are
given, since the test of drivers would start a process of its own, which runs on the true processor.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

_LARGEST_DIFFERENCE = 1e-5
_JOB = """
import sys
import numpy as np
import clrelight as cr
from clrelight.device import open_device
from clrelight.sampling import make_pattern
rng = np.random.default_rng(0)
lights = make_pattern("uniform", 40)
images = np.maximum(np.einsum("ik,khwc->ihwc", lights, rng.standard_normal((3, 16, 16, 3))), 0).astype(np.float32)
fitted = cr.fit(cr.LightStack(images, lights, 1.0), "cls", degree=3, device=open_device(sys.argv[1]))
np.save(sys.argv[2], fitted.coeffs_khwc)
print(open_device(sys.argv[1]).info.label)
"""


def main() -> None:
    """Run the fit here and under QEMU, and compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cpu", default="Nehalem")
    parser.add_argument("--lanes", default="4")
    parser.add_argument("--qemu", default="qemu-x86_64")
    asked = parser.parse_args()
    emulator = shutil.which(asked.qemu)
    if emulator is None:
        sys.exit(f"there is no {asked.qemu} on PATH (Debian: apt install qemu-user)")
    with tempfile.TemporaryDirectory() as folder:
        here = _run([], f"@{asked.lanes}", Path(folder, "here"))
        there = _run([emulator, "-cpu", asked.cpu], f"@{asked.lanes}", Path(folder, "there"))
        pair = [np.load(Path(folder, name, "fit.npy")) for name in ("here", "there")]
    scale = float(np.abs(pair[0]).max())
    difference = float(np.abs(pair[0] - pair[1]).max()) / scale
    print(json.dumps({"here": here, "there": {"cpu": asked.cpu, **there}, "difference": difference}, indent=2))
    if not difference <= _LARGEST_DIFFERENCE:
        sys.exit(f"coefficients differ by {difference:.1e} of the largest, more than {_LARGEST_DIFFERENCE:.0e}")


def _run(prefix: list[str], device: str, folder: Path) -> dict[str, object]:
    folder.mkdir()
    # A cache of its own: kernels of the true processor are no use to another. OpenBLAS is told the emulated one, for it
    # takes some for others, with AVX.
    environment = {**os.environ, "CLRELIGHT_CACHE": str(folder)}
    if prefix:
        environment["OPENBLAS_CORETYPE"] = prefix[-1]
    start = time.perf_counter()
    words = [*prefix, sys.executable, "-c", _JOB, device, str(folder / "fit.npy")]
    ended = subprocess.run(words, env=environment, capture_output=True, text=True)
    if ended.returncode != 0:
        sys.exit(f"exit code {ended.returncode}: {ended.stderr.strip()[-2000:]}")
    return {"device": ended.stdout.strip(), "seconds": round(time.perf_counter() - start, 1)}


if __name__ == "__main__":
    main()
