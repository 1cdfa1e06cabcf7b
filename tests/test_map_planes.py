"""Planes of a part of a map in memory, against float64."""

import numpy as np
import pytest

from clrelight.codec.transforms.map_planes import _TILES, has_tile, planes_of_map
from clrelight.matmul import pack_operator

TILE = _TILES[0]


@pytest.mark.parametrize("channel", [1, 2, 3])
@pytest.mark.parametrize("width", [1, 7, TILE - 1, TILE, TILE + 1, 3 * TILE + 29])
def test_planes_are_products_less_offsets(device, width, channel):
    if device.style != "cpu":
        pytest.skip("a GPU's arrays of samples are read otherwise")
    rng = np.random.default_rng(width + channel)
    n_coeff, n_plane, rows, left, at, pitch = 9, 11, 3, 5, 2, (width + 7) // 8 * 8
    coeffs = (rng.standard_normal((n_coeff, 6, width + 9, channel)) * 1e3).astype(np.float32)
    last, offset = rng.standard_normal((n_plane, n_coeff * channel)), rng.standard_normal(n_plane).astype(np.float32)
    made = device.hold(np.full((n_plane, rows + 4, pitch), 7.0, np.float32))
    planes_of_map(
        made,
        device.upload(coeffs),
        pack_operator(device, last),
        device.upload(offset),
        (2, 2 + rows),
        (left, left + width),
        at,
        device,
    )
    found = device.download(made)
    part = coeffs[:, 2 : 2 + rows, left : left + width].astype(np.float64)
    factors = last.astype(np.float32).astype(np.float64).reshape(n_plane, n_coeff, channel)
    wanted = np.einsum("jkc,kyxc->jyx", factors, part) - offset[:, None, None]
    terms = np.einsum("jkc,kyxc->jyx", np.abs(factors), np.abs(part)) + np.abs(offset)[:, None, None]
    assert (np.abs(found[:, at : at + rows, :width] - wanted) <= (n_coeff * channel + 2) * 2.0**-23 * terms).all()
    # Nothing else is written: rows in front and behind, and columns that pad a row.
    found[:, at : at + rows, :width] = 7.0
    assert (found == 7.0).all()


def test_room_is_what_local_memory_holds(device):
    most = device.info.local_memory_bytes // (8 * _TILES[-1]) - 8
    assert has_tile(device, 1 << (most.bit_length() - 1)) == (_TILES[-1] >= 2 * device.info.lanes)
    assert not has_tile(device, most + 1)
