import fcntl
import os
import struct
import subprocess
import sys
import zlib
from contextlib import closing

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from clrelight import image_encoding, images
from clrelight.errors import InputError, KernelBuildError
from clrelight.image_encoding import png_rows
from clrelight.images import read_bands, read_header, read_image, write_image
from tests.commands import contents, environment

RNG = np.random.default_rng(7)
RGB8 = RNG.integers(0, 256, (37, 23, 3), dtype=np.uint8)
COLOR_TYPE = {1: 0, 2: 4, 3: 2, 4: 6}


def png_chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_bytes(values_hwc, extra=b""):
    """Return a PNG of 8 or 16 bit made by hand, with no filter."""
    height, width, channel = values_hwc.shape
    bits = 8 * values_hwc.dtype.itemsize
    rows = b"".join(b"\0" + row.astype(row.dtype.newbyteorder(">")).tobytes() for row in values_hwc)
    header = struct.pack(">IIBBBBB", width, height, bits, COLOR_TYPE[channel], 0, 0, 0)
    chunks = png_chunk(b"IHDR", header) + extra + png_chunk(b"IDAT", zlib.compress(rows)) + png_chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


def exr_bytes(planes, origin=(0, 0), display=None):
    """Return an uncompressed OpenEXR file made by hand from {channel name: (height, width) array}."""
    kinds = {"uint32": 0, "float16": 1, "float32": 2}
    planes = dict(sorted(planes.items()))
    height, width = next(iter(planes.values())).shape
    box = (*origin, origin[0] + width - 1, origin[1] + height - 1)

    def attribute(name, kind, content):
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(content)) + content

    channels = b"".join(
        name.encode() + b"\0" + struct.pack("<iB3xii", kinds[plane.dtype.name], 0, 1, 1)
        for name, plane in planes.items()
    )
    head = struct.pack("<II", 20000630, 2)
    head += attribute("channels", "chlist", channels + b"\0")
    head += attribute("compression", "compression", b"\0")
    head += attribute("dataWindow", "box2i", struct.pack("<4i", *box))
    head += attribute("displayWindow", "box2i", struct.pack("<4i", *(display or box)))
    head += attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    head += attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    lines = [b"".join(plane[y].tobytes() for plane in planes.values()) for y in range(height)]
    first = len(head) + 8 * height
    offsets = b"".join(struct.pack("<Q", first + y * (8 + len(lines[0]))) for y in range(height))
    rows = b"".join(struct.pack("<ii", origin[1] + y, len(line)) + line for y, line in enumerate(lines))
    return head + offsets + rows


def oiio_write(path, values_hwc, **attributes):
    kind = {"uint8": oiio.UINT8, "float32": oiio.FLOAT, "float64": oiio.DOUBLE}[values_hwc.dtype.name]
    spec = oiio.ImageSpec(values_hwc.shape[1], values_hwc.shape[0], values_hwc.shape[2], kind)
    for name, value in attributes.items():
        if hasattr(spec, name):
            setattr(spec, name, value)
        else:
            spec.attribute(name, value)
    writer = oiio.ImageOutput.create(str(path))
    assert writer.open(str(path), spec), writer.geterror()
    assert writer.write_image(values_hwc)
    assert writer.close()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channel", [1, 2, 3, 4])
def test_png_values_are_the_stored_ones(tmp_path, dtype, channel):
    values = RNG.integers(0, np.iinfo(dtype).max + 1, (5, 7, channel)).astype(dtype)
    if channel in (2, 4):
        values[..., -1] //= 3  # an alpha that would show if colours were multiplied by it
    (tmp_path / "a.png").write_bytes(png_bytes(values))
    found = read_image(tmp_path / "a.png")
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, values[..., : 1 if channel < 3 else 3])


