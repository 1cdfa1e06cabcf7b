"""A process that measures one thing and prints it as JSON: ``python -m clrelight.speed.child TASK``.

Each point of a growth has a process of its own, so that its memory is its own, and so that threads can be limited.
"""

from __future__ import annotations

import importlib.metadata
import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.speed.environment import describe_environment
from clrelight.speed.job import measure_point
from clrelight.speed.peak import copy_run, peak_run
from clrelight.speed.peer_stages import missing_peers, peer_stages
from clrelight.speed.stage import measure
from clrelight.speed.timing import interleave


def measure_machine(
    stack: str, *, degree: int, rounds: int, settle_seconds: float, device: str | None
) -> dict[str, Any]:
    """Return the environment, what the machine can do at most, and the stages beside other libraries."""
    opened = open_device(device)
    facts = describe_environment(opened)
    (multiply_add, flops), (copy, copied) = peak_run(opened), copy_run()
    runs = {"multiply-add": multiply_add, "copy": copy}
    timings = interleave(runs, finish=opened.finish, rounds=rounds, settle_seconds=settle_seconds)
    if not missing_peers():
        facts["versions"] += f", PyWavelets {importlib.metadata.version('PyWavelets')}"
    facts["peak"] = (
        f"{flops / timings.time('multiply-add')[1] / 1e9:.0f} GFLOP/s of multiply-adds on the device, "
        f"{copied / timings.time('copy')[1] / 1e9:.1f} GB/s of a NumPy copy (read and written)"
    )
    rows = [
        asdict(measure(stage, opened, rounds=rounds, settle_seconds=settle_seconds))
        for stage in peer_stages(Path(stack), degree, opened)
    ]
    return {"environment": facts, "stages": rows, "notes": missing_peers()}


def main() -> None:
    """Do the task that the only argument describes, an object with ``kind`` and the parameters of its function."""
    task = json.loads(sys.argv[1])
    kind = task.pop("kind")
    if kind == "machine":
        result = measure_machine(**task)
    else:
        stack, folder = Path(task.pop("stack")), Path(task.pop("folder"))
        result = measure_point(stack, folder, ways=tuple(task.pop("ways")), **task)
    print(json.dumps(result))


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
