"""The sweep of what can be given up: fronts and budgets by brute force, its answer as TOML, resuming, refusals."""

import json
import math
import re
import tomllib
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from clrelight.dataset import split_lights
from clrelight.errors import InputError
from clrelight.experiment import load_experiment, make_settings
from clrelight.experiment.axes import Axes
from clrelight.experiment.grid import CodecSetting, Experiment
from clrelight.experiment.pareto import (
    Limits,
    Model,
    Trial,
    best_of_degrees,
    best_within,
    near_pareto_front,
    pareto_front,
)
from clrelight.experiment.toml import experiment_text
from clrelight.fit import method_class
from clrelight.holdout import split_chosen
from clrelight.report import canvas
from clrelight.report.trade import trade_chart
from clrelight.results import ROW_DTYPE, TIME_FIELDS
from clrelight.sampling import farthest_point_subset, make_pattern
from clrelight.store import read_results, write_results
from tests.commands import arrays, call, contents, succeed

SMALL = ["--methods", "uls,cls", "--degrees", "1,2", "--iterations", "4,32", "--codecs", "half,klt", "--rates", "1,0.2"]
SMALL += ["--newton-steps", "2"]


def trial(seconds, size, psnr, degree=2):
    row = np.zeros(1, ROW_DTYPE)[0]
    row["seconds_fit"], row["encoded_bytes"], row["psnr_pooled_holdout"] = seconds, size, psnr
    return Trial(Model(method_class("cls")(), degree), CodecSetting(), row)


points = st.lists(st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 6)), min_size=1, max_size=12)


@given(points)
def test_fronts_are_what_nothing_beats(drawn):
    trials = [trial(*map(float, point[:1]), point[1], float(point[2])) for point in drawn]
    for cost, value, sign in (("seconds", "psnr", -1), ("size", "psnr", -1), ("seconds", "size", 1)):
        pairs = {(getattr(t, cost), sign * getattr(t, value)) for t in trials}
        best = {p for p in pairs if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in pairs)}
        assert {(getattr(t, cost), sign * getattr(t, value)) for t in pareto_front(trials, cost, value)} == best
    kept = near_pareto_front(trials, 2.0)
    for each in trials:
        beaten = any(o.seconds <= each.seconds and o.size <= each.size and o.psnr >= each.psnr + 2.0 for o in trials)
        assert (each in kept) == (not beaten)


@given(points, st.integers(1, 6), st.integers(1, 6), st.integers(1, 6))
def test_a_choice_is_within_the_limits_and_the_best(drawn, seconds, size, psnr):
    trials = [trial(float(s), b, float(q)) for s, b, q in drawn]
    for limits, rank in (
        (Limits(seconds=seconds), lambda t: -t.psnr),
        (Limits(seconds=seconds, size=size), lambda t: -t.psnr),
        (Limits(psnr=psnr), lambda t: t.size),
        (Limits(psnr=psnr, seconds=seconds), lambda t: t.size),
        (Limits(psnr=psnr, size=size), lambda t: t.seconds),
        (Limits(seconds, size, psnr), lambda t: -t.psnr),
    ):
        within = [
            t
            for t in trials
            if (limits.seconds is None or t.seconds <= seconds)
            and (limits.size is None or t.size <= size)
            and (limits.psnr is None or t.psnr >= psnr)
        ]
        if within:
            assert rank(limits.choose(trials)) == min(map(rank, within))
        else:
            with pytest.raises(InputError, match="none of the"):
                limits.choose(trials)


@given(points)
def test_the_best_of_degrees_and_within_sizes(drawn):
    trials = [trial(1.0, size, float(psnr), degree=degree) for degree, size, psnr in drawn]
    trials.append(trial(1.0, 1, math.nan))  # was refused
    for count in (1, 2):
        kept = best_of_degrees(trials, count)
        assert [each.model.degree for each in kept] == sorted(each.model.degree for each in kept)
        for degree in {point[0] for point in drawn}:
            of_degree = sorted((float(point[2]) for point in drawn if point[0] == degree), reverse=True)
            assert [each.psnr for each in kept if each.model.degree == degree] == of_degree[:count]
    for size in range(7):
        found = [float(point[2]) for point in drawn if point[1] <= size]
        assert best_within(trials, size) == max(found, default=-math.inf)


