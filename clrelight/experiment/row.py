"""One row of an experiment: what was asked for, which identifies it, and how values are written into its fields."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from clrelight.fit.selection import AUTO
from clrelight.results import ROW_DTYPE, Results

_IDENTITY = (
    *("scene", "method", "degree", "fit_config", "codec", "codec_config"),
    *("n_light", "n_holdout", "height", "width", "channel", "seed"),
)
_ASKED_ALWAYS = ("auto", "weights", "sampling", "precision", "lights", "holdout_by", "stack")
"""What `fit_config` holds beside a method's own options."""


def row_key(row: np.void) -> tuple:
    """Return what a row was asked for: rows that share it are one measurement."""
    asked = {name: row[name] for name in _IDENTITY}
    config = _asked_config(row["fit_config"])
    chosen = str(config.get("auto", ""))
    if "degree" in chosen:
        asked["degree"] = AUTO
    if "method" in chosen:
        # What was chosen, with its options, is no part of the question.
        asked["method"], asked["fit_config"] = AUTO, json_text({name: config.get(name) for name in _ASKED_ALWAYS})
    return tuple(asked.values())


def _asked_config(fit_config: bytes) -> dict[str, Any]:
    try:
        config = json.loads(fit_config)
    except ValueError:  # cut off at the field's length
        return {}
    return config if isinstance(config, dict) else {}


def json_text(config: Mapping[str, Any]) -> str:
    """Return a configuration as rows hold it: the same text for the same values."""
    return json.dumps(config, sort_keys=True, separators=(",", ":"))


def fixed(name: str, value: Any) -> Any:
    """Return a value as a field of a row holds it: text as UTF-8, cut off between characters where it is too long."""
    dtype = ROW_DTYPE[name]
    if dtype.kind != "S":
        return value
    encoded = str(value).encode("utf-8")
    return encoded[: dtype.itemsize].decode("utf-8", "ignore").encode("utf-8")


def fill(row: np.void, values: Mapping[str, Any]) -> None:
    """Set some fields of a row."""
    for name, value in values.items():
        row[name] = fixed(name, value)


def append(results: Results, row: np.void) -> Results:
    """Return the results with one row more."""
    return replace(results, table=np.concatenate([results.table, np.array([row], ROW_DTYPE)]))


def without_quality(row: np.void, reason: str) -> np.void:
    """Return the row of a fit or codec that refused: a result too, with the reason as its note."""
    unknown = ("bits_per_coefficient", "entropy_bits", "seconds_encode", "seconds_decode", "seconds_measure")
    of_coding = ("coding_psnr_independent", "coding_psnr_predicted", "coding_psnr")
    for name in (*unknown, *of_coding, "psnr_mean", "psnr_pooled", "psnr_mean_holdout", "psnr_pooled_holdout"):
        row[name] = math.nan
    row["encoded_bytes"] = 0
    row["note"] = fixed("note", reason)
    return row
