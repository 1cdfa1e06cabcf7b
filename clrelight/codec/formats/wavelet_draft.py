"""What the codec `wavelet` decides before it looks for steps: rotations, groups of maps, and what streams hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.units import count_units
from clrelight.codec.formats.wavelet_planes import Scan
from clrelight.codec.formats.wavelet_units import ABSENT, MOST_CHANNELS, MOST_TOGETHER, Tables
from clrelight.codec.transforms.channels import angles_of, count_angles
from clrelight.codec.workspace import Shape

_STREAM_BYTES = 1 << 14
"""Bytes that streams should have at the least: they learn alone."""
_GROUP = 8
"""Maps of a group at the least."""
_ANGLE_PARTS = (3e-3, 1e-2)
"""Parts of a budget that tables of fine and of coarse angles may take."""


def draft_tables(known: Scan, shape: Shape, budget: int) -> Tables:
    """Return tables without steps: rotations, groups, and whether units are streams of their own."""
    _, height, width, channel = shape
    present = np.flatnonzero(known.present_k)
    units = count_units(height, width)
    together = height * width <= MOST_TOGETHER and budget < _STREAM_BYTES * units
    parts = budget // (_STREAM_BYTES * (1 if together else units))
    group = min(max(-(-len(present) // max(parts, 1)), _GROUP), 65535)
    code_k = np.where(known.present_k, 0, ABSENT).astype(np.int64)
    return Tables(code_k, _draft_angles(known.moments_kcc[present], channel, budget), together, group)


def _draft_angles(moments_mcc: NDArray[np.float64], channel: int, budget: int) -> NDArray[np.unsignedinteger]:
    """Return what turns channels to their principal axes: of every map, of all together, or nothing."""
    if not (1 < channel <= MOST_CHANNELS and len(moments_mcc)):
        return np.zeros((0, 0), np.uint8)
    fine, coarse = (budget * part / count_angles(channel) for part in _ANGLE_PARTS)
    if coarse < len(moments_mcc):
        moments_mcc = moments_mcc.sum(axis=0, keepdims=True)
    if coarse < 1:
        return np.zeros((0, 0), np.uint8)
    axes_mdc = np.linalg.eigh(moments_mcc)[1][:, :, ::-1].transpose(0, 2, 1)
    return angles_of(axes_mdc, np.dtype(np.uint16 if 2 * len(moments_mcc) <= fine else np.uint8))
