"""Components of a view as pictures: grey is 0, brighter above, darker below, as in illumination-variation, figure 9."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.durable import replacing_folder
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import degree_and_order
from clrelight.images import write_image
from clrelight.passes import stack_rows
from clrelight.surface import Surface
from clrelight.transfer.cameras import frame_surface
from clrelight.transfer.rays import RayScene
from clrelight.transfer.views import look
from clrelight.variation.maps import SampleReader
from clrelight.variation.subspaces import Subspace, half_cosine_factors

MOST_COMPONENTS = 9
SIDE = 1024
"""Pixels of the longer side of pictures; larger views are shrunk."""
_MESH_SIDE = 512

Signed = dict[str, NDArray[np.float64]]
"""Pictures by name, (height, width); NaN where nothing is."""


def check_folder(folder: str) -> None:
    """Raise InputError where something is that is no empty folder, or none can be, before long work."""
    above = os.path.dirname(os.path.abspath(folder))
    if not os.path.isdir(above):
        raise InputError(f"cannot write {folder}: there is no folder {above}")
    if os.path.lexists(folder) and not (os.path.isdir(folder) and not os.listdir(folder)):
        raise InputError(f"{folder} is there: pictures go to a new folder")


def pictures_of_normals(found: Subspace, normals_hw3: NDArray[np.floating], degree: int) -> Signed:
    """Return the components of a picture of normals, and the harmonics of degrees up to 2 that they are made of."""
    step = max(1, -(-max(normals_hw3.shape[:2]) // SIDE))
    small_hw3 = normals_hw3[::step, ::step]
    inside_hw = np.any(small_hw3 != 0.0, axis=2)
    basis_pk = evaluate_basis(small_hw3[inside_hw].astype(np.float64), degree)

    def place(values_p: NDArray[np.float64]) -> NDArray[np.float64]:
        picture_hw = np.full(inside_hw.shape, np.nan)
        picture_hw[inside_hw] = values_p
        return picture_hw

    return _of_basis(found, basis_pk, degree, place)


def pictures_of_mesh(found: Subspace, surface: Surface, degree: int) -> Signed:
    """Return the same of a mesh, as it is seen from +z with y up."""
    view = look(
        RayScene(surface), frame_surface(surface, (0.0, 0.0, 1.0), up=(0.0, 1.0, 0.0), orthographic=True), _MESH_SIDE
    )
    basis_vk = evaluate_basis(surface.normals_v3.astype(np.float64), degree)
    if surface.albedo_vc is not None:
        basis_vk = basis_vk * surface.albedo_vc.astype(np.float64).mean(axis=1, keepdims=True)
    covered_hw = view.coverage_hw > 0.5

    def place(values_v: NDArray[np.float64]) -> NDArray[np.float64]:
        picture_hw = view.interpolate(values_v[:, None])[:, :, 0].astype(np.float64)
        return np.where(covered_hw, picture_hw / np.maximum(view.coverage_hw, 1e-6), np.nan)

    return _of_basis(found, basis_vk, degree, place)


def _of_basis(
    found: Subspace,
    basis_pk: NDArray[np.float64],
    degree: int,
    place: Callable[[NDArray[np.float64]], NDArray[np.float64]],
) -> Signed:
    shaded_pk = basis_pk * half_cosine_factors(degree)
    pictures = {
        f"component_{r + 1}": place(shaded_pk @ found.components_rd[r])
        for r in range(min(MOST_COMPONENTS, len(found.components_rd)))
        if found.variance_r[r] > 0.0
    }
    for k in range(min(9, basis_pk.shape[1])):
        pictures[_harmonic(k)] = place(basis_pk[:, k])
    return pictures


def pictures_of_stack(
    found: Subspace, stack: LightStack, centred: bool, budget: int, tell: Callable[[int, int], object]
) -> Signed:
    """Return the components of photographs, sums of them in linear grey; rows pass once more."""
    height, width, channel = stack.image_shape
    step = max(1, -(-max(height, width) // SIDE))
    count = min(MOST_COMPONENTS, int(np.count_nonzero(found.variance_r > 1e-12)))
    weights_ri = found.components_rd[:count]
    if centred:
        weights_ri = weights_ri - weights_ri.mean(axis=1, keepdims=True)
    row = width * channel * stack.n_light * (2 * stack.images_ihwc.dtype.itemsize + 12)
    rows = max(1, budget // row // step) * step
    if budget < row * step:
        raise InputError(f"{step} rows of this stack take {row * step} bytes, more than the memory budget {budget}")
    pictures_rhw = np.full((count, -(-height // step), -(-width // step)), np.nan)
    for first, grey_irw in _grey(stack, rows):
        sums_irw = np.add.reduceat(grey_irw, np.arange(0, grey_irw.shape[1], step), axis=1)
        sums_irw = np.add.reduceat(sums_irw, np.arange(0, width, step), axis=2)
        pictures_rhw[:, first // step : first // step + sums_irw.shape[1]] = np.tensordot(weights_ri, sums_irw, axes=1)
        tell(min(first + rows, height), height)
    if stack.mask_hw is not None:
        pictures_rhw[:, ~stack.mask_hw[::step, ::step]] = np.nan
    return {f"component_{r + 1}": picture_hw for r, picture_hw in enumerate(pictures_rhw)}


def pictures_of_map(held: CoefficientMap) -> Signed:
    """Return the coefficients of up to degree 2 as pictures: what is seen under each harmonic as light, in grey."""
    height, width, channel = held.image_shape
    step = max(1, -(-max(height, width) // SIDE))
    rows_khwc = np.empty((held.n_coeff, 1, width, channel), np.float32)
    shown_khw = np.zeros((min(9, held.n_coeff), -(-height // step), -(-width // step)))
    for n, row in enumerate(range(0, height, step)):
        shown_khw[:, n] = held.read_rows(row, row + 1, rows_khwc)[: len(shown_khw), 0, ::step].mean(axis=2)
    return {_harmonic(k): picture_hw for k, picture_hw in enumerate(shown_khw)}


def _harmonic(k: int) -> str:
    l, m = degree_and_order(k)
    return f"harmonic_{l}_{m}"


def _grey(stack: LightStack, rows: int) -> Iterator[tuple[int, NDArray[np.float32]]]:
    reader, (_, width, channel) = SampleReader(stack), stack.image_shape
    with stack_rows(stack, rows) as tiles:
        for first, _, tile_ihwc in tiles:
            linear_cip = reader.linear(tile_ihwc.reshape(stack.n_light, -1, channel))
            yield first, linear_cip.mean(axis=0).reshape(stack.n_light, -1, width)


def write_pictures(folder: str | os.PathLike[str], pictures: Signed) -> list[str]:
    """Write signed pictures as 8-bit PNG to a new folder, and each kind on one sheet; return their names.

    The sign of a component is nobody's: each is shown so that its sum is not below 0.
    """
    shown = {name: _codes(picture_hw, name.startswith("component")) for name, picture_hw in pictures.items()}
    for kind in ("component", "harmonic"):
        alike = [codes_hw for name, codes_hw in shown.items() if name.startswith(kind)]
        if alike:
            shown[f"{kind}s"] = _sheet(alike)
    with replacing_folder(folder) as place:
        for name, codes_hw in shown.items():
            write_image(place / f"{name}.png", codes_hw)
    return [f"{name}.png" for name in shown]


def _codes(picture_hw: NDArray[np.float64], any_sign: bool) -> NDArray[np.uint8]:
    seen_hw = np.isfinite(picture_hw)
    values_hw = np.where(seen_hw, picture_hw, 0.0)
    if any_sign and values_hw.sum() < 0.0:
        values_hw = -values_hw
    top = float(np.quantile(np.abs(values_hw[seen_hw]), 0.999)) if seen_hw.any() else 0.0
    scaled_hw = values_hw / top if top > 0.0 else values_hw
    return np.rint(127.5 + 127.5 * np.clip(scaled_hw, -1.0, 1.0)).astype(np.uint8)


def _sheet(pictures: list[NDArray[np.uint8]], across: int = 3) -> NDArray[np.uint8]:
    """Return pictures of one size in rows of three, with lines of grey between."""
    height, width = pictures[0].shape
    down = -(-len(pictures) // across)
    sheet = np.full((down * (height + 4) - 4, min(across, len(pictures)) * (width + 4) - 4), 128, np.uint8)
    for n, codes_hw in enumerate(pictures):
        row, column = (n // across) * (height + 4), (n % across) * (width + 4)
        sheet[row : row + height, column : column + width] = codes_hw
    return sheet
