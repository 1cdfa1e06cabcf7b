"""The benchmark of coding peers: its search, its planes, its videos, and a quick run of all of it."""

import itertools
import json
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import coding_peers, peer_video
from benchmarks.peer_page import where_behind
from benchmarks.peer_search import CODING, HELD_OUT, SEEN, Point, match
from benchmarks.peer_stacks import FittedStack
from benchmarks.peer_video import from_frames, shortest_path, to_frames
from benchmarks.peer_ways import KLT, WAYS, Measurement, Row, measure_stack
from clrelight.dataset import LightStack
from clrelight.harmonics.basis import evaluate_basis
from clrelight.sampling import make_pattern

PAGE = "before\n<!-- peers -->\nold\n<!-- /peers -->\nafter\n"
RATES = (0.3,)


def point_at(place):
    """6 dB for each doubling of the bytes."""
    return Point(round(1000 * 2.0**place), {SEEN: 20.0 + 6.0 * place}, 1.0, 1.0)


@pytest.mark.parametrize("start", [-3.0, 0.4, 4.0])
def test_bytes_at_equal_decibel_are_found_and_interpolated(start):
    found = match(point_at, SEEN, 26.0, start, (-5.0, 5.0), 0.7)
    assert found.byte_count == pytest.approx(2000, rel=3e-3)
    whole = match(point_at, SEEN, 23.0, start, (-5.0, 5.0), 1.0, whole=True)
    assert whole.byte_count == pytest.approx(1000 * 2**0.5, rel=1e-3)
    assert whole.nearest.byte_count in (1000, 2000)


def test_a_quality_beyond_all_settings_is_said_to_be():
    assert match(point_at, SEEN, 80.0, 0.0, (-5.0, 5.0), 1.0).byte_count is None
    assert match(point_at, SEEN, 80.0, 0.0, (-5.0, 5.0), 1.0).nearest.psnr[SEEN] == 50.0
    assert match(point_at, SEEN, -40.0, 0.0, (-5.0, 5.0), 1.0).byte_count == round(1000 / 32)


def test_the_path_of_lights_is_a_short_one():
    directions = make_pattern("uniform", 7)

    def length(order):
        return sum(np.arccos(np.clip(directions[a] @ directions[b], -1, 1)) for a, b in itertools.pairwise(order))

    order = shortest_path(directions)
    assert sorted(order) == list(range(7))
    best = min(map(length, itertools.permutations(range(7))))
    assert length(order) <= 1.25 * best


@pytest.mark.parametrize("halves", [False, True])
def test_frames_give_the_photographs_back(halves):
    y, x = np.mgrid[:43, :66] / 66.0
    images = np.stack([np.stack([x, y, 0.5 * x * y + 0.2], axis=-1)] * 2).astype(np.float32)
    frames = to_frames(images, halves)
    assert frames[0][0].shape == (64, 66)
    assert frames[0][1].shape == ((32, 33) if halves else (64, 66))
    np.testing.assert_allclose(from_frames(frames, halves)[:, :43, :66], images, atol=0.02 if halves else 2e-3)


@pytest.fixture(scope="module")
def stack():
    """A bumpy patch of two colours, and coefficients that give its photographs but for some noise."""
    rng = np.random.default_rng(0)
    directions = make_pattern("uniform", 14)
    y, x = np.mgrid[:40, :44] / 6.0
    coeffs = np.zeros((4, 40, 44, 3), np.float32)
    for k, map_hw in enumerate((2.0 + np.sin(x), 0.5 * np.cos(y), 1.0 + 0.3 * np.sin(x + y), 0.4 * np.sin(2 * x))):
        coeffs[k] = map_hw[..., None] * np.array([0.3, 0.2, 0.25])
    coeffs += 0.01 * rng.standard_normal(coeffs.shape, np.float32)
    lights = np.arange(14)
    relit = (evaluate_basis(directions, 1) @ coeffs.reshape(4, -1)).reshape(14, 40, 44, 3)
    codes = np.clip(np.rint(255 * relit), 0, 255).astype(np.uint8)
    stack = LightStack(codes, directions, peak=255.0, transfer="linear", name="patch")
    return FittedStack("patch", stack, lights[lights % 5 != 4], lights[lights % 5 == 4], coeffs, 1)


