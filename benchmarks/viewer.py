"""Figures, table and picture of the viewer: ``python -m benchmarks.viewer``."""

from __future__ import annotations

import io
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click
import numpy as np
from PIL import Image

from clrelight.cli.tables import print_table
from clrelight.durable import replacing
from clrelight.errors import InputError
from clrelight.store import write_fit
from clrelight.view import lights
from tests.browser import Page, find_chromium, opened_browser
from tests.test_view_page import smooth_fit

ROOT = Path(__file__).resolve().parents[1]
_READY = "globalThis.clrelight?.app?.isWhole && clrelight.app.store.isIdle"
_FRAMES = """(() => {
  const app = clrelight.app, gl = app.renderer.gl, one = new Uint8Array(4);
  const frame = (i) => {
    app.pace = 0;
    app.pointLight(clrelight.directionOf(0.6 * Math.cos(i), 0.6 * Math.sin(i)));
    app.frame();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one);
  };
  app.drag(true);
  for (let i = 0; i < 5; i++) frame(i);
  const since = performance.now();
  for (let i = 0; i < COUNT; i++) frame(i);
  const seconds = (performance.now() - since) / 1000;
  app.drag(false);
  return COUNT / seconds;
})()"""
_SKY = """(async () => {
  const app = clrelight.app;
  const rate = (files) => {
    const once = () => {
      for (const picture of app.renderer.pictures) picture.key = null; // made anew, though the light is the same
      files.forEach((file, slot) => app.renderer.sum(slot, file, app.view, app.store, app.lighting, app.state, 0.5));
    };
    once();
    app.renderer.finish();
    const since = performance.now();
    for (let i = 0; i < COUNT; i++) once();
    app.renderer.finish();
    return (1000 * COUNT) / (performance.now() - since);
  };
  app.state.light = "sky";
  app.isSlow = true;
  const since = performance.now();
  app.changed();
  const [file] = app.shownFiles();
  const ready = () => app.isWhole && app.store.isIdle && !app.planned && app.drawnFiles()[0] === file.straight;
  while (!ready()) await new Promise((done) => setTimeout(done, 10));
  const seconds = (performance.now() - since) / 1000;
  return [rate([file]), rate([file.straight]), seconds];
})()"""
_SQUARE = """(() => {
  const app = clrelight.app;
  app.canvas.style.cssText = "position: fixed; left: 0; top: 0; z-index: 9; width: SIDEpx; height: SIDEpx";
  app.resize();
})()"""


_COMPARED = """(() => {
  const app = clrelight.app;
  app.chooseScale = () => (app.scale = 1); // however slow this machine is
  app.pointLight(clrelight.directionOf(-0.4, 0.3));
  app.set("split", 0.47);
  app.set("compare", "split");
})()"""


@contextmanager
def served(*words: object) -> Iterator[str]:
    """Lend the address of ``clrelight view`` with some words."""
    command = [sys.executable, "-m", "clrelight", "view", *map(str, words), "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise InputError("clrelight view does not start")
        yield json.loads(line)["address"]
    finally:
        process.terminate()
        process.wait()


def run(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "clrelight", *map(str, words)], check=True, capture_output=True, cwd=ROOT)


def square(page: Page, side: int) -> None:
    page.wait("globalThis.clrelight?.app")
    page.evaluate(_SQUARE.replace("SIDE", str(side)))
    page.wait(_READY, 120)


def frame_rate(folder: Path, count: int) -> float:
    """Return frames a second at 1024 x 1024 of 27 planes, at half size, each waited for."""
    stack, fit = folder / "ring.h5", folder / "fit.h5"
    if not fit.exists():
        run("synth", "ring", stack, "--size", 256, "--lights", 64)
        run("fit", stack, fit, "--degree", 2)
    with served(fit) as address, opened_browser(address, width=1400, height=1100) as page:
        square(page, 1024)
        return float(page.evaluate(_FRAMES.replace("COUNT", str(count)), 300))


