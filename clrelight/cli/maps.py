"""Options of ``clrelight light`` and ``irradiance`` that say how an environment map is to be read."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import clip_negative_option, gather, layer_option
from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.jobs.report import Report
    from clrelight.lighting.environment import Environment


@dataclass(frozen=True)
class MapReading:
    """How an environment map is to be read; the fields are the options."""

    layout: str | None
    axes: str
    transfer: str
    layer: str | None
    clip_negative: bool

    def read(self, files: Sequence[str], report: Report) -> Environment:
        """Return the map in some files."""
        from clrelight.lighting.environment import read_environment

        since = time.perf_counter()
        environment, notes = read_environment(files, **asdict(self))
        report.note(*notes)
        report.add("read", since)
        return environment


def map_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that `MapReading` holds, which the command gets as `reading`."""
    command = gather(MapReading, "reading")(command)
    for option in (
        click.option(
            "--transfer",
            type=click.Choice(["srgb", "linear"]),
            default="srgb",
            show_default=True,
            help="Curve of maps of integers.",
        ),
        click.option(
            "--axes",
            default="z-up",
            show_default=True,
            help="Where x, y, z point in the map's view: z-up (right,forward,up), camera (right,up,back), probe "
            "(right,up,forward: published tables), or three such words; left, back, down flip.",
        ),
        click.option(
            "--layout",
            metavar="LAYOUT",
            help="latlong, angular, vertical-cross, horizontal-cross, vertical-strip, horizontal-strip or cube; "
            "default: by an EXR's envmap attribute, else the aspect.",
        ),
        layer_option,
        clip_negative_option,
    ):
        command = option(command)
    return command


def is_light_file(name: str) -> bool:
    """Return whether a file of this name is one of ours, and no map."""
    return name.lower().endswith((".h5", ".hdf5"))


def refuse_map_options(*others: str, but: Sequence[str] = ()) -> None:
    """Refuse options of maps, and `others`, where there is no map: --axes would not turn a sky, for one."""
    context = click.get_current_context()
    for name in ("layout", "axes", "transfer", *others, "layer", "clip_negative"):
        if name not in but and context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
            raise InputError(f"--{name.replace('_', '-')} is for maps (--env); --rotate turns any light")
