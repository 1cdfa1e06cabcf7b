"""Measure a growth, point by point, each in a process of its own."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import clrelight
from clrelight.durable import folder_aside
from clrelight.errors import InputError
from clrelight.harmonics.index import coefficient_count
from clrelight.interrupts import at_end, forget, holding
from clrelight.speed.environment import THREAD_VARIABLES
from clrelight.speed.job import NUMPY, OURS
from clrelight.speed.plan import PLURALS, Growth, Point
from clrelight.speed.scene import TILE, write_scene

NUMPY_BYTES = 1 << 30
"""NumPy, which holds all at once, runs where that takes no more than this."""

_DISK_MARGIN = 1.1

Progress = Callable[[int, int, str], None]


def measure_growth(
    growth: Growth, folder: Path, *, memory: int, device: str | None = None, progress: Progress | None = None
) -> dict[str, Any]:
    """Measure every point of a growth, and the stages beside other libraries.

    Parameters
    ----------
    growth : Growth
    folder : Path
        Where a folder for stacks and fits is made, and removed in the end.
    memory : int
        Bytes that a tile of our fits may take.
    device : str, optional
    progress : callable, optional
        Called with steps done, steps in all, and what is being done.

    Returns
    -------
    dict
        ``environment``, ``stages`` and ``notes`` of `child.measure_machine`; ``base`` and ``axes`` of the growth;
        ``points``: size, lights, degree and threads with the result of `job.measure_point`, ``memory`` by way, or
        with a ``note`` where a point could not be measured.

    Raises
    ------
    InputError
        If the disk is too small, or the device does not answer.
    """
    points = growth.points()
    _check_room(max(map(_disk_bytes, points)), folder)
    report = progress or (lambda done, total, what: None)
    steps = len(points) + 1
    with folder_aside(folder / "speed") as place:
        common = {"rounds": growth.rounds, "settle_seconds": growth.settle_seconds, "device": device}
        report(0, steps, "stages beside other libraries")
        stack = place / "stack.h5"
        write_scene(stack, growth.base.size, growth.base.lights)
        machine = run_child({"kind": "machine", "stack": str(stack), "degree": growth.base.degree, **common})
        machine["environment"] = {"command": growth.command(memory, device), **machine["environment"]}
        measured: list[dict[str, Any]] = []
        written = growth.base
        warm: set[tuple[int, int]] = set()
        for index, point in enumerate(points):
            report(index + 1, steps, point.label)
            task = {"kind": "point", "degree": point.degree, "memory": memory, **common}
            try:
                if (point.size, point.lights) != (written.size, written.lights):
                    write_scene(stack, point.size, point.lights)
                    written = point
                if (point.lights, point.degree) not in warm:
                    warm.add((point.lights, point.degree))
                    _warm_up(task, point, place)
                found = _measure(task, point, stack, place)
            except InputError as error:
                found = {"note": str(error)}
            measured.append({**asdict(point), **found})
    axes = {axis: list(getattr(growth, axis)) for axis in PLURALS}
    return {**machine, "base": asdict(growth.base), "axes": axes, "points": measured}


def _warm_up(task: Mapping[str, Any], point: Point, place: Path) -> None:
    """Leave kernels of these lights and this degree in the driver's cache: a compiler takes more memory than a fit."""
    small = place / "small.h5"
    write_scene(small, min(point.size, TILE), point.lights)
    run_child({**task, "stack": str(small), "folder": str(place), "ways": [OURS], "rounds": 1, "settle_seconds": 0.0})


def _measure(task: Mapping[str, Any], point: Point, stack: Path, place: Path) -> dict[str, Any]:
    fits = numpy_bytes(point) <= NUMPY_BYTES
    task = {**task, "stack": str(stack), "folder": str(place), "ways": [OURS, NUMPY] if fits else [OURS]}
    try:
        found = run_child(task, point.threads)
        found["memory"] = {OURS: found["memory"]}
        if fits:
            alone = run_child({**task, "ways": [NUMPY], "rounds": 1}, point.threads)
            found["memory"][NUMPY] = alone["memory"]
        return found
    finally:
        # A point that filled the disk must not leave it full to the next.
        for way in (OURS, NUMPY):
            shutil.rmtree(place / way, ignore_errors=True)


def run_child(task: Mapping[str, Any], threads: int | None = None) -> dict[str, Any]:
    """Run a task of `clrelight.speed.child` and return what it measured; InputError with its reason where it fails."""
    environment = dict(os.environ)
    # The child finds this very package, however this process found it.
    home = str(Path(clrelight.__file__).resolve().parents[1])
    environment["PYTHONPATH"] = os.pathsep.join(filter(None, (home, environment.get("PYTHONPATH"))))
    if threads is not None:
        environment.update(dict.fromkeys(THREAD_VARIABLES, str(threads)))
    child: subprocess.Popen[str] | None = None
    try:
        with holding():
            child = subprocess.Popen(
                [sys.executable, "-m", "clrelight.speed.child", json.dumps(task)],
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C is for this process, which ends the child
            )
            key = at_end(child.kill)
        out, complaints = child.communicate()
    finally:
        with holding():
            if child is not None:
                if child.poll() is None:
                    child.kill()
                    child.wait()
                forget(key)
    if child.returncode == -signal.SIGKILL:
        raise InputError("the process was killed: not enough memory")
    if child.returncode != 0:
        reason = complaints.strip().splitlines()[-1:] or [f"exit code {child.returncode}"]
        raise InputError(reason[0].removeprefix("clrelight: "))
    found: dict[str, Any] = json.loads(out)
    return found


def numpy_bytes(point: Point) -> int:
    """Return about how much NumPy holds at once: samples twice, components and coefficients."""
    return point.columns * (6 * point.lights + 12 * coefficient_count(point.degree))


def _disk_bytes(point: Point) -> int:
    """Return what the files of a point take: the stack, the fit, its halves, what they decode to, and lambda."""
    ours = 2 * point.lights + 10 * coefficient_count(point.degree) + 8
    numpys = 10 * coefficient_count(point.degree) if numpy_bytes(point) <= NUMPY_BYTES else 0
    return point.columns * (ours + numpys)


def _check_room(needed: int, folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if free < _DISK_MARGIN * needed:
        raise InputError(
            f"the largest picture needs {needed / 1e9:.1f} GB in {folder}, where {free / 1e9:.1f} GB are free: "
            "ask for smaller --sizes, or another place by --out"
        )
