"""The command line as a process: signals, full disks, missing drivers, pipes and terminals."""

import fcntl
import inspect
import os
import pty
import re
import resource
import signal
import struct
import subprocess
import sys
import termios
import time

import h5py
import numpy as np
import pytest
import rich.progress  # noqa: F401 - so that it does not load while a bar is timed

from clrelight.cli import progress
from clrelight.cli.app import cli, run
from clrelight.cli.output import print_notes
from clrelight.cli.tables import print_table
from clrelight.dataset import LightStack
from clrelight.images import write_image
from clrelight.sampling import make_pattern
from clrelight.store import read_results, write_stack
from tests.commands import arrays, command_line, contents, environment, process, succeed

HEAVY = ("numpy", "pyopencl", "scipy", "h5py", "matplotlib", "OpenImageIO", "rich", "embreex", "trimesh")


def test_importing_the_command_line_is_light():
    code = f"import sys, clrelight.cli; print([name for name in {HEAVY} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], env=environment(), capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_module_runs_as_a_command(tmp_path):
    ended = process("fit", "nowhere.h5", "o.h5", folder=tmp_path)
    assert (ended.code, ended.out, ended.err) == (2, "", "clrelight: there is no file nowhere.h5\n")
    ended = process("synth", "ring", "r.h5", "--size", 8, "--lights", 4, "--json", folder=tmp_path)
    assert (ended.code, ended.err, ended.json["lights"]) == (0, "", 4)
    assert contents(tmp_path).keys() == {"r.h5"}


def test_no_device_says_how_to_install_one(tmp_path):
    # An empty folder would not do: the loader of the wheel then still takes the driver that lies beside it.
    nothing = {"OCL_ICD_VENDORS": str(tmp_path / "none"), "OCL_ICD_FILENAMES": str(tmp_path / "none")}
    for words in (["devices"], ["devices", "--json"], ["fit", "s.h5", "o.h5"]):
        ended = process(*words, folder=tmp_path, **nothing)
        assert (ended.code, ended.out) == (2, "")
        assert ended.err.startswith("clrelight: no OpenCL device found; install one with: pip install")
        assert ended.err.count("\n") == 1
    ended = process("devices", folder=tmp_path, CLRELIGHT_DEVICE="warp")
    assert ended.code == 0
    ended = process("fit", "s.h5", "o.h5", folder=tmp_path, CLRELIGHT_DEVICE="warp")
    assert "no OpenCL device matches 'warp'" in ended.err


def test_a_bug_shows_its_traceback(monkeypatch):
    def break_down(*arguments, **options):
        raise ZeroDivisionError("ours")

    monkeypatch.setattr(cli.commands["info"], "callback", break_down)
    with pytest.raises(ZeroDivisionError, match="ours"):
        run(["info", "x.h5"])


@pytest.fixture(scope="module")
def big(tmp_path_factory):
    """A stack whose fit takes seconds, and a folder of photographs whose reading does."""
    folder = tmp_path_factory.mktemp("big")
    rng = np.random.default_rng(5)
    directions = make_pattern("uniform", 60)
    images = rng.integers(0, 256, (60, 160, 200, 3), np.uint8)
    write_stack(folder / "stack.h5", LightStack(images, directions, 255.0, name="big"))
    (folder / "photos").mkdir()
    lines = ["60"]
    for i, direction in enumerate(directions):
        write_image(folder / "photos" / f"{i}.png", images[i])
        lines.append(f"{i}.png " + " ".join(map(str, direction)))
    (folder / "photos" / "dirs.lp").write_text("\n".join(lines))
    return folder


