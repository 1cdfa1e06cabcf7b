"""What campaigns of random cases share: options, tallies of how cases ended, and bounds on a process."""

import faulthandler
import json
import resource
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import click


class Tally:
    """How many cases ended in each of some ways, the slowest of them, and those that failed."""

    def __init__(self, *ways):
        self.counts = dict.fromkeys(ways, 0)
        self.slowest_ms = 0.0
        self.failures = []

    def run(self, case, do, *, first):
        """Do a case, which returns the ways it ended in beside the `first`; an exception is a failure."""
        self.counts[first] += 1
        start = time.perf_counter()
        try:
            ways = do()
        except (Exception, SystemExit) as error:
            print(f"{case}: {error!r}", file=sys.stderr, flush=True)
            self.failures.append(f"{case}: {error!r}")
            return
        # What a case measures by itself it returns beside the ways.
        ways, seconds = ways if isinstance(ways, tuple) else (ways, time.perf_counter() - start)
        self.slowest_ms = max(self.slowest_ms, 1e3 * seconds)
        for way in ways:
            self.counts[way] += 1


def options(count, what):
    """Return a decorator that gives a command the options of a campaign of `count` cases."""
    every = [
        click.option("--count", type=click.IntRange(min=1), default=count, show_default=True, help=f"{what} in all."),
        click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True),
        click.option("--only", metavar="TEXT", default="", help="Only kinds whose name holds TEXT."),
        click.option("--first", type=click.IntRange(min=0), default=0, help="Number of the first case."),
    ]

    def decorate(command):
        for option in reversed(every):
            command = option(command)
        return command

    return decorate


def conclude(what, tallies):
    """Print one JSON object for each name and tally, as they come; exit 1 on a failure."""
    failed = False
    for name, tally in tallies:
        told = {what: name, **tally.counts, "slowest_ms": tally.slowest_ms, "failures": tally.failures}
        print(json.dumps(told), flush=True)
        failed |= bool(tally.failures)
    sys.exit(failed)


@contextmanager
def bounded(n_bytes, seconds):
    """Bound memory, so that an allocation fails, and time, so that the process ends with a traceback."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + n_bytes, before[1]))
    faulthandler.dump_traceback_later(seconds, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        resource.setrlimit(resource.RLIMIT_AS, before)
