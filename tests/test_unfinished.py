"""Turntables that are interrupted go on where they were, and only those."""

import os
import signal
import subprocess
import time

import numpy as np
import pytest

import clrelight as cr
from clrelight import durable
from clrelight.batch.single import run_single
from clrelight.jobs import relight, relighting, unfinished
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern
from clrelight.store import write_fit
from tests.commands import call, command_line, contents, environment, succeed
from tests.test_batch import Here

COUNT = 9
LIST = ".turn0.png.done"


def run(*arguments):
    ended = call(*arguments)
    assert ended.code == 0, ended.err
    return ended


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("turned")
    coeffs = np.random.default_rng(0).random((9, 24, 32, 3)).astype(np.float32)
    write_fit(place / "fit.h5", cr.CoefficientMap(coeffs, 2, "uls", 1.0, "srgb", make_pattern("uniform", 9)))
    succeed("light", place / "sky.h5", "--sky", "clear", "--sun", "35,120", "--degree", 2)
    return place


def words(folder, out, *more):
    return ["relight", folder / "fit.h5", out / "turn%d.png", "--light", folder / "sky.h5", "--turntable", COUNT, *more]


def interrupt_after(count, monkeypatch, module=relighting):
    """Have images written until so many are; return their numbers, as they are written."""
    write, written = module.write_view, []

    def counted(name, *arguments):
        if len(written) == count:
            raise KeyboardInterrupt
        write(name, *arguments)
        written.append(int(name[-5]))

    monkeypatch.setattr(module, "write_view", counted)
    return written


def cut(asked, count, monkeypatch):
    with monkeypatch.context() as patch:
        interrupt_after(count, patch)
        assert call(*asked).code == 130


def start(folder, out, count, monkeypatch, *more):
    """Interrupt a turntable after so many images."""
    cut(words(folder, out, *more), count, monkeypatch)
    assert sorted(contents(out)) == [LIST, *(f"turn{i}.png" for i in range(count))]


@pytest.fixture(scope="module")
def whole(folder, tmp_path_factory):
    out = tmp_path_factory.mktemp("whole")
    run(*words(folder, out, "--exposure", "auto"))
    return contents(out)


def test_finished_images_are_kept(folder, whole, tmp_path, monkeypatch):
    start(folder, tmp_path, 4, monkeypatch, "--exposure", "auto")
    (tmp_path / "turn2.png").write_bytes(b"of somebody else")
    (tmp_path / LIST).open("a").write("[5, [1")  # as a crash may leave it
    written = interrupt_after(99, monkeypatch)
    told = run(*words(folder, tmp_path, "--exposure", "auto"), "--json").json
    assert written == [2, 4, 5, 6, 7, 8]
    assert told["notes"][0] == f"3 of {COUNT} images are there, of this command when it was interrupted"
    assert contents(tmp_path) == whole
    written.clear()
    again = run(*words(folder, tmp_path, "--exposure", "auto"), "--json").json
    assert written == list(range(COUNT))  # a whole turntable is made anew
    assert again["exposure"] == told["exposure"]
    assert again["below"] == told["below"]


@pytest.mark.parametrize("change", ["option", "fit", "light", "list"])
def test_another_command_begins_anew(folder, tmp_path, monkeypatch, change):
    start(folder, tmp_path, 4, monkeypatch)
    if change == "list":
        (tmp_path / LIST).write_bytes(b"\xff\xfe\x00")
    elif change != "option":
        os.utime(folder / {"fit": "fit.h5", "light": "sky.h5"}[change])
    written = interrupt_after(99, monkeypatch)
    run(*words(folder, tmp_path, *(("--tonemap", "reinhard") if change == "option" else ())))
    assert written == list(range(COUNT))
    assert len(contents(tmp_path)) == COUNT


def test_what_is_missing_is_told_as_of_one_image(folder, tmp_path):
    with pytest.raises(cr.InputError, match=r"there is no file .*none\.h5"):
        cr.relight(folder / "none.h5", out=tmp_path / "turn%d.png", light=folder / "sky.h5", turntable=COUNT)


def test_a_list_that_is_a_link_is_left_alone(folder, tmp_path):
    """Anybody may put one into a shared folder."""
    (tmp_path / "theirs").write_text("theirs")
    (tmp_path / LIST).symlink_to(tmp_path / "theirs")
    ended = call(*words(folder, tmp_path))
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert f"{LIST}: it is there and is no regular file" in ended.err
    assert (tmp_path / "theirs").read_text() == "theirs"


def test_a_list_that_cannot_be_written_anew_stays(folder, tmp_path, monkeypatch):
    start(folder, tmp_path, 4, monkeypatch)
    before, write = (tmp_path / LIST).read_text(), durable.Part.write

    def fill(self, content):
        if self.target.name == LIST:
            raise cr.InputError("the disk is full")
        write(self, content)

    with monkeypatch.context() as patch:
        patch.setattr(durable.Part, "write", fill)
        assert call(*words(folder, tmp_path)).code == 2
    assert (tmp_path / LIST).read_text() == before
    assert run(*words(folder, tmp_path), "--json").json["notes"][0].startswith("4 of 9 images are there")


