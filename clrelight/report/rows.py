"""Rows of a results table as a report wants them: named, ordered, and found by key."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from clrelight.errors import InputError
from clrelight.results import NO_CODEC, Results

METHOD_LABELS = {"uls": "ULS", "sloan": "Sloan ULS", "cls": "CLS", "ceb": "CEB"}
"""The paper's methods, in its order; others follow by name, under their own id."""

CODEC_LABELS = {NO_CODEC: "plain", "half": "half float", "s3tc": "S3TC", "uniform": "uniform", "wavelet": "wavelet"}
"""Ways to store coefficients (noise-resistant-fitting, section III-B), in its order; others follow by name."""


class Setting(NamedTuple):
    """A codec with the rate asked of it, as picture keys spell it: ``CODEC[@RATE]``."""

    codec: str
    rate: str  # "%g", or "" where the codec is not asked for one

    @property
    def label(self) -> str:
        """Name for people."""
        name = CODEC_LABELS.get(self.codec, self.codec)
        return f"{name} {self.rate} bit" if self.rate else name

    @property
    def rank(self) -> tuple[int, str, float]:
        """Sort key: the paper's codecs first, then by name; generous rates first."""
        return *_rank(self.codec, CODEC_LABELS), -float(self.rate or "inf")


class PictureKey(NamedTuple):
    """The parts of ``SCENE/METHOD/DEGREE/CODEC[@RATE]``."""

    scene: str
    method: str
    degree: int
    setting: Setting


def _rank(name: str, known: Iterable[str]) -> tuple[int, str]:
    order = list(known)
    return (order.index(name), "") if name in order else (len(order), name)


def method_rank(method: str) -> tuple[int, str]:
    """Sort key of a method: the paper's first."""
    return _rank(method, METHOD_LABELS)


def method_label(method: str) -> str:
    """Return a method's name for people."""
    return METHOD_LABELS.get(method, method)


def text(value: bytes | str) -> str:
    """Return a fixed-length field of a row as a string."""
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)


def setting_of(row: np.void) -> Setting:
    """Return codec and rate of a row."""
    rate = float(row["rate"])
    return Setting(text(row["codec"]), f"{rate:g}" if np.isfinite(rate) else "")


def scene_names(results: Results) -> list[str]:
    """Return the scenes in order of appearance."""
    return list(dict.fromkeys(text(name) for name in results.table["scene"]))


def scene_rows(results: Results, scene: str) -> list[np.void]:
    """Return one scene's rows by degree, method, codec and falling rate."""
    rows = [row for row in results.table if text(row["scene"]) == scene]
    return sorted(rows, key=lambda row: (int(row["degree"]), method_rank(text(row["method"])), setting_of(row).rank))


def rows_by_key(rows: Iterable[np.void]) -> dict[tuple[str, int, Setting], np.void]:
    """Return the rows by (method, degree, setting); of rows that share a key, the first."""
    found: dict[tuple[str, int, Setting], np.void] = {}
    for row in rows:
        found.setdefault((text(row["method"]), int(row["degree"]), setting_of(row)), row)
    return found


def differing_options(rows: Sequence[np.void]) -> list[str]:
    """Return per row the options in which it differs from others of its scene and method, or scene and codec.

    So ``iterations=8`` where a method was fitted with several numbers of iterations, and mostly nothing: a rate asked
    for is no such option, it has its own column.
    """
    found: list[list[str]] = [[] for _ in rows]
    for name, field in (("method", "fit_config"), ("codec", "codec_config")):
        configs = [_config(row[field]) for row in rows]
        kinds = [(text(row["scene"]), text(row[name])) for row in rows]
        for kind in set(kinds):
            members = [i for i, each in enumerate(kinds) if each == kind]
            for key in sorted({key for i in members for key in configs[i]}):
                is_rate = all(configs[i].get(key) in (None, rows[i]["rate"]) for i in members)
                if not is_rate and len({repr(configs[i].get(key)) for i in members}) > 1:
                    for i in (i for i in members if key in configs[i]):
                        found[i].append(f"{key}={configs[i].get(key)}")
    return [", ".join(words) for words in found]


def _config(value: bytes) -> dict[str, object]:
    try:
        config = json.loads(value)
    except (ValueError, RecursionError):  # cut off at the field's length, or of another program
        return {}
    return config if isinstance(config, dict) else {}


def parse_picture_key(key: str) -> PictureKey | None:
    """Take ``SCENE/METHOD/DEGREE/CODEC[@RATE]`` apart; None for ``SCENE/reference``; InputError otherwise."""
    if re.fullmatch(r".+/reference", key):
        return None
    match = re.fullmatch(r"(.+)/([^/]+)/(\d+)/([^/@]+)(?:@([^/@]+))?", key)
    try:
        if match:
            scene, method, degree, codec, rate = match.groups()
            return PictureKey(scene, method, int(degree), Setting(codec, f"{float(rate):g}" if rate else ""))
    except ValueError:
        pass
    raise InputError(f"picture {key!r} is neither SCENE/reference nor SCENE/METHOD/DEGREE/CODEC[@RATE]")


def parse_profile_key(key: str) -> tuple[str, str, int]:
    """Take ``SCENE/METHOD/DEGREE`` apart; InputError if it is something else."""
    match = re.fullmatch(r"(.+)/([^/]+)/(\d+)", key)
    if not match:
        raise InputError(f"profile {key!r} is not SCENE/METHOD/DEGREE")
    return match[1], match[2], int(match[3])


def all_methods(results: Results) -> list[str]:
    """Return the methods in the paper's order: what colours follow, in every picture alike."""
    named = {text(name) for name in results.table["method"]}
    return sorted(named | {parse_profile_key(key)[1] for key in results.profiles}, key=method_rank)


def file_suffixes(scenes: Iterable[str]) -> dict[str, str]:
    """Return a distinct, portable file name suffix per scene: ``_SCENE``, or nothing where there is one scene."""
    scenes = list(scenes)
    if len(scenes) == 1:
        return {scenes[0]: ""}
    suffixes: dict[str, str] = {}
    taken: set[str] = set()
    for scene in scenes:
        stem = suffix = "_" + (re.sub(r"[^A-Za-z0-9]+", "-", scene).strip("-") or "scene")
        count = 1
        while suffix.casefold() in taken:
            count += 1
            suffix = f"{stem}-{count}"
        taken.add(suffix.casefold())
        suffixes[scene] = suffix
    return suffixes
