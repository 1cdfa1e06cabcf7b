"""What an experiment measures: a grid of scenes, methods, degrees, codecs and rates."""

from __future__ import annotations

import itertools
import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clrelight.codec import Codec, codec_class
from clrelight.errors import InputError
from clrelight.fit import FitMethod, method_class
from clrelight.results import NO_CODEC

RING = "ring"
PAPER_METHODS = ("uls", "sloan", "cls", "ceb")
PAPER_RATES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Bits per coefficient of the wavelet curve, figure 15."""


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
        return float(self.config.get("rate", math.nan))

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

    @property
    def row_count(self) -> int:
        """Rows of the finished table."""
        return len(self.scenes) * len(self.methods) * len(self.degrees) * len(self.codecs)


def paper_experiment(
    scene: str = RING,
    *,
    methods: tuple[str, ...] = PAPER_METHODS,
    degrees: tuple[int, ...] = (6,),
    codecs: tuple[str, ...] = (NO_CODEC, "half", "s3tc", "uniform", "wavelet"),
    rates: tuple[float, ...] = PAPER_RATES,
    holdout: int | None = None,
    ring: Mapping[str, Any] | None = None,
) -> Experiment:
    """Return the paper's experiment (table I and III, figures 7 and 15) on one scene."""
    settings: list[CodecSetting] = []
    for name in codecs:
        settings += make_settings(name, {"rate": list(rates)} if name == "wavelet" else {})
    return Experiment(
        (scene,),
        tuple(method_class(name)() for name in methods),
        degrees,
        tuple(settings),
        holdout,
        ring=dict(ring or {}),
    )


def make_settings(codec_id: str, config: Mapping[str, Any]) -> list[CodecSetting]:
    """Return one setting for each combination of the options that are lists."""
    if codec_id == NO_CODEC:
        if config:
            raise InputError(f"codec {NO_CODEC!r} has no options, got {', '.join(config)}")
        return [CodecSetting()]
    kind = codec_class(codec_id)
    axes = [[(key, v) for v in (value if isinstance(value, list) else [value])] for key, value in config.items()]
    return [CodecSetting(kind.from_config(dict(combination))) for combination in itertools.product(*axes)]


_TOML_KEYS = ("scenes", "methods", "degrees", "holdout", "weights", "sampling", "ring", "method", "codec")


def load_experiment(path: str | os.PathLike[str]) -> Experiment:
    """Read an experiment from TOML (docs/experiments.md); InputError names what is not right."""
    file = Path(path)
    try:
        given = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"no such file: {file}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{file} is not valid TOML: {error}") from None
    for key in given:
        if key not in _TOML_KEYS:
            raise InputError(f"{file}: unknown key {key!r}; known are {', '.join(_TOML_KEYS)}")
    options = _typed(file, given, "method", dict, {})
    methods = []
    for name in _typed(file, given, "methods", list, list(PAPER_METHODS)):
        methods.append(method_class(name).from_config(options.get(name, {})))
    settings: list[CodecSetting] = []
    for entry in _typed(file, given, "codec", list, [{"id": NO_CODEC}]):
        if not isinstance(entry, dict) or not isinstance(entry.get("id"), str):
            raise InputError(f"{file}: every [[codec]] needs an id")
        settings += make_settings(entry["id"], {k: v for k, v in entry.items() if k != "id"})
    scenes = [
        scene if scene == RING else str(file.parent / scene) for scene in _typed(file, given, "scenes", list, [RING])
    ]
    degrees = _typed(file, given, "degrees", list, [6])
    if not scenes or not methods or not settings or not degrees or not all(type(d) is int for d in degrees):
        raise InputError(f"{file}: scenes, methods, degrees (whole numbers) and codecs must not be empty")
    return Experiment(
        tuple(scenes),
        tuple(methods),
        tuple(degrees),
        tuple(settings),
        _typed(file, given, "holdout", int, None),
        _typed(file, given, "weights", str, "uniform"),
        _typed(file, given, "sampling", str, "hemisphere"),
        _typed(file, given, "ring", dict, {}),
    )


def _typed(file: Path, given: Mapping[str, Any], key: str, kind: type, default: Any) -> Any:
    value = given.get(key, default)
    if key in given and (not isinstance(value, kind) or isinstance(value, bool)):
        raise InputError(f"{file}: {key} must be a {kind.__name__}, got {value!r}")
    return value
