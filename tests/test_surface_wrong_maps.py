"""Maps that a command does not take are refused: encoded, decoded or cut, they still say whose functions they are."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.jobs.region import Part, crop
from clrelight.lighting.light import Light
from clrelight.lighting.relighting import relight_under
from clrelight.surface import surface_facts
from clrelight.transfer.reflection import add_diffuse
from clrelight.transfer.vertex_order import reorder
from tests.commands import call
from tests.meshes import icosphere

pytest.importorskip("embreex")

LIGHT = Light(np.array([[2.0], [0.3], [-1.1], [0.2]]))  # most of it from below
BALL = icosphere(1)


@pytest.fixture
def files(tmp_path):
    cr.write_light(tmp_path / "light.h5", LIGHT)
    for frame in ("global", "local"):
        cr.transfer(BALL, kind="unshadowed", degree=2, frame=frame, out=tmp_path / f"{frame}.h5")
    cr.transfer_operators(BALL, "phong:5", 1, samples=64, out=tmp_path / "operators.h5")
    cr.reflect(tmp_path / "operators.h5", LIGHT, out=tmp_path / "seen.h5")
    for name in ("global", "local", "seen", "operators"):
        cr.encode(tmp_path / f"{name}.h5", "half", out=tmp_path / f"{name}-coded.h5")
    return tmp_path


def test_encoded_transfer_knows_the_whole_sphere(files):
    told = cr.relight(files / "global.h5", light=LIGHT)
    np.testing.assert_allclose(cr.relight(files / "global-coded.h5", light=LIGHT), told, atol=1e-3)
    ended = call("relight", files / "global-coded.h5", files / "o.exr", "--light", files / "light.h5")
    assert (ended.code, "horizon" in ended.err) == (0, False)


@pytest.mark.parametrize(
    ("name", "says"), [("local", "each vertex's own frame"), ("seen", "direction to the eye"), ("operators", "reflect")]
)
@pytest.mark.parametrize("coded", ["", "-coded"])
def test_what_takes_no_light_from_everywhere_is_refused(files, name, says, coded):
    ended = call("relight", files / f"{name}{coded}.h5", files / "o.png", "--light", files / "light.h5")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert says in ended.err
    assert not (files / "o.png").exists()


def test_a_part_of_a_map_says_whose_functions_it_has(files):
    ended = call("encode", files / "local.h5", files / "klt.h5", "--codec", "klt", "--rate", "8")
    assert ended.code == 0
    for name in ("klt", "local-coded"):
        assert call("decode", files / f"{name}.h5", files / "part.h5", "--region", "0,0,1,5").code == 0
        with cr.open_fit(files / "part.h5") as held:
            assert held.image_shape[:2] == (5, 1)
            assert surface_facts(held.surface, held.config) == {"frame": "local", "argument": "light"}
    with cr.open_fit(files / "local.h5") as held:
        part = crop(held, Part((0, 0, 1, 5)))
    assert surface_facts(part.surface, part.config) == {"frame": "local", "argument": "light"}


@pytest.mark.parametrize("coded", ["", "-coded"])
def test_shaders_take_functions_of_the_light(files, coded):
    def made(name):
        return call(
            "shader", "transfer", files / "light.h5", "--map", files / f"{name}{coded}.h5", "--out", files / "o.glsl"
        )

    for name in ("operators", "seen"):
        ended = made(name)
        assert (ended.code, ended.err.count("\n"), (files / "o.glsl").exists()) == (2, 1, False)
        assert "shaders take functions of the direction to the light" in ended.err
    assert "in local frames: turn the light into each" in made("local").err
    assert made("global").err == ""


def test_transfer_is_added_to_operators_of_the_same_vertices():
    operators = cr.transfer_operators(BALL, "phong:5", 1, samples=64)
    alike = cr.transfer(BALL, kind="unshadowed", degree=1)
    add_diffuse(operators, alike)
    other = cr.transfer(reorder(BALL, "hilbert")[0], kind="unshadowed", degree=1)
    with pytest.raises(cr.InputError, match="of other vertices, or in another order"):
        add_diffuse(operators, other)
    with pytest.raises(cr.InputError, match="functions of the light"):
        add_diffuse(operators, cr.reflect(operators, LIGHT))
    with pytest.raises(cr.InputError, match="functions of the light"):
        add_diffuse(operators, operators)
    with pytest.raises(cr.InputError, match="axes of the mesh"):
        add_diffuse(operators, cr.transfer(BALL, kind="unshadowed", degree=1, frame="local"))


def test_a_part_is_lit_as_the_whole():
    whole = cr.transfer(BALL, kind="unshadowed", degree=2)
    bare = cr.decode(cr.encode(whole, "half"))
    assert bare.surface is None
    np.testing.assert_allclose(relight_under(bare, LIGHT), relight_under(whole, LIGHT), atol=1e-3)
