"""Folders of relight, which OpenLIME shows: planes as JPEGs, and the light as an octahedral table, `info.json`.

What is displayed is ``base_0(s) + sum_p base_p(s) (texel_p - bias_p) scale_p`` with texels from 0 to 1, the bases
interpolated bilinearly between the cells of a square onto which the hemisphere is unfolded.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.durable import naming, replacing_folder
from clrelight.errors import InputError
from clrelight.exchange.codes import check_picture, display_values, row_pieces
from clrelight.harmonics.basis import evaluate_basis

MOST_PLANES = 48
INFO = "info.json"
_SAMPLES = 1 << 15
"""Pixels of which axes are found."""
_LEAST_RESOLUTION, _MOST_RESOLUTION = 16, 24
"""At fewer cells, what lies between them costs more than all else: 16 leave about 48 dB."""
_SPANS = {"linear": (-1e6, 1e6), "srgb": (-0.02, 4.0)}
"""Radiance that is kept, by the curve: viewers clip themselves, and functions that are not cut need fewer planes."""
_ROOM = 0.05
"""Of the range of the samples' planes, on either side, for pixels that are none of them."""


@dataclass(frozen=True)
class Table:
    """A folder's bases, as it holds them.

    Attributes
    ----------
    resolution : int
        Cells along a side of the square.
    codes_pd : ndarray, shape (plane + 1, cell · 3), uint8
        The mean, then the planes' bases.
    range_p, scale_p, bias_p : ndarray, shape (plane,), float64
    """

    resolution: int
    codes_pd: NDArray[np.uint8]
    range_p: NDArray[np.float64]
    scale_p: NDArray[np.float64]
    bias_p: NDArray[np.float64]

    @property
    def mean_d(self) -> NDArray[np.float64]:
        """The first base."""
        return self.codes_pd[0] / 255.0

    @property
    def bases_pd(self) -> NDArray[np.float64]:
        """The other ones."""
        return (self.codes_pd[1:].astype(np.float64) - 127.0) / self.range_p[:, None]


