"""Exported textures, read by OpenImageIO and put together again by what the notes beside them say."""

import json
import os
import resource
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight.codec import Bc6h, codec_class, decode, encode
from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.export import export_textures
from clrelight.store import write_encoded, write_fit
from tests.commands import call, contents, succeed
from tests.reference.basis import real_harmonics

LIGHTS = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.48, 0.36, 0.8]])


def make_map(shape=(9, 11, 14, 3), size=1.0):
    rng = np.random.default_rng(0)
    k, h, w, c = np.indices(shape)
    smooth = np.sin(0.3 * h + 0.2 * w * (1 + c) + k) / (1 + k)
    coeffs = (size * (smooth + 0.02 * rng.standard_normal(shape))).astype(np.float32)
    degree = int(np.sqrt(shape[0])) - 1
    return CoefficientMap(coeffs, degree, "cls", 255.0, "srgb", LIGHTS, {}, name="made")


def read(path):
    image = oiio.ImageInput.open(str(path))
    assert image is not None, oiio.geterror()
    return image.read_image(oiio.FLOAT), str(image.spec().format)


def assemble(folder, notes):
    """Return the (k, h, w, c) values that the notes find in the textures of a folder, times their scale."""
    values = np.full([notes[name] for name in ("n_coeff", "height", "width", "channels")], np.nan)
    for texture in notes["textures"]:
        texels, _ = read(folder / texture["file"])
        texels = texels.reshape(*values.shape[1:3], -1)
        assert len(texture["planes"]) <= texels.shape[2]
        for component, (k, c) in enumerate(texture["planes"]):
            assert np.isnan(values[k, :, :, c]).all()
            values[k, :, :, c] = texels[..., component]
    return notes["scale"] * values


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (3, 4), (5, 3), (8, 8), (9, 31), (13, 17)])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_a_folder_of_dds_textures_holds_what_bc6h_decodes_to(device, tmp_path, channels, size):
    made = make_map((9, *size, channels))
    files = export_textures(made, tmp_path / "t", device=device)
    assert sorted(files) == sorted((tmp_path / "t").iterdir())
    assert len(files) == 1 + -(-9 * channels // 3)
    notes = json.loads((tmp_path / "t" / "textures.json").read_text())
    ours = decode(encode(made.coeffs_khwc, Bc6h(), device), device)
    np.testing.assert_array_equal(assemble(tmp_path / "t", notes), ours)
    assert notes["component"] == "BC6H_SF16"
    assert (notes["degree"], notes["peak"], notes["transfer"], notes["scale"]) == (2, 255.0, "srgb", 1.0)


def test_the_notes_alone_relight_as_the_program_does(device, tmp_path):
    from clrelight.relight import relight

    made = make_map()
    export_textures(made, tmp_path / "t", "exr", device=device)
    notes = json.loads((tmp_path / "t" / "textures.json").read_text())
    images = np.einsum("ik,khwc->ihwc", real_harmonics(LIGHTS, notes["degree"]), assemble(tmp_path / "t", notes))
    np.testing.assert_allclose(images, relight(made, LIGHTS, device=device), atol=1e-5)


def test_a_texture_array_holds_the_layers_in_the_order_of_its_notes(device, tmp_path):
    made = make_map()
    export_textures(made, tmp_path / "t", device=device)
    files = export_textures(made, tmp_path / "a.dds", device=device)
    assert files == [tmp_path / "a.dds", tmp_path / "a.dds.json"]
    array, notes = files[0].read_bytes(), json.loads(files[1].read_text())
    # Height and width, then DXGI format, two-dimensional, no flag, layers, of Microsoft's header.
    assert np.frombuffer(array, "<u4", 2, 12).tolist() == [11, 14]
    assert np.frombuffer(array, "<u4", 5, 128).tolist() == [96, 3, 0, 9, 0]
    alone = json.loads((tmp_path / "t" / "textures.json").read_text())["textures"]
    size = 16 * 3 * 4
    for texture, layer in zip(alone, notes["textures"], strict=True):
        assert (layer["file"], layer["planes"]) == ("a.dds", texture["planes"])
        start = 148 + size * layer["layer"]
        assert array[start : start + size] == (tmp_path / "t" / texture["file"]).read_bytes()[148:]
    assert len(array) == 148 + 9 * size


@pytest.mark.parametrize(("file_format", "dtype"), [("exr", "float32"), ("exr-half", "float16")])
@pytest.mark.parametrize("channels", [1, 2, 3])
def test_exr_textures_hold_the_values_themselves(device, tmp_path, file_format, dtype, channels):
    made = make_map((4, 5, 6, channels))
    files = export_textures(made, tmp_path / "t", file_format, device=device)
    assert len(files) == 1 + (8 if channels == 2 else 4)
    assert read(files[0])[1] == {"float32": "float", "float16": "half"}[dtype]
    notes = json.loads(files[-1].read_text())
    np.testing.assert_array_equal(assemble(tmp_path / "t", notes), made.coeffs_khwc.astype(dtype))


@pytest.mark.parametrize("file_format", ["dds", "exr", "exr-half"])
def test_there_may_be_more_textures_than_open_files(device, tmp_path, file_format):
    made = make_map((225, 5, 6, 3))
    export_textures(made, tmp_path / "usual", file_format, device=device)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = max(map(int, os.listdir("/proc/self/fd"))) + 150
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, limits[1]))
    try:
        files = export_textures(made, tmp_path / "few", file_format, device=device)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert len(files) == 226
    assert contents(tmp_path / "few") == contents(tmp_path / "usual")
    values = {"exr": np.float32, "exr-half": np.float16}
    is_dds = file_format == "dds"
    expected = decode(encode(made.coeffs_khwc, Bc6h(), device), device) if is_dds else made.coeffs_khwc
    expected = expected.astype(values.get(file_format, np.float32))
    np.testing.assert_array_equal(assemble(tmp_path / "few", json.loads(files[-1].read_text())), expected)


