"""No room for what a command writes: one line, and everything as it was."""

import errno
import os

import numpy as np
import pytest

from clrelight import durable
from clrelight.images import write_image
from tests.commands import call, contents, succeed

COMMANDS = {
    "ring.h5": "synth ring {out} --size 8 --lights 6",
    "stack.h5": "ingest {made}/photos {out}",
    "fit.h5": "fit {made}/ring.h5 {out} --degree 1",
    "enc.h5": "encode {made}/fit.h5 {out} --codec half",
    "dec.h5": "decode {made}/enc.h5 {out}",
    "light.h5": "light {out} --sky clear --sun 35,120 --degree 2",
    "relit.png": "relight {made}/fit.h5 {out} --light 0,0,1",
    "relit.jpg": "relight {made}/fit.h5 {out} --light 0,0,1",
    "relit.exr": "relight {made}/fit.h5 {out} --light 0,0,1",
    "frame%d.png": "relight {made}/fit.h5 {out} --light {made}/light.h5 --turntable 2",
    "turn.gif": "relight {made}/fit.h5 {out} --light {made}/light.h5 --turntable 2",
    "texture.dds": "export {made}/fit.h5 {out}",
    "textures": "export {made}/fit.h5 {out} --format exr",
    "irradiance.hdr": "irradiance {made}/map.exr {out} --size 8",
    "lights.lp": "plan-lights --degree 1 --count 6 {out} --force",
    "rows.h5": "bench {made}/ring.h5 --out {out} --methods uls --degrees 1 --codecs none",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    place = tmp_path_factory.mktemp("full")
    for name in ("ring.h5", "fit.h5", "enc.h5", "light.h5"):
        succeed(*COMMANDS[name].format(made=place, out=place / name).split())
    (place / "photos").mkdir()
    for i in range(4):
        succeed("relight", place / "fit.h5", place / "photos" / f"{i}.png", "--light", f"{0.1 * i},0,1")
    (place / "photos" / "light_directions.txt").write_text("".join(f"{0.1 * i} 0 1\n" for i in range(4)))
    write_image(place / "map.exr", np.ones((4, 8, 3), np.float32))
    return place


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EROFS])
@pytest.mark.parametrize("name", [name for name in COMMANDS if not name.startswith("texture")])  # others write those
def test_a_disk_without_room(made, tmp_path, monkeypatch, name, error):
    words = COMMANDS[name].format(made=made, out=name).split()
    monkeypatch.chdir(tmp_path)
    if name != "rows.h5":  # which writes to nothing that others have written
        (tmp_path / name.replace("%d", "0")).write_bytes(b"precious")
    before, real = contents(tmp_path), os.write

    def refuse(descriptor, content):
        if os.path.realpath(f"/proc/self/fd/{descriptor}").startswith(str(tmp_path)):
            raise OSError(error, os.strerror(error))
        return real(descriptor, content)

    monkeypatch.setattr(durable.os, "write", refuse)
    ended = call(*words)
    reason = os.strerror(error) if error == errno.EROFS else "the disk is full"
    assert (ended.code, ended.out) == (2, ""), ended.err
    said = [line for line in ended.err.splitlines() if not line.startswith("note: ")]
    assert said == [f"clrelight: cannot write {written(name)}: {reason}"]
    assert contents(tmp_path) == before


def written(name):
    """Return the first file that a command writes."""
    return {"frame%d.png": "frame0.png"}.get(name, name)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_folder_in_its_place(made, tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    place = tmp_path / name.replace("%d", "0")
    place.mkdir()
    (place / "kept").write_bytes(b"precious")
    ended = call(*COMMANDS[name].format(made=made, out=name).split())
    assert (ended.code, ended.out) == (2, ""), ended.err
    (line,) = (line for line in ended.err.splitlines() if not line.startswith("note: "))
    assert line.startswith("clrelight: ")
    assert place.name in line
    assert contents(tmp_path) == {f"{place.name}/kept": b"precious"}
