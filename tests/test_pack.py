"""Photographs to one file and back, by the command and from Python."""

import os
import re
import shutil

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.codec import decode, decode_regions
from clrelight.codec.views import Region
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.images import write_image
from clrelight.ingest import folder as folder_module
from clrelight.jobs import measure_parts as parts_module
from clrelight.jobs import packing
from clrelight.jobs.fitted_source import fitted_source
from clrelight.jobs.measure_parts import measure_parts, sample_windows
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern
from clrelight.store import open_stack, write_stack
from clrelight.store.scratch import scratch_workspace
from tests.commands import call, succeed
from tests.stacks import make_samples

LIGHTS = 30
HEIGHT, WIDTH = 40, 56


def codes(height=HEIGHT, width=WIDTH, n_light=LIGHTS):
    """8-bit photographs of a smooth matt surface, with a little noise."""
    y, x = np.mgrid[0 : 1 : height * 1j, 0 : 1 : width * 1j]
    normals = np.stack([np.sin(5 * x), np.cos(4 * y), np.full_like(x, 1.5)], -1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    albedo = np.stack([0.3 + 0.6 * x, 0.8 - 0.5 * y, 0.4 + 0.3 * np.sin(9 * x * y)], -1)
    shading = np.maximum(np.einsum("id,hwd->ihw", make_pattern("uniform", n_light), normals), 0.0)
    noise = 0.01 * np.random.default_rng(5).standard_normal((n_light, height, width, 3))
    return np.rint(255 * np.clip(shading[..., None] * albedo + noise, 0, 1)).astype(np.uint8)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("photographs")
    names = [f"IMG_{i:02}.png" for i in range(LIGHTS)]
    for name, image in zip(names, codes(), strict=True):
        write_image(place / name, image)
    lines = [f"{n} {x} {y} {z}" for n, (x, y, z) in zip(names, make_pattern("uniform", LIGHTS), strict=True)]
    (place / "dome.lp").write_text("\n".join([str(LIGHTS), *lines]))
    return place


@pytest.fixture(scope="module")
def stack(folder, tmp_path_factory):
    path = tmp_path_factory.mktemp("stack") / "stack.h5"
    succeed("ingest", folder, path)
    return path


def payload(path):
    return cr.read_encoded(path)[0].to_bytes()


@pytest.mark.parametrize("size", [("--rate", 0.5), ("--bytes", "9k")])
def test_it_is_ingest_fit_and_encode(folder, stack, tmp_path, size):
    asked = ("--method", "spline", "--degree", 3, "--holdout", 5)
    told = succeed("pack", folder, tmp_path / "p.h5", *asked, *size, "--json").json
    succeed("fit", stack, tmp_path / "f.h5", *asked, "--no-measure", "--json")
    succeed("encode", tmp_path / "f.h5", tmp_path / "e.h5", "--codec", "klt", *size, "--json")
    assert payload(tmp_path / "p.h5") == payload(tmp_path / "e.h5")
    apart = succeed("psnr", tmp_path / "p.h5", stack, "--json").json["psnr"]
    assert told["psnr"] == pytest.approx(apart, rel=1e-4)
    assert (told["method"], told["degree"], told["n_light"], told["n_holdout"]) == ("spline", 3, 24, 6)
    assert told["bytes_on_disk"] == os.stat(tmp_path / "p.h5").st_size
    assert told["peak_memory"] > 1 << 20
    assert sorted(os.listdir(tmp_path)) == ["e.h5", "f.h5", "p.h5"]


def test_without_a_map_it_is_nearly_the_same(stack, tmp_path, device):
    whole = cr.pack(stack, tmp_path / "a.h5", method="spline", degree=3, rate=0.5)
    streamed = cr.pack(stack, tmp_path / "b.h5", method="spline", degree=3, rate=0.5, memory="300k")
    assert "fit" in whole.seconds
    assert "fit" not in streamed.seconds
    assert streamed.psnr["pooled_fitted"] == pytest.approx(whole.psnr["pooled_fitted"], abs=0.05)
    assert streamed.facts["encoded_bytes"] == pytest.approx(whole.facts["encoded_bytes"], rel=0.03)
    fitted_khwc = cr.fit(stack, method="spline", degree=3).coeffs_khwc
    lost = [rms(decode(cr.read_encoded(tmp_path / f"{n}.h5")[0], device) - fitted_khwc) for n in "ab"]
    assert lost[1] == pytest.approx(lost[0], rel=0.05)


def rms(values):
    return np.sqrt(np.square(values, dtype=np.float64).mean())


@pytest.mark.parametrize("method", ["spline", "cls", "ceb", "spectrum"])
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_methods_and_curves_without_a_map(tmp_path, method, transfer):
    mask = np.ones((HEIGHT, WIDTH), bool)
    mask[:9, :7] = False
    stack = LightStack(codes(), make_pattern("uniform", LIGHTS), 255.0, transfer, mask_hw=mask)
    whole = cr.pack(stack, tmp_path / "a.h5", method=method, degree=3, rate=0.5)
    streamed = cr.pack(stack, tmp_path / "b.h5", method=method, degree=3, rate=0.5, memory="300k")
    assert "fit" not in streamed.seconds
    assert streamed.psnr["pooled_fitted"] == pytest.approx(whole.psnr["pooled_fitted"], abs=0.1)


@pytest.mark.parametrize("budget", [4000, 9001, 20000])
def test_a_file_has_no_more_bytes_than_asked_for(stack, tmp_path, budget):
    cr.pack(stack, tmp_path / "p.h5", method="spline", degree=3, bytes=budget, measure="none")
    assert 0.97 * budget <= os.stat(tmp_path / "p.h5").st_size <= budget


def test_a_quality_is_met(stack, tmp_path):
    report = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=3, holdout=5, target_psnr=26)
    assert 26 <= report.psnr["pooled_holdout"] <= 26.4
    least = report.facts["bytes_on_disk"]
    better = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=3, holdout=5, target_psnr=28)
    assert 28 <= better.psnr["pooled_holdout"] <= 28.4
    assert least < better.facts["bytes_on_disk"]


