"""Decoders and openers in Python under atheris, which looks for inputs that reach new lines of them.

``python -m tests.python_fuzz --executions 1000000 --only klt`` needs the extra ``fuzz``. Payloads of every codec are
sealed again after they were changed, so that decoders see the damage behind the checksums; files of every kind are
opened with and without their seal; journals of batches and lists of shards are read. An exception that is no
`InputError` ends its process, and its input is kept under ``--findings``.

Payloads claim few coefficients, so that a million of them are tried in minutes; ``--large`` has the shapes and the
frozen files of ``tests.mutations``, and decodes whatever is claimed.
"""

import contextlib
import importlib.util
import json
import math
import os
import re
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import click

from tests.commands import ROOT, environment

SECONDS_EACH = 30
MEGABYTES = 4096
MOST_COEFFICIENTS = 128
"""That a payload may claim to be decoded, unless it is a large one; its bytes are then few too."""
SMALL_SHAPES = [(1, 1, 1, 1), (1, 2, 2, 1), (4, 1, 2, 1), (4, 2, 3, 3), (4, 3, 5, 2)]
INSTALL = "atheris is not installed: pip install 'clrelight[fuzz]'"


def targets():
    """Return the names of all targets."""
    from tests.file_mutations import KINDS
    from tests.mutations import families

    return [*families(), *(f"file {kind}" for kind in KINDS), "journal", "list", "shards"]


def prepare(name, folder, large=False):
    """Return what does one input, and inputs to begin with; modules are loaded while atheris looks."""
    if name == "journal":
        return _journal(folder)
    if name == "list":
        return _list(folder)
    if name == "shards":
        return _shards()
    if name.startswith("file "):
        return _file(name.removeprefix("file "), folder)
    return _payload(name, large)


def _payload(family, large):
    from clrelight.codec import decode
    from clrelight.device import open_device
    from clrelight.errors import PayloadError
    from tests.mutations import make_payloads, seal, seal_units

    device = open_device("cpu")

    def run(data):
        # The first byte says which checksums fit.
        payload = data[1:]
        if not large and _claim_of(payload) > MOST_COEFFICIENTS:
            return -1  # and such inputs are not kept
        if data[:1] and data[0] & 1:
            with contextlib.suppress(IndexError, ValueError, OverflowError):
                payload = seal_units(payload)
        with contextlib.suppress(PayloadError):
            decode(seal(payload), device)
        return 0

    seeds = make_payloads(family, device) if large else _small_payloads(family, device)
    return run, [bytes([number % 2]) + each for number, each in enumerate(seeds)]


def _claim_of(payload):
    """Return how many coefficients a header claims; 0 where there is no whole one."""
    at = 6 + payload[5] if len(payload) > 5 else 0
    return math.prod(struct.unpack_from("<4I", payload, at)) if at and len(payload) >= at + 16 else 0


def _small_payloads(family, device):
    """Return payloads of few coefficients; of old versions frozen ones, whose headers claim less than they hold."""
    from clrelight.errors import InputError
    from tests.mutations import FROZEN, OPTIONS, UNITS, make_payload

    outer, _, inner = ("klt" if family == UNITS else family).partition("/")
    made = []
    for options in OPTIONS.get(inner or outer, [{}]):
        for number, shape in enumerate(SMALL_SHAPES):
            with contextlib.suppress(InputError):  # a rate at which the tables of so small a map have no room
                config = {"codec": inner, "options": options} if inner else options
                made.append(make_payload(outer, config, shape, number, device, lit=family == UNITS))
    for path in sorted(FROZEN.glob(f"{outer}*.bin")) if not inner and family != UNITS else ():
        payload = bytearray(path.read_bytes())
        struct.pack_into("<2I", payload, 10 + payload[5], 1, 2)
        if _claim_of(payload) <= MOST_COEFFICIENTS:
            made.append(bytes(payload))
    return made


def _file(kind, folder):
    from clrelight.errors import InputError
    from clrelight.store import describe
    from clrelight.store.opening import opening
    from tests.file_mutations import write_all

    path = folder / "input.h5"

    def run(data):
        # The first byte says whether checksums are trusted, and whether the file is described or read.
        how = data[0] if data else 0
        path.write_bytes(data[1:])
        with contextlib.suppress(InputError):
            if how & 2:
                describe(path)
                return
            with opening(path, trusting=bool(how & 1)) as opened:
                for array in opened.arrays.values():
                    array[...]

    sound = write_all(folder)[kind].read_bytes()
    return run, [how + sound for how in (b"\0", b"\1", b"\2")]