@pytest.mark.parametrize("size", [1e-12, 1e-3, 1e6, 1e30])
@pytest.mark.parametrize("file_format", ["dds", "exr", "exr-half"])
def test_coefficients_of_any_size_fit_by_a_power_of_two(device, tmp_path, size, file_format):
    errors = []
    for folder, made in (("usual", make_map()), ("unusual", make_map(size=size))):
        files = export_textures(made, tmp_path / folder, file_format, device=device)
        notes = json.loads(files[-1].read_text())
        difference = assemble(tmp_path / folder, notes) - made.coeffs_khwc
        errors.append(np.sqrt(np.mean((difference / np.abs(made.coeffs_khwc).max()) ** 2)))
    assert np.log2(notes["scale"]) % 1 == 0
    assert (notes["scale"] == 1.0) == (file_format == "exr")
    # A format's own error, relative to the largest coefficient, whatever that is.
    assert errors[1] <= 1.2 * errors[0] < {"dds": 0.1, "exr-half": 2.0**-12, "exr": 1e-9}[file_format]


def test_blocks_of_an_encoding_are_passed_on(device, tmp_path):
    made = make_map()
    encoded = encode(made.coeffs_khwc, Bc6h(), device)
    write_encoded(tmp_path / "enc.h5", encoded, made)
    succeed("export", tmp_path / "enc.h5", tmp_path / "a.dds")
    assert (tmp_path / "a.dds").read_bytes()[148:] == encoded.body


