"""File names as people have them, in and out of every command: a name is only a name."""

import os
import shutil
from pathlib import Path

import pytest

from clrelight.errors import InputError
from clrelight.jobs.pictures import name_pictures
from tests.commands import call, process, succeed

NAMES = [
    "50%done",
    "a%sb%n",
    "#1",
    "a b",
    "a\nb",
    "ö日本",
    "a'b\"c",
    "a?b=c",
    "http:a",
    "[1]{x}*",
    "..a",
    ".hidden",
    "\x1b[31mred",
    "x" * 200,
    "y" * 250,
]
FORMATS = (".png", ".exr", ".hdr", ".tif", ".jpg", ".ppm", ".bmp", ".tga")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("names")
    succeed("synth", "ring", folder / "ring.h5", "--size", 16, "--lights", 12)
    succeed("fit", folder / "ring.h5", folder / "fit.h5", "--degree", 1, "--no-measure")
    return folder


@pytest.mark.parametrize("name", NAMES, ids=lambda name: ascii(name)[:16])
def test_any_name_in_and_out(made, tmp_path, name):
    folder = tmp_path / name[:100]
    folder.mkdir()

    def run(*words):
        ended = call(*words)
        assert ended.code == 0, (words, ended.err)

    def path(ending):
        # The longest name that a command makes of another one is that of the notes beside a texture array.
        whole = os.fsencode(name)[: 255 - max(len(ending), len(".dds.json"))]
        return os.path.join(folder, os.fsdecode(whole) + ending)

    shutil.copyfile(made / "ring.h5", path(".h5"))
    shutil.copyfile(made / "fit.h5", path("f.h5"))
    run("fit", path(".h5"), path("g.h5"), "--degree", 1, "--no-measure")
    run("encode", path("f.h5"), path("e.h5"), "--codec", "half")
    run("decode", path("e.h5"), path("d.h5"))
    assert Path(path("g.h5")).read_bytes() == Path(path("f.h5")).read_bytes()
    for ending in FORMATS:
        run("relight", path("f.h5"), path(ending), "--light", "0,0,1")
        assert os.path.isfile(path(ending))
    run("export", path("f.h5"), path(".dds"))
    run("export", path("f.h5"), os.path.join(folder, "t" + name[:100]), "--format", "exr")
    run("light", path("l.h5"), "--env", path(".hdr"), "--layout", "angular", "--degree", 2)
    run("relight", path("f.h5"), path(".gif"), "--light", path("l.h5"), "--turntable", 2)
    photos = os.path.join(folder, "p" + name[:100])
    os.mkdir(photos)
    for i in range(5):
        shutil.copyfile(path(".png"), os.path.join(photos, f"i{name[:100]}{i}.png"))
    with open(path(".txt"), "w") as table:
        table.writelines(f"{0.1 * i} {-0.1 * i} 1\n" for i in range(5))
    run("ingest", photos, path("s.h5"), "--lights", path(".txt"), "--mask", path(".png"), "--name", "n")
    grid = ("--degrees", 1, "--methods", "uls", "--codecs", "none")
    run("bench", path(".h5"), "--out", path("r.h5"), *grid)
    run("report", path("r.h5"), "--out", os.path.join(folder, "r" + name[:100]))
    run("info", path("r.h5"))
    left = [each for _, folders, files in os.walk(tmp_path) for each in (*folders, *files)]
    assert [each for each in left if each.endswith((".part", ".lock"))] == []


def test_names_are_printed_as_they_are(made, tmp_path):
    """Also where they are no text; what a terminal would obey is shown instead."""
    name = os.fsdecode(b"l\xf6we.h5")
    shutil.copyfile(made / "ring.h5", tmp_path / name)
    for words in (["info", name], ["info", name, "--json"], ["fit", name, f"o{name}", "--degree", "1"]):
        done = process(*words, folder=tmp_path, errors="surrogateescape")
        assert (done.code, "Traceback" in done.err) == (0, False), done.err
    assert name in process("info", name, folder=tmp_path, errors="surrogateescape").out
    done = process("info", f"no{name}", folder=tmp_path)
    assert done.code == 2
    assert "there is no file nol" in done.err
    shutil.copyfile(made / "ring.h5", tmp_path / "a\x1b[31m\nb.h5")
    done = process("info", "a\x1b[31m\nb.h5", folder=tmp_path)
    assert r"a\x1b[31m\nb.h5" in done.out.splitlines()[0]


