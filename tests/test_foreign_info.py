"""`clrelight info` of other programs' files: pictures, folders and lists of lights."""

import json
import os

import numpy as np
import pytest

from clrelight.jobs.thumbnail import LIGHT, thumbnail
from clrelight.store import write_fit
from tests.commands import call, succeed
from tests.test_exchange import made_fit, shown_by_ours


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    write_fit(folder / "fit.h5", made_fit())
    for words in (
        ("a.ptm",),
        ("b.ptm", "--quality", 90),
        ("a.rti",),
        ("whole", "--format", "relight", "--planes", 9),
        ("tiles", "--format", "relight", "--tiles", "deepzoom", "--colorspace", "mycc"),
        ("a.lp",),
    ):
        succeed("export", folder / "fit.h5", folder / words[0], *words[1:])
    return folder


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a.ptm", ("polynomial texture map 1.2, PTM_FORMAT_RGB", "polynomials", 18, "bytes")),
        ("b.ptm", ("polynomial texture map 1.2, PTM_FORMAT_JPEG_RGB", "polynomials", 18, "JPEG")),
        ("a.rti", ("universal RTI file", "hemispherical harmonics, order 2", 27, "bytes")),
        ("whole", ("relight folder", "bilinear table", 9, "whole images")),
        ("whole/info.json", ("relight folder", "bilinear table", 9, "whole images")),
        ("tiles", ("relight folder", "bilinear table", 27, "tiles")),
    ],
)
def test_pictures(made, name, expected):
    told = succeed("info", made / name, "--json").json
    assert tuple(told[key] for key in ("kind", "basis", "planes", "stored")) == expected
    assert told["shape"] == [37, 50, 3]
    assert told["file"] == str(made / name)
    folder = made / name.partition("/")[0]
    files = [each for each in folder.rglob("*") if each.is_file()] if folder.is_dir() else [folder]
    assert told["bytes_on_disk"] == sum(len(each.read_bytes()) for each in files) > 1000
    if folder.is_dir():
        assert told["lights"] == 4
        assert told["colorspace"] == ("mycc" if name == "tiles" else "mrgb")
    lines = succeed("info", made / name).out.splitlines()
    assert f"kind           {expected[0]}" in lines
    assert "shape          37 × 50 × 3" in lines


def test_luminance_and_a_colour(tmp_path):
    head = b"PTM_1.2\nPTM_FORMAT_LRGB\n4\n3\n1 1 1 1 1 1\n0 0 0 0 0 0\n"
    (tmp_path / "l.PTM").write_bytes(head + bytes(9 * 12))
    told = succeed("info", tmp_path / "l.PTM", "--json").json
    assert (told["planes"], told["shape"], told["basis"]) == (9, [3, 4, 3], "polynomials, of luminance")


@pytest.mark.parametrize("name", ["a.ptm", "b.ptm", "a.rti", "whole", "tiles"])
def test_thumbnails_are_what_others_show(made, name):
    shown = shown_by_ours(made_fit(), LIGHT[None])[0]
    found = thumbnail(made / name) / 255.0
    assert found.shape == shown.shape
    assert np.sqrt(np.mean((found - shown) ** 2)) < 0.02 < shown.std()
    small = thumbnail(made / name, 25)
    assert small.shape == (18, 25, 3)  # 18.5 rounds to even


def test_no_thumbnail_where_it_takes_long_or_there_is_none(made, monkeypatch):
    assert thumbnail(made / "a.lp") is None
    monkeypatch.setattr("clrelight.jobs.thumbnail._MOST_VALUES", 100)
    assert [thumbnail(made / name) is None for name in ("a.ptm", "b.ptm", "whole")] == [False, True, True]


def test_nothing_is_decoded(made, tmp_path):
    """Bytes of planes that are no JPEG do not matter to what the text says of them."""
    content = bytearray((made / "b.ptm").read_bytes())
    content[-2000:] = bytes(2000)
    (tmp_path / "x.ptm").write_bytes(content)
    told = succeed("info", tmp_path / "x.ptm", "--json").json
    assert told["stored"] == "JPEG"
    assert call("import", tmp_path / "x.ptm", tmp_path / "x.h5").code == 2


