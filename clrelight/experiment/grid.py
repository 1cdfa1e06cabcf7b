"""What an experiment measures: a grid of scenes, methods, degrees, codecs and rates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from clrelight.basis import MAX_DEGREE
from clrelight.codec import Codec, codec_class
from clrelight.errors import InputError
from clrelight.fit import FitMethod, method_class
from clrelight.fit.plan import SAMPLINGS, WEIGHTINGS
from clrelight.results import NO_CODEC

RING = "ring"
PAPER_METHODS = ("uls", "sloan", "cls", "ceb")
PAPER_RATES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Bits per coefficient of the wavelet curve, figure 15."""
PICTURE_RATE = 4.0
"""Of the wavelet rows, the rate whose pictures are kept (figures 4c, 8c, 12c)."""


TYPE_NAMES = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    list: "a list",
    dict: "a table",
}


@dataclass(frozen=True)
class CodecSetting:
    """A codec with its options; `codec` is None for the float32 coefficients as they are."""

    codec: Codec | None = None

    @property
    def id(self) -> str:
        """Name in the table."""
        return NO_CODEC if self.codec is None else self.codec.id

    @property
    def config(self) -> dict[str, Any]:
        """Options as a JSON object."""
        return {} if self.codec is None else self.codec.to_config()

    @property
    def rate(self) -> float:
        """Bits per coefficient asked for, NaN where the codec is not asked for any."""
        return float(self.config.get("rate", self.config.get("bits", math.nan)))

    @property
    def is_pictured(self) -> bool:
        """Whether the results keep its pictures: of a codec that takes any rate, only at `PICTURE_RATE`."""
        return self.config.get("rate", PICTURE_RATE) == PICTURE_RATE

    @property
    def picture_name(self) -> str:
        """Last part of a picture's key."""
        return self.id if math.isnan(self.rate) else f"{self.id}@{self.rate:g}"


@dataclass(frozen=True)
class Experiment:
    """What to measure.

    Attributes
    ----------
    scenes : tuple of str
        ``"ring"`` or paths of stack files.
    methods : tuple of FitMethod
    degrees : tuple of int
    codecs : tuple of CodecSetting
    holdout : int or None
        Keep every K-th light out of the fits and measure there too.
    weights, sampling : str
        As in `clrelight.fit.fit`.
    ring : mapping
        Arguments of `datasets_synth.ring.render_ring`.
    """

    scenes: tuple[str, ...] = (RING,)
    methods: tuple[FitMethod, ...] = ()
    degrees: tuple[int, ...] = (6,)
    codecs: tuple[CodecSetting, ...] = ()
    holdout: int | None = None
    weights: str = "uniform"
    sampling: str = "hemisphere"
    ring: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("scenes", "methods", "degrees", "codecs"):
            values = getattr(self, name)
            if not values:
                raise InputError(f"an experiment needs {name}, got none")
            twice = next((value for value in values if values.count(value) > 1), None)
            if twice is not None:
                raise InputError(f"{name} holds {_label(twice)} twice")
        for degree in self.degrees:
            if not 0 <= degree <= MAX_DEGREE:
                raise InputError(f"degrees must be 0 to {MAX_DEGREE}, got {degree}")
        if self.holdout is not None and self.holdout < 2:
            raise InputError(f"holdout must be at least 2 (every K-th light is kept out), got {self.holdout}")
        for name, known in (("weights", WEIGHTINGS), ("sampling", SAMPLINGS)):
            if getattr(self, name) not in known:
                raise InputError(f"{name} must be one of {', '.join(known)}, got {getattr(self, name)!r}")

    @property
    def row_count(self) -> int:
        """Rows of the finished table."""
        return len(self.scenes) * len(self.methods) * len(self.degrees) * len(self.codecs)


def _label(value: Any) -> str:
    if isinstance(value, FitMethod | CodecSetting):
        options = value.to_config() if isinstance(value, FitMethod) else value.config
        return f"{value.id} {options}" if options else value.id
    return repr(value)


def paper_experiment(
    scene: str = RING,
    *,
    methods: tuple[str, ...] = PAPER_METHODS,
    degrees: tuple[int, ...] = (6,),
    codecs: tuple[str, ...] = (NO_CODEC, "half", "s3tc", "uniform", "wavelet"),
    rates: tuple[float, ...] | None = None,
    holdout: int | None = None,
    ring: Mapping[str, Any] | None = None,
) -> Experiment:
    """Return the paper's experiment (table I and III, figures 7 and 15) on one scene.

    `rates` are those of the wavelet codec; `PAPER_RATES` without.
    """
    if rates is not None and "wavelet" not in codecs:
        raise InputError(f"rates are of the codec wavelet, which is not among the codecs {', '.join(codecs)}")
    settings: list[CodecSetting] = []
    for name in codecs:
        settings += make_settings(name, {"rate": list(rates or PAPER_RATES)} if name == "wavelet" else {})
    made = [method for name in methods for method in make_methods(name, {})]
    return Experiment((scene,), tuple(made), degrees, tuple(settings), holdout, ring=dict(ring or {}))


def make_methods(method_id: str, config: Mapping[str, Any]) -> list[FitMethod]:
    """Return one method for each combination of the options that are lists."""
    kind = method_class(method_id)
    return [kind.from_config(_with_types(kind, options)) for options in _combinations(config)]


def make_settings(codec_id: str, config: Mapping[str, Any]) -> list[CodecSetting]:
    """Return one setting for each combination of the options that are lists."""
    if codec_id == NO_CODEC:
        if config:
            raise InputError(f"codec {NO_CODEC!r} has no options, got {', '.join(config)}")
        return [CodecSetting()]
    kind = codec_class(codec_id)
    return [CodecSetting(kind.from_config(_with_types(kind, options))) for options in _combinations(config)]


def _combinations(config: Mapping[str, Any]) -> list[dict[str, Any]]:
    axes = [[(key, v) for v in (value if isinstance(value, list) else [value])] for key, value in config.items()]
    return [dict(combination) for combination in itertools.product(*axes)]


def _with_types(kind: type, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options as the types of their defaults, so that 1 and 1.0 make one row; InputError if they are not."""
    defaults = {each.name: each.default for each in fields(kind)}
    typed = dict(options)
    for key, value in options.items():
        wanted = type(defaults.get(key, value))
        if wanted is float and type(value) is int and abs(value) < 1 << 53:
            typed[key] = float(value)
        elif type(value) is not wanted:
            raise InputError(f"{kind.id}: {key} must be {TYPE_NAMES[wanted]}, got {value!r}")  # type: ignore[attr-defined]
    return typed
