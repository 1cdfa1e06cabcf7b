"""Write a stack of any size without ray tracing it: ``python -m benchmarks.big_stack``."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from clrelight.cli.options import whole_number
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError
from clrelight.store import create_stack
from datasets_synth.ring import DTYPES, render_ring

_TILE = 128
_BAND_BYTES = 64 << 20


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("out", type=click.Path(dir_okay=False, path_type=Path))
@click.option("--height", type=whole_number(1, 1 << 16), default=4096, show_default=True)
@click.option("--width", type=whole_number(1, 1 << 16), default=4096, show_default=True)
@click.option("--lights", type=whole_number(1, 1 << 12), default=64, show_default=True)
@click.option("--dtype", type=click.Choice(DTYPES), default="float16", show_default=True, help="Sample type.")
def main(out: Path, height: int, width: int, lights: int, dtype: str) -> None:
    """Tile a small rendering of the ring scene to a large view, and write it in bands: to measure how work streams.

    \b
    Example:
      python -m benchmarks.big_stack big.h5 --height 4096 --width 4096 --lights 64 --dtype float16
    """
    scene = render_ring(size=_TILE, lights=lights, dtype=dtype)
    # The band is made once; the rows of any other are some of its rows.
    wide_ihwc = np.tile(scene.images_ihwc, (1, 1, -(-width // _TILE), 1))[:, :, :width]
    blank_ihwc = np.broadcast_to(np.zeros((), dtype), (lights, height, width, 3))
    big = replace(scene, images_ihwc=blank_ihwc, name="big")
    with progress_bar("writing") as progress, create_stack(out, big) as sink:
        chunk_rows = sink.chunks[1]
        step = chunk_rows * max(1, _BAND_BYTES // (chunk_rows * wide_ihwc[:, :1].nbytes))
        for first in range(0, height, step):
            end = min(first + step, height)
            sink[:, first:end] = wide_ihwc[:, np.arange(first, end) % _TILE]
            progress(end, height)


if __name__ == "__main__":
    try:
        main(prog_name="python -m benchmarks.big_stack")
    except InputError as error:
        sys.exit(f"benchmarks.big_stack: {error}")
