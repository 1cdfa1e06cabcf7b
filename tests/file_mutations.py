"""Damaged files: every reader must refuse them in one line, or see just what the sound file holds, and soon.

``python -m tests.file_mutations --count 10000 --seed 1`` damages that many files of all kinds. A case depends on the
seed, its kind and its number alone, so ``--only fit --first 1234 --count 1`` repeats one. ``--every`` instead sets each
byte of each file to 0x00 and then to 0xFF, one at a time.
"""

import faulthandler
import json
import resource
import sys
import tempfile
import time
import zlib
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import click
import numpy as np

from clrelight import store
from clrelight.codec.registry import Encoded
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.errors import InputError
from clrelight.lighting.light import Light
from clrelight.results import ROW_DTYPE, Results
from clrelight.sampling import make_pattern
from clrelight.store import writing
from tests.hdf5 import content

KINDS = ("stack", "fit", "encoded", "results", "light")
FREE_BYTES = 1 << 28
"""Address space that reading may take: HDF5 believes sizes that a damaged file claims."""
MOST_SECONDS = 20.0
"""A thousand times what reading takes."""
CHUNK_BYTES = 1024
"""So that arrays have several blocks, some of them cut off by the array's edge."""


def write_all(folder):
    """Write one file of each kind; return their paths by kind."""
    rng = np.random.default_rng(1)
    lights, size = make_pattern("uniform", 9), (7, 11, 3)
    paths = {kind: Path(folder, f"{kind}.h5") for kind in KINDS}
    # A saturated and a black part each: what Fletcher's checksum takes for the same.
    images = rng.integers(0, 256, (9, *size), np.uint8)
    images[:, 1:3], images[:, 4:6] = 0, 255
    whole = writing.CHUNK_BYTES
    writing.CHUNK_BYTES = CHUNK_BYTES
    try:
        stack = LightStack(images, lights, 255.0, "srgb", np.full(9, 0.5), rng.random(size[:2]) < 0.5, "vase")
        store.write_stack(paths["stack"], stack)
        maps = rng.random(size, np.float32), rng.integers(0, 9, size, np.int32)
        coeffs = rng.standard_normal((4, *size), np.float32)
        coeffs[1] = 0
        fit = CoefficientMap(coeffs, 1, "cls", 255.0, "srgb", lights, {"energy": 1.0}, *maps, "vase")
        store.write_fit(paths["fit"], fit)
        body = bytes(300) + rng.bytes(2000) + b"\xff" * 300
        encoded = Encoded("half", {"clamp": True}, coeffs.shape, body, {"entropy_bits": 3.25})
        store.write_encoded(paths["encoded"], encoded, fit)
        table = np.zeros(2, ROW_DTYPE)
        table["scene"], table["psnr_mean"], table["degree"] = b"ring", np.inf, np.arange(2)
        pictures = {f"ring/uls/{i}": rng.integers(0, 256, (4, 5, 3), np.uint8) for i in range(9)}
        store.write_results(paths["results"], Results(table, pictures, {"ring/uls/6": np.linspace(0, 1, 49)}))
        store.write_light(paths["light"], Light(rng.standard_normal((9, 3)), "sky", "", {"cap": 1.5}))
    finally:
        writing.CHUNK_BYTES = whole
    return paths


