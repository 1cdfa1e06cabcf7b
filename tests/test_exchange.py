"""Files of other viewers: written and shown as those show them, read back, and refused where they are damaged."""

import json
import math
from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.exchange.ptm import read_ptm, write_ptm
from clrelight.exchange.relight_reading import read_relight_folder
from clrelight.exchange.relight_table import octahedral_directions
from clrelight.exchange.rti import read_rti, write_rti
from clrelight.images import write_image
from clrelight.store import write_fit
from tests.commands import call, succeed
from tests.reference import openlime
from tests.reference.basis import real_harmonics

LIGHTS = np.array([[0.2, 0.3, 0.93], [-0.5, 0.4, 0.7], [0.1, -0.6, 0.5], [0.0, 0.0, 1.0]])
LIGHTS /= np.linalg.norm(LIGHTS, axis=1, keepdims=True)


def made_fit(degree=2, height=37, width=50, channels=3, transfer="linear"):
    """Return a bumpy view between 0 and 1 that is no mirror image of itself in any way."""
    y, x = np.mgrid[:height, :width] / width * 2 * np.pi
    coeffs = np.zeros(((degree + 1) ** 2, height, width, channels), np.float32)
    for k in range(len(coeffs)):
        for c in range(channels):
            waves = np.sin((1 + k % 3) * x + c) * np.cos((1 + k % 2) * y + k)
            coeffs[k, ..., c] = 1.5 + 0.5 * waves + 0.02 * y if k == 0 else 0.3 * waves / (1 + k)
    return cr.CoefficientMap(coeffs, degree, "spline", 255.0, transfer, LIGHTS, name="made")


def shown_by_ours(fit, lights=LIGHTS):
    radiance = np.einsum("ik,khwc->ihwc", real_harmonics(lights, fit.degree), fit.coeffs_khwc.astype(float))
    clipped = np.clip(radiance, 0, 1)
    if fit.transfer == "srgb":
        clipped = np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
    return np.broadcast_to(clipped, (*clipped.shape[:3], 3))


def decibels(found, expected):
    return -10 * math.log10(np.mean((found - expected) ** 2))


def shown_by_openlime(folder, light):
    return openlime.shown(json.loads((folder / "info.json").read_text()), openlime.whole_texels(folder), light)


@pytest.mark.parametrize(
    ("degree", "channels", "transfer", "planes", "space"),
    [
        *((2, 3, "linear", 27, "mrgb"), (3, 3, "srgb", 48, "mrgb"), (1, 1, "srgb", 12, "mrgb")),
        *((2, 3, "linear", 27, "mycc"), (2, 3, "srgb", 48, "mycc"), (1, 1, "srgb", 18, "mycc")),
    ],
)
def test_openlime_shows_what_we_show(tmp_path, degree, channels, transfer, planes, space):
    fit = made_fit(degree, channels=channels, transfer=transfer)
    write_fit(tmp_path / "fit.h5", fit)
    told = succeed(
        *("export", tmp_path / "fit.h5", tmp_path / "out", "--format", "relight", "--planes", planes),
        *("--colorspace", space, "--json"),
    ).json
    assert len(told["files"]) == planes // 3 + 1
    for light, expected in zip(LIGHTS, shown_by_ours(fit), strict=True):
        assert expected.std() > 0.02
        assert decibels(shown_by_openlime(tmp_path / "out", light), expected) > 44


def test_cells_of_the_table_are_where_viewers_look_them_up():
    for side in (2, 5, 16):
        directions = octahedral_directions(side).reshape(side, side, 3)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=2), 1)
        assert directions[..., 2].min() == 0
        size = np.abs(directions).sum(axis=2)
        x = ((directions[..., 0] + directions[..., 1]) / size + 1) / 2 * (side - 1)
        y = ((directions[..., 1] - directions[..., 0]) / size + 1) / 2 * (side - 1)
        np.testing.assert_allclose(x, np.broadcast_to(np.arange(side), (side, side)), atol=1e-12)
        np.testing.assert_allclose(y, np.broadcast_to(np.arange(side)[:, None], (side, side)), atol=1e-12)


