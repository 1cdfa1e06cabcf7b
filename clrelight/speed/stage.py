"""One stage: our way and a peer's of doing the same work, and the row of the table that measuring them gives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from clrelight.device import Device
from clrelight.speed.peak import peak_run
from clrelight.speed.timing import SETTLE_SECONDS, Quartiles, interleave

SLOW_SECONDS = 8.0
"""A stage that would take longer than this in all its rounds gets fewer of them."""


@dataclass(frozen=True)
class Stage:
    """Work to be timed.

    Attributes
    ----------
    name : str
        What is timed.
    peer : str
        What it is timed beside.
    ours, theirs : callable
        Do the work once, from inputs that are ready.
    errors : callable
        Return our error and the peer's (None where the peer computes something else) against float64; called once,
        apart from the timing.
    error_unit : str
        What the errors are.
    flops : float, optional
        Floating-point operations of the work, where it is made of little else.
    goal : float, optional
        Speed beside the peer that the project asks for.
    peer_share : float
        Part of the work that a slow peer does; its time is divided by it.
    """

    name: str
    peer: str
    ours: Callable[[], object]
    theirs: Callable[[], object]
    errors: Callable[[], tuple[float, float | None]]
    error_unit: str
    flops: float | None = None
    goal: float | None = None
    peer_share: float = 1.0


@dataclass(frozen=True)
class Row:
    """What a stage took. Times are quartiles in seconds; speed is the peer's time over ours, round by round."""

    name: str
    peer: str
    rounds: int
    first_seconds: float
    our_seconds: Quartiles
    peer_seconds: Quartiles
    speed: Quartiles
    goal: float | None
    gigaflops: float | None
    peak_share: float | None
    error: float
    peer_error: float | None
    error_unit: str


def measure(stage: Stage, device: Device, *, rounds: int, settle_seconds: float = SETTLE_SECONDS) -> Row:
    """Time a stage in turns with its peer, and with the device's multiply-add peak where it counts operations."""
    runs = {"ours": stage.ours, "peer": stage.theirs}
    gigaflops = peak_share = None
    if stage.flops is not None:
        runs["peak"], peak_flops = peak_run(device)
    timings = interleave(
        runs, finish=device.finish, rounds=rounds, most_seconds=SLOW_SECONDS, settle_seconds=settle_seconds
    )
    timings.seconds["peer"][:] /= stage.peer_share
    if stage.flops is not None:
        gigaflops = stage.flops / timings.time("ours")[1] / 1e9
        peak_share = timings.speed("ours", "peak")[1] * stage.flops / peak_flops
    error, peer_error = stage.errors()
    return Row(
        stage.name,
        stage.peer,
        len(timings.seconds["ours"]),
        timings.first["ours"],
        timings.time("ours"),
        timings.time("peer"),
        timings.speed("ours", "peer"),
        stage.goal,
        gigaflops,
        peak_share,
        float(error),
        None if peer_error is None else float(peer_error),
        stage.error_unit,
    )
