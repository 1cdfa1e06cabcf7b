"""``bench --speed`` from end to end, its parts, and what it refuses; no test depends on what time anything takes."""

import csv
import io
import itertools
import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from PIL import Image

from benchmarks import growth as growth_page
from benchmarks import startup
from benchmarks.pages import check_markdown
from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.sampling import make_pattern
from clrelight.speed import growth_tables, peer_stages, run, scene
from clrelight.speed.job import NUMPY, OURS, STAGES, TOTAL
from clrelight.speed.plan import Point, choose_growth, full_growth
from clrelight.speed.record import read_record, write_record
from clrelight.speed.timing import interleave
from tests.commands import call, command_line, contents, environment, succeed

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """A run of the command: its folder, and what it printed."""
    folder = tmp_path_factory.mktemp("speed")
    words = ["--quick", "--sizes", 16, "--threads", 1, "--out", folder / "speed.json", "--report", folder / "report"]
    return folder, succeed("bench", "--speed", *words, "--json").json


def test_end_to_end_leaves_a_record_and_a_report(measured):
    folder, printed = measured
    assert set(contents(folder)) == {"speed.json"} | {
        f"report/{name}" for name in ("speed.md", "points.csv", "stages.csv", "seconds.png", "memory.png")
    }
    record = read_record(folder / "speed.json")
    assert printed["points"] == record["points"]
    assert [(point["size"], point["threads"]) for point in record["points"]] == [(16, None), (16, 1)]
    assert record["environment"]["command"] == "clrelight bench --speed --quick --sizes 16 --threads 1 --rounds 1"
    for name in ("machine", "device", "driver", "versions", "load", "peak"):
        assert record["environment"][name]


def test_times_of_stages_add_up_and_are_ordered(measured):
    for point in measured[1]["points"]:
        for way in (OURS, NUMPY):
            times = point["seconds"][way]
            assert set(times) == {*STAGES, TOTAL}
            for low, middle, high in times.values():
                assert 0 < low <= middle <= high
            # One round: its parts are the whole.
            assert sum(times[stage][1] for stage in STAGES) == pytest.approx(times[TOTAL][1])
        ratio = point["seconds"][NUMPY][TOTAL][1] / point["seconds"][OURS][TOTAL][1]
        assert point["speed"][TOTAL][1] == pytest.approx(ratio)


def test_numpy_finds_what_we_find(measured):
    for point in measured[1]["points"]:
        assert point["psnr"][OURS] == pytest.approx(point["psnr"][NUMPY], abs=1e-3)
        assert 15 < point["psnr"][OURS] < 60


def test_memory_and_bytes_are_those_of_processes_and_files(measured):
    for point in measured[1]["points"]:
        assert all(20e6 < point["memory"][way] < 2e9 for way in (OURS, NUMPY))
        assert point["bytes"]["stack"] > 2 * 16 * 16**2
        assert point["bytes"]["fit"] > 4 * 9 * 16**2
        assert 2 * 9 * 16**2 < point["bytes"]["encoded"] < point["bytes"]["fit"]


def test_stages_of_other_libraries_agree_with_ours(measured):
    rows = measured[1]["stages"]
    peers = " ".join(row["peer"] for row in rows)
    assert "brentq" in peers
    assert "cho_solve" in peers
    assert ("PyWavelets" in peers) == (peer_stages.missing_peers() == [])
    for row in rows:
        assert 0 <= row["error"] < 1e-5
        assert 0 <= row["peer_error"] < 1e-5


def test_tables_hold_the_figures(measured):
    folder, printed = measured
    rows = list(csv.DictReader(io.StringIO((folder / "report" / "points.csv").read_text())))
    assert len(rows) == len(printed["points"])
    for row, point in zip(rows, printed["points"], strict=True):
        assert float(row["ours_total_seconds_median"]) == point["seconds"][OURS][TOTAL][1]
        assert int(row["numpy_memory_bytes"]) == point["memory"][NUMPY]
        assert row["note"] == ""
    assert len(list(csv.DictReader(io.StringIO((folder / "report" / "stages.csv").read_text())))) == len(
        printed["stages"]
    )
    text = (folder / "report" / "speed.md").read_text()
    tables = [line for line in text.splitlines() if line.startswith("|")]
    assert len(tables) == 4 + len(printed["points"]) + len(printed["stages"])
    assert {line.count("|") - 1 for line in tables} == {len(growth_tables.HEADERS), len(growth_tables.STAGE_HEADERS)}
    for picture in ("seconds.png", "memory.png"):
        assert f"({picture})" in text
        with Image.open(folder / "report" / picture) as image:
            assert len(set(image.convert("L").tobytes())) > 20


