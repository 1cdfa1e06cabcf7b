"""How fast klt encodes and decodes photographs' fits: ``python -m benchmarks.klt_speed``.

Coefficients of linear radiance are in memory, and so is what comes out: coefficients, or planes, of which images are
sums. Processor seconds are told beside the time: on a machine that is busy with something else they tell more.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import click
import numpy as np

import clrelight as cr
from benchmarks.photographs import Scene
from clrelight.cli.options import whole_number
from clrelight.cli.tables import print_table
from clrelight.codec import Encoded, codec_class, decode, encode
from clrelight.codec.formats.klt_decode import UnitPlanes
from clrelight.codec.formats.klt_units import parse_body
from clrelight.codec.minimum_size import drop_padding
from clrelight.codec.views import Region
from clrelight.dataset import LightStack
from clrelight.device import Device, open_device
from clrelight.sampling import make_pattern

_CASES = ((4, 0.1), (6, 0.1), (9, 0.1))
"""Degrees, and bits per coefficient."""
_CPU = "of its CPU time"
HEADERS = ["degree", "bit", "planes", "MB", "encode MP/s", _CPU, "decode MP/s", _CPU, "to planes MP/s", _CPU]


def _timed(work: Callable[[], Any]) -> tuple[Any, float, float]:
    """Return what work returns, its seconds, and its processor seconds over the processors there are."""
    used, since = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
    made = work()
    seconds, now = time.perf_counter() - since, resource.getrusage(resource.RUSAGE_SELF)
    busy = now.ru_utime + now.ru_stime - used.ru_utime - used.ru_stime
    return made, seconds, busy / len(os.sched_getaffinity(0))


def _decode_planes(encoded: Encoded, device: Device) -> None:
    body = drop_padding(encoded.body, encoded.shape)
    planes = UnitPlanes(body, parse_body(body, encoded.shape).stored, encoded.shape)
    for part in planes.parts(Region(0, 0, *encoded.shape[1:3]), device):
        part.array(device)


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--width", type=whole_number(64, 20000), default=1224, show_default=True)
@click.option("--height", type=whole_number(64, 20000), default=816, show_default=True)
@click.option("--lights", type=whole_number(4, 1000), default=101, show_default=True)
@click.option("--rounds", type=whole_number(1, 100), default=3, show_default=True, help="The fastest counts.")
def main(width: int, height: int, lights: int, rounds: int) -> None:
    """Print megapixels a second of some degrees, as timed and as processor seconds allow."""
    directions_i3, scene = make_pattern("uniform", lights), Scene(width, height)
    images = np.stack([scene.photograph(light, i) for i, light in enumerate(directions_i3)])
    stack, megapixels, rows = LightStack(images, directions_i3, 255.0, "srgb"), width * height / 1e6, []
    device = open_device()
    for degree, rate in _CASES:
        fitted = cr.fit(stack, method="spline", degree=degree)
        codec = codec_class("klt").from_config({"rate": rate, "transfer": "linear"})
        encoded = encode(fitted.coeffs_khwc, codec, device)
        # No round's map outlives it: several would be memory that no system has had in use.
        coded = [_timed(partial(encode, fitted.coeffs_khwc, codec, device))[1:] for _ in range(rounds)]
        decoded = [_timed(partial(decode, encoded, device))[1:] for _ in range(rounds)]
        to_planes = [_timed(partial(_decode_planes, encoded, device))[1:] for _ in range(rounds)]
        timed = (coded, decoded, to_planes)
        speeds = [f"{megapixels / min(each[at] for each in of):.2f}" for of in timed for at in (0, 1)]
        planes = int(encoded.info["planes"])
        rows.append([str(degree), f"{rate:g}", str(planes), f"{encoded.encoded_bytes / 1e6:.2f}", *speeds])
    print_table(HEADERS, rows)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.klt_speed")
