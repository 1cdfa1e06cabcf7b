"""Turntables of surfaces that are interrupted go on where they were, and only those."""

import os

import numpy as np
import pytest

import clrelight as cr
from clrelight.jobs.reflection import render as reflection_render
from clrelight.jobs.surface import pictures
from clrelight.lighting.lamps import cap_light
from clrelight.shrm.record import Shrm
from clrelight.store import write_fit, write_light, write_shrm
from clrelight.transfer.near_lights import PointLight
from tests.commands import call, contents
from tests.rendering import sphere
from tests.test_render_job import clamped_cosine
from tests.test_unfinished import interrupt_after

COUNT = 4
LIST = ".t0.png.done"
LIGHT = cap_light((0.4, -0.6, 0.7), 40, 3, (1.0, 0.8, 0.5))
COMMANDS = ["render", "shrm"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("surfaces")
    write_fit(place / "ball.h5", clamped_cosine(sphere(1), degree=2))
    write_light(place / "cap.h5", LIGHT)
    maps = np.random.default_rng(0).random((4, 8, 16, 3), np.float32)
    write_shrm(place / "glossy.h5", Shrm(maps, "global", 3))
    return place


def words(command, folder, out, *more):
    asked = ["--size", 12, "--exposure", "auto", "--turntable", COUNT, *more]
    if command == "render":
        return ["render", folder / "ball.h5", out / "t%d.png", "--light", folder / "cap.h5", *asked]
    return ["shrm", "render", folder / "glossy.h5", out / "t%d.png", *asked]


def start(asked, out, monkeypatch):
    """Interrupt a turntable after two pictures."""
    with monkeypatch.context() as patch:
        interrupt_after(2, patch, pictures)
        assert call(*asked).code == 130
    assert sorted(contents(out)) == [LIST, "t0.png", "t1.png"]


@pytest.mark.parametrize(("command", "together", "made"), [("render", 1, [0, 2, 3]), ("shrm", 2, [0, 1, 2, 3])])
def test_finished_pictures_are_kept(folder, tmp_path, monkeypatch, command, together, made):
    (tmp_path / "whole").mkdir()
    (tmp_path / "some").mkdir()
    monkeypatch.setattr(reflection_render, "_together", lambda shrm: together)
    whole = call(*words(command, folder, tmp_path / "whole"), "--json").json
    asked = words(command, folder, tmp_path / "some")
    for broken, expected in [(False, [2, 3]), (True, made)]:
        start(asked, tmp_path / "some", monkeypatch)
        if broken:
            (tmp_path / "some/t0.png").write_bytes(b"of somebody else")
        with monkeypatch.context() as patch:
            written = interrupt_after(99, patch, pictures)
            told = call(*asked, "--json").json
        assert written == expected
        assert told["notes"][0] == f"{2 - broken} of 4 images are there, of this command when it was interrupted"
        assert told["exposure"] == whole["exposure"]
        assert contents(tmp_path / "some") == contents(tmp_path / "whole")
        for path in (tmp_path / "some").iterdir():
            path.unlink()


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("change", [("--turns",), ("--rotate", 20), ("--background", "1"), None])
def test_another_command_begins_anew(folder, tmp_path, monkeypatch, command, change):
    start(words(command, folder, tmp_path), tmp_path, monkeypatch)
    if change is None:
        os.utime(folder / ("ball.h5" if command == "render" else "glossy.h5"))
    elif change == ("--turns",):
        change += ("light" if command == "render" else "view",)
    written = interrupt_after(99, monkeypatch, pictures)
    assert call(*words(command, folder, tmp_path, *(change or ()))).code == 0
    assert written == [0, 1, 2, 3]
    assert len(contents(tmp_path)) == COUNT


def test_lights_count_by_their_numbers_and_unknown_ones_not_at_all(folder, tmp_path, monkeypatch):
    class Own:
        degree = 0

        def __init__(self, strength):
            self.lamp = PointLight((0.0, 0.0, 3.0), (strength,) * 3)

        def __getattr__(self, name):
            return getattr(self.lamp, name)

    asked = {"out": tmp_path / "t%d.png", "size": 12, "turntable": COUNT}
    for lights, expected in [
        ((PointLight((0.0, 0.0, 3.0)), PointLight((0.0, 0.0, 3.0))), [2, 3]),
        ((PointLight((0.0, 0.0, 3.0)), PointLight((0.0, 0.0, 3.1))), [0, 1, 2, 3]),
        ((Own(1.0),) * 2, [0, 1, 2, 3]),
    ]:
        for light, count in zip(lights, (2, 99), strict=True):
            with monkeypatch.context() as patch:
                written = interrupt_after(count, patch, pictures)
                try:
                    cr.render(folder / "ball.h5", [light], report=cr.Report(), **asked)
                except KeyboardInterrupt:
                    assert count == 2
        assert written == expected