def test_the_command_takes_fits_and_encodings(device, tmp_path):
    made = make_map()
    write_fit(tmp_path / "fit.h5", made)
    write_encoded(tmp_path / "enc.h5", encode(made.coeffs_khwc, codec_class("half")(), device), made)
    for source in ("fit.h5", "enc.h5"):
        out = tmp_path / source.replace(".h5", "")
        out.mkdir()  # an empty folder is as good as none
        told = succeed("export", tmp_path / source, out, "--format", "exr-half", "--json").json
        assert told["files"] == [str(file) for file in sorted(out.iterdir())]
        assert told["bytes"] == sum(file.stat().st_size for file in out.iterdir())
    notes = [(tmp_path / name / "textures.json").read_text() for name in ("fit", "enc")]
    assert notes[0] == notes[1]
    values = [assemble(tmp_path / name, json.loads(notes[0])) for name in ("fit", "enc")]
    np.testing.assert_array_equal(*values)
    assert "textures.json" in succeed("export", tmp_path / "fit.h5", tmp_path / "shown").out


def test_a_folder_is_flushed_before_it_stands_and_open_to_whom_the_umask_says(device, tmp_path, monkeypatch):
    # What another program with this one's number left behind is none of our business.
    stranger = tmp_path / f".t.{os.getpid()}.part"
    stranger.mkdir()
    (stranger / "precious").write_text("kept")
    (tmp_path / "plain").mkdir()
    flushed, sync, replace = set(), os.fsync, os.replace

    def fsync(descriptor):
        flushed.add(Path(f"/proc/self/fd/{descriptor}").resolve().stat().st_ino)
        sync(descriptor)

    def move(source, target):
        if Path(target) == tmp_path / "t":
            assert {path.stat().st_ino for path in (source, *source.iterdir())} <= flushed
        replace(source, target)

    monkeypatch.setattr(os, "fsync", fsync)
    monkeypatch.setattr(os, "replace", move)
    files = export_textures(make_map((4, 5, 6, 3)), tmp_path / "t", device=device)
    assert len(files) == 5
    assert sorted(path.name for path in tmp_path.iterdir()) == [stranger.name, "plain", "t"]
    assert (stranger / "precious").read_text() == "kept"
    assert (tmp_path / "t").stat().st_mode == (tmp_path / "plain").stat().st_mode


@pytest.mark.parametrize("file_format", ["dds", "exr"])
def test_an_export_that_fails_leaves_nothing(device, tmp_path, file_format):
    def fail(done, total):
        if done:
            assert len(list(tmp_path.iterdir())) == 1
            raise OSError(28, "No space left on device")

    with pytest.raises(InputError, match="the disk is full"):
        export_textures(make_map((4, 5, 6, 3)), tmp_path / "t", file_format, device=device, progress=fail)
    assert list(tmp_path.iterdir()) == []


REFUSED = [
    ("@nowhere.h5 @t", "there is no file"),
    ("@text.h5 @t", "text.h5 is not an HDF5 file"),
    ("@fit.h5 @full", "is no empty folder"),
    ("@fit.h5 @fit.h5", "is no empty folder"),
    ("@fit.h5 @no/t", "there is no folder"),
    ("@fit.h5 @no/t.dds", "there is no folder"),
    ("@fit.h5 @t.dds --format exr", "a texture array is a DDS file"),
    ("@fit.h5 @t --format png", "'png' is not one of 'dds', 'exr', 'exr-half'"),
    ("@fit.h5 @folder.dds", "is no regular file"),
    ("@fit.h5", "Missing argument"),
]


@pytest.mark.parametrize(("line", "expected"), REFUSED, ids=[line for line, _ in REFUSED])
def test_bad_input_writes_nothing(tmp_path, line, expected):
    write_fit(tmp_path / "fit.h5", make_map((4, 5, 6, 3)))
    (tmp_path / "text.h5").write_text("not HDF5")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").write_text("kept")
    (tmp_path / "folder.dds").mkdir()
    before = contents(tmp_path)
    ended = call("export", *(tmp_path / word[1:] if word.startswith("@") else word for word in line.split()))
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.count("\n") == 1
    assert expected in ended.err
    assert contents(tmp_path) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fit.h5", "folder.dds", "full", "text.h5"]