def interrupt(words, folder, ready):
    """Start a command, send SIGINT as soon as `ready`, and return how it ended."""
    started = subprocess.Popen(
        command_line(*words), cwd=folder, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        since = time.monotonic()
        while not ready() and started.poll() is None and time.monotonic() - since < 60:
            time.sleep(0.002)
        time.sleep(0.01)  # an empty .part of the instant it is made may stay, and is taken over
        assert started.poll() is None, started.communicate()
        started.send_signal(signal.SIGINT)
        out, err = started.communicate(timeout=60)
    finally:
        started.kill()
    return started.returncode, out, err


@pytest.mark.parametrize(
    "words",
    [
        "fit {big}/stack.h5 o.h5 --degree 6 --memory 600k --iterations 1000",
        "ingest {big}/photos o.h5 --memory 200k",
    ],
    ids=["fit", "ingest"],
)
def test_interrupt_leaves_the_old_file(big, tmp_path, words):
    (tmp_path / "o.h5").write_bytes(b"precious")
    part = tmp_path / ".o.h5.part"
    code, out, err = interrupt(words.format(big=big).split(), tmp_path, part.exists)
    assert (code, out) == (130, "")
    assert err == "clrelight: interrupted; files that were not finished are discarded\n"
    assert contents(tmp_path) == {"o.h5": b"precious"}


def test_interrupted_bench_goes_on_where_it_stopped(big, tmp_path):
    words = ["bench", big / "stack.h5", "--methods", "cls,ceb", "--degrees", "2,3", "--codecs", "none,s3tc,half"]
    words += ["--out", "o.h5", "--holdout", "4"]
    code, out, err = interrupt(words, tmp_path, (tmp_path / "o.h5").exists)
    assert (code, out, err) == (130, "", "clrelight: interrupted; files that were not finished are discarded\n")
    assert contents(tmp_path).keys() == {"o.h5"}
    first = read_results(tmp_path / "o.h5").table
    assert 1 <= len(first) < 12
    assert process(*words, folder=tmp_path).code == 0
    second = read_results(tmp_path / "o.h5").table
    assert len(second) == 12
    assert second[: len(first)].tobytes() == first.tobytes()  # seconds and all
    keys = {(row["method"], row["degree"], row["codec"]) for row in second}
    assert len(keys) == 12


@pytest.mark.parametrize(
    "words",
    [
        "fit {big}/stack.h5 o.h5 --degree 4",
        "ingest {big}/photos o.h5",
        "synth ring o.h5 --size 64 --lights 90",
    ],
    ids=["fit", "ingest", "synth"],
)
def test_full_disk_is_one_line(big, tmp_path, words):
    (tmp_path / "o.h5").write_bytes(b"precious")
    if words.startswith("fit"):
        process("devices", folder=tmp_path)  # kernels are cached elsewhere, before files are limited
    done = subprocess.run(
        command_line(*words.format(big=big).split()),
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20)),
    )
    assert (done.returncode, done.stdout, done.stderr) == (2, "", "clrelight: cannot write o.h5: File too large\n")
    assert contents(tmp_path) == {"o.h5": b"precious"}


def test_reader_of_a_pipe_may_go(tmp_path):
    succeed("synth", "ring", tmp_path / "r.h5", "--size", 8, "--lights", 4)
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        command_line("info", tmp_path / "r.h5"), env=environment(), stdout=write, stderr=subprocess.PIPE, timeout=60
    )
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


IMPATIENT = "import rich.progress; from clrelight.cli import main, progress; progress._PATIENCE_SECONDS = 0.01; main()"


def in_terminal(words, folder, columns):
    """Run a command with a terminal for input, output and errors; return its exit code and what was written.

    Bars show at once, so that no command has to take long.
    """
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    changes = {"TERM": "xterm", "COLUMNS": None, "LINES": None, "NO_COLOR": None}
    started = subprocess.Popen(
        [sys.executable, "-c", IMPATIENT, *map(str, words)],
        cwd=folder,
        env=environment(**changes),
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
    )
    os.close(theirs)
    written = b""
    while True:
        try:
            piece = os.read(ours, 65536)
        except OSError:  # Linux says so when the other end is closed
            break
        if not piece:
            break
        written += piece
    os.close(ours)
    return started.wait(60), written.decode()


def screen(written):
    """Return what a terminal shows in the end: enough of one for what progress bars send."""
    lines, row, column = [""], 0, 0
    for token in re.findall(r"\x1b\[\??[0-9;]*[A-Za-z]|.|\n", written.replace("\r\n", "\r\x00"), re.S):
        if token == "\r":
            column = 0
        elif token in ("\x00", "\n"):
            row += 1
            lines += [""] * (row + 1 - len(lines))
        elif token.startswith("\x1b"):
            count = int(token[2:-1]) if token[2:-1].isdigit() else 1
            if token.endswith("A"):
                row = max(0, row - count)
            elif token.endswith("K"):
                lines[row] = "" if count == 2 else lines[row][:column]
        else:
            lines[row] = lines[row].ljust(column)[:column] + token + lines[row][column + 1 :]
            column += 1
    return lines


def test_bar_on_a_terminal_leaves_nothing(tmp_path):
    words = ["synth", "ring", "r.h5", "--size", "32", "--lights", "100"]
    code, written = in_terminal(words, tmp_path, 80)
    assert code == 0
    assert "rendering" in written
    assert re.search(r"\d+/100", written)
    assert written.count("\x1b[?25l") == written.count("\x1b[?25h") == 1  # the cursor is hidden, and comes back
    shown = [line for line in screen(written) if line]
    assert shown[0].split() == ["file", "r.h5"]
    assert "rendering" not in "".join(shown)


AT_ONCE = {"brdf info", "completion", "product", "shader irradiance", "shader transfer"}


def test_every_long_command_has_a_bar():
    """By its text: its module opens one."""

    def leaves(group, path=()):
        for name, command in group.commands.items():
            yield from leaves(command, (*path, name)) if hasattr(command, "commands") else [((*path, name), command)]

    bare = {
        " ".join(path)
        for path, command in leaves(cli)
        if "progress_bar(" not in inspect.getsource(inspect.getmodule(inspect.unwrap(command.callback)))
    }
    assert bare <= AT_ONCE, bare - AT_ONCE


