"""Apply a small matrix to every column of an array on the device: the work-horse of fitting and relighting."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import linear_to_srgb, srgb_to_linear
from clrelight.device import Device
from clrelight.matmul_gpu import launch_matmul, pack_rows
from clrelight.opencl.arguments import DeviceArray

COLUMN_PADDING = 16
"""Arrays that stay on the device have columns padded to a multiple of this, so that kernels need no tail."""
_RESONANT = 256
"""Rows of a multiple of this many columns lie in few sets of a processor's caches, so that a kernel that goes down a
column finds none of its lines again: three to four times the time of `ceb`."""

_CHUNK = 256
DEPTH = 64
_MAX_TILE = 256
_FEW_ROWS, _FEW_ROWS_SUMS = 4, 4096
"""Most rows that are summed at once, and sums that a work-item then keeps: it reads the source page by page."""
_SAMPLE_TYPES = {"uint8": "uchar", "uint16": "ushort", "float16": "half", "float32": "float", "float64": "double"}
_FLOAT32 = np.dtype(np.float32)


ENCODED = "encoded"
"""A `SampleCurve.transfer` that is none of a stack: linear code values, to be put on the sRGB curve."""


@dataclass(frozen=True)
class SampleCurve:
    """How kernels turn code values into linear radiance.

    Attributes
    ----------
    peak : float
        Code value that means 1.0.
    transfer : str
        ``"linear"`` or ``"srgb"``; of integers also `ENCODED`.
    """

    peak: float = 1.0
    transfer: str = "linear"

    def mode(self, dtype: np.dtype) -> int:
        """Return the CURVE of the kernels: 0 none, 1 a table of all code values, 2 the formula."""
        if self.transfer == "linear":
            return 0
        return 1 if np.issubdtype(dtype, np.integer) else 2

    def table(self, dtype: np.dtype, real: np.dtype = _FLOAT32) -> NDArray:
        """Return linear radiance for each code value, as `real`; one unused entry where no table is used."""
        if self.mode(dtype) != 1:
            return np.zeros(1, real)
        turn = linear_to_srgb if self.transfer == ENCODED else srgb_to_linear
        return turn(np.arange(np.iinfo(dtype).max + 1) / self.peak).astype(real)

    def operator_scale(self) -> float:
        """Return the factor that a matrix on code values must carry for its result to be in units of the peak."""
        return 1.0 / self.peak if self.transfer == "linear" else 1.0


@dataclass(frozen=True)
class PackedOperator:
    """A matrix on the device, as its kernels read it: for CPUs in row blocks with their heights (``matmul.cl``)."""

    packed_o: DeviceArray
    heights_b: DeviceArray | None
    shape: tuple[int, int]


def tile_defines(device: Device, real: np.dtype = _FLOAT32) -> dict[str, object]:
    """Return the definitions that tiles of `real` need: the largest tile whose local memory the device has."""
    size = real.itemsize
    vector = device.info.lanes if real == np.float32 else 8
    tile = _MAX_TILE
    while tile > 2 * vector and tile * size * (_CHUNK + 8) > device.info.local_memory_bytes:
        tile //= 2
    chunk = _CHUNK
    while chunk > DEPTH and tile * size * (chunk + 8) > device.info.local_memory_bytes:
        chunk //= 2
    return {"VECTOR": vector, "TILE": tile, "CHUNK": chunk, "DEPTH": DEPTH}


def sample_defines(dtype: np.dtype, real: np.dtype = _FLOAT32) -> dict[str, object]:
    """Return the definitions that name the stored type of samples, and the type that they are read as."""
    stored = np.dtype(dtype)
    return {
        "SAMPLE_T": _SAMPLE_TYPES[stored.name],
        "SAMPLE_HALF": int(stored == np.float16),
        "REAL_BITS": 8 * real.itemsize,
    }


def pad_columns(columns: int) -> int:
    """Return the number of columns of an array that stays on the device: no multiple of `_RESONANT`."""
    padded = -(-columns // COLUMN_PADDING) * COLUMN_PADDING
    return padded if padded % _RESONANT else padded + COLUMN_PADDING


def row_blocks(rows: int, widest: int) -> list[int]:
    """Split rows into the fewest blocks of at most `widest`, as even as they can be."""
    count = -(-rows // widest)
    return [rows // count + (b < rows % count) for b in range(count)]


def pack_operator(
    device: Device, operator_mi: NDArray, real: np.dtype = _FLOAT32, *, together: int = 1
) -> PackedOperator:
    """Upload a matrix (n_out, n_in), rounded to `real`: float32, or float64 for products in double precision.

    Blocks are of a multiple of `together` rows, at most 6, of which there are so many times any number.
    """
    operator = np.asarray(operator_mi, dtype=real)
    if device.style == "gpu":
        return PackedOperator(device.upload(pack_rows(operator)), None, operator.shape)
    # 32 vector registers hold two vectors of sums for 8 rows; where there are 16, for 6, or for 3 of eight doubles.
    narrow = 6 if real == np.float32 else 3
    widest = 8 if device.info.lanes == 16 else narrow
    heights = [together * each for each in row_blocks(len(operator) // together, max(widest // together, 1))]
    ends = np.cumsum(heights)
    blocks = [operator[end - height : end].T.ravel() for height, end in zip(heights, ends, strict=True)]
    return PackedOperator(
        device.upload(np.concatenate(blocks)), device.upload(np.array(heights, np.int32)), operator.shape
    )


def apply_operator(
    device: Device,
    operator: PackedOperator,
    source_ip: DeviceArray,
    out_mq: DeviceArray,
    *,
    curve: SampleCurve | None = None,
    energy_q: DeviceArray | None = None,
    weight_i: DeviceArray | None = None,
) -> None:
    """Queue ``out = operator source``, and the weighted energy of each column where asked for.

    Parameters
    ----------
    operator : PackedOperator, shape (n_out, n_in)
    source_ip : DeviceArray, shape (n_in, P)
        Any of the sample types; float64 where the product is.
    out_mq : DeviceArray, shape (n_out, Q), float32 or float64
        The type of the product, which the operator must have too. Columns from P on become 0.
    curve : SampleCurve, optional
        Turns code values into radiance (its `operator_scale` is the caller's to put in the operator).
    energy_q : DeviceArray, shape (Q,), of the product's type, optional
        ``sum_i weight_i source_i**2``.
    weight_i : DeviceArray, shape (n_in,), of the product's type, optional
        Needed with `energy_q`.
    """
    curve = curve or SampleCurve()
    if operator.shape != (out_mq.shape[0], source_ip.shape[0]):
        raise ValueError(f"operator {operator.shape} does not map {source_ip.shape[0]} rows to {out_mq.shape[0]}")
    with_energy, real = energy_q is not None, out_mq.dtype
    defines = {
        **sample_defines(source_ip.dtype, real),
        "WITH_ENERGY": int(with_energy),
        "CURVE": curve.mode(source_ip.dtype),
    }
    outputs = (out_mq, energy_q, weight_i) if with_energy else (out_mq,)
    curve_v, scale = device.upload(curve.table(source_ip.dtype, real)), 1.0 / curve.peak
    if operator.heights_b is None:
        arrays = (*outputs, source_ip, operator.packed_o, curve_v)
        launch_matmul(device, arrays, scale, out_mq.shape, source_ip.shape, defines)
        return
    is_plain = source_ip.dtype.kind == "f" and not defines["CURVE"] and not with_energy
    if out_mq.shape[0] <= _FEW_ROWS and is_plain and real == np.float32:
        columns = _FEW_ROWS_SUMS // max(2, out_mq.shape[0]) // 8 * 8
        device.launch(
            "few_rows.cl",
            "apply_few_rows_mq",
            (-(-out_mq.shape[1] // columns),),
            out_mq,
            source_ip,
            operator.packed_o,
            *out_mq.shape,
            *source_ip.shape,
            defines={**sample_defines(source_ip.dtype), "ROWS": out_mq.shape[0], "TILE": columns},
        )
        return
    tile = tile_defines(device, real)
    device.launch(
        "matmul.cl",
        "apply_operator_mq",
        (-(-out_mq.shape[1] // int(str(tile["TILE"]))),),
        *outputs,
        source_ip,
        operator.packed_o,
        operator.heights_b,
        curve_v,
        scale,
        *out_mq.shape,
        *source_ip.shape,
        operator.heights_b.shape[0],
        defines={**tile, **defines},
    )


def multiply_columns(device: Device, operator_mi: NDArray, source_ip: NDArray) -> NDArray[np.float32]:
    """Return ``operator source`` as float32, from host memory to host memory; see `apply_operator`."""
    out_mp = device.empty((len(operator_mi), source_ip.shape[1]), np.float32)
    apply_operator(device, pack_operator(device, operator_mi), device.upload(source_ip), out_mp)
    return device.download(out_mp)
