"""The four kinds of files: what goes in comes out, the same bytes each time, and is whole or not there."""

import errno
import json
import math
import os
import signal
import stat
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xxhash

from clrelight import durable, store
from clrelight.arrays import SAMPLE_DTYPES
from clrelight.codec.encoded import Encoded
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.errors import InputError, StoreFormatError
from clrelight.lighting.light import Light
from clrelight.results import ROW_DTYPE, Results
from clrelight.sampling import make_pattern
from clrelight.store import writing
from clrelight.store.encodings import container_bytes

FROZEN = Path(__file__).parent / "frozen"


def directions(n):
    rng = np.random.default_rng(n)
    d = rng.normal(size=(n, 3))
    d[:, 2] = np.abs(d[:, 2])
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def make_stack(dtype="uint8", shape=(5, 7, 6, 3), optional=True):
    rng = np.random.default_rng(1)
    images = (rng.random(shape) * 200).astype(dtype)
    weights = np.linspace(0.1, 0.4, shape[0]) if optional else None
    mask = rng.random(shape[1:3]) < 0.5 if optional else None
    return LightStack(images, directions(shape[0]), 200.0, "srgb", weights, mask, "vase é")


def make_fit(degree=2, image=(5, 4, 3), maps=True, n_light=9):
    rng = np.random.default_rng(2)
    coeffs = rng.normal(size=((degree + 1) ** 2, *image)).astype(np.float32)
    lam = rng.random(image).astype(np.float32) if maps else None
    rank = rng.integers(0, 9, image).astype(np.int32) if maps else None
    config = {"energy": 1.0, "b": [1, 2], "a": None}
    return CoefficientMap(coeffs, degree, "cls", 255.0, "linear", directions(n_light), config, lam, rank, "ring")


def make_encoded(fit, body=b"payload and tables" * 9):
    return Encoded("half", {"clamp": True}, fit.coeffs_khwc.shape, body, {"entropy_bits": 3.25, "other": math.nan})


def make_results(n=3):
    table = np.zeros(n, ROW_DTYPE)
    if n:
        table["scene"], table["rate"], table["psnr_mean"] = b"ring", math.nan, math.inf
        table["degree"] = np.arange(n)
        table["fit_config"] = b'{"energy": 1.0}'
    pictures = {
        "ring/reference": np.arange(24, dtype=np.uint8).reshape(2, 4, 3),
        "a/b/6/half@4": np.ones((1, 1, 1), "u1"),
    }
    return Results(table, pictures, {"ring/uls/6": np.linspace(0, 1, 49)})


def write_each(folder):
    """Write one file of each kind; return their paths by schema."""
    paths = {kind: folder / f"{kind}.h5" for kind in ("stack", "fit", "encoded", "results")}
    store.write_stack(paths["stack"], make_stack())
    store.write_fit(paths["fit"], make_fit())
    store.write_encoded(paths["encoded"], make_encoded(make_fit()), make_fit())
    store.write_results(paths["results"], make_results())
    return paths


def same_stack(a, b):
    np.testing.assert_array_equal(np.asarray(a.images_ihwc), np.asarray(b.images_ihwc), strict=True)
    np.testing.assert_array_equal(a.directions_i3, b.directions_i3, strict=True)
    assert (a.peak, a.transfer, a.name) == (b.peak, b.transfer, b.name)
    for x, y in ((a.weights_i, b.weights_i), (a.mask_hw, b.mask_hw)):
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_array_equal(x, y, strict=True)


def same_fit(a, b):
    np.testing.assert_array_equal(np.asarray(a.coeffs_khwc), np.asarray(b.coeffs_khwc), strict=True)
    np.testing.assert_array_equal(a.directions_i3, b.directions_i3, strict=True)
    for name in ("degree", "method", "peak", "transfer", "config", "name"):
        assert getattr(a, name) == getattr(b, name)
    for x, y in ((a.lambda_hwc, b.lambda_hwc), (a.rank_hwc, b.rank_hwc)):
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_array_equal(x, y, strict=True)


