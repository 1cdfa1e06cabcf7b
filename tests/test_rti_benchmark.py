"""The benchmark of the RTI field on small stacks of its form, and its measure of likeness."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import rti
from benchmarks.rti_stacks import find_stacks, read_case
from benchmarks.rti_tools import BASES
from benchmarks.rti_ways import Way, default_ways
from benchmarks.similarity import score_images, similarity
from clrelight.errors import InputError
from clrelight.fit import method_ids

Image = pytest.importorskip("PIL.Image")

PAGE = "before\n<!-- rti -->\nold\n<!-- /rti -->\nafter\n"
FEW = ["spline:3:lam=1e-3", "cls:2", "ptm", "hsh16", "pca9", "rbf"]


def write_photographs(folder, count, elevations, seed):
    """Write 8-bit photographs of a bumpy, glossy patch under lights in rings, and the file of their lights."""
    folder.mkdir(parents=True)
    azimuth = np.arange(count) * 2.4 + seed
    elevation = np.radians(np.asarray(elevations)[np.arange(count) % len(elevations)])
    lights = np.stack([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)], 1)
    y, x = np.mgrid[:20, :24] / 5.0
    normals = np.stack([0.4 * np.sin(x), 0.4 * np.cos(y), np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    lines = [str(count)]
    for i, light in enumerate(lights):
        shade = np.clip(normals @ light, 0, 1)
        colour = np.stack([0.8 * shade, 0.5 * shade, 0.4 * shade + 0.3 * shade**8], axis=-1)
        Image.fromarray(np.rint(255 * colour).astype(np.uint8)).save(folder / f"image{i:02}.png")
        lines.append(f"image{i:02}.png " + " ".join(f"{value:.6f}" for value in light))
    (folder / "dirs.lp").write_text("\n".join(lines) + "\n")


@pytest.fixture
def data(tmp_path, monkeypatch):
    synth, real = tmp_path / "data" / "stacks" / "synthrti", tmp_path / "data" / "stacks" / "realrti"
    for group, name in (("Single", "Object1/material1"), ("Multi", "Object2/material3")):
        write_photographs(synth / group / name / "Dome", 33, (10, 30, 50, 70, 90), 0)
        write_photographs(synth / group / name / "Test", 9, (20, 40, 60), 1)
    write_photographs(real / "item1", 36, (15, 40, 65, 80), 2)
    (real / "notes").mkdir()
    monkeypatch.setenv("CLRELIGHT_DATA", str(tmp_path / "data"))
    return tmp_path


def run(*arguments, exit_code=0):
    done = CliRunner().invoke(rti.main, list(map(str, arguments)))
    assert done.exit_code == exit_code, done.output
    return done.output


def test_lights_between_the_rings_are_not_fitted(data):
    assert [source.name for source in find_stacks()] == [
        "Multi/Object2/material3",
        "Single/Object1/material1",
        "Real/item1",
    ]
    (multi,), (real,) = find_stacks(["Multi/*"]), find_stacks(["Real/*"])
    case = read_case(multi)
    assert (len(case.fitted_i), len(case.unseen_i)) == (33, 9)
    np.testing.assert_allclose(
        np.degrees(np.arcsin(case.stack.directions_i3[case.unseen_i[:3], 2])), [20, 40, 60], atol=1e-3
    )
    assert case.example_light in case.unseen_i
    case = read_case(real, pixels=7)
    assert case.unseen_i.tolist() == [4, 9, 14, 19, 24, 29, 34]
    assert case.stack.image_shape == (7, 7, 3)


def test_every_figure_is_kept_and_the_page_filled(data, monkeypatch):
    monkeypatch.setattr("benchmarks.rti_ways.BITS_PER_PIXEL", (16.0,))
    page, figures, pictures = data / "page.md", data / "out.json", data / "pictures"
    page.write_text(PAGE)
    ways = [word for way in FEW for word in ("--way", way)]
    output = run(
        "--quick",
        *ways,
        "--code",
        "cls:2",
        "--stacks",
        "[MR]*",
        "--json",
        figures,
        "--markdown",
        page,
        "--pictures",
        pictures,
    )
    rows = json.loads(figures.read_text())["rows"]
    assert [(row["stack"], row["way"]) for row in rows[: len(FEW)]] == [("Multi/Object2/material3", way) for way in FEW]
    assert len(rows) == 2 * len(FEW)
    for row in rows:
        score = row["score"]
        assert 12 < score["psnr_pooled"] <= score["psnr_mean"] + 1e-9 < 80
        assert 0.3 < score["ssim"] <= 1
        assert score["psnr_mean"] == pytest.approx(np.mean(score["psnr_i"]))
        sizes = [coded["byte_count"] for coded in row["coded"]]
        assert len(sizes) == {"cls:2": 1, "spline:3:lam=1e-3": 0}.get(row["way"], 3)
        assert sizes == sorted(sizes)
        assert row["seconds"] > 0
    values = {row["way"]: row["values"] for row in rows if row["group"] == "Multi"}
    assert values == {"spline:3:lam=1e-3": 48, "cls:2": 27, "ptm": 18, "hsh16": 48, "pca9": 9, "rbf": 99}
    text = page.read_text()
    assert text.startswith("before\n<!-- rti -->\n- measured: ")
    assert text.endswith("\n<!-- /rti -->\nafter\n")
    assert "old" not in text
    assert text.count("| cls 2 |") >= 3
    for name in ("rti_median.png", "rti_worst.png", "rti_best.png"):
        assert Image.open(pictures / name).size[0] > 300
        assert text.count(f"](pictures/{name})") == 1
    assert "the middle 64 pixels only" in output


def test_a_size_that_cannot_be_had_is_left_out(data, monkeypatch):
    def refuse(*arguments):
        raise InputError("the tables alone take more")

    monkeypatch.setattr("benchmarks.rti_ways.encode", refuse)
    output = run("--stacks", "Real/*", "--way", "cls:1")
    assert "cls 1" in output
    assert "klt" not in output


def test_a_way_that_cannot_do_a_stack_says_why_and_the_others_go_on(data):
    output = run("--stacks", "Single/*", "--way", "uls:8", "--way", "ptm")
    assert "uls 8" in output
    assert "33" in output.split("uls 8", 1)[1].splitlines()[0]
    assert "– " in output


def test_a_stack_that_cannot_be_read_is_left_out(data):
    (data / "data/stacks/realrti/item1/image03.png").write_bytes(b"no image")
    output = run("--quick", "--way", "ptm", "--stacks", "Real/*", "--stacks", "Single/*")
    assert "Real/item1 is left out: " in output
    assert "Single/Object1/material1" in output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--way", "sh:4"], "'sh' is none of auto, "),
        (["--way", "spline:six"], "not 'spline:six'"),
        (["--way", "spline:15:lam"], "not 'spline:15:lam'"),
        (["--stacks", "Double/*"], "no stack's name fits Double/*; there are Multi/Object2"),
        (["--code", "uls:2"], "--code names ways that are measured"),
        (["--way", "ptm", "--markdown", "absent.md"], "absent.md: no such file"),
    ],
)
def test_what_cannot_be_is_refused_before_work(data, arguments, message):
    assert message in run(*arguments, exit_code=2)


def test_without_data(monkeypatch, tmp_path):
    monkeypatch.delenv("CLRELIGHT_DATA", raising=False)
    assert "CLRELIGHT_DATA must name the folder" in run(exit_code=2)
    monkeypatch.setenv("CLRELIGHT_DATA", str(tmp_path))
    assert "no stack in " in run(exit_code=2)


def test_the_usual_ways_are_those_that_there_are():
    ways = [Way(text) for text in default_ways()]
    assert ways[0].text == "auto"
    assert {way.text for way in ways if not way.is_fit} <= set(BASES)
    assert ("spectrum" in default_ways()) == ("spectrum" in method_ids())
    assert Way("spline:15:lam=3e-4").label == "spline 15, λ 0.0003"
    assert Way("cls").parts == ("cls", "auto", {})
    with pytest.raises(InputError, match="is none of"):
        Way("nothing").label  # noqa: B018


def direct_similarity(a, b):
    """Wang et al. 2004, window by window."""
    offsets = np.arange(-5, 6)
    weight = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    weight = (weight / weight.sum())[..., None]
    found = []
    for h in range(5, a.shape[0] - 5):
        for w in range(5, a.shape[1] - 5):
            x, y = (image[h - 5 : h + 6, w - 5 : w + 6] for image in (a, b))
            mean_x, mean_y = (weight * x).sum((0, 1)), (weight * y).sum((0, 1))
            var_x, var_y = (weight * (x - mean_x) ** 2).sum((0, 1)), (weight * (y - mean_y) ** 2).sum((0, 1))
            both = (weight * (x - mean_x) * (y - mean_y)).sum((0, 1))
            found.append(
                (2 * mean_x * mean_y + 1e-4)
                * (2 * both + 9e-4)
                / ((mean_x**2 + mean_y**2 + 1e-4) * (var_x + var_y + 9e-4))
            )
    return np.mean(found)


def test_structural_similarity():
    rng = np.random.default_rng(0)
    a = rng.random((16, 19, 3))
    b = np.clip(a + 0.2 * rng.standard_normal(a.shape), 0, 1)
    whole = np.ones(a.shape[:2], bool)
    assert similarity(a, b, whole) == pytest.approx(direct_similarity(a, b), abs=1e-9)
    assert similarity(a, a, whole) == pytest.approx(1.0)
    assert similarity(a[:4, :4], a[:4, :4], whole[:4, :4]) == pytest.approx(1.0)
    mask = np.zeros_like(whole)
    mask[5, 5] = True
    assert similarity(a, b, mask) == pytest.approx(direct_similarity(a[:11, :11], b[:11, :11]), abs=1e-9)


def test_scores_are_of_clipped_values_in_the_mask():
    given = np.zeros((2, 3, 1)) + np.array([0.0, 0.5, 1.0])[None, :, None]
    relit = given + np.array([-3.0, 0.1, 2.0])[None, :, None]
    score = score_images([(relit, given), (given, given + 0.1)], np.ones((2, 3), bool), with_ssim=False)
    expected = -10 * np.log10([0.01 / 3, 0.02 / 3])
    assert score.psnr_i == pytest.approx(expected)
    assert score.psnr_mean == pytest.approx(expected.mean())
    assert score.psnr_pooled == pytest.approx(-10 * np.log10(0.015 / 3))
    assert score.ssim is None
