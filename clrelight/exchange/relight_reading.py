"""Reads folders of relight: `info.json` and planes, whole or in tiles, of the bases that OpenLIME shows."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.exchange.files import MOST_NUMBER, read_bytes
from clrelight.exchange.ptm import polynomial_terms
from clrelight.exchange.relight_folder import INFO, MOST_PLANES
from clrelight.exchange.relight_table import COLOUR_SPACES, to_rgb
from clrelight.exchange.rows import Rows
from clrelight.exchange.rti import hemispherical_terms
from clrelight.exchange.tile_finding import find_planes
from clrelight.harmonics.basis import evaluate_basis

_MOST_RESOLUTION = 256
_LEAST_SIGMA = 1e-4
_LEAST_RANGE = 1.0 / MOST_NUMBER
_LEAST_WEIGHT = 1e-3
"""Of a light, below which OpenLIME leaves it out of radial bases."""
_MOST_SAID = 80
"""Letters that a message repeats of what a folder says: a number may have thousands."""
_TABLES, _TERMS = ("bilinear", "rbf"), ("ptm", "hsh", "sh")
# relight has 1, u, v, u², u v, v²; ours are u², v², u v, u, v, 1.
_POLYNOMIAL_ORDER = [5, 3, 4, 0, 2, 1]


@dataclass(frozen=True)
class RelightFolder:
    """Display values ``base_0(s) + sum_p base_p(s) (texel_p - bias_p) scale_p`` of each channel.

    Attributes
    ----------
    texels_hwp : Rows, shape (height, width, plane), uint8
    scale_p, bias_p : ndarray, shape (plane,), float64
    info : dict
        What the folder says of its basis.
    """

    texels_hwp: Rows
    scale_p: NDArray[np.float64]
    bias_p: NDArray[np.float64]
    info: dict[str, Any]

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and 3."""
        return self.texels_hwp.shape[0], self.texels_hwp.shape[1], 3

    def display_values(self, directions_i3: NDArray[np.float64], first: int, end: int) -> NDArray[np.float32]:
        """Return display values of rows, (n_light, rows, width, 3), float32 in 0 .. 1."""
        scale_p, bias_p = self.scale_p.astype(np.float32), self.bias_p.astype(np.float32)
        texels_hwp = self.texels_hwp[first:end][..., : len(scale_p)]
        values_hwp = (texels_hwp.astype(np.float32) / np.float32(255.0) - bias_p) * scale_p
        if self.info["type"] in _TABLES:
            base_ipc = self._table_weights(directions_i3).astype(np.float32)
            shown = np.einsum("hwp,ipc->ihwc", values_hwp, base_ipc[:, 1:], optimize=True) + base_ipc[:, None, None, 0]
            return np.clip(to_rgb(shown) if self.info["colorspace"] == "mycc" else shown, 0.0, 1.0)
        terms_it = _terms(self.info["type"], directions_i3).astype(np.float32)
        if self.info["colorspace"] == "lrgb":
            count = min(terms_it.shape[1], values_hwp.shape[2] - 3)
            light_ihw = np.tensordot(terms_it[:, :count], values_hwp[..., 3 : 3 + count], (1, 2))
            return np.clip(light_ihw[..., None] * values_hwp[..., :3], 0.0, 1.0)
        count = min(terms_it.shape[1], values_hwp.shape[2] // 3)
        by_term = values_hwp[..., : 3 * count].reshape(*values_hwp.shape[:2], count, 3)
        return np.clip(np.einsum("it,hwtc->ihwc", terms_it[:, :count], by_term, optimize=True), 0.0, 1.0)

    def _table_weights(self, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return bases (n_light, plane + 1, 3) of the table of cells or lights."""
        planes = len(self.scale_p)
        table_pnc = np.array(self.info["basis"], np.float64).reshape(planes + 1, -1, 3)
        table_pnc[0] /= 255.0
        range_p = np.array(self.info["materials"][0]["range"], np.float64)
        table_pnc[1:] = (table_pnc[1:] - 127.0) / range_p[:, None, None]
        if self.info["type"] == "rbf":
            weight_in = _radial_weights(self.info, directions_i3)
        else:
            weight_in = _bilinear_weights(int(self.info["resolution"]), directions_i3)
        if self.info["colorspace"] == "mycc":  # relight leaves in a plane's base what belongs to other components
            table_pnc[1:] *= _components([int(each) for each in self.info["yccplanes"]])[:, None]
        return np.einsum("in,pnc->ipc", weight_in, table_pnc, optimize=True)


def _components(counts: list[int]) -> NDArray[np.float64]:
    """Return which component each plane is of, (plane, 3), ones and zeros.

    Luminance and both differences take turns while there are differences; what luminance has more stands behind them.
    """
    turns = np.tile(np.eye(3), (counts[1], 1))
    return np.concatenate([turns, np.tile(np.eye(3)[:1], (counts[0] - counts[1], 1))])


def _terms(kind: str, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    if kind == "hsh":
        return hemispherical_terms(directions_i3)
    if kind == "sh":
        return evaluate_basis(directions_i3, 2)
    return polynomial_terms(directions_i3)[:, _POLYNOMIAL_ORDER]


def _bilinear_weights(side: int, directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return weights (n_light, side²) of the cells around each direction."""
    size_i = np.abs(directions_i3).sum(axis=1)
    x_i, y_i = (
        ((each / size_i + 1.0) / 2.0) * (side - 1)
        for each in (directions_i3[:, 0] + directions_i3[:, 1], directions_i3[:, 1] - directions_i3[:, 0])
    )
    left_i, top_i = (np.clip(np.floor(each), 0, side - 2).astype(int) for each in (x_i, y_i))
    weight_in = np.zeros((len(directions_i3), side * side))
    row_i = np.arange(len(directions_i3))
    for down in (0, 1):
        for right in (0, 1):
            share_i = np.abs(1 - right - (x_i - left_i)) * np.abs(1 - down - (y_i - top_i))
            weight_in[row_i, left_i + right + (top_i + down) * side] += share_i
    return weight_in


def _radial_weights(info: dict[str, Any], directions_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return weights (n_light, light) of radial bases."""
    lights_n3 = np.array(info["lights"], np.float64).reshape(-1, 3)
    apart_in = np.sum((directions_i3[:, None] - lights_n3) ** 2, axis=2)
    weight_in = np.exp(-apart_in / float(info["sigma"]) ** 2)
    weight_in /= np.maximum(weight_in.sum(axis=1, keepdims=True), 1e-300)
    weight_in[weight_in <= _LEAST_WEIGHT] = 0.0
    return weight_in / np.maximum(weight_in.sum(axis=1, keepdims=True), 1e-300)


def read_relight_folder(path: str | os.PathLike[str]) -> RelightFolder:
    """Read a folder, or the `info.json` in it; InputError where something is missing or makes no sense.

    Bases: `bilinear` and `rbf` in `mrgb` and `mycc`; `ptm`, `hsh` and `sh` in `rgb` and `lrgb`. Planes are whole
    images, JPEG or PNG, or tiles in any layout of `LAYOUTS`; they are read when rows are asked for.
    """
    given = Path(os.fsdecode(path))
    folder = given.parent if given.name == INFO else given
    if folder.is_dir() and not (folder / INFO).exists():
        raise InputError(f"{folder} is no folder of relight, it has no {INFO}; clrelight ingest reads photographs")
    try:
        info = json.loads(read_bytes(folder / INFO))
        scale_p, bias_p = (np.array(info["materials"][0][name], np.float64).ravel() for name in ("scale", "bias"))
        kind, space, n_plane = str(info["type"]), str(info["colorspace"]), len(scale_p)
        _check(info, kind, space, n_plane, len(bias_p))
        ending = str(info.get("format", "jpg"))[:_MOST_SAID]
        size = (int(info["height"]), int(info["width"])) if "height" in info and "width" in info else None
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError):
        raise InputError(f"{folder / INFO} is no JSON") from None
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, InputError):
            raise
        said = repr(error)[:_MOST_SAID]
        raise InputError(f"{folder / INFO} does not say what a relight folder says: {said}") from None
    images = [f"plane_{number}" for number in range(-(-n_plane // 3))]
    planes = find_planes(folder, images, ending, size)
    if size is not None and planes.shape[:2] != size:  # before anything is decoded
        said = f"{size[1]} × {size[0]}"[:_MOST_SAID]
        raise InputError(f"{folder}: its planes have {planes.shape[1]} × {planes.shape[0]} pixels, {INFO} says {said}")
    return RelightFolder(planes, scale_p, bias_p, info)


def _check(info: dict[str, Any], kind: str, space: str, planes: int, biases: int) -> None:
    """Raise ValueError unless a folder's numbers belong together."""
    known = {
        (k, c) for kinds, spaces in ((_TABLES, COLOUR_SPACES), (_TERMS, ("rgb", "lrgb"))) for k in kinds for c in spaces
    }
    if (kind, space) not in known:
        said = f"{kind[:_MOST_SAID]!r} in {space[:_MOST_SAID]!r}"
        raise InputError(f"basis {said} cannot be read; known are {sorted(known)}")
    if not 0 < planes <= 2 * MOST_PLANES or biases != planes:
        raise ValueError(f"{planes} scales and {biases} biases")
    material = info["materials"][0]
    for name in ("scale", "bias"):
        _check_numbers(name, material[name])
    if space not in COLOUR_SPACES:
        return
    if space == "mycc":
        counts = [int(each) for each in info["yccplanes"]]
        if len(counts) != 3 or sum(counts) != planes or not 0 <= counts[1] == counts[2] <= counts[0]:
            raise ValueError(f"yccplanes {counts} of {planes} planes")
    _check_numbers("basis", info["basis"])
    if not (np.abs(_check_numbers("range", material["range"])) >= _LEAST_RANGE).all():
        raise ValueError("a range is 0, or next to it")
    side = int(info["resolution"]) if kind == "bilinear" else 0
    cells = side**2 if kind == "bilinear" else len(info["lights"]) // 3
    if side < 0 or not 4 <= cells <= _MOST_RESOLUTION**2 or len(info["materials"][0]["range"]) != planes:
        raise ValueError(f"{cells} cells of the table")
    if len(info["basis"]) != (planes + 1) * cells * 3:
        raise ValueError(f"{len(info['basis'])} numbers in the table")
    if kind == "rbf":
        if len(_check_numbers("lights", info["lights"]).ravel()) != 3 * cells:
            raise ValueError(f"lights are three numbers each, there are {len(info['lights'])}")
        if not _LEAST_SIGMA <= float(info["sigma"]) <= MOST_NUMBER:
            raise ValueError(f"sigma {float(info['sigma']):g}")


def _check_numbers(name: str, values: Any) -> NDArray[np.float64]:
    """Return a list of numbers as an array; ValueError or TypeError where it is none, or float32 does not hold them."""
    numbers = np.array(values, np.float64)
    if not (np.abs(numbers) <= MOST_NUMBER).all():  # NaN neither, which JSON has none of and Python reads
        raise ValueError(f"{name} holds what is no finite number, or too large a one")
    return numbers
