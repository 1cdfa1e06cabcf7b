"""Pictures stored in legal but unusual ways, made by hand or by other libraries, and what every viewer shows."""

import resource
import struct
import subprocess
import sys
import zlib

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image, ImageOps

from clrelight.errors import InputError
from clrelight.images import read_alpha, read_bands, read_header, read_image, write_image
from tests.commands import call, environment, process
from tests.test_images import exr_bytes, oiio_write, png_chunk

RNG = np.random.default_rng(5)
RGB8 = RNG.integers(0, 256, (37, 23, 3), dtype=np.uint8)
RADIANCE = RNG.random((6, 8, 3)).astype(np.float32)
ONE = np.ones((6, 8), np.float32)


def banded(path, rows):
    """Return rows as bands give them, which must follow one another."""
    header = read_header(path)
    parts = list(read_bands(header, rows, 3 * header.row_bytes))
    assert [row for row, _ in parts] == list(rows[0] + np.cumsum([0] + [len(p) for _, p in parts])[:-1])
    return np.concatenate([part for _, part in parts])


def planes(prefix="", values_hwc=RADIANCE, names="RGB"):
    return {prefix + name: values_hwc[..., i].copy() for i, name in enumerate(names)}


@pytest.mark.parametrize("tile", [0, 16])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_tiff_orientation_is_applied(tmp_path, orientation, tile):
    path = tmp_path / "a.tif"
    oiio_write(path, RGB8, Orientation=orientation, **({"tile_width": tile, "tile_height": tile} if tile else {}))
    with Image.open(path) as file:
        expected = np.asarray(ImageOps.exif_transpose(file))
    np.testing.assert_array_equal(read_image(path), expected)
    for rows in ((0, 1), (5, len(expected) - 2)):
        np.testing.assert_array_equal(banded(path, rows), expected[slice(*rows)])
    assert read_header(path).notes == (() if orientation == 1 else (f"turned as orientation {orientation} says",))


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
@pytest.mark.parametrize("orientation", range(2, 9))
def test_orientation_of_a_camera_is_applied_where_asked(tmp_path, orientation, name):
    exif = Image.Exif()
    exif[0x0112] = orientation
    Image.fromarray(RGB8 // 64 * 64).save(tmp_path / name, exif=exif, quality=100, subsampling=0)
    with Image.open(tmp_path / name) as file:
        stored, expected = np.asarray(file).astype(int), np.asarray(ImageOps.exif_transpose(file)).astype(int)
    header = read_header(tmp_path / name, upright=True)
    assert np.abs(read_image(header).astype(int) - expected).max() <= 2
    assert header.camera_orientation == 1
    assert np.abs(read_image(tmp_path / name).astype(int) - stored).max() <= 2


@pytest.mark.parametrize("from_right", [False, True])
@pytest.mark.parametrize("from_top", [False, True])
def test_tga_and_bmp_rows(tmp_path, from_top, from_right):
    stored = RGB8[:: 1 if from_top else -1, :: -1 if from_right else 1, ::-1]
    kind = 0x20 * from_top + 0x10 * from_right
    head = struct.pack("<BBBHHBHHHHBB", 0, 0, 2, 0, 0, 0, 0, 0, 23, 37, 24, kind)
    (tmp_path / "a.tga").write_bytes(head + stored.tobytes())
    np.testing.assert_array_equal(read_image(tmp_path / "a.tga"), RGB8)
    rows = b"".join(row.tobytes() + bytes(-69 % 4) for row in RGB8[:: 1 if from_top else -1, :, ::-1])
    info = struct.pack("<IiiHHIIiiII", 40, 23, -37 if from_top else 37, 1, 24, 0, 0, 0, 0, 0, 0)
    (tmp_path / "a.bmp").write_bytes(b"BM" + struct.pack("<IHHI", 54 + len(rows), 0, 0, 54) + info + rows)
    np.testing.assert_array_equal(read_image(tmp_path / "a.bmp"), RGB8)


def hdr_bytes(values_hw3, size, *lines):
    """Return a Radiance picture of codes 0 to 255, which an exponent of 136 makes values."""
    codes = np.dstack([values_hw3, np.full(values_hw3.shape[:2], 136)]).astype(np.uint8)
    return b"\n".join([b"#?RADIANCE", *lines, b"", size]) + b"\n" + codes.tobytes()


RGBE = b"FORMAT=32-bit_rle_rgbe"


@pytest.mark.parametrize("x", [b"-X", b"+X"])
@pytest.mark.parametrize("y", [b"-Y", b"+Y"])
@pytest.mark.parametrize("by_columns", [False, True])
def test_hdr_rows_and_columns(tmp_path, x, y, by_columns):
    picture = RNG.integers(1, 255, (5, 7, 3))
    stored = picture[:: 1 if y == b"-Y" else -1, :: 1 if x == b"+X" else -1]
    size = b"%s 5 %s 7" % (y, x)
    if by_columns:
        stored, size = stored.swapaxes(0, 1), b"%s 7 %s 5" % (x, y)
    (tmp_path / "a.hdr").write_bytes(hdr_bytes(stored, size, RGBE))
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), picture, atol=0.51)
    np.testing.assert_allclose(banded(tmp_path / "a.hdr", (1, 4)), picture[1:4], atol=0.51)


