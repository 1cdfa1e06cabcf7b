"""Archives of others whose numbers make no sense, and results that would replace what they are made of."""

import json
import resource
import tempfile
import warnings
from contextlib import contextmanager

import numpy as np
import pytest

import clrelight as cr
from clrelight.exchange.relight_reading import read_relight_folder
from clrelight.images import write_image
from clrelight.store import write_fit
from tests.commands import call, contents, succeed
from tests.test_exchange import folder_of, made_fit

TABLE = [1] * 48
MATERIAL = {"scale": [2.0] * 3, "bias": [0.25] * 3, "range": [1.0] * 3}


@pytest.fixture
def folder(tmp_path):
    info = {"type": "bilinear", "colorspace": "mrgb", "resolution": 2, "basis": TABLE, "sigma": 0.2}
    info |= {"lights": [0.0, 0.0, 1.0] * 4, "material": {"range": [1.0] * 3}}
    folder_of(tmp_path / "x", info, np.full((2, 2, 3), 9, np.uint8))
    return tmp_path / "x"


def change(folder, told):
    known = json.loads((folder / "info.json").read_text())
    (folder / "info.json").write_text(json.dumps(known | told))


@pytest.mark.parametrize(
    "told",
    [
        *({"basis": [each, *TABLE[1:]]} for each in ("x", None, [1, 2], float("nan"), float("inf"), 1e300)),
        *({"materials": [MATERIAL | {"range": [each, 1.0, 1.0]}]} for each in (0, 1e-320, "q", float("nan"), None)),
        *({"materials": [MATERIAL | {"scale": [each, 1.0, 1.0]}]} for each in (float("inf"), 1e300, float("nan"))),
        {"materials": [MATERIAL | {"bias": [float("-inf"), 1.0, 1.0]}]},
        {"resolution": -2},
        {"type": "rbf", "lights": [0.0, 0.0, 1.0] * 4 + [1.0]},
        *({"type": "rbf", "sigma": each} for each in (1e-200, 0, float("nan"), float("inf"), "s")),
        *({"type": "rbf", "lights": ["a", *[0.0] * 11]}, {"type": "rbf", "lights": [float("nan"), *[0.0] * 11]}),
    ],
)
def test_numbers_that_make_no_sense_are_refused(folder, tmp_path, told):
    change(folder, told)
    ended = call("import", folder, tmp_path / "y.h5")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "does not say what a relight folder says" in ended.err
    assert not (tmp_path / "y.h5").exists()


STRANGE = (
    *({"resolution": 10**400}, {"type": "1" * 900}, {"colorspace": "2" * 900}),
    *({"width": 10**400, "height": 10**400}, {"format": "3" * 900}),
)


@pytest.mark.parametrize("told", STRANGE)
def test_what_is_repeated_of_a_folder_is_short(folder, told):
    change(folder, told)
    with pytest.raises(cr.InputError) as refused:
        read_relight_folder(folder)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize("content", [b"", b"{", b"\x89HDF\r\n\x1a\n" + bytes(900), b"[" * 100_000])
def test_what_is_no_json_is_refused_in_a_short_line(folder, content):
    (folder / "info.json").write_bytes(content)
    with pytest.raises(cr.InputError, match=r"info\.json is no JSON$"):
        read_relight_folder(folder)


def test_planes_of_another_size_are_refused_before_they_are_decoded(folder, tmp_path):
    write_image(folder / "plane_0.png", np.zeros((600, 700, 3), np.uint8))
    change(folder, {"width": 2, "height": 2})
    ended = call("import", folder, tmp_path / "y.h5")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "its planes have 700 × 600 pixels, info.json says 2 × 2" in ended.err


@contextmanager
def small_files(n_bytes):
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    "words",
    [("a", "relight"), ("a.ptm", "ptm", "--quality", 80), ("a.exr", "channels"), ("a", "deepzoom"), ("a", "exr")],
)
def test_files_that_may_not_get_so_large(tmp_path, words):
    write_fit(tmp_path / "fit.h5", made_fit(1, 120, 130))
    (tmp_path / "out").mkdir()
    name, kind, *more = words
    succeed("export", tmp_path / "fit.h5", tmp_path / f"before{name}", "--format", kind, *more)  # kernels are built
    with small_files(9000):
        ended = call("export", tmp_path / "fit.h5", tmp_path / "out" / name, "--format", kind, *more)
    assert (ended.code, ended.err) == (2, f"clrelight: cannot write {tmp_path / 'out' / name}: File too large\n")
    assert not list((tmp_path / "out").iterdir())


def test_compressed_planes_need_no_temporary_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    write_fit(tmp_path / "fit.h5", made_fit(1, 8, 9))
    succeed("export", tmp_path / "fit.h5", tmp_path / "a.ptm", "--format", "ptm", "--quality", 90)
    succeed("import", tmp_path / "a.ptm", tmp_path / "b.h5")


def test_scales_beyond_float32_are_refused(tmp_path):
    write_fit(tmp_path / "fit.h5", made_fit(1, 4, 5))
    for ending in ("ptm", "rti"):
        succeed("export", tmp_path / "fit.h5", tmp_path / f"good.{ending}")
    good = (tmp_path / "good.rti").read_bytes()
    at = good.index(b"9 2 1\n") + 6
    (tmp_path / "bad.rti").write_bytes(good[:at] + np.full(9, 3e38, "<f4").tobytes() + good[at + 36 :])
    lines = (tmp_path / "good.ptm").read_bytes().split(b"\n", 5)
    (tmp_path / "bad.ptm").write_bytes(b"\n".join([*lines[:4], b"1e300 " * 5 + b"1e300", lines[5]]))
    for name in ("bad.rti", "bad.ptm"):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            ended = call("import", tmp_path / name, tmp_path / "y.h5")
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "beyond 1e+09" in ended.err


def test_a_stack_never_replaces_a_part_of_its_folder(folder):
    before = contents(folder)
    for name in ("info.json", "plane_0.png"):
        ended = call("import", folder, folder / name)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "that is the input" in ended.err
    assert contents(folder) == before


def test_a_folder_that_is_there_is_refused_before_the_work(folder, tmp_path, monkeypatch):
    write_fit(tmp_path / "fit.h5", made_fit(1, 4, 5))
    monkeypatch.setattr("clrelight.jobs.exchange.write_relight_folder", None)
    for out in (folder, tmp_path / "fit.h5"):
        ended = call("export", tmp_path / "fit.h5", out, "--format", "relight")
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert "it is there, choose the name of a new folder" in ended.err