def _journal(folder):
    from clrelight.batch.journal import Journal, sealed
    from clrelight.batch.task import Outcome
    from clrelight.errors import InputError

    path = folder / "journal.jsonl"
    journal = Journal(path)
    journal.add(Outcome("a", "done", "k", outputs={str(folder / "a.h5"): {"bytes": 1}}, psnr={"mean": 30.0}))
    journal.close()

    def run(data):
        # The first byte says whether the checksums of its lines fit.
        lines = data[1:].split(b"\n") if data[:1] and data[0] & 1 else [data[1:]]
        ours = len(b'{"sum":"0123456789abcdef",')
        path.write_bytes(b"\n".join(sealed(b"{" + line[ours:]) if len(line) > ours else line for line in lines))
        with contextlib.suppress(InputError):
            Journal(path).close()

    return run, [how + path.read_bytes() for how in (b"\0", b"\1")]


def _list(folder):
    from clrelight.batch.lists import read_list
    from clrelight.errors import InputError

    path = folder / "list.toml"
    (folder / "in.h5").touch()

    def run(data):
        if b"/" in data:
            return -1  # a pattern may name the whole disk
        path.write_bytes(data)
        with contextlib.suppress(InputError):
            read_list(path, None)
        return 0

    return run, [
        b'job = "pack"\nstacks = ["i*.h5"]\nexclude = ["x*"]\n[options]\nbytes = "200k"\n',
        b'job = "fit"\nending = ".h5"\n[[override]]\nmatch = "c*"\ndegree = 4\n',
        b'job = "fit"\n[[stack]]\nsource = "in.h5"\nname = "a"\noptions = {degree = 4}\n',
    ]


def _shards():
    from clrelight.errors import InputError
    from clrelight.store.shards import shards_of

    class Opened:
        def __init__(self, text):
            self.text = text

        def attributes(self):
            return {"shards": self.text}

    def run(data):
        with contextlib.suppress(InputError):
            shards_of(Opened(data.decode("utf-8", "replace")))

    manifest = {"folder": "a.shards", "ends": [5, 10], "seals": ["xxh3-64 0123456789abcdef"] * 2}
    return run, [json.dumps(manifest).encode()]


def child(name, findings, words, large=False):
    """Fuzz one target in this process, which ends here."""
    import atheris

    memory = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None  # files are written a thousand times a second
    with tempfile.TemporaryDirectory(dir=memory) as place:
        folder = Path(place)
        with atheris.instrument_imports(include=["clrelight"], enable_loader_override=False):
            run, seeds = prepare(name, folder, large)
        corpus = folder / "corpus"
        corpus.mkdir()
        for number, seed in enumerate(seeds):
            (corpus / f"seed{number}").write_bytes(seed)
        atheris.Setup([sys.argv[0], f"-artifact_prefix={findings}/", *words, str(corpus)], run)
        atheris.Fuzz()


def fuzz(name, executions, seconds, seed, findings, large=False):
    """Fuzz one target in a process of its own; return what came of it."""
    limits = [f"-runs={executions}", f"-seed={seed}", f"-timeout={SECONDS_EACH}", f"-rss_limit_mb={MEGABYTES}"]
    limits += ["-print_final_stats=1", *([f"-max_total_time={seconds}"] if seconds else [])]
    code = f"from tests.python_fuzz import child; child({name!r}, {str(findings)!r}, {limits!r}, {large})"
    start = time.perf_counter()
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])  # atheris may lie apart
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=environment(PYTHONPATH=path),
        capture_output=True,
        text=True,
        errors="replace",
    )
    told = done.stderr + done.stdout
    count = re.search(r"number_of_executed_units:\s*(\d+)", told)
    reached = re.findall(r"cov: (\d+)", told)
    failed = done.returncode != 0
    return {
        "target": name,
        "executions": int(count[1]) if count else 0,
        "edges": int(reached[-1]) if reached else 0,
        "seconds": round(time.perf_counter() - start, 1),
        "failures": [told[-2000:]] if failed else [],
    }


@click.command()
@click.option("--executions", type=click.IntRange(min=1), default=1_000_000, show_default=True, help="Of each target.")
@click.option("--seconds", type=click.IntRange(min=0), default=0, show_default=True, help="Longest for each; 0: any.")
@click.option("--seed", type=click.IntRange(min=1), default=1, show_default=True)
@click.option("--only", metavar="TEXT", default="", help="Only targets whose name holds TEXT.")
@click.option("--large", is_flag=True, help="Payloads of many coefficients too: a hundred times slower.")
@click.option("--findings", type=click.Path(path_type=Path), default=Path("results/fuzz"), show_default=True)
def main(executions, seconds, seed, only, large, findings):
    """Fuzz; print one JSON object for each target, exit 1 on a failure."""
    if importlib.util.find_spec("atheris") is None:
        raise click.ClickException(INSTALL)
    findings.mkdir(parents=True, exist_ok=True)
    failed = False
    for name in targets():
        if only in name:
            told = fuzz(name, executions, seconds, seed, findings.resolve(), large)
            print(json.dumps(told), flush=True)
            failed |= bool(told["failures"])
    sys.exit(failed)


if __name__ == "__main__":
    main(prog_name="python -m tests.python_fuzz")