def test_bar_shows_also_while_a_step_has_nothing_to_say(monkeypatch):
    ours, theirs = pty.openpty()
    monkeypatch.setenv("TERM", "xterm")
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)

        def shown(patience, seconds):
            monkeypatch.setattr(progress, "_PATIENCE_SECONDS", patience)
            with progress.progress_bar("thinking") as bar:
                bar(1, 2)
                time.sleep(seconds)
            terminal.write("<end>")
            terminal.flush()
            written = ""
            while not written.endswith("<end>"):
                written += os.read(ours, 65536).decode()
            return written

        assert "thinking" in shown(0.01, 0.5)
        assert shown(10, 0.0) == "<end>"
    os.close(ours)


def test_notes_stand_above_the_bar(monkeypatch):
    ours, theirs = pty.openpty()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(progress, "_PATIENCE_SECONDS", 0.01)
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr(sys, "stderr", terminal)
        with progress.progress_bar("thinking") as bar:
            for _ in range(500):
                if bar._bar is not None:
                    break
                time.sleep(0.01)
            time.sleep(0.1)
            print_notes(["all is well"])
        terminal.write("<end>")
        terminal.flush()
        written = ""
        while not written.endswith("<end>"):
            written += os.read(ours, 65536).decode()
    os.close(ours)
    assert "thinking" in written
    assert [line.strip() for line in screen(written) if line.strip()] == ["note: all is well", "<end>"]


def test_bench_on_a_terminal_of_80_columns(tmp_path):
    succeed("synth", "ring", tmp_path / "r.h5", "--size", 16, "--lights", 36)
    words = "bench r.h5 --holdout 5 --degrees 3 --codecs none,half,uniform,wavelet --rates 0.5 --methods uls,cls"
    code, written = in_terminal([*words.split(), "--out", "o.h5"], tmp_path, 80)
    assert code == 0
    shown = screen(written)
    # The table fits; a note is prose, which a terminal breaks.
    assert max(len(line) for line in shown if not line.startswith("note:")) <= 80
    assert "…" not in written
    text = "\n".join(shown)
    for row in read_results(tmp_path / "o.h5").table:
        assert f"{row['psnr_mean']:.2f}" in text
        assert f"{row['psnr_pooled_holdout']:.2f}" in text
    assert len([line for line in shown if "wavelet" in line]) == 2


HEADERS = ["scene", "method", "PSNR mean (dB)", "kB", "fit (s)"]
ROWS = [["ring", "cls", "31.25", "100.0", "0.5"], ["ring", "uls", "∞", "–", "12.5"]]


def printed(capsys, monkeypatch, columns, **options):
    monkeypatch.setattr("sys.stdout.isatty", lambda: columns is not None, raising=False)
    monkeypatch.setenv("COLUMNS", str(columns or 1))
    print_table(HEADERS, ROWS, **options)
    return capsys.readouterr().out.splitlines()


def test_table_in_a_pipe_has_everything(capsys, monkeypatch):
    assert printed(capsys, monkeypatch, None) == [
        "scene  method  PSNR mean (dB)     kB  fit (s)",
        "─────  ──────  ──────────────  ─────  ───────",
        "ring   cls              31.25  100.0      0.5",
        "ring   uls                  ∞      –     12.5",
    ]


def test_table_wraps_headers_where_it_is_narrow(capsys, monkeypatch):
    assert printed(capsys, monkeypatch, 40) == [
        "                PSNR",
        "                mean          fit",
        "scene  method   (dB)     kB   (s)",
        "─────  ──────  ─────  ─────  ────",
        "ring   cls     31.25  100.0   0.5",
        "ring   uls         ∞      –  12.5",
    ]


def test_table_says_what_it_leaves_out(capsys, monkeypatch):
    assert printed(capsys, monkeypatch, 26)[-3:] == [
        "cls     31.25  100.0   0.5",
        "uls         ∞      –  12.5",
        "all rows: scene ring",
    ]
    assert printed(capsys, monkeypatch, 20, expendable=("kB",))[-4:] == [
        "cls     31.25   0.5",
        "uls         ∞  12.5",
        "all rows: scene ring",
        "not shown for lack of room: kB",
    ]
    assert printed(capsys, monkeypatch, 14)[-1] == "not shown for lack of room: fit (s); kB"


def test_written_files_open_with_plain_h5py_whatever_the_mode(big, tmp_path):
    """A killed writer leaves its part; the next one takes it over."""
    (tmp_path / ".o.h5.part").write_bytes(b"left by a killed program")
    succeed("fit", big / "stack.h5", tmp_path / "o.h5", "--degree", 1, "--no-measure")
    assert contents(tmp_path).keys() == {"o.h5"}
    with h5py.File(tmp_path / "o.h5") as file:
        assert file["coefficients"].dims[0].keys() == ["coefficient"]
    assert arrays(tmp_path / "o.h5")["coefficients"].shape == (4, 160, 200, 3)
