"""Thumbnails on terminals that are faked, and completions as shells ask for them."""

import base64
import io
import re
import shutil
import subprocess
import zlib

import numpy as np
import pytest
from PIL import Image

from clrelight.cli import terminal
from clrelight.cli.terminal import longest_side, picture_form, picture_text
from clrelight.dataset import LightStack
from clrelight.jobs.thumbnail import LIGHT, thumbnail
from clrelight.lighting.light import Light
from clrelight.store import write_fit, write_light, write_results, write_stack
from tests.commands import call, environment, process, succeed
from tests.reference.basis import real_harmonics
from tests.test_report import make_results, make_rows
from tests.test_store_nexus import make_fit, make_stack

PICTURE = np.random.default_rng(5).integers(0, 256, (7, 5, 3)).astype(np.uint8)


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self):
        return True


class Typewriter(Terminal):
    encoding = "ascii"


@pytest.mark.parametrize(
    ("known", "form"),
    [
        ({"TERM": "xterm-kitty", "COLORTERM": "truecolor"}, "kitty"),
        ({"TERM": "xterm-256color", "KITTY_WINDOW_ID": "1"}, "kitty"),
        ({"TERM": "xterm-ghostty"}, "kitty"),
        ({"TERM": "xterm-256color", "TERM_PROGRAM": "iTerm.app"}, "iterm"),
        ({"TERM": "xterm-256color", "TERM_PROGRAM": "WezTerm"}, "iterm"),
        ({"TERM": "xterm-256color", "LC_TERMINAL": "iTerm2"}, "iterm"),
        ({"TERM": "foot"}, "sixel"),
        ({"TERM": "mlterm-256color"}, "sixel"),
        ({"TERM": "xterm-256color", "COLORTERM": "truecolor"}, "blocks"),
        ({"TERM": "xterm-direct"}, "blocks"),
        ({"TERM": "xterm-256color"}, None),
        ({"TERM": "dumb", "COLORTERM": "truecolor"}, None),
        ({"COLORTERM": "truecolor"}, None),
        ({"TERM": "xterm-kitty", "NO_COLOR": "1"}, None),
        ({"TERM": "xterm-kitty", "TMUX": "x", "COLORTERM": "24bit"}, "blocks"),
        ({"TERM": "screen-256color", "KITTY_WINDOW_ID": "1"}, None),
    ],
)
def test_the_form_follows_what_the_terminal_says(known, form):
    assert picture_form(Terminal(), known) == form
    assert picture_form(io.StringIO(), known) is None


def test_blocks_need_their_sign():
    known = {"TERM": "xterm-256color", "COLORTERM": "truecolor"}
    assert picture_form(Typewriter(), known) is None


def test_kitty_gets_the_pixels_in_pieces():
    large = np.random.default_rng(1).integers(0, 256, (60, 70, 3)).astype(np.uint8)
    for picture in (PICTURE, large):
        text = picture_text(picture, "kitty")
        pieces = re.findall(r"\x1b_G([^;]*);([^\x1b]*)\x1b\\", text)
        assert "".join(f"\x1b_G{a};{b}\x1b\\" for a, b in pieces) + "\n" == text
        assert all(len(b) <= 4096 for _, b in pieces)
        about = dict(each.split("=") for each in pieces[0][0].split(","))
        assert (about["a"], about["f"], about["q"]) == ("T", "24", "2")
        assert [re.search(r"m=(\d)", a)[1] for a, _ in pieces] == ["1"] * (len(pieces) - 1) + ["0"]
        raw = zlib.decompress(base64.b64decode("".join(b for _, b in pieces)))
        shown = np.frombuffer(raw, np.uint8).reshape(int(about["v"]), int(about["s"]), 3)
        np.testing.assert_array_equal(shown, picture)


def test_iterm_gets_a_png():
    match = re.fullmatch(r"\x1b\]1337;File=inline=1;size=(\d+);width=5px:([^\a]+)\a\n", picture_text(PICTURE, "iterm"))
    content = base64.b64decode(match[2])
    assert len(content) == int(match[1])
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(content))), PICTURE)