def ptm_by_the_letter(content):
    """Return display values of `LIGHTS` of a file in RGB, by another reading of its bytes."""
    lines = content.split(b"\n", 6)
    assert lines[:2] == [b"PTM_1.2", b"PTM_FORMAT_RGB"]
    width, height = int(lines[2]), int(lines[3])
    scale, bias = (np.array(line.split(), float) for line in lines[4:6])
    assert (bias == bias.astype(int)).all()
    codes = np.frombuffer(lines[6], np.uint8).reshape(3, height, width, 6)[:, ::-1]
    u, v = LIGHTS[:, 0], LIGHTS[:, 1]
    terms = np.stack([u * u, v * v, u * v, u, v, np.ones(4)])
    return np.clip(np.einsum("ti,chwt->ihwc", terms, (codes - bias) * scale) / 255, 0, 1)


def test_a_ptm_is_what_its_format_says(tmp_path, device):
    fit = made_fit(1)  # x and y are in a polynomial; z nearly
    left = write_ptm(fit, tmp_path / "x.ptm", device)
    found = ptm_by_the_letter((tmp_path / "x.ptm").read_bytes())
    assert left > 30
    assert decibels(found, shown_by_ours(fit)) > 30
    # Written and read back: equal to a level, from the same bytes.
    ours = read_ptm(tmp_path / "x.ptm").display_values(LIGHTS, 0, 37)
    assert np.abs(ours - found).max() < 1 / 255


def test_an_rti_is_what_its_format_says(tmp_path, device):
    fit = made_fit(2, transfer="srgb")
    left = write_rti(fit, tmp_path / "x.rti", device)
    content = (tmp_path / "x.rti").read_bytes()
    lines = content.split(b"\n", 4)
    assert lines[:4] == [b"#HSH1.2", b"3", b"50 37 3", b"9 2 1"]
    scale, least = np.frombuffer(lines[4], "<f4", 18).reshape(2, 9)
    codes = np.frombuffer(lines[4], np.uint8, offset=72).reshape(37, 50, 3, 9)
    values = codes / 255 * scale + least
    zenith = [1 / np.sqrt(2 * np.pi), 0, np.sqrt(3 / (2 * np.pi)), 0, 0, 0, np.sqrt(5 / (2 * np.pi)), 0, 0]
    found = read_rti(tmp_path / "x.rti").display_values(LIGHTS, 0, 37)
    np.testing.assert_allclose(found[3], np.clip(values @ zenith, 0, 1), atol=1e-5)
    assert left > 32
    assert decibels(found, shown_by_ours(fit)) > 30


def test_lrgb_is_luminance_times_colour(tmp_path):
    rng = np.random.default_rng(0)
    luminance, colour = rng.integers(0, 256, (3, 4, 6), np.uint8), rng.integers(0, 256, (3, 4, 3), np.uint8)
    head = b"PTM_1.2\nPTM_FORMAT_LRGB\n4\n3\n1.0 0.5 0.5 1.0 1.0 2.0\n128 128 128 128 128 0\n"
    (tmp_path / "x.ptm").write_bytes(head + luminance.tobytes() + colour.tobytes())
    found = read_ptm(tmp_path / "x.ptm").display_values(LIGHTS[:1], 0, 3)[0]
    u, v, _ = LIGHTS[0]
    a = (luminance[::-1] - np.array([128.0, 128, 128, 128, 128, 0])) * [1, 0.5, 0.5, 1, 1, 2]
    light = a @ [u * u, v * v, u * v, u, v, 1]
    np.testing.assert_allclose(found, np.clip(light[..., None] * colour[::-1] / 255 / 255, 0, 1), atol=1e-5)


@pytest.mark.parametrize("ending", ["ptm", "rti"])
def test_an_archive_is_photographed_and_fitted(tmp_path, ending):
    fit = made_fit(2, transfer="srgb")
    write_fit(tmp_path / "fit.h5", fit)
    told = succeed("export", tmp_path / "fit.h5", tmp_path / f"old.{ending}", "--json").json
    assert told["format"] == ending
    assert told["refit"] > 25
    succeed("import", tmp_path / f"old.{ending}", tmp_path / "stack.h5", "--lights", 30)
    archive = {"ptm": read_ptm, "rti": read_rti}[ending](tmp_path / f"old.{ending}")
    with cr.open_stack(tmp_path / "stack.h5") as stack:
        assert stack.n_light == 30
        assert stack.directions_i3[:, 2].min() >= 0.15
        expected = archive.display_values(stack.directions_i3, 0, 37)
        assert np.abs(stack.images_ihwc[:] / 255.0 - expected).max() <= 0.502 / 255
    succeed("fit", tmp_path / "stack.h5", tmp_path / "again.h5", "--degree", 3)
    assert decibels(shown_by_ours(cr.store.read_fit(tmp_path / "again.h5")), shown_by_ours(fit)) > 24


