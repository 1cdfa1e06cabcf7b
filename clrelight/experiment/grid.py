"""What an experiment measures: a grid of scenes, methods, degrees, codecs and rates."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from clrelight.codec import Codec, codec_class
from clrelight.errors import InputError
from clrelight.fit import FitMethod, method_class
from clrelight.fit.plan import SAMPLINGS, WEIGHTINGS
from clrelight.fit.precision import MIXED, PRECISIONS
from clrelight.fit.selection import AUTO
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.holdout import HOLDOUTS
from clrelight.results import NO_CODEC

DEFAULT_SCENE = "ring"
PAPER_METHODS = ("uls", "sloan", "cls", "ceb")
PAPER_RATES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Bits per coefficient of the wavelet curve (noise-resistant-fitting, fig. 15)."""
PICTURE_RATES = (4.0, 1.0)
"""Of the wavelet rows, the rates whose pictures are kept: figures 4c, 8c, 12c; and where our wavelet's noise shows."""


_BITS = {NO_CODEC: 32.0, "half": 16.0, "s3tc": 224.0 / 48.0}
"""Per coefficient, of what is asked for no rate."""


TYPE_NAMES: dict[type, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    list: "a list",
    dict: "a table",
    Mapping: "a table",
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
        asked = self.config.get("bits" if self.id == "uniform" else "rate")
        return math.nan if asked is None else float(asked)

    @property
    def expected_bits(self) -> float:
        """About the bits of a coefficient that it will take; inf where they are not known beforehand."""
        return _BITS.get(self.id, math.inf) if math.isnan(self.rate) else self.rate

    @property
    def is_pictured(self) -> bool:
        """Whether the results keep its pictures: of the paper's curve of wavelet rates, those at `PICTURE_RATES`."""
        return self.id != "wavelet" or self.rate in PICTURE_RATES

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
        Names of `datasets_synth.scenes.SCENES`, or paths of stack files.
    methods : tuple of FitMethod or str
        ``"auto"`` leaves the choice to the lights, as `clrelight.fit.fit` does.
    degrees : tuple of int or str
        Likewise.
    codecs : tuple of CodecSetting
    holdout : int or None
        Keep every K-th light out of the fits and measure there too.
    weights, sampling : str
        As in `clrelight.fit.fit`.
    synth : mapping of str to mapping
        Options of scenes that are rendered, by their names.
    lights : int or None
        Fit so many well-spread lights only (`clrelight.sampling.split_chosen`).
    precision : str
        As in `clrelight.fit.fit`.
    holdout_by : str
        Which lights `holdout` keeps out, one of `clrelight.holdout.HOLDOUTS`.
    """

    scenes: tuple[str, ...] = (DEFAULT_SCENE,)
    methods: tuple[FitMethod | str, ...] = ()
    degrees: tuple[int | str, ...] = (6,)
    codecs: tuple[CodecSetting, ...] = ()
    holdout: int | None = None
    weights: str = "uniform"
    sampling: str = "hemisphere"
    synth: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    lights: int | None = None
    precision: str = MIXED
    holdout_by: str = "index"

    def __post_init__(self) -> None:
        for name in ("scenes", "methods", "degrees", "codecs"):
            values = getattr(self, name)
            if not values:
                raise InputError(f"an experiment needs {name}, got none")
            twice = next((value for value in values if values.count(value) > 1), None)
            if twice is not None:
                raise InputError(f"{name} holds {_label(twice)} twice")
        for degree in self.degrees:
            if degree != AUTO and (isinstance(degree, str) or not 0 <= degree <= MAX_DEGREE):
                raise InputError(f"degrees must be auto or 0 to {MAX_DEGREE}, got {degree}")
        if self.holdout is not None and self.holdout < 2:
            raise InputError(f"holdout must be at least 2 (every K-th light is kept out), got {self.holdout}")
        if self.lights is not None and self.lights < 1:
            raise InputError(f"lights must be at least 1 (so many are fitted), got {self.lights}")
        for name, known in (
            ("weights", WEIGHTINGS),
            ("sampling", SAMPLINGS),
            ("precision", PRECISIONS),
            ("holdout_by", HOLDOUTS),
        ):
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
    scene: str = DEFAULT_SCENE,
    *,
    methods: tuple[str, ...] = PAPER_METHODS,
    degrees: tuple[int | str, ...] = (6,),
    codecs: tuple[str, ...] = (NO_CODEC, "half", "s3tc", "uniform", "wavelet"),
    rates: tuple[float, ...] | None = None,
    holdout: int | None = None,
    holdout_by: str = "index",
    precision: str = MIXED,
    synth: Mapping[str, Any] | None = None,
) -> Experiment:
    """Return the paper's experiment (table I and III, figures 7 and 15) on one scene.

    `rates` are those of every codec that takes one; without, `PAPER_RATES` of wavelet and the others' own default.
    `synth` are options of the scene, where it is one that is rendered.
    """
    rated = [name for name in codecs if name != NO_CODEC and "rate" in get_type_hints(codec_class(name))]
    if rates is not None and not rated:
        raise InputError(f"rates are for codecs that take one, such as wavelet, not for {', '.join(codecs)}")
    settings: list[CodecSetting] = []
    for name in codecs:
        chosen = rates or (PAPER_RATES if name == "wavelet" else None)
        settings += make_settings(name, {"rate": list(chosen)} if chosen and name in rated else {})
    made = [method for name in methods for method in make_methods(name, {})]
    return Experiment(
        (scene,),
        tuple(made),
        degrees,
        tuple(settings),
        holdout,
        synth={scene: dict(synth)} if synth else {},
        precision=precision,
        holdout_by=holdout_by,
    )


def make_methods(method_id: str, config: Mapping[str, Any]) -> list[FitMethod | str]:
    """Return one method for each combination of the options that are lists; ``"auto"`` has none."""
    if method_id == AUTO:
        if config:
            raise InputError(f"auto chooses the options too; {', '.join(config)} needs a method by name")
        return [AUTO]
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
    for key, value in config.items():
        if value == []:
            raise InputError(f"{key} needs at least one value, got an empty list")
    axes = [[(key, v) for v in (value if isinstance(value, list) else [value])] for key, value in config.items()]
    return [dict(combination) for combination in itertools.product(*axes)]


def _with_types(kind: type, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options as their declared types, so that 1 and 1.0 make one row; InputError if they are not."""
    hints = get_type_hints(kind)
    typed = dict(options)
    for key, value in options.items():
        if key not in hints:
            continue  # named by from_config, with the options that there are
        parts = get_args(hints[key]) if isinstance(hints[key], UnionType) else (hints[key],)
        allowed = {get_origin(part) or part for part in parts}
        if float in allowed and type(value) is int and abs(value) < 1 << 53:
            typed[key] = float(value)
        elif not any(isinstance(value, each) for each in allowed) or (type(value) is bool and bool not in allowed):
            wanted = " or ".join(name for each, name in TYPE_NAMES.items() if each in allowed)
            raise InputError(f"{kind.id}: {key} must be {wanted}, got {value!r}")  # type: ignore[attr-defined]
    return typed