def test_pieces_of_a_narrow_image_are_all_its_own(tmp_path, monkeypatch):
    monkeypatch.setattr(parts_module, "_WINDOW", 64)
    monkeypatch.setattr(packing, "_MOSAIC_VALUES", 16 * 3 * 20 * 32 * 6)
    stack = LightStack(codes(700, 20), make_pattern("uniform", LIGHTS), 255.0)
    prepared = prepare_fit(stack, "spline", 3)
    with scratch_workspace(tmp_path, 1 << 20) as workspace, fitted_source(prepared, workspace) as source:
        split = (np.arange(LIGHTS), np.arange(0))
        job = packing.Pack(stack, split, prepared, packing.Size(), "radiance", workspace, Report(), None)
        fitted, mosaic = job._mosaic(source)
    windows = sample_windows(stack, 20 * 32 * 6)
    assert len(windows) > 3
    expected = np.concatenate([stack.images_ihwc[:, w.top : w.bottom, w.left : w.right] for w in windows], axis=2)
    np.testing.assert_array_equal(mosaic.images_ihwc, expected)
    assert fitted.image_shape == mosaic.image_shape


def test_coding_costs_what_it_may(stack, tmp_path):
    best = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=3, rate=8.0)
    report = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=3, loss=1.0)
    assert report.psnr["mean_fitted"] == pytest.approx(best.psnr["mean_fitted"] - 1.0, abs=0.4)


def test_default_size_is_a_byte_a_pixel(tmp_path):
    stack = LightStack(codes(160, 160), make_pattern("uniform", LIGHTS), 255.0)
    report = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=3, measure="none")
    assert 0.95 * 160 * 160 <= report.facts["bytes_on_disk"] <= 160 * 160


def test_photographs_may_be_kept(folder, stack, tmp_path):
    succeed("pack", folder, tmp_path / "p.h5", "--keep-stack", tmp_path / "s.h5", "--degree", 2, "--json")
    with open_stack(tmp_path / "s.h5") as kept, open_stack(stack) as expected:
        np.testing.assert_array_equal(kept.images_ihwc[...], expected.images_ihwc[...])