def test_hdr_values(tmp_path):
    picture = RNG.integers(20, 200, (3, 4, 3))
    size = b"-Y 3 +X 4"
    for lines, factor in (
        ((RGBE, b"EXPOSURE=4"), 1 / 4),
        ((b"EXPOSURE = 2.0", RGBE, b"EXPOSURE=5e-1", b"EXPOSURE=8"), 1 / 8),
        ((RGBE, b"COLORCORR= 2 1 0.5"), np.array([0.5, 1, 2])),
        ((RGBE, b"GAMMA=1.0", b"# a remark", b"PRIMARIES=.64 .33 .29 .6 .15 .06 .333 .333"), 1),
        ((b"SOFTWARE=none",), 1),
    ):
        (tmp_path / "a.hdr").write_bytes(hdr_bytes(picture, size, *lines))
        np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), picture * factor, atol=1.1)
    assert read_header(tmp_path / "a.hdr").notes == ()
    # CIE XYZ of sRGB's primaries (IEC 61966-2-1).
    xyz = picture @ np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]).T
    (tmp_path / "a.hdr").write_bytes(hdr_bytes(xyz, size, b"FORMAT=32-bit_rle_xyze", b"EXPOSURE=2"))
    np.testing.assert_allclose(read_image(tmp_path / "a.hdr"), picture / 2, atol=3)
    assert read_header(tmp_path / "a.hdr").notes == (
        "divided by the header's exposure",
        "XYZ is taken to linear Rec. 709",
    )


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (hdr_bytes(RGB8, b"-Y 37 +X 23", RGBE, b"EXPOSURE=0"), "EXPOSURE=0, expected a number above 0"),
        (hdr_bytes(RGB8, b"-Y 37 +X 23", RGBE, b"EXPOSURE=much"), "EXPOSURE=much"),
        (hdr_bytes(RGB8, b"-Y 37 +X 23", RGBE, b"GAMMA=2.2"), "GAMMA=2.2: expected linear values"),
        (hdr_bytes(RGB8, b"-Y 37 +X 23", b"FORMAT=32-bit_rle_yuv"), "expected 32-bit_rle_rgbe"),
        (hdr_bytes(RGB8, b"-Y 37 +Y 23", RGBE), "no line such as"),
        (hdr_bytes(RGB8, b"37 23", RGBE), "no line such as"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", "no line such as"),
        (hdr_bytes(RGB8, b"-Y 37 +X 23", b"FORMAT=32-bit_rle_xyze")[:-100], "cannot decode"),
    ],
)
def test_bad_hdr_is_named(tmp_path, content, message):
    (tmp_path / "a.hdr").write_bytes(content)
    with pytest.raises(InputError, match=message) as error:
        read_image(tmp_path / "a.hdr")
    assert "a.hdr" in str(error.value)
    assert "\n" not in str(error.value)


