"""Environment maps as other programs write them: all of them the same sky."""

import struct

import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight.errors import InputError
from clrelight.images import write_image
from clrelight.lighting.environment import read_environment
from clrelight.lighting.projection import project_environment
from tests.test_image_forms import hdr_bytes
from tests.test_images import oiio_write

SIZE = 12


def sky(right, forward, up):
    """Return radiance brighter above, redder to the right and bluer forward."""
    length = np.sqrt(right * right + forward * forward + up * up)
    white = 1 + 0.5 * up / length
    return np.stack([white + 0.3 * right / length, white, white + 0.3 * forward / length], -1).astype(np.float32)


def check(environment):
    """Compare coefficients with the sky's: 1, and z / 2, 0.3 x in red, 0.3 y in blue, by their integrals."""
    first, second = 2 * np.sqrt(np.pi), np.sqrt(4 * np.pi / 3)
    expected = np.zeros((4, 3))
    expected[0], expected[2] = first, 0.5 * second
    expected[3, 0] = expected[1, 2] = 0.3 * second
    np.testing.assert_allclose(project_environment(environment, 1).coeffs_kc, expected, atol=0.03)


def latlong():
    polar = np.pi * (np.arange(16)[:, None] + 0.5) / 16
    azimuth = 2 * np.pi * (np.arange(32) + 0.5) / 32 - np.pi
    up = np.cos(polar) + 0 * azimuth
    return sky(np.sin(polar) * np.sin(azimuth), np.sin(polar) * np.cos(azimuth), up)


def cube_faces():
    """Return Direct3D's six faces, seen from inside: right, left, up, down, forward, back."""
    along = 2 * (np.arange(SIZE) + 0.5) / SIZE - 1
    x, y = np.meshgrid(along, -along)
    one = np.ones_like(x)
    views = ((one, -x, y), (-one, x, y), (x, -y, one), (x, y, -one), (x, one, y), (-x, -one, y))
    return np.stack([sky(*view) for view in views])


def openexr_cube():
    """Return the faces of ImfEnvmap.h, one below the other: right-handed, y up; -z is forward where x is right."""
    along = 2 * (np.arange(SIZE) + 0.5) / SIZE - 1
    column, row = np.meshgrid(along, -along)
    one = np.ones_like(row)
    xyz = ((one, row, column), (-one, row, -column), (column, one, row), (column, -one, -row))
    xyz += ((-column, row, one), (column, row, -one))
    return np.concatenate([sky(x, -z, y) for x, y, z in xyz])


def test_cube_of_openexr(tmp_path):
    oiio_write(tmp_path / "a.exr", openexr_cube(), textureformat="CubeFace Environment")
    assert b"envmap\0envmap\0\1\0\0\0\1" in (tmp_path / "a.exr").read_bytes()
    for layout in (None, "cube"):
        environment, notes = read_environment(tmp_path / "a.exr", layout=layout)
        check(environment)
        assert notes == ["a.exr is a cube as its envmap attribute says: -z is forward in it, y up"]
    oiio_write(tmp_path / "b.exr", np.concatenate(cube_faces()))
    check(read_environment(tmp_path / "b.exr")[0])
    # A layout that is asked for counts more than the attribute.
    oiio_write(tmp_path / "c.exr", np.concatenate(cube_faces()), textureformat="CubeFace Environment")
    check(read_environment(tmp_path / "c.exr", layout="vertical-strip")[0])


def test_map_of_openexr(tmp_path):
    oiio_write(tmp_path / "a.exr", latlong(), textureformat="LatLong Environment")
    environment, notes = read_environment(tmp_path / "a.exr")
    check(environment)
    assert (environment.layout, notes) == ("latlong", [])
    for name, values in (("Cube", latlong()), ("LatLong", latlong()[:, :16])):
        oiio_write(tmp_path / "a.exr", values, textureformat=f"{name.replace('Cube', 'CubeFace')} Environment")
        with pytest.raises(InputError, match=r"a.exr has \d+×16 texels, layout .* must be"):
            read_environment(tmp_path / "a.exr")


@pytest.mark.parametrize("turned", ["rows", "columns", "exposure", "tiff", "overscan"])
def test_maps_stored_in_other_ways(tmp_path, turned):
    values = latlong()
    path = tmp_path / "a.hdr"
    scaled = np.minimum(values * 100, 255)
    if turned == "rows":
        path.write_bytes(hdr_bytes(scaled[::-1, ::-1], b"+Y 16 -X 32", b"FORMAT=32-bit_rle_rgbe", b"EXPOSURE=100"))
    elif turned == "columns":
        columns = scaled.swapaxes(0, 1)
        path.write_bytes(hdr_bytes(columns, b"+X 32 -Y 16", b"FORMAT=32-bit_rle_rgbe", b"EXPOSURE=100"))
    elif turned == "exposure":
        path.write_bytes(hdr_bytes(scaled, b"-Y 16 +X 32", b"EXPOSURE=10", b"EXPOSURE=10"))
    elif turned == "tiff":
        path = tmp_path / "a.tif"
        oiio_write(path, values[::-1].copy(), Orientation=4)
    else:
        path = tmp_path / "a.exr"
        padded = np.pad(values, ((3, 3), (2, 2), (0, 0)))
        oiio_write(path, padded, x=-2, y=-3, full_x=0, full_y=0, full_width=32, full_height=16)
    check(read_environment(path)[0])


