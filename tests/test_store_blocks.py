"""Blocks and their checksums: what is read is what was written, whole blocks are checked, and no byte is left out."""

import errno
import itertools
import json
import os
import subprocess
import sys
import threading

import h5py
import numpy as np
import pytest

from clrelight import durable, store
from clrelight.dataset import LightStack
from clrelight.errors import InputError, StoreFormatError
from clrelight.store import writing
from clrelight.store.blocks import Blocks, BlockWriter, box_of
from clrelight.store.stored import StoredArray
from clrelight.tiles import Rectangle
from tests.commands import ROOT, call, environment
from tests.file_mutations import KINDS
from tests.hdf5 import content, unseal
from tests.stacks import make_stack
from tests.test_store import write_each


def values_of(shape, dtype):
    return np.random.default_rng(5).integers(0, 256, (*shape, np.dtype(dtype).itemsize), np.uint8).view(dtype)[..., 0]


SHAPE = (6, 11, 5, 3)
CHUNKS = [(6, 1, 5, 3), (6, 4, 5, 3), (3, 2, 5, 3), (1, 9, 5, 3), (4, 4, 5, 3), (2, 4, 3, 2), None]


def write_blocks(path, values, chunks, steps=((0, 6), (0, 11))):
    """Write an array in boxes of lights and rows; return the checksums of its blocks."""
    with h5py.File(path, "w", libver="latest") as file:
        dataset = file.create_dataset("x", values.shape, values.dtype, chunks=chunks)
        writer = BlockWriter(dataset)
        for lights in itertools.pairwise(steps[0]):
            for rows in itertools.pairwise(steps[1]):
                box = slice(*lights), slice(*rows), slice(0, values.shape[2]), slice(0, values.shape[3])
                writer.write(box, values[box])
        return writer.sums()


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("chunks", CHUNKS)
def test_rows_are_those_that_were_written(tmp_path, dtype, chunks):
    values = values_of(SHAPE, dtype)
    sums = write_blocks(tmp_path / "x.h5", values, chunks)
    with h5py.File(tmp_path / "x.h5") as file:
        stored = StoredArray(file["x"], "x.h5", sums)
        assert len(sums) == Blocks.of(file["x"]).count
        for first, end in ((0, 11), (1, 11), (3, 4), (2, 9), (10, 11), (4, 4)):
            out = np.zeros((6, end - first, 5, 3), dtype)
            stored.read_into(Rectangle(first, 0, end, 5), out)
            assert out.tobytes() == values[:, first:end].tobytes()
            for picked in (np.arange(6), np.array([4, 1, 5]), np.array([2]), np.array([-1, 0]), np.array([1, 4, 1])):
                out = np.zeros((len(picked), end - first, 5, 3), dtype)
                stored.read_into(Rectangle(first, 0, end, 5), out, picked)
                assert out.tobytes() == values[picked, first:end].tobytes()


@pytest.mark.parametrize(
    "key",
    [..., 0, -1, (slice(None), 2), (slice(1, 4), slice(3, 5)), (..., 1), ([0, 3], slice(2, 4)), (1, ..., 2), [2, 2],
     (slice(0, 6, 2), slice(9, 30)), (slice(3, 3),), (slice(-2, None), -3, 1, 0), np.array([True, False] * 3)],
)  # fmt: skip
@pytest.mark.parametrize("chunks", CHUNKS)
def test_indices_are_those_of_arrays(tmp_path, chunks, key):
    values = values_of(SHAPE, "uint16")
    sums = write_blocks(tmp_path / "x.h5", values, chunks)
    with h5py.File(tmp_path / "x.h5") as file:
        for stored in (StoredArray(file["x"], "x.h5", sums), StoredArray(file["x"], "x.h5")):
            np.testing.assert_array_equal(stored[key], values[key], strict=True)


@pytest.mark.parametrize("key", [6, -7, (0, 11), ([0, 6],), (0, 0, 0, 0, 0), (slice(None, None, -1),)])
def test_indices_beyond_an_array_are_refused(key):
    with pytest.raises(IndexError):
        box_of(key, SHAPE)