LAYERS = {
    "names in small letters": (planes(names="rgb"), ""),
    "long names": (planes("beauty.", names=("red", "green", "blue")), "beauty"),
    "depth beside": (planes() | {"Z": ONE, "A": ONE / 4}, ""),
    "other layers": (planes() | planes("albedo.", RADIANCE / 2) | {f"N.{c}": ONE for c in "XYZ"}, ""),
    "Blender": (
        planes("ViewLayer.Combined.") | planes("ViewLayer.DiffCol.", ONE[..., None].repeat(3, 2))
        | planes("ViewLayer.Noisy Image.", RADIANCE / 3) | {"ViewLayer.Depth.Z": ONE, "ViewLayer.Combined.A": ONE},
        "ViewLayer.Combined",
    ),
    "compositor": (planes("Composite.Combined.") | planes("ViewLayer.Combined.", RADIANCE / 2), "Composite.Combined"),
    "beauty": (planes("beauty.") | planes("diffuse.", RADIANCE / 2), "beauty"),
    "one layer": (planes("somewhere."), "somewhere"),
    "identities": (planes("Image.") | planes("uCryptoObject00.", RADIANCE / 2, "rgb"), "Image"),
    "half and float": (planes() | {"G": RADIANCE[..., 1].astype(np.float16)}, ""),
}  # fmt: skip


@pytest.mark.parametrize("case", LAYERS)
def test_layer_of_an_exr_is_found(tmp_path, case):
    content, layer = LAYERS[case]
    (tmp_path / "a.exr").write_bytes(exr_bytes(content))
    header = read_header(tmp_path / "a.exr")
    np.testing.assert_allclose(read_image(header), RADIANCE, atol=1e-3 if case == "half and float" else 0)
    assert header.picture.layer == layer
    said = len(set(content) - {"A"}) > 3 or bool(layer)
    assert len(header.notes) == said
    # All that is left unread but alpha is named, up to eight.
    left = [name for name in content if name.rpartition(".")[2] != "A"]
    assert not said or len(left) > 8 or all(name in header.notes[0] for name in left)


@pytest.mark.parametrize("names", ["Y", "YA", "YZ", "R", ["550nm"]])
def test_gray_channel_is_found(tmp_path, names):
    (tmp_path / "a.exr").write_bytes(exr_bytes({name: ONE * (0.5 if i else 2) for i, name in enumerate(names)}))
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), 2 * ONE[..., None])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"Z": ONE}, "channels Z, none of which are radiance"),
        ({"depth": ONE}, "none of which are radiance"),
        ({"ViewLayer.Depth.V": ONE}, "none of which are radiance"),
        ({"A": ONE}, "none of which are radiance"),
        (planes(names="XYZ"), "none of which are radiance"),
        ({"R": ONE, "G": ONE}, "none of which are radiance"),
        (planes() | {"NIR": ONE}, "images of more bands are read from a stack file"),
        ({f"{nm}nm": ONE for nm in range(400, 700, 50)}, "images of more bands are read from a stack file"),
        ({"Y": ONE, "RY": ONE, "BY": ONE}, "luminance and chroma"),
        (
            planes("ViewLayer.Combined.") | planes("ViewLayer_001.Combined."),
            "by --layer: ViewLayer.Combined, ViewLayer_0",
        ),
        (planes("diffuse.") | planes("albedo."), "by --layer: albedo, diffuse"),
    ],
)
def test_exr_without_a_plain_picture(tmp_path, content, message):
    (tmp_path / "a.exr").write_bytes(exr_bytes(content))
    with pytest.raises(InputError, match=message) as error:
        read_header(tmp_path / "a.exr")
    assert "a.exr" in str(error.value)


def test_bands_beside_colours_are_dropped_only_where_asked(tmp_path):
    for bands in ({"NIR": ONE}, {f"S0.{nm},5nm": ONE for nm in (400, 500)}, {"x.850nm": ONE}):
        (tmp_path / "a.exr").write_bytes(exr_bytes(planes() | bands))
        with pytest.raises(InputError, match=r"images of more bands .* --layer rgb reads R, G, B alone"):
            read_header(tmp_path / "a.exr")
        header = read_header(tmp_path / "a.exr", layer="rgb")
        np.testing.assert_array_equal(read_image(header), RADIANCE)
        assert all(name in header.notes[0] for name in bands)


