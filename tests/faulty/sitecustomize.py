"""Loaded by every Python process of a test that puts this folder on its path: tasks with some names do harm.

``CLRELIGHT_FAULTS`` is a JSON object of patterns of names and what befalls tasks that match: ``kill`` ends the process
by SIGKILL, ``once`` the first time only, ``hang`` sleeps, ``slow`` works for a second, ``bug`` raises.

``CLRELIGHT_CLOCK`` sets the clock each time that somebody looks at it: so many seconds forward, and then back again.
"""

import fnmatch
import importlib.machinery
import itertools
import json
import os
import signal
import sys
import time
from pathlib import Path

FAULTS = json.loads(os.environ.get("CLRELIGHT_FAULTS", "{}"))


def harm(task, fault):
    if fault == "once":
        try:
            os.close(os.open(Path(task.out).with_suffix(".once"), os.O_CREAT | os.O_EXCL))
        except FileExistsError:
            return
    if fault in ("kill", "once"):
        os.kill(os.getpid(), signal.SIGKILL)
    if fault in ("hang", "slow"):
        time.sleep(3600 if fault == "hang" else 1.0)
    if fault == "bug":
        raise ZeroDivisionError("nobody expects this")


class Loader(importlib.machinery.SourceFileLoader):
    """Loads the module that does tasks, and has it look for harm first."""

    def exec_module(self, module):
        super().exec_module(module)
        work = module._work

        def faulty(task, *rest):
            for pattern, fault in FAULTS.items():
                if fnmatch.fnmatchcase(task.name, pattern):
                    harm(task, fault)
            return work(task, *rest)

        module._work = faulty


class Finder:
    """Not an import of the module here: drivers must not load NumPy before they watch signals."""

    def find_spec(self, name, path, target=None):
        if name != "clrelight.batch.perform":
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        spec.loader = Loader(spec.loader.name, spec.loader.path)
        return spec


def set_clock(seconds):
    looks = itertools.count()
    for name, unit in (("time", 1.0), ("time_ns", 10**9)):
        now = getattr(time, name)
        setattr(time, name, lambda now=now, unit=unit: now() + (next(looks) % 2) * type(unit)(seconds * unit))


if os.environ.get("CLRELIGHT_CLOCK"):
    set_clock(float(os.environ["CLRELIGHT_CLOCK"]))
if FAULTS:
    sys.meta_path.insert(0, Finder())