@pytest.mark.parametrize(("first", "end", "out"), [(-1, 2, (6, 3, 5, 3)), (9, 12, (6, 3, 5, 3)), (0, 2, (6, 3, 5, 3))])
def test_an_array_that_does_not_fit(tmp_path, first, end, out):
    sums = write_blocks(tmp_path / "x.h5", values_of(SHAPE, "uint8"), (6, 1, 5, 3))
    with h5py.File(tmp_path / "x.h5") as file, pytest.raises(ValueError, match="expected a"):
        StoredArray(file["x"], "x.h5", sums).read_into(Rectangle(first, 0, end, 5), np.zeros(out, np.uint8))


@pytest.mark.parametrize("chunks", CHUNKS)
def test_checksums_do_not_depend_on_how_an_array_comes(tmp_path, chunks):
    values = values_of(SHAPE, "float32")
    steps = [((0, 6), (0, 11)), ((0, 1, 2, 3, 4, 5, 6), (0, 11)), ((0, 6), (0, 3, 4, 8, 11)), ((0, 2, 6), (0, 5, 11))]
    sums = [write_blocks(tmp_path / f"{i}.h5", values, chunks, step).tolist() for i, step in enumerate(steps)]
    assert sums == [sums[0]] * len(steps)


def make_rows():
    rng = np.random.default_rng(6)
    return (
        rng.standard_normal((4, 11, 5, 3), np.float32),
        rng.random((11, 5, 3), np.float32),
        rng.integers(0, 9, (11, 5, 3), np.int32),
    )


def write_rows(path, steps=(0, 4, 5, 8, 11)):
    """Write a fit in tiles; return the file's bytes."""
    rows = make_rows()
    about = {"degree": 1, "method": "cls", "peak": 255.0, "transfer": "srgb", "config": {}, "name": "x"}
    maps = {"has_lambda": True, "has_rank": True}
    with store.create_fit(path, store.FitRecord(directions_i3=np.eye(3), **about), (11, 5, 3), **maps) as sink:
        for first, end in itertools.pairwise(steps):
            sink.write_rows(first, rows[0][:, first:end], rows[1][first:end], rows[2][first:end])
        out = np.empty((4, 7, 5, 3), np.float32)
        sink.coeffs_khwc.read_into(Rectangle(2, 0, 9, 5), out)
        assert out.tobytes() == rows[0][:, 2:9].tobytes()
    return path.read_bytes()


@pytest.mark.parametrize("chunk_bytes", [1, 240, 720, 1 << 20])  # chunks of 1, 1, 3 (11 is no multiple) and 11 rows
def test_a_file_has_the_same_bytes_in_whatever_tiles_it_comes(tmp_path, monkeypatch, chunk_bytes):
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(writing, "CHUNK_BYTES", chunk_bytes)
    steps = [(0, 4, 5, 8, 11), (0, 11), tuple(range(12))]
    files = [write_rows(tmp_path / f"{i}.h5", step) for i, step in enumerate(steps)]
    assert files == [files[0]] * 3
    back = store.read_fit(tmp_path / "1.h5")
    for found, wanted in zip((back.coeffs_khwc, back.lambda_hwc, back.rank_hwc), make_rows(), strict=True):
        assert found.tobytes() == wanted.tobytes()


def write_chunked(path, images):
    """Write a stack of three chunks, each of 2 x 3 x 5 x 3 bytes, and return where the second lies."""
    with store.create_stack(path, LightStack(images, np.eye(3)[:2], 255.0, "srgb")) as sink:
        assert sink.chunks == (2, 3, 5, 3)
        sink[...] = images
    with h5py.File(path, "r") as file:
        return file["images"].id.get_chunk_info(1).byte_offset


