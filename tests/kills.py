"""Commands ended by signals at any moment: their output is absent, old or new, but whole, and the next run works.

``python -m tests.kills --count 300 --seed 1`` ends that many commands. A case depends on the seed and its number alone,
so ``--first 123 --count 1`` repeats one, as far as the machine keeps time.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import click
import h5py
import numpy as np

from clrelight.dataset import LightStack
from clrelight.images import write_image
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests import campaign
from tests.campaign import Tally
from tests.commands import command_line, environment

OUT = "out.h5"
COMMANDS = {
    "fit": "fit {inputs}/stack.h5 out.h5 --degree 3",
    "encode": "encode {inputs}/fit.h5 out.h5 --codec s3tc",
    "decode": "decode {inputs}/encoded.h5 out.h5",
    "ingest": "ingest {inputs}/photos out.h5 --name photos",
    "pack": "pack {inputs}/photos out.h5 --method spline --degree 2 --bytes 8k",
    "bench": "bench {inputs}/stack.h5 --methods uls,cls --degrees 1,2 --codecs none,half --holdout 5 --out out.h5",
}
PREPARED = {
    "encode": ["fit stack.h5 fit.h5 --degree 3"],
    "decode": ["fit stack.h5 fit.h5 --degree 3", "encode fit.h5 encoded.h5 --codec half"],
    "bench": ["bench stack.h5 --methods uls --degrees 1 --codecs none --holdout 5 --out begun.h5"],
}
"""What makes their inputs."""
ROWS = 8
"""Of the bench."""
ENDINGS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up"}
WAYS = ("ended", "late", "absent", "old", "new", "twice")
"""What becomes of commands that a signal ends: too late for it, the file absent, old or new; of two signals."""
SIGNALS = ("SIGKILL", "SIGTERM", "SIGINT", "SIGHUP")
_SHARES = (0.35, 0.3, 0.25, 0.1)
NEAR_SECONDS = 0.01
"""How soon after a temporary file appears the signal comes, where it is to strike a write."""
_PATIENCE_SECONDS, _WARM_SECONDS = 120, 1.5
_LEFT_BY_KILL = (f".{OUT}.part", f".{OUT}.lock")


class Campaign:
    """Inputs, and what each command makes of them when nothing ends it."""

    def __init__(self, folder, only=""):
        self.inputs, self.place = folder / "inputs", folder / "place"
        (self.inputs / "photos").mkdir(parents=True)
        rng = np.random.default_rng(3)
        directions = make_pattern("uniform", 30)
        images = rng.integers(0, 256, (30, 24, 20, 3), np.uint8)
        write_stack(self.inputs / "stack.h5", LightStack(images, directions, 255.0, name="small"))
        lines = ["30", *(f"{i}.png {' '.join(map(str, each))}" for i, each in enumerate(directions))]
        (self.inputs / "photos" / "dome.lp").write_text("\n".join(lines))
        for i, image in enumerate(images):
            write_image(self.inputs / "photos" / f"{i}.png", image)
        self.commands = [command for command in COMMANDS if only in command]
        for command in self.commands:
            for words in PREPARED.get(command, ()):
                self._finish(words.split(), self.inputs)
        self.seconds, self.made = {}, {}
        for command in self.commands:
            for _ in range(2):
                since = time.monotonic()
                self._clear(None)
                self._finish(self.words(command), self.place)
                self.seconds[command] = time.monotonic() - since
                if self.seconds[command] < _WARM_SECONDS:
                    break  # else it has built kernels
            self.made[command] = (self.place / OUT).read_bytes()

    def words(self, command):
        return COMMANDS[command].format(inputs=self.inputs).split()

    def draw(self, number, seed):
        """Return what the rest of a case is drawn from, its command and its signal."""
        rng = np.random.default_rng([seed, number])
        return rng, str(rng.choice(self.commands)), str(rng.choice(SIGNALS, p=_SHARES))

    def run(self, number, seed):
        """End one command; return the ways it ended in, and the seconds; AssertionError where that must not be."""
        rng, command, name = self.draw(number, seed)
        old = self.inputs / ("begun.h5" if command == "bench" else "stack.h5") if rng.random() < 0.5 else None
        at_write = rng.random() < 0.5
        wait = NEAR_SECONDS * rng.random() if at_write else self.seconds[command] * rng.random()
        writes = int(rng.integers(1, ROWS)) if command == "bench" else 1
        again = NEAR_SECONDS * rng.random() if name != "SIGKILL" and rng.random() < 0.3 else None
        self._clear(old)
        before = None if old is None else old.read_bytes()
        started = subprocess.Popen(
            command_line(*self.words(command)),
            cwd=self.place,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            if at_write:
                self._await_write(started, writes)
            time.sleep(wait)
            if name != "SIGKILL":
                await_handlers(started)
            started.send_signal(signal.Signals[name])
            since = time.monotonic()
            if again is not None:
                time.sleep(again)
                started.send_signal(signal.Signals[name])
            _, complaint = started.communicate(timeout=_PATIENCE_SECONDS)
        finally:
            started.kill()
        ended = time.monotonic()
        self._check_end(name, started.returncode, complaint)
        ways = [self._check_files(name, command, before)]
        ways += ["late"] * (started.returncode == 0) + ["twice"] * (again is not None)
        self._finish(self.words(command), self.place)
        self._check_finished(command)
        return ways, ended - since

    def _check_end(self, name, code, complaint):
        number = signal.Signals[name].value
        if name == "SIGKILL":
            assert code in (0, -number), (code, complaint)
            return
        assert code in (0, 128 + number), (code, complaint)
        line = f"clrelight: {ENDINGS[name]}; files that were not finished are discarded\n"
        said = "".join(each for each in complaint.splitlines(keepends=True) if not each.startswith("note: "))
        # Before the command begins and once all is done there is nothing to say.
        assert said in ("", line), complaint

    def _check_files(self, name, command, before):
        """What stands is whole, and nothing lies beside it that the next command does not take over."""
        strays = sorted(entry for entry in os.listdir(self.place) if entry != OUT)
        assert name == "SIGKILL" or strays == [], strays
        assert set(strays) <= set(_LEFT_BY_KILL), strays
        path = self.place / OUT
        if not path.exists():
            assert before is None, "the old file is gone"
            return "absent"
        content = path.read_bytes()
        if before is not None and content == before:
            return "old"
        if command == "bench":
            # Holds seconds, so no two are alike; those of rows that were there before are kept.
            with h5py.File(path) as file:
                found = file["table"][()]
            assert 1 <= len(found) <= ROWS
            if before is not None:
                with h5py.File(self.inputs / "begun.h5") as file:
                    kept = file["table"][()]
                assert found[: len(kept)].tobytes() == kept.tobytes()
            assert np.isfinite(found["psnr_mean"]).all()
        else:
            assert content == self.made[command], "neither the old file nor the new one"
        return "new"

    def _check_finished(self, command):
        assert os.listdir(self.place) == [OUT], os.listdir(self.place)
        if command == "bench":
            with h5py.File(self.place / OUT) as file:
                found = file["table"][()]
            keys = {(row["method"], row["degree"], row["codec"]) for row in found}
            assert len(keys) == len(found) == ROWS
        else:
            assert (self.place / OUT).read_bytes() == self.made[command], "made anew it is another"

    def _clear(self, old):
        shutil.rmtree(self.place, ignore_errors=True)
        self.place.mkdir()
        if old is not None:
            shutil.copyfile(old, self.place / OUT)

    def _await_write(self, started, count):
        """Return when the temporary file has appeared so many times, or the command has ended."""
        part, there = self.place / f".{OUT}.part", False
        while count and started.poll() is None:
            now = part.exists()
            count -= now and not there
            there = now
            time.sleep(0.0002)

    def _finish(self, words, folder):
        done = subprocess.run(
            command_line(*words),
            cwd=folder,
            env=environment(),
            capture_output=True,
            text=True,
            timeout=_PATIENCE_SECONDS,
        )
        assert done.returncode == 0, done.stderr


def await_handlers(started):
    """Return when the command takes signals: what strikes Python itself, which begins before, is not ours to mend."""
    status = Path(f"/proc/{started.pid}/status")
    while started.poll() is None:
        try:
            caught = int(status.read_text().partition("SigCgt:")[2].split()[0], 16)
        except (OSError, IndexError):  # it has just ended
            return
        if caught >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.001)


@click.command()
@campaign.options(300, "Commands")
@click.option("--progress", is_flag=True, help="Name each case before it is begun.")
def main(count, seed, only, first, progress):
    """End commands by signals; print one JSON object for each signal, exit 1 on a failure."""
    tallies = {name: Tally(*WAYS) for name in SIGNALS}
    with tempfile.TemporaryDirectory() as folder:
        commands = Campaign(Path(folder), only)
        for number in range(first, first + count):
            _, command, name = commands.draw(number, seed)
            if progress:
                print(f"{number} {command} {name}", file=sys.stderr, flush=True)
            case = f"--first {number} --seed {seed} --only '{only}' ({command})"
            tallies[name].run(case, partial(commands.run, number, seed), first="ended")
    campaign.conclude("signal", tallies.items())


if __name__ == "__main__":
    main(prog_name="python -m tests.kills")