def test_names_that_are_no_text(made, tmp_path):
    """Of a disk that was written before UTF-8: files of ours may have them, images must not, which is said."""
    name = os.path.join(tmp_path, os.fsdecode(b"l\xf6we"))
    shutil.copyfile(made / "ring.h5", f"{name}.h5")
    for words in (["fit", f"{name}.h5", f"{name}f.h5", "--degree", "1"], ["info", f"{name}f.h5"]):
        assert call(*words).code == 0
    succeed("relight", f"{name}f.h5", f"{name}.png", "--light", "0,0,1")
    ended = call("light", f"{name}l.h5", "--env", f"{name}.png")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "images need names in UTF-8" in ended.err
    assert sorted(map(os.fsencode, os.listdir(tmp_path))) == [b"l\xf6we.h5", b"l\xf6we.png", b"l\xf6wef.h5"]


def test_a_dash_in_front(made, tmp_path):
    shutil.copyfile(made / "fit.h5", tmp_path / "-f.h5")
    ended = process("relight", "-f.h5", "-o.png", "--light", "0,0,1", folder=tmp_path)
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert process("relight", "--light", "0,0,1", "--", "-f.h5", "-o.png", folder=tmp_path).code == 0
    assert process("relight", "./-f.h5", "./-p.png", "--light", "0,0,1", folder=tmp_path).code == 0
    assert sorted(os.listdir(tmp_path)) == ["-f.h5", "-o.png", "-p.png"]


def test_a_name_that_no_system_takes(made, tmp_path):
    for words in (
        ("info", tmp_path / ("x" * 256)),
        ("fit", made / "ring.h5", tmp_path / ("x" * 256)),
        ("fit", made / "ring.h5", "/".join(["x" * 200] * 30)),
        ("relight", made / "fit.h5", tmp_path / f"{'x' * 256}.png", "--light", "0,0,1"),
        ("relight", made / "fit.h5", tmp_path / "o.png", "--light", "x" * 300),
        ("ingest", tmp_path / ("x" * 256), tmp_path / "o.h5"),
        ("bench", made / "ring.h5", "--out", tmp_path / ("x" * 256)),
        ("light", tmp_path / "o.h5", "--env", tmp_path / ("x" * 256)),
    ):
        ended = call(*words)
        assert (ended.code, ended.err.count("\n"), ended.err[:9]) == (2, 1, "clrelight"), ended
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    ("image", "count", "names"),
    [
        ("50%done.png", 1, ["50%done.png"]),
        ("100%.png", 1, ["100%.png"]),
        ("50%d/o.png", 1, ["50%d/o.png"]),
        ("a%03d.png", 2, ["a000.png", "a001.png"]),
        ("50%done/a%d.png", 2, ["50%done/a0.png", "50%done/a1.png"]),
        ("50%done_%02d.png", 2, ["50%done_00.png", "50%done_01.png"]),
        ("%d", 1, ["0"]),
        ("%02dleft.png", 1, ["00left.png"]),
    ],
)
def test_number_fields(image, count, names):
    assert name_pictures(image, count) == names


@pytest.mark.parametrize(
    ("image", "count", "message"),
    [
        ("50%done.png", 2, "2 images need a number field"),
        ("a%d_b%03d.png", 2, "has 2 number fields, expected one"),
        ("%03d/o.png", 2, "2 images need a number field"),
    ],
)
def test_number_fields_that_are_none(image, count, message):
    with pytest.raises(InputError, match=message):
        name_pictures(image, count)
