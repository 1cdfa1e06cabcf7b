"""``clrelight relight``: images under any light."""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.claims import claim_output
from clrelight.cli.lamps import ROTATION_HELP, Rotation, Turn
from clrelight.cli.lighting import FLOAT_FORMATS, Exposure, relight_environment
from clrelight.cli.options import Numbers, device_option, json_option, whole_number
from clrelight.cli.output import print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.cli.quality import lend_coefficients
from clrelight.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from clrelight.device import Device

_PICTURE_BYTES = 1 << 26
"""So many bytes of pictures, and one at least, are made in one pass through the coefficients."""
_NUMBER_FIELD = re.compile(r"%0[1-9]d|%[1-9]?d(?![A-Za-z])")
"""Where the number of a picture goes: ``%03d``, or ``%d`` that is no part of a word, as in ``50%done``."""


class LightOrDirection(Numbers):
    """Three numbers, or a light file: what is there, or is named as one."""

    def __init__(self) -> None:
        super().__init__(float, "X,Y,Z", 3)
        self.name = "X,Y,Z|LIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the numbers as a tuple, or the path as it is."""
        if isinstance(value, str) and (value.lower().endswith((".h5", ".hdf5")) or Path(value).is_file()):
            return value
        return super().convert(value, param, ctx)


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("image", type=click.Path())
@click.option(
    "--light",
    type=LightOrDirection(),
    multiple=True,
    help="Direction to the light; may be repeated. Or a light file: light from everywhere.",
)
@click.option("--lights", type=click.Path(), metavar="FILE", help="Directions from a file, as ingest reads them.")
@click.option(
    "--exposure",
    type=Exposure(),
    default=0.0,
    show_default=True,
    help="Stops: values are scaled by 2^exposure. auto (light files): so that hardly anything is clipped.",
)
@click.option("--rotate", type=Turn(), help=f"Turn a light file: {ROTATION_HELP}")
@click.option(
    "--turntable", type=whole_number(1, 1 << 16), metavar="N", help="N images, a light file going round once."
)
@click.option(
    "--about", type=Numbers(float, "0,1,0", 3), metavar="X,Y,Z", help="Axis of the turntable; default: 0,0,1."
)
@click.option("--tonemap", type=click.Choice(["clip", "reinhard"]), help="8-bit images of a light file; default: clip.")
@click.option("--transfer", type=click.Choice(["linear", "srgb"]), help="Curve of 8-bit files; default: the stack's.")
@device_option
@json_option
def relight(
    fitted: str,
    image: str,
    light: tuple[tuple[float, float, float] | str, ...],
    lights: str | None,
    exposure: float | None,
    rotate: Rotation | None,
    turntable: int | None,
    about: tuple[float, float, float] | None,
    tonemap: str | None,
    transfer: str | None,
    device: str | None,
    as_json: bool,
) -> None:
    """Write the view under one light, under several, or under light from everywhere.

    The name decides the format: .exr, .hdr and .tif hold linear radiance as floats, .png, .jpg and others 8-bit
    display values. For several images, IMAGE holds a number field such as %03d; a turntable may be a .gif.

    \b
    Example:
      clrelight relight fit.h5 relit.png --light 0.5,0.2,0.8
      clrelight relight enc.h5 frame%03d.exr --lights turntable.lp
      clrelight relight fit.h5 grace.png --light grace.h5 --rotate 90 --exposure auto
    """
    import numpy as np

    from clrelight.device import open_device
    from clrelight.images import write_image
    from clrelight.relight import to_display
    from clrelight.store import check_output

    if transfer and image.lower().endswith(FLOAT_FORMATS):
        raise InputError(f"--transfer is for 8-bit files, but {image} holds linear radiance: leave it out")
    if any(isinstance(each, str) for each in light):
        if len(light) > 1 or lights is not None:
            raise InputError("a light file is light from everywhere: give one --light, and no --lights beside it")
        files = [image] if image.lower().endswith(".gif") else _names(image, turntable or 1)
        if about is not None and (turntable is None or not any(about)):
            raise InputError("--about X,Y,Z is the axis of --turntable N, and not all zero")
        relight_environment(
            fitted, str(light[0]), files, exposure, rotate, turntable, about, tonemap, transfer, device, as_json
        )
        return
    if exposure is None or any(each is not None for each in (rotate, turntable, about, tonemap)):
        raise InputError(
            "--exposure auto, --rotate, --turntable, --about and --tonemap are for light files (--light LIGHT.h5)"
        )
    directions_i3 = _directions([each for each in light if not isinstance(each, str)], lights)
    names = _names(image, len(directions_i3))
    for name in names:
        check_output(name, [fitted, lights] if lights else [fitted])
    claim_output(names[0])  # and so the others: two commands share all of them, or none
    opened = open_device(device)
    seconds: dict[str, float] = {}
    notes = [
        f"light {i} is below the horizon, where a hemispherical fit knows nothing"
        for i in range(len(directions_i3))
        if directions_i3[i, 2] < 0
    ]
    seconds["relight"] = seconds["write"] = 0.0
    with _lend_view(fitted, opened, seconds) as view, progress_bar("relighting") as bar:
        step = max(1, _PICTURE_BYTES // view.picture_bytes)
        for first in range(0, len(names), step):
            since = time.perf_counter()
            pictures_ihwc = view.light(directions_i3[first : first + step])
            seconds["relight"] += time.perf_counter() - since
            for index, radiance in enumerate(pictures_ihwc, start=first):
                since = time.perf_counter()
                radiance *= np.float32(2.0**exposure)
                if names[index].lower().endswith(FLOAT_FORMATS):
                    write_image(names[index], radiance)
                else:
                    write_image(names[index], to_display(radiance, transfer or view.transfer))
                seconds["write"] += time.perf_counter() - since
                bar(index + 1, len(names))
    if as_json:
        print_json({"files": names, "notes": notes, "seconds": seconds, "device": opened.info.label})
        return
    print_notes(notes)
    print_facts({"image": ", ".join(names[:3]) + (" ..." if len(names) > 3 else ""), "time": seconds_line(seconds)})


@dataclass(frozen=True)
class _View:
    """What makes pictures of directions, the bytes of one, and the stack's transfer."""

    light: Callable[[NDArray[np.float64]], NDArray[np.float32]]
    picture_bytes: int
    transfer: str


@contextmanager
def _lend_view(path: str, device: Device, seconds: dict[str, float]) -> Iterator[_View]:
    """Lend a view to relight.

    An encoding with a basis of its own relights there: only the light vector is transformed.
    """
    from clrelight.codec import decode_view
    from clrelight.relight import relight as relight_coefficients
    from clrelight.store import file_schema, read_encoded

    if file_schema(path).startswith("encoded/"):
        since = time.perf_counter()
        encoded, source = read_encoded(path)
        view = decode_view(encoded, device)
        seconds["decode"] = time.perf_counter() - since
        if view is not None:
            picture_bytes = 4 * math.prod(encoded.shape[1:])
            yield _View(lambda directions_i3: view.relight(directions_i3, device), picture_bytes, source.transfer)
            return
    with lend_coefficients(path, device, seconds) as coefficients:
        picture_bytes = 4 * math.prod(coefficients.image_shape)
        yield _View(
            lambda directions_i3: relight_coefficients(coefficients, directions_i3, device=device),
            picture_bytes,
            coefficients.transfer,
        )


def _directions(light: list[tuple[float, float, float]], lights: str | None) -> NDArray[np.float64]:
    import numpy as np

    from clrelight.lights import read_directions, read_lp

    if bool(light) == (lights is not None):
        raise InputError("give the light by --light X,Y,Z or by --lights FILE")
    if lights is None:
        directions_i3 = np.array(light, np.float64)
    elif lights.lower().endswith(".lp"):
        directions_i3 = read_lp(Path(lights))[1]
    else:
        directions_i3 = read_directions(Path(lights))
    # Scaled by the largest component first, whose square could be beyond float64's range.
    largest = np.max(np.abs(directions_i3), axis=1, keepdims=True)
    bad = np.flatnonzero(~(np.isfinite(largest[:, 0]) & (largest[:, 0] > 0)))
    if bad.size:
        raise InputError(
            f"light {bad[0]} has the direction {directions_i3[bad[0]]}, expected finite numbers that are not all zero"
        )
    directions_i3 = directions_i3 / largest
    return directions_i3 / np.linalg.norm(directions_i3, axis=1, keepdims=True)


def _names(image: str, count: int) -> list[str]:
    folder, name = os.path.split(image)
    fields = list(_NUMBER_FIELD.finditer(name))
    if len(fields) > 1:
        raise InputError(f"{image} has {len(fields)} number fields, expected one, such as relit%03d.png")
    if fields:
        before, after = name[: fields[0].start()], name[fields[0].end() :]
        return [os.path.join(folder, before + fields[0][0] % index + after) for index in range(count)]
    if count > 1:
        raise InputError(f"{count} images need a number field in their name, such as relit%03d.png, got {image!r}")
    return [image]


COMMANDS = (relight,)