@pytest.mark.parametrize("kept", [False, True])
def test_headers_are_read_once(folder, tmp_path, monkeypatch, kept):
    read, calls = folder_module.read_headers, []
    monkeypatch.setattr(folder_module, "read_headers", lambda *asked: calls.append(1) or read(*asked))
    keep = {"keep_stack": tmp_path / "s.h5"} if kept else {}
    report = cr.pack(folder, tmp_path / "p.h5", method="uls", degree=1, measure="none", **keep)
    assert len(calls) == 1
    assert report.seconds["ingest"] > 0
    assert (tmp_path / "s.h5").exists() == kept


def test_photographs_come_back(folder, tmp_path):
    succeed("pack", folder, tmp_path / "p.h5", "--degree", 3, "--rate", 2, "--json")
    told = succeed("unpack", tmp_path / "p.h5", tmp_path / "back", "--format", "png", "--json").json
    assert len(told["files"]) == LIGHTS + 1
    found = np.stack([oiio.ImageBuf(name).get_pixels(oiio.UINT8) for name in told["files"][:-1]]).astype(float)
    assert np.abs(found - codes()).mean() < 4
    again = succeed("pack", tmp_path / "back", tmp_path / "q.h5", "--degree", 3, "--rate", 2, "--json").json
    assert again["n_light"] == LIGHTS
    assert again["psnr"]["pooled_fitted"] > 38


def test_other_lights_and_radiance(folder, tmp_path):
    (tmp_path / "two.lp").write_text("2\na 0 0 1\nb 0.6 0 0.8\n")
    succeed("pack", folder, tmp_path / "p.h5", "--degree", 3, "--rate", 2, "--json")
    told = succeed(
        "unpack", tmp_path / "p.h5", tmp_path / "o", "--lights", tmp_path / "two.lp", "--format", "exr", "--json"
    )
    names = told.json["files"]
    assert [os.path.basename(name) for name in names] == ["light_000.exr", "light_001.exr", "lights.lp"]
    expected = cr.relight(tmp_path / "p.h5", np.array([[0, 0, 1], [0.6, 0, 0.8]]))
    found = np.stack([oiio.ImageBuf(name).get_pixels() for name in names[:2]])
    np.testing.assert_allclose(found, expected, atol=2e-6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["STACK", "OUT", "--rate", 1, "--bytes", "9k"], "give one of --rate, --bytes, --target-psnr and --loss"),
        (["STACK", "OUT", "--rate", -1], "must be a positive number, got -1.0"),
        (["STACK", "OUT", "--bytes", "500"], "a file of these lights and this size takes at least .* bytes, got 500"),
        (["STACK", "OUT", "--transfer", "srgb"], "transfer: for a folder of photographs, not for a stack"),
        (["STACK", "OUT", "--keep-stack", "OTHER"], "keep_stack: for a folder of photographs, not for a stack"),
        (["STACK", "STACK"], "that is the input"),
        (["NOTHING", "OUT"], "there is no file or folder"),
        (["NOTHING", "OUT", "--lights", "dome.lp", "--transfer", "srgb"], "there is no file or folder"),
        (["STACK", "OUT", "--target-psnr", 90], "the target is 90 dB"),
        (["STACK", "OUT", "--method", "magic"], "magic"),
        (["FOLDER", "OUT", "--crop", "0,0,999,9"], "not within the images"),
        (["FOLDER", "OUT", "--keep-stack", "OUT"], "OUT"),
    ],
)
def test_what_makes_no_sense_is_one_line(folder, stack, tmp_path, words, message):
    names = {"STACK": stack, "OUT": tmp_path / "OUT", "OTHER": tmp_path / "OTHER", "NOTHING": tmp_path / "n.h5"}
    ended = call("pack", *(({**names, "FOLDER": folder}).get(word, word) for word in words))
    assert (ended.code, ended.out) == (2, ""), ended
    *notes, line = ended.err.splitlines()
    assert all(note.startswith("note: ") for note in notes)
    assert re.search(message, line)
    assert os.listdir(tmp_path) == []


