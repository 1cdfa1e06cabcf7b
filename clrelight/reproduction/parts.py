"""What the experiments of the noise-resistant fitting paper share: their samples, names, tables and verdicts."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.fit.cls import plan_constrained
from clrelight.fit.plan import Lighting
from clrelight.harmonics.index import degree_and_order
from clrelight.reproduction import exact
from clrelight.speed.tables import markdown_table
from datasets_synth.ring import render_ring

RING_SIZE = 48


@dataclass(frozen=True)
class Part:
    """One experiment: its text, what the paper says that must hold here too, its pictures by file name, and numbers."""

    name: str
    text: str
    verdicts: Mapping[str, bool]
    figures: Mapping[str, Any] = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)


def table(headers: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    return markdown_table(headers, rows)


def prose(text: str) -> str:
    """Return a paragraph as one line."""
    return " ".join(text.split())


def name_of(k: int) -> str:
    """Return y_lm's name of an index, as in ``y10``."""
    l, m = degree_and_order(k)
    return f"y{l}{m}".replace("-", "₋")


@functools.cache
def ring_columns(lights: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ring scene's samples, shape (n_light, P), and its lights."""
    stack = render_ring(size=RING_SIZE, lights=lights)
    samples_ip = stack.images_ihwc.reshape(lights, -1).astype(np.float64) / stack.peak
    return np.ascontiguousarray(samples_ip[:, ::3]), stack.directions_i3


def lighting_of(directions_i3: NDArray[np.float64], sampling: str = "hemisphere") -> Lighting:
    """Return lights of one weight."""
    count = len(directions_i3)
    return Lighting(directions_i3, np.full(count, 2.0 * np.pi / count), np.ones(count, np.intp), sampling)


def cls_norms(degree: int, samples_ip: NDArray[np.float64], directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return |c| of each column by constrained least squares, in float64."""
    plan = plan_constrained(lighting_of(directions_i3), degree, 1.0)
    return np.linalg.norm(exact.fit_cls(plan, samples_ip), axis=0)
