"""Experiments: what a TOML file says, resuming, refusals as rows, and the same table twice."""

import itertools
import json
import tomllib

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.experiment import Experiment, load_experiment, make_methods, make_settings, paper_experiment, run
from clrelight.experiment.bench import Bench
from clrelight.experiment.scenes import MAX_PICTURE_SIDE, shrink_picture
from clrelight.harmonics.index import coefficient_count
from clrelight.report import all_rows, summary_rows, write_report
from clrelight.results import ROW_DTYPE, TIME_FIELDS
from clrelight.sampling import make_pattern
from clrelight.store import read_results, write_stack
from tests.commands import ROOT, call, contents, succeed

SMALL = {"size": 12, "lights": 30}


def small(**changes):
    """Return an experiment of 2 x 1 x 3 rows that takes a moment."""
    settings = {"scenes": ("ring",), "degrees": (2,), "holdout": 5, "synth": {"ring": SMALL}} | changes
    settings.setdefault("methods", (*make_methods("uls", {}), *make_methods("cls", {})))
    settings.setdefault("codecs", tuple(s for name in ("none", "half", "s3tc") for s in make_settings(name, {})))
    return Experiment(**settings)


def write_toml(tmp_path, text):
    path = tmp_path / "e.toml"
    path.write_text(text)
    return path


def without_times(table):
    kept = [name for name in ROW_DTYPE.names if name not in TIME_FIELDS]
    return [tuple(row[name].item() for name in kept) for row in table]


def same(first, second):
    # NaN is not itself.
    return repr(without_times(first)) == repr(without_times(second))


def test_toml_lists_multiply_out(tmp_path):
    path = write_toml(
        tmp_path,
        """
        scenes = ["ring", "sub/stack.h5", "/abs/other.h5"]
        methods = ["cls", "uls"]
        degrees = [2, 4]
        holdout = 5
        weights = "solid-angle"
        sampling = "scattered"
        [ring]
        size = 16
        pattern = "grid"
        [method.cls]
        solver = "bisection"
        iterations = [8, 16]
        energy = [1, 0.5]
        [[codec]]
        id = "none"
        [[codec]]
        id = "wavelet"
        rate = [1, 2.0]
        allocation = ["map", "global"]
        """,
    )
    made = load_experiment(path)
    assert made.scenes == ("ring", str(tmp_path / "sub/stack.h5"), "/abs/other.h5")
    found = [(m.id, getattr(m, "iterations", None), getattr(m, "energy", None)) for m in made.methods]
    assert found == [("cls", 8, 1.0), ("cls", 8, 0.5), ("cls", 16, 1.0), ("cls", 16, 0.5), ("uls", None, None)]
    assert made.degrees == (2, 4)
    assert [(c.id, c.config.get("rate"), c.config.get("allocation")) for c in made.codecs] == [
        ("none", None, None),
        *[("wavelet", rate, allocation) for rate in (1.0, 2.0) for allocation in ("map", "global")],
    ]
    assert (made.holdout, made.weights, made.sampling) == (5, "solid-angle", "scattered")
    assert made.synth == {"ring": {"size": 16, "pattern": "grid"}}
    assert made.row_count == 3 * 5 * 2 * 5
    # 1 and 1.0 are one setting, also beside the command line's.
    assert json.dumps(made.codecs[1].config) == json.dumps(make_settings("wavelet", {"rate": 1.0})[0].config)


