"""Launch the matmul's GPU kernels: how operators are cut into tiles, and what a group of work-items makes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.device import Device
from clrelight.opencl.arguments import DeviceArray

FEW_ROWS = 16
"""At most so many rows are all summed by each work-item."""
_FEW_WIDTH, _FEW_GROUP, _RUN_ROWS = 256, 128, 64

_TILE_WIDTH, _THREADS_X = 128, 32
_MOST_ROWS, _MOST_THREADS_Y, _DEPTH = 8, 8, 16


@dataclass(frozen=True)
class Tiling:
    """How an operator of more than `FEW_ROWS` rows is cut.

    Attributes
    ----------
    rows : int
        Rows that a work-item sums.
    threads_y : int
        Work-items that share a column: ``rows * threads_y`` rows are a block.
    depth : int
        Rows of the source in local memory at a time, a multiple of `threads_y`.
    blocks : int
        Row blocks.
    """

    rows: int
    threads_y: int
    depth: int
    blocks: int


def choose_tiling(n_out: int) -> Tiling:
    """Return the tiling with the fewest idle rows, among equals that with the most sums in registers."""
    blocks = -(-n_out // (_MOST_ROWS * _MOST_THREADS_Y))
    block_rows = -(-n_out // blocks)
    fitting = [
        (rows * threads_y, -rows, threads_y)
        for rows in range(1, _MOST_ROWS + 1)
        for threads_y in range(4, _MOST_THREADS_Y + 1)
        if rows * threads_y >= block_rows
    ]
    _, negative_rows, threads_y = min(fitting)
    return Tiling(-negative_rows, threads_y, max(1, round(_DEPTH / threads_y)) * threads_y, blocks)


def pack_rows(operator_mi: NDArray) -> NDArray:
    """Return the matrix, of any float type, as ``few_rows.gpu.cl`` or ``matmul.gpu.cl`` reads it, one axis."""
    n_out, n_in = operator_mi.shape
    if n_out <= FEW_ROWS:
        packed = np.zeros((_round_up(n_in, _RUN_ROWS), _round_up(n_out, 4)), operator_mi.dtype)
        packed[:n_in, :n_out] = operator_mi.T
        return packed.ravel()
    tiling = choose_tiling(n_out)
    shape = (tiling.blocks * tiling.threads_y * tiling.rows, _round_up(n_in, tiling.depth))
    padded = np.zeros(shape, operator_mi.dtype)
    padded[:n_out, :n_in] = operator_mi
    by_thread = padded.reshape(tiling.blocks, tiling.threads_y, tiling.rows, -1).transpose(0, 3, 1, 2)
    return np.pad(by_thread, [(0, 0)] * 3 + [(0, -tiling.rows % 4)]).ravel()


def launch_matmul(
    device: Device,
    arrays: tuple[DeviceArray, ...],
    scale: float,
    shape_mq: tuple[int, ...],
    shape_ip: tuple[int, ...],
    defines: Mapping[str, Any],
) -> None:
    """Queue the kernel for this number of rows; `arrays` are those of `clrelight.matmul.apply_operator`."""
    n_out, columns = shape_mq
    if n_out <= FEW_ROWS:
        device.launch(
            "few_rows.cl",
            "apply_few_rows_mq",
            (-(-columns // _FEW_WIDTH) * _FEW_GROUP,),
            *arrays,
            scale,
            columns,
            *shape_ip,
            defines={**defines, "ROWS": n_out, "DEPTH": _RUN_ROWS},
            local_size=(_FEW_GROUP,),
        )
        return
    tiling = choose_tiling(n_out)
    group = _THREADS_X * tiling.threads_y
    device.launch(
        "matmul.cl",
        "apply_operator_mq",
        (-(-columns // _TILE_WIDTH) * tiling.blocks * group,),
        *arrays,
        scale,
        n_out,
        columns,
        *shape_ip,
        tiling.blocks,
        defines={
            **defines,
            "ROWS": tiling.rows,
            "THREADS_Y": tiling.threads_y,
            "DEPTH": tiling.depth,
            "RUN": max(1, _RUN_ROWS // tiling.depth),
        },
        local_size=(group,),
    )


def _round_up(count: int, multiple: int) -> int:
    return -(-count // multiple) * multiple
