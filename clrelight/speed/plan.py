"""Which points a run measures: pictures, lights, degrees and threads, one of them varied at a time."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, replace

from clrelight.errors import InputError
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.memory import DEFAULT_MEMORY
from clrelight.speed.timing import SETTLE_SECONDS

LARGEST_SIZE, MOST_LIGHTS, MOST_THREADS, MOST_ROUNDS = 1 << 14, 1 << 12, 1 << 10, 1000


@dataclass(frozen=True)
class Point:
    """One measured job: pixels along a side, lights, degree of the fit, and threads (None: as many as there are)."""

    size: int
    lights: int
    degree: int
    threads: int | None = None

    @property
    def columns(self) -> int:
        """Pixels, which is columns: the pictures are grey."""
        return self.size**2

    @property
    def label(self) -> str:
        """What a progress bar says."""
        threads = "" if self.threads is None else f", {self.threads} thread{'s' * (self.threads > 1)}"
        return f"{self.size} × {self.size}, {self.lights} lights, degree {self.degree}{threads}"


@dataclass(frozen=True)
class Growth:
    """The values of each axis, measured while all others are those of `base`.

    Attributes
    ----------
    size, lights, degree, threads : tuple of int
        Values of each axis; empty where it is not varied.
    base : Point
        What the other axes are meanwhile.
    rounds : int
        Runs of each job that count.
    settle_seconds : float
        Pause before each.
    """

    base: Point
    rounds: int
    settle_seconds: float = SETTLE_SECONDS
    size: tuple[int, ...] = ()
    lights: tuple[int, ...] = ()
    degree: tuple[int, ...] = ()
    threads: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        bounds = {
            "size": (1, LARGEST_SIZE),
            "lights": (1, MOST_LIGHTS),
            "degree": (0, MAX_DEGREE),
            "threads": (1, MOST_THREADS),
        }
        for axis, (least, most) in bounds.items():
            values = getattr(self, axis)
            bad = next((value for value in values if not least <= value <= most), None)
            if bad is not None:
                raise InputError(f"{PLURALS[axis]} must be {least} to {most}, got {bad}")
            if len(set(values)) < len(values):
                raise InputError(f"{PLURALS[axis]} must differ, got {','.join(map(str, values))}: one is there twice")
        if not 1 <= self.rounds <= MOST_ROUNDS:
            raise InputError(f"rounds must be 1 to {MOST_ROUNDS}, got {self.rounds}")

    def command(self, memory: int, device: str | None) -> str:
        """Return the command that measures this, with the memory and on the device that `measure_growth` is given."""
        axes = {PLURALS[axis]: ",".join(map(str, getattr(self, axis))) for axis in PLURALS}
        words = [f"--{name} {values}" for name, values in axes.items() if values]
        quick = ["--quick"] if self.base == quick_growth().base else []
        words += [f"--rounds {self.rounds}"]
        words += [f"--memory {memory}"] if memory != DEFAULT_MEMORY else []
        words += [f"--device {shlex.quote(device)}"] if device is not None else []
        return " ".join(["clrelight bench --speed", *quick, *words])

    def points(self) -> list[Point]:
        """Return all points, each once; those of one stack follow each other."""
        return sorted(set(self._points()) or {self.base}, key=lambda p: (p.size, p.lights, p.degree, p.threads or 0))

    def _points(self) -> Iterator[Point]:
        for axis in PLURALS:
            yield from (replace(self.base, **{axis: value}) for value in getattr(self, axis))


PLURALS = {"size": "sizes", "lights": "lights", "degree": "degrees", "threads": "threads"}
"""Axes, and what the command line calls their values."""


def _thread_counts() -> tuple[int, ...]:
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return tuple(2**i for i in range(cpus.bit_length()))


def full_growth() -> Growth:
    """Return what is measured by default: minutes of work."""
    return Growth(
        Point(256, 64, 4),
        5,
        size=(64, 128, 256, 512, 1024, 2048, 4096),
        lights=(16, 32, 64, 128, 256),
        degree=(2, 3, 4, 5, 6, 8),
        threads=_thread_counts(),
    )


def quick_growth() -> Growth:
    """Return small pictures and one round: shows that it works, not how fast."""
    return Growth(Point(16, 16, 2), 1, settle_seconds=0.0, size=(16, 32), lights=(16, 32), degree=(1, 2), threads=(1,))


def choose_growth(*, quick: bool, rounds: int | None, **axes: tuple[int, ...] | None) -> Growth:
    """Return the default growth, or only the axes that are given, with other values or rounds.

    Raises
    ------
    InputError
        If a value is out of bounds or there twice.
    """
    growth = quick_growth() if quick else full_growth()
    if any(values is not None for values in axes.values()):
        size, lights, degree, threads = (tuple(sorted(axes.get(axis) or ())) for axis in PLURALS)
        growth = replace(growth, size=size, lights=lights, degree=degree, threads=threads)
    return growth if rounds is None else replace(growth, rounds=rounds)