def read_sixels(text):
    """Return the picture that a terminal would draw."""
    match = re.fullmatch(r'\x1bP[\d;]*q"1;1;(\d+);(\d+)(.*)\x1b\\\n', text, re.DOTALL)
    width, height = int(match[1]), int(match[2])
    picture = np.full((-(-height // 6) * 6, width, 3), -1)
    palette, colour, x, top = {}, None, 0, 0
    for set_, rgb, run, sign, control in re.findall(r"#(\d+)(;2;\d+;\d+;\d+)?|(?:!(\d+))?([?-~])|([$-])", match[3]):
        if set_:
            colour = int(set_)
            if rgb:
                palette[colour] = [round(int(each) * 2.55) for each in rgb.split(";")[2:]]
        elif control:
            x, top = 0, top + 6 * (control == "-")
        else:
            end = x + int(run or 1)
            for bit in range(6):
                if (ord(sign) - 63) >> bit & 1:
                    picture[top + bit, x:end] = palette[colour]
            x = end
    assert (picture[height:] == -1).all()
    return picture[:height]


def test_sixels_are_the_picture_in_216_colours():
    flat = np.repeat(np.repeat(PICTURE, 3, axis=0), 9, axis=1)  # runs, and bands that the edge cuts off
    for picture in (PICTURE, flat):
        np.testing.assert_allclose(read_sixels(picture_text(picture, "sixel")), picture, atol=27)


@pytest.mark.parametrize("rows", [6, 7])
def test_blocks_are_two_pixels_each(rows):
    lines = picture_text(PICTURE[:rows], "blocks").splitlines()
    assert len(lines) == 4 if rows == 7 else 3
    for i, line in enumerate(lines):
        cells = re.findall(r"\x1b\[38;2;(\d+;\d+;\d+);(?:48;2;(\d+;\d+;\d+)|49)m▀", line)
        assert line.endswith("\x1b[0m")
        np.testing.assert_array_equal([list(map(int, c[0].split(";"))) for c in cells], PICTURE[2 * i])
        if 2 * i + 1 < rows:
            np.testing.assert_array_equal([list(map(int, c[1].split(";"))) for c in cells], PICTURE[2 * i + 1])


def test_grey_pictures_are_drawn_as_colours():
    for form in terminal.SIDES:
        assert picture_text(PICTURE[..., :1], form) == picture_text(np.repeat(PICTURE[..., :1], 3, axis=2), form)


def test_blocks_fit_the_terminal(monkeypatch):
    monkeypatch.setenv("COLUMNS", "30")
    monkeypatch.setenv("LINES", "50")
    assert longest_side("blocks") == 29
    monkeypatch.setenv("LINES", "14")
    assert longest_side("blocks") == 20
    assert longest_side("kitty") == 256


# --- what is shown


def srgb(linear):
    linear = np.clip(linear, 0, 1)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def test_a_stack_is_shown_by_the_photograph_from_the_upper_left(tmp_path):
    stack = make_stack(3)
    write_stack(tmp_path / "s.h5", stack)
    assert np.abs(thumbnail(tmp_path / "s.h5").astype(int) - stack.images_ihwc[2]).max() <= 1  # srgb, peak 255
    small = thumbnail(tmp_path / "s.h5", 4)
    assert small.shape == (3, 4, 3)


def test_a_fit_is_shown_under_that_light(tmp_path):
    fitted = make_fit(1)
    write_fit(tmp_path / "f.h5", fitted)
    relit = np.einsum("k,khwc->hwc", real_harmonics(LIGHT[None], 1)[0], fitted.coeffs_khwc.astype(np.float64))
    assert np.abs(thumbnail(tmp_path / "f.h5").astype(float) - srgb(relit)).max() <= 1


@pytest.mark.parametrize("codec", ["klt", "wavelet", "half"])
def test_an_encoding_is_shown_as_its_fit_at_any_size(codec, tmp_path):
    y, x = np.mgrid[:70, :100] / 100
    images = np.stack([np.stack([x, y, 1 - x], axis=-1) * weight for weight in np.linspace(0.4, 0.9, 9)])
    angles = np.linspace(0, 6, 9)
    lights = np.stack([0.6 * np.cos(angles), 0.6 * np.sin(angles), 0.8 + 0 * angles], axis=1)
    stack = LightStack((200 * images).astype(np.uint8), lights, 255.0, "linear")
    write_stack(tmp_path / "s.h5", stack)
    assert call("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 1).code == 0
    assert call("encode", tmp_path / "f.h5", tmp_path / "e.h5", "--codec", codec).code == 0
    for side, shape in ((100, (70, 100, 3)), (32, (22, 32, 3))):
        picture = thumbnail(tmp_path / "e.h5", side).astype(int)
        assert picture.shape == shape or picture.shape == (23, 32, 3)
        expected = thumbnail(tmp_path / "f.h5", side).astype(int)
        assert np.abs(picture[: len(expected)] - expected[: len(picture)]).mean() < 8


def test_results_and_lights_have_pictures(tmp_path):
    results = make_results(make_rows(codecs=make_rows_codecs()))
    write_results(tmp_path / "r.h5", results)
    picture = thumbnail(tmp_path / "r.h5")
    assert np.abs(picture.astype(int) - results.pictures["ring/reference"]).max() <= 1
    coeffs = np.zeros((4, 3))
    coeffs[0] = 1.0
    coeffs[3, 0] = 1.0  # more red from the right
    write_light(tmp_path / "l.h5", Light(coeffs, "me", "", {}))
    ball = thumbnail(tmp_path / "l.h5", 40).astype(int)
    assert ball.shape == (40, 40, 3)
    assert (ball[0, 0] == 0).all()
    assert ball[20, 38, 0] > ball[20, 1, 0]
    assert ball[20, 38, 1] == ball[20, 1, 1] > 0


def make_rows_codecs():
    return [("none", float("nan"), 32.0)]


def shown(monkeypatch, *arguments, stream=Terminal, **known):
    """Return what a command prints on a terminal."""
    for name in ("TMUX", "KITTY_WINDOW_ID", "TERM_PROGRAM", "LC_TERMINAL", "NO_COLOR", "COLORTERM", "TERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in known.items():
        monkeypatch.setenv(name, value)
    from contextlib import redirect_stdout

    from clrelight.cli.app import run

    out = stream()
    with redirect_stdout(out):
        assert run([str(argument) for argument in arguments]) == 0
    return out.getvalue()


def test_info_draws_on_a_terminal_and_nowhere_else(monkeypatch, tmp_path):
    path = tmp_path / "s.h5"
    write_stack(path, make_stack(3))
    kitty = {"TERM": "xterm-kitty"}
    text = shown(monkeypatch, "info", path, **kitty)
    assert text.startswith("\x1b_Ga=T")
    plain = shown(monkeypatch, "info", path, "--no-thumbnail", **kitty)
    assert "\x1b" not in plain
    assert text.endswith(plain)
    assert shown(monkeypatch, "info", path, stream=io.StringIO, **kitty) == plain
    assert shown(monkeypatch, "info", path, "--json", **kitty).startswith("{")
    blocks = shown(monkeypatch, "info", path, TERM="xterm", COLORTERM="truecolor")
    assert blocks.count("▀") == 3 * 7


def test_what_cannot_be_drawn_is_a_note(monkeypatch, tmp_path, capsys):
    write_stack(tmp_path / "s.h5", make_stack(3))
    succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 0)
    succeed("encode", tmp_path / "f.h5", tmp_path / "e.h5", "--codec", "half")
    monkeypatch.setenv("CLRELIGHT_DEVICE", "no such device")
    text = shown(monkeypatch, "info", tmp_path / "e.h5", TERM="xterm-kitty")
    assert "\x1b" not in text
    assert "encoded/4" in text
    assert capsys.readouterr().err.startswith("note: no thumbnail: ")


# --- completion


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_script_for_each_shell(shell, tmp_path):
    script = succeed("completion", shell).out
    assert "_CLRELIGHT_COMPLETE" in script
    if shutil.which(shell):
        (tmp_path / "script").write_text(script)
        subprocess.run([shell, "-n", str(tmp_path / "script")], check=True, timeout=30)


def test_other_shells_are_refused():
    ended = call("completion", "tcsh")
    assert ended.code == 2
    assert "bash" in ended.err


@pytest.mark.parametrize(
    ("words", "word", "expected"),
    [
        ("clrelight rel", 1, {"relight"}),
        ("clrelight info --no", 2, {"--no-thumbnail"}),
        ("clrelight completion z", 2, {"zsh"}),
        ("clrelight fit s.h5 f.h5 --method ce", 5, {"ceb", "ceb-crossing"}),
        ("clrelight encode f.h5 e.h5 --codec w", 5, {"wavelet", "whitened"}),
    ],
)
def test_a_shell_that_asks_is_answered(words, word, expected):
    ended = process(_CLRELIGHT_COMPLETE="bash_complete", COMP_WORDS=words, COMP_CWORD=str(word))
    assert ended.code == 0
    assert {line.partition(",")[2] for line in ended.out.splitlines()} == expected


def test_bash_completes(tmp_path):
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash is installed")
    import sys

    (tmp_path / "clrelight").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m clrelight "$@"\n')
    (tmp_path / "clrelight").chmod(0o755)
    asked = 'eval "$(clrelight completion bash)"; COMP_WORDS=(clrelight repo); COMP_CWORD=1; '
    asked += '_clrelight_completion clrelight; printf "%s\\n" "${COMPREPLY[@]}"'
    known = environment()
    known["PATH"] = f"{tmp_path}:{known['PATH']}"
    done = subprocess.run([bash, "-c", asked], env=known, capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["report"]