def test_scores_are_of_what_they_say(stack):
    off = stack.coeffs_khwc.copy()
    off[0] += 0.1
    error = 0.1 * evaluate_basis(stack.stack.directions_i3, 1)[:, 0]
    psnr = stack.score_coefficients(off)
    assert psnr[CODING] == pytest.approx(-10 * np.log10(np.mean(error**2)), abs=0.01)
    assert set(psnr) == {CODING, SEEN, HELD_OUT}
    images = stack.stack.images_ihwc / np.float32(255)
    images[stack.unseen_i] += np.where(images[stack.unseen_i] > 0.5, -0.1, 0.1)
    psnr = stack.score(lambda rows: images[:, rows])
    assert psnr[SEEN] > 100
    assert psnr[HELD_OUT] == pytest.approx(20.0, abs=0.01)


def test_planes_that_are_not_quantised_lose_what_the_axes_leave_out(stack, device):
    from benchmarks.peer_planes import principal_planes, raw_planes
    from clrelight.codec import codec_class, decode, encode

    raw = raw_planes(stack)
    assert raw.score(raw.planes_jhw)[CODING] > 100
    encoded = encode(stack.coeffs_khwc, codec_class("klt").from_config({"rate": 0.5}), device)
    planes = principal_planes(stack, encoded)
    exact = planes.score(planes.planes_jhw)
    coded = stack.score_coefficients(decode(encoded, device))
    assert exact[CODING] > coded[CODING] + 1.0
    # klt's indices are near the planes, in steps.
    assert planes.score(np.rint(planes.planes_jhw))[CODING] > coded[CODING] - 1.0


def test_every_way_has_its_row_at_equal_quality(stack, device):
    pytest.importorskip("imagecodecs", reason="the image codecs of extra peers")
    pytest.importorskip("av", reason="the videos of extra peers")
    pytest.importorskip("PIL", reason="the JPEG planes of RTI tools")
    measurement, told = Measurement(), []
    measure_stack(stack, device, measurement, told.append, RATES)
    assert measurement.left_out == {}
    assert told == measurement.rows
    ways = {(row.way, row.equal) for row in told}
    assert ways == {
        (KLT, CODING),
        *((f"{name}, principal planes", CODING) for name in ("JPEG 2000", "HTJ2K", "JPEG XL", "SPERR")),
        *((f"{name}, raw planes", CODING) for name in ("JPEG 2000", "HTJ2K")),
        ("RTI planes, JPEG", HELD_OUT),
        *((f"{name}", SEEN) for name in ("HEVC video", "AV1 video", "SPERR volume")),
        *((f"{name}, between lights", HELD_OUT) for name in ("HEVC video", "AV1 video", "SPERR volume")),
    }
    assert len(told) == len(RATES) * len(ways)
    assert {KLT, *WAYS} == {way for way, _ in ways}
    klt = {row.rate: row for row in told if row.way == KLT}
    for row in told:
        assert row.byte_count > 0
        assert row.point.encode_seconds > 0
        if row.reached:
            assert row.psnr == klt[row.rate].point.psnr[row.equal]
        else:
            assert row.psnr < klt[row.rate].point.psnr[row.equal]
    # What the codecs gave back is as good as what they were asked for.
    for row in told:
        if row.equal == CODING:
            assert row.point.psnr[CODING] == pytest.approx(row.psnr, abs=1.0)


def test_what_is_not_installed_is_left_out_by_name(stack, device, monkeypatch):
    import sys

    for name in ("imagecodecs", "av"):
        monkeypatch.setitem(sys.modules, name, None)
    measurement = Measurement()
    measure_stack(stack, device, measurement, lambda row: None, RATES)
    assert {row.way for row in measurement.rows} <= {KLT, "RTI planes, JPEG"}
    for name in ("JPEG 2000, HTJ2K, JPEG XL, SPERR", "HEVC video", "AV1 video", "SPERR volume"):
        assert "not installed" in measurement.left_out[name]


