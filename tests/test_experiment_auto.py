"""Rows whose method or degree the fit chooses: they say what was chosen, and are found again by what was asked."""

import json

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.experiment import bench, load_experiment, paper_experiment, run_experiment
from clrelight.experiment.row import row_key
from clrelight.jobs.fit import fit
from clrelight.report import summary_rows, write_report
from clrelight.store import read_results, write_stack
from datasets_synth.ring import render_ring
from tests.commands import call, contents, succeed
from tests.stacks import make_stack

RING = {"size": 12, "lights": 30}


def auto_grid(**changes):
    return paper_experiment(**{"methods": ("auto",), "degrees": ("auto",), "codecs": ("none", "half"), "holdout": 5,
                               "synth": RING} | changes)  # fmt: skip


@pytest.fixture
def choices(monkeypatch):
    """Count the fits that are made, by what was asked."""
    asked = []

    def prepare(stack, method, degree, **options):
        asked.append((method if isinstance(method, str) else method.id, degree))
        return original(stack, method, degree, **options)

    original = bench.prepare_fit
    monkeypatch.setattr(bench, "prepare_fit", prepare)
    return asked


def test_a_row_says_what_was_chosen_and_that_it_was(tmp_path, choices):
    table = run_experiment(auto_grid(), tmp_path / "r.h5").table
    chosen = fit(render_ring(**RING), "auto", "auto", holdout=5)
    assert choices == [("auto", "auto")]
    for row in table:
        assert row["method"].decode() == chosen.method
        assert (row["degree"], row["n_coeff"]) == (chosen.degree, chosen.n_coeff)
        assert json.loads(row["fit_config"])["auto"] == "method and degree"
    assert f"ring/{chosen.method}/{chosen.degree}/half" in read_results(tmp_path / "r.h5").pictures


@pytest.mark.parametrize(
    ("methods", "degrees", "said"),
    [(("auto",), (3,), "method"), (("cls",), ("auto",), "degree"), (("auto",), ("auto",), "method and degree")],
)
def test_rows_are_found_again_without_choosing_again(tmp_path, choices, methods, degrees, said):
    grid = auto_grid(methods=methods, degrees=degrees)
    first = run_experiment(grid, tmp_path / "r.h5").table
    assert {json.loads(row["fit_config"])["auto"] for row in first} == {said}
    before = contents(tmp_path)
    assert run_experiment(grid, tmp_path / "r.h5").table.tobytes() == first.tobytes()
    assert (len(choices), contents(tmp_path)) == (1, before)
    # Another codec needs the fit again, but no row a second time.
    more = run_experiment(auto_grid(methods=methods, degrees=degrees, codecs=("none", "s3tc")), tmp_path / "r.h5").table
    assert (len(choices), len(more)) == (2, 3)
    assert (more[-1]["method"], more[-1]["degree"]) == (first[0]["method"], first[0]["degree"])


def test_what_was_asked_by_name_is_another_row_than_the_same_chosen(tmp_path):
    chosen = run_experiment(auto_grid(), tmp_path / "r.h5").table[0]
    named = auto_grid(methods=(chosen["method"].decode(),), degrees=(int(chosen["degree"]), "auto"))
    table = run_experiment(named, tmp_path / "r.h5").table
    assert len(table) == 2 + 2 * 2
    assert len({row_key(row) for row in table}) == 6
    assert len({row["psnr_pooled_holdout"] for row in table if row["codec"] == b"none"}) == 1
    # The lights held out are part of the question.
    assert len(run_experiment(auto_grid(holdout=6), tmp_path / "r.h5").table) == 8
    headers, rows = summary_rows(read_results(tmp_path / "r.h5"))
    assert {row[headers.index("options")] for row in rows} == {"", "auto=degree", "auto=method and degree"}
    write_report(read_results(tmp_path / "r.h5"), tmp_path / "report")