def same_results(a, b):
    assert a.table.tobytes() == b.table.tobytes()
    for x, y in ((a.pictures, b.pictures), (a.profiles, b.profiles)):
        assert list(x) == list(y)
        for key in x:
            np.testing.assert_array_equal(x[key], y[key], strict=True)


@pytest.fixture(params=["memory", "streamed"])
def way(request, monkeypatch):
    if request.param == "streamed":
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    return request.param


@pytest.mark.parametrize("dtype", SAMPLE_DTYPES)
@pytest.mark.parametrize("optional", [True, False])
def test_stack_round_trip(tmp_path, dtype, optional, way):
    stack = make_stack(dtype, optional=optional)
    store.write_stack(tmp_path / "s.h5", stack)
    with store.open_stack(str(tmp_path / "s.h5")) as back:
        assert back.images_ihwc.dtype == dtype
        same_stack(back, stack)
        np.testing.assert_array_equal(back.images_ihwc[1:3, 2:5], stack.images_ihwc[1:3, 2:5])
        store.write_stack(tmp_path / "copy.h5", back)  # from a stored array, not an ndarray
    assert (tmp_path / "copy.h5").read_bytes() == (tmp_path / "s.h5").read_bytes()
    assert store.file_schema(tmp_path / "s.h5") == "stack/1"


@pytest.mark.parametrize("maps", [True, False])
def test_fit_round_trip(tmp_path, maps, way):
    fit = make_fit(maps=maps)
    store.write_fit(tmp_path / "f.h5", fit)
    same_fit(store.read_fit(tmp_path / "f.h5"), fit)
    with store.open_fit(tmp_path / "f.h5") as lazy:
        assert isinstance(lazy.coeffs_khwc, store.StoredArray)
        np.testing.assert_array_equal(lazy.coeffs_khwc[:, 1:3], fit.coeffs_khwc[:, 1:3])
        same_fit(lazy, fit)
    with pytest.raises(ValueError, match="closed"):
        lazy.coeffs_khwc[0]


@pytest.mark.parametrize("body", [b"payload" * 40, b"", bytes(3 << 20)])
def test_encoded_round_trip(tmp_path, body, way):
    fit = make_fit()
    encoded = make_encoded(fit, body)
    store.write_encoded(tmp_path / "e.h5", encoded, fit)
    back, record = store.read_encoded(tmp_path / "e.h5")
    assert back.to_bytes() == encoded.to_bytes()
    assert (back.codec, back.config, back.shape) == (encoded.codec, encoded.config, encoded.shape)
    assert back.info["entropy_bits"] == 3.25
    assert math.isnan(back.info["other"])
    bare = replace(make_fit(maps=False), directions_i3=record.directions_i3)
    np.testing.assert_allclose(record.directions_i3, fit.directions_i3, atol=8e-5)
    same_fit(record.to_map(fit.coeffs_khwc), bare)
    with pytest.raises(InputError, match="degree"):
        record.to_map(fit.coeffs_khwc[:4])


@pytest.mark.parametrize("n", [0, 1, 600])
def test_results_round_trip(tmp_path, n, way):
    results = make_results(n)
    store.write_results(tmp_path / "r.h5", results)
    same_results(store.read_results(tmp_path / "r.h5"), results)


def test_no_pictures(tmp_path):
    store.write_results(tmp_path / "r.h5", Results(make_results().table))
    assert store.read_results(tmp_path / "r.h5").pictures == {}


def test_same_input_same_bytes(tmp_path, way):
    first = {kind: path.read_bytes() for kind, path in write_each(tmp_path).items()}
    assert {kind: path.read_bytes() for kind, path in write_each(tmp_path).items()} == first


