"""Chunks read and written past HDF5: their checksums, their place in an array, and what is left to HDF5."""

import errno
import functools
import itertools
import os
import threading
from contextlib import contextmanager

import h5py
import numpy as np
import pytest

from clrelight import store
from clrelight.errors import DeviceError, InputError, StoreFormatError
from clrelight.store import chunk_table, durable, fletcher, writing
from clrelight.store.chunk_table import ChunkTable, RowReader
from clrelight.store.chunk_writer import ChunkWriter
from tests.commands import call
from tests.reference.fletcher import fletcher32
from tests.stacks import make_stack

KINDS = {
    "random": lambda rng, shape: rng.integers(0, 256, shape, np.uint8),
    "zeros": lambda rng, shape: np.zeros(shape, np.uint8),
    "ones": lambda rng, shape: np.full(shape, 255, np.uint8),  # every word is 65535: both sums are multiples of it
    "last": lambda rng, shape: np.append(np.zeros(np.prod(shape) - 1, np.uint8), 1).astype(np.uint8).reshape(shape),
    "first": lambda rng, shape: np.append(255, np.zeros(np.prod(shape) - 1)).astype(np.uint8).reshape(shape),
}


def sum_of_hdf5(data):
    with h5py.File("sums", "w", driver="core", backing_store=False) as file:
        dataset = file.create_dataset("x", data=data, chunks=data.shape, fletcher32=True)
        return int.from_bytes(dataset.id.read_direct_chunk((0,) * data.ndim)[1][-4:], "little")


@pytest.mark.parametrize("kind", KINDS)
def test_sums_are_those_of_hdf5(kind):
    rng = np.random.default_rng(3)
    sizes = (1, 2, 3, 31, 63, 64, 65, 127, 130, 16383, 16384, 16385, 16448, 16449, 40001)  # of steps and blocks too
    for piece in sizes:
        for pieces in (1, 2, 3):
            rows_mx = KINDS[kind](rng, (pieces + 1, 3 * piece + 1))
            image_n, place_n = rng.permutation(pieces + 1)[:pieces], rng.permutation(pieces)
            shape = {"chunks": 2, "piece": piece, "pieces": pieces, "skipped": piece + 1}
            found = fletcher.checksums(fletcher.add_pieces(rows_mx, image_n, place_n, **shape))
            # The sums of some pieces and of the others add up.
            parts = [fletcher.add_pieces(rows_mx, image_n[[i]], place_n[[i]], **shape) for i in range(pieces)]
            np.testing.assert_array_equal(fletcher.checksums(np.sum(parts, axis=0, dtype=np.uint64)), found)
            for b in range(2):
                chunk = np.empty((pieces, piece), np.uint8)
                chunk[place_n] = rows_mx[image_n, (b + 1) * piece + 1 : (b + 2) * piece + 1]
                assert found[b] == sum_of_hdf5(chunk.ravel()), (piece, pieces)
                assert piece > 1000 or found[b] == fletcher32(chunk.tobytes())


def test_a_sum_of_many_blocks():
    data = np.full(3 << 20, 255, np.uint8)
    data[-5:] = 1, 2, 3, 4, 5
    rows_mx = data.reshape(2, -1)
    sums_bs = fletcher.add_pieces(rows_mx, np.arange(2), np.arange(2), chunks=1, piece=rows_mx.shape[1], pieces=2)
    assert fletcher.checksums(sums_bs)[0] == sum_of_hdf5(data)


@pytest.fixture
def directly(monkeypatch):
    """Have everything read past HDF5 that can be; return the rows that were left to it."""
    left = []
    real = ChunkTable.read

    def read(*arguments):
        for rows in real(*arguments):
            left.append(rows)
            yield rows

    monkeypatch.setattr(chunk_table, "LEAST_BYTES", 0)
    monkeypatch.setattr(ChunkTable, "read", read)
    return left


@contextmanager
def dataset_of(path, values, chunks, **storage):
    with h5py.File(path, "w", libver="latest") as file:
        file.create_dataset("x", data=values, chunks=chunks, **storage)
    with h5py.File(path, "r") as file:
        yield file["x"]