def test_the_nearest_is_named_and_what_was_refused_is_never_taken():
    refused = trial(math.nan, 0, math.nan)
    trials = [refused, trial(10.0, 100, 20.0), trial(1.0, 400, 30.0)]
    assert Limits(size=50).excess(refused) == math.inf
    with pytest.raises(InputError, match=r"the nearest is cls newton degree 2, .*: 20.00 dB, 100 bytes, 10 s"):
        Limits(size=50).choose(trials)
    assert near_pareto_front(trials, 0.3) == [trials[2], trials[1]]
    assert pareto_front(trials, "size", "psnr") == trials[1:]
    for bad in ({"seconds": 0.0}, {"seconds": math.nan}, {"size": 0}, {"psnr": math.inf}):
        with pytest.raises(InputError):
            Limits(**bad)


def test_an_experiment_comes_back_from_its_text(tmp_path):
    cls = method_class("cls")(iterations=8, solver="bisection")
    (setting,) = make_settings("klt", {"rate": 0.25})
    (inner,) = make_settings("whitened", {})
    path = tmp_path / "e.toml"
    for made in (
        Experiment((str(tmp_path / 'a "b".h5'),), (cls,), (4,), (setting, inner), 5, lights=20),
        Experiment((str(tmp_path / "s.h5"),), ("auto",), ("auto",), (CodecSetting(),), weights="solid-angle"),
        Experiment((str(tmp_path / "s.h5"),), (cls,), (4,), (CodecSetting(),), precision="double"),
    ):
        text = experiment_text(made, tmp_path, "two\nlines")
        assert text.startswith("# two\n# lines\n")
        tomllib.loads(text)
        path.write_text(text)
        assert load_experiment(path) == made


def test_chosen_lights_are_well_spread_and_never_held_out():
    directions = make_pattern("scattered", 60)
    seen, held = split_lights(60, 4)
    fitted, unseen = split_chosen(directions, 4, 20)
    np.testing.assert_array_equal(unseen, held)
    assert set(fitted) == set(seen[farthest_point_subset(directions[seen], 20)])
    np.testing.assert_array_equal(split_chosen(directions, 4, None)[0], seen)
    with pytest.raises(InputError, match="45 of 60 lights are there to be fitted, got lights 46"):
        split_chosen(directions, 4, 46)


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept")
    succeed("synth", "ring", folder / "ring.h5", "--size", 12, "--lights", 40)
    succeed("synth", "ring", folder / "few.h5", "--size", 8, "--lights", 11)
    told = succeed("trade", folder / "ring.h5", "--out", folder / "t.h5", *SMALL, "--budget-bytes", 2000, "--json")
    return folder, told.json


def test_every_axis_is_measured(swept):
    rows = swept[1]["trials"]
    configs = [json.loads(row["fit_config"]) for row in rows]
    assert {(r["method"], r["degree"]) for r in rows} >= {("uls", 1), ("cls", 1), ("cls", 2)}
    assert {c["iterations"] for c in configs if c.get("solver") == "bisection"} == {4, 32}
    assert [c["iterations"] for c in configs if c.get("solver") == "newton" and c["iterations"] < 16] == [2]
    # The reference, cls, in each precision; another model's single precision would be its mixed precision.
    precisions = [(r["method"], c["precision"]) for r, c in zip(rows, configs, strict=True) if "precision" in c]
    assert set(precisions) >= {("cls", "single"), ("cls", "double")}
    assert ("uls", "single") not in precisions
    assert all(
        c["precision"] in r["label"].split(",")[0] for r, c in zip(rows, configs, strict=True) if "precision" in c
    )
    assert {r["n_light"] for r in rows} >= {32, 16}
    assert all((r["n_light"] == 32) == ("lights" not in c) for r, c in zip(rows, configs, strict=True))
    assert {r["codec"] for r in rows} == {"none", "half", "klt"}
    assert {r["n_holdout"] for r in rows} == {8}
    assert len({r["label"] for r in rows}) == len(rows)


def test_no_coding_of_a_good_model_would_be_better_and_no_larger(swept, tmp_path):
    """What was left out of each degree's best, measured here, gains no more than it was left out for."""
    folder, told = swept
    rows = told["trials"]
    assert {(r["degree"], r["codec"]) for r in rows} >= {(1, "klt"), (2, "klt")}
    usual = [r for r in rows if r["codec"] == "none" and r["n_light"] == 32 and "precision" not in r["fit_config"]]
    best = max((r for r in usual if r["degree"] == 1), key=lambda r: r["psnr_pooled_holdout"])
    words = ("--methods", best["method"], "--degrees", 1, "--codecs", "klt", "--rates", "1,0.2", "--holdout", 5)
    for coded in succeed("bench", folder / "ring.h5", *words, "--out", tmp_path / "b.h5", "--json").json["rows"]:
        within = [
            r["psnr_pooled_holdout"]
            for r in rows
            if r["encoded_bytes"] and r["encoded_bytes"] <= coded["encoded_bytes"]
        ]
        assert max(within) >= coded["psnr_pooled_holdout"] - 0.1