def test_report_draws_a_record_again(measured, tmp_path):
    ended = succeed("report", measured[0] / "speed.json", "--out", tmp_path / "again")
    assert str(tmp_path / "again" / "speed.md") in ended.out
    assert contents(tmp_path / "again") == contents(measured[0] / "report")
    (tmp_path / "r.json").write_text("{}")
    ended = call("report", tmp_path / "r.json", "--out", tmp_path / "no")
    assert (ended.code, ended.err.count("\n"), (tmp_path / "no").exists()) == (2, 1, False)


def test_a_point_that_failed_keeps_its_place_with_a_note(measured, tmp_path):
    record = read_record(measured[0] / "speed.json")
    record["points"][1] = {**record["base"], "threads": 1, "note": "the process was killed: not enough memory"}
    write_record(tmp_path / "failed.json", record)
    again = read_record(tmp_path / "failed.json")
    assert growth_tables.points_markdown(again).splitlines()[-1].endswith("not enough memory |")
    assert growth_tables.points_csv(again).splitlines()[-1].endswith(",the process was killed: not enough memory")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--speed stack.h5", "--speed makes its own pictures: leave out stack.h5"),
        ("--speed --sizes abc", "one or more whole numbers separated by commas"),
        ("--speed --sizes 64,", "one or more whole numbers"),
        ("--speed --sizes 0", "sizes must be 1 to 16384, got 0"),
        ("--speed --sizes 64,1e9", "whole numbers"),
        ("--speed --sizes 20000", "sizes must be 1 to 16384, got 20000"),
        ("--speed --sizes 16,16", "sizes must differ, got 16,16: one is there twice"),
        ("--speed --lights 0", "lights must be 1 to 4096, got 0"),
        ("--speed --degrees 4,-1", "degrees must be 0 to 100, got -1"),
        ("--speed --threads 0", "threads must be 1 to 1024, got 0"),
        ("--speed --rounds 0", "0 is not in the range"),
        ("--speed --rounds 5000", "rounds must be 1 to 1000, got 5000"),
        ("--speed --memory much", "'much' is not a number of bytes"),
        ("--speed --methods cls", "--methods is an option of experiments, not of --speed"),
        ("--speed --force", "--force is an option of experiments, not of --speed"),
        ("--speed --out speed.h5", "--out must end in .json, got speed.h5"),
        ("--speed --out no/speed.json", "there is no folder no"),
        ("--speed --report stack.h5", "stack.h5 is a file"),
        ("--speed --quick --device warp", "no OpenCL device matches 'warp'"),
        ("ring --rounds 3", "--rounds is an option of --speed"),
        ("ring --quick", "--quick is an option of --speed"),
        ("ring --report folder", "--report is an option of --speed"),
        ("ring --lights 16,32", "--lights must be one number of at least 1, got 16,32"),
        ("", "Missing argument"),
    ],
)
def test_bad_input_is_one_line(words, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("stack.h5").write_bytes(b"precious")
    Path("speed.json").write_bytes(b"old")
    ended = call("bench", *words.split())
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert expected in ended.err
    assert contents(tmp_path) == {"stack.h5": b"precious", "speed.json": b"old"}


def test_a_report_without_matplotlib_is_refused_before_work(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    ended = call("bench", "--speed", "--out", tmp_path / "speed.json", "--report", tmp_path / "report")
    assert (ended.code, ended.out) == (2, "")
    assert "pip install 'clrelight[report]'" in ended.err
    assert contents(tmp_path) == {}


def test_a_full_disk_is_told_before_work(tmp_path, monkeypatch):
    asked = []

    def disk_usage(folder):
        asked.append(folder)
        return SimpleNamespace(free=32**2 * 16 * 2)  # the samples of the largest stack, and no fit of it

    monkeypatch.setattr(shutil, "disk_usage", disk_usage)
    monkeypatch.setattr(run, "run_child", lambda *_: pytest.fail("work has begun"))
    ended = call("bench", "--speed", "--quick", "--out", tmp_path / "speed.json")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert "the largest picture needs" in ended.err
    assert asked == [tmp_path]
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_during_work_costs_only_the_points_it_has_no_room_for(tmp_path, monkeypatch):
    def write_scene(path, size, lights):
        if size == 32:
            raise InputError("cannot write: the disk is full")

    def run_child(task, threads=None):
        return {"environment": {}} if task["kind"] == "machine" else {"memory": 1}

    monkeypatch.setattr(run, "write_scene", write_scene)
    monkeypatch.setattr(run, "run_child", run_child)
    record = run.measure_growth(choose_growth(quick=True, rounds=None), tmp_path, memory=1 << 20)
    assert {point["size"] for point in record["points"]} == {16, 32}
    for point in record["points"]:
        assert point.get("note") == ("cannot write: the disk is full" if point["size"] == 32 else None)
        assert ("memory" in point) == (point["size"] == 16)


def test_a_point_that_failed_leaves_no_files_to_the_next(tmp_path, monkeypatch):
    def run_child(task, threads=None):
        assert not (Path(task["folder"]) / OURS).exists()
        (Path(task["folder"]) / OURS).mkdir()
        raise InputError("the disk is full")

    monkeypatch.setattr(run, "run_child", run_child)
    for _ in range(2):
        with pytest.raises(InputError, match="the disk is full"):
            run._measure({}, Point(16, 16, 2), tmp_path / "stack.h5", tmp_path)


def test_the_command_of_a_record_measures_the_same():
    growth = choose_growth(quick=True, rounds=3, size=(16,))
    words = "clrelight bench --speed --quick --sizes 16 --rounds 3"
    assert growth.command(DEFAULT_MEMORY, None) == words
    assert growth.command(1 << 20, "pocl") == f"{words} --memory 1048576 --device pocl"
    assert growth.command(DEFAULT_MEMORY, "Xeon Processor") == f"{words} --device 'Xeon Processor'"


def test_interrupt_ends_the_children_and_leaves_the_old_record(tmp_path):
    (tmp_path / "speed.json").write_bytes(b"precious")
    words = command_line("bench", "--speed", "--quick", "--out", tmp_path / "speed.json")
    started = subprocess.Popen(
        words, cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        since = time.monotonic()
        while not children_in(tmp_path) and started.poll() is None and time.monotonic() - since < 60:
            time.sleep(0.01)
        assert started.poll() is None, started.communicate()
        started.send_signal(signal.SIGINT)
        out, err = started.communicate(timeout=60)
    finally:
        started.kill()
    assert (started.returncode, out) == (130, "")
    assert err == "clrelight: interrupted; files that were not finished are discarded\n"
    assert contents(tmp_path) == {"speed.json": b"precious"}
    assert children_in(tmp_path) == []


def children_in(folder):
    """Return the processes that measure something in a folder."""
    found = []
    for line in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = line.read_bytes()
        except OSError:  # it has just ended
            continue
        if b"clrelight.speed.child" in words and str(folder).encode() in words:
            found.append(line)
    return found


def test_only_the_named_axes_are_varied():
    assert choose_growth(quick=False, rounds=None) == full_growth()
    points = choose_growth(quick=False, rounds=2, degree=(6, 2)).points()
    assert points == [Point(256, 64, 2), Point(256, 64, 6)]
    growth = choose_growth(quick=True, rounds=None, size=(8, 16), threads=(2,))
    assert growth.rounds == 1
    assert growth.points() == [Point(8, 16, 2), Point(16, 16, 2), Point(16, 16, 2, threads=2)]


def test_each_point_is_measured_once():
    points = full_growth().points()
    assert len(set(points)) == len(points)
    stacks = [(point.size, point.lights) for point in points]
    assert sum(a != b for a, b in itertools.pairwise(stacks)) == len(set(stacks)) - 1
    assert Point(4096, 64, 4) in points


@pytest.mark.parametrize("size", [5, 64, 70])
def test_scene_is_tiled_and_the_same_each_time(tmp_path, size):
    for name in ("a.h5", "b.h5"):
        scene.write_scene(tmp_path / name, size, 9)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
    with h5py.File(tmp_path / "a.h5") as file:
        images, directions = file["images"][...], file["directions"][...]
    assert (images.shape, images.dtype) == ((9, size, size, 1), np.float16)
    assert 0 <= images.min() < images.max() <= 1
    tiles = scene.make_tiles(directions, min(size, 64))
    for row in range(0, size, 64):
        for column in range(0, size, 64):
            piece = images[:, row : row + 64, column : column + 64, 0]
            assert any((piece == tile[:, : piece.shape[1], : piece.shape[2]]).all() for tile in tiles)


def test_scene_has_shadows_where_the_ring_stands_in_the_way():
    low, above = np.array([[np.cos(0.2), 0.0, np.sin(0.2)]]), np.array([[0.0, 0.0, 1.0]])
    image, bright = (scene.make_tiles(light, 64)[0, 0].astype(float) for light in (low, above))
    # The middle of the plane, and the plane beyond the ring on the side away from the light.
    assert image[32, 32] < 0.02
    assert image[32, 3] < 0.02
    assert image[3, 32] == pytest.approx(0.35 * np.sin(0.2), abs=0.02)
    assert bright.min() > 0.03  # the noise is at most 0.01


def test_scene_is_made_in_streams(tmp_path, monkeypatch):
    """Whatever rows come at a time, the picture is the same."""
    scene.write_scene(tmp_path / "whole.h5", 70, 4)
    monkeypatch.setattr("clrelight.store.writing.CHUNK_BYTES", 4 * 70 * 2 * 3)
    scene.write_scene(tmp_path / "streamed.h5", 70, 4)
    with h5py.File(tmp_path / "whole.h5") as whole, h5py.File(tmp_path / "streamed.h5") as streamed:
        assert streamed["images"].chunks[1] == 3
        np.testing.assert_array_equal(whole["images"][...], streamed["images"][...])


def test_first_runs_that_were_made_are_not_made_again():
    calls = []
    timings = interleave(
        {"a": lambda: calls.append("a"), "b": lambda: calls.append("b")},
        finish=lambda: None,
        rounds=5,
        most_seconds=2.0,
        least_seconds=0.0,
        settle_seconds=0.0,
        first={"a": 0.75, "b": 0.25},
        fewest_rounds=1,
    )
    assert calls == ["a", "b", "b", "a"]
    assert timings.first == {"a": 0.75, "b": 0.25}


def test_missing_pywavelets_is_a_note(monkeypatch):
    monkeypatch.setattr(peer_stages.importlib.util, "find_spec", lambda name: None)
    (note,) = peer_stages.missing_peers()
    assert "pip install 'clrelight[speed]'" in note


@pytest.mark.parametrize("text", ["", "[]", '{"a": 1}', '{"clrelight_schema": "speed/9"}'])
def test_a_file_that_is_no_record_is_refused(tmp_path, text):
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InputError, match=r"is no record|expected speed/1"):
        read_record(tmp_path / "r.json")
    with pytest.raises(InputError, match="there is no file"):
        read_record(tmp_path / "nowhere.json")


@pytest.mark.parametrize(
    ("change", "expected"),
    [({name: ...}, f"the file has no {name}") for name in ("environment", "stages", "notes", "base", "axes", "points")]
    + [
        ({"environment": []}, "environment is no object"),
        ({"stages": {}}, "stages is no list"),
        ({"stages": [{}]}, "an item of stages has no name"),
        ({"notes": [1]}, "an item of notes is 1"),
        ({"base": {"size": 16}}, "base has no lights"),
        ({"axes": {}}, "axes has no size"),
        ({"points": [{}]}, "an item of points has no size"),
        ({"points": None}, "points is no list"),
    ],
)
def test_a_record_that_lacks_something_is_refused(measured, tmp_path, change, expected):
    record = json.loads((measured[0] / "speed.json").read_text()) | change
    record = {name: value for name, value in record.items() if value is not ...}
    (tmp_path / "r.json").write_text(json.dumps(record))
    ended = call("report", tmp_path / "r.json", "--out", tmp_path / "no")
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert expected in ended.err
    assert not (tmp_path / "no").exists()


@pytest.mark.parametrize("name", ["rounds", "seconds", "memory", "psnr", "bytes"])
def test_a_point_that_lacks_something_is_refused(measured, tmp_path, name):
    record = read_record(measured[0] / "speed.json")
    write_record(tmp_path / "whole.json", record)
    assert read_record(tmp_path / "whole.json") == record
    for value in (..., {"ours": {"total": [1.0]}}, {"ours": None, "other": 1}, "text"):
        point = {**record["points"][0], name: value}
        points = [{key: held for key, held in point.items() if held is not ...}]
        write_record(tmp_path / "r.json", {**record, "points": points})
        with pytest.raises(InputError, match="is no whole record"):
            read_record(tmp_path / "r.json")


def test_a_fit_starts_without_scipy(tmp_path):
    scene.write_scene(tmp_path / "s.h5", 8, 16)
    code = (
        "import sys; from clrelight.cli.app import run; "
        "code = run(['fit', 's.h5', 'f.h5', '--degree', '2', '--json']); "
        "print([name for name in ('scipy', 'matplotlib', 'OpenImageIO', 'rich') if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True
    )
    assert json.loads(done.stdout.splitlines()[0])["degree"] == 2
    assert done.stdout.splitlines()[1] == "[]"


def test_startup_lists_imports(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    rows = startup.slow_imports("--help")
    assert len(rows) == 8
    assert [float(milliseconds) for _, milliseconds in rows] == sorted((float(m) for _, m in rows), reverse=True)
    assert "clrelight.cli" in [name for name, _ in rows]


def test_the_page_has_its_markers():
    check_markdown(ROOT / "docs" / "performance.md", growth_page.BEGIN, growth_page.END)


def test_directions_are_those_of_the_uniform_pattern(tmp_path):
    scene.write_scene(tmp_path / "s.h5", 4, 12)
    with h5py.File(tmp_path / "s.h5") as file:
        np.testing.assert_array_equal(file["directions"][...], make_pattern("uniform", 12))