@pytest.mark.parametrize(
    ("values", "x", "display"),
    [
        (latlong()[:8], 0, (32, 16)),
        (latlong()[:, :16], 0, (32, 16)),  # a square, like an angular map
        (latlong(), 16, (32, 16)),
    ],
)
def test_maps_of_which_a_part_is_stored(tmp_path, values, x, display):
    window = {"full_x": 0, "full_y": 0, "full_width": display[0], "full_height": display[1]}
    oiio_write(tmp_path / "a.exr", values.copy(), x=x, **window)
    with pytest.raises(InputError, match=r"a.exr stores only \d+×\d+ pixels .* a map must show every direction"):
        read_environment(tmp_path / "a.exr")


def test_integers_become_radiance_by_their_curve(tmp_path):
    codes = np.arange(16 * 32 * 3).reshape(16, 32, 3)
    for name, values in (("a.png", codes.astype(np.uint8)), ("b.png", (40 * codes).astype(np.uint16))):
        write_image(tmp_path / name, values)
        encoded = values / np.iinfo(values.dtype).max
        decoded = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
        for transfer, expected in (("linear", encoded), ("srgb", decoded)):
            environment, notes = read_environment(tmp_path / name, transfer=transfer)
            np.testing.assert_allclose(environment.radiance_hwc, expected, rtol=1e-6)
            assert len(notes) == 1


def dds_bytes(*, dx10=True, caps=0xFE00, flags=4, count=1, n_face=6, pixel_format_size=32, dxgi=10):
    header = bytearray(128)
    header[:4] = b"DDS "
    struct.pack_into("<7I", header, 4, 124, 0x1007, SIZE, SIZE, 0, 1, 0)
    struct.pack_into("<2I", header, 76, pixel_format_size, 4)
    header[84:88] = b"DX10" if dx10 else struct.pack("<I", 113)
    struct.pack_into("<2I", header, 108, 0x1008, caps)
    body = bytes(header) + (struct.pack("<5I", dxgi, 3, flags, count, 0) if dx10 else b"")
    faces = np.concatenate([cube_faces(), np.ones((6, SIZE, SIZE, 1), np.float32)], axis=3).astype("<f2")
    return body + b"".join(faces[i % 6].tobytes() for i in range(n_face))


@pytest.mark.parametrize(
    "options",
    [
        {"dx10": False},
        {"dx10": False, "pixel_format_size": 24},
        {},
        {"caps": 0},
        {"flags": 0},
        {"count": 0},
        {"count": 6},
    ],
)
def test_cube_flag_in_either_header(tmp_path, options):
    (tmp_path / "a.dds").write_bytes(dds_bytes(**options))
    check(read_environment(tmp_path / "a.dds")[0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"caps": 0, "flags": 0}, r"is no cube map of six square faces \(0 faces of 12×12\)"),
        ({"caps": 0, "flags": 0, "count": 6}, "is no cube map"),
        ({"dx10": False, "caps": 0x7E00, "n_face": 5}, r"\(5 faces of 12×12\)"),
        ({"dx10": False, "caps": 0xFC00}, "is no cube map"),
        ({"count": 2, "n_face": 12}, "is an array of 2 cube maps"),
        ({"count": 6, "n_face": 36}, "is an array of 6 cube maps"),
        ({"n_face": 5}, "is cut short"),
        ({"dxgi": 95}, "has texel format 95"),
    ],
)
def test_other_textures_are_refused(tmp_path, options, message):
    (tmp_path / "a.dds").write_bytes(dds_bytes(**options))
    with pytest.raises(InputError, match=message):
        read_environment(tmp_path / "a.dds")
    with pytest.raises(InputError, match="has no layers"):
        read_environment(tmp_path / "a.dds", layer="beauty")


def test_layer_of_a_map(tmp_path):
    values = np.concatenate([latlong(), latlong() / 2], axis=2)
    spec = oiio.ImageSpec(32, 16, 6, oiio.FLOAT)
    spec.channelnames = ("a.R", "a.G", "a.B", "b.R", "b.G", "b.B")
    writer = oiio.ImageOutput.create("a.exr")
    assert writer.open(str(tmp_path / "a.exr"), spec)
    assert writer.write_image(values)
    assert writer.close()
    check(read_environment(tmp_path / "a.exr", layer="a")[0])
    with pytest.raises(InputError, match="by --layer: a, b"):
        read_environment(tmp_path / "a.exr")
