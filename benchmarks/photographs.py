"""Pack photographs of many megapixels as people shoot them: ``python -m benchmarks.photographs``."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import click
import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.pages import check_markdown, replace_block
from clrelight.cli.options import whole_number
from clrelight.cli.tables import print_table
from clrelight.conventions import linear_to_srgb
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.speed.environment import describe_environment
from clrelight.speed.tables import markdown_table

_RELIEF = 2048
"""Side in pixels of the relief, which repeats; the paint on it does not."""
_SHADOW_STEPS = (1, 2, 4, 8, 16, 32, 64)
_NOISE = 0.004
_SHAPES = {1: (1224, 816), 4: (2448, 1632), 24: (6000, 4000), 100: (12240, 8160)}


BEGIN, END = "<!-- photographs -->", "<!-- /photographs -->"
HEADERS = [
    *("MP", "JPEG MB", "decoding s", "pack s", "times", "MiB", "photographs MiB", "bytes", "dB held out"),
    *("picture s", "512² s", "opened 512² s"),
]
_OPENED = """
import sys, time
import clrelight as cr
path, x, y = sys.argv[1], *map(int, sys.argv[2:])
encoded, _ = cr.read_encoded(path)
for step in range(8):
    since = time.perf_counter()
    cr.relight(encoded, (0.3, 0.1, 0.8), region=(x - 32 * step, y, 512, 512))
    print(time.perf_counter() - since)