def damage(sound, others, rng):
    """Return a damaged file's bytes; `others` lend pieces of theirs."""
    changed = bytearray(sound)
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(len(changed)))
        length = int(min(2 ** rng.uniform(0, 12), len(changed) - at))
        match rng.choice(_DAMAGES):
            case "byte":
                changed[at] = rng.integers(256)
            case "bit":
                changed[at] ^= 1 << int(rng.integers(8))
            case "run":
                changed[at : at + length] = bytes([rng.choice([0, 0xFF])]) * length
            case "noise":
                changed[at : at + length] = rng.bytes(length)
            case "inverted":
                changed[at : at + length] = bytes(255 - b for b in changed[at : at + length])
            case "sector":  # of the same file, or of another one
                source = sound if rng.random() < 0.5 else others[rng.integers(len(others))]
                first = at - at % 512
                start = 512 * int(rng.integers(len(source) // 512))
                piece = source[start : start + 512][: len(changed) - first]
                changed[first : first + len(piece)] = piece
            case "cut":
                del changed[max(at, 1) :]
            case "insert":
                changed[at:at] = rng.bytes(length)
            case "delete":
                del changed[at : at + length]
        if not changed:
            break
    return bytes(changed)


_DAMAGES = ("byte", "byte", "bit", "bit", "run", "run", "run", "noise", "inverted", "sector", "cut", "insert", "delete")


@dataclass
class Tally:
    """What became of the files of a kind: refused, or read as the sound one, which holds bytes that nobody needs."""

    files: int = 0
    refused: int = 0
    same: int = 0
    slowest_ms: float = 0.0
    failures: list[str] = field(default_factory=list)


class Campaign:
    """The sound files of all kinds."""

    def __init__(self, folder):
        paths = write_all(folder)
        self._path = Path(folder, "damaged.h5")
        self.sound = {kind: path.read_bytes() for kind, path in paths.items()}
        self._expected = {kind: content(kind, path) for kind, path in paths.items()}

    def run(self, kind, numbers, seed):
        """Damage files at random and read them."""
        tally, others = Tally(), list(self.sound.values())
        for number in numbers:
            rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), number])
            damaged = damage(self.sound[kind], others, rng)
            if damaged != self.sound[kind]:
                self._read(kind, damaged, tally, f"--only {kind} --first {number} --seed {seed}")
        return tally

    def run_every(self, kind):
        """Set each byte to 0x00 and to 0xFF, and read the file."""
        tally = Tally()
        for at, now in enumerate(self.sound[kind]):
            for value in {0x00, 0xFF} - {now}:
                damaged = bytearray(self.sound[kind])
                damaged[at] = value
                self._read(kind, damaged, tally, f"{kind}: byte {at} set to {value}")
        return tally

    def _read(self, kind, damaged, tally, case):
        self._path.write_bytes(damaged)
        tally.files += 1
        start = time.perf_counter()
        with _bounded():
            try:
                found = content(kind, self._path)
            except InputError as error:
                tally.refused += 1
                if str(self._path) not in str(error) or "\n" in str(error):
                    tally.failures.append(f"{case}: {error}")
            except BaseException as error:
                if isinstance(error, KeyboardInterrupt):
                    raise
                tally.failures.append(f"{case}: {error!r}")
            else:
                tally.same += 1
                if found != self._expected[kind]:
                    tally.failures.append(f"{case}: other values, and no word")
        tally.slowest_ms = max(tally.slowest_ms, 1e3 * (time.perf_counter() - start))


@contextmanager
def _bounded():
    """Bound memory, so that an allocation fails, and time, so that the process ends with a traceback."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + FREE_BYTES, before[1]))
    faulthandler.dump_traceback_later(MOST_SECONDS, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        resource.setrlimit(resource.RLIMIT_AS, before)


@click.command()
@click.option("--count", type=click.IntRange(min=1), default=10000, show_default=True, help="Files in all.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option("--only", metavar="KIND", type=click.Choice(KINDS))
@click.option("--first", type=click.IntRange(min=0), default=0, help="Number of the first file of each kind.")
@click.option("--every", is_flag=True, help="Set each byte to 0x00 and to 0xFF instead.")
def main(count, seed, only, first, every):
    """Damage files of every kind and read them; print one JSON object for each kind, exit 1 on a failure."""
    faulthandler.enable()
    failed = False
    kinds = (only,) if only else KINDS
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(folder)
        for kind in kinds:
            share = -(-count // len(kinds))
            tally = campaign.run_every(kind) if every else campaign.run(kind, range(first, first + share), seed)
            print(json.dumps({"kind": kind, "bytes": len(campaign.sound[kind]), **asdict(tally)}), flush=True)
            failed |= bool(tally.failures)
    sys.exit(failed)


if __name__ == "__main__":
    main(prog_name="python -m tests.file_mutations")