def test_lists_of_lights(made, tmp_path):
    told = succeed("info", made / "a.lp", "--json").json
    z = np.array([0.93, 0.7, 0.5, 1.0]) / np.sqrt([0.04 + 0.09 + 0.93**2, 0.25 + 0.16 + 0.49, 0.37 + 0.25, 1.0])
    degrees = np.degrees(np.arcsin(z))
    np.testing.assert_allclose(told["elevation_range"], [degrees.min(), degrees.max()], atol=1e-3)
    assert told["images"] == ["000.png", "001.png", "002.png", "003.png"]
    assert (told["kind"], told["lights"], told["duplicates"], told["below_horizon"]) == ("list of lights", 4, 0, 0)
    assert "images         000.png to 003.png" in succeed("info", made / "a.lp").out
    (tmp_path / "x.txt").write_text("0 0 1\n0 0 2\n1 0 -1\n")
    told = succeed("info", tmp_path / "x.txt", "--json").json
    assert (told["lights"], told["duplicates"], told["below_horizon"], told["images"]) == (3, 1, 1, [])
    (tmp_path / "x.lp").write_text("3\na.jpg 0 0 1\nb.jpg 0 1 1\n")
    ended = call("info", tmp_path / "x.lp")
    assert ended.code == 0
    assert ended.err == "note: x.lp announces 3 lights, but lists 2; all 2 were taken\n"


def test_domes_and_projects(tmp_path):
    dome = {"directions": [[0, 0, 1], [0.5, 0, 0.5]]}
    (tmp_path / "d.dome").write_text(json.dumps(dome))
    images = [{"filename": "a.jpg"}, {"filename": "b.jpg", "skip": True}]
    (tmp_path / "p.relight").write_text(json.dumps({"images": images, "dome": dome}))
    told = succeed("info", tmp_path / "d.dome", "--json").json
    assert (told["kind"], told["lights"], told["elevation_range"]) == ("dome of relight", 2, [45.0, 90.0])
    told = succeed("info", tmp_path / "p.relight", "--json").json
    assert (told["kind"], told["lights"], told["images"]) == ("project of relight", 1, ["a.jpg"])
    assert "images         a.jpg\n" in succeed("info", tmp_path / "p.relight").out


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("x.ptm", b"junk", "is no polynomial texture map"),
        ("x.rti", b"junk", "is no .rti file"),
        ("x.lp", b"1\na.jpg 0 0\n", "line 2"),
        ("y.lp", b"1\na.jpg 0 0 0\n", "expected a vector towards the light"),
        ("x.json", b"{}", "is no dome of relight"),
        ("info.json", b"{}", "does not say what a relight folder says"),
        ("f.json", b'{"clrelight_schema": "brdf-coefficients/1"}', "clrelight brdf info"),
        ("x.brdf", b"", "clrelight brdf info"),
        ("x.png", b"junk", "is not an HDF5 file"),
    ],
)
def test_one_line_says_why_not(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    ended = call("info", tmp_path / name)
    assert (ended.code, ended.out) == (2, "")
    assert ended.err.count("\n") == 1
    assert words in ended.err


@pytest.mark.parametrize("name", ["none.ptm", "none.rti", "none.lp", "none.dome", "none"])
def test_what_is_not_there(tmp_path, name):
    ended = call("info", tmp_path / name)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert name in ended.err


def test_what_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "x.lp")  # whose end would never come
    (tmp_path / "x.ptm").mkdir()
    for name in ("x.lp", "x.ptm"):
        ended = call("info", tmp_path / name)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "is no regular file" in ended.err
    ended = call("info", "https://127.0.0.1:1/x.ptm")
    assert ended.code != 0
    assert "https://127.0.0.1:1/x.ptm" in ended.err  # as ours are asked for


def test_cut_short(made, tmp_path):
    for name in ("a.ptm", "b.ptm", "a.rti"):
        (tmp_path / name).write_bytes((made / name).read_bytes()[:-10])
        ended = call("info", tmp_path / name)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "bytes" in ended.err


def test_display_values_are_taken_for_srgb(tmp_path):
    """A picture of one value keeps it, whatever is averaged."""
    head = b"PTM_1.2\nPTM_FORMAT_RGB\n8\n8\n1 1 1 1 1 1\n0 0 0 0 0 0\n"
    (tmp_path / "x.ptm").write_bytes(head + 3 * 64 * bytes([0, 0, 0, 0, 0, 100]))
    assert (thumbnail(tmp_path / "x.ptm", 4) == 100).all()