"""


class Scene:
    """A painted, varnished relief that casts shadows on itself."""

    def __init__(self, width: int, height: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self._width, self._height = width, height
        side = min(_RELIEF, max(width, height))
        self._relief = 12.0 * _fractal(rng, side, side, wrap=True)
        slope_y, slope_x = np.gradient(self._relief)
        normal = np.stack([-slope_x, slope_y, np.ones_like(slope_x)], axis=-1)
        self._normal = (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)
        paint = _fractal(rng, height, width)
        hues = np.array([[0.55, 0.14, 0.09], [0.16, 0.30, 0.42], [0.62, 0.52, 0.30], [0.30, 0.28, 0.25]], np.float32)
        place = np.clip((paint - paint.min()) / np.ptp(paint) * 3.0, 0.0, 2.999)
        first = place.astype(np.intp)
        part = (place - first)[..., None].astype(np.float32)
        self._albedo = hues[first] * (1.0 - part) + hues[first + 1] * part
        grain = rng.standard_normal((height, width), np.float32)
        self._albedo *= np.clip(1.0 + 0.08 * grain[..., None], 0.5, 1.5)

    def photograph(self, light: NDArray[np.float64], seed: int) -> NDArray[np.uint8]:
        """Return sRGB code values under a distant light, with the noise of a sensor."""
        side = len(self._relief)
        diffuse = np.clip(self._normal @ light.astype(np.float32), 0.0, None)
        half = light + np.array([0.0, 0.0, 1.0])
        half /= np.linalg.norm(half)
        gloss = np.clip(self._normal @ half.astype(np.float32), 0.0, None) ** 40
        lit = np.ones((side, side), bool)
        across = np.hypot(light[0], light[1])
        for step in _SHADOW_STEPS if across > 1e-6 else ():
            shift = np.rint(step * np.array([light[1], -light[0]]) / across).astype(int)
            beyond = np.roll(self._relief, tuple(shift), axis=(0, 1))
            lit &= beyond < self._relief + step * light[2] / across
        soft = ndimage.uniform_filter(lit.astype(np.float32), 3, mode="wrap")
        shade, shine = 1.1 * soft * diffuse + 0.02, 0.25 * soft * gloss
        repeats = (-(-self._height // side), -(-self._width // side))
        table = (255.0 * linear_to_srgb(np.arange(4096) / 4095.0)).astype(np.float32)
        image = np.empty((self._height, self._width, 3), np.uint8)
        shade, shine = (np.tile(each, repeats)[: self._height, : self._width] for each in (shade, shine))
        rng = np.random.default_rng(seed)
        for top in range(0, self._height, 256):
            rows = slice(top, top + 256)
            radiance = self._albedo[rows] * shade[rows, :, None] + shine[rows, :, None]
            radiance += _NOISE * rng.standard_normal(radiance.shape, np.float32)
            np.clip(radiance, 0.0, 1.0, out=radiance)
            image[rows] = np.rint(table[(4095.0 * radiance).astype(np.intp)])
        return image


def _fractal(rng: np.random.Generator, height: int, width: int, wrap: bool = False) -> NDArray[np.float32]:
    """Return a rough surface of mean 0, of deviation about 1."""
    total = np.zeros((height, width), np.float32)
    for octave in range(2, 9):
        cells = 1 << octave
        coarse = rng.standard_normal((cells, cells), np.float32)
        rows, columns = (np.arange(n, dtype=np.float32) * cells / n for n in (height, width))
        top, left = rows.astype(int), columns.astype(int)
        below, right = (top + 1) % cells, (left + 1) % cells
        if not wrap:
            below, right = np.minimum(top + 1, cells - 1), np.minimum(left + 1, cells - 1)
        part_y, part_x = (rows - top)[:, None], (columns - left)[None]
        part_y, part_x = (part * part * (3.0 - 2.0 * part) for part in (part_y, part_x))
        upper = coarse[top][:, left] * (1.0 - part_x) + coarse[top][:, right] * part_x
        lower = coarse[below][:, left] * (1.0 - part_x) + coarse[below][:, right] * part_x
        total += (upper * (1.0 - part_y) + lower * part_y) * np.float32(2.0 ** (-0.8 * (octave - 2)))
    return total


def write_photographs(folder: Path, width: int, height: int, lights: int, quality: int) -> None:
    """Write JPEGs of a scene under lights all over the hemisphere, and their ``dome.lp``."""
    folder.mkdir(parents=True)
    directions_i3 = make_pattern("uniform", lights)
    scene = Scene(width, height)

    def write(light: int) -> None:
        spec = oiio.ImageSpec(width, height, 3, "uint8")
        spec.attribute("Compression", f"jpeg:{quality}")
        output = oiio.ImageOutput.create("x.jpg")
        if not output or not output.open(str(folder / f"IMG_{light:04d}.jpg"), spec):
            raise InputError(f"cannot write photographs to {folder}")
        output.write_image(scene.photograph(directions_i3[light], light))
        output.close()

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(write, range(lights)))
    lines = [f"IMG_{i:04d}.jpg {x:.6f} {y:.6f} {z:.6f}" for i, (x, y, z) in enumerate(directions_i3)]
    (folder / "dome.lp").write_text("\n".join([str(lights), *lines, ""]))


def decode_seconds(folder: Path) -> float:
    """Return how long OpenImageIO takes to decode all photographs, on two threads."""
    names = sorted(folder.glob("*.jpg"))
    since = time.perf_counter()
    with ThreadPoolExecutor(2) as pool:
        for pixels in pool.map(_decode, names):
            if pixels is None:
                raise InputError(f"cannot read the photographs of {folder}")
    return time.perf_counter() - since


def _decode(path: Path) -> tuple[int, ...] | None:
    source = oiio.ImageInput.open(str(path))
    pixels = source.read_image("uint8") if source else None
    return None if pixels is None else pixels.shape


def run_pack(folder: Path, out: Path, words: list[str]) -> dict[str, Any]:
    """Return what ``clrelight pack`` says of a folder, with the seconds of the whole process."""
    since = time.perf_counter()
    command = [sys.executable, "-m", "clrelight", "pack", str(folder), str(out), "--transfer", "srgb", "--json", *words]
    ended = subprocess.run(command, capture_output=True, text=True)
    if ended.returncode:
        raise InputError(f"pack ended with {ended.returncode}: {ended.stderr}")
    return {**json.loads(ended.stdout), "whole": time.perf_counter() - since}


def _relit(out: Path, words: list[str]) -> float:
    """Return the seconds of a whole process that writes one relit picture."""
    picture = out.with_suffix(".png")
    since = time.perf_counter()
    command = [sys.executable, "-m", "clrelight", "relight", str(out), str(picture), "--light", "0.3,0.1,0.8", *words]
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - since


def _relit_opened(out: Path, x: int, y: int) -> float:
    """Return the median of the seconds that regions take once the file is open and the first of them is shown."""
    command = [sys.executable, "-c", _OPENED, str(out), str(x), str(y)]
    printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return float(np.median([float(line) for line in printed.split()][1:]))


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--megapixels", type=click.Choice([str(each) for each in _SHAPES]), multiple=True, default=["1", "4", "24"]
)
@click.option("--lights", type=whole_number(4, 1000), default=60, show_default=True)
@click.option("--quality", type=whole_number(1, 100), default=92, show_default=True, help="Of the JPEGs.")
@click.option("--folder", type=click.Path(path_type=Path), help="Where the photographs stay, for the next run.")
@click.option("--json", "json_path", type=click.Path(path_type=Path), help="Where the figures go as well.")
@click.option("--markdown", type=click.Path(path_type=Path), help="Page whose table between two markers is replaced.")
@click.argument("words", nargs=-1)
def main(
    megapixels: tuple[str, ...],
    lights: int,
    quality: int,
    folder: Path | None,
    json_path: Path | None,
    markdown: Path | None,
    words: tuple[str, ...],
) -> None:
    """Make photographs, pack them, and print what it took.

    WORDS are options of pack; by default --degree 6 --method spline --rate 0.1 --holdout 5.

    \b
    Example:
      python -m benchmarks.photographs --megapixels 24
      python -m benchmarks.photographs --megapixels 24 -- --bytes 20M
    """
    asked = list(words) or ["--degree", "6", "--method", "spline", "--rate", "0.1", "--holdout", "5"]
    place = Path(tempfile.mkdtemp(prefix="photographs.")) if folder is None else folder
    if markdown is not None:
        check_markdown(markdown, BEGIN, END)
    try:
        rows = list(_measure(place, megapixels, lights, quality, asked))
    finally:
        if folder is None:
            shutil.rmtree(place)
    if json_path is not None:
        json_path.write_text(json.dumps(rows, indent=1))
    cells = [[str(cell) for cell in _cells(row)] for row in rows]
    print_table(HEADERS, cells)
    if markdown is not None:
        facts = {
            "command": f"python -m benchmarks.photographs, pack {' '.join(asked)}",
            **describe_environment(open_device()),
        }
        lines = [f"- {name}: {value}" for name, value in facts.items()]
        replace_block(markdown, "\n".join([*lines, "", markdown_table(HEADERS, cells)]), BEGIN, END)


def _measure(
    place: Path, megapixels: tuple[str, ...], lights: int, quality: int, words: list[str]
) -> Iterator[dict[str, Any]]:
    for name in megapixels:
        width, height = _SHAPES[int(name)]
        photographs = place / f"{name}mp"
        if not photographs.exists():
            write_photographs(photographs, width, height, lights, quality)
        size = sum(path.stat().st_size for path in photographs.glob("*.jpg"))
        out = place / f"{name}mp.h5"
        packed = run_pack(photographs, out, words)
        x, y = width // 2 - 256, height // 2 - 256
        yield {
            "megapixels": width * height / 1e6,
            "jpeg_bytes": size,
            "decoding": decode_seconds(photographs),
            "packed": packed,
            "picture": _relit(out, []),
            "region": _relit(out, ["--region", f"{x},{y},512,512"]),
            "opened": _relit_opened(out, x, y),
        }


def _cells(row: dict[str, Any]) -> Iterator[Any]:
    packed = row["packed"]
    yield f"{row['megapixels']:.0f}"
    yield f"{row['jpeg_bytes'] / 1e6:.0f}"
    yield f"{row['decoding']:.1f}"
    yield f"{packed['whole']:.1f}"
    yield f"{packed['whole'] / row['decoding']:.1f}"
    yield f"{packed['peak_memory'] / 2**20:.0f}"
    yield f"{packed['photographs_in_memory'] / 2**20:.0f}"
    yield packed["bytes_on_disk"]
    yield f"{packed['psnr'].get('pooled_holdout', packed['psnr'].get('pooled_fitted', 0.0)):.2f}"
    yield f"{row['picture']:.1f}"
    yield f"{row['region']:.1f}"
    yield f"{row['opened']:.3f}"


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.photographs")
    except InputError as error:
        sys.exit(f"benchmarks.photographs: {error}")