@pytest.mark.parametrize("way", ["memory", "streamed"])
def test_a_part_of_a_damaged_block_is_refused(tmp_path, monkeypatch, way):
    monkeypatch.setattr(writing, "CHUNK_BYTES", 90)
    if way == "streamed":
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    path = tmp_path / "s.h5"
    images = values_of((2, 9, 5, 3), "uint8")
    images[:, 3:5] = 0
    at = write_chunked(path, images)
    good = path.read_bytes()
    out = np.zeros((2, 9, 5, 3), np.uint8)
    for offset, length, value in ((0, 1, 0xFF), (45, 30, 0xFF), (44, 2, 1), (89, 1, good[at + 89] ^ 16), (0, 90, 0xFF)):
        bad = bytearray(good)
        bad[at + offset : at + offset + length] = bytes([value]) * length
        assert bad != good
        path.write_bytes(bad)
        with store.open_stack(path) as stack:
            for images in (stack, stack.select(np.array([1])), stack.select(np.array([0]))):
                for first, end in ((0, 3), (6, 9)):  # the rows beside it are sound
                    images.read_rows(first, end, out[: images.n_light, first:end].copy())
                for first, end in ((0, 9), (3, 4), (5, 6), (4, 7)):
                    with pytest.raises(
                        StoreFormatError, match=r"s\.h5: images is damaged: the checksum of its block 1"
                    ):
                        images.read_rows(first, end, out[: images.n_light, first:end].copy())


def test_zeros_that_become_ones_are_seen(tmp_path):
    """2000 saturated samples made black, and black ones saturated: Fletcher's checksum sees neither."""
    path = tmp_path / "s.h5"
    images = np.zeros((2, 50, 40, 3), np.uint8)
    images[1] = 255
    with store.create_stack(path, LightStack(images, np.eye(3)[:2], 255.0, "srgb")) as sink:
        sink[...] = images
    good = path.read_bytes()
    at = good.index(b"\xff" * 2000)
    for value, start in ((0, at), (255, at - 2000)):
        bad = bytearray(good)
        bad[start : start + 2000] = bytes([value]) * 2000
        path.write_bytes(bad)
        with store.open_stack(path) as stack, pytest.raises(StoreFormatError, match="images is damaged"):
            stack.read_rows(0, 1)


def test_a_file_cut_short_while_it_is_open(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "CHUNK_BYTES", 90)
    path = tmp_path / "s.h5"
    at = write_chunked(path, values_of((2, 9, 5, 3), "uint8"))
    out = np.zeros((2, 9, 5, 3), np.uint8)
    with store.open_stack(path) as stack:
        stack.images_ihwc.read_into(Rectangle(0, 0, 9, 5), out)
        os.truncate(path, at + 10)
        with pytest.raises(StoreFormatError, match="images is damaged"):
            stack.images_ihwc.read_into(Rectangle(0, 0, 9, 5), out)


def test_many_threads_read_one_array(tmp_path):
    values = values_of((16, 200, 16, 3), "float32")
    sums = write_blocks(tmp_path / "x.h5", values, (16, 3, 16, 3), ((0, 16), (0, 200)))
    with h5py.File(tmp_path / "x.h5", "r") as file:
        stored, wrong = StoredArray(file["x"], "x.h5", sums), []

        def read(start):
            for count in range(60):
                row = (start + 7 * count) % 199
                wrong.append(stored[:, row : row + 2].tobytes() != values[:, row : row + 2].tobytes())

        threads = [threading.Thread(target=read, args=(i,)) for i in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(wrong) == 240
        assert not any(wrong)


# The seal


def change_peak(file):
    file.attrs["peak"] = 99.0


def change_table(file):
    file["clrelight/checksums"][0] ^= 1


def lose_table(file):
    del file["clrelight/checksums"]


def lose_group(file):
    del file["clrelight"]


def lose_seal(file):
    del file.attrs["clrelight_checksums"]


def lose_a_sum(file):
    table = file["clrelight/checksums"][1:]
    del file["clrelight/checksums"]
    file["clrelight/checksums"] = table


def retype_table(file):
    table = file["clrelight/checksums"][...]
    del file["clrelight/checksums"]
    file["clrelight/checksums"] = table.astype("<i8")


def lose_mask(file):
    del file["mask"]


def rechunk(file):
    images = file["images"][...]
    del file["images"]
    file.create_dataset("images", data=images, chunks=(1, *images.shape[1:]))


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        (change_peak, "its attributes, shapes or checksums are not as they were written"),
        (change_table, "its attributes, shapes or checksums are not as they were written"),
        (lose_table, "it has lost its checksums (clrelight/checksums)"),
        (lose_group, "it has lost its checksums (clrelight/checksums)"),
        (lose_seal, "it has lost its checksums (clrelight_checksums)"),
        (lose_a_sum, "3 checksums, its arrays 4 blocks"),
        (retype_table, "expected <u8 with 1 axis"),
        (lose_mask, "4 checksums, its arrays 3 blocks"),
        (rechunk, "4 checksums, its arrays 8 blocks"),
    ],
)
def test_a_file_that_was_changed_says_how_to_trust_it(tmp_path, change, phrase):
    path = write_each(tmp_path)["stack"]
    with h5py.File(path, "r+", libver="latest") as file:
        change(file)
    for words in (("info", path), ("fit", path, tmp_path / "f.h5", "--degree", 1)):
        ended = call(*words)
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert phrase in ended.err
    if change not in (lose_table, lose_group, lose_seal, retype_table):
        assert "delete its attribute clrelight_checksums and its group clrelight" in ended.err
    with h5py.File(path, "r+", libver="latest") as file:
        file.require_group("clrelight")
        file.attrs["clrelight_checksums"] = ""
        unseal(file)
    with store.open_stack(path) as stack:
        assert stack.peak == (99.0 if change is change_peak else 200.0)


