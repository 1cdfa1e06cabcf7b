"""Normals of a whole stack whose light is not known: what lights do to each other first, then rows in tiles."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.passes import rows_within, stack_rows
from clrelight.threads import on_one_thread
from clrelight.variation.integrable import resolve_lorentz
from clrelight.variation.maps import NormalMap
from clrelight.variation.samples import SampleReader, read_probe
from clrelight.variation.unknown import COMPONENTS, Factored, factor_four, factor_nine, null_vectors
from clrelight.variation.wanted import Found, UnknownLight

_FACTORED = 4000
"""Pixels that the factors are told from."""
_TINY = 1e-30


def map_unknown(
    stack: LightStack,
    degree: int = 1,
    *,
    concave: bool = False,
    transfer: str | None = None,
    memory_bytes: int = DEFAULT_MEMORY,
    progress: Callable[[int, int], None] | None = None,
    add_time: Callable[[str, float], float] | None = None,
) -> NormalMap:
    """Return the normals of a convex matte surface under light that nothing is known of.

    Parameters
    ----------
    stack : LightStack
        Its directions are not looked at; each image is under distant light of any kind, of one colour.
    degree : int
        Of the harmonics: 1, four components, or 2, nine.
    concave : bool
        Of the two surfaces that cannot be told apart: the one that is lower in the middle.
    transfer : str, optional
        ``"linear"`` or ``"srgb"`` instead of the stack's own.
    memory_bytes, progress, add_time
        As of `clrelight.variation.maps.map_normals`.

    Raises
    ------
    InputError
        If there are fewer images than components, the photographs do not vary enough, or are not those of a surface.
    """
    count = _count(stack, degree)
    tally = add_time or (lambda _, since: time.perf_counter())
    since = time.perf_counter()
    height, width, channel = stack.image_shape
    reader, rows = SampleReader(stack, transfer), _rows(stack, memory_bytes)
    with on_one_thread():
        products_ii = np.zeros((stack.n_light, stack.n_light))
        for _, end, samples_cip in _tiles(stack, reader, rows):
            grey_ip = samples_cip.mean(axis=0, dtype=np.float64)
            products_ii += grey_ip @ grey_ip.T
            _tell(progress, end, 2 * height)
        energy_r, axes_ir = np.linalg.eigh(products_ii)
        energy_r, axes_ir = energy_r[::-1], axes_ir[:, ::-1]
        if not energy_r[count - 1] > 1e-12 * energy_r[0]:
            raise InputError(f"the images vary in fewer than {count} ways: they do not tell degree {degree}")
        inside_count = height * width if stack.mask_hw is None else int(np.count_nonzero(stack.mask_hw))
        project_ki = (axes_ir[:, :count] * np.sqrt(inside_count / energy_r[:count])).T
        since = tally("decompose", since)
        factored = _factor(stack, reader, project_ki, degree)
        since = tally("factor", since)
        made = _Made(height, width, channel)
        rows_4i, axes_ik = (each.astype(np.float32) for each in (factored.rows_4k @ project_ki, axes_ir[:, :count]))
        for first, end, samples_cip in _tiles(stack, reader, rows):
            made.fill(first, end, samples_cip, rows_4i, axes_ik, stack.mask_hw)
            _tell(progress, height + end, 2 * height)
        since = tally("project", since)
        normals_hw3, albedo_hw, gap = _resolve(made.scaled_4hw, degree, concave)
        tally("resolve", since)
    told = UnknownLight(degree, float(energy_r[:count].sum() / energy_r.sum()), factored.residual, gap, concave)
    seen_hw = normals_hw3.any(axis=2)
    return NormalMap(
        normals_hw3,
        np.maximum(albedo_hw[..., None] * made.ratio_hwc, 0.0),
        np.where(seen_hw, made.confidence_hw, np.float32(0.0)),
        float(np.sqrt(energy_r[0] / energy_r[count - 1])),
        0.0,
        "unknown",
        Found(transfer or stack.transfer, 0.0, light=told),
    )


def _count(stack: LightStack, degree: int) -> int:
    if degree not in COMPONENTS:
        raise InputError(f"unknown light is of degree {' or '.join(map(str, COMPONENTS))}, got {degree}")
    count = COMPONENTS[degree]
    if stack.n_light < count:
        raise InputError(
            f"light of degree {degree} has {count} components: it needs as many images, got {stack.n_light}"
        )
    return count


class _Made:
    """What is kept of each pixel: its vector on the cone, its colour, and how much components hold of it."""

    def __init__(self, height: int, width: int, channel: int) -> None:
        self.scaled_4hw = np.zeros((4, height, width), np.float32)
        self.ratio_hwc = np.zeros((height, width, channel), np.float32)
        self.confidence_hw = np.zeros((height, width), np.float32)

    def fill(
        self,
        first: int,
        end: int,
        samples_cip: NDArray[np.float32],
        rows_4i: NDArray[np.float32],
        axes_ik: NDArray[np.float32],
        mask_hw: NDArray[np.bool_] | None,
    ) -> None:
        """Fill rows first..end; pixels outside the mask stay 0."""
        width, channel = self.ratio_hwc.shape[1:]
        inside_hw = np.ones((end - first, width), bool) if mask_hw is None else mask_hw[first:end]
        grey_ip = samples_cip.mean(axis=0, dtype=np.float32)
        own_4p = rows_4i @ grey_ip
        total_p = np.maximum(np.sum(grey_ip**2, axis=0), _TINY)
        left_p = np.maximum(total_p - np.sum((axes_ik.T @ grey_ip) ** 2, axis=0), 0.0)
        self.confidence_hw[first:end][inside_hw] = 1.0 - np.minimum(2.0 * np.sqrt(left_p / total_p), 1.0)
        length_p = np.maximum(np.sum(own_4p**2, axis=0), _TINY)
        for each in range(channel):
            ratio_p = np.sum((rows_4i @ samples_cip[each]) * own_4p, axis=0) / length_p
            self.ratio_hwc[first:end, :, each][inside_hw] = ratio_p
        self.scaled_4hw[:, first:end][:, inside_hw] = own_4p


def _tell(progress: Callable[[int, int], None] | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)


def _rows(stack: LightStack, memory_bytes: int) -> int:
    _, width, channel = stack.image_shape
    row = width * channel * stack.n_light * (2 * stack.images_ihwc.dtype.itemsize + 20)
    return rows_within(row, memory_bytes)


def _tiles(stack: LightStack, reader: SampleReader, rows: int) -> Iterator[tuple[int, int, NDArray[np.float32]]]:
    """Yield linear samples of the pixels inside the mask, (channel, n_light, P), tile by tile."""
    with stack_rows(stack, rows) as tiles:
        for first, end, tile_ihwc in tiles:
            columns_ipc = tile_ihwc.reshape(stack.n_light, -1, stack.image_shape[2])
            if stack.mask_hw is not None:
                columns_ipc = columns_ipc[:, stack.mask_hw[first:end].ravel()]
            yield first, end, reader.linear(columns_ipc)


def _factor(stack: LightStack, reader: SampleReader, project_ki: NDArray[np.float64], degree: int) -> Factored:
    grey_ip = reader.linear(read_probe(stack).codes_ipc).mean(axis=0, dtype=np.float64)
    grey_ip = grey_ip[:, grey_ip.max(axis=0, initial=0.0) > 0.0]
    if grey_ip.shape[1] < 100:
        raise InputError(f"{grey_ip.shape[1]} of the probed pixels are not black, expected at least 100")
    chosen_p = np.linspace(0, grey_ip.shape[1] - 1, min(grey_ip.shape[1], _FACTORED)).round().astype(int)
    components_kp = project_ki @ grey_ip[:, chosen_p]
    if degree == 1:
        return factor_four(components_kp)
    # A flat albedo's start serves where the four components of the most energy are no cone.
    first_p = np.linalg.lstsq(components_kp[:4].T, np.ones(len(chosen_p)), rcond=None)[0] @ components_kp[:4]
    starts = [np.concatenate([np.abs(first_p)[None], components_kp[1:4]])]
    try:
        four = factor_four(components_kp[:4])
        starts.insert(0, four.rows_4k @ components_kp[:4])
    except InputError:
        pass
    return factor_nine(components_kp, tuple(starts))


def _resolve(
    scaled_4hw: NDArray[np.float32], degree: int, concave: bool
) -> tuple[NDArray[np.float32], NDArray[np.float32], float]:
    """Return normals, albedo whose brightest hundredth is 1, and how well the surface is told."""
    null_4hw = null_vectors(scaled_4hw, degree)
    inside_hw = null_4hw[0] > 0.0
    surface = resolve_lorentz(null_4hw, inside_hw)
    made_4hw = np.tensordot(surface.rows_44.astype(np.float32), null_4hw, axes=1)
    if concave:
        made_4hw[1:3] = -made_4hw[1:3]
    length_hw = np.sqrt(np.sum(made_4hw[1:] ** 2, axis=0))
    inside_hw &= length_hw > _TINY
    normals_hw3 = np.where(inside_hw, made_4hw[1:] / np.maximum(length_hw, _TINY), 0.0).transpose(1, 2, 0)
    albedo_hw = np.where(inside_hw, np.maximum(made_4hw[0], 0.0) ** degree, 0.0)
    brightest = float(np.quantile(albedo_hw[inside_hw], 0.99)) if inside_hw.any() else 1.0
    albedo_hw /= max(brightest, _TINY)
    return np.ascontiguousarray(normals_hw3, np.float32), albedo_hw.astype(np.float32), surface.gap