def test_only_parts_are_unpacked(stack, tmp_path):
    succeed("fit", stack, tmp_path / "f.h5", "--degree", 2, "--no-measure", "--json")
    succeed("encode", tmp_path / "f.h5", tmp_path / "e.h5", "--codec", "half", "--json")
    ended = call("unpack", tmp_path / "e.h5", tmp_path / "o")
    assert (ended.code, "only files of codec klt" in ended.err) == (2, True)
    with pytest.raises(InputError, match="--transfer is for 8-bit files"):
        cr.unpack(tmp_path / "e.h5", tmp_path / "o", kind="exr", transfer="srgb")
    assert not (tmp_path / "o").exists()


@pytest.fixture(scope="module")
def large(tmp_path_factory):
    """An encoding of an image of several tiles, and its stack."""
    directions = make_pattern("uniform", 12)
    images = np.tile(codes(200, 260, 12), (1, 3, 3, 1))
    stack = LightStack(images, directions, 255.0, mask_hw=np.arange(600 * 780).reshape(600, 780) % 7 > 0)
    path = tmp_path_factory.mktemp("large") / "p.h5"
    cr.pack(stack, path, method="spline", degree=2, rate=0.3, measure="none", holdout=4)
    return path, stack


def test_parts_together_are_the_whole(large, device, monkeypatch):
    path, stack = large
    monkeypatch.setattr(parts_module, "TILE_BYTES", 1 << 20)
    encoded, record = cr.read_encoded(path)
    split = (np.arange(12)[np.arange(12) % 4 != 3], np.arange(12)[np.arange(12) % 4 == 3])
    found = measure_parts(decode_regions(encoded), record, stack, split, device, sampled=False)
    expected = cr.measure(path, stack)
    assert found == pytest.approx(expected, rel=1e-5)
    assert "sampled" not in found


def test_a_sample_is_near_and_says_how_near(large, device, monkeypatch):
    path, stack = large
    monkeypatch.setattr(parts_module, "_WINDOW", 64)
    encoded, record = cr.read_encoded(path)
    split = (np.arange(12), np.arange(0))
    found = measure_parts(decode_regions(encoded), record, stack, split, device, sampled=True)
    exact = measure_parts(decode_regions(encoded), record, stack, split, device, sampled=False)
    assert 0.1 < found["sampled"] < 0.5
    assert 0.0 < found["error_fitted"] < 1.0
    assert abs(found["pooled_fitted"] - exact["pooled_fitted"]) < 4 * found["error_fitted"]


@pytest.mark.parametrize("most", [1, 5000, 100_000, 2_000_000, 10**9])
@pytest.mark.parametrize("shape", [(1, 1), (3, 4000), (1000, 1000), (4000, 6000), (4097, 255)])
def test_windows_lie_apart_in_the_image(shape, most):
    stack = LightStack(np.broadcast_to(np.uint8(0), (1, *shape, 3)), [[0, 0, 1.0]], 255.0)
    windows = sample_windows(stack, most)
    assert windows
    seen = np.zeros(shape, np.uint8)
    for window in windows:
        assert isinstance(window, Region)
        assert min(window.shape) > 0
        seen[window.top : window.bottom, window.left : window.right] += 1
    assert seen.max() == 1
    assert sum(w.shape[0] * w.shape[1] for w in windows) == seen.sum()


def test_a_large_image_is_the_same_in_memory_and_in_chunks(tmp_path, device):
    """Of several tiles, at the usual memory: photographs are read ahead while the device makes planes of others."""
    directions = make_pattern("uniform", 8)
    images = np.tile(codes(300, 390, 8), (1, 2, 3, 1))
    images += np.random.default_rng(0).integers(0, 9, images.shape, np.uint8)
    stack = LightStack(images, directions, 300.0, "srgb")
    write_stack(tmp_path / "s.h5", stack)
    with open_stack(tmp_path / "s.h5") as stored:
        kept = [
            cr.pack(each, tmp_path / f"{n}.h5", method="spline", degree=4, rate=0.1, measure="none")
            for n, each in enumerate([stack, stored])
        ]
    assert "fit" not in kept[0].seconds
    assert payload(tmp_path / "0.h5") == payload(tmp_path / "1.h5")