def test_an_empty_toml_is_the_paper_without_codecs(tmp_path):
    made = load_experiment(write_toml(tmp_path, ""))
    assert made.scenes == ("ring",)
    assert [method.id for method in made.methods] == ["uls", "sloan", "cls", "ceb"]
    assert (made.degrees, [c.id for c in made.codecs], made.holdout) == ((6,), ["none"], None)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("methods = [", "is not valid TOML"),
        ("method = 3", "method must be a table, got 3"),
        ("speed = 3", "unknown key 'speed'; known are scenes, methods, degrees"),
        ('methods = "cls"', "methods must be a list, got 'cls'"),
        ("methods = [1]", "methods must be text, got 1"),
        ("methods = []", "an experiment needs methods, got none"),
        ('methods = ["magic"]', "unknown method 'magic'; known are"),
        ('methods = ["cls", "cls"]', "methods holds cls {"),
        ('methods = ["uls", "uls"]', "methods holds uls twice"),
        ("[method.magic]\nx = 1", "unknown method 'magic'"),
        ('methods = ["uls"]\n[method.cls]\nenergy = 1', "[method.cls] has options of a method that is not among"),
        ("[method.cls]\nspeed = 1", "method cls has no option 'speed'; it has: energy, iterations, solver"),
        ('[method.cls]\nenergy = "much"', "cls: energy must be a number, got 'much'"),
        ("[method.cls]\niterations = 8.5", "cls: iterations must be a whole number, got 8.5"),
        ("[method.cls]\niterations = true", "cls: iterations must be a whole number, got True"),
        ("[method.cls]\niterations = [32, 32]", "twice"),
        ("[method.cls]\niterations = []", "iterations needs at least one value"),
        ("[method.cls]\nenergy = nan", "positive factor on E_c, got nan"),
        ("degrees = [4.0]", "degrees must be whole numbers or 'auto', got 4.0"),
        ("degrees = [101]", "degrees must be auto or 0 to 100, got 101"),
        ("degrees = [2, 2]", "degrees holds 2 twice"),
        ("degrees = 4", "degrees must be a list, got 4"),
        ("holdout = 1", "holdout must be at least 2"),
        ("holdout = true", "holdout must be a whole number, got True"),
        ("holdout = 100000000000000", "holdout 100000000000000 is too large"),
        ('weights = "heavy"', "weights must be one of uniform, solid-angle, got 'heavy'"),
        ('sampling = "poor"', "sampling must be one of hemisphere, scattered, got 'poor'"),
        ("scenes = []", "an experiment needs scenes"),
        ("scenes = [3]", "scenes must be text, got 3"),
        ('scenes = ["ring", "ring"]', "scenes holds 'ring' twice"),
        ("[ring]\nspeed = 3", "ring has no option 'speed'; it has: size, lights, pattern, seed, dtype"),
        ('[ring]\nsize = "big"', "size must be a whole number, got 'big'"),
        ('scenes = ["a.h5"]\n[ring]\nsize = 16', "[ring] has options of a scene that is not among"),
        ("[[codec]]\nbits = 3", "every [[codec]] needs an id"),
        ("[codec]\nid = 'none'", "codec must be a list"),
        ("[[codec]]\nid = 'zip'", "unknown codec 'zip'; known are"),
        ("[[codec]]\nid = 'none'\nbits = 3", "codec 'none' has no options, got bits"),
        ("[[codec]]\nid = 'uniform'\nspeed = 3", "codec uniform has no option 'speed'; it has: bits"),
        ("[[codec]]\nid = 'uniform'\nbits = [8, 99]", "1 to 16, got 99"),
        ("[[codec]]\nid = 'uniform'\nbits = '8'", "uniform: bits must be a whole number, got '8'"),
        ("[[codec]]\nid = 'klt'\nrate = 'low'", "klt: rate must be a number, got 'low'"),
        ("[[codec]]\nid = 'half'\n[[codec]]\nid = 'half'", "codecs holds half {'clamp': False} twice"),
    ],
)
def test_toml_mistakes_are_named(tmp_path, text, expected):
    path = write_toml(tmp_path, text)
    with pytest.raises(InputError) as error:
        load_experiment(path)
    assert expected in str(error.value)
    assert str(error.value).startswith(str(path))
    ended = call("bench", path, "--out", tmp_path / "r.h5")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert contents(tmp_path).keys() == {"e.toml"}


