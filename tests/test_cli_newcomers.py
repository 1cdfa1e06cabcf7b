"""What somebody sees who does not know the commands yet: a list by purpose, and what to do about a wrong file."""

import re

import numpy as np
import pytest

import clrelight as cr
from clrelight.cli.app import cli
from clrelight.cli.sections import OTHERS, SECTIONS
from tests.commands import call, contents, succeed
from tests.test_store_nexus import make_fit, make_stack


def test_every_command_stands_once_in_the_list_and_whole():
    told = succeed("--help").out
    names = re.findall(r"^  ([a-z][a-z-]+) {2,}\S", told, re.M)
    assert sorted(names) == sorted(cli.commands)
    assert "..." not in told.partition("Options:")[2]
    positions = [told.index(f"\n{title}:") for title in SECTIONS]
    assert positions == sorted(positions)
    assert names[:2] == ["pack", "relight"]


def test_headings_name_commands_that_exist_and_a_new_one_is_shown_too(monkeypatch):
    assert {name for names in SECTIONS.values() for name in names} <= set(cli.commands)
    monkeypatch.setitem(cli.commands, "anew", cli.commands["info"])
    assert f"\n{OTHERS}:\n  anew" in succeed("--help").out


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("fit photos o.h5", "photos is no regular file, but a folder: clrelight ingest makes"),
        ("fit fit.h5 o.h5", "expected stack/1 (clrelight ingest makes one)"),
        ("encode stack.h5 o.h5", "clrelight fit makes one of it"),
        ("decode fit.h5 o.h5", "(clrelight encode or pack makes one)"),
        ("report fit.h5 --out o", "expected results/1 (clrelight bench makes one)"),
        ("import photos o.h5", "photos is no folder of relight, it has no info.json"),
        ("pack empty o.h5", "empty holds no files"),
        ("pack photos o.h5", "clrelight find-lights"),
    ],
)
def test_a_file_of_another_kind_says_what_makes_the_right_one(words, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    cr.write_stack("stack.h5", make_stack(3))
    cr.write_fit("fit.h5", make_fit(3))
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "a.png").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    before = contents(tmp_path)
    ended = call(*words.split())
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert told in ended.err
    assert contents(tmp_path) == before


def test_lights_too_few_for_the_degree_are_said_to_be(tmp_path):
    stack = make_stack(3)
    cr.write_stack(tmp_path / "s.h5", stack)
    few = succeed("plan-lights", tmp_path / "s.h5", "--degree", 3, "--json").json["notes"]
    assert any(f"{stack.n_light} lights are fewer than the 16 coefficients" in note for note in few)
    assert not succeed("plan-lights", tmp_path / "s.h5", "--degree", 1, "--json").json["notes"]


def test_records_and_reports_are_shown_in_few_lines(tmp_path):
    stack, fitted = make_stack(3), make_fit(3)
    shown = repr(stack)
    assert shown.startswith("LightStack(images_ihwc=")
    assert f"{stack.images_ihwc.dtype} {stack.images_ihwc.shape}" in shown
    assert "None" not in shown
    encoded = cr.encode(fitted, "half")
    assert f"body={len(encoded.body)} bytes" in repr(encoded)
    for each in (stack, fitted, encoded, encoded.record):
        assert "\n" not in repr(each)
        assert len(repr(each)) < 500
    report = cr.fit(stack, "uls", 1, out=tmp_path / "f.h5")
    lines = repr(report).split("\n")
    assert lines[0] == "Report"
    assert any(line.split() == ["method", "uls"] for line in lines)
    psnr = f"{report.psnr['mean_fitted']:.2f}"
    assert any(line.split() == ["psnr", "mean_fitted", psnr, "dB"] for line in lines)


def test_a_stack_is_read_whole_and_a_misspelt_name_is_told(tmp_path):
    cr.write_stack(tmp_path / "s.h5", make_stack(3))
    stack = cr.read_stack(tmp_path / "s.h5")
    (tmp_path / "s.h5").unlink()
    np.testing.assert_array_equal(stack.images_ihwc, make_stack(3).images_ihwc)
    np.testing.assert_array_equal(stack.directions_i3, make_stack(3).directions_i3)
    assert stack.peak == 255.0
    with pytest.raises(AttributeError, match="did you mean 'relight'"):
        cr.relite  # noqa: B018
    assert not hasattr(cr, "__wrapped__")