@pytest.mark.parametrize("chunk", [(b"gAMA", struct.pack(">I", 100000)), (b"sRGB", b"\0"), (b"sBIT", b"\4\4\4")])
def test_hints_do_not_change_values(tmp_path, chunk):
    (tmp_path / "a.png").write_bytes(png_bytes(RGB8, png_chunk(*chunk)))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), RGB8)


@pytest.mark.parametrize("name", ["a.bmp", "a.tga", "a.tif", "a.ppm", "a.png"])
def test_rgb8_as_another_library_wrote_it(tmp_path, name):
    Image.fromarray(RGB8).save(tmp_path / name)
    found = read_image(tmp_path / name)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, RGB8)


@pytest.mark.parametrize("mode", ["tga", "tif"])
def test_alpha_is_dropped_and_not_multiplied(tmp_path, mode):
    rgba = np.concatenate([RGB8, RGB8[..., :1] // 2], axis=2)
    Image.fromarray(rgba).save(tmp_path / f"a.{mode}")
    np.testing.assert_array_equal(read_image(tmp_path / f"a.{mode}"), RGB8)


def test_jpeg_as_another_library_decodes_it(tmp_path):
    smooth = np.add.outer(np.arange(37) * 3, np.arange(23) * 4).astype(np.uint8)[..., None] // np.uint8([1, 2, 3])
    Image.fromarray(smooth).save(tmp_path / "a.jpg", quality=95, subsampling=0)
    with Image.open(tmp_path / "a.jpg") as file:
        expected = np.asarray(file).astype(int)
    assert np.abs(read_image(tmp_path / "a.jpg").astype(int) - expected).max() <= 1
    assert np.abs(read_image(tmp_path / "a.jpg").astype(int) - smooth).max() <= 16


def test_orientation_of_cameras_is_not_applied(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    for name in ("a.jpg", "a.png"):
        Image.fromarray(RGB8).save(tmp_path / name, exif=exif)
        assert read_header(tmp_path / name).camera_orientation == 6
        assert read_image(tmp_path / name).shape == RGB8.shape
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), RGB8)


def test_netpbm_by_hand(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5\n# gray\n3 2\n255\n" + bytes([0, 1, 2, 3, 4, 255]))
    (tmp_path / "b.pgm").write_bytes(b"P5\n2 1\n65535\n" + struct.pack(">2H", 258, 65535))
    (tmp_path / "c.ppm").write_bytes(b"P3\n1 2\n255\n1 2 3\n4 5 6\n")
    assert read_image(tmp_path / "a.pgm").tolist() == [[[0], [1], [2]], [[3], [4], [255]]]
    assert read_image(tmp_path / "b.pgm").tolist() == [[[258], [65535]]]
    assert read_image(tmp_path / "b.pgm").dtype == np.uint16
    assert read_image(tmp_path / "c.ppm").tolist() == [[[1, 2, 3]], [[4, 5, 6]]]


def test_float_tiff_and_radiance_hdr(tmp_path):
    gray = np.array([[0.5, -2.0], [1e-3, 7e4]], np.float32)
    Image.fromarray(gray).save(tmp_path / "a.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif")[..., 0], gray)
    # Ward's RGBE: mantissa * 2^(exponent - 136); rows shorter than 8 pixels are stored plain.
    rows = bytes([128, 64, 32, 129, 200, 100, 50, 136])
    (tmp_path / "a.hdr").write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + rows)
    found = read_image(tmp_path / "a.hdr")
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, [[[1.0, 0.5, 0.25], [200, 100, 50]]], rtol=0.5 / 50)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_by_hand(tmp_path, dtype):
    planes = {name: RNG.normal(size=(4, 5)).astype(dtype) for name in ("R", "G", "B", "A")}
    (tmp_path / "a.exr").write_bytes(exr_bytes(planes))
    found = read_image(tmp_path / "a.exr")
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.stack([planes[c] for c in "RGB"], axis=2))
    (tmp_path / "y.exr").write_bytes(exr_bytes({"Y": planes["G"]}))
    np.testing.assert_array_equal(read_image(tmp_path / "y.exr")[..., 0], planes["G"])