def test_toml_takes_no_grid_options(tmp_path):
    path = write_toml(tmp_path, "")
    for words in (["--methods", "cls"], ["--holdout", "5"], ["--size", "16"]):
        ended = call("bench", path, "--out", tmp_path / "r.h5", *words)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert words[0] in ended.err
    ended = call("bench", path, "--out", path, "--force")
    assert "that is the input" in ended.err
    assert path.read_text() == ""


def test_missing_scene_is_found_before_anything_is_measured(tmp_path):
    path = write_toml(tmp_path, 'scenes = ["ring", "gone.h5"]\n[ring]\nsize = 12\nlights = 60')
    ended = call("bench", path, "--out", tmp_path / "r.h5")
    assert (ended.code, ended.err) == (2, f"clrelight: there is no file {tmp_path / 'gone.h5'}\n")
    assert contents(tmp_path).keys() == {"e.toml"}


def test_the_example_runs_as_written(tmp_path):
    """examples/grid.toml, with the stack that its first comment makes."""
    text = (ROOT / "examples" / "grid.toml").read_text()
    (tmp_path / "grid.toml").write_text(text)
    comment = next(line for line in text.splitlines() if "clrelight synth" in line)
    words = comment.split("clrelight ")[1].replace("examples/", f"{tmp_path}/").split()
    succeed(*words)
    table = succeed("bench", tmp_path / "grid.toml", "--out", tmp_path / "r.h5", "--json").json["rows"]
    given = tomllib.loads(text)
    assert len(table) == int(text.split("= ")[1].split(" rows")[0]) == 72
    made = {
        (r["scene"], r["method"], json.loads(r["fit_config"]).get("iterations"), r["degree"], r["codec"], r["rate"])
        for r in table
    }
    methods = [("uls", None), *[("cls", n) for n in given["method"]["cls"]["iterations"]]]
    codecs = [("none", None), ("half", None), ("s3tc", None), *[("uniform", bits) for bits in (4, 6, 8)]]
    assert made == {
        (scene, *method, degree, *codec)
        for scene, method, degree, codec in itertools.product(
            ("scattered-ring", "ring"), methods, given["degrees"], codecs
        )
    }
    assert {(r["n_light"], r["n_holdout"]) for r in table} == {(52, 12)}
    # Rows that differ in an option only are told apart.
    headers, rows = summary_rows(read_results(tmp_path / "r.h5"))
    assert {row[headers.index("options")] for row in rows} == {"", "iterations=8", "iterations=32"}
    shown = [tuple(row[: headers.index("bits per coeff.")]) for row in rows]
    assert len(set(shown)) == 72
    assert len(set(all_rows(read_results(tmp_path / "r.h5")).values("options"))) == 3


