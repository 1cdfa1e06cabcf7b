"""Data larger than memory: what is read ahead and written behind, in order, in bounds, and with its errors."""

import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from clrelight.arrays import is_radiance
from clrelight.errors import InputError
from clrelight.fit import fit_tiles, prepare_fit
from clrelight.fit.run import rows_per_tile
from clrelight.store import create_stack, writing
from clrelight.streaming import Buffer, reading_ahead, writing_behind
from tests.commands import call, contents, environment, succeed
from tests.stacks import make_stack


def io_threads():
    return [thread for thread in threading.enumerate() if thread.name.startswith("clrelight-io")]


def test_the_next_is_read_while_one_is_used():
    begun, used = [], []
    second_begins = threading.Event()

    def read(item):
        begun.append(item)
        if item == 1:
            second_begins.set()
        return 10 * item

    with reading_ahead(read, range(4)) as results:
        for result in results:
            assert second_begins.wait(10)  # while 0 is in use
            used.append(result)
            assert max(begun) <= len(used)  # two buffers are enough
    assert (begun, used, io_threads()) == ([0, 1, 2, 3], [0, 10, 20, 30], [])


@pytest.mark.parametrize("count", [0, 1])
def test_one_item_needs_no_thread(count):
    seen = []
    with reading_ahead(lambda item: seen.append(threading.current_thread()) or item, range(count)) as results:
        assert list(results) == list(range(count))
    assert seen == [threading.main_thread()] * count


def test_an_error_of_the_reading_thread_comes_in_its_place():
    def read(item):
        if item == 2:
            raise InputError("two is bad")
        return item

    used = []
    with pytest.raises(InputError, match="two is bad"), reading_ahead(read, range(4)) as results:
        used.extend(results)
    assert (used, io_threads()) == ([0, 1], [])


def test_leaving_early_ends_the_thread():
    written = []
    with reading_ahead(lambda item: item, range(100)) as results, writing_behind(written.append) as put:
        for result in results:
            put(result)
            break
        assert len(io_threads()) == 2
    assert (written, io_threads()) == ([0], [])


def test_the_last_is_written_while_the_next_is_made():
    free, written = threading.Event(), []

    def write(item):
        assert free.wait(10)
        written.append(item)

    with writing_behind(write) as put:
        put(0)
        assert written == []  # and we are here
        free.set()
        put(1)
        assert written[0] == 0  # so its buffer may be used for 2
        put(2)
    assert (written, io_threads()) == ([0, 1, 2], [])


@pytest.mark.parametrize("bad", [0, 1, 2])
def test_an_error_of_the_writing_thread_is_not_lost(bad):
    def write(item):
        if item == bad:
            raise InputError(f"{item} is bad")

    def write_all():
        with writing_behind(write) as put:
            for item in range(3):
                put(item)

    with pytest.raises(InputError, match=f"{bad} is bad"):
        write_all()
    assert io_threads() == []


def test_a_buffer_is_lent_again():
    buffer = Buffer()
    large, small = buffer.lend((4, 5), np.float32), buffer.lend((3, 5), np.float16)
    assert (large.shape, large.dtype, small.shape, small.dtype) == ((4, 5), np.float32, (3, 5), np.float16)
    assert large.flags.c_contiguous
    assert small.flags.c_contiguous
    assert np.shares_memory(large, small)
    assert buffer.lend((5, 5), np.float32).shape == (5, 5)


@pytest.mark.parametrize("held", [1, 2, 3])
def test_tiles_keep_their_values_as_long_as_was_asked(device, held):
    stack = make_stack(20, (9, 7, 3))
    prepared = prepare_fit(stack, "cls", 2)
    row_bytes = 7 * 3 * 4 * (20 + 20 + 9 + 2 + held * (9 + 1))
    assert rows_per_tile(prepared, 2 * row_bytes, held=held) == 2
    with closing(fit_tiles(prepared, memory_bytes=2 * row_bytes, held=held)) as tiles:
        kept, copies, maps = [], [], []
        for tile in tiles:
            kept, copies = [*kept, tile][-held:], [*copies, tile.coeffs_khwc.copy()][-held:]
            maps = [*maps, (tile.lambda_hwc, tile.lambda_hwc.copy())]
            for one, copy in zip(kept, copies, strict=True):
                np.testing.assert_array_equal(one.coeffs_khwc, copy)
    assert all((lambda_hwc == copy).all() for lambda_hwc, copy in maps)  # a tile's own, kept for ever
    assert io_threads() == []


class Chunked:
    """An image dataset that is stored in chunks."""

    def __init__(self, images_ihwc, chunk_rows):
        self._images = images_ihwc
        self.shape, self.dtype, self.chunks = images_ihwc.shape, images_ihwc.dtype, (1, chunk_rows, 1, 1)

    def __getitem__(self, key):
        return self._images[key].copy()


