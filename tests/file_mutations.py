"""Damaged files: every reader must refuse them in one line, or see just what the sound file holds, and soon.

``python -m tests.file_mutations --count 10000 --seed 1`` damages that many files of all kinds. A case depends on the
seed, its kind and its number alone, so ``--only fit --first 1234 --count 1`` repeats one. ``--every`` instead sets each
byte of each file to 0x00 and then to 0xFF, one at a time.
"""

import faulthandler
import tempfile
import zlib
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np

from clrelight import store
from clrelight.codec.encoded import Encoded
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.errors import InputError
from clrelight.lighting.light import Light
from clrelight.results import ROW_DTYPE, Results
from clrelight.sampling import make_pattern
from clrelight.shrm.record import Shrm
from clrelight.store import writing
from tests import campaign
from tests.campaign import Tally, bounded
from tests.hdf5 import content
from tests.surfaces import make_grid

KINDS = ("stack", "fit", "encoded", "results", "light", "surface", "shrm")
WAYS = ("files", "refused", "same")
"""What becomes of files: refused, or read as the sound one, which holds bytes that nobody needs."""
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
        maps = rng.standard_normal((4, 5, 9, 3), np.float32)
        store.write_shrm(paths["shrm"], Shrm(maps, "global", 3, "reflection", "sky", "", {"brdf": "phong"}))
        store.write_light(paths["light"], Light(rng.standard_normal((9, 3)), "sky", "", {"cap": 1.5}))
        surface = make_grid(*size[:2])
        store.write_fit(paths["surface"], replace(fit, surface=surface))
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
                start = 512 * int(rng.integers(max(len(source) // 512, 1)))
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


class Campaign:
    """The sound files of all kinds."""

    def __init__(self, folder):
        paths = write_all(folder)
        self._path = Path(folder, "damaged.h5")
        self.sound = {kind: path.read_bytes() for kind, path in paths.items()}
        self._expected = {kind: content(kind, path) for kind, path in paths.items()}

    def run(self, kind, numbers, seed):
        """Damage files at random and read them."""
        tally, others = Tally(*WAYS), list(self.sound.values())
        for number in numbers:
            rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), number])
            damaged = damage(self.sound[kind], others, rng)
            if damaged != self.sound[kind]:
                case = f"--only {kind} --first {number} --seed {seed}"
                tally.run(case, partial(self._read, kind, damaged), first="files")
        return tally

    def run_every(self, kind):
        """Set each byte to 0x00 and to 0xFF, and read the file."""
        tally = Tally(*WAYS)
        for at, now in enumerate(self.sound[kind]):
            for value in {0x00, 0xFF} - {now}:
                damaged = bytearray(self.sound[kind])
                damaged[at] = value
                tally.run(f"{kind}: byte {at} set to {value}", partial(self._read, kind, damaged), first="files")
        return tally

    def _read(self, kind, damaged):
        self._path.write_bytes(damaged)
        with bounded(FREE_BYTES, MOST_SECONDS):
            try:
                found = content(kind, self._path)
            except InputError as error:
                refused = str(error)
            else:
                assert found == self._expected[kind], "other values, and no word"
                return ["same"]
        assert str(self._path) in refused, refused
        assert "\n" not in refused, refused
        return ["refused"]


@click.command()
@campaign.options(10000, "Files")
@click.option("--every", is_flag=True, help="Set each byte to 0x00 and to 0xFF instead.")
def main(count, seed, only, first, every):
    """Damage files of every kind and read them; print one JSON object for each kind, exit 1 on a failure."""
    faulthandler.enable()
    kinds = [kind for kind in KINDS if only in kind]
    with tempfile.TemporaryDirectory() as folder:
        files = Campaign(folder)
        numbers = range(first, first - (-count // len(kinds)))
        campaign.conclude(
            "kind", ((kind, files.run_every(kind) if every else files.run(kind, numbers, seed)) for kind in kinds)
        )


if __name__ == "__main__":
    main(prog_name="python -m tests.file_mutations")