def test_exr_data_window_lies_in_the_display_window(tmp_path):
    planes = {name: RNG.normal(size=(4, 5)).astype(np.float16) for name in "RGB"}
    depth = {"Z": np.ones((4, 5), np.float32)}
    (tmp_path / "a.exr").write_bytes(exr_bytes(planes | depth, origin=(3, -2), display=(0, 0, 19, 9)))
    header = read_header(tmp_path / "a.exr")
    assert header.origin_xy == (3, -2)
    assert header.covers == (3, 0, 5, 2)
    assert (header.height, header.width, header.channels, header.dtype) == (10, 20, 3, np.float16)
    expected = np.zeros((10, 20, 3), np.float16)
    expected[:2, 3:8] = np.stack([planes[c][2:] for c in "RGB"], axis=2)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), expected)


def test_refused_channels_and_types_name_the_file(tmp_path):
    half, whole = np.ones((2, 2), np.float16), np.ones((2, 2), np.uint32)
    (tmp_path / "xyz.exr").write_bytes(exr_bytes(dict.fromkeys("XYZ", half)))
    (tmp_path / "layer.exr").write_bytes(exr_bytes(dict.fromkeys(("d.R", "d.G"), half)))
    (tmp_path / "ids.exr").write_bytes(exr_bytes(dict.fromkeys("RGB", whole)))
    (tmp_path / "mixed.exr").write_bytes(exr_bytes({"R": half, "G": whole, "B": half}))
    Image.new("CMYK", (4, 4)).save(tmp_path / "cmyk.jpg")
    Image.new("CMYK", (4, 4)).save(tmp_path / "cmyk.tif")
    Image.fromarray(np.arange(4, dtype=np.int32).reshape(2, 2)).save(tmp_path / "int.tif")
    oiio_write(tmp_path / "double.tif", np.ones((2, 2, 1)))
    expected = {"xyz.exr": "X, Y, Z", "layer.exr": "channels", "ids.exr": "uint", "mixed.exr": "half/uint"}
    expected |= {"cmyk.jpg": "CMYK", "cmyk.tif": "CMYK", "int.tif": "stores int", "double.tif": "stores double"}
    for name, part in expected.items():
        with pytest.raises(InputError, match=part) as error:
            read_header(tmp_path / name)
        assert name in str(error.value)
        assert "\n" not in str(error.value)


def write_all_formats(folder):
    Image.fromarray(RGB8).save(folder / "a.png")
    Image.fromarray(RGB8).save(folder / "a.jpg")
    Image.fromarray(RGB8).save(folder / "progressive.jpg", progressive=True)
    for name in ("a.bmp", "a.tga", "a.ppm"):
        Image.fromarray(RGB8).save(folder / name)
    oiio_write(folder / "a.hdr", RGB8.astype(np.float32))
    (folder / "plain.exr").write_bytes(exr_bytes({c: RGB8[..., i].astype(np.float16) for i, c in enumerate("RGB")}))
    oiio_write(folder / "zip.exr", RGB8.astype(np.float32), compression="zip")
    oiio_write(folder / "tiled.exr", RGB8.astype(np.float32), tile_width=16, tile_height=8)
    oiio_write(folder / "tiled.tif", RGB8, tile_width=16, tile_height=16)
    oiio_write(folder / "strips.tif", RGB8, **{"tiff:RowsPerStrip": 37})
    oiio_write(folder / "separate.tif", RGB8, planarconfig="separate")
    return sorted(p.name for p in folder.iterdir())


FORMATS = ["a.bmp", "a.hdr", "a.jpg", "a.png", "a.ppm", "a.tga", "plain.exr", "progressive.jpg"]
FORMATS += ["separate.tif", "strips.tif", "tiled.exr", "tiled.tif", "zip.exr"]