@pytest.mark.parametrize("name", ["IMG_03.png", "dome.lp", "mask.png"])
@pytest.mark.parametrize("kept", [False, True])
def test_no_photograph_light_or_mask_is_written_over(folder, tmp_path, name, kept):
    place = tmp_path / "photos"
    shutil.copytree(folder, place)
    write_image(tmp_path / "mask.png", np.full((HEIGHT, WIDTH, 1), 255, np.uint8))
    target = (tmp_path if name == "mask.png" else place) / name
    before = target.read_bytes()
    words = ["--mask", tmp_path / "mask.png", *(["--keep-stack", tmp_path / "kept.h5"] if kept else [])]
    ended = call("pack", place, target, *words, "--degree", 2)
    assert (ended.code, "that is the input" in ended.err) == (2, True), ended
    assert target.read_bytes() == before
    assert not (tmp_path / "kept.h5").exists()


@pytest.mark.parametrize("size", [{"loss": 0.5}, {"target_psnr": 30.0}, {"rate": 0.5}])
def test_a_mask_that_leaves_a_corner_is_measured_there(tmp_path, monkeypatch, size):
    monkeypatch.setattr(parts_module, "_WINDOW", 32)
    monkeypatch.setattr(packing, "SAMPLED_FROM", 0)
    monkeypatch.setattr(packing, "_MOSAIC_VALUES", 27 * 32 * 32 * 4)
    mask = np.zeros((300, 400), bool)
    mask[-3:, -2:] = True
    stack = LightStack(codes(300, 400), make_pattern("uniform", LIGHTS), 255.0, mask_hw=mask)
    report = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=2, **size)
    assert np.isfinite(report.psnr["pooled_fitted"])
    assert report.psnr["sampled"] == 1.0


def test_a_quality_that_is_passed_at_the_coarsest_step(tmp_path):
    white = LightStack(np.full((LIGHTS, 20, 24, 3), 255, np.uint8), make_pattern("uniform", LIGHTS), 255.0)
    report = cr.pack(white, tmp_path / "p.h5", method="spline", degree=2, target_psnr=40)
    assert report.psnr["pooled_fitted"] >= 40
    stack = LightStack(codes(), make_pattern("uniform", LIGHTS), 255.0)
    report = cr.pack(stack, tmp_path / "p.h5", method="spline", degree=2, target_psnr=1)
    assert report.psnr["pooled_fitted"] >= 1
    assert any("is the nearest to 1 dB" in note for note in report.notes)


def test_a_sample_that_is_no_radiance_is_named(tmp_path):
    images = make_samples(make_pattern("uniform", 20), (30, 40, 3)).astype(np.float32)
    images[7, 21, 33, 1] = np.nan
    write_stack(tmp_path / "s.h5", LightStack(images, make_pattern("uniform", 20), 1.0))
    ended = call("pack", tmp_path / "s.h5", tmp_path / "p.h5", "--method", "spline", "--degree", 2, "--memory", "200k")
    assert ended.code == 2
    assert "image 7 is nan at row 21, column 33, channel 1" in ended.err


@pytest.mark.parametrize("channel", [1, 3])
def test_the_least_bytes_that_are_told_are_enough(tmp_path, channel):
    stack = LightStack(make_samples(make_pattern("uniform", 20), (6, 7, channel)), make_pattern("uniform", 20), 1.0)
    fitted = cr.fit(stack, "cls", 1, measure=False, report=cr.Report())
    with pytest.raises(InputError, match="takes at least") as refused:
        cr.encode(fitted, "klt", out=tmp_path / "e.h5", bytes=100, report=cr.Report())
    least = int(re.search(r"at least (\d+)", str(refused.value))[1])
    cr.encode(fitted, "klt", out=tmp_path / "e.h5", bytes=least, report=cr.Report())
    assert os.path.getsize(tmp_path / "e.h5") <= least


def refuse_reading(monkeypatch):
    """Let no photograph be read."""

    def read(*arguments, **options):
        raise AssertionError("a photograph was read")

    monkeypatch.setattr("clrelight.images.read_rows", read)
    monkeypatch.setattr(LightStack, "load_rows", read)


