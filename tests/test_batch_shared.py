"""`decode`, `unpack` and `psnr` with parts done by workers: what one process makes, bit for bit."""

import os

import numpy as np
import pytest

from clrelight import metrics
from clrelight.batch import cluster, farm, farmed, make_tasks, read_listing
from clrelight.batch.single import run_single
from clrelight.batch.tiles import run_tiles
from clrelight.codec import encode
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.wavelet import Wavelet
from clrelight.dataset import FitRecord, LightStack
from clrelight.device import open_device
from clrelight.errors import InputError
from clrelight.jobs import farm as jobs_farm
from clrelight.jobs import fitting, frames
from clrelight.jobs import measure as measuring
from clrelight.jobs.decode import decode
from clrelight.jobs.fit import fit
from clrelight.jobs.measure import measure
from clrelight.jobs.relight import relight
from clrelight.jobs.report import Report
from clrelight.jobs.unpack import unpack
from clrelight.lighting.light import Light
from clrelight.results import TIME_FIELDS
from clrelight.sampling import make_pattern
from clrelight.store import read_fit, read_results, write_encoded, write_light, write_stack
from tests.batches import make_stacks, strays_in
from tests.commands import call, succeed
from tests.test_batch import Here
from tests.test_batch_pack import Failing

HEIGHT, WIDTH = 1100, 200
DIRECTIONS = make_pattern("uniform", 7)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Encodings of a smooth map with noise, and photographs that are not far from it."""
    folder = tmp_path_factory.mktemp("shared") / "in"
    folder.mkdir()
    rng = np.random.default_rng(3)
    y, x = np.mgrid[0 : 3 : HEIGHT * 1j, 0 : 1 : WIDTH * 1j]
    base = np.stack([1.5 + np.sin(9 * x * y), 0.3 * np.cos(8 * y), 0.2 * x, 0.1 * np.sin(20 * x)])
    coeffs = (base + 0.01 * rng.standard_normal(base.shape)).astype(np.float32)[..., None]
    fit = FitRecord(1, "spline", 255.0, "linear", DIRECTIONS, {}, "s").to_map(coeffs)
    device = open_device()
    for name, codec in (("klt", Klt(rate=1.0)), ("wavelet", Wavelet(rate=1.0))):
        write_encoded(folder / f"{name}.h5", encode(coeffs, codec, device), fit)
    images = rng.integers(0, 256, (7, HEIGHT, WIDTH, 1), np.uint8)
    write_stack(folder.parent / "stack.h5", LightStack(images, DIRECTIONS, 255.0, name="s"))
    return folder


@pytest.mark.parametrize("name", ["klt", "wavelet"])
def test_decoding_in_tiles(files, tmp_path, name):
    decode(files / f"{name}.h5", out=tmp_path / "one.h5", report=Report())
    tasks = make_tasks(read_listing(files, "decode", match=(name,)), tmp_path / "out", job="decode")
    for virtual in (False, True):
        engine = Here()
        batch = run_tiles(tasks, tmp_path / "out", rows=512, virtual=virtual, engine=engine, report=Report(), anew=True)
        assert not batch.failed, batch.failed
        assert [each for each in engine.begun if "@" in each] == [f"{name}@{row:06d}" for row in (0, 512, 1024)]
        made = tmp_path / "out" / f"{name}.h5"
        assert (made.read_bytes() == (tmp_path / "one.h5").read_bytes()) != virtual
        assert np.array_equal(read_fit(made).coeffs_khwc, read_fit(tmp_path / "one.h5").coeffs_khwc)
    assert strays_in(tmp_path / "out") == []


def test_decoding_by_its_command(files, tmp_path):
    alone = succeed("decode", files / "klt.h5", tmp_path / "one.h5", "--json").json
    told = succeed("decode", files / "klt.h5", tmp_path / "two.h5", "--jobs", 1, "--json").json
    assert told["device"] == alone["device"]
    for each in (alone, told):  # which are of stages of another kind
        del each["seconds"]
    assert told == {**alone, "file": str(tmp_path / "two.h5")}
    assert (tmp_path / "two.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
    assert sorted(os.listdir(tmp_path)) == ["one.h5", "two.h5"]
    with pytest.raises(InputError, match="region is not for a decode that several workers share"):
        run_single("decode", files / "klt.h5", tmp_path / "x.h5", options={"region": (0, 0, 9, 9)}, engine=Here())


@pytest.mark.parametrize("kind", ["png", "exr"])
def test_photographs_from_parts(files, tmp_path, kind):
    unpack(files / "klt.h5", tmp_path / "one", kind=kind, memory="1MiB", report=Report())
    options, report = {"kind": kind, "memory": "1MiB"}, Report()
    engine = Failing("*@unpack-light-*")
    with pytest.raises(InputError, match="unpack-light"):
        run_single("unpack", files / "klt.h5", tmp_path / "two", options=options, engine=engine, report=Report())
    engine = Here()
    run_single("unpack", files / "klt.h5", tmp_path / "two", options=options, engine=engine, report=report)
    assert not any("@unpack-part-" in name for name in engine.begun)  # those were done
    found = {name: (tmp_path / "two" / name).read_bytes() for name in os.listdir(tmp_path / "two")}
    assert found == {name: (tmp_path / "one" / name).read_bytes() for name in os.listdir(tmp_path / "one")}
    assert sorted(found) == sorted(os.path.basename(path) for path in report.facts["files"])
    assert sorted(os.listdir(tmp_path)) == ["one", "two"]


def test_quality_from_windows(files, tmp_path, monkeypatch):
    monkeypatch.setattr(measuring, "DEFAULT_MEMORY", 1)  # else a small map is decoded as a whole
    report, engine = Report(), Here()
    options = {"stack": files.parent / "stack.h5"}
    run_single("psnr", files / "klt.h5", None, options=options, engine=engine, report=report)
    assert report.psnr == measure(files / "klt.h5", files.parent / "stack.h5", report=Report())
    assert any("@measure-windows-" in name for name in engine.begun)
    assert sorted(os.listdir(files)) == ["klt.h5", "wavelet.h5"]
    tasks = make_tasks(
        read_listing(files, "psnr", match=("klt",)),
        tmp_path / "out",
        job="psnr",
        options={"stack": str(options["stack"])},
    )
    (outcome,) = run_tiles(tasks, tmp_path / "out", engine=Here(), report=Report()).outcomes
    assert dict(outcome.psnr) == report.psnr
    assert not [*(tmp_path / "out").glob("*.shards")]


@pytest.mark.parametrize(
    "options",
    [
        {"method": "cls", "degree": 2, "holdout": 3},
        {"method": "ceb", "degree": 1, "store": "float16", "measure": False},
    ],
)
def test_fits_of_parts(files, tmp_path, monkeypatch, options):
    monkeypatch.setattr(fitting, "_PART_BYTES", 1 << 20)
    monkeypatch.setattr(metrics, "PIECE_BYTES", 1 << 20)
    stack, alone, report = files.parent / "stack.h5", Report(), Report()
    fit(stack, out=tmp_path / "one.h5", report=alone, **options)
    engine = Here()
    run_single("fit", stack, tmp_path / "two.h5", options=options, engine=engine, report=report)
    assert len(engine.begun) > 1 + len(["closed"])
    assert sorted(os.listdir(tmp_path)) == ["one.h5", "two.h5"]
    assert (tmp_path / "two.h5").read_bytes() == (tmp_path / "one.h5").read_bytes()
    assert report.psnr == alone.psnr
    assert {**report.facts, "file": ""} == {**alone.facts, "file": ""}


def test_what_is_written_beside_a_fit_is_named_as_it_was_asked_for(files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options, report = {"method": "spectrum", "degree": 1, "confidence": "seen.png"}, Report()
    run_single("fit", files.parent / "stack.h5", "a.h5", options=options, engine=Here(), report=report)
    assert (report.facts["file"], report.facts["confidence"]["file"]) == ("a.h5", "seen.png")
    assert sorted(os.listdir()) == ["a.h5", "seen.png"]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("a%02d.png", {"lights": "dirs.txt"}),
        ("a.exr", {"light": (0.1, -0.2, 0.9), "exposure": 1.0, "region": (3, 5, 60, 50)}),
        ("a%d.exr", {"light": "sky.h5", "turntable": 10, "exposure": "auto", "rotate": ("axis", (0, 1, 0, 30))}),
        ("a.gif", {"light": "sky.h5", "turntable": 9, "level": 2}),
    ],
)
def test_pictures_by_workers(files, tmp_path, name, options):
    if name.endswith(".gif"):
        pytest.importorskip("PIL", reason="animations: pip install 'clrelight[codecs]'")
    directions = np.vstack([make_pattern("uniform", 10), [0.0, 0.6, -0.8]])
    np.savetxt(tmp_path / "dirs.txt", directions)
    write_light(tmp_path / "sky.h5", Light(np.linspace(0.9, -0.3, 9)[:, None], "sky"))
    source = files / "klt.h5"
    options = {
        key: tmp_path / value if isinstance(value, str) and "." in value else value for key, value in options.items()
    }
    found = {}
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        report, out = Report(), tmp_path / folder / name
        if folder == "one":
            relight(source, out=out, report=report, **options)
        else:
            run_single("relight", source, out, options=options, engine=Here(), report=report)
        facts = {key: value for key, value in report.facts.items() if key not in ("files", "file")}
        contents = {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
        found[folder] = contents, facts, sorted(report.notes), report.device
    assert found["one"] == found["two"]
    assert found["two"][0]
    assert found["two"][3]


@pytest.mark.parametrize("at_once", [1, 3, 10])
def test_the_last_picture_alone_is_that_of_one_process(files, tmp_path, monkeypatch, at_once):
    """A product of few rows is summed in another order: pictures are made with those beside which one process does."""
    fit(files.parent / "stack.h5", "spline", 3, out=tmp_path / "fit.h5", report=Report())
    height, width, channel = read_fit(tmp_path / "fit.h5").image_shape
    monkeypatch.setattr(frames, "TILE_BYTES", at_once * 4 * height * width * channel)
    found, engine = [], Here()
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        options = {"light": make_pattern("uniform", 25)}
        if folder == "one":
            relight(tmp_path / "fit.h5", out=tmp_path / folder / "a%d.exr", **options)
        else:
            run_single("relight", tmp_path / "fit.h5", tmp_path / folder / "a%d.exr", options=options, engine=engine)
        found.append({path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()})
    assert found[0] == found[1]
    assert len([name for name in engine.begun if "@relight-some-" in name]) == {1: 4, 3: 3, 10: 3}[at_once]


def test_a_scheduler_that_does_not_answer_is_told_of_first(files, tmp_path, monkeypatch):
    pytest.importorskip("distributed", reason="the engines of Dask: pip install 'clrelight[cluster]'")
    monkeypatch.setattr(cluster, "_PATIENCE", "1s")
    monkeypatch.setattr(farmed, "_run", lambda *given: pytest.fail("the job was begun"))
    with pytest.raises(InputError, match="no scheduler answers at tcp:"):
        run_single("fit", files.parent / "stack.h5", tmp_path / "x.h5", engine="tcp://127.0.0.1:9", report=Report())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [b"a \n b.h5", b"\xff\xfe.h5"])
def test_names_that_are_no_text(files, tmp_path, monkeypatch, name):
    out, report = os.fsdecode(name), Report()
    monkeypatch.chdir(tmp_path)
    options = {"method": "uls", "degree": 1}
    run_single("fit", files.parent / "stack.h5", out, options=options, engine=Here(), report=report)
    assert os.listdir(tmp_path) == [out]
    assert report.facts["file"] == out
    report = Report()
    run_single("relight", out, "x%d.png", options={"light": [(0, 0, 1), (0, 1, 1)]}, engine=Here(), report=report)
    assert report.facts == {"files": ["x0.png", "x1.png"]}
    assert sorted(os.listdir(tmp_path)) == sorted([out, "x0.png", "x1.png"])


def test_what_is_missing_is_named_as_it_was_given(files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for source, out, told in [("no.h5", "x.png", "no.h5"), (files / "klt.h5", "none/x.png", "folder none")]:
        ended = call("relight", source, out, "--light", "0,0,1", "--jobs", 1)
        assert (ended.code, ended.out) == (2, "")
        assert ended.err.rstrip().endswith(f"{told}")
        assert ended.err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_large_shards_are_read_an_array_at_a_time(files, tmp_path, monkeypatch):
    monkeypatch.setattr(farm, "PIECE_BYTES", 1)
    read, one = [], jobs_farm.read_one_array
    monkeypatch.setattr(jobs_farm, "read_one_array", lambda path, name: read.append(name) or one(path, name))
    lights = {"light": [(0, 0, 1), (0, 1, 1), (1, 0, 1)]}
    run_single("relight", files / "klt.h5", tmp_path / "x%d.png", options=lights, engine=Here(), report=Report())
    relight(files / "klt.h5", lights["light"], out=tmp_path / "y%d.png", report=Report())
    assert {"picture0", "picture1", "picture2"} <= set(read)
    for number in range(3):
        assert (tmp_path / f"x{number}.png").read_bytes() == (tmp_path / f"y{number}.png").read_bytes()


@pytest.mark.parametrize("source", [np.zeros(3), "https://host/a.h5", None])
def test_what_other_processes_cannot_read(source):
    with pytest.raises(InputError, match=r"^other processes read the stack too: give the path of a file"):
        jobs_farm.shared_path(source, "the stack")


def test_an_experiment_file_by_workers(tmp_path):
    make_stacks(tmp_path, ["a"], shape=(24, 20, 3))
    (tmp_path / "e.toml").write_text(
        'scenes = ["a.h5", "ring"]\nmethods = ["uls", "cls"]\ndegrees = [1, 2]\nholdout = 3\n'
        '[ring]\nsize = 24\nlights = 20\n[[codec]]\nid = "uniform"\n'
    )
    assert call("bench", tmp_path / "e.toml", "--out", tmp_path / "one.h5").code == 0
    engine = Here()
    run_single("bench", tmp_path / "e.toml", tmp_path / "two.h5", engine=engine, report=Report())
    assert len([name for name in engine.begun if "@bench-part-" in name]) == 2 * 2 + 2  # of a scene all degrees
    assert_same_results(tmp_path / "one.h5", tmp_path / "two.h5")
    with pytest.raises(InputError, match="says itself what to measure"):
        run_single("bench", tmp_path / "e.toml", tmp_path / "x.h5", options={"holdout": 4}, engine=Here())


def assert_same_results(*paths):
    one, two = (read_results(path) for path in paths)
    for name in set(one.table.dtype.names) - set(TIME_FIELDS):
        np.testing.assert_array_equal(one.table[name], two.table[name])
    assert [*one.pictures] == [*two.pictures]
    assert [*one.profiles] == [*two.profiles]
    for mine, theirs in ((one.pictures, two.pictures), (one.profiles, two.profiles)):
        assert all(np.array_equal(mine[name], theirs[name]) for name in mine)


def test_a_grid_by_workers(tmp_path):
    make_stacks(tmp_path, ["a"], shape=(24, 20, 3))
    words = ("--methods", "uls,cls", "--degrees", "1,2", "--codecs", "none,uniform", "--holdout", 3)
    assert call("bench", tmp_path / "a.h5", "--out", tmp_path / "one.h5", *words).code == 0
    options = {"methods": ("uls", "cls"), "degrees": (1, 2), "codecs": ("none", "uniform"), "holdout": 3}
    engine = Here()
    run_single("bench", tmp_path / "a.h5", tmp_path / "two.h5", options=options, engine=engine, report=Report())
    assert len(engine.begun) == 4 + len(["closed"])
    assert_same_results(tmp_path / "one.h5", tmp_path / "two.h5")
    assert sorted(os.listdir(tmp_path)) == ["a.h5", "one.h5", "two.h5"]
    for told, words in {"is there": ("a.h5", "--out", "two.h5"), "is none": ("ring", "--out", "x.h5")}.items():
        names = [tmp_path / word if word.endswith(".h5") else word for word in words]
        ended = call("bench", *names, "--jobs", 1)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert told in ended.err