@pytest.fixture(scope="module")
def formats(tmp_path_factory):
    folder = tmp_path_factory.mktemp("formats")
    assert write_all_formats(folder) == FORMATS
    return folder


@pytest.mark.parametrize("name", FORMATS)
def test_bands_make_up_the_image(formats, name):
    header = read_header(formats / name)
    whole = read_image(formats / name)
    assert whole.shape == RGB8.shape
    if name.endswith(".jpg"):
        with Image.open(formats / name) as file:
            assert np.abs(whole.astype(int) - np.asarray(file)).mean() < 1
    elif name == "a.hdr":
        np.testing.assert_allclose(whole, RGB8, atol=2)  # 8 bit with an exponent per pixel
    else:
        np.testing.assert_array_equal(whole, RGB8)
    for rows in ((0, 37), (5, 30), (36, 37), (8, 9)):
        for band_bytes in (1, 3 * header.row_bytes, 17 * header.row_bytes):
            parts = list(read_bands(header, rows, band_bytes))
            limit = max(band_bytes, header.row_bytes * header.row_step)
            assert max(part.nbytes for _, part in parts) <= limit
            assert [row for row, _ in parts] == list(rows[0] + np.cumsum([0] + [len(p) for _, p in parts])[:-1])
            np.testing.assert_array_equal(np.concatenate([p for _, p in parts]), whole[slice(*rows)])


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("fraction", [0.1, 0.6, 0.97])
def test_truncated_files_are_refused(formats, tmp_path, capfd, name, fraction):
    content = (formats / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(len(content) * fraction)])
    with pytest.raises(InputError, match=name) as error:
        read_image(tmp_path / name)
    assert "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_a_path_may_be_bytes(tmp_path):
    name = os.fsencode(tmp_path / "a.png")
    write_image(name, RGB8)
    assert (read_image(name) == RGB8).all()
    os.rename(name, os.fsencode(tmp_path) + b"/\xe4.png")
    with pytest.raises(InputError, match="names in UTF-8"):
        read_header(os.fsencode(tmp_path) + b"/\xe4.png")


def test_files_that_are_no_images(tmp_path):
    (tmp_path / "empty.png").touch()
    (tmp_path / "junk.jpg").write_text("hello")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "bomb.png").write_bytes(png_bytes(RGB8).replace(struct.pack(">II", 23, 37), b"\0\1\0\0\0\1\0\0"))
    for name in ("empty.png", "junk.jpg", "folder.png", "bomb.png", "none.exr"):
        with pytest.raises(InputError, match=name):
            read_header(tmp_path / name)


def test_absurd_size_is_refused(formats, monkeypatch):
    monkeypatch.setattr(images, "MAX_PIXELS", 37 * 23 - 1)
    with pytest.raises(InputError, match="claims 23×37 pixels"):
        read_header(formats / "a.png")