def test_a_relight_folder_is_photographed(tmp_path):
    fit = made_fit(2)
    write_fit(tmp_path / "fit.h5", fit)
    succeed("export", tmp_path / "fit.h5", tmp_path / "out", "--format", "relight")
    found = read_relight_folder(tmp_path / "out").display_values(LIGHTS, 0, 37)
    for shown, light in zip(found, LIGHTS, strict=True):
        np.testing.assert_allclose(shown, shown_by_openlime(tmp_path / "out", light), atol=1e-4)
    for source in ("out", "out/info.json"):
        succeed("import", tmp_path / source, tmp_path / "stack.h5", "--lights", 20)
        with cr.open_stack(tmp_path / "stack.h5") as stack:
            assert (stack.n_light, stack.name) == (20, "out")
            expected = shown_by_ours(fit, stack.directions_i3)
            assert decibels(stack.images_ihwc[:] / 255.0, expected) > 40


def folder_of(place, info, planes):
    place.mkdir()
    for number in range(planes.shape[2] // 3):
        write_image(place / f"plane_{number}.png", np.ascontiguousarray(planes[..., 3 * number : 3 * number + 3]))
    material = {"scale": [2.0] * planes.shape[2], "bias": [0.25] * planes.shape[2], **info.pop("material", {})}
    (place / "info.json").write_text(json.dumps({"format": "png", "materials": [material], **info}))
    return (planes / 255 - 0.25) * 2


def test_other_bases_of_relight(tmp_path):
    rng = np.random.default_rng(2)
    planes = rng.integers(100, 200, (4, 5, 18), np.uint8)
    u, v, _ = LIGHTS[0]
    terms = np.array([1, u, v, u * u, u * v, v * v])
    values = folder_of(tmp_path / "ptm", {"type": "ptm", "colorspace": "rgb"}, planes)
    expected = np.einsum("t,hwtc->hwc", terms, values.reshape(4, 5, 6, 3))
    found = read_relight_folder(tmp_path / "ptm").display_values(LIGHTS[:1], 0, 4)[0]
    np.testing.assert_allclose(found, np.clip(expected, 0, 1), atol=1e-5)
    values = folder_of(tmp_path / "lrgb", {"type": "ptm", "colorspace": "lrgb"}, planes[..., :9])
    expected = (values[..., 3:] @ terms)[..., None] * values[..., :3]
    found = read_relight_folder(tmp_path / "lrgb").display_values(LIGHTS[:1], 0, 4)[0]
    np.testing.assert_allclose(found, np.clip(expected, 0, 1), atol=1e-5)
    # Radial bases: at a light far from all others, what the table has there.
    lights = np.array([[0.9, 0.0, 0.436], [-0.9, 0.0, 0.436], [0.0, 0.9, 0.436], [0.0, -0.9, 0.436]])
    basis = rng.integers(90, 160, (4, 4, 3))
    info = {"type": "rbf", "colorspace": "mrgb", "sigma": 0.2, "lights": lights.ravel().tolist()}
    info |= {"basis": basis.ravel().tolist(), "material": {"range": [100.0, 200.0, 300.0]}}
    values = folder_of(tmp_path / "rbf", info, planes[..., :3])
    expected = basis[0, 2] / 255 + values @ ((basis[1:, 2] - 127) / np.array([[100.0], [200.0], [300.0]]))
    found = read_relight_folder(tmp_path / "rbf").display_values(lights[2:3], 0, 4)[0]
    np.testing.assert_allclose(found, np.clip(expected, 0, 1), atol=1e-5)


@pytest.mark.parametrize(
    "change",
    [
        *(
            {"type": "ptm", "colorspace": "mycc"},
            {"colorspace": "mycc"},
            {"materials": []},
            {"resolution": 3},
            {"resolution": "x"},
        ),
        {"colorspace": "mycc", "yccplanes": [1, 2, 0]},
        *({"basis": [1, 2, 3]}, {"format": "tzi"}, {"materials": [{"scale": [1], "bias": [1, 2], "range": [1]}]}),
        {"materials": [{"scale": [1, 1, 1, 1, 1, 1, 1], "bias": [1] * 7, "range": [1] * 7}]},
    ],
)
def test_a_relight_folder_that_makes_no_sense_is_refused(tmp_path, change):
    info = {"type": "bilinear", "colorspace": "mrgb", "resolution": 2, "basis": [1] * 48}
    info["material"] = {"range": [1.0] * 3}
    folder_of(tmp_path / "x", info, np.full((2, 2, 3), 9, np.uint8))
    read_relight_folder(tmp_path / "x")
    told = json.loads((tmp_path / "x" / "info.json").read_text())
    (tmp_path / "x" / "info.json").write_text(json.dumps(told | change))
    with pytest.raises(cr.InputError):
        read_relight_folder(tmp_path / "x")


def test_damage_is_refused(tmp_path, device):
    fit = made_fit(1, 5, 6)
    write_ptm(fit, tmp_path / "good.ptm", device)
    write_rti(fit, tmp_path / "good.rti", device)
    rng = np.random.default_rng(3)
    for name, reader in (("good.ptm", read_ptm), ("good.rti", read_rti)):
        good = (tmp_path / name).read_bytes()
        bad = tmp_path / f"bad{name[-4:]}"
        for cut in (0, 5, 20, 60, len(good) - 1):
            bad.write_bytes(good[:cut])
            with pytest.raises(cr.InputError):
                reader(bad)
        for _ in range(300):  # whatever a header says, it is refused or shown
            changed = bytearray(good)
            for _ in range(rng.integers(1, 4)):
                changed[rng.integers(0, 110)] = rng.integers(256)
            bad.write_bytes(changed)
            try:
                found = reader(bad)
            except cr.InputError:
                continue
            with np.errstate(all="ignore"):
                assert found.display_values(LIGHTS, 0, 2).shape[2:] == (found.image_shape[1], 3)


@pytest.mark.parametrize(("words", "component"), [((), "float"), (("--format", "channels-half"), "half")])
@pytest.mark.parametrize("channels", [1, 3])
def test_all_coefficients_in_one_exr(tmp_path, words, component, channels):
    fit = made_fit(2, channels=channels)
    write_fit(tmp_path / "fit.h5", fit)
    succeed("export", tmp_path / "fit.h5", tmp_path / "maps.exr", *words)
    image = oiio.ImageInput.open(str(tmp_path / "maps.exr"))
    spec, values = image.spec(), image.read_image(oiio.FLOAT)
    assert str(spec.format) == component
    assert "z to the camera" in spec.getattribute("clrelight:axes")
    for k in range(9):
        for c, letter in enumerate("RGB" if channels == 3 else "Y"):
            found = values[..., spec.channelnames.index(f"SH.{k:03}.{letter}")]
            np.testing.assert_allclose(found, fit.coeffs_khwc[k, ..., c], rtol=0, atol=1e-3 * (component == "half"))


def test_halves_that_would_be_infinite_are_refused(tmp_path):
    fit = made_fit(1)
    coeffs_khwc = fit.coeffs_khwc.copy()
    coeffs_khwc[2, 1, 3, 0] = -7e4
    write_fit(tmp_path / "fit.h5", replace(fit, coeffs_khwc=coeffs_khwc))
    ended = call("export", tmp_path / "fit.h5", tmp_path / "maps.exr", "--format", "channels-half")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "(2, 1, 3, 0) is -70000, which binary16 cannot hold" in ended.err
    assert "take --format channels" in ended.err
    assert [path.name for path in tmp_path.iterdir()] == ["fit.h5"]
    succeed("export", tmp_path / "fit.h5", tmp_path / "maps.exr", "--format", "channels")


def test_ktx2_holds_the_blocks(tmp_path):
    fit = made_fit(1, 10, 13)
    write_fit(tmp_path / "fit.h5", fit)
    succeed("encode", tmp_path / "fit.h5", tmp_path / "enc.h5", "--codec", "bc6h")
    succeed("export", tmp_path / "enc.h5", tmp_path / "maps.ktx2")
    content = (tmp_path / "maps.ktx2").read_bytes()
    assert content[:12] == bytes.fromhex("AB4B5458203230BB0D0A1A0A")
    words = np.frombuffer(content, "<u4", 13, 12).tolist()
    assert words[:9] == [144, 1, 13, 10, 0, 4, 1, 1, 0]  # format, type size, sides, layers, faces, levels, plain
    dfd, dfd_size, kvd, kvd_size = words[9:13]
    start, size, whole = np.frombuffer(content, "<u8", 3, 80).tolist()
    assert (dfd, kvd) == (104, 104 + dfd_size)
    assert start % 16 == 0
    assert start >= kvd + kvd_size
    assert size == whole == len(content) - start == 4 * 3 * 4 * 16
    assert np.frombuffer(content, "<u4", 1, dfd)[0] == dfd_size == 44
    assert content[dfd + 12] == 133  # BC6H
    body = bytes(cr.read_encoded(tmp_path / "enc.h5")[0].body[:])
    assert content[start:] == body[:size]
    # A fit is coded on the way, to the same blocks.
    succeed("export", tmp_path / "fit.h5", tmp_path / "fit.ktx2")
    assert (tmp_path / "fit.ktx2").read_bytes() == content


def test_a_light_as_nine_coefficients(tmp_path):
    succeed("light", tmp_path / "sky.h5", "--sky", "clear", "--sun", "40,120", "--colour", "1,0.9,0.7", "--degree", 4)
    succeed("light", tmp_path / "lamp.h5", "--directional", "0,0.6,0.8", "--colour", "2", "--degree", 1)
    for name, shape in (("sky", 3), ("lamp", 1)):
        succeed("export", tmp_path / f"{name}.h5", tmp_path / f"{name}.json")
        told = json.loads((tmp_path / f"{name}.json").read_text())
        light = cr.read_light(tmp_path / f"{name}.h5")
        found = np.reshape(told["sh"], (9, 3))
        count = min(9, len(light.coeffs_kc))
        np.testing.assert_array_equal(found[:count], np.broadcast_to(light.coeffs_kc[:count], (count, 3)))
        assert not found[count:].any()
        assert light.channels == shape


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("export", "fit.h5", "x", "--format", "relight", "--planes", "10"), "a multiple of 3, got 10"),
        (("export", "fit.h5", "x.ptm", "--planes", "9"), "--planes is for --format relight"),
        (("export", "fit.h5", "fit.h5", "--format", "rti"), "that is the input fit.h5"),
        (("export", "fit.h5", "no/x.rti"), "no/x.rti"),
        (("export", "fit.h5", "x.json"), "fit.h5"),
        (("export", "fit.h5", "fit.h5", "--format", "ktx2"), "that is the input fit.h5"),
        (
            ("export", "fit.h5", "x.rti", "--format", "ptm"),
            "x.rti would be a file of format ptm",
        ),
        (("import", "fit.h5", "y.h5"), "files that end in .ptm or .rti can be imported"),
        (("import", "none.ptm", "y.h5"), "cannot read none.ptm"),
        (("import", "jpeg.ptm", "y.h5"), "a quality and 7 lines of 9 numbers"),
        (("import", "lut.ptm", "y.h5"), "PTM_FORMAT_PTM_LUT"),
    ],
)
def test_refusals(tmp_path, monkeypatch, words, line):
    monkeypatch.chdir(tmp_path)
    write_fit("fit.h5", made_fit(1, 4, 5))
    for name, kind in (("jpeg", b"JPEG_LRGB"), ("lut", b"PTM_LUT")):
        head = b"PTM_1.2\nPTM_FORMAT_" + kind + b"\n2\n2\n1 1 1 1 1 1\n0 0 0 0 0 0\n90\n"
        (tmp_path / f"{name}.ptm").write_bytes(head)
    before = {path.name for path in tmp_path.iterdir()}
    ended = call(*words)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert line in ended.err
    assert {path.name for path in tmp_path.iterdir() if not path.name.endswith(".lock")} == before