def test_every_block_is_summed(tmp_path, way, monkeypatch):
    """Each stored value is in one block of the table, in the order of names and then of places."""
    monkeypatch.setattr(writing, "CHUNK_BYTES", 100)  # several blocks, and some that the array's edge cuts off
    kinds = {**write_each(tmp_path), "light": tmp_path / "light.h5"}
    store.write_light(kinds["light"], Light(np.arange(27.0).reshape(9, 3), "sky", "", {}))
    scales = {"light", "height", "width", "channel", "coefficient", "xyz"}
    for kind, path in kinds.items():
        expected = []
        with h5py.File(path) as file:
            names = []
            file.visititems(lambda name, item, names=names: names.append(name) if hasattr(item, "shape") else None)
            for name in sorted(names):
                if name in scales or name.startswith(("clrelight/", "view/")):
                    continue
                values, chunks = file[name][...], file[name].chunks or file[name].shape
                assert math.prod(values.shape) > 0
                for at in np.ndindex(*(-(-n // c) for n, c in zip(values.shape, chunks, strict=True))):
                    block = values[tuple(slice(i * c, (i + 1) * c) for i, c in zip(at, chunks, strict=True))]
                    expected.append(xxhash.xxh3_64_intdigest(block.tobytes()))
            if kind == "encoded":
                seal = file["payload"].attrs["clrelight_checksums"]
                assert seal.decode().split(" ")[2:] == [f"{each:016x}" for each in expected]
            else:
                seal, found = file.attrs["clrelight_checksums"], file["clrelight/checksums"][...]
                np.testing.assert_array_equal(found, np.array(expected, "<u8"), strict=True)
            assert len(expected) >= {"encoded": 1, "light": 1}.get(kind, 4)
            assert seal.startswith(b"xxh3-64 ")


def test_no_dataset_has_a_filter_or_bears_a_time(tmp_path, way):
    for path in write_each(tmp_path).values():
        with h5py.File(path) as file:
            seen = []

            def look(name, item, seen=seen):
                seen.append(name)
                info = h5py.h5o.get_info(item.id)
                assert (info.mtime, info.ctime) == (0, 0), name
                assert not isinstance(item, h5py.Dataset) or item.id.get_create_plist().get_nfilters() == 0, name

            file.visititems(look)
            assert len(seen) >= 1


def test_axes_have_names(tmp_path):
    paths = write_each(tmp_path)
    with h5py.File(paths["stack"]) as file:
        assert [d[0].name for d in file["images"].dims] == ["/light", "/height", "/width", "/channel"]
        assert [d[0].name for d in file["directions"].dims] == ["/light", "/xyz"]
        assert [d[0].name for d in file["mask"].dims] == ["/height", "/width"]
        assert file["light"].attrs["CLASS"] == b"DIMENSION_SCALE"
        np.testing.assert_array_equal(file["width"][...], np.arange(6))
    with h5py.File(paths["fit"]) as file:
        assert [d[0].name for d in file["coefficients"].dims] == ["/coefficient", "/height", "/width", "/channel"]


def test_describe(tmp_path):
    paths = write_each(tmp_path)
    summaries = {kind: store.describe(path) for kind, path in paths.items()}
    json.dumps(summaries, allow_nan=False)
    assert summaries["stack"]["datasets"]["images"]["shape"] == [5, 7, 6, 3]
    assert summaries["stack"]["bytes_on_disk"] == paths["stack"].stat().st_size
    assert summaries["fit"]["attributes"]["config"] == {"energy": 1.0, "b": [1, 2], "a": None}
    assert summaries["encoded"]["info"] == {"entropy_bits": 3.25, "other": None}
    assert summaries["results"]["rows"] == 3
    assert [s["schema"] for s in summaries.values()] == ["stack/1", "fit/1", "encoded/4", "results/1"]


@pytest.mark.parametrize(
    ("shape", "itemsize", "first", "expected"),
    [
        ((256, 480, 640, 3), 1, None, (256, 2, 640, 3)),
        ((5, 7, 6, 3), 1, None, (5, 7, 6, 3)),
        ((256, 480, 640, 3), 1, 32, (32, 17, 640, 3)),
        ((1000, 4000, 6000, 3), 2, None, (29, 1, 6000, 3)),  # a row of all lights would be 36 MB
        ((1, 3, 1 << 20, 3), 4, None, (1, 1, 1 << 20, 3)),
    ],
)
def test_chunks(shape, itemsize, first, expected):
    assert writing.chunk_shape(shape, itemsize, first) == expected


# Writing is all or nothing


def leftovers(folder):
    return sorted(p.name for p in folder.iterdir())


def fill(path, stack, count, error=None):
    """Write the first `count` images one by one, then raise."""
    with store.create_stack(path, replace(stack, name="stack"), chunk_lights=2) as sink:
        with pytest.raises(TypeError, match="expected uint16"):
            sink[0] = stack.images_ihwc[0].astype(np.uint8)
        with pytest.raises(TypeError, match="expected uint16"):
            sink[0:2] = stack.images_ihwc[0:1]
        for i in range(count):
            sink[i : i + 1] = stack.images_ihwc[i : i + 1]
        if error is not None:
            raise error


@pytest.mark.parametrize("error", [RuntimeError("no"), KeyboardInterrupt(), SystemExit(1)])
@pytest.mark.parametrize("count", [0, 3, 5])
def test_exception_keeps_the_old_file(tmp_path, way, error, count):
    path = tmp_path / "s.h5"
    store.write_stack(path, make_stack())
    before = path.read_bytes()
    with pytest.raises(type(error)):
        fill(path, make_stack("uint16"), count, error)
    assert path.read_bytes() == before
    assert leftovers(tmp_path) == ["s.h5"]


def test_an_array_not_filled_is_an_error(tmp_path, way):
    stack = make_stack("uint16", optional=False)
    with pytest.raises(ValueError, match="126 of 630 elements"):
        fill(tmp_path / "s.h5", stack, 4)
    assert leftovers(tmp_path) == []
    fill(tmp_path / "s.h5", stack, 5)
    with store.open_stack(tmp_path / "s.h5") as back:
        np.testing.assert_array_equal(np.asarray(back.images_ihwc), stack.images_ihwc)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT])
def test_disk_full(tmp_path, way, monkeypatch, error):
    path = tmp_path / "f.h5"
    store.write_fit(path, make_fit())
    before = path.read_bytes()

    def full(*_):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(durable.os, "write" if way == "memory" else "posix_fallocate", full)
    with pytest.raises(InputError, match=r"^cannot write .*f\.h5: the disk is full$"):
        store.write_fit(path, make_fit(maps=False))
    assert path.read_bytes() == before
    assert leftovers(tmp_path) == ["f.h5"]


def test_free_space_is_looked_at_first(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    real = os.fstatvfs
    monkeypatch.setattr(durable.os, "fstatvfs", lambda fd: os.statvfs_result((*real(fd)[:4], 1, *real(fd)[5:10])))
    with pytest.raises(InputError, match="it needs 4 MB, 0 MB are free"):
        store.write_fit(tmp_path / "f.h5", make_fit())
    assert leftovers(tmp_path) == []


@pytest.mark.parametrize("reserves", [True, False])
def test_reserved_space_covers_the_file_and_is_given_back(tmp_path, monkeypatch, reserves):
    # Thousands of lights and rows, in chunks of one row: as much beside the images as there will ever be.
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    monkeypatch.setattr(writing, "CHUNK_BYTES", 1 << 13)
    reserved = []

    def reserve(descriptor, start, n_bytes):
        reserved.append(n_bytes)
        if not reserves:
            raise OSError(errno.EOPNOTSUPP, "no")
        os.ftruncate(descriptor, n_bytes)

    monkeypatch.setattr(durable.os, "posix_fallocate", reserve)
    stack = make_stack("float32", (4000, 60, 2, 3))
    store.write_stack(tmp_path / "s.h5", stack)
    size = (tmp_path / "s.h5").stat().st_size
    assert reserved == [pytest.approx(size, rel=0.8)]
    assert stack.images_ihwc.nbytes < size < reserved[0]
    with store.open_stack(tmp_path / "s.h5") as back:
        assert back.images_ihwc.chunks[1] == 1
        same_stack(back, stack)
    with h5py.File(tmp_path / "s.h5") as file:
        assert file.id.get_filesize() == size


def test_a_killed_writer_leaves_the_old_file_and_its_part_is_taken_over(tmp_path):
    path = tmp_path / "s.h5"
    store.write_stack(path, make_stack())
    before = path.read_bytes()
    script = f"""
        import os, signal
        from clrelight.durable import replacing
        with replacing({str(path)!r}) as part:
            part.write(b"half")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], timeout=60)
    assert done.returncode == -signal.SIGKILL
    assert path.read_bytes() == before
    assert leftovers(tmp_path) == [".s.h5.part", "s.h5"]
    store.write_stack(path, make_stack("uint16"))
    assert leftovers(tmp_path) == ["s.h5"]


def test_two_writers_of_one_file(tmp_path):
    path = tmp_path / "f.h5"
    with durable.replacing(path) as part:
        part.write(b"mine")
        with pytest.raises(InputError, match="another program is writing"):
            store.write_fit(path, make_fit())
    assert path.read_bytes() == b"mine"


def test_bad_targets(tmp_path):
    fit = make_fit()
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    os.mkfifo(tmp_path / "fifo")
    for name, message in (
        ("none/f.h5", "there is no folder"),
        ("folder", "no regular file"),
        ("link", "no regular file"),
        ("fifo", "no regular file"),
        ("x" * 300, "cannot write"),
        ("nul\0", "no file name"),
    ):
        with pytest.raises(InputError, match=message):
            store.write_fit(tmp_path / name, fit)
    os.mkfifo(tmp_path / ".a.h5.part")
    (tmp_path / ".b.h5.part").symlink_to(tmp_path / "victim")
    (tmp_path / "victim").write_bytes(b"keep")
    os.link(tmp_path / "victim", tmp_path / ".c.h5.part")
    for name in "abc":
        with pytest.raises(InputError, match="cannot write"):
            store.write_fit(tmp_path / f"{name}.h5", fit)
    assert (tmp_path / "victim").read_bytes() == b"keep"
    assert stat.S_ISFIFO(os.lstat(tmp_path / "fifo").st_mode)


def test_what_cannot_be_written_is_said(tmp_path):
    stack, fit = make_stack(), make_fit()
    for name, message in (("a\0b", "NUL"), ("\ud800", "surrogates")):
        opening = store.create_stack(tmp_path / "s.h5", replace(stack, name=name))
        with pytest.raises(InputError, match=message), opening:
            pass
    for config in ({"x": math.nan}, {"x": object()}, {"x": "y" * 40000}):
        bad = CoefficientMap(fit.coeffs_khwc, 2, "uls", 1.0, "linear", fit.directions_i3, config)
        with pytest.raises(InputError, match=r"JSON|bytes"):
            store.write_fit(tmp_path / "f.h5", bad)
    with pytest.raises(InputError, match="shape"):
        store.write_encoded(tmp_path / "e.h5", make_encoded(make_fit(1)), fit)
    for pictures in ({"a": np.zeros((2, 2), "u1")}, {"a": np.zeros((2, 2, 3))}):
        with pytest.raises(InputError, match="pictures: a must be"):
            store.write_results(tmp_path / "r.h5", Results(make_results().table, pictures))
    assert leftovers(tmp_path) == []


def test_an_open_reader_keeps_the_old_content(tmp_path):
    path = tmp_path / "s.h5"
    old = make_stack(shape=(4, 5, 6, 3))
    store.write_stack(path, old)
    with store.open_stack(path) as back:
        store.write_stack(path, make_stack("float32"))
        same_stack(back, old)
    with store.open_stack(path) as back:
        assert back.images_ihwc.dtype == np.float32


def test_encodings_of_before_are_read():
    encoded, record = store.read_encoded(FROZEN / "encoded.1.hdf")
    held = np.frombuffer(encoded.body, "<f2")
    np.testing.assert_array_equal(held, np.arange(24) / 8)
    assert (encoded.codec, encoded.config, encoded.info) == ("half", {"clamp": False}, {"clamped": 0.25})
    assert (record.method, record.degree, record.peak, record.transfer) == ("cls", 1, 255.0, "srgb")
    assert (record.name, record.config, record.directions_i3.shape) == ("before", {"energy": 0.5}, (7, 3))
    assert store.file_schema(FROZEN / "encoded.1.hdf") == "encoded/1"
    assert store.describe(FROZEN / "encoded.1.hdf")["attributes"]["encoded_bytes"] == 48


@pytest.mark.parametrize(("version", "basis", "off"), [(2, "sh", 5e-6), (3, "hsh", 5e-6), (4, "hsh", 8e-5)])
def test_encodings_of_all_versions_are_read(version, basis, off, tmp_path):
    """Before `encoded/4` lights took 5 bytes, records had no dictionary, and the root bore the seal."""
    path = FROZEN / f"encoded.{version}.hdf"
    encoded, record = store.read_encoded(path)
    np.testing.assert_array_equal(np.frombuffer(encoded.body, "<f2"), np.arange(24) / 8)
    assert (encoded.codec, encoded.config, encoded.info) == ("half", {"clamp": False}, {"clamped": 0.25})
    assert (record.method, record.degree, record.peak, record.transfer) == ("cls", 1, 255.0, "srgb")
    assert (record.name, record.basis) == ("before", basis)
    lights_i3 = np.random.default_rng(3).standard_normal((7, 3))
    lights_i3[:, 2] = np.abs(lights_i3[:, 2])
    lights_i3 /= np.linalg.norm(lights_i3, axis=1, keepdims=True)
    np.testing.assert_allclose(record.directions_i3, lights_i3, rtol=0, atol=off)
    assert store.file_schema(path) == f"encoded/{version}"
    damaged = bytearray(path.read_bytes())
    at = damaged.index(b"xxh3-64")
    damaged[at + 8] ^= 1
    (tmp_path / "damaged.h5").write_bytes(damaged)
    with pytest.raises(StoreFormatError):
        store.read_encoded(tmp_path / "damaged.h5")


@pytest.mark.parametrize(
    ("n_light", "pattern", "most"),
    [(1, "random", 680), (49, "random", 880), (100, "random", 1090), (240, "random", 1630), (240, "uniform", 1500)],
)
def test_an_encoding_takes_little_beside_its_payload(tmp_path, n_light, pattern, most):
    """Options as `auto` leaves them: numbers of all digits. Of lights along a path differences are less than places."""
    options = {name: 1 / (3 + k) for k, name in enumerate(("edge", "heat", "level", "noise", "slope"))}
    options |= {"holdout": {"by": "index", "every": 5, "lights": None}, "precision": "mixed", "weights": "uniform"}
    lights_i3 = directions(n_light) if pattern == "random" else make_pattern(pattern, n_light)
    fit = replace(make_fit(maps=False), directions_i3=lights_i3, method="spectrum", config=options, name="item1")
    config = {"byte_budget": 15000, "metric": "radiance", "rate": None, "step": None, "transfer": "srgb"}
    body = np.random.default_rng(0).bytes(15000)
    encoded = Encoded("klt", config, fit.coeffs_khwc.shape, body, {"planes": 29.0, "step": 1 / 17}, FitRecord.of(fit))
    store.write_encoded(tmp_path / "e.h5", encoded)
    beside = (tmp_path / "e.h5").stat().st_size - 15000
    assert beside <= most
    assert beside <= container_bytes(FitRecord.of(fit), encoded.shape) <= beside + 120


@pytest.mark.parametrize("size", [(1 << 20) - 10, (1 << 20) + 10, 3_500_001])
def test_large_payloads_are_not_filled_up(tmp_path, size):
    encoded = make_encoded(make_fit(), bytes(size))
    store.write_encoded(tmp_path / "e.h5", encoded, make_fit())
    assert (tmp_path / "e.h5").stat().st_size < size + 2000
    assert len(store.read_encoded(tmp_path / "e.h5")[0].body) == size


def test_many_lights_and_all_directions(tmp_path):
    many = replace(make_fit(maps=False), directions_i3=directions(5000))
    store.write_encoded(tmp_path / "e.h5", make_encoded(many), many)
    record = store.read_encoded(tmp_path / "e.h5")[1]
    np.testing.assert_array_equal(record.directions_i3, many.directions_i3)
