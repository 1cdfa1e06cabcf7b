"""Directions of lights in few bytes."""

import ast
import json
import re
import struct
import zlib

import h5py
import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.light_codes import MOST_PACKED, WITHIN, pack_directions, unpack_directions, unpack_directions_of_5
from clrelight.sampling import make_pattern
from clrelight.store import read_encoded
from clrelight.store.usual import USUAL
from tests.commands import ROOT

STEPS = 1 << 15


def spread(count, seed=1):
    around = np.random.default_rng(seed).standard_normal((count, 3))
    return around / np.linalg.norm(around, axis=1, keepdims=True)


def read_plainly(packed):
    """What docs/files.md says of the bytes, bit by bit."""
    times, lag, low, count = struct.unpack_from("<BBBH", packed)
    bits = [byte >> k & 1 for byte in packed[5:] for k in range(8)]
    lows = [sum(bits[n * low + k] << k for k in range(low)) for n in range(2 * count)]
    at, values = 2 * count * low, []
    for n in range(2 * count):
        zeros = 0
        while not bits[at]:
            at, zeros = at + 1, zeros + 1
        at += 1
        code = (zeros << low) + lows[n]
        values.append(-(code + 1) // 2 if code % 2 else code // 2)
    places = [values[0::2], values[1::2]]
    for _ in range(times):
        places = [[sum(each[n % lag : n + 1 : lag]) for n in range(count)] for each in places]
    found = []
    for x, y in zip(*places, strict=True):
        z = STEPS - abs(x) - abs(y)
        if z < 0:
            x, y = (STEPS - abs(y)) * (-1 if x < 0 else 1), (STEPS - abs(x)) * (-1 if y < 0 else 1)
        found.append(np.array([x, y, z]) / np.sqrt(x * x + y * y + z * z))
    return np.array(found)


def test_directions_come_back():
    around = spread(MOST_PACKED)
    around[:1000, 2] = np.abs(around[:1000, 2]) * 1e-8
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    packed = pack_directions(around)
    back = unpack_directions(packed)
    assert np.linalg.norm(back - around, axis=1).max() < WITHIN
    assert back[:1000, 2].min() >= 0
    np.testing.assert_array_equal(unpack_directions(pack_directions(back)), back)
    assert len(packed) < 4.2 * MOST_PACKED
    axes = np.array([[1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1], [-1, 0, 0.0]])
    np.testing.assert_array_equal(unpack_directions(pack_directions(axes)), axes)
    assert unpack_directions(pack_directions(axes[:0])).shape == (0, 3)


@pytest.mark.parametrize("way", [(0, 1), (1, 1), (2, 1), (1, 5)])
def test_bytes_are_as_documented(way):
    """Lights in any order, along a path of small steps, along a smooth one, and along five by turns."""
    turn = np.linspace(0.0, 3.0, 60)
    smooth = np.stack([np.cos(turn), np.sin(turn), 0.3 + turn], axis=1)
    wandering = np.array([0.0, 0.0, 9.0]) + np.cumsum(spread(60), axis=0)
    five = np.tile(5.0 * spread(5, 7), (12, 1)) + 0.1 * spread(60)
    lights_i3 = {(0, 1): spread(60), (1, 1): wandering, (2, 1): smooth, (1, 5): five}[way]
    lights_i3 = lights_i3 / np.linalg.norm(lights_i3, axis=1, keepdims=True)
    packed = pack_directions(lights_i3)
    assert tuple(packed[:2]) == way
    np.testing.assert_allclose(unpack_directions(packed), read_plainly(packed), rtol=0, atol=1e-15)


def test_a_dome_takes_few_bytes():
    lights_i3 = make_pattern("uniform", 240)
    assert len(pack_directions(lights_i3)) < 3.4 * 240


def test_what_is_no_list_of_directions_is_refused():
    packed = pack_directions(spread(9))
    for damaged in (b"", packed[:3], packed[:-1], packed + b"\0", b"\3" + packed[1:], packed[:3] + b"\xff\xff"):
        with pytest.raises(InputError, match="directions"):
            unpack_directions(damaged)
    unmoved = packed[:1] + b"\0" + packed[2:]
    with pytest.raises(InputError, match="differences at 0"):
        unpack_directions(unmoved)
    far = struct.pack("<BBBH", 0, 1, 17, 1) + np.packbits([0] * 16 + [1] * 18 + [1, 1], bitorder="little").tobytes()
    with pytest.raises(InputError, match="beyond the octahedron"):
        unpack_directions(far)
    with pytest.raises(InputError, match="5 bytes each"):
        unpack_directions_of_5(b"1234")


def test_no_bytes_do_harm():
    rng = np.random.default_rng(2)
    packed = pack_directions(spread(12))
    for _ in range(1000):
        damaged = bytearray(packed)
        for at in rng.integers(0, len(damaged), 3):
            damaged[at] = rng.integers(256)
        try:
            found = unpack_directions(bytes(damaged))
        except InputError:
            continue
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0)


def test_the_dictionary_of_records_is_documented():
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    assert ast.literal_eval(re.search(r"usual = (\(\n.*?\n\))", page, re.DOTALL)[1]) == USUAL


def test_the_reader_of_the_page_reads_a_file():
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    path = ROOT / "tests" / "frozen" / "encoded.4.hdf"
    with h5py.File(path) as file:
        names = {"zlib": zlib, "json": json, "struct": struct, "file": file}
        exec(re.search(r"```python\n(usual = .*?)```", page, re.DOTALL)[1], names)
    record = read_encoded(path)[1]
    assert (names["facts"]["method"], names["facts"]["degree"]) == (record.method, record.degree)
    x, y = np.array(names["places"]).T
    found = np.stack([x, y, STEPS - np.abs(x) - np.abs(y)], axis=1)
    assert found[:, 2].min() >= 0  # of these lights none is folded
    np.testing.assert_allclose(found / np.linalg.norm(found, axis=1, keepdims=True), record.directions_i3, atol=1e-15)
