import json
import math
import time

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import stages, sweep
from clrelight.codec import codec_ids
from clrelight.errors import InputError
from clrelight.speed import tables
from clrelight.speed.stage import Stage, measure
from clrelight.speed.timing import interleave

DOCUMENT = "before\n<!-- stages -->\nold\n<!-- /stages -->\nafter\n"


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    pytest.importorskip("embreex", reason="the benchmark's scene is ray traced")
    folder = tmp_path_factory.mktemp("benchmarks")
    (folder / "page.md").write_text(DOCUMENT)
    arguments = ["--quick", "--json", str(folder / "out.json"), "--markdown", str(folder / "page.md")]
    done = CliRunner().invoke(stages.main, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    return done.output, json.loads((folder / "out.json").read_text()), (folder / "page.md").read_text()


def test_every_part_has_rows(quick):
    names = [row["name"] for row in quick[1]["rows"]]
    for codec in codec_ids():
        assert any(name.startswith(f"encode {codec}") for name in names)
        assert any(name.startswith(f"decode {codec}") for name in names)
    for part in (
        "project uint8",
        "project float16",
        "project float32",
        "fit ULS",
        "fit CLS",
        "fit CEB",
        "relight",
        "PSNR",
    ):
        assert any(name.startswith(part) for name in names)


def test_figures_are_finite_and_ordered(quick):
    for row in quick[1]["rows"]:
        for key in ("our_seconds", "peer_seconds", "speed"):
            low, middle, high = row[key]
            assert 0 < low <= middle <= high < math.inf
        assert 0 < row["first_seconds"] < math.inf
        assert row["rounds"] == stages.QUICK.rounds
        assert (row["gigaflops"] is None) == (row["peak_share"] is None)
        if row["gigaflops"] is not None:
            assert 0 < row["gigaflops"] < math.inf
            assert 0 < row["peak_share"] < math.inf


def test_errors_are_those_of_float32_or_of_the_codec(quick):
    for row in quick[1]["rows"]:
        for error in (row["error"], row["peer_error"]):
            # ULS at degree 6 multiplies rounding errors by its condition; codecs lose some percent of the peak.
            limit = 0.2 if "decoding" in row["error_unit"] else 3e-3 if "ULS" in row["name"] else 1e-4
            if "binary16" in row["error_unit"]:
                limit = 5e-3
            assert error is None or 0 <= error < limit, row


def test_environment_is_recorded(quick):
    facts = quick[1]["environment"]
    for name in ("machine", "threads", "device", "driver", "versions", "commit", "BLAS", "work"):
        assert facts[name]


def test_markdown_replaces_the_block_only(quick):
    _, figures, page = quick
    assert page.startswith("before\n<!-- stages -->\n- measured: ")
    assert page.endswith("|\n<!-- /stages -->\nafter\n")
    assert "old" not in page
    table = [line for line in page.splitlines() if line.startswith("|")]
    assert len(table) == 2 + len(figures["rows"])
    assert {line.count("|") for line in table} == {len(tables.HEADERS) + 1}


def test_terminal_shows_each_row(quick):
    output, figures, _ = quick
    for row in figures["rows"]:
        assert row["name"] in output


@pytest.mark.parametrize("text", ["no markers", "<!-- /stages -->\n<!-- stages -->", DOCUMENT + DOCUMENT])
def test_a_page_without_the_two_markers_is_refused_before_work(tmp_path, text):
    page = tmp_path / "page.md"
    page.write_text(text)
    with pytest.raises(InputError, match="stages"):
        CliRunner().invoke(stages.main, ["--quick", "--markdown", str(page)], catch_exceptions=False)
    assert page.read_text() == text


def test_interleave_takes_turns_and_waits_inside():
    calls = []
    timings = interleave(
        {"a": lambda: calls.append("a"), "b": lambda: calls.append("b")},
        finish=lambda: calls.append("finish"),
        rounds=4,
        least_seconds=0.0,
        settle_seconds=0.0,
    )
    order = "ab" + "ab" + "ab" + "ba" + "ab" + "ba"  # first run, warm-up, rounds
    assert calls == [call for name in order for call in (name, "finish")]
    assert {name: values.shape for name, values in timings.seconds.items()} == {"a": (4,), "b": (4,)}
    assert timings.speed("a", "b")[1] == pytest.approx(
        np.median(timings.seconds["b"] / timings.seconds["a"]), rel=1e-12
    )


def test_interleave_cuts_rounds_to_the_time_given():
    busy = {"a": lambda: sum(range(20_000)), "b": lambda: sum(range(20_000))}
    timings = interleave(busy, finish=lambda: None, rounds=50, least_seconds=0.0, most_seconds=0.0, settle_seconds=0.0)
    assert len(timings.seconds["a"]) == 3
    with pytest.raises(ValueError, match="rounds"):
        interleave(busy, finish=lambda: None, rounds=0)


def test_sweep_prints_every_point(device):
    done = CliRunner().invoke(sweep.main, ["--quick"], catch_exceptions=False)
    assert done.exit_code == 0
    assert "of 12 points below 33% of their neighbours" in done.output


def test_cliffs_are_points_far_below_their_neighbours():
    assert sweep.find_cliffs([0.5, 0.1, 0.5]) == [False, True, False]
    assert sweep.find_cliffs([0.1, 0.5, 0.6]) == [True, False, False]
    assert sweep.find_cliffs([0.3, 0.4, 0.5]) == [False, False, False]
    assert sweep.find_cliffs([0.5]) == [False]


def test_a_peer_that_does_a_part_counts_as_if_it_did_all(device):
    stage = Stage("a", "b", lambda: None, lambda: time.sleep(0.01), lambda: (0.0, None), "none", peer_share=0.01)
    assert measure(stage, device, rounds=3, settle_seconds=0.0).peer_seconds[0] >= 1.0  # a sleep is never shorter
