"""Fits that are stored as binary16: the values, what is refused, and every command that reads one."""

import contextlib
import importlib
import itertools
import json
import tracemalloc
from dataclasses import replace

import h5py
import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight import store
from clrelight.cli.trade import _commands
from clrelight.codec import Half, encode
from clrelight.codec.rounding import rounding_rows
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.device import open_device
from clrelight.errors import InputError, StoreFormatError
from clrelight.experiment.grid import CodecSetting
from clrelight.fit import prepare_fit
from clrelight.fit.run import fit_tiles, rows_per_tile
from clrelight.jobs.fit import fit
from clrelight.jobs.half_tiles import tiles_of
from clrelight.jobs.target import encode_to_quality
from clrelight.metrics import measure_errors
from clrelight.relight import relight
from clrelight.sampling import make_pattern
from clrelight.store import writing
from tests.commands import arrays, attributes, call, contents, succeed
from tests.hdf5 import unseal
from tests.reference.basis import real_harmonics
from tests.reference.half import decode_half, encode_half
from tests.reference.psnr import mean_squared_errors, psnr
from tests.stacks import make_stack
from tests.styles import both_styles

UP = np.array([[0.0, 0.0, 1.0]])
DEGREE = 4


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A ring, and its fit stored both ways."""
    folder = tmp_path_factory.mktemp("made")
    succeed("synth", "ring", folder / "ring.h5", "--size", 32, "--lights", 64)
    told = {}
    for dtype in ("float32", "float16"):
        words = ("--degree", DEGREE, "--holdout", 5, "--store", dtype, "--json")
        told[dtype] = succeed("fit", folder / "ring.h5", folder / f"{dtype}.h5", *words).json
    return folder, told


def random_map(dtype="float32", shape=(9, 23, 11, 3), scale=1.0, seed=1):
    rng = np.random.default_rng(seed)
    coeffs = scale * rng.standard_normal(shape) * 10.0 ** rng.uniform(-9, 3, shape)
    return CoefficientMap(coeffs.astype(dtype), int(np.sqrt(shape[0])) - 1, "uls", 1.0, "linear", UP)


def pixels(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT), np.float64)


def as_file(path, coeffs, dtype):
    """Write a fit file whose coefficients are of any type, as another program might."""
    store.write_fit(path, replace(random_map(), coeffs_khwc=np.asarray(coeffs, np.float32)))
    with h5py.File(path, "r+", libver="latest") as file:
        unseal(file)
        axes = [file[axis] for axis in ("coefficient", "height", "width", "channel")]
        del file["coefficients"]
        dataset = file.create_dataset("coefficients", data=np.asarray(coeffs, dtype), fletcher32=True, chunks=True)
        for dim, axis in zip(dataset.dims, axes, strict=True):
            dim.attach_scale(axis)
    return path


# The values


def test_a_half_fit_holds_what_codec_half_makes_of_the_other(made):
    folder, told = made
    wide, narrow = (arrays(folder / f"{dtype}.h5") for dtype in ("float32", "float16"))
    assert (wide["coefficients"].dtype, narrow["coefficients"].dtype) == (np.float32, np.float16)
    np.testing.assert_array_equal(narrow["coefficients"].view(np.uint16), encode_half(wide["coefficients"]))
    for dtype in ("float32", "float16"):
        succeed("encode", folder / f"{dtype}.h5", folder / f"{dtype}.enc.h5", "--codec", "half")
    payload = narrow["coefficients"].tobytes()
    for dtype in ("float32", "float16"):
        assert arrays(folder / f"{dtype}.enc.h5")["payload"].tobytes().endswith(payload)
    np.testing.assert_array_equal(narrow["lambda"], wide["lambda"], strict=True)
    for name in ("method", "degree", "config", "peak", "transfer", "name", "clrelight_schema"):
        assert attributes(folder / "float16.h5")[name] == attributes(folder / "float32.h5")[name]
    for dtype in ("float32", "float16"):
        size = (folder / f"{dtype}.h5").stat().st_size
        assert (told[dtype]["dtype"], told[dtype]["bytes_on_disk"]) == (dtype, size)
    saved = told["float32"]["bytes_on_disk"] - told["float16"]["bytes_on_disk"]
    assert abs(saved - len(payload)) < 20_000


def test_the_psnr_after_fitting_is_that_of_what_is_stored(made):
    folder, told = made
    stack = arrays(folder / "ring.h5")
    bits = arrays(folder / "float16.h5")["coefficients"].view(np.uint16)
    basis_ik = real_harmonics(stack["directions"], DEGREE)
    relit = np.einsum("ik,khwc->ihwc", basis_ik, decode_half(bits))
    mse_i = mean_squared_errors(relit, stack["images"], 255.0, "linear", np.ones((32, 32), bool))
    held = np.arange(64) % 5 == 4
    expected = psnr(mse_i[~held].mean()), psnr(mse_i[held].mean())
    for quality in (
        told["float16"]["psnr"],
        succeed("psnr", folder / "float16.h5", folder / "ring.h5", "--json").json["psnr"],
    ):
        np.testing.assert_allclose((quality["pooled_fitted"], quality["pooled_holdout"]), expected, atol=1e-4)


@pytest.mark.parametrize("method", ["cls", "ceb"])
def test_bounded_fits_lose_nothing(made, tmp_path, method):
    found = []
    for dtype in ("float32", "float16"):
        words = ("--method", method, "--degree", 6, "--store", dtype, "--json")
        found.append(succeed("fit", made[0] / "ring.h5", tmp_path / "f.h5", *words).json["psnr"]["pooled_fitted"])
    assert abs(found[0] - found[1]) < 0.01


def test_unbounded_ones_lose(tmp_path):
    store.write_stack(tmp_path / "r.h5", make_stack(100, (16, 16, 3)))
    found = []
    for dtype in ("float32", "float16"):
        words = ("--method", "uls", "--degree", 8, "--store", dtype, "--json")
        found.append(succeed("fit", tmp_path / "r.h5", tmp_path / "f.h5", *words).json["psnr"]["pooled_fitted"])
    assert found[1] < found[0] - 1


@both_styles
@pytest.mark.parametrize("streamed", [False, True])
def test_python_writes_and_reads_either_type(device, tmp_path, monkeypatch, streamed):
    if streamed:
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    fitted, path = random_map(), tmp_path / "f.h5"
    store.write_fit(path, fitted, dtype="float16", device=device)
    back = store.read_fit(path)
    np.testing.assert_array_equal(back.coeffs_khwc.view(np.uint16), encode_half(fitted.coeffs_khwc))
    store.write_fit(tmp_path / "again.h5", back)
    assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()
    with store.open_fit(path) as lazy:
        assert lazy.coeffs_khwc.dtype == np.float16
        store.write_fit(tmp_path / "again.h5", lazy)
        wide = lazy.to_float32()
        store.write_fit(tmp_path / "wide.h5", lazy, dtype=np.float32)
        monkeypatch.setattr("clrelight.dataset.PIECE_BYTES", 2 * 9 * 11 * 3 * 5)  # five rows at a time
        np.testing.assert_array_equal(lazy.to_float32().coeffs_khwc, wide.coeffs_khwc)
        rows_khwc = np.empty((9, 12, 11, 3), np.float32)
        np.testing.assert_array_equal(lazy.read_rows(4, 16, rows_khwc), wide.coeffs_khwc[:, 4:16])
        with pytest.raises(TypeError, match="expected an array of float16 or float32, got float64"):
            lazy.read_rows(4, 16, rows_khwc.astype(np.float64))
    with pytest.raises(TypeError, match="expected an array of float32 or float32, got float16"):
        wide.read_rows(0, 23, np.empty((9, 23, 11, 3), np.float16))  # that would round
    assert (tmp_path / "again.h5").read_bytes() == path.read_bytes()
    np.testing.assert_array_equal(wide.coeffs_khwc, decode_half(encode_half(fitted.coeffs_khwc)))
    assert wide.coeffs_khwc.dtype == np.float32
    np.testing.assert_array_equal(store.read_fit(tmp_path / "wide.h5").coeffs_khwc, wide.coeffs_khwc, strict=True)
    assert wide.to_float32() is wide


@both_styles
@pytest.mark.parametrize("shape", [(9, 1, 1, 1), (9, 13, 37, 3), (9, 1, 1025, 1), (81, 5, 61, 3)])
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_halves_are_measured_as_their_float32(device, shape, transfer):
    images = np.random.default_rng(0).random((20, *shape[1:])).astype(np.float32)
    stack = LightStack(images, make_pattern("uniform", 20), 1.0, transfer)
    halves = replace(random_map("float16", shape, scale=1e-3), transfer=transfer)
    halves.coeffs_khwc[0] += np.float16(1.5)
    for given in (halves, replace(halves, coeffs_khwc=Rows(halves.coeffs_khwc))):
        np.testing.assert_array_equal(measure_errors(given, stack), measure_errors(halves.to_float32(), stack))
        np.testing.assert_array_equal(
            relight(given, stack.directions_i3[:3]), relight(halves.to_float32(), stack.directions_i3[:3])
        )


def test_halves_are_read_as_halves(device, monkeypatch):
    stack, read = make_stack(20, (13, 37, 3)), []
    halves = random_map("float16", (9, 13, 37, 3), scale=1e-3)

    def recording(self, first, end, out_khwc):
        read.append(out_khwc.dtype)
        return read_rows(self, first, end, out_khwc)

    read_rows = CoefficientMap.read_rows
    monkeypatch.setattr(CoefficientMap, "read_rows", recording)
    stored = replace(halves, coeffs_khwc=Rows(halves.coeffs_khwc))
    relight(stored, stack.directions_i3[:3])
    measure_errors(stored, stack)
    assert read == [np.float16, np.float16]


class Rows:
    """Coefficients that can only be read by rows, as those of a file."""

    def __init__(self, coeffs_khwc):
        self._coeffs, self.shape, self.dtype, self.chunks = coeffs_khwc, coeffs_khwc.shape, coeffs_khwc.dtype, None

    def read_into(self, tile, out, picked_n=None):
        assert out.dtype == self.dtype
        out[...] = self._coeffs[:, tile.rows, tile.columns]


# Every command that reads a fit


def test_every_codec_takes_a_half_fit(made, tmp_path):
    folder, _ = made
    exact = tmp_path / "exact.h5"  # the same values, as float32
    store.write_fit(exact, store.read_fit(folder / "float16.h5"), dtype="float32")
    for codec in ("s3tc", "uniform", "wavelet"):
        told = {}
        for name, path in (("half", folder / "float16.h5"), ("exact", exact)):
            words = (path, tmp_path / f"{name}.enc.h5", "--codec", codec, "--stack", folder / "ring.h5", "--json")
            told[name] = succeed("encode", *words).json
        assert (tmp_path / "half.enc.h5").read_bytes() == (tmp_path / "exact.enc.h5").read_bytes()
        for key in ("psnr", "coding_noise", "encoded_bytes"):
            assert told["half"][key] == told["exact"][key]


def test_a_quality_can_be_asked_of_a_half_fit(made, tmp_path):
    folder, told = made
    target = told["float16"]["psnr"]["pooled_holdout"] - 1.0
    words = ("--target-psnr", target, "--stack", folder / "ring.h5", "--json")
    ended = call("encode", folder / "float16.h5", tmp_path / "e.h5", *words)
    assert target <= ended.json["psnr"]["pooled_holdout"] <= target + 0.5
    with store.open_stack(folder / "ring.h5") as stack:
        encoded, _, _ = encode_to_quality(store.read_fit(folder / "float16.h5"), stack, target, device=open_device())
    assert encoded.encoded_bytes == ended.json["encoded_bytes"]


def test_pictures_of_a_half_fit(made, tmp_path):
    folder, _ = made
    coeffs = decode_half(arrays(folder / "float16.h5")["coefficients"].view(np.uint16))
    lights = np.array([[0.6, 0, 0.8], [0, -0.6, 0.8]])
    words = [word for light in lights for word in ("--light", ",".join(map(str, light)))]
    succeed("relight", folder / "float16.h5", tmp_path / "r%d.exr", *words)
    for i, expected in enumerate(np.einsum("ik,khwc->ihwc", real_harmonics(lights, DEGREE), coeffs)):
        np.testing.assert_allclose(pixels(tmp_path / f"r{i}.exr"), expected, atol=1e-5)
    # Under light from everywhere, as the float32 of the same values.
    store.write_fit(tmp_path / "exact.h5", store.read_fit(folder / "float16.h5"), dtype="float32")
    succeed("light", tmp_path / "sky.h5", "--sky", "clear", "--sun", "35,120", "--degree", DEGREE)
    for name, path in (("half", folder / "float16.h5"), ("exact", tmp_path / "exact.h5")):
        ended = call("relight", path, tmp_path / f"{name}_sky.exr", "--light", tmp_path / "sky.h5")
        assert ended.code == 0
        for form in ("exr", "exr-half", "dds"):
            succeed("export", path, tmp_path / f"{name}.{form}", "--format", form)
    np.testing.assert_array_equal(pixels(tmp_path / "half_sky.exr"), pixels(tmp_path / "exact_sky.exr"))
    for form in ("exr", "exr-half"):
        files = sorted((tmp_path / f"half.{form}").iterdir())
        assert len(files) == 26
        for file in files:
            other = tmp_path / f"exact.{form}" / file.name
            if file.suffix == ".exr":
                np.testing.assert_array_equal(pixels(file), pixels(other))
            else:
                assert file.read_bytes() == other.read_bytes()
    assert (tmp_path / "half.dds").read_bytes() == (tmp_path / "exact.dds").read_bytes()


def test_info_and_the_printed_facts_name_the_type(made, tmp_path):
    folder, _ = made
    told = succeed("info", folder / "float16.h5", "--json").json
    assert told["datasets"]["coefficients"]["dtype"] == "float16"
    assert told["datasets"]["lambda"]["dtype"] == "float32"
    out = succeed("fit", folder / "ring.h5", tmp_path / "f.h5", "--degree", 1, "--store", "float16").out
    assert f"stored     float16, {(tmp_path / 'f.h5').stat().st_size} bytes\n" in out


def test_trade_names_the_one_command_that_stores_halves(tmp_path):
    asked = {codec: _commands("s.h5", tmp_path / "t.toml", CodecSetting(codec)) for codec in (None, Half())}
    fit = f"clrelight fit s.h5 fit.h5 --config {tmp_path / 't.toml'}"
    assert asked[None] == {"next": fit}
    then = "clrelight encode fit.h5 small.h5 --codec half"
    assert asked[Half()] == {"next": fit, "then": then, "or at once": f"{fit} --store float16"}


def test_a_config_and_a_type_go_together(made, tmp_path):
    (tmp_path / "one.toml").write_text('methods = ["ceb"]\ndegrees = [2]\n')
    words = ("--config", tmp_path / "one.toml", "--store", "float16")
    succeed("fit", made[0] / "ring.h5", tmp_path / "f.h5", *words)
    assert arrays(tmp_path / "f.h5")["coefficients"].dtype == np.float16
    assert arrays(tmp_path / "f.h5")["rank"].dtype == np.int32


# What is refused


def large_stack(path, row):
    """Write a stack of which one pixel alone is too bright for halves."""
    stack = make_stack(30, (40, 16, 3))
    stack.images_ihwc[:, row, 5, 1] = 3e5
    store.write_stack(path, stack)
    return path


@pytest.mark.parametrize("row", [0, 21, 39])
@pytest.mark.parametrize("memory", ["1MB", "100k"])
@pytest.mark.parametrize("streamed", [False, True])
def test_what_halves_cannot_hold_is_refused_and_nothing_written(tmp_path, monkeypatch, row, memory, streamed):
    if streamed:
        monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    large_stack(tmp_path / "s.h5", row)
    succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 2)
    value = arrays(tmp_path / "f.h5")["coefficients"][0, row, 5, 1]
    (tmp_path / "f.h5").write_bytes(b"precious")
    files = contents(tmp_path)
    words = ("--degree", 2, "--memory", memory, "--store", "float16")
    ended = call("fit", tmp_path / "s.h5", tmp_path / "f.h5", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert f"(k, row, column, channel) = (0, {row}, 5, 1) is {value:g}, which binary16 cannot hold" in ended.err
    assert "(|x| must be below 65520); fit with a constrained method, or store float32" in ended.err
    assert contents(tmp_path) == files


@pytest.mark.parametrize("memory", ["1MB", "100k"])
def test_a_map_of_which_nothing_would_be_left_is_refused(tmp_path, memory):
    stack = make_stack(30, (40, 16, 3))
    dim = replace(stack, images_ihwc=stack.images_ihwc * np.float32(2.0**-30))
    store.write_stack(tmp_path / "s.h5", dim)
    files = contents(tmp_path)
    words = ("--degree", 2, "--memory", memory, "--store", "float16")
    ended = call("fit", tmp_path / "s.h5", tmp_path / "f.h5", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "as binary16 all would be 0: give the stack a peak near its brightest sample" in ended.err
    assert contents(tmp_path) == files
    dim.images_ihwc[:] = 0  # there is nothing to lose
    store.write_stack(tmp_path / "s.h5", dim)
    succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", *words)
    assert not arrays(tmp_path / "f.h5")["coefficients"].any()


@both_styles
def test_rounding_rows_is_codec_half_by_rows(device):
    fitted, rows = random_map(scale=1e-4), ((0, 9), (9, 10), (10, 23))
    fitted.coeffs_khwc[:, :9] *= np.float32(1e-12)  # 0 as halves
    with rounding_rows(device) as round_rows:
        pieces = []
        for first, end in rows:
            part = np.ascontiguousarray(fitted.coeffs_khwc[:, first:end])
            pieces.append(round_rows(part, np.empty(part.shape, np.float16), first))
    whole = np.concatenate(pieces, axis=1)
    assert whole.tobytes() == encode(fitted.coeffs_khwc, Half(), device).body
    assert not whole[:, :9].any()


@pytest.mark.parametrize("value", [65520.0, -65520.0, np.inf])
def test_python_refuses_what_halves_cannot_hold(tmp_path, value):
    fitted, path = random_map(scale=1e-3), tmp_path / "f.h5"
    fitted.coeffs_khwc[4, 17, 2, 1] = value
    with pytest.raises(InputError, match=r"\(4, 17, 2, 1\) is .* binary16 cannot hold"):
        store.write_fit(path, fitted, dtype="float16")
    assert contents(tmp_path) == {}
    fitted.coeffs_khwc[4, 17, 2, 1] = np.nextafter(np.float32(65520), np.float32(0))
    store.write_fit(path, fitted, dtype="float16")
    assert store.read_fit(path).coeffs_khwc[4, 17, 2, 1] == 65504


@pytest.mark.parametrize("scale", [2.0**-60, 0.0])
def test_python_refuses_what_vanishes(tmp_path, scale):
    fitted = random_map(scale=scale)
    refusal = pytest.raises(InputError, match="all would be 0") if scale else contextlib.nullcontext()
    with refusal:
        store.write_fit(tmp_path / "f.h5", fitted, dtype="float16")
    assert contents(tmp_path).keys() == ({"f.h5"} if not scale else set())


@pytest.mark.parametrize("dtype", ["float64", ">f2", ">f4", "int16", "two", None])
def test_other_types_are_not_stored(tmp_path, dtype):
    about = {"method": "uls", "peak": 1.0, "transfer": "linear", "directions_i3": UP, "name": "x", "config": {}}
    opening = store.create_fit(tmp_path / "f.h5", FitRecord(2, **about), (3, 4, 3), dtype=dtype)
    with pytest.raises(InputError, match="coefficients are stored as float32 or float16, not as"), opening:
        pass
    assert contents(tmp_path) == {}


@pytest.mark.parametrize("dtype", [">f2", ">f4", "<f8", "<i2", "<u2"])
def test_other_types_are_not_read(tmp_path, dtype):
    path = as_file(tmp_path / "f.h5", np.ones((9, 23, 11, 3)), dtype)
    for reading in (store.read_fit, store.describe):
        with pytest.raises(StoreFormatError, match=r"coefficients is .*, expected float32 or float16 with 4 axes"):
            reading(path)


def test_a_file_of_halves_by_another_program_is_read(tmp_path):
    coeffs = random_map("float16").coeffs_khwc
    fitted = store.read_fit(as_file(tmp_path / "f.h5", coeffs, "<f2"))
    np.testing.assert_array_equal(fitted.coeffs_khwc, coeffs, strict=True)


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_a_stored_half_that_is_no_number_is_named(made, tmp_path, value):
    stack = made[0] / "ring.h5"
    fitted = random_map("float16", (9, 32, 32, 3))
    fitted.coeffs_khwc[3, 30, 2, 1] = value
    store.write_fit(tmp_path / "bad.h5", fitted)
    shown = json.dumps(value).replace("Infinity", "inf").replace("NaN", "nan")
    for words in (["psnr", "bad.h5", stack], ["relight", "bad.h5", "p.png", "--light", "0,0,1"]):
        ended = call(*[tmp_path / word if word in ("bad.h5", "p.png") else word for word in words])
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
        assert f"coefficient 3 at row 30, column 2, channel 1 is {shown}, expected a finite number" in ended.err
    ended = call("encode", tmp_path / "bad.h5", tmp_path / "e.h5", "--codec", "uniform")
    assert ended.code == 2
    assert f"(k, row, column, channel) = (3, 30, 2, 1) is {shown}" in ended.err
    assert contents(tmp_path).keys() == {"bad.h5"}


@pytest.mark.parametrize("value", ["float64", "half", "16"])
def test_the_option_knows_two_types(made, tmp_path, value):
    ended = call("fit", made[0] / "ring.h5", tmp_path / "f.h5", "--store", value)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "--store" in ended.err
    assert contents(tmp_path) == {}


# Memory


def test_the_budget_changes_no_byte(made, tmp_path):
    files = [(made[0] / "float16.h5").read_bytes()]
    for memory in ("300k", "60k"):
        words = ("--degree", DEGREE, "--holdout", 5, "--store", "float16", "--memory", memory)
        succeed("fit", made[0] / "ring.h5", tmp_path / "f.h5", *words)
        files.append((tmp_path / "f.h5").read_bytes())
    assert files[0] == files[1] == files[2]


@pytest.mark.parametrize("method", ["cls", "ceb", "uls"])
def test_tiles_of_halves_hold_what_they_are_counted_for(method):
    stack = make_stack(20, (40, 64, 3))
    prepared = prepare_fit(stack, method, 2)
    maps = 4 * (method != "uls")
    beside = 2 * 2 * 9 + maps
    column = 2 * 4 * 20 + 4 * (len(prepared.plan.singular_r) + 2) + 4 * (9 + 1) + beside
    memory = 4 * 64 * 3 * column - 1
    assert rows_per_tile(prepared, memory + 1, beside=beside) == 4
    assert rows_per_tile(prepared, memory) == 4  # it is the halves that do not fit
    with contextlib.closing(tiles_of(prepared, np.dtype(np.float16), memory)) as tiles:
        found = [(tile, tile.coeffs_khwc.copy()) for tile in tiles]
    assert [(tile.first, tile.end) for tile, _ in found[:2]] == [(0, 3), (3, 6)]
    for (tile, _), (following, _) in itertools.pairwise(found):
        assert not np.shares_memory(tile.coeffs_khwc, following.coeffs_khwc)  # one is written while the other is made
    assert np.shares_memory(found[0][0].coeffs_khwc, found[2][0].coeffs_khwc)
    with contextlib.closing(fit_tiles(prepared, memory_bytes=memory, beside=beside)) as tiles:
        for (_, halves_khwc), tile in zip(found, tiles, strict=True):
            np.testing.assert_array_equal(halves_khwc, tile.coeffs_khwc.astype(np.float16), strict=True)


def test_memory_does_not_grow_with_the_view(tmp_path, monkeypatch):
    monkeypatch.setattr(writing, "IN_MEMORY_BYTES", 0)
    for module, name in (("clrelight.relight", "_TILE_BYTES"), ("clrelight.metrics", "PIECE_BYTES")):
        monkeypatch.setattr(importlib.import_module(module), name, 1 << 18)
    peaks = {}
    for height in (340, 340, 1020):  # the first builds kernels
        store.write_stack(tmp_path / "s.h5", make_stack(20, (height, 64, 3)))
        peaks[height] = []
        for words in (
            ("fit", "s.h5", "f.h5", "--degree", 3, "--memory", "500k", "--store", "float16", "--no-measure"),
            ("psnr", "f.h5", "s.h5"),
            ("relight", "f.h5", "f.exr", "--light", "0,0,1"),
        ):
            tracemalloc.start()
            succeed(*(tmp_path / word if str(word).endswith((".h5", ".exr")) else word for word in words))
            peaks[height].append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    pixels_more = 680 * 64 * 3
    grown = np.subtract(peaks[1020], peaks[340])  # chunks have the same size, and none is cut off
    grown[2] -= 2 * 4 * pixels_more  # relight holds its picture, and what it writes of it
    assert (grown < 0.1 * 16 * 2 * pixels_more).all(), peaks


@pytest.mark.parametrize("store", ["float32", "float16"])
def test_a_budget_below_one_row_is_refused_before_any_file_is_begun(store, tmp_path, monkeypatch):
    monkeypatch.setattr("clrelight.jobs.fitting.create_fit", lambda *given, **options: pytest.fail("a file was begun"))
    picture = tmp_path / "c.exr"
    with pytest.raises(InputError, match="one row of this fit takes"):
        fit(
            make_stack(20, (6, 8, 3)),
            "spectrum",
            2,
            memory=1000,
            store=store,
            confidence=picture,
            out=tmp_path / "f.h5",
        )
    assert list(tmp_path.iterdir()) == []