def test_errors_do_not_reach_stderr_when_the_program_ends(tmp_path):
    (tmp_path / "junk.exr").write_text("hello")
    (tmp_path / "cut.tif").write_bytes(b"II*\0")
    program = """
import sys
from clrelight.images import read_image
for path in sys.argv[1:]:
    try: read_image(path)
    except ValueError: print("refused")
"""
    paths = [str(tmp_path / "junk.exr"), str(tmp_path / "cut.tif")]
    done = subprocess.run([sys.executable, "-c", program, *paths], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("refused\nrefused\n", "")


def test_file_that_changed_since_its_header(tmp_path):
    Image.fromarray(RGB8).save(tmp_path / "a.png")
    header = read_header(tmp_path / "a.png")
    Image.fromarray(RGB8[1:]).save(tmp_path / "a.png")
    with pytest.raises(InputError, match="changed"):
        list(read_bands(header))


@pytest.mark.parametrize(
    ("name", "dtype"),
    [
        *((f"a{ext}", np.uint8) for ext in (".png", ".tif", ".TIFF", ".bmp", ".tga", ".ppm")),
        *((f"a{ext}", np.uint16) for ext in (".png", ".tif", ".ppm")),
        *((f"a{ext}", np.float32) for ext in (".exr", ".tif")),
        *((f"a{ext}", np.float16) for ext in (".exr", ".tif")),
    ],
)
@pytest.mark.parametrize("channel", [1, 3])
def test_written_values_come_back(tmp_path, name, dtype, channel):
    values = (RNG.random((6, 9, channel)) * (np.iinfo(dtype).max if np.dtype(dtype).kind == "u" else 5)).astype(dtype)
    if channel == 1:
        name = name.replace(".ppm", ".pgm")
    write_image(tmp_path / name, values)
    assert os.listdir(tmp_path) == [name]
    found = read_image(tmp_path / name)
    np.testing.assert_array_equal(found.astype(np.float64), values.astype(np.float64))
    if dtype == np.uint8:
        with Image.open(tmp_path / name) as file:
            np.testing.assert_array_equal(np.asarray(file.convert("RGB"))[..., :channel], values)


WRITE = """
import os, resource, sys
import numpy as np
from clrelight.errors import InputError, KernelBuildError
from clrelight.images import write_image

values = np.random.default_rng(0).integers(1, 256, (40, 40, 3))
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)
for name in sys.argv[2:]:
    floats = name.endswith((".exr", ".hdr"))
    try:
        write_image(name, values.astype(np.float32) if floats else values.astype(np.uint8))
    except InputError as error:
        print(error)
    else:
        print(name, "is written")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere OpenImageIO writes to the disk itself")
@pytest.mark.parametrize("limit", [0, 1, 1000, 2000])
def test_a_file_that_finds_no_room_is_said_of_every_format(tmp_path, limit):
    """Also where the encoder says that all is well (PNG), and where it would end the process (JPEG)."""
    names = [f"a{ending}" for ending in (".png", ".jpg", ".tif", ".exr", ".hdr", ".bmp", ".tga", ".ppm")]
    for name in names:
        (tmp_path / name).write_bytes(b"precious")
    done = subprocess.run(
        [sys.executable, "-c", WRITE, str(limit), *names],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines() == [f"cannot write {name}: File too large" for name in names]
    assert contents(tmp_path) == dict.fromkeys(names, b"precious")


def test_written_jpeg_and_hdr_are_close(tmp_path):
    smooth = np.add.outer(np.arange(37) * 3, np.arange(23) * 4).astype(np.uint8)
    write_image(tmp_path / "a.jpg", smooth)
    assert np.abs(read_image(tmp_path / "a.jpg")[..., 0].astype(int) - smooth).max() <= 8
    radiance = np.exp(RNG.normal(size=(9, 12, 1)) * 3).astype(np.float32) * np.float32([1, 0.9, 0.8])
    write_image(tmp_path / "a.hdr", radiance)
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), radiance, rtol=1 / 100)


def test_values_that_a_format_cannot_hold(tmp_path):
    gray = np.ones((2, 2, 1), np.float32)
    for name, values, part in (
        ("a.png", gray, "float32 goes to .exr, .tif, .hdr"),
        ("a.jpg", gray.astype(np.uint16), "uint16 goes to"),
        ("a.exr", gray.astype(np.uint8), "uint8 goes to"),
        ("a.exr", gray.astype(np.float64), "float64 goes to no format"),
        ("a.gif", gray, "extension '.gif'"),
        ("a", gray, "extension ''"),
        ("a.hdr", gray, "3 channels, got 1"),
        ("a.tif", np.ones((2, 2, 2), np.float32), "2 channels go to .exr"),
        ("a.png", np.ones((2, 2, 4), np.uint8), "4 channels go to .exr"),
        ("a.exr", np.ones((2, 2, 3, 1), np.float32), r"got shape \(2, 2, 3, 1\)"),
        ("a.exr", np.ones((0, 2, 3), np.float32), "got shape"),
        ("none/a.exr", gray, "there is no folder"),
    ):
        with pytest.raises(InputError, match=part):
            write_image(tmp_path / name, values)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("extension", sorted(images._WRITABLE))
def test_only_one_program_writes_an_image(tmp_path, extension):
    values = np.ones((2, 3, 1 if extension == ".pgm" else 3), next(iter(images._WRITABLE[extension])))
    path = tmp_path / f"a{extension}"
    with open(tmp_path / f".a{extension}.part", "wb") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another program is writing it"):
            write_image(path, values)
        assert not path.exists()
    # A part that nobody holds was left by a program that is gone.
    write_image(path, values)
    np.testing.assert_array_equal(read_image(path), values)
    assert os.listdir(tmp_path) == [path.name]


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    write_image(tmp_path / "a.png", RGB8)

    def fail(name, *_):
        with open(name, "wb") as file:
            file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(images, "_encode", fail)
    with pytest.raises(InputError, match="the disk is full"):
        write_image(tmp_path / "a.png", RGB8 // 2)
    assert os.listdir(tmp_path) == ["a.png"]
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), RGB8)


@pytest.mark.parametrize("extension", [".exr", ".tif"])
def test_pictures_say_no_date(tmp_path, extension):
    """Nobody knows it, and equal pictures are equal files."""
    write_image(tmp_path / f"p{extension}", RNG.random((3, 4, 3)).astype(np.float32))
    header = oiio.ImageInput.open(str(tmp_path / f"p{extension}")).spec()
    assert header.get_string_attribute("DateTime") == "0000:00:00 00:00:00"


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("height", [5, 2050])
def test_a_png_in_bands_is_the_png_at_once(tmp_path, height, channels):
    rng = np.random.default_rng(height)
    values = (rng.standard_normal((height, 2048, channels)).cumsum(axis=1) * 3).astype(np.uint8)
    images.write_image(tmp_path / "whole.png", values)
    with png_rows(tmp_path / "bands.png", values.shape) as put:
        for first in range(0, height, 700):
            put(np.ascontiguousarray(values[first : first + 700]))
    assert (tmp_path / "bands.png").read_bytes() == (tmp_path / "whole.png").read_bytes()


@pytest.mark.parametrize(
    ("message", "error"),
    [
        ("^row 3", InputError("row 3 is damaged")),
        ("3 of 9 rows", None),
        ("^a.cl does not build", KernelBuildError("a.cl", {}, "")),
    ],
)
def test_a_png_that_loses_its_rows_is_not_there(tmp_path, capfd, message, error):
    (tmp_path / "a.png").write_bytes(b"before")

    def write():
        with png_rows(tmp_path / "a.png", (9, 4, 3)) as put:
            put(np.zeros((3, 4, 3), np.uint8))
            if error is not None:
                raise error

    with pytest.raises(InputError if error is None else type(error), match=message):
        write()
    assert (tmp_path / "a.png").read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert capfd.readouterr() == ("", "")  # encoders are told nothing that they would complain of


@pytest.mark.parametrize(("name", "large"), [("a.tif", "none"), ("a.exr", "zip"), ("b.tif", "zip")])
def test_large_pictures_are_packed_fast(tmp_path, monkeypatch, name, large):
    """Deflating floats took longer than relighting them; codes of 8 bits still shrink."""
    values = RGB8 if name == "b.tif" else RGB8.astype(np.float32) / 7
    for least, expected in ((1, large), (values[..., 0].size + 1, "zip")):
        monkeypatch.setattr(image_encoding, "_LARGE_PIXELS", least)
        write_image(tmp_path / name, values)
        with closing(oiio.ImageInput.open(str(tmp_path / name))) as reader:
            assert reader.spec()["compression"] == expected
        np.testing.assert_array_equal(read_image(tmp_path / name), values)
