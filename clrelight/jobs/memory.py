"""What a process has held in memory, and what the system has to spare."""

from __future__ import annotations

import sys
from pathlib import Path


def peak_memory() -> int | None:
    """Return the most bytes that this process has had resident; None where the system does not say."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return 1024 * int(next(line.split()[1] for line in lines if line.startswith("VmHWM:")))
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:  # Windows
        return None
    # Elsewhere than on Linux; there it would count what the starting process had.
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


SPARE_SHARE = 4
"""Photographs that take this part of the memory to spare, or less, are held there."""
_GROUPS = Path("/sys/fs/cgroup")


def spare_memory() -> int:
    """Return the bytes that nobody needs, as the system and this process's control groups see it; 0 if nobody says."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        spare = 1024 * int(next(line.split()[1] for line in lines if line.startswith("MemAvailable:")))
        named = [line.split(":", 2) for line in Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines()]
    except (OSError, StopIteration, ValueError):
        return 0
    left: list[float] = [spare]
    for _, controllers, path in named:
        if not controllers:
            left.append(_left_in(_GROUPS, path, "memory.max", "memory.current", "inactive_file"))
        elif "memory" in controllers.split(","):
            names = "memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file"
            left.append(_left_in(_GROUPS / "memory", path, *names))
    return max(int(min(left)), 0)


def _left_in(root: Path, path: str, limit: str, usage: str, unused: str) -> float:
    """Return the least that a control group, or one above it, leaves: what files have in caches can go."""
    left, group = float("inf"), root / path.lstrip("/")
    for each in (group, *group.parents):
        try:
            most = (each / limit).read_text(encoding="ascii").strip()
            if most != "max":
                stat = dict(line.split() for line in (each / "memory.stat").read_text(encoding="ascii").splitlines())
                left = min(left, int(most) - int((each / usage).read_text(encoding="ascii")) + int(stat[unused]))
        except (OSError, KeyError, ValueError):
            pass  # a group without limits, or one that is seen from outside only
        if each == root:
            break
    return left