@pytest.mark.parametrize("way", ["folder", "stack", "keep"])
@pytest.mark.parametrize("degree", [(), ("--degree", 3, "--method", "cls")])
def test_too_few_bytes_are_refused_before_a_photograph_is_read(folder, stack, tmp_path, monkeypatch, way, degree):
    refuse_reading(monkeypatch)
    source = stack if way == "stack" else folder
    kept = ("--keep-stack", tmp_path / "kept.h5") if way == "keep" else ()
    ended = call("pack", source, tmp_path / "o.h5", "--bytes", 800, *degree, *kept)
    assert ended.code == 2
    said = re.search(r"takes at least (\d+) bytes, got 800\n$", ended.err)
    assert said, ended.err
    assert 800 < int(said[1]) < 1200
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("way", ["folder", "stack", "keep"])
def test_lights_that_are_too_few_are_said_before_a_photograph_is_read(folder, stack, tmp_path, monkeypatch, way):
    refuse_reading(monkeypatch)
    kept = ("--keep-stack", tmp_path / "kept.h5") if way == "keep" else ()
    source = stack if way == "stack" else folder
    ended = call("pack", source, tmp_path / "o.h5", "--method", "uls", "--degree", 20, "--holdout", 5, *kept)
    assert ended.code == 2
    assert "uls at degree 20 has 441 coefficients but there are" in ended.err
    assert os.listdir(tmp_path) == []


def test_a_full_disk_is_said_of_a_folder(folder, tmp_path, monkeypatch):
    def full(descriptor, at, count):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("clrelight.durable.os.posix_fallocate", full)
    ended = call("pack", folder, tmp_path / "o.h5", "--degree", 1, "--method", "cls")
    said = f"clrelight: cannot write temporary files in {tmp_path}: the disk is full"
    assert (ended.code, ended.err.splitlines()[-1]) == (2, said)
    assert os.listdir(tmp_path) == []


def test_a_full_disk_of_unpack_too(stack, tmp_path, monkeypatch):
    call("pack", stack, tmp_path / "p.h5", "--degree", 1, "--method", "cls", "--measure", "none")
    monkeypatch.setattr(
        "clrelight.durable.os.posix_fallocate", lambda *arguments: (_ for _ in ()).throw(OSError(28, ""))
    )
    ended = call("unpack", tmp_path / "p.h5", tmp_path / "again")
    said = f"clrelight: cannot write temporary files in {tmp_path}: the disk is full"
    assert (ended.code, ended.err.splitlines()[-1]) == (2, said)
    assert os.listdir(tmp_path) == ["p.h5"]


def test_grey_pictures_do_not_go_to_hdr(tmp_path, monkeypatch):
    grey = LightStack(codes()[..., :1], make_pattern("uniform", LIGHTS), 255.0)
    cr.pack(grey, tmp_path / "p.h5", method="cls", degree=1, rate=1.0, measure="none")
    monkeypatch.setattr("clrelight.jobs.unpack._Unpack.run", lambda *arguments: pytest.fail("it was relit"))
    ended = call("unpack", tmp_path / "p.h5", tmp_path / "again", "--format", "hdr")
    said = "clrelight: hdr holds 3 channels, the images have 1: jpg, png, tif and exr can hold them\n"
    assert (ended.code, ended.err) == (2, said)
    assert os.listdir(tmp_path) == ["p.h5"]


def test_a_light_file_that_is_not_there_is_refused_before_drivers_are_tested(tmp_path, monkeypatch):
    (tmp_path / "photos").mkdir()
    for number in range(3):
        oiio.ImageBuf(np.full((4, 5, 3), 9 * number, np.uint8)).write(str(tmp_path / "photos" / f"{number}.png"))
    monkeypatch.setattr("clrelight.jobs.pack.opened_on", None)
    with pytest.raises(cr.InputError, match="there is no light file"):
        cr.pack(tmp_path / "photos", tmp_path / "view.h5", lights=tmp_path / "no.lp")
    assert not (tmp_path / "view.h5").exists()
