"""Experiments written as TOML."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clrelight.errors import InputError, unknown
from clrelight.experiment.grid import (
    DEFAULT_SCENE,
    PAPER_METHODS,
    TYPE_NAMES,
    CodecSetting,
    Experiment,
    make_methods,
    make_settings,
)
from clrelight.fit import method_class
from clrelight.fit.precision import MIXED
from clrelight.fit.selection import AUTO
from clrelight.results import NO_CODEC
from datasets_synth.scenes import SCENES

_MODEL_KEYS = ("methods", "degrees", "holdout", "holdout_by", "weights", "sampling", "precision", "lights")
_TOML_KEYS = ("scenes", *_MODEL_KEYS, *SCENES, "method", "codec")


def load_experiment(path: str | os.PathLike[str]) -> Experiment:
    """Read an experiment from TOML (docs/experiments.md); InputError names what is not right."""
    file = Path(os.fsdecode(path))
    try:
        given = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"there is no file {file}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{file} is not valid TOML: {error}") from None
    try:
        return _experiment_of(given, file)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def experiment_text(experiment: Experiment, folder: Path, comment: str = "") -> str:
    """Return the TOML of an experiment with one method, for a file in `folder`; `load_experiment` reads it back."""
    if len(experiment.methods) != 1 or experiment.synth:
        raise ValueError("expected an experiment with one method on stack files")
    method = experiment.methods[0]
    scenes = [s if s in SCENES else os.path.relpath(s, folder).replace(os.sep, "/") for s in experiment.scenes]
    values: dict[str, Any] = {
        "scenes": scenes,
        "methods": [method if isinstance(method, str) else method.id],
        "degrees": list(experiment.degrees),
        "holdout": experiment.holdout,
        "holdout_by": None if experiment.holdout_by == "index" else experiment.holdout_by,
        "lights": experiment.lights,
        "weights": experiment.weights,
        "sampling": experiment.sampling,
        "precision": experiment.precision,
    }
    lines = [f"# {line}" for line in comment.splitlines()] + _assignments(values)
    if not isinstance(method, str) and (options := _assignments(method.to_config())):
        lines += ["", f"[method.{method.id}]", *options]
    for setting in experiment.codecs:
        lines += ["", "[[codec]]", *_assignments({"id": setting.id, **setting.config})]
    return "\n".join(lines) + "\n"


def _assignments(values: Mapping[str, Any]) -> list[str]:
    """Return ``key = value`` lines; what is None has no line, which means the same."""
    return [f"{key} = {_toml_value(value)}" for key, value in values.items() if value is not None]


def _toml_value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(_assignments(value)) + " }"
    return json.dumps(value, ensure_ascii=False)  # of text, numbers and lists of them, JSON is TOML


def _experiment_of(given: Mapping[str, Any], file: Path) -> Experiment:
    for key in given:
        if key not in _TOML_KEYS:
            raise unknown("key", key, _TOML_KEYS)
    names = _list_of(str, given, "methods", list(PAPER_METHODS))
    options = _typed(dict, given, "method", {})
    for name in options:
        if name != AUTO:
            method_class(name)
        if name not in names:
            raise InputError(f"[method.{name}] has options of a method that is not among the methods")
    methods = [method for name in names for method in make_methods(name, _typed(dict, options, name, {}))]
    settings: list[CodecSetting] = []
    for entry in _list_of(dict, given, "codec", [{"id": NO_CODEC}]):
        if not isinstance(entry.get("id"), str):
            raise InputError("every [[codec]] needs an id")
        settings += make_settings(entry["id"], {k: v for k, v in entry.items() if k != "id"})
    scenes = _list_of(str, given, "scenes", [DEFAULT_SCENE])
    for name in SCENES:
        if name in given and name not in scenes:
            raise InputError(f"[{name}] has options of a scene that is not among the scenes {', '.join(scenes)}")
    return Experiment(
        tuple(scene if scene in SCENES else str(file.parent / scene) for scene in scenes),
        tuple(methods),
        tuple(_degrees(given)),
        tuple(settings),
        _typed(int, given, "holdout", None),
        _typed(str, given, "weights", "uniform"),
        _typed(str, given, "sampling", "hemisphere"),
        {scene: _scene_options(scene, given) for scene in SCENES if scene in given},
        _typed(int, given, "lights", None),
        _typed(str, given, "precision", MIXED),
        _typed(str, given, "holdout_by", "index"),
    )


def _scene_options(scene: str, given: Mapping[str, Any]) -> dict[str, Any]:
    options = _typed(dict, given, scene, {})
    kinds = {option.name: option.kind for option in SCENES[scene].options}
    for key, value in options.items():
        if key not in kinds:
            raise InputError(f"{scene} has no option {key!r}; it has: {', '.join(kinds)}")
        _typed(kinds[key], options, key, value)
    return options


def _typed(kind: type, given: Mapping[str, Any], key: str, default: Any) -> Any:
    value = given.get(key, default)
    if key in given and type(value) is not kind:
        raise InputError(f"{key} must be {TYPE_NAMES[kind]}, got {value!r}")
    # No number of an experiment is this large, and NumPy takes none that is larger.
    if kind is int and value is not None and abs(value) >= 1 << 31:
        raise InputError(f"{key} {value} is too large")
    return value


def _degrees(given: Mapping[str, Any]) -> list[int | str]:
    degrees = _typed(list, given, "degrees", [6])
    for degree in degrees:
        if degree != AUTO and type(degree) is not int:
            raise InputError(f"degrees must be whole numbers or {AUTO!r}, got {degree!r}")
    return degrees


def _list_of(kind: type, given: Mapping[str, Any], key: str, default: list) -> list:
    values = _typed(list, given, key, default)
    for value in values:
        _typed(kind, {key: value}, key, None)
    return values