def test_an_interrupted_grid_goes_on(tmp_path, choices, monkeypatch):
    write, count = run_experiment.__globals__["write_results"], 0

    def stop_after_the_first(*arguments):
        nonlocal count
        count += 1
        if count == 2:
            raise KeyboardInterrupt
        write(*arguments)

    monkeypatch.setitem(run_experiment.__globals__, "write_results", stop_after_the_first)
    grid = auto_grid(methods=("auto", "cls"), degrees=("auto", 2))
    with pytest.raises(KeyboardInterrupt):
        run_experiment(grid, tmp_path / "r.h5")
    first = read_results(tmp_path / "r.h5").table
    assert len(first) == 1
    whole = run_experiment(grid, tmp_path / "r.h5").table
    assert (len(whole), whole[:1].tobytes()) == (8, first.tobytes())
    assert len({row_key(row) for row in whole}) == 8
    assert choices == [("auto", "auto"), ("auto", "auto"), ("auto", 2), ("cls", "auto"), ("cls", 2)]


def test_a_choice_that_cannot_be_made_leaves_a_row(tmp_path, choices):
    write_stack(tmp_path / "one.h5", make_stack(1, (4, 5, 3), directions_i3=np.array([[0.0, 0.0, 1.0]])))
    grid = paper_experiment(str(tmp_path / "one.h5"), methods=("sloan",), degrees=("auto",), codecs=("none",))
    (row,) = run_experiment(grid, tmp_path / "r.h5").table
    assert (row["method"], row["degree"], row["n_coeff"]) == (b"sloan", -1, 0)
    assert b"there is 1 light" in row["note"]
    run_experiment(grid, tmp_path / "r.h5")
    assert len(choices) == 1
    write_report(read_results(tmp_path / "r.h5"), tmp_path / "report")


def test_the_command_and_toml_ask_alike(tmp_path, choices):
    words = ["--size", 12, "--lights", 60, "--holdout", 5, "--codecs", "none"]
    ended = succeed("bench", "ring", *words, "--methods", "auto,cls", "--degrees", "auto,2", "--out",
                    tmp_path / "r.h5", "--json")  # fmt: skip
    assert [row["degree"] for row in ended.json["rows"]][1::2] == [2, 2]
    (tmp_path / "e.toml").write_text(
        'methods = ["auto", "cls"]\ndegrees = ["auto", 2]\nholdout = 5\n[ring]\nsize = 12\nlights = 60\n'
    )
    count = len(choices)
    again = succeed("bench", tmp_path / "e.toml", "--out", tmp_path / "r.h5", "--json")
    assert again.json["rows"] == ended.json["rows"]
    assert len(choices) == count == 4


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('degrees = ["many"]', "degrees must be whole numbers or 'auto', got 'many'"),
        ("degrees = [true]", "degrees must be whole numbers or 'auto', got True"),
        ('degrees = ["auto", "auto"]', "degrees holds 'auto' twice"),
        ('methods = ["auto", "auto"]', "methods holds 'auto' twice"),
        (
            'methods = ["auto"]\n[method.auto]\nenergy = 1',
            "auto chooses the options too; energy needs a method",
        ),
    ],
)
def test_toml_mistakes_are_named(tmp_path, text, expected):
    (tmp_path / "e.toml").write_text(text)
    with pytest.raises(InputError) as error:
        load_experiment(tmp_path / "e.toml")
    assert expected in str(error.value)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("ring --degrees auto,six", "expected one or more whole numbers separated by commas, such as 4,6,auto"),
        ("ring --degrees auto,101", "degrees must be auto or 0 to 100, got 101"),
        ("ring --degrees auto,auto", "degrees holds 'auto' twice"),
        ("--speed --degrees 2,auto", "leave auto out of --degrees"),
    ],
)
def test_bad_words_are_refused(tmp_path, words, expected):
    ended = call("bench", *words.split(), "--out", tmp_path / "r.h5")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert expected in ended.err
    assert contents(tmp_path) == {}
