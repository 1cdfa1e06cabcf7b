"""Small stacks, and batches of them in processes that can be watched and ended."""

import json
import os
import subprocess
import time
from pathlib import Path

import numpy as np

from clrelight.dataset import LightStack
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests.commands import ROOT, command_line, environment

FAULTY = Path(__file__).parent / "faulty"
FIT = ("--job", "fit", "--set", "degree=1", "--set", "measure=false")


def make_stacks(folder, names, shape=(6, 5, 3), n_light=9):
    """Write a stack of noise for each name."""
    folder.mkdir(parents=True, exist_ok=True)
    directions = make_pattern("uniform", n_light)
    for seed, name in enumerate(names):
        images = np.random.default_rng(seed).integers(0, 256, (n_light, *shape), np.uint8)
        (folder / name).parent.mkdir(exist_ok=True)
        write_stack(folder / f"{name}.h5", LightStack(images, directions, 255.0, name="s"))
    return folder


def faulty_environment(faults=None, **changes):
    path = os.pathsep.join([str(FAULTY), str(ROOT)])
    return environment(**{"PYTHONPATH": path, "CLRELIGHT_FAULTS": json.dumps(faults or {}), **changes})


def start_batch(*words, faults=None, **changes):
    """Begin a batch in a process of its own, in whose environment tasks may do harm."""
    return subprocess.Popen(
        command_line("batch", *words),
        env=faulty_environment(faults, **changes),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish_batch(*words, faults=None, **changes):
    """Run a batch; return exit code, output and complaints."""
    started = start_batch(*words, faults=faults, **changes)
    out, complaint = started.communicate(timeout=120)
    return started.returncode, out, complaint


def children_of(process):
    """Return the processes that have this one above them."""
    above = {}
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            try:
                above[int(entry.name)] = int(Path(entry.path, "stat").read_text().rpartition(")")[2].split()[1])
            except OSError:
                continue
    found, more = set(), {process.pid}
    while more:
        more = {child for child, parent in above.items() if parent in more} - found
        found |= more
    return found


def are_gone(processes, seconds):
    """Return whether all of them end within some seconds."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if not any(_is_alive(each) for each in processes):
            return True
        time.sleep(0.05)
    return False


def _is_alive(process):
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def await_line(path, text, seconds=60):
    """Return when a file holds a text."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if path.exists() and text in path.read_text(errors="replace"):
            return
        time.sleep(0.01)
    raise AssertionError(f"{path} does not hold {text}")


def results_in(folder):
    """Return the bytes of all results, by name."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in (".h5", ".exr", ".png")}


def strays_in(folder):
    """Return what nobody is to find in a folder or beside it."""
    beside = [entry for entry in os.listdir(folder.parent) if entry.startswith(f".{folder.name}.")]
    return sorted([entry for entry in os.listdir(folder) if entry.startswith(".")] + beside)
