"""Folders of relight, which OpenLIME shows: planes in JPEGs or tiles, the light as an octahedral table, `info.json`.

What is displayed is ``base_0(s) + sum_p base_p(s) (texel_p - bias_p) scale_p`` with texels from 0 to 1, the bases
interpolated bilinearly between the cells of a square onto which the hemisphere is unfolded.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.durable import naming, replacing_folder
from clrelight.errors import InputError
from clrelight.exchange.codes import check_picture, row_pieces, shown_of
from clrelight.exchange.jpegs import JpegWriter
from clrelight.exchange.layouts import find_layout
from clrelight.exchange.relight_table import COLOUR_SPACES, Table, make_table, octahedral_directions, to_ycc
from clrelight.exchange.shown_sums import LinearSums, ShownSums, code_values, slabs_of
from clrelight.exchange.tiles import TileWriter

MOST_PLANES = 48
INFO = "info.json"
_SAMPLES = 1 << 15
"""Pixels of which axes are found."""
_LEAST_RESOLUTION, _MOST_RESOLUTION = 16, 24
"""At fewer cells, what lies between them costs more than all else: 16 leave about 48 dB."""
_SPANS = {"linear": (-1e6, 1e6), "srgb": (-0.02, 4.0)}
"""Radiance that is kept, by the curve: viewers clip themselves, and functions that are not cut need fewer planes."""


@dataclass(frozen=True)
class FolderForm:
    """How a folder holds its planes.

    Attributes
    ----------
    planes : int
        A multiple of 3, up to `MOST_PLANES`.
    quality : int
        Of the JPEGs, 1 to 100; their colours are not subsampled.
    space : str
        ``"mrgb"`` or ``"mycc"``.
    tiles : str, optional
        A layout of tiles; whole images without.
    url : str
        Where the folder will be found, for tiles of ``"iiif"``.
    """

    planes: int = 27
    quality: int = 100
    space: str = "mrgb"
    tiles: str | None = None
    url: str = ""

    def __post_init__(self) -> None:
        if not (3 <= self.planes <= MOST_PLANES and self.planes % 3 == 0):
            raise InputError(f"a relight folder has 3 to {MOST_PLANES} planes, a multiple of 3, got {self.planes}")
        if not 1 <= self.quality <= 100:
            raise InputError(f"the quality of JPEGs is 1 to 100, got {self.quality}")
        if self.space not in COLOUR_SPACES:
            raise InputError(f"colour spaces of a relight folder are {', '.join(COLOUR_SPACES)}, got {self.space!r}")
        if self.tiles is not None:
            find_layout(self.tiles)

    @property
    def images(self) -> list[str]:
        """Names of the images, three planes each."""
        return [f"plane_{number}" for number in range(self.planes // 3)]

    def writer(self, folder: Path, height: int, width: int) -> JpegWriter | TileWriter:
        """Return what takes rows of planes; InputError where the layout has no room for such a picture."""
        if self.tiles is None:
            return JpegWriter(folder, self.images, height, width, self.quality)
        layout = find_layout(self.tiles).of(height, width)
        return TileWriter(folder, layout, self.images, self.quality, url=self.url)


def write_relight_folder(
    coefficients: CoefficientMap,
    out: str | os.PathLike[str],
    form: FolderForm,
    device: Device,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write a fit as a folder that OpenLIME and relight show.

    Display values under the cells' lights are coded by their principal axes; planes are solved against the bases as
    they are rounded, and cut to the range that sampled pixels have, a twentieth more on either side.

    Parameters
    ----------
    coefficients : CoefficientMap
        A picture of 1 or 3 channels, of any basis.
    out : path
        A new folder.
    form : FolderForm
    device : Device
        Where planes are made.
    progress : callable, optional
        Called with rows done and in all.

    Returns
    -------
    list of Path
        What was written, ``info.json`` last; of tiles, what describes them.
    """
    check_picture(coefficients, "a relight folder")
    resolution = int(np.clip(4 * coefficients.degree, _LEAST_RESOLUTION, _MOST_RESOLUTION))
    basis_ik = coefficients.functions_at(octahedral_directions(resolution))
    table = make_table(_sample(coefficients, basis_ik, form.space), form.planes, resolution, form.space)
    target = Path(os.fsdecode(out))
    with replacing_folder(target) as folder:
        files = _write_planes(coefficients, basis_ik, table, form, folder, device, progress)
        with naming(target):
            (folder / INFO).write_text(json.dumps(_info(coefficients, table, form)))
    return [target / name for name in (*files, Path(INFO))]