def octahedral_directions(resolution: int) -> NDArray[np.float64]:
    """Return the directions of the cells, (resolution², 3): those of a row follow each other, x + y, then y - x."""
    v, u = np.meshgrid(*2 * [np.linspace(-1.0, 1.0, resolution)], indexing="ij")
    x, y = (u - v).ravel() / 2.0, (u + v).ravel() / 2.0
    directions = np.stack([x, y, 1.0 - np.abs(x) - np.abs(y)], axis=1)
    directions[:, 2] = np.maximum(directions[:, 2], 0.0)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def write_relight_folder(
    coefficients: CoefficientMap,
    out: str | os.PathLike[str],
    *,
    planes: int = 27,
    quality: int = 95,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write a fit as a folder that OpenLIME and relight show.

    Display values under the cells' lights are coded by their principal axes; planes are solved against the bases as
    they are rounded, and cut to the range that sampled pixels have, a twentieth more on either side.

    Parameters
    ----------
    coefficients : CoefficientMap
        A picture of 1 or 3 channels.
    out : path
        A new folder.
    planes : int
        A multiple of 3, up to `MOST_PLANES`.
    quality : int
        Of the JPEGs, 1 to 100; their colours are not subsampled.
    progress : callable, optional
        Called with rows done and in all.

    Returns
    -------
    list of Path
        What was written, ``info.json`` last.
    """
    check_picture(coefficients, "a relight folder")
    if not (3 <= planes <= MOST_PLANES and planes % 3 == 0):
        raise InputError(f"a relight folder has 3 to {MOST_PLANES} planes, a multiple of 3, got {planes}")
    if not 1 <= quality <= 100:
        raise InputError(f"the quality of JPEGs is 1 to 100, got {quality}")
    resolution = int(np.clip(4 * coefficients.degree, _LEAST_RESOLUTION, _MOST_RESOLUTION))
    basis_ik = evaluate_basis(octahedral_directions(resolution), coefficients.degree)
    table = _make_table(_sample(coefficients, basis_ik), planes, resolution)
    names = [f"plane_{number}.jpg" for number in range(planes // 3)]
    target = Path(os.fsdecode(out))
    with replacing_folder(target) as folder:
        _write_planes(coefficients, basis_ik, table, [folder / name for name in names], quality, progress)
        with naming(target):
            (folder / INFO).write_text(json.dumps(_info(coefficients, table, quality)))
    return [target / name for name in (*names, INFO)]


def _sample(coefficients: CoefficientMap, basis_ik: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return display values (sample, cell · 3) of pixels all over the image."""
    height, width, _ = coefficients.image_shape
    step = max(height * width // _SAMPLES, 1) | 1  # odd, to leave no column out
    found = []
    for first, end in row_pieces(coefficients, len(basis_ik)):
        shown_ipc = display_values(coefficients, basis_ik, first, end, _SPANS[coefficients.transfer])
        start = -(first * width) % step
        found.append(np.moveaxis(shown_ipc[:, start::step], 0, 1).reshape(-1, 3 * len(basis_ik)))
    return np.concatenate(found)


def _make_table(values_nd: NDArray[np.float32], planes: int, resolution: int) -> Table:
    mean_d = np.clip(values_nd.mean(axis=0, dtype=np.float64), 0.0, 1.0)
    codes_pd = np.empty((planes + 1, len(mean_d)), np.uint8)
    codes_pd[0] = np.rint(255.0 * mean_d)
    apart_nd = values_nd - (codes_pd[0] / 255.0).astype(np.float32)
    _, vectors_dd = np.linalg.eigh((apart_nd.T @ apart_nd).astype(np.float64))
    vectors_pd = vectors_dd[:, ::-1].T[:planes]
    range_p = 127.0 / np.abs(vectors_pd).max(axis=1)
    codes_pd[1:] = np.rint(range_p[:, None] * vectors_pd) + 127.0
    table = Table(resolution, codes_pd, range_p, np.ones(planes), np.zeros(planes))
    found_np = apart_nd @ _solver(table)
    low_p, high_p = found_np.min(axis=0).astype(np.float64), found_np.max(axis=0).astype(np.float64)
    room_p = _ROOM * (high_p - low_p) + 1e-6
    scale_p = high_p - low_p + 2.0 * room_p
    return Table(resolution, codes_pd, range_p, scale_p, (room_p - low_p) / scale_p)


def _solver(table: Table) -> NDArray[np.float32]:
    """Return what makes planes of display values apart from the mean, (cell · 3, plane)."""
    return np.linalg.pinv(table.bases_pd).astype(np.float32)


def _write_planes(
    coefficients: CoefficientMap,
    basis_ik: NDArray[np.float64],
    table: Table,
    files: list[Path],
    quality: int,
    progress: Callable[[int, int], None] | None,
) -> None:
    height, width, _ = coefficients.image_shape
    solver, mean_d = _solver(table), table.mean_d.astype(np.float32)
    outputs = [_opened_jpeg(file, height, width, quality) for file in files]
    for first, end in row_pieces(coefficients, len(basis_ik)):
        if progress is not None:
            progress(first, height)
        shown_ipc = display_values(coefficients, basis_ik, first, end, _SPANS[coefficients.transfer])
        shown_nd = np.moveaxis(shown_ipc, 0, 1).reshape(-1, len(mean_d))
        texels_np = (shown_nd - mean_d) @ solver / table.scale_p.astype(np.float32) + table.bias_p.astype(np.float32)
        codes_hwp = np.rint(255.0 * np.clip(texels_np, 0.0, 1.0)).astype(np.uint8).reshape(end - first, width, -1)
        for number, (file, output) in enumerate(zip(files, outputs, strict=True)):
            pixels = np.ascontiguousarray(codes_hwp[:, :, 3 * number : 3 * number + 3])
            if not output.write_scanlines(first, end, 0, pixels):
                raise InputError(f"cannot write {file.name}: {output.geterror()}")
    for file, output in zip(files, outputs, strict=True):
        if not output.close():
            raise InputError(f"cannot write {file.name}: {output.geterror()}")


def _opened_jpeg(file: Path, height: int, width: int, quality: int) -> Any:
    spec = oiio.ImageSpec(width, height, 3, "uint8")
    spec.attribute("Compression", f"jpeg:{quality}")
    spec.attribute("jpeg:subsampling", "4:4:4")
    spec.attribute("oiio:ColorSpace", "sRGB")  # codes are written as they are
    output = oiio.ImageOutput.create(str(file))
    if not output or not output.open(str(file), spec):
        raise InputError(f"cannot write {file.name}: {oiio.geterror() or 'the folder takes no file'}")
    return output


def _info(coefficients: CoefficientMap, table: Table, quality: int) -> dict[str, Any]:
    height, width, _ = coefficients.image_shape
    material = {"scale": table.scale_p, "bias": table.bias_p, "range": table.range_p}
    return {
        "width": width,
        "height": height,
        "format": "jpg",
        "type": "bilinear",
        "colorspace": "mrgb",
        "resolution": table.resolution,
        "nplanes": len(table.range_p),
        "nmaterials": 1,
        "quality": quality,
        "lights": np.round(coefficients.directions_i3, 6).ravel().tolist(),
        "materials": [{name: np.round(values, 9).tolist() for name, values in material.items()}],
        "basis": table.codes_pd.ravel().tolist(),
    }