def test_layer_is_chosen_by_name(tmp_path):
    (tmp_path / "a.exr").write_bytes(exr_bytes(planes("albedo.") | planes("diffuse.", RADIANCE / 2) | {"Z": ONE}))
    for layer, factor in (("albedo", 1), ("DIFFUSE", 2)):
        found = read_image(read_header(tmp_path / "a.exr", layer=layer))
        np.testing.assert_array_equal(found, RADIANCE / factor)
    with pytest.raises(InputError, match=r"no layer 'Z' .* its layers are albedo, diffuse"):
        read_header(tmp_path / "a.exr", layer="Z")
    Image.fromarray(RGB8).save(tmp_path / "a.png")
    with pytest.raises(InputError, match=r"a.png has no layer 'R'; it has 1 page"):
        read_header(tmp_path / "a.png", layer="R")


def write_parts(path, parts):
    """Write a multi-part EXR of {name: (channel names, values)}."""
    specs = []
    for name, (channels, values) in parts.items():
        spec = oiio.ImageSpec(values.shape[1], values.shape[0], values.shape[2], oiio.FLOAT)
        spec.channelnames = tuple(channels)
        spec.attribute("oiio:subimagename", name)
        specs.append(spec)
    writer = oiio.ImageOutput.create("a.exr")
    assert writer.open(str(path), tuple(specs)), writer.geterror()
    for number, (_, values) in enumerate(parts.values()):
        assert number == 0 or writer.open(str(path), specs[number], "AppendSubimage"), writer.geterror()
        assert writer.write_image(values)
    assert writer.close()


def test_part_of_an_exr_is_found(tmp_path):
    path, depth, half = tmp_path / "a.exr", ("Z", ONE[..., None]), ("RGB", RADIANCE / 2)
    for parts in (
        {"depth": depth, "rgba": ("RGB", RADIANCE)},
        {"rgba": ("RGB", RADIANCE), "depth": depth},
        {"albedo": half, "beauty": ("RGB", RADIANCE), "depth": depth},
    ):
        write_parts(path, parts)
        np.testing.assert_array_equal(read_image(path), RADIANCE)
        np.testing.assert_array_equal(banded(path, (1, 5)), RADIANCE[1:5])
    write_parts(path, {"rgba": ("RGB", RADIANCE)})
    assert read_header(path).notes == ()
    write_parts(path, {"left": ("RGB", RADIANCE), "right": half})
    with pytest.raises(InputError, match="by --layer: left, right"):
        read_header(path)
    np.testing.assert_array_equal(read_image(read_header(path, layer="right")), RADIANCE / 2)