def _sample(coefficients: CoefficientMap, basis_ik: NDArray[np.float64], space: str) -> NDArray[np.float32]:
    """Return display values (sample, cell · 3) of pixels all over the image."""
    height, width, channel = coefficients.image_shape
    step = max(height * width // _SAMPLES, 1) | 1  # odd, to leave no column out
    found = []
    for first, end in row_pieces(coefficients, 1):
        start = -(first * width) % step
        if start >= (end - first) * width:
            continue
        coeffs_khwc = np.empty((coefficients.n_coeff, end - first, width, channel), np.float32)
        coefficients.read_rows(first, end, coeffs_khwc)
        taken_kpc = np.ascontiguousarray(coeffs_khwc.reshape(len(coeffs_khwc), -1, channel)[:, start::step])
        shown_ipc = shown_of(taken_kpc, coefficients.transfer, basis_ik, _SPANS[coefficients.transfer])
        shown_ipc = to_ycc(shown_ipc) if space == "mycc" else shown_ipc
        found.append(np.moveaxis(shown_ipc, 0, 1).reshape(-1, 3 * len(basis_ik)))
    return np.concatenate(found)


def _write_planes(
    coefficients: CoefficientMap,
    basis_ik: NDArray[np.float64],
    table: Table,
    form: FolderForm,
    folder: Path,
    device: Device,
    progress: Callable[[int, int], None] | None,
) -> list[Path]:
    height, width, channel = coefficients.image_shape
    scaled_dp = table.solver / table.scale_p
    offset_p = 255.0 * (table.bias_p - table.mean_d @ scaled_dp)
    solver_icp = 255.0 * _by_channel(scaled_dp, len(basis_ik), channel, form.space)
    sums: ShownSums | LinearSums
    if coefficients.transfer == "linear":  # nothing is cut then, and a few numbers a pixel do for all cells
        matrix_kcp = np.einsum("ik,icp->kcp", basis_ik, solver_icp)
        sums = LinearSums(matrix_kcp.reshape(-1, form.planes).T, device)
    else:
        solver_pd = solver_icp.reshape(-1, form.planes).T
        sums = ShownSums(coefficients, basis_ik, solver_pd, _SPANS[coefficients.transfer], device)
    with closing(form.writer(folder, height, width)) as writer:
        for first, end, slabs in slabs_of(coefficients, sums):
            if progress is not None:
                progress(first, height)
            made = [code_values(sums.solve(coeffs_kcp)[0], offset_p, 3, device) for coeffs_kcp in slabs]
            codes_gpv = np.concatenate(made, axis=1)  # an image's planes beside each other, as its JPEG wants them
            writer.add(codes_gpv.reshape(-1, end - first, width, 3))
        return writer.finish()


def _by_channel(scaled_dp: NDArray[np.float64], n_cell: int, channel: int, space: str) -> NDArray[np.float64]:
    """Return what makes planes of display values of a view's own channels, (cell, channel, plane)."""
    primaries = np.eye(3, dtype=np.float32)
    colours = to_ycc(primaries) if space == "mycc" else primaries
    given = colours if channel == 3 else colours.sum(axis=0, keepdims=True)  # gray is three equal channels
    return np.einsum("cv,ivp->icp", given.astype(np.float64), scaled_dp.reshape(n_cell, 3, -1))


def _info(coefficients: CoefficientMap, table: Table, form: FolderForm) -> dict[str, Any]:
    height, width, _ = coefficients.image_shape
    material = {"scale": table.scale_p, "bias": table.bias_p, "range": table.range_p}
    return {
        "width": width,
        "height": height,
        "format": "jpg",
        "type": "bilinear",
        "colorspace": form.space,
        "resolution": table.resolution,
        "nplanes": form.planes,
        **({"yccplanes": 3 * [form.planes // 3]} if form.space == "mycc" else {}),
        "nmaterials": 1,
        "quality": form.quality,
        "lights": np.round(coefficients.directions_i3, 6).ravel().tolist(),
        "materials": [{name: np.round(values, 9).tolist() for name, values in material.items()}],
        "basis": table.codes_pd.ravel().tolist(),
    }
