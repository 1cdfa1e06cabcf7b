"""The verbs from Python are those of the command line."""

import inspect
import os
import re
import subprocess
import sys
import warnings

import numpy as np
import OpenImageIO as oiio
import pytest

import clrelight as cr
from clrelight.images import write_image
from datasets_synth.ring import render_ring
from tests.commands import ROOT, arrays, call, contents, environment, succeed
from tests.reference.basis import real_harmonics
from tests.reference.psnr import display

DEGREE = 3
LIGHT = (0.3, 0.1, 2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("verbs")
    cr.write_stack(place / "stack.h5", render_ring(size=16, lights=36))
    return place


@pytest.fixture(scope="module")
def stack(folder):
    with cr.open_stack(folder / "stack.h5") as stored:
        return cr.LightStack(stored.images_ihwc[...], stored.directions_i3, stored.peak, stored.transfer, name="ring")


@pytest.fixture(scope="module")
def fit_file(folder):
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", DEGREE, "--holdout", 5)
    return folder / "fit.h5"


@pytest.fixture(scope="module")
def fitted(fit_file):
    return cr.read_fit(fit_file)


def relit(coeffs_khwc, direction):
    """Return the image of one direction, of any length, in float64."""
    unit = np.asarray(direction, np.float64) / np.linalg.norm(np.asarray(direction, np.float64))
    degree = int(np.sqrt(len(coeffs_khwc))) - 1
    return np.einsum("k,khwc->hwc", real_harmonics(unit[None], degree)[0], coeffs_khwc.astype(np.float64))


def examples(page):
    return re.findall(r"^```python\n(.*?)^```$", (ROOT / page).read_text(), re.S | re.M)


def run_python(code, place, *flags):
    done = subprocess.run(
        [sys.executable, *flags, "-c", code],
        cwd=place,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    return done


def test_readme_example_ends_in_a_file_and_an_image(stack, tmp_path):
    cr.write_stack(tmp_path / "stack.h5", stack)
    (example,) = examples("README.md")
    run_python(example + "\nimport numpy as np; np.save('image.npy', image)", tmp_path)
    image = np.load(tmp_path / "image.npy")
    assert (image.shape, image.dtype) == ((16, 16, 3), np.float32)
    shown = np.asarray(oiio.ImageBuf(str(tmp_path / "relit.png")).get_pixels(oiio.FLOAT), np.float64)
    assert np.abs(255 * shown - 255 * display(image.astype(np.float64), "linear")).max() <= 0.5 + 1e-3
    assert cr.read_encoded(tmp_path / "small.h5")[0].codec == "klt"


def test_every_example_of_the_page_runs(stack, tmp_path):
    (tmp_path / "photos").mkdir()
    lines = [f"{stack.n_light}"]
    for i, (image_hwc, direction) in enumerate(zip(stack.images_ihwc, stack.directions_i3, strict=True)):
        write_image(tmp_path / "photos" / f"{i:02}.png", image_hwc)
        lines.append(f"{i:02}.png " + " ".join(f"{v:.9f}" for v in direction))
    (tmp_path / "photos" / "dome.lp").write_text("\n".join(lines) + "\n")
    code = "".join(examples("docs/python.md"))
    for verb in (
        "pack",
        "unpack",
        "ingest",
        "fit",
        "encode",
        "decode",
        "relight",
        "measure",
        "export",
        "transfer",
        "render",
    ):
        assert f"cr.{verb}(" in code
    done = run_python(code + "\nprint(image.shape, images.shape, turned.shape)", tmp_path)
    assert done.stdout.splitlines()[-1] == "(16, 16, 3) (2, 16, 16, 3) (4, 16, 16, 3)"
    for name in (
        "stack.h5",
        "mine.h5",
        "fit.h5",
        "small.h5",
        "back.h5",
        "relit.png",
        "frame035.png",
        "textures",
        "photos_again",
    ):
        assert (tmp_path / name).exists(), name


@pytest.mark.parametrize(
    ("line", "verb"),
    [
        ("fit stack.h5 OUT --degree 3 --holdout 5", lambda out: cr.fit("stack.h5", degree=3, holdout=5, out=out)),
        (
            "fit stack.h5 OUT --method ceb --energy 0.5 --degree 2 --memory 60k --store float16",
            lambda out: cr.fit("stack.h5", "ceb", 2, energy=0.5, memory="60k", store="float16", out=out),
        ),
        ("encode fit.h5 OUT --codec klt --rate 0.2", lambda out: cr.encode("fit.h5", "klt", rate=0.2, out=out)),
        ("encode fit.h5 OUT --bytes 9k", lambda out: cr.encode("fit.h5", bytes="9k", out=out)),
        (
            "encode fit.h5 OUT --basis whitened --codec uniform --bits 5 --stack stack.h5",
            lambda out: cr.encode("fit.h5", "uniform", basis="whitened", bits=5, stack="stack.h5", out=out),
        ),
        ("relight fit.h5 OUT.exr --light 0.3,0.1,2", lambda out: cr.relight("fit.h5", LIGHT, out=f"{out}.exr")),
        (
            "relight fit.h5 OUT.png --light 0.3,0.1,2 --exposure 1 --transfer srgb",
            lambda out: cr.relight("fit.h5", LIGHT, exposure=1, transfer="srgb", out=f"{out}.png"),
        ),
    ],
)
def test_a_verb_writes_what_its_command_does(folder, fit_file, monkeypatch, tmp_path, line, verb):
    monkeypatch.chdir(folder)
    told = succeed(*line.replace("OUT", str(tmp_path / "a")).split(), "--json").json
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a note on one side alone would be a difference
        report = verb(str(tmp_path / "b"))
    left, right = sorted(contents(tmp_path).items())
    assert left[1] == right[1]
    assert (left[0].replace("a", "b", 1), report.device) == (right[0], told["device"])
    assert report.to_json().keys() == told.keys()
    for name in ("psnr", "encoded_bytes", "condition", "notes"):
        assert report.to_json().get(name) == told.get(name)
    assert report.seconds.keys() == told["seconds"].keys()


def test_records_and_files_give_the_same(folder, stack, fit_file, fitted, tmp_path):
    made = cr.fit(stack, "cls", degree=DEGREE, holdout=5)
    for name, value in (("coefficients", made.coeffs_khwc), ("lambda", made.lambda_hwc)):
        np.testing.assert_array_equal(arrays(fit_file)[name], value)
    tiled = cr.fit(folder / "stack.h5", "cls", degree=DEGREE, holdout=5, memory="60k")
    np.testing.assert_array_equal(tiled.coeffs_khwc, made.coeffs_khwc)
    halves = cr.fit(stack, "cls", degree=DEGREE, holdout=5, store="float16")
    np.testing.assert_array_equal(halves.coeffs_khwc, made.coeffs_khwc.astype(np.float16), strict=True)
    for codec in ("s3tc", "klt", "wavelet"):
        small = cr.encode(fitted, codec)
        assert small == cr.encode(fit_file, codec) == cr.encode(fit_file, codec, memory="8MiB")
        cr.write_encoded(tmp_path / "a.h5", small)
        cr.encode(fit_file, codec, out=tmp_path / "b.h5")
        assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()
        back = cr.decode(small)
        cr.decode(small, out=tmp_path / "c.h5")
        cr.decode(tmp_path / "b.h5", out=tmp_path / "d.h5")
        assert (tmp_path / "c.h5").read_bytes() == (tmp_path / "d.h5").read_bytes()
        np.testing.assert_array_equal(back.coeffs_khwc, cr.decode(tmp_path / "b.h5").coeffs_khwc)
        assert (back.method, back.degree, back.transfer, back.name) == ("cls", DEGREE, "linear", "ring")
        told = succeed("psnr", tmp_path / "b.h5", folder / "stack.h5", "--json").json["psnr"]
        assert cr.measure(small, stack) == cr.measure(tmp_path / "b.h5", folder / "stack.h5") == told
        np.testing.assert_array_equal(cr.relight(small, LIGHT), cr.relight(tmp_path / "b.h5", LIGHT))
        np.testing.assert_allclose(cr.relight(small, LIGHT), relit(back.coeffs_khwc, LIGHT), atol=1e-4)


@pytest.mark.parametrize(
    "light",
    [
        LIGHT,
        list(LIGHT),
        [6, 2, 40],
        np.array(LIGHT, ">f4"),
        np.array(LIGHT, "f2"),
        np.array(LIGHT, ">f8") * 1e300,
        np.array([6, 2, 40], np.uint8),
    ],
    ids=lambda light: getattr(light, "__name__", None) or repr(light),
)
def test_a_direction_in_any_form(fitted, light):
    expected = relit(fitted.coeffs_khwc, np.asarray(light, np.float64) / np.max(np.asarray(light, np.float64)))
    image = cr.relight(fitted, light)
    assert (image.shape, image.dtype) == ((16, 16, 3), np.float32)
    np.testing.assert_allclose(image, expected, atol=1e-5)
    for rows in ([light], np.asarray(light)[None], [light, light]):
        images = cr.relight(fitted, rows)
        assert images.shape == (len(rows), 16, 16, 3)
        np.testing.assert_array_equal(images[-1], image)


@pytest.mark.parametrize(
    "light",
    [
        (0, 0),
        (0, 0, 0),
        (0, 0, np.nan),
        [(0, 0, 1), (1, 2)],
        [[[0, 0, 1]]],
        "0,0,1",
        ["0", "0", "1"],
        (0, 0, 1j),
        (True, False, True),
        [],
        None,
        7,
        print,
        {},
    ],
    ids=lambda light: getattr(light, "__name__", None) or repr(light),
)
def test_what_is_no_direction_is_refused(fitted, light):
    with pytest.raises(cr.InputError) as told:
        cr.relight(fitted, light)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("out", "names"),
    [
        ("50%done.png", ["50%done.png"]),
        ("a%dir/x.png", ["a%dir/x.png"]),
        ("f%d.png", ["f0.png"]),
        ("%03d%.png", ["000%.png"]),
        ("f%d_%d.png", None),
    ],
)
def test_where_a_number_goes_in_a_name(fitted, tmp_path, out, names):
    (tmp_path / "a%dir").mkdir()
    if names is None:
        with pytest.raises(cr.InputError, match="2 number fields"):
            cr.relight(fitted, LIGHT, out=tmp_path / out)
    else:
        report = cr.relight(fitted, LIGHT, out=tmp_path / out)
        assert report.facts["files"] == [str(tmp_path / name) for name in names]
    assert sorted(contents(tmp_path)) == (names or [])


@pytest.mark.filterwarnings("ignore::clrelight.Note")
def test_light_from_everywhere(folder, fit_file, fitted, tmp_path):
    succeed("light", tmp_path / "cap.h5", "--cap", "0.2,0.3,1,20", "--degree", DEGREE)
    cap = cr.cap_light((0.2, 0.3, 1), 20, DEGREE)
    with pytest.warns(cr.Note, match="below the horizon"):
        image = cr.relight(fitted, cap, rotate=30)
    assert image.shape == (16, 16, 3)
    np.testing.assert_array_equal(image, cr.relight(fit_file, tmp_path / "cap.h5", rotate=("axis", (0, 0, 1, 30))))
    ended = call("relight", fit_file, tmp_path / "a.exr", "--light", tmp_path / "cap.h5", "--rotate", 30)
    assert ended.code == 0
    shown = np.asarray(oiio.ImageBuf(str(tmp_path / "a.exr")).get_pixels(oiio.FLOAT))
    np.testing.assert_array_equal(shown, image)
    turned = cr.relight(fitted, cap, turntable=3, exposure="auto")
    assert turned.shape == (3, 16, 16, 3)
    report = cr.relight(fitted, cap, turntable=3, exposure="auto", out=tmp_path / "t%d.png")
    assert (len(report.facts["files"]), report.facts["exposure"] != 0) == (3, True)


def refusals():
    yield "fit missing.h5 o.h5", lambda: cr.fit("missing.h5", out="o.h5")
    yield "fit fit.h5 o.h5", lambda: cr.fit("fit.h5", out="o.h5")
    yield "fit stack.h5 stack.h5", lambda: cr.fit("stack.h5", out="stack.h5")
    yield "fit stack.h5 o.h5 --method uls --degree 9", lambda: cr.fit("stack.h5", "uls", 9)
    yield "fit stack.h5 o.h5 --method nought", lambda: cr.fit("stack.h5", "nought")
    yield "fit stack.h5 o.h5 --method uls --energy 2", lambda: cr.fit("stack.h5", "uls", energy=2.0)
    yield "fit stack.h5 o.h5 --energy -1", lambda: cr.fit("stack.h5", energy=-1.0)
    yield "fit stack.h5 o.h5 --memory 10", lambda: cr.fit("stack.h5", memory=10, out="o.h5")
    yield "fit stack.h5 o.h5 --device nowhere", lambda: cr.fit("stack.h5", device="nowhere")
    yield "encode fit.h5 o.h5 --codec nought", lambda: cr.encode("fit.h5", "nought")
    yield "encode fit.h5 o.h5 --codec s3tc --rate 1", lambda: cr.encode("fit.h5", "s3tc", rate=1.0)
    yield "encode fit.h5 o.h5 --bytes 1k --rate 1", lambda: cr.encode("fit.h5", bytes="1k", rate=1.0)
    yield "encode fit.h5 o.h5 --target-psnr 30", lambda: cr.encode("fit.h5", target_psnr=30)
    yield "encode fit.h5 o.h5 --codec klt --memory 1k", lambda: cr.encode("fit.h5", "klt", memory="1k")
    yield "encode stack.h5 o.h5", lambda: cr.encode("stack.h5")
    yield "decode fit.h5 o.h5", lambda: cr.decode("fit.h5")
    yield "relight stack.h5 o.png --light 0,0,1", lambda: cr.relight("stack.h5", (0, 0, 1), out="o.png")
    yield "relight fit.h5 o.png --light 0,0,0", lambda: cr.relight("fit.h5", (0, 0, 0), out="o.png")
    yield "relight fit.h5 o.png", lambda: cr.relight("fit.h5", out="o.png")
    yield "relight fit.h5 o.xyz --light 0,0,1", lambda: cr.relight("fit.h5", (0, 0, 1), out="o.xyz")
    yield (
        "relight fit.h5 o.exr --light 0,0,1 --transfer srgb",
        lambda: cr.relight("fit.h5", (0, 0, 1), transfer="srgb", out="o.exr"),
    )
    yield (
        "relight fit.h5 o.png --light 0,0,1 --rotate 90",
        lambda: cr.relight("fit.h5", (0, 0, 1), rotate=90, out="o.png"),
    )
    yield "psnr fit.h5 fit.h5", lambda: cr.measure("fit.h5", "fit.h5")
    yield "export fit.h5 stack.h5", lambda: cr.export("fit.h5", "stack.h5")
    yield "ingest nowhere o.h5", lambda: cr.ingest("nowhere", "o.h5")


@pytest.mark.parametrize(("line", "verb"), list(refusals()), ids=[line for line, _ in refusals()])
def test_an_error_is_the_line_of_the_command(folder, fit_file, monkeypatch, line, verb):
    monkeypatch.chdir(folder)
    before = contents(folder)
    ended = call(*line.split())
    assert (ended.code, ended.out) == (2, "")
    with pytest.raises(cr.InputError) as told:
        verb()
    assert isinstance(told.value, ValueError)
    assert ended.err == f"clrelight: {' '.join(str(told.value).split())}\n"
    assert contents(folder) == before


@pytest.mark.parametrize(
    "verb",
    [
        lambda fitted, stack: cr.ingest(".", mask=b"\xe4.png"),
        lambda fitted, stack: cr.ingest(".", lights=7),
        lambda fitted, stack: cr.fit(7),
        lambda fitted, stack: cr.fit(stack.images_ihwc),
        lambda fitted, stack: cr.fit(fitted),
        lambda fitted, stack: cr.fit(stack, 3),
        lambda fitted, stack: cr.fit(stack, ["cls"]),
        lambda fitted, stack: cr.fit(stack, degree=2.5),
        lambda fitted, stack: cr.fit(stack, degree="six"),
        lambda fitted, stack: cr.fit(stack, degree=None),
        lambda fitted, stack: cr.fit(stack, holdout="5"),
        lambda fitted, stack: cr.fit(stack, lights=1000),
        lambda fitted, stack: cr.fit(stack, weights=None),
        lambda fitted, stack: cr.fit(stack, precision="quad"),
        lambda fitted, stack: cr.fit(stack, energy="much"),
        lambda fitted, stack: cr.fit(stack, iterations="many"),
        lambda fitted, stack: cr.fit(stack, holdot=5),
        lambda fitted, stack: cr.fit(stack, store="int8"),
        lambda fitted, stack: cr.fit(stack, memory="lots"),
        lambda fitted, stack: cr.fit(stack, memory=-1),
        lambda fitted, stack: cr.fit(stack, device=3.5),
        lambda fitted, stack: cr.fit(stack, out=3),
        lambda fitted, stack: cr.fit(stack, iterations=2.5),
        lambda fitted, stack: cr.encode(stack),
        lambda fitted, stack: cr.encode(fitted.coeffs_khwc),
        lambda fitted, stack: cr.encode(fitted, 3),
        lambda fitted, stack: cr.encode(fitted, out=3),
        lambda fitted, stack: cr.encode(fitted, "half", clamp="yes"),
        lambda fitted, stack: cr.encode(fitted, "klt", rate="low"),
        lambda fitted, stack: cr.encode(fitted, "klt", rtae=0.1),
        lambda fitted, stack: cr.encode(fitted, "uniform", bits=8.5),
        lambda fitted, stack: cr.encode(fitted, basis="spherical"),
        lambda fitted, stack: cr.encode(fitted, bytes="few"),
        lambda fitted, stack: cr.encode(fitted, target_psnr="good", stack=stack),
        lambda fitted, stack: cr.decode(b"CLRE"),
        lambda fitted, stack: cr.decode(fitted),
        lambda fitted, stack: cr.relight(stack, LIGHT),
        lambda fitted, stack: cr.relight(fitted, LIGHT, exposure="bright"),
        lambda fitted, stack: cr.relight(fitted, LIGHT, out=3),
        lambda fitted, stack: cr.relight(fitted, [LIGHT, LIGHT], out="one.png"),
        lambda fitted, stack: cr.relight(fitted, cr.cap_light(LIGHT, 20, 2), rotate=("euler",)),
        lambda fitted, stack: cr.relight(fitted, LIGHT, exposure="auto"),
        lambda fitted, stack: cr.relight(fitted, LIGHT, transfer="srgb"),
        lambda fitted, stack: cr.relight(fitted, cr.cap_light(LIGHT, 20, 2), turntable=2.5),
        lambda fitted, stack: cr.relight(fitted, cr.cap_light(LIGHT, 20, 2), turntable=0),
        lambda fitted, stack: cr.relight(fitted, cr.cap_light(LIGHT, 20, 2), rotate="left"),
        lambda fitted, stack: cr.relight(fitted, cr.cap_light(LIGHT, 20, 2), rotate=("left", (1, 2, 3))),
        lambda fitted, stack: cr.relight(fitted, cr.cap_light(LIGHT, 20, 2), turntable=2, about=(0, 0)),
        lambda fitted, stack: cr.measure(fitted, stack.images_ihwc),
        lambda fitted, stack: cr.measure(stack, stack),
        lambda fitted, stack: cr.measure(fitted, render_ring(size=8, lights=4)),
        lambda fitted, stack: cr.export(fitted, "textures", "bmp"),
        lambda fitted, stack: cr.export(fitted, 3),
        lambda fitted, stack: cr.ingest(3),
        lambda fitted, stack: cr.ingest(".", 3),
        lambda fitted, stack: cr.ingest(".", colour="red"),
    ],
    ids=lambda verb: inspect.getsource(verb).split("stack: ", 1)[1].strip().rstrip(","),
)
def test_bad_arguments_are_named(fitted, stack, monkeypatch, tmp_path, verb):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(cr.InputError) as told:
        verb(fitted, stack)
    assert str(told.value)
    assert "\n" not in str(told.value)
    assert os.listdir(tmp_path) == []


def test_a_coefficient_that_is_not_finite_is_named(fitted, stack):
    coeffs = fitted.coeffs_khwc.copy()
    coeffs[3, 1, 2, 0] = np.inf
    broken = cr.CoefficientMap(coeffs, DEGREE, "cls", 255.0, "linear", fitted.directions_i3)
    for verb in (lambda: cr.relight(broken, LIGHT), lambda: cr.measure(broken, stack)):
        with pytest.raises(cr.InputError, match="coefficient 3 at row 1, column 2, channel 0 is inf"):
            verb()


def test_notes_are_warned_of_or_reported(folder, fit_file):
    text = "light 0 is below the horizon, where a hemispherical fit knows nothing"
    with pytest.warns(cr.Note, match=text) as warned:
        cr.relight(fit_file, (0, 0, -1))
    assert (len(warned), warned[0].filename) == (1, __file__)
    report = cr.Report()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cr.relight(fit_file, (0, 0, -1), report=report)
    assert report.notes == [text]
    with pytest.warns(cr.Note, match="auto"):
        cr.fit(folder / "stack.h5", "auto", 2)


def test_progress_is_told(folder, tmp_path):
    told = []
    cr.fit(folder / "stack.h5", degree=2, out=tmp_path / "f.h5", memory="40k", progress=lambda *step: told.append(step))
    stages = list(dict.fromkeys(what for _, _, what in told))
    assert stages == ["preparing", "fitting CLS", "measuring"]
    assert ("preparing", None) in {(what, total) for _, total, what in told}
    assert (16, 16, "fitting CLS") in told
    assert len([step for step in told if step[2] == "fitting CLS"]) > 4


def test_a_verb_that_is_left_leaves_nothing(folder, tmp_path):
    def interrupt(done, total, what):
        if what == "measuring":
            raise KeyboardInterrupt

    (tmp_path / "f.h5").write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt):
        cr.fit(folder / "stack.h5", degree=2, out=tmp_path / "f.h5", progress=interrupt)
    assert contents(tmp_path) == {"f.h5": b"old"}


