"""Run in a child: does a device compute, with so many lanes, what every job of ours needs? Numbers, not exit codes.

`main` prints one line of JSON: ``rate`` (billions of multiply-adds per second of a projection from 8-bit samples;
of a CPU per second of its processors), ``checks``, and ``wrong``, what does not hold.
"""

from __future__ import annotations

import json
import time

import numpy as np

from clrelight.device import Device, make_device
from clrelight.matmul import apply_operator, pack_operator, pad_columns

_ROWS, _LIGHTS, _COLUMNS = 49, 256, 16384
_LEAST_SECONDS = 0.1


def measure_rate(device: Device) -> float:
    """Return billions of multiply-adds per second of a projection, the best of several runs.

    Seconds of a CPU are those that its processors worked: on a busy machine those that pass say nothing of widths.
    """
    clock = time.process_time if device.shares_memory else time.perf_counter
    rng = np.random.default_rng(0)
    source = device.upload(rng.integers(0, 256, (_LIGHTS, _COLUMNS), dtype=np.uint8))
    operator = pack_operator(device, rng.standard_normal((_ROWS, _LIGHTS)))
    out = device.empty((_ROWS, pad_columns(_COLUMNS)), np.float32)
    apply_operator(device, operator, source, out)  # compiles
    device.finish()
    best, spent = np.inf, 0.0
    while spent < _LEAST_SECONDS:
        start = clock()
        apply_operator(device, operator, source, out)
        device.finish()
        last = clock() - start
        best, spent = min(best, last or best), spent + last  # processors' clocks of some systems tick slowly
    return _ROWS * _LIGHTS * _COLUMNS / best / 1e9


def main(words: list[str]) -> None:
    """Print what is asked for: index, lanes, style, and ``--rate`` for that alone."""
    index, lanes, style = words[:3]
    device = make_device(f"{index}@{lanes}", style=style)
    wrong: list[str] = []
    checks = 0
    if "--rate" not in words:
        from clrelight.selftest import run_quick_selftest

        for statement in run_quick_selftest(device):
            checks += 1
            if not statement.holds:
                wrong.append(f"{statement.part}, {statement.case}: {statement.what} {statement.figure:.1e}")
    print(json.dumps({"rate": measure_rate(device), "checks": checks, "wrong": wrong}))
