"""The report of one file beside its photographs."""

import csv
import json
import re

import numpy as np
import pytest

from tests.commands import call, contents, succeed
from tests.reference.basis import real_harmonics
from tests.reference.psnr import mean_squared_errors, psnr
from tests.test_report_page import Tree


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("file")
    succeed("synth", "ring", folder / "ring.h5", "--size", 24, "--lights", 36)
    succeed("fit", folder / "ring.h5", folder / "fit.h5", "--degree", 2, "--holdout", 5)
    succeed("encode", folder / "fit.h5", folder / "enc.h5", "--codec", "half")
    return folder


@pytest.fixture(scope="module")
def told(place):
    return succeed("report", place / "fit.h5", "--stack", place / "ring.h5", "--out", place / "out", "--json").json


def lights(place):
    return list(csv.DictReader((place / "out" / "lights.csv").read_text().splitlines()))


def test_psnr_is_that_of_each_light(place, told):
    import h5py

    with h5py.File(place / "fit.h5") as fit, h5py.File(place / "ring.h5") as ring:
        coeffs, images, directions = fit["coefficients"][...], ring["images"][...], ring["directions"][...]
    relit = np.einsum("ik,khwc->ihwc", real_harmonics(directions, 2), coeffs.astype(np.float64))
    expected = psnr(mean_squared_errors(relit, images, 255.0, "linear", np.ones(images.shape[1:3], bool)))
    rows = lights(place)
    np.testing.assert_allclose([float(row["psnr"]) for row in rows], expected, atol=1e-3)
    held = [i for i, row in enumerate(rows) if row["seen"] == "held out"]
    assert held == list(range(4, 36, 5))
    assert told["psnr"]["mean_holdout"] == pytest.approx(expected[held].mean(), abs=1e-3)
    np.testing.assert_allclose(
        [float(row["elevation"]) for row in rows], np.degrees(np.arcsin(directions[:, 2])), atol=1e-9
    )


def test_the_page_shows_the_worst_the_middle_and_the_best(place, told):
    text = (place / "out" / "report.html").read_text(encoding="utf-8")
    tree = Tree(text)
    shown = json.loads(next(each for each in tree.scripts if each.startswith("[")))
    values = [float(row["psnr"]) for row in lights(place)]
    assert shown[0]["name"] == f"photograph, worst light ({int(np.argmin(values))})"
    names = [each["name"] for each in shown]
    assert f"relit, best light ({int(np.argmax(values))})" in names
    for each in shown[1::2]:
        light = int(re.search(r"\((\d+)\)", each["name"])[1])
        assert abs(float(each["facts"].split()[0]) - values[light]) < 0.2  # of the picture in 8 bits
    assert {path.rpartition("/")[2] for path in told["files"]} == {"report.html", "lights.csv", "psnr_by_light.png"}
    assert len(tree.all("svg")) == 1
    assert all(
        (a.get(key) or "#").startswith(("data:", "#"))
        for _, a in tree.elements
        for key in ("src", "href", "xlink:href")
    )


def test_an_encoding_has_its_codec_on_the_page(place, tmp_path):
    ended = succeed("report", place / "enc.h5", "--stack", place / "ring.h5", "--out", tmp_path / "out")
    assert "PSNR, held out" in ended.out
    assert "half, 16 bit per coefficient" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_what_makes_no_sense_is_refused_and_nothing_written(place, tmp_path):
    succeed("synth", "ring", tmp_path / "other.h5", "--size", 16, "--lights", 9)
    before = contents(tmp_path)
    for arguments, words in (
        ((place / "ring.h5", "--stack", place / "ring.h5"), "a fit or an encoding"),
        ((place / "fit.h5", "--stack", tmp_path / "other.h5"), "the stack has"),
        ((place / "fit.h5",), "expected results/1"),
        ((place / "fit.h5", "--stack", place / "ring.h5", "--parquet"), "--parquet"),
        ((place / "fit.h5", "--device", "cpu"), "--stack"),
    ):
        ended = call("report", *arguments, "--out", tmp_path / "out")
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert words in ended.err
    assert contents(tmp_path) == before
