"""What a stranger tried from the command line: each was a fault."""

import errno
import io
import json
import os

import numpy as np
import pytest

from clrelight.batch.single import run_single
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.exchange.jpegs import close_jpeg, open_jpeg, write_jpeg
from clrelight.exchange.relight_reading import read_relight_folder
from clrelight.jobs.report import Report
from clrelight.jobs.unpack import unpack
from clrelight.sampling import make_pattern
from clrelight.store import write_fit, write_stack
from tests.commands import call, succeed
from tests.test_batch import Here
from tests.test_exchange import made_fit

DIRECTIONS = make_pattern("uniform", 12)


@pytest.fixture
def stack(tmp_path):
    images = np.random.default_rng(1).integers(0, 256, (12, 40, 44, 1), np.uint8)
    write_stack(tmp_path / "stack.h5", LightStack(images, DIRECTIONS, 255.0, name="s"))
    return tmp_path / "stack.h5"


def shared(stack, out, **options):
    report = Report()
    run_single("pack", stack, out, options=options, engine=Here(), report=report)
    assert report.facts["file"] == str(out)
    return report.facts


def test_workers_are_told_options_that_are_zero(stack, tmp_path):
    facts = shared(stack, tmp_path / "a.h5", method="uls", degree=0, rate=1.0, holdout=None, perceptual=False)
    assert facts["degree"] == 0


def test_what_is_refused_leaves_no_folder_of_parts(stack, tmp_path):
    with pytest.raises(InputError, match="for a folder of photographs"):
        shared(stack, tmp_path / "a.h5", keep_stack=str(tmp_path / "k.h5"))
    for options, line in (
        ({"engine": "nope"}, "there is no engine 'nope'"),
        ({"engine": "tcp://127.0.0.1:1", "workers": 2}, "leave the number out"),
    ):
        with pytest.raises(InputError, match=line):
            run_single("pack", stack, tmp_path / "a.h5", **options)
    assert "no engine 'nope'" in call("batch", tmp_path, tmp_path / "out", "--job", "pack", "--engine", "nope").err
    with pytest.raises(InputError, match="fetch it first"):
        run_single("unpack", "https://127.0.0.1:1/x.h5", tmp_path / "a")
    with pytest.raises(InputError, match="choose another ending"):
        shared(stack, tmp_path / "a.shards")
    assert os.listdir(tmp_path) == ["stack.h5"]


