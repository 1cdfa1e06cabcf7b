"""Options and argument types that several commands share."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import fields
from typing import Any, TypeVar

import click

from clrelight.errors import InputError

Command = TypeVar("Command", bound=Callable[..., Any])

_LARGEST = (1 << 31) - 1


class ByteCount(click.ParamType):
    """A number of bytes with an optional unit: 1GiB, 512M, 2e9."""

    name = "bytes"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the number of bytes."""
        if isinstance(value, int):
            return value
        from clrelight.jobs.written import count_bytes

        try:
            return count_bytes(value)
        except InputError as error:
            self.fail(str(error), param, ctx)


class Exposure(click.ParamType):
    """Stops, or auto."""

    name = "STOPS|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | None:
        """Return the stops, None for auto."""
        from clrelight.jobs.written import count_stops

        try:
            return count_stops(value)
        except InputError as error:
            self.fail(str(error), param, ctx)


class DegreeType(click.ParamType):
    """A whole number, or auto."""

    name = "integer|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        """Return the number, or ``"auto"``."""
        if value == "auto" or isinstance(value, int):
            return value
        try:
            return int(value)
        except ValueError:
            self.fail(f"{value!r} is not a whole number or auto", param, ctx)


class Numbers(click.ParamType):
    """Numbers separated by commas, of a fixed count where one is given."""

    def __init__(self, kind: type, example: str, count: int | None = None) -> None:
        self.kind, self.example, self.count = kind, example, count
        self.name = example

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple:
        """Return the numbers as a tuple."""
        if isinstance(value, tuple):
            return value
        try:
            numbers = tuple(self.kind(part) for part in str(value).split(","))
        except ValueError:
            numbers = ()
        if not numbers or (self.count and len(numbers) != self.count) or not all(map(_is_sensible, numbers)):
            wanted = f"{self.count} numbers" if self.count else "one or more numbers"
            if self.kind is int:
                wanted = wanted.replace("numbers", "whole numbers")
            self.fail(f"expected {wanted} separated by commas, such as {self.example}, got {value!r}", param, ctx)
        return numbers


def _is_sensible(number: float) -> bool:
    return abs(number) <= _LARGEST if isinstance(number, int) else math.isfinite(number)


region_option = click.option(
    "--region", type=Numbers(int, "X,Y,W,H", 4), help="A part of the image, in pixels: first column and row, and sizes."
)
level_option = click.option(
    "--level",
    type=click.IntRange(0, 5),
    default=0,
    show_default=True,
    help="Halve width and height so often (klt, wavelet).",
)
salvage_option = click.option(
    "--salvage",
    is_flag=True,
    help="Take a damaged file (klt, wavelet): what is damaged is named, and filled from what is left.",
)


class Degrees(Numbers):
    """SH degrees separated by commas, among which ``auto`` leaves the choice to the fit."""

    def __init__(self) -> None:
        super().__init__(int, "4,6,auto")

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple:
        """Return the numbers, and ``"auto"``, as a tuple."""
        if isinstance(value, tuple):
            return value
        parts = [part.strip() for part in str(value).split(",")]
        numbers = [part for part in parts if part != "auto"]
        known = iter(super().convert(",".join(numbers), param, ctx) if numbers else ())
        return tuple(part if part == "auto" else next(known) for part in parts)


class Names(click.ParamType):
    """Names separated by commas, none of them twice."""

    name = "a,b,..."

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Return the names as a tuple."""
        if isinstance(value, tuple):
            return value
        names = tuple(part.strip() for part in str(value).split(",") if part.strip())
        if not names:
            self.fail(f"expected one or more names separated by commas, got {value!r}", param, ctx)
        return names


def whole_number(least: int, most: int = _LARGEST) -> click.IntRange:
    """Return the type of an option that is a whole number within bounds."""
    return click.IntRange(least, most)


def holdout_option(what: str) -> Callable[[Command], Command]:
    """Add ``--holdout``."""
    return click.option(
        "--holdout",
        type=whole_number(2),
        metavar="K",
        help=f"Keep every K-th light out of {what} and measure there too.",
    )


holdout_by_option = click.option(
    "--holdout-by",
    type=click.Choice(["index", "place"]),
    help="Which lights --holdout keeps out: every K-th as photographed (index, default), or blocks as large as the "
    "gaps between lights (place).",
)
basis_option = click.option(
    "--basis",
    default="sh",
    show_default=True,
    help="Functions of the light: sh, or of the hemisphere (methods uls and spline) hsh, gram-schmidt, zernike, "
    "makhotkin or haar.",
)
within_option = click.option(
    "--within",
    type=float,
    default=0.05,
    show_default=True,
    metavar="DB",
    help="Decibels at unseen lights that auto may give for fewer coefficients.",
)
device_option = click.option(
    "--device",
    metavar="DEVICE",
    help="OpenCL device: gpu, cpu, pocl, an index or part of a name, @4, @8 or @16 behind it for so many lanes "
    "(clrelight devices); default: $CLRELIGHT_DEVICE, else the first sound one: GPUs, the packaged PoCL, others.",
)
perceptual_option = click.option(
    "--perceptual",
    is_flag=True,
    help="Measure FLIP and colour differences too, at a sample of lights with standard errors (extra flip).",
)
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object and nothing else on standard output."
)
preview_option = click.option(
    "--preview",
    type=click.Path(),
    metavar="PICTURE",
    help="Write a small picture beside the file, of what it holds under a light from the upper left.",
)
order_option = click.option(
    "--order",
    type=click.Choice(["file", "morton", "hilbert", "graph", "blocks", "sorted"]),
    default="file",
    show_default=True,
    help="Order of the vertices, for codecs; blocks and sorted are images of them.",
)
layer_option = click.option(
    "--layer",
    metavar="NAME",
    help="Layer or part of EXR images, or page of TIFFs (from 1); default: R, G, B, else the one named as the "
    "picture, such as ViewLayer.Combined.",
)
clip_negative_option = click.option(
    "--clip-negative",
    is_flag=True,
    help="Set negative radiance to 0 however large; default: only tiny values, as lossy files have.",
)


def memory_option(default: str, what: str) -> Callable[[Command], Command]:
    """Add ``--memory``."""
    return click.option(
        "--memory", type=ByteCount(), default=default, show_default=True, metavar="BYTES", help=f"Budget for {what}."
    )


def gather(record: type, name: str) -> Callable[[Command], Callable[..., Any]]:
    """Hand a command those of its options that are fields of a dataclass as one record, under `name`."""

    def decorate(command: Command) -> Callable[..., Any]:
        @functools.wraps(command)
        def gathered(**options: Any) -> Any:
            held = {each.name: options.pop(each.name) for each in fields(record)}
            return command(**{name: record(**held)}, **options)

        return gathered

    return decorate


def is_given(context: click.Context, name: str) -> bool:
    """Return whether an option stands on the command line."""
    return context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE


def given(**options: Any) -> dict[str, Any]:
    """Return the options that the user gave (those that are not None)."""
    return {name: value for name, value in options.items() if value is not None}
