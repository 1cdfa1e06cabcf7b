"""Damaged archives of others: they are refused in a line, with nothing written, or read to finite values, soon.

``python -m tests.archive_mutations --count 20000 --seed 1`` damages that many ``.ptm`` and ``.rti`` files, folders of
relight (whole planes and tiles), domes and projects: bytes, and values of what is JSON. A case depends on the seed,
its kind and its number alone, so ``--only rti --first 1234 --count 1`` repeats one.
"""

import copy
import faulthandler
import json
import shutil
import tempfile
import warnings
import zlib
from functools import partial
from pathlib import Path

import click
import numpy as np

from clrelight.dataset import CoefficientMap
from clrelight.store import open_stack, write_fit
from tests import campaign
from tests.campaign import Tally, bounded
from tests.commands import call
from tests.file_mutations import damage

SIZE = (9, 300)
LIGHTS = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [0.0, -0.6, 0.8], [-0.48, 0.6, 0.64]])
TILES = ("deepzoom", "google", "zoomify", "tarzoom", "itarzoom")
EXPORTED = {
    "ptm": ("a.ptm", "--format", "ptm"),
    "ptm by JPEG": ("a.ptm", "--format", "ptm", "--quality", 90),
    "rti": ("a.rti", "--format", "rti"),
    "relight": ("a", "--format", "relight", "--planes", 6),
    "relight mycc": ("a", "--format", "relight", "--planes", 9, "--colorspace", "mycc"),
    **{f"relight {each}": ("a", "--format", "relight", "--planes", 3, "--tiles", each) for each in TILES},
    "relight iiif": ("a", "--format", "relight", "--planes", 3, "--tiles", "iiif", "--url", "https://example.org/a"),
}
"""What is damaged after `export` wrote it."""
RADIAL = {"type": "rbf", "resolution": 0, "basis": [90] * 48, "sigma": 0.2, "lights": LIGHTS.ravel().tolist()}
DOME = {"lightConfiguration": "directional", "directions": LIGHTS.tolist()}
PROJECT = {"dome": DOME, "images": [{"filename": f"{i}.png", "skip": i == 3} for i in range(4)]}
MADE = {"dome": ("a.dome", DOME), "project": ("a.relight", PROJECT)}
KINDS = [*EXPORTED, "relight rbf", *MADE]
STRANGE = (
    *(None, True, "", "x", "1e400", [], [[]], {}, {"x": 1}, [1] * 9, [None], "\u0000", "../../etc/passwd", "a" * 300),
    *(0, -1, 1, 3, 2**31, 2**63, 10**400, -(10**30), 0.5, 1e-320, 1e308, -1e300, float("nan"), float("inf")),
)
FREE_BYTES, MOST_SECONDS, LIGHTS_READ = 1 << 29, 60, 4
WAYS = ("archives", "refused", "read")


def make_all(folder):
    """Write a sound archive of every kind; return their places."""
    coeffs = np.random.default_rng(3).standard_normal((9, *SIZE, 3), np.float32) * 0.1
    coeffs[0] += 1.5
    write_fit(folder / "fit.h5", CoefficientMap(coeffs, 2, "spline", 255.0, "linear", LIGHTS, name="fit"))
    places = {}
    for kind, (name, *words) in EXPORTED.items():
        (folder / kind).mkdir()
        places[kind] = folder / kind / name
        ended = call("export", folder / "fit.h5", places[kind], *words)
        assert ended.code == 0, ended
    places["relight rbf"] = folder / "relight rbf" / "a"
    shutil.copytree(places["relight"], places["relight rbf"])
    told = json.loads((places["relight rbf"] / "info.json").read_text())
    planes = len(told["materials"][0]["scale"])
    (places["relight rbf"] / "info.json").write_text(json.dumps(told | RADIAL | {"basis": [90] * 12 * (planes + 1)}))
    for kind, (name, told) in MADE.items():
        (folder / kind).mkdir()
        places[kind] = folder / kind / name
        places[kind].write_text(json.dumps(told))
    return places