def values_of(shape, dtype):
    return np.random.default_rng(5).integers(0, 256, (*shape, np.dtype(dtype).itemsize), np.uint8).view(dtype)[..., 0]


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("chunks", [(6, 1, 5, 3), (6, 4, 5, 3), (3, 2, 5, 3), (1, 9, 5, 3), (2, 4, 5, 3)])
def test_rows_are_those_that_hdf5_reads(tmp_path, directly, monkeypatch, dtype, chunks):
    monkeypatch.setattr(chunk_table, "ASIDE_BYTES", 64)
    monkeypatch.setattr(chunk_table, "_MOST_BUFFERS", 4)
    values = values_of((6, 11, 5, 3), dtype)
    with dataset_of(tmp_path / "x.h5", values, chunks, fletcher32=True) as dataset:
        reader = RowReader(dataset)
        for picked in (None, np.arange(6), np.array([4, 1, 5]), np.array([2]), np.array([-1, 0])):
            for first, end in ((0, 11), (1, 11), (3, 4), (2, 9), (10, 11)):
                out = np.zeros((6 if picked is None else len(picked), end - first, 5, 3), dtype)
                reader.read_into(first, end, out, picked)
                wanted = values[:, first:end] if picked is None else values[picked, first:end]
                assert out.tobytes() == wanted.tobytes()
                whole = range(-(-first // chunks[1]) * chunks[1], end // chunks[1] * chunks[1])
                assert not any(row in whole for rows in directly for row in rows)
                directly.clear()


OTHERS = {
    "no sums": {"chunks": (6, 2, 5, 3)},
    "deflated": {"chunks": (6, 2, 5, 3), "fletcher32": True, "compression": "gzip"},
    "parts of rows": {"chunks": (6, 2, 5, 1), "fletcher32": True},
    "uneven groups": {"chunks": (4, 2, 5, 3), "fletcher32": True},
    "whole": {"chunks": None},
}


@pytest.mark.parametrize("other", OTHERS)
def test_what_only_hdf5_can_read(tmp_path, directly, other):
    values = values_of((6, 11, 5, 3), "float32")
    with dataset_of(tmp_path / "x.h5", values, **OTHERS[other]) as dataset:
        assert ChunkTable.of(dataset) is None
        out = np.zeros((2, 11, 5, 3), np.float32)
        RowReader(dataset).read_into(0, 11, out, np.array([5, 0]))
        assert out.tobytes() == values[[5, 0]].tobytes()


def test_an_array_larger_than_a_buffer_of_the_device_is_left_to_hdf5():
    assert fletcher.takes_sums(128 << 20)  # the least that OpenCL allows a device
    assert not fletcher.takes_sums(1 << 60)


def test_an_image_twice_is_read_twice(tmp_path, directly):
    values = values_of((6, 11, 5, 3), "uint8")
    with dataset_of(tmp_path / "x.h5", values, (6, 1, 5, 3), fletcher32=True) as dataset:
        out = np.zeros((3, 11, 5, 3), np.uint8)
        RowReader(dataset).read_into(0, 11, out, np.array([1, 4, 1]))
        assert out.tobytes() == values[[1, 4, 1]].tobytes()


@pytest.mark.parametrize(
    ("first", "end", "out"),
    [
        (0, 12, np.zeros((6, 12, 5, 3), np.uint8)),
        (-1, 2, np.zeros((6, 3, 5, 3), np.uint8)),
        (0, 2, np.zeros((6, 3, 5, 3), np.uint8)),
        (0, 2, np.zeros((5, 2, 5, 3), np.uint8)),
        (0, 2, np.zeros((6, 4, 5, 3), np.uint8)[:, ::2]),
    ],
)
def test_an_array_that_does_not_fit(tmp_path, directly, first, end, out):
    values = values_of((6, 11, 5, 3), "uint8")
    with (
        dataset_of(tmp_path / "x.h5", values, (6, 1, 5, 3), fletcher32=True) as dataset,
        pytest.raises(ValueError, match=r"expected rows of 11 in a contiguous array"),
    ):
        RowReader(dataset).read_into(first, end, out)


def test_without_a_device_hdf5_sums(tmp_path, directly, monkeypatch):
    def none(*_, **__):
        raise DeviceError("none")

    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    files = [write_summed(tmp_path / "with.h5")]
    monkeypatch.setattr("clrelight.device.make_device", none)
    monkeypatch.setattr(fletcher, "_device", functools.cache(fletcher._device.__wrapped__))
    assert not fletcher.takes_sums(1)
    files.append(write_summed(tmp_path / "without.h5"))
    assert files[0] == files[1]
    values = values_of((6, 11, 5, 3), "uint8")
    with dataset_of(tmp_path / "x.h5", values, (6, 1, 5, 3), fletcher32=True) as dataset:
        out = np.zeros((6, 11, 5, 3), np.uint8)
        RowReader(dataset).read_into(0, 11, out)
        assert out.tobytes() == values.tobytes()


def make_rows():
    rng = np.random.default_rng(6)
    return (
        rng.standard_normal((4, 11, 5, 3), np.float32),
        rng.random((11, 5, 3), np.float32),
        rng.integers(0, 9, (11, 5, 3), np.int32),
    )


def write_summed(path, summed=True, steps=(0, 4, 5, 8, 11)):
    """Write a fit in tiles; return the file's bytes."""
    rows = make_rows()
    about = {"degree": 1, "method": "cls", "peak": 255.0, "transfer": "srgb", "config": {}, "name": "x"}
    with store.create_fit(
        path,
        image_shape=(11, 5, 3),
        directions_i3=np.eye(3),
        has_lambda=True,
        has_rank=True,
        **about,
    ) as sink:
        for first, end in itertools.pairwise(steps):
            tile = [np.ascontiguousarray(rows[0][:, first:end]), rows[1][first:end], rows[2][first:end]]
            if summed:
                sink.sum_rows(first, *tile)
            sink.write_rows(first, *tile)
        out = np.empty((4, 7, 5, 3), np.float32)
        sink.coeffs_khwc.read_rows_into(2, 9, out)
        assert out.tobytes() == rows[0][:, 2:9].tobytes()
    return path.read_bytes()


@pytest.mark.parametrize("chunk_bytes", [1, 240, 720, 1 << 20])  # chunks of 1, 1, 3 (11 is no multiple) and 11 rows
def test_a_file_has_the_same_bytes_whoever_sums(tmp_path, directly, monkeypatch, chunk_bytes):
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(writing, "CHUNK_BYTES", chunk_bytes)
    written = []
    real = ChunkWriter.write
    monkeypatch.setattr(ChunkWriter, "write", lambda *args: written.append(real(*args)) or written[-1])
    files = {write_summed(tmp_path / f"{i}.h5", summed) for i, summed in enumerate((False, True))}
    assert len(files) == 1
    assert any(written) == (chunk_bytes < 1 << 20)  # tiles hold whole chunks but there
    back = store.read_fit(tmp_path / "1.h5")
    for found, wanted in zip((back.coeffs_khwc, back.lambda_hwc, back.rank_hwc), make_rows(), strict=True):
        assert found.tobytes() == wanted.tobytes()


def write_chunked(path):
    """Write a stack of three chunks, each of 2 x 3 x 5 x 3 bytes, and return where the second lies."""
    images = values_of((2, 9, 5, 3), "uint8")
    with store.create_stack(
        path, shape_ihwc=images.shape, dtype=np.uint8, directions_i3=np.eye(3)[:2], peak=255.0, transfer="srgb"
    ) as sink:
        assert sink.chunks == (2, 3, 5, 3)
        sink[...] = images
    with h5py.File(path, "r") as file:
        return images, file["images"].id.get_chunk_info(1).byte_offset


def test_damaged_chunks_are_refused_as_hdf5_does(tmp_path, directly, monkeypatch):
    monkeypatch.setattr(writing, "CHUNK_BYTES", 90)
    path = tmp_path / "s.h5"
    _, at = write_chunked(path)
    good = path.read_bytes()
    out = np.zeros((2, 9, 5, 3), np.uint8)
    for offset in (0, 45, 89, 90, 93):
        bad = bytearray(good)
        bad[at + offset] ^= 16
        path.write_bytes(bad)
        messages = set()
        with store.open_stack(path) as stack:
            for images, least in itertools.product((stack, stack.select(np.array([1]))), (0, 1 << 60)):
                monkeypatch.setattr(chunk_table, "LEAST_BYTES", least)
                images.read_rows(0, 3, out[: images.n_light, :3].copy())  # the rows beside it are sound
                with pytest.raises(StoreFormatError, match=r"s\.h5: images is damaged") as caught:
                    images.read_rows(0, 9, out[: images.n_light])
                messages.add(str(caught.value))
        (message,) = messages
        assert "\n" not in message


def test_flipped_bits_are_seen_as_hdf5_sees_them(tmp_path, directly, monkeypatch):
    monkeypatch.setattr(writing, "CHUNK_BYTES", 90)
    path = tmp_path / "s.h5"
    images, _ = write_chunked(path)
    good = path.read_bytes()

    def read(least):
        monkeypatch.setattr(chunk_table, "LEAST_BYTES", least)
        out = np.zeros_like(images)
        try:
            with store.open_stack(path) as stack:
                stack.images_ihwc.read_rows_into(0, 9, out)
        except InputError as error:
            return str(error)
        return out.tobytes()

    rng = np.random.default_rng(9)
    seen = set()
    for _ in range(250):
        bad = bytearray(good)
        bad[rng.integers(len(bad))] ^= 1 << rng.integers(8)
        path.write_bytes(bad)
        found = read(0)
        assert found == read(1 << 60)
        assert isinstance(found, str) or found == images.tobytes()
        seen.add("damaged" in found if isinstance(found, str) else "sound")
    assert seen == {True, "sound"}


def test_a_file_cut_short_while_it_is_open(tmp_path, directly, monkeypatch):
    monkeypatch.setattr(writing, "CHUNK_BYTES", 90)
    path = tmp_path / "s.h5"
    _, at = write_chunked(path)
    out = np.zeros((2, 9, 5, 3), np.uint8)
    with store.open_stack(path) as stack:
        stack.images_ihwc.read_rows_into(0, 9, out)
        os.truncate(path, at + 10)
        with pytest.raises(StoreFormatError, match="images is damaged"):
            stack.images_ihwc.read_rows_into(0, 9, out)


def test_an_unlisted_or_misplaced_chunk_leaves_all_to_hdf5(tmp_path):
    values = np.zeros((6, 11, 5, 3), np.uint8)
    with h5py.File(tmp_path / "x.h5", "w", libver="latest") as file:
        dataset = file.create_dataset("x", values.shape, "u1", chunks=(6, 1, 5, 3), fletcher32=True)
        dataset[:, :10] = 1
        file.flush()
        assert ChunkTable.of(dataset) is None  # row 10 was never written: it reads as zeros
        dataset.id.write_direct_chunk((0, 10, 0, 0), bytes(90), 1)
        assert ChunkTable.of(dataset) is None  # it was not summed
        dataset[:, 10:] = 1
        file.flush()
        assert ChunkTable.of(dataset) is not None


def test_hdf5_reads_beside(tmp_path, directly):
    values = values_of((16, 200, 16, 3), "float32")
    with dataset_of(tmp_path / "x.h5", values, (16, 1, 16, 3), fletcher32=True) as dataset:
        reader, wrong, done = RowReader(dataset), [], threading.Event()

        def read_others():
            count = 0
            while not (done.is_set() and count):
                count += 1
                wrong.append(dataset[:, 7 * count % 200].tobytes() != values[:, 7 * count % 200].tobytes())

        thread = threading.Thread(target=read_others)
        thread.start()
        out = np.empty_like(values)
        for _ in range(10):
            out[...] = 0
            reader.read_into(0, 200, out)
            assert out.tobytes() == values.tobytes()
        done.set()
        thread.join()
        assert wrong
        assert not any(wrong)


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize(("error", "reason"), [(errno.EIO, "Input/output error"), (errno.ENOSPC, "the disk is full")])
def test_what_the_disk_says_meanwhile_is_one_line(tmp_path, monkeypatch, late, error, reason):
    def refuse(_):
        raise OSError(error, os.strerror(error))

    path = tmp_path / "f.h5"
    before = write_summed(path)
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(durable, "SYNC_BYTES", 11 * 5 * 3 * 24 if late else 1)  # with the last bytes, or at once
    monkeypatch.setattr(durable.os, "fdatasync", refuse)
    with pytest.raises(InputError, match=rf"^cannot write .*f\.h5: {reason}$"):
        write_summed(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["f.h5"]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("clrelight-io")]


def test_a_fit_of_the_command_line_sums_what_it_writes(tmp_path, monkeypatch):
    """The whole way: some lights of a streamed stack to a streamed fit, with and without a device for sums."""
    stack = make_stack(20, (40, 9, 3))
    store.write_stack(tmp_path / "s.h5", stack)
    words = ["--degree", "2", "--holdout", "5", "--memory", "60kB", "--json"]
    done = {}
    for name, least in (("hdf5", 1 << 60), ("direct", 0)):
        monkeypatch.setattr(chunk_table, "LEAST_BYTES", least)
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0 if name == "direct" else writing.IN_MEMORY_BYTES)
        monkeypatch.setattr(writing, "CHUNK_BYTES", 1 << 12)
        path = tmp_path / f"{name}.h5"
        assert call("fit", str(tmp_path / "s.h5"), str(path), *words).code == 0
        done[name] = store.read_fit(path)
    assert done["hdf5"].coeffs_khwc.tobytes() == done["direct"].coeffs_khwc.tobytes()
    assert done["hdf5"].lambda_hwc.tobytes() == done["direct"].lambda_hwc.tobytes()