def test_parts_that_are_done_are_told_of(stack, tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("clrelight.jobs.pack.write_encoded", interrupted)
    report = Report()
    with pytest.raises(KeyboardInterrupt):
        run_single("pack", stack, tmp_path / "a.h5", options={"rate": 1.0}, engine=Here(), report=report)
    assert f"what is done stays in {tmp_path / 'a.shards'}" in report.notes[-1]
    monkeypatch.undo()
    shared(stack, tmp_path / "a.h5", rate=1.0)
    assert sorted(os.listdir(tmp_path)) == ["a.h5", "stack.h5"]


def test_a_folder_that_is_there_is_refused_before_work(stack, tmp_path, monkeypatch):
    succeed("pack", stack, tmp_path / "a.h5", "--rate", 1, "--method", "uls", "--degree", 1)
    (tmp_path / "un").mkdir()
    (tmp_path / "un" / "mine.txt").touch()
    monkeypatch.setattr("clrelight.jobs.unpack.lend_encoded", None)
    with pytest.raises(InputError, match="choose the name of a new folder"):
        unpack(tmp_path / "a.h5", tmp_path / "un", report=Report())


def test_google_tiles_without_a_first_level_are_found(tmp_path):
    write_fit(tmp_path / "fit.h5", made_fit(1, height=257, width=1))
    succeed("export", tmp_path / "fit.h5", tmp_path / "out", "--format", "relight", "--tiles", "google", "--planes", 3)
    assert not (tmp_path / "out" / "plane_0" / "0").exists()
    assert read_relight_folder(tmp_path / "out").image_shape == (257, 1, 3)
    assert "there is no file or folder" in call("import", tmp_path / "nothing", tmp_path / "x.h5").err


def test_names_of_lights_can_be_read_again(stack, tmp_path):
    for start in ("#", "%%", "//", '"'):
        ended = call("export", stack, tmp_path / "a.lp", "--names", f"{start}%d.png")
        assert (ended.code, ended.err.count("\n")) == (2, 1), start
    assert succeed("export", stack, tmp_path / "a.lp").out.splitlines()[-1].split() == ["time", "0.00", "s"]
    lamps = [[0, 0, 1], [0, 1, 1], [1, 0, 1]]
    told = {"images": [{"filename": None}] * 3, "dome": {"directions": lamps}}
    (tmp_path / "a.relight").write_text(json.dumps(told))
    assert "have no file names" in call("export", tmp_path / "a.relight", tmp_path / "b.lp").err


def test_spheres_that_are_none_are_refused_in_one_line(tmp_path):
    images = np.full((3, 40, 40, 1), 60, np.uint8)
    images[1, 20, 20] = 255
    write_stack(tmp_path / "grey.h5", LightStack(images, DIRECTIONS[:3], 255.0, name="s"))
    write_stack(tmp_path / "black.h5", LightStack(0 * images, DIRECTIONS[:3], 255.0, name="s"))
    for name, words in (
        ("grey", ("--sphere", "1e300,1e300,1e300")),
        ("grey", ("--sphere", "20,20,900")),
        ("grey", ("--sphere", "20,20,9", "--focal", "1e-9")),
        ("black", ("--sphere", "20,20,9", "--kind", "matte")),
    ):
        ended = call("find-lights", tmp_path / f"{name}.h5", tmp_path / "x.lp", *words)
        told = [line for line in ended.err.splitlines() if not line.startswith("note:")]
        assert (ended.code, len(told)) == (2, 1), (words, ended.err)
    ended = call("find-lights", tmp_path / "grey.h5", tmp_path / "x.lp", "--sphere", "20,20,9")
    assert (ended.code, "not seen" in ended.out) == (0, True)


@pytest.mark.skipif(not hasattr(os, "memfd_create"), reason="the system has no files in memory")
@pytest.mark.parametrize("words", [("--format", "relight"), ("--format", "deepzoom"), ("--quality", "95")])
def test_a_full_disk_ends_an_export_and_not_the_process(tmp_path, monkeypatch, words):
    """libjpeg calls exit() where a write fails."""
    write_fit(tmp_path / "fit.h5", made_fit(1, height=60, width=70))
    jpegs = []

    class Full(io.BytesIO):
        def write(self, piece):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def opened(file, mode):
        jpegs.append(file)
        return Full()

    monkeypatch.setattr("clrelight.exchange.jpegs.open", opened, raising=False)
    out = "out.ptm" if "--quality" in words else "out"
    ended = call("export", tmp_path / "fit.h5", tmp_path / out, *words)
    assert (ended.code, ended.err.count("\n"), "the disk is full" in ended.err) == (2, 1, True), ended.err
    assert jpegs
    assert os.listdir(tmp_path) == ["fit.h5"]


def test_a_jpeg_in_pieces_is_the_one_at_once(tmp_path):
    pixels = np.random.default_rng(2).integers(0, 256, (300, 200, 3), np.uint8)
    write_jpeg(tmp_path / "once.jpg", pixels, 90)
    output = open_jpeg(tmp_path / "pieces.jpg", 300, 200, 90)
    for first in range(0, 300, 50):
        output.write_scanlines(first, first + 50, 0, pixels[first : first + 50].copy())
    assert (tmp_path / "pieces.jpg").stat().st_size > 0  # memory does not hold it all
    close_jpeg(tmp_path / "pieces.jpg", output)
    assert (tmp_path / "pieces.jpg").read_bytes() == (tmp_path / "once.jpg").read_bytes()