def test_resume_measures_nothing_twice(tmp_path, monkeypatch):
    out = tmp_path / "r.h5"
    measure, count = Bench.measure, 0

    def stop_at_the_fourth(self, *arguments):
        nonlocal count
        count += 1
        if count == 4:
            raise KeyboardInterrupt
        return measure(self, *arguments)

    monkeypatch.setattr(Bench, "measure", stop_at_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        run.run_experiment(small(), out)
    first = read_results(out).table
    assert len(first) == 3
    steps = []
    second = run.run_experiment(small(), out, progress=lambda *step: steps.append(step)).table
    assert count == 4 + 3
    assert second[:3].tobytes() == first.tobytes()
    assert [(row["method"], row["codec"]) for row in second] == [
        (method, codec) for method in (b"uls", b"cls") for codec in (b"none", b"half", b"s3tc")
    ]
    assert steps[-1] == ("done", 6, 6)
    assert [step[1] for step in steps] == sorted(step[1] for step in steps)
    # All there: nothing is measured, and the file is not touched.
    before = contents(tmp_path)
    third = run.run_experiment(small(), out).table
    assert (count, third.tobytes()) == (7, second.tobytes())
    assert contents(tmp_path) == before
    # More of it: only the new rows.
    run.run_experiment(small(degrees=(2, 3)), out)
    assert count == 7 + 6
    assert read_results(out).table[:6].tobytes() == second.tobytes()
    run.run_experiment(small(), out, force=True)
    assert count == 13 + 6
    assert len(read_results(out).table) == 6


def test_two_runs_give_the_same_rows_and_pictures(tmp_path):
    for name in ("a", "b"):
        run.run_experiment(small(), tmp_path / f"{name}.h5")
    a, b = (read_results(tmp_path / f"{name}.h5") for name in ("a", "b"))
    assert same(a.table, b.table)
    for held_a, held_b in ((a.pictures, b.pictures), (a.profiles, b.profiles)):
        assert list(held_a) == list(held_b)
        for key in held_a:
            np.testing.assert_array_equal(held_a[key], held_b[key])
    assert set(a.pictures) == {"ring/reference"} | {
        f"ring/{method}/2/{codec}" for method in ("uls", "cls") for codec in ("none", "half", "s3tc")
    }
    assert set(a.profiles) == {"ring/uls/2", "ring/cls/2"}
    assert a.profiles["ring/cls/2"].shape == (9,)


def constant_stack(value, name="x", n_light=20):
    images = np.full((n_light, 6, 5, 3), value, np.float32)
    return LightStack(images, make_pattern("uniform", n_light), 1.0, name=name)


def test_another_stack_of_the_same_name_is_refused(tmp_path):
    write_stack(tmp_path / "s.h5", constant_stack(0.25))
    one = small(scenes=(str(tmp_path / "s.h5"),), synth={})
    run.run_experiment(one, tmp_path / "r.h5")
    before = contents(tmp_path)["r.h5"]
    write_stack(tmp_path / "s.h5", constant_stack(0.26))
    with pytest.raises(InputError, match="another stack that is named 'x' too"):
        run.run_experiment(one, tmp_path / "r.h5")
    assert contents(tmp_path)["r.h5"] == before
    write_stack(tmp_path / "s.h5", constant_stack(0.25))
    run.run_experiment(one, tmp_path / "r.h5")
    assert contents(tmp_path)["r.h5"] == before


def test_another_ring_is_not_taken_for_measured(tmp_path):
    run.run_experiment(small(), tmp_path / "r.h5")
    for change in ({"seed": 1}, {"size": 16}, {"lights": 35}):
        with pytest.raises(InputError, match="another stack that is named 'ring' too"):
            run.run_experiment(small(synth={"ring": SMALL | change}), tmp_path / "r.h5")
    run.run_experiment(small(synth={"ring": SMALL | {"pattern": "scattered"}}), tmp_path / "r.h5")
    run.run_experiment(small(synth={"ring": SMALL | {"dtype": "float16"}}), tmp_path / "r.h5")
    names = [row["scene"].decode() for row in read_results(tmp_path / "r.h5").table]
    assert names == ["ring"] * 6 + ["scattered-ring"] * 6 + ["float16-ring"] * 6


def test_two_scenes_of_one_name_are_refused(tmp_path):
    for name, value in (("a", 0.25), ("b", 0.5)):
        write_stack(tmp_path / f"{name}.h5", constant_stack(value, "same"))
    scenes = (str(tmp_path / "a.h5"), str(tmp_path / "b.h5"))
    with pytest.raises(InputError, match=r"a.h5 and .*b.h5 are both named 'same': ingest one with another --name"):
        run.run_experiment(small(scenes=scenes, synth={}), tmp_path / "r.h5")
    assert "r.h5" not in contents(tmp_path)


def test_a_fit_that_refuses_leaves_a_row(tmp_path):
    ended = call(
        "bench", "ring", "--size", 12, "--lights", 20, "--methods", "uls,cls", "--degrees", "3,4", "--codecs",
        "none,s3tc", "--out", tmp_path / "r.h5", "--json",
    )  # fmt: skip
    assert (ended.code, ended.err) == (0, "")
    rows = {(row["method"], row["degree"], row["codec"]): row for row in ended.json["rows"]}
    assert len(rows) == 8
    for key, row in rows.items():
        refused = key[:2] == ("uls", 4)
        assert bool(row["note"]) == refused
        assert (row["psnr_mean"] is None) == refused
        assert (row["bits_per_coefficient"] is None) == refused
        assert row["n_coeff"] == coefficient_count(key[1])
    assert "20 lights: degree 3 is the largest that fits" in rows["uls", 4, "none"]["note"]
    text = call("bench", "ring", "--size", 12, "--lights", 20, "--methods", "uls,cls", "--degrees", "3,4", "--codecs",
                "none,s3tc", "--out", tmp_path / "r.h5")  # fmt: skip
    assert text.err.startswith("note: ring, uls degree 4, none, s3tc: uls at degree 4 has 25 coefficients but")
    assert text.err.count("\n") == 1
    succeed("report", tmp_path / "r.h5", "--out", tmp_path / "report")


def test_a_codec_that_refuses_leaves_a_row(tmp_path):
    """ULS on lights of a narrow cap gives coefficients beyond what half holds."""
    rng = np.random.default_rng(2)
    radius, azimuth = 0.1 * np.sqrt(rng.random(60)), 2 * np.pi * rng.random(60)
    directions = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2)], axis=1)
    stack = LightStack(rng.random((60, 6, 5, 3)).astype(np.float32), directions, 1.0, name="cap")
    write_stack(tmp_path / "cap.h5", stack)
    words = ["bench", tmp_path / "cap.h5", "--methods", "uls,cls", "--degrees", 2, "--codecs", "none,half,s3tc"]
    ended = call(*words, "--out", tmp_path / "r.h5", "--json")
    rows = {(row["method"], row["codec"]): row for row in ended.json["rows"]}
    assert len(rows) == 6
    refused = rows["uls", "half"]
    assert "binary16 cannot hold" in refused["note"]
    assert (refused["psnr_mean"], refused["psnr_pooled"], refused["bits_per_coefficient"]) == (None, None, None)
    assert refused["mean_energy"] > 65504**2 / 100
    assert all(row["psnr_mean"] is not None and row["note"] == "" for key, row in rows.items() if row is not refused)
    text = call(*words, "--out", tmp_path / "r.h5")
    assert text.err.startswith("note: cap, uls degree 2, half: coefficient (k, row, column, channel) = ")
    line = next(line for line in text.out.splitlines() if "half" in line)
    assert line.split()[5:8] == ["–", "–", "–"]
    write_report(read_results(tmp_path / "r.h5"), tmp_path / "report")


