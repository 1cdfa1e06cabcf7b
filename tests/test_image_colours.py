"""What image files say of their colours and curve is told, and raw files are not taken for the previews in them."""

import struct

import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight.errors import InputError
from clrelight.image_set import describe_headers
from clrelight.images import read_header

# Columns of the matrices to D50, as the profiles of Lindbloom (brucelindbloom.com) and Apple's Display P3 print them.
_SRGB = ((0.4361, 0.2225, 0.0139), (0.3851, 0.7169, 0.0971), (0.1431, 0.0606, 0.7141))
_ADOBE = ((0.6097, 0.3111, 0.0195), (0.2053, 0.6257, 0.0609), (0.1492, 0.0632, 0.7446))
_P3 = ((0.5151, 0.2412, -0.0011), (0.2920, 0.6922, 0.0419), (0.1571, 0.0666, 0.7841))

_GAMMA22, _GAMMA18, _LINEAR = (b"curv" + bytes(4) + tail for tail in (b"\0\0\0\1\2\x33", b"\0\0\0\1\1\xcd", bytes(4)))
_FORMULA = (
    b"para" + bytes(4) + struct.pack(">HH5i", 3, 0, *(round(x * 65536) for x in (2.4, 0.9479, 0.0521, 0.0774, 0.04)))
)
_TABLE = b"curv" + bytes(4) + struct.pack(">I5H", 5, 0, 3000, 14020, 35000, 65535)


def profile(name: str, columns: tuple, curve: bytes | None) -> bytes:
    """An ICC profile of version 2 by primaries and one curve: ICC.1:2001-04, clauses 6.1 and 6.5."""
    words = name.encode() + b"\0"
    tags = {b"desc": b"desc" + bytes(4) + struct.pack(">I", len(words)) + words + bytes(79)}
    for tag, column in zip((b"rXYZ", b"gXYZ", b"bXYZ")[: len(columns)], columns, strict=True):
        tags[tag] = b"XYZ " + bytes(4) + struct.pack(">3i", *(round(each * 65536) for each in column))
    tags |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curve) if curve is not None else {}
    table, body = struct.pack(">I", len(tags)), b""
    for tag, content in tags.items():
        table += struct.pack(">4sII", tag, 132 + 12 * len(tags) + len(body), len(content))
        body += content + bytes(-len(content) % 4)
    head = bytearray(128)
    head[:4] = struct.pack(">I", 128 + len(table) + len(body))
    head[8:24], head[36:40] = b"\2\x40\0\0mntrRGB XYZ ", b"acsp"
    return bytes(head) + table + body


def notes(tmp_path, name="a.jpg", transfer="srgb", icc=None, channels=3, **attributes) -> str:
    spec = oiio.ImageSpec(4, 3, channels, "half" if name.endswith("exr") else "uint8")
    if icc is not None:
        spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(icc)}]"), np.frombuffer(icc, np.uint8))
    for key, value in attributes.items():
        spec.attribute(key.replace("__", ":"), *(value if isinstance(value, tuple) else (value,)))
    out = oiio.ImageOutput.create(str(tmp_path / name))
    assert out.open(str(tmp_path / name), spec), out.geterror()
    assert out.write_image(np.zeros((3, 4, channels), np.uint8)), out.geterror()
    out.close()
    return "\n".join(describe_headers([read_header(tmp_path / name)], transfer))


@pytest.mark.parametrize("name", ["a.jpg", "a.png", "a.tif"])
def test_a_profile_of_other_primaries_is_named(tmp_path, name):
    for title, columns, curve in (("Adobe RGB (1998)", _ADOBE, _GAMMA22), ("Display P3", _P3, _FORMULA)):
        told = notes(tmp_path, name, icc=profile(title, columns, curve))
        assert told.startswith(f"all images: colours are those of {title}, ")
        assert told.count("\n") == 0


@pytest.mark.parametrize("curve", [_GAMMA22, _FORMULA, _TABLE])
def test_a_profile_of_srgb_is_as_none(tmp_path, curve):
    assert notes(tmp_path, icc=profile("sRGB IEC61966-2.1", _SRGB, curve)) == ""


def test_a_profile_of_tables_is_known_by_its_name(tmp_path):
    """ICC's own sRGB v4 has no primaries to compare, nor has any printer's."""
    assert notes(tmp_path, icc=profile("sRGB v4 ICC preference", (), None)) == ""
    assert "--transfer srgb" in notes(tmp_path, transfer="linear", icc=profile("sRGB v4 ICC preference", (), None))
    assert "colours are those of Coated" in notes(tmp_path, icc=profile("Coated FOGRA39", (), None))


def test_another_curve_than_the_one_that_is_taken_is_told(tmp_path):
    assert "--transfer srgb" in notes(tmp_path, transfer="linear", icc=profile("x", _SRGB, _GAMMA22))
    assert "--transfer srgb" in notes(tmp_path, transfer=None, icc=profile("x", _SRGB, _FORMULA))
    assert "--transfer linear" in notes(tmp_path, transfer="srgb", icc=profile("x", _SRGB, _LINEAR))
    assert notes(tmp_path, transfer="linear", icc=profile("x", _SRGB, _LINEAR)) == ""
    assert "gamma 1.8" in notes(tmp_path, icc=profile("x", _SRGB, _GAMMA18))


def test_a_jpeg_whose_curve_nobody_chose_is_told(tmp_path):
    assert "--transfer srgb" in notes(tmp_path, transfer=None)
    assert notes(tmp_path, transfer="linear") == notes(tmp_path, transfer="srgb") == ""
    assert notes(tmp_path, "a.png", transfer=None) == ""


def test_exif_and_chromaticities_say_so_too(tmp_path):
    assert "Adobe RGB or another" in notes(tmp_path, Exif__ColorSpace=65535)
    assert notes(tmp_path, Exif__ColorSpace=1) == ""
    assert notes(tmp_path, Exif__ColorSpace=65535, channels=1) == ""  # gray has no primaries
    kind, aces = oiio.TypeDesc("float[8]"), (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)
    assert "chromaticities 0.7347, 0.2653" in notes(tmp_path, "a.exr", "linear", chromaticities=(kind, aces))
    same = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
    assert notes(tmp_path, "a.exr", "linear", chromaticities=(kind, same)) == ""


def test_damaged_profiles_are_survived(tmp_path):
    rng = np.random.default_rng(1)
    sound = np.frombuffer(profile("x" * 30, _P3, _FORMULA), np.uint8)
    for _ in range(60):
        damaged = sound.copy()
        damaged[rng.integers(128, len(sound), 8)] = rng.integers(0, 256, 8)
        notes(tmp_path, icc=damaged.tobytes())


@pytest.mark.parametrize("name", ["a.NEF", "a.dng", "a.heic"])
def test_files_that_hold_only_a_preview_are_refused(tmp_path, name):
    notes(tmp_path, "a.tif")
    (tmp_path / "a.tif").rename(tmp_path / name)
    with pytest.raises(InputError, match=r"16-bit TIFF"):
        read_header(tmp_path / name)