@pytest.mark.parametrize("tile", [0, 4])
@pytest.mark.parametrize(
    ("origin", "display"),
    [
        ((3, 5), (0, 0, 30, 28)),
        ((-3, -5), (0, 0, 9, 12)),
        ((-3, 2), (0, 0, 15, 40)),
        ((2, 3), (4, 6, 3, 30)),
        ((7, 7), (7, 7, 17, 21)),
    ],
)
def test_data_window_lies_in_the_display_window(tmp_path, origin, display, tile):
    values = RNG.random((21, 17, 3)).astype(np.float32)
    window = dict(zip(("full_x", "full_y", "full_width", "full_height"), display, strict=True))
    tiles = {"tile_width": tile, "tile_height": tile} if tile else {}
    oiio_write(tmp_path / "a.exr", values, x=origin[0], y=origin[1], **window, **tiles)
    left, top, width, height = display
    expected = np.zeros((height, width, 3), np.float32)
    for y in range(height):
        for x in range(width):
            row, column = y + top - origin[1], x + left - origin[0]
            if 0 <= row < 21 and 0 <= column < 17:
                expected[y, x] = values[row, column]
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), expected)
    for rows in ((1, height - 1), (height // 2, height // 2 + 1)):
        np.testing.assert_array_equal(banded(tmp_path / "a.exr", rows), expected[slice(*rows)])


def test_data_window_outside_the_picture(tmp_path):
    (tmp_path / "a.exr").write_bytes(exr_bytes(planes(), origin=(20, 20), display=(0, 0, 9, 9)))
    with pytest.raises(InputError, match="stores no pixel of its display window, 10×10"):
        read_header(tmp_path / "a.exr")


def test_page_of_a_tiff(tmp_path):
    path, page = tmp_path / "a.tif", Image.fromarray(RGB8)
    Image.fromarray(RGB8[::2, ::2]).save(path, save_all=True, append_images=[page])
    np.testing.assert_array_equal(read_image(path), RGB8)
    assert read_header(path).notes == ("of 2 pages number 2 is read, the largest",)
    np.testing.assert_array_equal(read_image(read_header(path, layer="1")), RGB8[::2, ::2])
    with pytest.raises(InputError, match="no layer '3'; it has 2 page"):
        read_header(path, layer="3")
    page.save(path, save_all=True, append_images=[Image.fromarray(RGB8[::-1])])
    np.testing.assert_array_equal(read_image(path), RGB8)
    assert read_header(path).notes == ("of 2 pages number 1 is read",)


@pytest.mark.parametrize("channel", [2, 5, 7])
def test_more_channels_are_refused_and_not_dropped(tmp_path, channel):
    oiio_write(tmp_path / "a.tif", RNG.integers(0, 255, (5, 4, channel), dtype=np.uint8), alpha_channel=-1)
    with pytest.raises(InputError, match=r"channels \(R, G.* expected gray or R, G, B"):
        read_header(tmp_path / "a.tif")


@pytest.mark.parametrize("channel", [2, 4, 7])
def test_any_number_of_channels_is_written_to_exr(tmp_path, channel):
    values = RNG.random((5, 4, channel)).astype(np.float32)
    write_image(tmp_path / "a.exr", values)
    reader = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    assert reader.spec().channelnames == tuple(f"band{i:03}" for i in range(channel))
    assert reader.spec().alpha_channel == -1
    np.testing.assert_array_equal(reader.read_image(oiio.FLOAT), values)
    reader.close()


def test_names_that_are_not_utf8(tmp_path):
    content = exr_bytes(planes("layer.") | {"Z": ONE})
    folder = write_folder(tmp_path / "a", lambda path, _: path.with_suffix(".exr").write_bytes(content))
    for old, new in ((b"layer.", b"lay\xe9r."), (b"lineOrder\0lineOrder", b"lineOrder\0lineOrd\xae\1")):
        assert old in content
        (folder / "im2.exr").write_bytes(content.replace(old, new))
        found = process("ingest", folder, tmp_path / "o.h5")
        assert found.code == 2
        assert found.err.count("\n") == 1
        assert "im2.exr" in found.err


def test_damaged_png_is_one_line(tmp_path, capfd):
    Image.fromarray(RGB8).save(tmp_path / "a.png", pnginfo=None)
    content = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "light_directions.txt").write_text("0 0 1\n")
    # In the size, its checksum, the pixels and theirs.
    for at in (18, 30, content.index(b"IDAT") + 2, content.index(b"IDAT") + 300, len(content) - 14):
        damaged = bytearray(content)
        damaged[at] ^= 0x11
        (tmp_path / "a" / "1.png").write_bytes(damaged)
        found = call("ingest", tmp_path / "a", tmp_path / "o.h5")
        assert (found.code, found.err.count("\n")) == (2, 1)
        assert "1.png" in found.err
        assert capfd.readouterr() == ("", "")  # nor has the library written anything
        assert not (tmp_path / "o.h5").exists()


def test_alpha_alone(tmp_path):
    rgba = np.dstack([RGB8, RGB8[..., 0] // 2])
    Image.fromarray(rgba).save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_alpha(read_header(tmp_path / "a.png")), rgba[..., 3])
    Image.fromarray(RGB8).save(tmp_path / "b.png")
    with pytest.raises(InputError, match=r"b.png has no alpha"):
        read_alpha(read_header(tmp_path / "b.png"))


def bomb(path, width, height, color_type=2):
    """Write a PNG that is black throughout, a thousandth of what it decodes to."""
    row = bytes(1 + width * {0: 1, 2: 3}[color_type])
    pack = zlib.compressobj(1)
    first, again = (pack.compress(row) + pack.flush(zlib.Z_FULL_FLUSH) for _ in range(2))
    # Each row is by itself, so that one is all; of as many zeros the checksum's sums are 1 and their count.
    check = struct.pack(">HH", height * len(row) % 65521, 1)
    packed = first + (height - 1) * again + pack.flush()[:-4] + check
    head = struct.pack(">IIBBBBB", width, height, 8, color_type, 0, 0, 0)
    chunks = png_chunk(b"IHDR", head) + png_chunk(b"IDAT", packed) + png_chunk(b"IEND", b"")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunks)


def test_bombs_are_refused_before_memory_is_taken(tmp_path):
    """Every command that reads images; each process may take 1 GB beside what it starts with."""
    (tmp_path / "a").mkdir()
    bomb(tmp_path / "a" / "1.png", 20000, 20000)
    Image.fromarray(RGB8).save(tmp_path / "small.png")
    (tmp_path / "b").mkdir()
    Image.fromarray(RGB8).save(tmp_path / "b" / "1.png")
    for folder in "ab":
        (tmp_path / folder / "light_directions.txt").write_text("0 0 1\n")
    before = sorted(path.name for path in tmp_path.iterdir())
    program = (
        "import sys\nfrom clrelight.cli.app import run\nfrom clrelight.jobs.memory import peak_memory\n"
        "code = run(sys.argv[1:])\nprint(peak_memory() >> 20)\nsys.exit(code)"
    )
    for arguments in (
        ("ingest", "a", "o.h5"),
        ("ingest", "b", "o.h5", "--mask", "a/1.png"),
        ("light", "o.h5", "--env", "a/1.png", "--layout", "angular"),
        ("irradiance", "a/1.png", "o.exr"),
        ("light", "o.h5", *(part for _ in range(6) for part in ("--env", "a/1.png"))),
    ):
        done = subprocess.run(
            [sys.executable, "-c", program, *arguments], cwd=tmp_path, env=environment(), capture_output=True, text=True
        )
        assert done.returncode == 2
        assert "claims 20000×20000 pixels (1144 MiB) in " in done.stderr
        assert done.stderr.count("\n") == 1
        assert int(done.stdout) < 700
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_large_masks_are_no_bombs(tmp_path):
    bomb(tmp_path / "a.png", 12000, 10000, color_type=0)
    header = read_header(tmp_path / "a.png")
    assert (header.height, header.width) == (10000, 12000)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    next(read_bands(header))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 100 << 10  # KiB


def write_folder(folder, write):
    folder.mkdir()
    for i in range(4):
        write(folder / f"im{i}", i)
    np.savetxt(folder / "light_directions.txt", [[0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8], [-0.6, 0, 0.8]])
    return folder


def test_ingest_says_how_images_were_understood(tmp_path):
    def camera(path, i):
        exif = Image.Exif()
        exif[0x0112] = 3 if i % 2 else 1
        Image.fromarray(RGB8).save(path.with_suffix(".jpg"), exif=exif)

    folder = write_folder(tmp_path / "camera", camera)
    found = call("ingest", folder, tmp_path / "o.h5")
    assert found.code == 0
    assert "mixed EXIF orientations (1 in 2, 3 in 2), not applied" in found.err
    said = call("ingest", folder, tmp_path / "o.h5", "--upright", "--json").json["notes"]
    assert "2 images: turned as orientation 3 says" in said

    def exr(path, i):
        content = planes("a.", RADIANCE * i) | planes("b.", RADIANCE / 2)
        path.with_suffix(".exr").write_bytes(exr_bytes(content, origin=(1, 0), display=(0, 0, 9, 5)))

    folder = write_folder(tmp_path / "layers", exr)
    assert "say which by --layer: a, b" in call("ingest", folder, tmp_path / "o.h5").err
    said = call("ingest", folder, tmp_path / "o.h5", "--layer", "b", "--json").json["notes"]
    assert "all images: channels b.R, b.G, b.B are read, not a.B, a.G, a.R" in {
        note.replace("a.R, a.G, a.B", "a.B, a.G, a.R") for note in said
    }
    assert "all images: only 8×6 pixels at (1, 0) are stored, black around them" in said


def test_windows_that_differ(tmp_path):
    import h5py

    def exr(path, i):
        content = exr_bytes(planes("", RADIANCE * i), origin=(i % 2, 0), display=(0, 0, 9, 5))
        path.with_suffix(".exr").write_bytes(content)

    folder = write_folder(tmp_path / "a", exr)
    found = call("ingest", folder, tmp_path / "o.h5")
    assert (found.code, found.err.count("\n")) == (2, 1)
    assert "--crop 1,0,7,6 keeps what all store" in found.err
    assert call("ingest", folder, tmp_path / "o.h5", "--crop", "1,0,7,6").code == 0
    with h5py.File(tmp_path / "o.h5") as file:
        for i, image in enumerate(file["images"][()]):
            first = 1 - i % 2
            np.testing.assert_array_equal(image, (RADIANCE * i)[:, first : first + 7])