def test_the_answer_is_what_bench_and_fit_measure(swept, tmp_path):
    folder, told = swept
    choice = told["choice"]
    assert choice["encoded_bytes"] <= 2000
    best = max(r["psnr_pooled_holdout"] for r in told["trials"] if r["encoded_bytes"] <= 2000)
    assert choice["psnr_pooled_holdout"] == best
    (row,) = succeed("bench", folder / "t.toml", "--out", tmp_path / "b.h5", "--json").json["rows"]
    for name in set(ROW_DTYPE.names) - set(TIME_FIELDS):
        assert row[name] == choice[name] or (row[name] is None and choice[name] is None), name
    fitted = succeed("fit", folder / "ring.h5", tmp_path / "f.h5", "--config", folder / "t.toml", "--json").json
    assert (fitted["method"], fitted["degree"]) == (choice["method"], choice["degree"])
    assert (fitted["n_light"], fitted["n_holdout"]) == (choice["n_light"], 8)
    directions = arrays(folder / "ring.h5")["directions"]
    lights, _ = split_chosen(directions, 5, None if choice["n_light"] == 32 else choice["n_light"])
    np.testing.assert_array_equal(arrays(tmp_path / "f.h5")["directions"], directions[lights])


def test_going_on_measures_nothing_again(swept):
    folder, told = swept
    before = read_results(folder / "t.h5").table
    text = succeed("trade", folder / "ring.h5", "--out", folder / "t.h5", *SMALL, "--report", folder / "report").out
    np.testing.assert_array_equal(read_results(folder / "t.h5").table.tobytes(), before.tobytes())
    assert re.search(rf"^rows +{len(told['trials'])}$", text, re.MULTILINE)
    made = {path.name for path in (folder / "report").iterdir()}
    assert made == {"trade.md", "trade.html", "rows.csv", "trade.png"}
    assert len((folder / "report" / "rows.csv").read_text().splitlines()) == len(told["trials"]) + 1
    page = (folder / "report" / "trade.md").read_text()
    steps = ("bisection steps 32 → 4", "newton to its end → newton 2 steps", "mixed precision → double")
    assert all(f"| {step} " in page for step in steps)


def test_panels_of_the_chart_keep_clear_of_each_other():
    settings = [trial(10.0 ** (n - 7), 10**n, 20.0 + n) for n in range(4, 11)]  # 1 ms to 1000 s, 10 kB to 10 GB
    with canvas.house_style():
        figure = trade_chart(settings, "any")
        boxes = [axes.get_tightbbox(figure.canvas.get_renderer()) for axes in figure.axes]
    assert len(boxes) == 3
    assert [left.x1 < right.x0 for left, right in pairwise(boxes)] == [True, True]
    assert boxes[0].x0 > 0
    assert boxes[2].x1 < figure.bbox.width


