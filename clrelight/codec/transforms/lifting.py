"""The CDF 9/7 wavelet transform of coefficient maps on a device, and where its subbands lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import round_up
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

_LANES = 8
_BUFFERS, _SLACK = 10, 32
"""Rows, and values beyond the end of each, that a CPU's work-item has to work with (in ``wavelet.cl`` too)."""
_PLANES_AT_ONCE = 4
"""Work-items of each compute unit of a CPU, so that none waits long for the last."""
_GROUP = 64
"""Work-items of a GPU's group, along rows."""


@dataclass(frozen=True)
class Subband:
    """One subband's place in a transformed plane.

    Attributes
    ----------
    name : str
        ``"LL"``, ``"HL"`` (high along x), ``"LH"`` (high along y) or ``"HH"``.
    level : int
        1 is the finest.
    rows, columns : slice
        Where the subband lies.
    """

    name: str
    level: int
    rows: slice
    columns: slice

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, both at least 1."""
        return self.rows.stop - self.rows.start, self.columns.stop - self.columns.start


def list_subbands(height: int, width: int, levels: int) -> list[Subband]:
    """Return the subbands of a plane from coarse to fine, without empty ones: ``3 levels + 1`` where sides suffice."""
    bands: list[Subband] = []
    for level in range(1, levels + 1):
        low_h, low_w = (height + 1) // 2, (width + 1) // 2
        top, bottom, left, right = slice(0, low_h), slice(low_h, height), slice(0, low_w), slice(low_w, width)
        named = [("HL", top, right), ("LH", bottom, left), ("HH", bottom, right)]
        found = [Subband(name, level, rows, columns) for name, rows, columns in named]
        bands = [band for band in found if min(band.shape) > 0] + bands
        height, width = low_h, low_w
    return [Subband("LL", levels, slice(0, height), slice(0, width)), *bands]


def forward_transform(
    coeffs_khwc: NDArray[np.float32], scale_k: NDArray[np.float32], levels: int, device: Device
) -> DeviceArray:
    """Scale and transform every channel plane of every map alone.

    Parameters
    ----------
    coeffs_khwc : ndarray, shape (n_coeff, height, width, channel), float32
        C-contiguous.
    scale_k : ndarray, shape (n_coeff,), float32
        Factor of each map, to bring it near 1.
    levels : int
        How often the low subband is split again; a side of one sample is left as it is.
    device : Device
        Where to run.

    Returns
    -------
    DeviceArray
        Subbands in place (see `list_subbands`), (n_coeff * channel, height, width padded to a multiple of 8). Near
        orthonormal: see lifting.clh.
    """
    planes = split_channels(coeffs_khwc, scale_k, device)
    transform_planes("analyse", planes, coeffs_khwc.shape[2], levels, device)
    device.finish()
    return planes


def split_channels(coeffs_khwc: NDArray[np.float32], scale_k: NDArray[np.float32], device: Device) -> DeviceArray:
    """Queue the scaling of maps, and return their channels as planes, (n_coeff * channel, height, padded width)."""
    planes = empty_planes(coeffs_khwc.shape, device)
    split_planes(device.upload(coeffs_khwc), planes, device, scale_k)
    return planes


def split_planes(
    coeffs: DeviceArray, planes: DeviceArray, device: Device, scale_k: NDArray[np.float32] | None = None
) -> None:
    """Queue the same of maps on the device, to planes that are there."""
    n_coeff, height, width, channels = coeffs.shape
    scale = np.ones(n_coeff, np.float32) if scale_k is None else np.ascontiguousarray(scale_k, dtype=np.float32)
    _launch(
        device,
        "planes_from_coeffs",
        (width, height, n_coeff * channels) if device.style == "gpu" else (height, n_coeff),
        planes,
        coeffs,
        device.upload(scale),
        *(height, width, channels, *planes.shape[1:]),
    )


def join_channels(
    planes: DeviceArray, shape: tuple[int, int, int, int], scale_k: NDArray[np.float32], device: Device
) -> NDArray[np.float32]:
    """Return scaled maps of a shape (n_coeff, height, width, channel) of what `split_channels` makes."""
    n_coeff, height, width, channels = shape
    coeffs = device.empty(shape, np.float32)
    _launch(
        device,
        "coeffs_from_planes",
        (width, height, n_coeff * channels) if device.style == "gpu" else (height, n_coeff),
        coeffs,
        planes,
        device.upload(np.ascontiguousarray(scale_k, dtype=np.float32)),
        *(height, width, channels, *planes.shape[1:]),
    )
    return device.download(coeffs)


def inverse_transform(
    planes: DeviceArray, shape: tuple[int, int, int, int], scale_k: NDArray[np.float32], levels: int, device: Device
) -> NDArray[np.float32]:
    """Undo `forward_transform`: overwrites `planes`, returns (n_coeff, height, width, channel) float32 coefficients.

    `scale_k` multiplies each map; what would exceed float32 is clamped to its largest number.
    """
    transform_planes("synthesise", planes, shape[2], levels, device)
    return join_channels(planes, shape, scale_k, device)


def transform_planes(verb: str, planes: DeviceArray, width: int, levels: int, device: Device) -> None:
    """Queue all levels of the transform of planes in place: ``"analyse"``, or its inverse ``"synthesise"``."""
    count, height, pitch = planes.shape
    if device.style == "gpu":
        scratch = device.empty(planes.shape, np.float32)
        sizes = _level_sizes(height, width, levels)
        for size in sizes if verb == "analyse" else reversed(sizes):
            _run_level(verb, planes, scratch, size, device)
        return
    workers = min(count, _PLANES_AT_ONCE * device.info.compute_units)
    rows = _BUFFERS * (pitch + _SLACK) + (height + 1) // 2 * pitch
    scratch = device.empty((workers, rows), np.float32)
    _launch(device, f"{verb}_planes", (workers,), planes, scratch, levels, width, *scratch.shape, *planes.shape)


def empty_planes(shape: tuple[int, int, int, int], device: Device) -> DeviceArray:
    """Return uninitialised planes for maps of a shape (n_coeff, height, width, channel)."""
    n_coeff, height, width, channels = shape
    return device.empty((n_coeff * channels, height, padded_width(width)), np.float32)


def padded_width(width: int) -> int:
    """Return the values of a row of planes: a multiple of 8."""
    return round_up(width, _LANES)


def dequantise_map(
    planes: DeviceArray,
    k: int,
    index_chw: NDArray[np.int32],
    step: float,
    biases: tuple[float, float],
    device: Device,
) -> None:
    """Write map `k` of `planes` as ``sign(q) (|q| - bias) step``; `biases` are those of |q| = 1 and of |q| > 1."""
    channels, height, width = index_chw.shape
    _launch(
        device,
        "dequantise",
        (width, height, channels),
        planes,
        device.upload(index_chw),
        *(step, *biases, k * channels, height, width, *planes.shape[1:]),
    )
    device.finish()  # the indices are the caller's memory


def _level_sizes(height: int, width: int, levels: int) -> list[tuple[int, int]]:
    sizes = []
    for _ in range(levels):
        sizes.append((height, width))
        height, width = (height + 1) // 2, (width + 1) // 2
    return [size for size in sizes if size != (1, 1)]


def _run_level(verb: str, planes: DeviceArray, scratch: DeviceArray, size: tuple[int, int], device: Device) -> None:
    height, width = size
    count, *pitch = planes.shape
    columns, rows = (width, (height + 1) // 2, count), (-(-width // 2), height, count)
    _launch(device, f"{verb}_columns", columns, scratch, planes, height, *pitch)
    _launch(device, f"{verb}_rows", rows, planes, scratch, width, *pitch)


def _launch(device: Device, kernel: str, global_size: tuple[int, ...], *arguments: object) -> None:
    local_size = None
    if device.style == "gpu":
        across, *others = global_size
        global_size, local_size = (round_up(across, _GROUP), *others), (_GROUP, 1, 1)
    device.launch("codec/wavelet.cl", kernel, global_size, *arguments, local_size=local_size)