def sky_rates(folder: Path, degree: int, count: int) -> tuple[float, float, float]:
    """Return frames a second of a sky over a payload behind the curve, 1024 x 1024 at half size.

    Summed over directions, and as coefficients; then the seconds until these are there.
    """
    fit, coded = folder / f"smooth{degree}.h5", folder / f"curved{degree}.h5"
    write_fit(fit, smooth_fit(512, degree))
    run("encode", fit, coded, "--codec", "klt", "--step", 0.06, "--transfer", "srgb")
    with served(coded) as address, opened_browser(address, width=1400, height=1100) as page:
        square(page, 1024)
        if not page.evaluate("clrelight.app.store.files[0].bent"):
            raise InputError(f"the encoder left the curve out at degree {degree}")
        summed, straight, seconds = page.evaluate(_SKY.replace("COUNT", str(count)), 600)
        return float(summed), float(straight), float(seconds)


def first_picture(path: Path) -> tuple[float, float]:
    """Return seconds from asking for the page to a picture, and to all of it at the screen's resolution."""
    with served(path) as address, opened_browser() as page:
        since = time.perf_counter()
        page.go(address, width=1280, height=800)
        page.wait("globalThis.clrelight?.app?.someTiles", 120)
        some = time.perf_counter() - since
        page.wait("clrelight.app.firstPicture", 300)
        return some, time.perf_counter() - since


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def main() -> None:
    """Measure the viewer, draw its picture, or make its table of skies."""
    if not find_chromium():
        raise InputError("no Chromium is installed: apt-get install chromium")


@main.command()
@click.option("--file", "file_24", type=click.Path(path_type=Path), help="A file of codec klt of 24 megapixels.")
@click.option("--frames", default=30, show_default=True)
def figures(file_24: Path | None, frames: int) -> None:
    """Print frames a second without a graphics card, and the seconds to the first picture of a file."""
    with tempfile.TemporaryDirectory() as folder:
        rows: list[list[Any]] = [
            ["frames a second, 1024², 27 planes, half size", f"{frame_rate(Path(folder), frames):.1f}"]
        ]
        for degree in (2, 4):
            summed, straight, seconds = sky_rates(Path(folder), degree, max(frames // 10, 2))
            what = f"frames a second, a sky behind the curve, degree {degree}"
            rows += [[f"{what}, over directions", f"{summed:.2f}"], [f"{what}, as coefficients", f"{straight:.1f}"]]
            rows += [["seconds until those are there", f"{seconds:.1f}"]]
    if file_24 is not None:
        some, whole = first_picture(file_24)
        rows += [["seconds to the first picture", f"{some:.2f}"], ["seconds to all of it", f"{whole:.2f}"]]
    print_table(["figure", "value"], rows)


@main.command()
@click.option("--folder", type=click.Path(path_type=Path), help="Where the files stay, for the next run.")
@click.option("--out", type=click.Path(path_type=Path), default=ROOT / "docs" / "images" / "viewer.png")
def picture(folder: Path | None, out: Path) -> None:
    """Write the picture of docs/viewer.md: the paper's ring by two codecs beside each other."""
    with tempfile.TemporaryDirectory() as scratch:
        place = folder or Path(scratch)
        stack, fit, files = place / "ring.h5", place / "fit.h5", [place / "ring_klt.h5", place / "ring_s3tc.h5"]
        if not fit.exists():
            run("synth", "ring", stack, "--size", 512, "--lights", 100)
            run("fit", stack, fit, "--degree", 5)
            run("encode", fit, files[0], "--codec", "klt", "--rate", 0.1)
            run("encode", fit, files[1], "--codec", "s3tc")
        with served(*files) as address, opened_browser(address, width=1120, height=740) as page:
            page.wait("globalThis.clrelight?.app?.isWhole", 120)
            page.evaluate(_COMPARED)
            page.wait(f"{_READY} && /dB/.test(document.getElementById('figure').textContent)", 120)
            page.picture(out)
    with Image.open(out) as drawn:
        drawn.convert("RGB").quantize(200).save(out, optimize=True)


@main.command()
def skies() -> None:
    """Write the coefficients of skies that the page interpolates: clrelight/view/skies.npy."""
    content = io.BytesIO()
    np.save(content, lights.make_sky_table())
    with replacing(ROOT / "clrelight" / "view" / "skies.npy") as part:
        part.write(content.getvalue())


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.viewer")
    except InputError as error:
        sys.exit(f"benchmarks.viewer: {error}")