def test_paper_experiment():
    made = paper_experiment()
    assert [method.id for method in made.methods] == ["uls", "sloan", "cls", "ceb"]
    assert [(c.id, c.rate) for c in made.codecs[4:]] == [("wavelet", r) for r in (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)]
    assert [c.id for c in made.codecs[:4]] == ["none", "half", "s3tc", "uniform"]
    assert [c.id for c in made.codecs if not c.is_pictured] == ["wavelet"] * 4
    rated = paper_experiment(codecs=("klt", "half", "wavelet"), rates=(0.5, 1.0))
    assert [(c.id, c.config.get("rate")) for c in rated.codecs] == [
        ("klt", 0.5), ("klt", 1.0), ("half", None), ("wavelet", 0.5), ("wavelet", 1.0),
    ]  # fmt: skip


def test_pictures_are_shrunk_by_averaging_blocks():
    image = np.zeros((2 * MAX_PICTURE_SIDE + 1, 6, 1), np.uint8)
    image[:3, :3] = 90
    small_one = shrink_picture(image)
    assert small_one.shape == (len(image) // 3, 2, 1)
    assert small_one[0, 0, 0] == 90
    assert small_one[1:].max() == small_one[:, 1].max() == 0
    assert shrink_picture(image[:MAX_PICTURE_SIDE]) is not None
    np.testing.assert_array_equal(shrink_picture(image[:MAX_PICTURE_SIDE]), image[:MAX_PICTURE_SIDE])
