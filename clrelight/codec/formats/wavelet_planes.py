"""The planes of the codec `wavelet`: components of each map's channels, transformed, of parts of the image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import LEVELS, Layout, Unit, Window, lay_out
from clrelight.codec.streams import Source
from clrelight.codec.transforms.lifting import list_subbands, padded_width, transform_planes
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.workspace import Shape
from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

_SAMPLED, _SAMPLES = 1 << 12, 1 << 12
_STRIDE = 3
_GOLDEN = 0.6180339887498949
SQUARE, PIECE = 64, 128
"""Sides in pixels of what is tried of a map that is one tile, and of others."""


@dataclass(frozen=True)
class Scan:
    """What is known of all maps before they are coded.

    Attributes
    ----------
    exponent_k : ndarray, shape (n_coeff,), int64
        Of the largest magnitude, as ``2**e <= largest < 2**(e + 1)``.
    present_k : ndarray of bool
        Whether a map has anything but zeros.
    moments_kcc : ndarray, shape (n_coeff, channel, channel), float64
        Second moments of the channels, of some pixels, in units of ``4**e``.
    """

    exponent_k: NDArray[np.int64]
    present_k: NDArray[np.bool_]
    moments_kcc: NDArray[np.float64]


def scan(source: Source) -> Scan:
    """Read all rows once."""
    n_coeff, height, width, channel = source.shape
    largest_k, sampled = np.zeros(n_coeff, np.float32), []
    step = max(height * width // _SAMPLED, 1) | 1
    with source.rows() as parts:
        for first, coeffs_khwc in parts:
            flat = coeffs_khwc.reshape(n_coeff, -1)
            largest_k = np.maximum(largest_k, np.maximum(flat.max(axis=1), -flat.min(axis=1)))
            pixels = coeffs_khwc.reshape(n_coeff, -1, channel)
            sampled.append(pixels[:, -first * width % step :: step].astype(np.float64))
    exponent_k = np.frexp(largest_k.astype(np.float64))[1].astype(np.int64) - 1
    values_kpc = np.ldexp(np.concatenate(sampled, axis=1), -exponent_k[:, None, None])
    return Scan(exponent_k, largest_k > 0, values_kpc.transpose(0, 2, 1) @ values_kpc)


@dataclass(frozen=True)
class Part:
    """Wavelet coefficients of the planes of a part of the image, and which of them are coded.

    Attributes
    ----------
    values : DeviceArray, shape (n_plane, height, pitch), float32
        In units of two to their map's exponent.
    layout : Layout
    width : int
        Of the part; rows of the planes may be longer.
    n_pixel : int
        Pixels that what is coded is of.
    """

    values: DeviceArray
    layout: Layout
    width: int
    n_pixel: int

    def samples(self, device: Device, *, coded: bool = False) -> NDArray[np.float32]:
        """Return some of each plane's magnitudes, (n_plane, n), at the same places; only of what is coded."""
        values_jp = device.download(self.values).reshape(self.values.shape[0], -1)
        if coded:
            places = np.flatnonzero(mask_of(self.layout, self.values.shape[1:]))
        else:  # not what rows are padded with: most of a list of vertices, whose rows have one pixel
            places = np.flatnonzero(np.arange(values_jp.shape[1]) % self.values.shape[2] < self.width)
        return np.abs(values_jp[:, places[:: max(len(places) // _SAMPLES, 1) | 1]])

    def sizes(self, device: Device) -> NDArray[np.float64]:
        """Return the mean magnitude of each plane on each level, (n_plane, LEVELS)."""
        values_jyx = device.download(self.values)[:, :, : self.width]
        sums, counts = np.zeros((len(values_jyx), LEVELS)), np.zeros(LEVELS)
        for band in list_subbands(values_jyx.shape[1], self.width, LEVELS):
            if band.name == "LL":
                continue
            # Every level of a subband with some rows only: what is asked for is a power of two.
            part = values_jyx[:, band.rows, band.columns][:, :: _STRIDE if band.level < 3 else 1]
            sums[:, band.level - 1] += np.abs(part).sum(axis=(1, 2), dtype=np.float64)
            counts[band.level - 1] += part[0].size
        return sums / np.maximum(counts, 1)


def list_squares(height: int, width: int, count: int) -> list[tuple[int, int]]:
    """Return squares of `SQUARE` pixels spread over an image, as multiples of it; none where they are half of it."""
    rows, columns = height // SQUARE, width // SQUARE
    count = max(count, 2)
    if 2 * count >= rows * columns:
        return []
    # Evenly in rows, and by multiples of the golden ratio in columns.
    row_i = np.arange(count) * rows // count
    column_i = (np.arange(count) * _GOLDEN % 1.0 * columns).astype(int)
    return sorted(set(zip(row_i.tolist(), column_i.tolist(), strict=True)))


def lay_out_squares(
    squares: list[tuple[int, int]], height: int, width: int, pitch: int, groups: list[tuple[int, int]]
) -> Layout:
    """Return the layout of squares of an image with what is of them on all levels, each group of planes one stream."""
    levels = (0, *range(LEVELS, 0, -1))
    units = [Unit(v, i * SQUARE >> (v or LEVELS), j * SQUARE >> (v or LEVELS)) for i, j in squares for v in levels]
    layout = lay_out(units, (height, width), Window(0, 0, height, width), pitch, True, groups)
    side_u = np.array([SQUARE >> (unit.level or LEVELS) for unit in units])
    layout.unit_uf[:, 4:10] = np.minimum(layout.unit_uf[:, 4:10], side_u[:, None])
    return layout


def list_windows(height: int, width: int, count: int) -> list[Window]:
    """Return pieces that lie all over an image."""
    side_h, side_w = min(PIECE, height), min(PIECE, width)
    across = min(max(round((count * width / height) ** 0.5), 1), count, max(width // side_w, 1))
    down = max(min(-(-count // across), height // side_h), 1)
    tops = [int((height - side_h) * (i + 0.5) / down) & ~31 for i in range(down)]
    lefts = [int((width - side_w) * (i + 0.5) / across) & ~31 for i in range(across)]
    return [Window(top, left, top + side_h, left + side_w) for top in tops for left in lefts]


def mask_of(layout: Layout, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which samples of a plane units hold."""
    mask_yx = np.zeros(shape, np.bool_)
    for unit in layout.unit_uf.tolist():
        for band in range(3):
            if unit[4 + band] > 0 and unit[7 + band] > 0:
                y, x = divmod(unit[1 + band], shape[1])
                mask_yx[y : y + unit[4 + band], x : x + unit[7 + band]] = True
    return mask_yx


def scales_of(exponent_k: NDArray[np.integer]) -> NDArray[np.float32]:
    """Return powers of two as two factors each, (n, 2), which float32 holds where it does not hold the product."""
    half = exponent_k // 2
    return np.ldexp(1.0, np.stack([half, exponent_k - half], axis=1)).astype(np.float32)


class PlaneMaker:
    """Makes wavelet coefficients of a part of the image.

    Parameters
    ----------
    source : Source
    scan : Scan
    rotation_kdc : ndarray, shape (n_coeff, channel, channel), float64, or None
    place_kd : ndarray, shape (n_coeff, channel), int32
        The plane of each component.
    """

    def __init__(
        self, source: Source, known: Scan, rotation_kdc: NDArray[np.float64] | None, place_kd: NDArray[np.int32]
    ) -> None:
        self._pixels, self._device, self._place = Pixels(source), source.device, place_kd
        self._rotation, self._scale = rotation_kdc, scales_of(-known.exponent_k)

    def values(self, window: Window) -> DeviceArray:
        """Return the coefficients of a window's planes, (n_plane, height, padded width)."""
        device = self._device
        coeffs_khwc = np.ascontiguousarray(
            self._pixels.coefficients((window.top, window.bottom), (window.left, window.right))
        )
        n_plane, (height, width) = int(self._place.max(initial=-1)) + 1, window.shape
        planes = device.empty((n_plane, height, padded_width(width)), np.float32)
        launch_rotation(
            "rotate_channels", planes, device.upload(coeffs_khwc), self._rotation, self._scale, self._place, device
        )
        transform_planes("analyse", planes, width, LEVELS, device)
        device.finish()  # what was read may be read into again
        return planes


def launch_rotation(
    kernel: str,
    planes: DeviceArray,
    coeffs: DeviceArray,
    rotation_kdc: NDArray[np.float64] | None,
    scale_k2: NDArray[np.float32],
    place_kd: NDArray[np.int32],
    device: Device,
) -> None:
    """Queue one of the kernels of ``rotate.cl``."""
    n_coeff, height, width, channel = coeffs.shape
    flat = np.zeros((1, 1)) if rotation_kdc is None else rotation_kdc.reshape(n_coeff, -1)
    made, given = (planes, coeffs) if kernel == "rotate_channels" else (coeffs, planes)
    device.launch(
        "codec/rotate.cl",
        kernel,
        (height, n_coeff),
        *(made, given, device.upload(flat.astype(np.float32)), device.upload(scale_k2), device.upload(place_kd)),
        *(int(rotation_kdc is not None), height, width, channel, *planes.shape[1:]),
    )


def planes_to_maps(
    planes_jyx: DeviceArray,
    shape: Shape,
    rotation_kdc: NDArray[np.float64] | None,
    step_k: NDArray[np.float64],
    place_kd: NDArray[np.int32],
    device: Device,
) -> NDArray[np.float32]:
    """Return maps (n_coeff, height, width, channel) of planes in steps; what float32 cannot hold is clamped."""
    mantissa_k, exponent_k = np.frexp(step_k)
    scale_k2 = scales_of(exponent_k)
    scale_k2[:, 0] *= mantissa_k.astype(np.float32)
    coeffs = device.empty(shape, np.float32)
    launch_rotation("unrotate_channels", planes_jyx, coeffs, rotation_kdc, scale_k2, place_kd, device)
    return device.download(coeffs)