def test_all_digits_of_a_turn_count(tmp_path):
    matrix = np.eye(3).ravel() / 3.0
    names = [str(tmp_path / f"turn{i}.png") for i in range(2)]

    def key(turn):
        how = relighting.take_how(rotate=("matrix", turn))
        return unfinished.unfinished_images(names, [("fit.h5", 1, 2)], [how])._lines[0]

    assert key(matrix) == key(matrix.tolist())
    assert key(matrix) != key(matrix * (1.0 + 1e-12))


def test_a_light_that_changes_once_it_is_read_is_another(folder, tmp_path, monkeypatch):
    opened_on = relight.opened_on

    def changed(*arguments):
        os.utime(folder / "sky.h5")
        return opened_on(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(relight, "opened_on", changed)
        start(folder, tmp_path, 4, monkeypatch)
    assert not run(*words(folder, tmp_path), "--json").json["notes"][0].startswith("4 of")


def test_directions_made_together_are_made_together_again(folder, tmp_path, monkeypatch):
    (tmp_path / "dome.lp").write_text("6\n" + "".join(f"x{i}.png 0.{i} 0.1 1\n" for i in range(6)))
    monkeypatch.setattr("clrelight.jobs.frames.TILE_BYTES", 2 * 4 * 24 * 32 * 3)
    asked = ["relight", folder / "fit.h5", tmp_path / "turn%d.png", "--lights", tmp_path / "dome.lp"]
    cut(asked, 3, monkeypatch)
    with monkeypatch.context() as patch:
        written = interrupt_after(99, patch)
        run(*asked)
    assert written == [2, 3, 4, 5]
    found = contents(tmp_path)
    run(*asked)
    assert contents(tmp_path) == found


def test_a_killed_command_leaves_whole_images(folder, whole, tmp_path):
    started = subprocess.Popen(
        command_line(*words(folder, tmp_path, "--exposure", "auto")), env=environment(), stderr=subprocess.DEVNULL
    )
    try:
        end = time.monotonic() + 60
        while not (tmp_path / "turn1.png").exists() and started.poll() is None and time.monotonic() < end:
            time.sleep(0.001)
        started.send_signal(signal.SIGKILL)
    finally:
        started.kill()
        started.wait()
    left = {name: content for name, content in contents(tmp_path).items() if name.startswith("turn")}
    assert left.items() <= whole.items()
    run(*words(folder, tmp_path, "--exposure", "auto"))
    assert {name: content for name, content in contents(tmp_path).items() if not name.startswith(".")} == whole


def test_workers_leave_out_what_is_there(folder, tmp_path, monkeypatch):
    images, report = tmp_path / "turn%d.exr", Report()
    light = {"light": folder / "sky.h5", "turntable": 20, "exposure": "auto"}
    add = unfinished.Unfinished.add

    def stop(self, number, facts):
        add(self, number, facts)
        if number == 10:  # of the second part
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(unfinished.Unfinished, "add", stop)
        with pytest.raises(KeyboardInterrupt):
            run_single("relight", folder / "fit.h5", images, options=light, engine=Here(), report=Report())
    times = {path.name: path.stat().st_mtime_ns for path in tmp_path.glob("turn*.exr")}
    assert len(times) == 11
    run_single("relight", folder / "fit.h5", images, options=light, engine=Here(), report=report)
    assert any("11 of 20 images are there" in note for note in report.notes)
    kept = {name for name, since in times.items() if (tmp_path / name).stat().st_mtime_ns == since}
    assert kept == {f"turn{number}.exr" for number in range(8)}  # whole parts
    found = contents(tmp_path)
    cr.relight(folder / "fit.h5", out=images, report=Report(), **light)
    assert contents(tmp_path) == found


def test_workers_on_another_device_begin_anew(folder, tmp_path, monkeypatch):
    add, light = unfinished.Unfinished.add, {"light": folder / "sky.h5", "turntable": COUNT}

    def stop(self, number, facts):
        add(self, number, facts)
        raise KeyboardInterrupt

    def relit(device):
        report = Report()
        run_single(
            "relight",
            *(folder / "fit.h5", tmp_path / "turn%d.png"),
            options=light,
            engine=Here(),
            device=device,
            report=report,
        )
        return report.notes

    with monkeypatch.context() as patch:
        patch.setattr(unfinished.Unfinished, "add", stop)
        with pytest.raises(KeyboardInterrupt):
            relit("pocl")
    assert (tmp_path / LIST).exists()
    assert not any("images are there" in note for note in relit(None))


def test_what_is_there_is_told_before_the_rest_is_made(folder, tmp_path, monkeypatch):
    start(folder, tmp_path, 4, monkeypatch)
    with monkeypatch.context() as patch:
        interrupt_after(1, patch)
        ended = call(*words(folder, tmp_path))
    assert ended.code == 130
    assert ended.err.startswith(f"note: 4 of {COUNT} images are there, of this command when it was interrupted\n")


def test_notes_on_kept_images_are_told_again(folder, tmp_path, monkeypatch):
    asked = ["relight", folder / "fit.h5", tmp_path / "turn%d.png", "--light", "0,0.5,-1", "--light", "0,0,1"]
    cut(asked, 1, monkeypatch)
    lines = run(*asked).err.splitlines()
    assert "note: light 0 is below the horizon, where a hemispherical fit knows nothing" in lines