def test_tiles_are_whole_chunks_where_there_is_room(device):
    stack = make_stack(20, (36, 7, 3))
    prepared = prepare_fit(replace(stack, images_ihwc=Chunked(stack.images_ihwc, 3)), "cls", 2)
    row_bytes = 7 * 3 * 4 * (20 + 20 + 9 + 2 + 9 + 1)
    wanted = {1: 1, 3: 2, 5: 4, 6: 6, 11: 6, 17: 12}
    assert {rows: rows_per_tile(prepared, rows * row_bytes, row_step=2) for rows in wanted} == wanted


def write_big(path, height, dtype="float16", width=64, n_light=30):
    """Write a stack piece by piece; only its first two rows differ from the others."""
    stack = make_stack(n_light, (4, width, 3))
    blank_ihwc = np.broadcast_to(np.zeros((), dtype), (n_light, height, width, 3))
    with create_stack(path, replace(stack, images_ihwc=blank_ihwc)) as sink:
        step = sink.chunks[1]
        for first in range(0, height, step):
            rows = np.minimum(np.arange(first, min(first + step, height)), 3)
            sink[:, first : first + step] = stack.images_ihwc[:, rows].astype(dtype)
    return path


@pytest.mark.parametrize("streamed", [False, True])
@pytest.mark.parametrize("method", ["cls", "ceb", "project"])
def test_the_budget_changes_no_byte_of_the_file(tmp_path, monkeypatch, streamed, method):
    write_big(tmp_path / "s.h5", 301)
    if streamed:
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    files = []
    for memory in ("1GiB", "3MB", "500k"):
        succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--method", method, "--degree", 4, "--memory", memory)
        files.append((tmp_path / "f.h5").read_bytes())
    assert files[0] == files[1] == files[2]


@pytest.mark.parametrize("row", [0, 150, 300])
def test_a_bad_sample_in_a_tile_read_ahead_leaves_the_old_file(tmp_path, row):
    stack = make_stack(30, (301, 8, 3))
    stack.images_ihwc[7, row, 5, 1] = np.nan
    with create_stack(tmp_path / "s.h5", stack) as sink:
        sink[...] = stack.images_ihwc
    (tmp_path / "f.h5").write_bytes(b"old")
    before = contents(tmp_path)
    ended = call("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 2, "--memory", "100k")
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.startswith(f"clrelight: image 7 is nan at row {row}, column 5, channel 1")
    assert ended.err.count("\n") == 1
    assert contents(tmp_path) == before
    assert io_threads() == []


def test_a_write_that_fails_leaves_the_old_file(tmp_path, monkeypatch):
    write_big(tmp_path / "s.h5", 101)
    (tmp_path / "f.h5").write_bytes(b"old")
    before = contents(tmp_path)
    fill, calls = writing.Sink.fill, []

    def fail(self, *arguments):
        calls.append(arguments)
        if len(calls) > 5:
            raise OSError(28, "No space left on device")
        fill(self, *arguments)

    monkeypatch.setattr(writing.Sink, "fill", fail)
    ended = call("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 2, "--memory", "400k")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "No space left on device" in ended.err
    assert contents(tmp_path) == before
    assert io_threads() == []


@pytest.mark.parametrize("dtype", ["float16", "float32"])
def test_what_is_radiance(dtype):
    info = np.finfo(dtype)
    good = np.array([0.0, -0.0, info.smallest_subnormal, info.tiny, 1.0, info.max], dtype)
    for values in (good, good[::2], good[:2], good.reshape(2, 3).T, good.astype(good.dtype.newbyteorder(">"))):
        assert is_radiance(values)
    for bad in (np.nan, -np.nan, np.inf, -np.inf, -info.smallest_subnormal, -1.0):
        for position in (0, 3, 5):
            values = good.copy()
            values[position] = bad
            assert not is_radiance(values)
            assert not is_radiance(values.astype(values.dtype.newbyteorder(">")))


PEAK = """
import sys
from clrelight.cli.app import run
code = run(sys.argv[1:])
from clrelight.jobs.memory import peak_memory
print(code, peak_memory())
"""


def peak_of(folder, *words):
    """Return the most memory, in bytes, that a command in a process of its own ever had."""
    words = [sys.executable, "-c", PEAK, *map(str, words)]
    done = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=120)
    code, peak = done.stdout.split()[-2:]
    assert code == "0", done.stderr
    return int(peak)


def test_memory_does_not_grow_with_the_view(tmp_path):
    fit = ["fit", "s.h5", "f.h5", "--degree", 6, "--memory", "20MB"]
    others = (["psnr", "f.h5", "s.h5"], ["relight", "f.h5", "f.png", "--light", "0,0,1"])
    peaks = {}
    for height in (500, 2000):
        write_big(tmp_path / "s.h5", height, width=256, n_light=12)
        if not peaks:
            peak_of(tmp_path, *fit)  # compiling kernels takes memory too
        peaks[height] = [peak_of(tmp_path, *words) for words in (fit, *others)]
    grown = np.subtract(peaks[2000], peaks[500])
    coefficients = 49 * 256 * 3 * 4 * 1500  # what the larger view has more of, 226 MB
    assert (grown < 0.25 * coefficients).all(), grown