def change_value(text, rng):
    """Return JSON with one to three values replaced by strange ones, or left out."""
    told = json.loads(text)
    for _ in range(rng.integers(1, 4)):
        at = told
        while True:
            keys = list(at) if isinstance(at, dict) else list(range(len(at)))
            if not keys:
                break
            key = keys[rng.integers(len(keys))]
            inner = at[key]
            if isinstance(inner, dict | list) and inner and rng.random() < 0.8:
                at = inner
                continue
            if rng.random() < 0.15:
                del at[key]
            elif rng.random() < 0.2 and isinstance(inner, float):
                at[key] = inner * (-1.0, 2.0, 1e6, 1e-6)[rng.integers(4)]
            else:
                at[key] = copy.deepcopy(STRANGE[rng.integers(len(STRANGE))])
            break
    return json.dumps(told).encode()


class Campaign:
    """Sound archives of all kinds, and a folder that their damaged copies come and go in."""

    def __init__(self, folder):
        (folder / "sound").mkdir()
        self.places, self.folder = make_all(folder / "sound"), folder / "damaged"
        self._pieces = [self.places[kind].read_bytes() for kind in ("ptm", "ptm by JPEG", "rti")]

    def run(self, kind, numbers, seed):
        """Damage one file of an archive at random, and read it."""
        tally = Tally(*WAYS)
        for number in numbers:
            rng = np.random.default_rng([seed, zlib.crc32(kind.encode()), number])
            case = f"--only {kind!r} --first {number} --seed {seed}"
            tally.run(case, partial(self._read, self._damaged(kind, rng)), first="archives")
        return tally

    def _damaged(self, kind, rng):
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        sound, place = self.places[kind], self.folder / self.places[kind].name
        (shutil.copytree if sound.is_dir() else shutil.copyfile)(sound, place)
        parts = sorted(path for path in place.rglob("*") if path.is_file()) if place.is_dir() else [place]
        # The list of what there is matters most, and is one file of many.
        told = [path for path in parts if path.name == "info.json" or kind in MADE]
        part = told[0] if told and rng.random() < 0.7 else parts[rng.integers(len(parts))]
        content = part.read_bytes()
        is_json = content[:1] == b"{" and rng.random() < 0.8
        part.write_bytes(change_value(content, rng) if is_json else damage(content, self._pieces, rng))
        return place

    def _read(self, place):
        out = self.folder / "out.h5"
        is_dome = place.suffix in (".dome", ".relight")
        words = ("info", place, "--json") if is_dome else ("import", place, out, "--lights", LIGHTS_READ)
        with bounded(FREE_BYTES, MOST_SECONDS), warnings.catch_warnings():
            warnings.simplefilter("error")
            ended = call(*words)
            if ended.code == 0:
                assert ended.err.count("\n") == ended.err.count("note: ") + ended.err.count("clrelight: "), ended.err
                assert is_dome or _is_finite(out), "values that are not finite"
                return ["read"]
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended
        assert len(ended.err) < 600, ended.err
        assert sorted(path.name for path in self.folder.iterdir()) == [place.name], "something was left"
        return ["refused"]


def _is_finite(path):
    with open_stack(path) as stack:
        return bool(np.isfinite(stack.images_ihwc[:]).all())


@click.command()
@campaign.options(10000, "Archives")
def main(count, seed, only, first):
    """Damage archives of every kind and read them; print one JSON object for each kind, exit 1 on a failure."""
    faulthandler.enable()
    kinds = [kind for kind in KINDS if only in kind]
    with tempfile.TemporaryDirectory() as folder:
        archives = Campaign(Path(folder))
        numbers = range(first, first - (-count // len(kinds)))
        campaign.conclude("kind", ((kind, archives.run(kind, numbers, seed)) for kind in kinds))


if __name__ == "__main__":
    main(prog_name="python -m tests.archive_mutations")