def test_what_another_program_adds_does_not_matter(tmp_path):
    for kind, path in write_each(tmp_path).items():
        before = content(kind, path)
        with h5py.File(path, "r+") as file:
            file["exif"], file.attrs["comment"] = "x", "seen"
        assert content(kind, path) == before


def test_no_damage_goes_unnoticed():
    command = [sys.executable, "-m", "tests.file_mutations", "--count", "1000", "--seed", "3"]
    done = subprocess.run(command, cwd=ROOT, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    tallies = [json.loads(line) for line in done.stdout.splitlines()]
    assert [tally["kind"] for tally in tallies] == list(KINDS)
    assert sum(tally["files"] for tally in tallies) > 900
    assert all(tally["refused"] > tally["same"] for tally in tallies)


def test_reading_needs_no_opencl(tmp_path):
    path = write_each(tmp_path)["stack"]
    script = f"""
import sys
from clrelight import store
with store.open_stack({str(path)!r}) as stack:
    stack.read_rows(0, 7)
assert not [name for name in sys.modules if name.startswith("pyopencl")], "OpenCL was loaded"
"""
    subprocess.run([sys.executable, "-c", script], cwd=ROOT, env=environment(), check=True)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(("error", "reason"), [(errno.EIO, "Input/output error"), (errno.ENOSPC, "the disk is full")])
def test_what_the_disk_says_meanwhile_is_one_line(tmp_path, monkeypatch, late, error, reason):
    def refuse(_):
        raise OSError(error, os.strerror(error))

    path = tmp_path / "f.h5"
    before = write_rows(path)
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(durable, "SYNC_BYTES", 11 * 5 * 3 * 24 if late else 1)  # with the last bytes, or at once
    monkeypatch.setattr(durable.os, "fdatasync", refuse)
    with pytest.raises(InputError, match=rf"^cannot write .*f\.h5: {reason}$"):
        write_rows(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["f.h5"]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("clrelight-io")]


def test_a_fit_of_the_command_line_is_the_same_streamed(tmp_path, monkeypatch):
    """The whole way: some lights of a stack to a fit, in memory and streamed in small blocks."""
    store.write_stack(tmp_path / "s.h5", make_stack(20, (40, 9, 3)))
    words = ["--degree", "2", "--holdout", "5", "--memory", "60kB", "--json"]
    done = {}
    for name in ("memory", "streamed"):
        if name == "streamed":
            monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
            monkeypatch.setattr(writing, "CHUNK_BYTES", 1 << 12)
        path = tmp_path / f"{name}.h5"
        assert call("fit", str(tmp_path / "s.h5"), str(path), *words).code == 0
        done[name] = store.read_fit(path)
    assert done["memory"].coeffs_khwc.tobytes() == done["streamed"].coeffs_khwc.tobytes()
    assert done["memory"].lambda_hwc.tobytes() == done["streamed"].lambda_hwc.tobytes()