def test_without_a_setting_within_the_budget_rows_and_report_stay(swept, tmp_path):
    folder, told = swept
    files = contents(folder)
    config = folder / "none.toml"
    words = ["--out", folder / "t.h5", *SMALL, "--config", config, "--min-psnr", 90, "--report", tmp_path / "report"]
    ended = call("trade", folder / "ring.h5", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert f"none of the {len(told['trials'])} settings measured is within the limits; the nearest is" in ended.err
    assert contents(folder) == files
    assert len((tmp_path / "report" / "rows.csv").read_text().splitlines()) == len(told["trials"]) + 1


def test_times_of_another_device_are_not_mixed_in(swept, tmp_path):
    earlier = read_results(swept[0] / "t.h5")
    table = earlier.table.copy()
    table["device"] = b"gpu: another"
    write_results(tmp_path / "t.h5", replace(earlier, table=table))
    before = contents(tmp_path)
    ended = call("trade", swept[0] / "ring.h5", "--out", tmp_path / "t.h5", *SMALL)
    assert (ended.code, ended.out) == (2, "")
    assert "holds times of another device (gpu: another)" in ended.err
    assert contents(tmp_path) == before


def test_the_answer_replaces_neither_the_rows_nor_a_file_of_the_user(swept, tmp_path):
    ring = swept[0] / "ring.h5"
    for words in (["--out", tmp_path / "r.toml"], ["--out", tmp_path / "t.h5", "--config", tmp_path / "t.h5"]):
        ended = call("trade", ring, *words, "--budget-bytes", "50k")
        assert (ended.code, contents(tmp_path)) == (2, {})
    (tmp_path / "grid.toml").write_text('scenes = ["ring"]')
    ended = call("trade", ring, "--out", tmp_path / "grid.h5", "--budget-bytes", "50k")
    assert ended.code == 2
    assert "was not written by trade" in ended.err
    assert contents(tmp_path).keys() == {"grid.toml"}


def test_settings_are_checked_before_anything_is_measured():
    for bad in ({"methods": ("auto",)}, {"degrees": (2, 2)}, {"rates": (0.0,)}, {"iterations": (0,)}, {"lights": (3,)},
                {"newton_steps": (0,)}, {"newton_steps": (4, 16)}, {"precisions": ("half",)}):  # fmt: skip
        with pytest.raises(InputError):
            Axes(**bad)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("trade nowhere.h5", "there is no file"),
        ("trade few.h5", "holdout 5 leaves 9 to fit: a sweep needs 10"),
        ("trade ring.h5 --holdout 41", "holdout 41 keeps no light"),
        ("trade ring.h5 --methods magic", "unknown method 'magic'"),
        ("trade ring.h5 --methods auto", "leave auto out of the methods"),
        ("trade ring.h5 --degrees 101", "degrees must be auto or 0 to 100, got 101"),
        ("trade ring.h5 --codecs zip", "unknown codec 'zip'"),
        ("trade ring.h5 --rates -1", "rate"),
        ("trade ring.h5 --iterations 0", "iterations must be 1 to"),
        ("trade ring.h5 --newton-steps 2,16", "newton steps must be at most 15, got 16"),
        ("trade ring.h5 --newton-steps 0", "iterations must be 1 to 1000, got 0"),
        ("trade ring.h5 --precisions single,half", "precision must be one of mixed, single, double, got 'half'"),
        ("trade ring.h5 --lights 33", "33 lights cannot be fitted: 32 of 40 are not held out"),
        ("trade ring.h5 --budget-seconds 0", "a budget of seconds must be above 0, got 0"),
        ("trade ring.h5 --budget-seconds -3", "above 0, got -3"),
        ("trade ring.h5 --budget-bytes 0", "is not a number of bytes"),
        ("trade ring.h5 --min-psnr nan", "the least PSNR must be a number of dB"),
        ("trade ring.h5 --config ring.h5", "that is the input"),
        ("trade ring.h5 --out no/t.h5", "there is no folder"),
        ("trade ring.h5 --report few.h5", "is a file; give a folder"),
        ("trade ring.h5 --methods uls --degrees 9", "none of uls can be fitted to ring at degree 9"),
        ("fit ring.h5 f.h5 --config two.toml", "holds 2 degrees, a fit has one"),
        ("fit ring.h5 f.h5 --config one.toml --degree 3", "--degree: "),
        ("fit ring.h5 f.h5 --config one.toml --iterations 3", "--iterations: "),
        ("fit ring.h5 f.h5 --config many.toml", "32 of 40 lights are there to be fitted, got lights 39"),
        ("fit ring.h5 one.toml --config one.toml", "that is the input"),
    ],
)
def test_refusals(swept, tmp_path, line, expected):
    made, _ = swept
    (tmp_path / "two.toml").write_text('methods = ["cls"]\ndegrees = [2, 3]\n')
    (tmp_path / "one.toml").write_text('methods = ["cls"]\ndegrees = [2]\n')
    (tmp_path / "many.toml").write_text('methods = ["cls"]\ndegrees = [2]\nholdout = 5\nlights = 39\n')
    words = [str(made / w) if (made / w).exists() else w for w in line.split()]
    words = [str(tmp_path / w) if w.endswith((".toml", "f.h5", "t.h5")) else w for w in words]
    words += ["--out", str(tmp_path / "t.h5")] if words[0] == "trade" and "--out" not in words else []
    files = contents(made), contents(tmp_path)
    ended = call(*words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended.err
    assert expected in ended.err
    assert (contents(made), contents(tmp_path)) == files


def test_a_sweep_of_a_device_without_float64(swept, tmp_path):
    from clrelight.device import Device, open_device
    from clrelight.experiment.trade import sweep_trade
    from clrelight.opencl import devices as device_module
    from clrelight.store import open_stack

    info = open_device().info
    bare = Device(replace(info, float64=False), device_module.loaded_devices()[info.index][1])
    few = {"methods": ("cls",), "degrees": (1,), "iterations": (), "newton_steps": (), "codecs": ()}
    with open_stack(swept[0] / "ring.h5") as stack:
        with pytest.raises(InputError, match="precision double needs float64, which"):
            sweep_trade(stack, "ring.h5", tmp_path / "t.h5", Axes(**few, precisions=("double",)), device=bare)
        assert contents(tmp_path) == {}
        trials = sweep_trade(stack, "ring.h5", tmp_path / "t.h5", Axes(**few), device=bare)
    assert {t.model.precision for t in trials} == {"mixed"}