def test_verbs_keep_their_names_beside_modules():
    code = (
        "import clrelight as cr, clrelight.ingest, clrelight.export, clrelight.relight, clrelight.fit.tile, types\n"
        "print([callable(getattr(cr, v)) and not isinstance(getattr(cr, v), types.ModuleType)"
        " for v in ('ingest', 'fit', 'encode', 'decode', 'relight', 'measure', 'export')])"
    )
    assert run_python(code, ROOT).stdout.strip() == str([True] * 7)


def test_importing_loads_nothing():
    code = "import sys, clrelight; print(sorted(m for m in sys.modules if m.split('.')[0] in ('numpy', 'clrelight')))"
    assert run_python(code, ROOT).stdout.strip() == "['clrelight']"


def test_jobs_neither_print_nor_click():
    for path in (ROOT / "clrelight" / "jobs").glob("*.py"):
        assert not re.search(r"\bprint\(|\bimport click\b|from click\b|clrelight\.cli", path.read_text()), path.name


def test_type_checkers_see_every_name():
    source = (ROOT / "clrelight" / "__init__.py").read_text()
    seen = {name: home for home, name in re.findall(r"^    from (\S+) import (\S+) as \2$", source, re.M)}
    assert seen == cr._HOMES
    for name in cr.__all__:
        assert getattr(cr, name) is not None