def test_only_the_ways_that_are_wanted_are_measured(stack, device):
    pytest.importorskip("PIL", reason="the JPEG planes of RTI tools")
    measurement = Measurement()
    measure_stack(stack, device, measurement, lambda row: None, (0.1,), wanted=lambda way: way == "RTI planes, JPEG")
    assert [row.way for row in measurement.rows] == [KLT, "RTI planes, JPEG"]
    assert measurement.left_out.keys() <= {"JPEG 2000, HTJ2K, JPEG XL, SPERR"}


def test_the_page_is_filled_and_says_where_klt_does_not_lead(tmp_path, stack, monkeypatch):
    def row(way, rate, byte_count, seconds, reached=True):
        point = Point(byte_count, {CODING: 30.0, SEEN: 29.0, HELD_OUT: 28.0}, seconds, seconds, "a setting")
        return Row("patch", way, rate, CODING if way == KLT else SEEN, 29.0, reached, byte_count, 1000.0, point)

    def measure(stack, device, measurement, tell, rates=(0.02, 0.1), wanted=None):
        for rate in rates:
            measurement.rows += [row(KLT, rate, 1000, 1.0), row("a", rate, 500, 2.0), row("b", rate, 3000, 0.5, False)]

    monkeypatch.setattr(coding_peers, "measure_stack", measure)
    monkeypatch.setattr(coding_peers, "fit_stack", lambda request, device, quick: stack)
    page, figures = tmp_path / "page.md", tmp_path / "out.json"
    page.write_text(PAGE)
    words = ["--quick", "--stack", "ring", "--markdown", str(page), "--json", str(figures)]
    done = CliRunner().invoke(coding_peers.main, words, catch_exceptions=False)
    assert done.exit_code == 0
    text = page.read_text()
    assert text.startswith("before\n<!-- peers -->\n- measured: ")
    assert text.endswith("|\n<!-- /peers -->\nafter\n")
    assert "| a | seen | 2 | 0.50 | 0.50 | 0.50 | 2.00 | 2.00 |" in text
    assert "| b | seen | 2, 2 † | 3.00 | 3.00 | 3.00 | 0.50 | 0.50 |" in text
    assert "a (seen) in 2 of 2 cases, at worst patch at 0.02 bit, 0.50 ×." in text
    assert "In the median b encode in less time, and b decode." in text
    assert "0.500 kB, 0.50 ×, 2.0 / 2.0 s" in text
    assert len(json.loads(figures.read_text())["rows"]) == 6
    assert "klt takes the fewest bytes." in where_behind([row(KLT, 0.1, 1000, 1.0), row("b", 0.1, 3000, 3.0)])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--stack", "nothing"], "no stack's name fits nothing; there are"),
        (["--stack", "ring", "--markdown", "docs/peers.md", "--way", "JPEG*"], "--markdown replaces rows of all ways"),
        (
            ["--stack", "ring", "--way", "JPEG XL*", "--way", "nothing"],
            "no way fits nothing; there are JPEG 2000, principal",
        ),
        (["--stack", "ring", "--markdown", "absent.md"], "absent.md: no such file"),
        (["--stack", "ring", "--device", "no such"], "no such"),
    ],
)
def test_what_cannot_be_is_refused_before_work(words, message):
    done = CliRunner().invoke(coding_peers.main, words)
    assert done.exit_code == 2
    assert message in done.output


def test_planes_of_noise_have_room_in_a_jpeg():
    pytest.importorskip("PIL")
    from benchmarks.jpeg_planes import compress_planes

    noise = np.random.default_rng(0).random((300, 300, 3), np.float32)
    size, (back,) = compress_planes([noise], 100)
    assert size > 2 * 300 * 300  # more than Pillow's usual buffer
    np.testing.assert_allclose(back, np.clip(noise, 0.0025, 0.9975), atol=0.02)


def test_an_encoder_that_takes_real_time_gives_it_back():
    pytest.importorskip("av")
    if not hasattr(os, "sched_getscheduler") or not Path("/proc/self/task").is_dir():
        pytest.skip("scheduling is Linux's")
    images = np.random.default_rng(0).random((3, 64, 64, 3), np.float32)
    packets = peer_video._encode(peer_video.FORMATS["AV1"], to_frames(images, True), 40)
    assert len(packets) == 3
    assert os.sched_getscheduler(0) == os.SCHED_OTHER
