"""What is asked of an encoding: which codec, in which coordinates, how small or how good."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from clrelight import codec as codecs
from clrelight.codec import Codec
from clrelight.codec.workspace import Shape
from clrelight.errors import InputError

BASES = ("sh", "whitened", "klt")
"""Coordinates that are coded: as fitted; in the metric of the image; its principal axes."""

_MAX_DECIBELS = 1000.0
_NAMED = ("half", "s3tc", "bc6h", "uniform", "wavelet", "jpeg2000", "vq", "cpca", "klt")
"""Codecs that are asked for by name; others are these in other coordinates."""
_OWN = "klt"
_PLAIN = "s3tc"
_SIZES = ("rate", "step")


@dataclass(frozen=True)
class CodingRequest:
    """What was asked of an encoding, once it makes sense."""

    codec: str | Codec
    basis: str
    byte_budget: int | None
    target_psnr: float | None
    options: Mapping[str, Any]

    def make(self, shape: Shape) -> Codec:
        """Return the codec for a map."""
        if isinstance(self.codec, Codec):
            return self.codec
        options = dict(self.options)
        if self.byte_budget is not None:
            size = {"byte_budget": self.byte_budget}
            options |= size if self.codec == "klt" else {"rate": 8.0 * self.byte_budget / math.prod(shape)}
        return _make(self.codec, self.basis, options)


def read_request(
    codec: str | Codec | None,
    basis: str,
    byte_budget: int | None,
    target_psnr: float | None,
    with_stack: bool,
    options: Mapping[str, Any],
) -> CodingRequest:
    """Return what is wanted; InputError says what contradicts itself before the fit is read."""
    given = {name: value for name, value in options.items() if value is not None}
    if basis not in BASES:
        raise InputError(f"basis must be one of {', '.join(BASES)}, got {basis!r}")
    if isinstance(codec, Codec):
        if given or basis != "sh" or byte_budget is not None or target_psnr is not None:
            raise InputError(f"options, a basis and a size belong to a codec given by its id; this is {codec}")
        return CodingRequest(codec, basis, None, None, {})
    if target_psnr is not None:
        _check_target(target_psnr, with_stack)
        turned = basis == "whitened" or (basis == "klt" and codec not in (None, "klt"))
        if byte_budget is not None or given or turned:
            raise InputError("--target-psnr says the size already, leave out --bytes, --basis and options of codecs")
    if byte_budget is not None and any(name in given for name in _SIZES):
        raise InputError("--bytes says the size already, leave out --rate and --step")
    name = str(codec or "") or _codec_for(basis, byte_budget is not None or target_psnr is not None, given)
    if byte_budget is not None and not hasattr(codecs.codec_class(name), "rate"):
        raise InputError(f"--bytes: what {name} takes follows from its options; klt, wavelet and jpeg2000 meet a size")
    if target_psnr is None and byte_budget is None:
        _make(name, basis, given)
    return CodingRequest(name, basis, byte_budget, target_psnr, given)


def _check_target(target_psnr: float, with_stack: bool) -> None:
    if not isinstance(target_psnr, int | float | np.number) or not abs(target_psnr) <= _MAX_DECIBELS:
        raise InputError(f"--target-psnr must be a number of decibels, got {target_psnr}")
    if not with_stack:
        raise InputError("--target-psnr needs --stack STACK, the photographs to measure against")


def _codec_for(basis: str, sized: bool, options: Mapping[str, Any]) -> str:
    """Return the codec where none is named: klt meets sizes best, s3tc is the papers'; InputError if neither can.

    Options say more: those that only one of the two has choose it, those of neither are told whose they are.
    """
    names = set(options) - {"planes"}
    sized = sized or any(name in names for name in _SIZES)
    if basis == "whitened":
        likely = ["wavelet"] if sized else [_PLAIN]  # klt is whitened itself
    elif basis == "klt":
        likely = [_OWN] if "planes" not in options else [_PLAIN]
    else:
        likely = [_OWN] if sized else [_PLAIN, _OWN]
    for name in likely:
        if names <= _options_of(name):
            return name
    turned = basis != "sh"  # klt turns and whitens by itself
    every = {option for name in _NAMED for option in _options_of(name)}
    if unknown := sorted(names - every):
        raise InputError(f"no codec has an option {', '.join(map(repr, unknown))}: see docs/codecs.md")
    others = [name for name in _NAMED if names <= _options_of(name) and not (turned and name == _OWN)]
    told = ", ".join(f"--{name}" for name in sorted(names))
    if not others:
        raise InputError(f"no codec has all of {told}: see docs/codecs.md for what each has")
    whose = " or ".join(f"--codec {name}" for name in others)
    raise InputError(f"{told} without a codec: add {whose}")


def _options_of(codec: str) -> set[str]:
    return {each.name for each in fields(codecs.codec_class(codec))}  # type: ignore[arg-type]


def _make(codec: str, basis: str, options: Mapping[str, Any]) -> Codec:
    """Return the codec in a basis; InputError where the two do not go together."""
    rest = dict(options)
    if basis == "whitened":
        return codecs.codec_class("whitened").from_config({"codec": codec, "options": rest})
    planes = rest.pop("planes", None)
    if basis == "klt" and codec != "klt":
        config = {"codec": codec, "options": rest, "planes": planes}
        return codecs.codec_class("principal").from_config(config)
    if planes is not None:
        raise InputError("--planes is for --basis klt with a codec other than klt, which chooses its own")
    return codecs.codec_class(codec).from_config(rest)


def advise_codecs(codec: Codec, shape: Shape, memory: int | None) -> str:
    """Return what to do where a codec takes more of a map at once than a budget: how much it takes, what takes less."""
    advice = f"give --memory {-(-codec.bytes_to_encode(shape) >> 20)}MiB"
    defaults = {name: codecs.codec_class(name).from_config({}) for name in _NAMED}
    less = [name for name, each in defaults.items() if memory is not None and each.bytes_to_encode(shape) <= memory]
    return f"{advice}, or --codec {', '.join(less[:-1])}{' or ' if less[:-1] else ''}{less[-1]}" if less else advice
