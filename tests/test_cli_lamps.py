"""Lights that `clrelight light` makes without a map, rotations of light and relight, and what they refuse."""

import numpy as np
import pytest

from clrelight.harmonics.rotation import rotation_matrix
from clrelight.images import read_image
from clrelight.lighting.lamps import cap_light, cast_shadow, directional_light
from clrelight.lighting.light import Light, apply_window
from clrelight.lighting.rotation import rotate_light
from clrelight.lighting.sky import sky_light
from clrelight.store import read_light, write_light
from tests.commands import call, succeed
from tests.test_cli_refusals import refuse

TURN = rotation_matrix("euler", (10, 20, 30))


def shaded(light):
    return cast_shadow(light, (0, 0, 1), 15)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a fit and two lights."""
    folder = tmp_path_factory.mktemp("made")
    succeed("synth", "ring", folder / "stack.h5", "--size", 16, "--lights", 36)
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", 3)
    rng = np.random.default_rng(0)
    write_light(folder / "light.h5", Light(rng.standard_normal((16, 3)) + 1.0, "made", "right,forward,up"))
    write_light(folder / "gray.h5", Light(rng.standard_normal((9, 1)), "gray"))
    write_light(folder / "fine.h5", Light(rng.standard_normal((51 * 51, 1)) + 1.0, "fine"))
    write_light(folder / "finer.h5", Light(rng.standard_normal((52 * 52, 1)) + 1.0, "finer"))
    return folder


LIGHTS = [
    ("@o.h5 --sky blue --sun 10,0", "sky must be one of overcast, clear, partly-cloudy, 1, 2"),
    ("@o.h5 --sky 16 --sun 10,0", "sky must be one of"),
    ("@o.h5 --sky clear", "sky clear needs the sun: --sun ELEVATION,AZIMUTH"),
    ("@o.h5 --sky clear --sun -5,0", "the sun is below the horizon: its elevation must be 0 to 90 degrees, got -5"),
    ("@o.h5 --sky overcast --sun -5,0", "the sun is below the horizon"),
    ("@o.h5 --sky clear --sun 95,0", "an elevation of 0 to 90 degrees and a finite azimuth, got 95,0"),
    ("@o.h5 --sky clear --sun 10", "expected 2 numbers separated by commas"),
    ("@o.h5 --sky clear --sun 10,nan", "expected 2 numbers separated by commas"),
    ("@o.h5 --sky clear --sun 10,0 --zenith 0", "the luminance of the zenith must be above 0 kcd/m², got 0"),
    ("@o.h5 --sky clear --sun 10,0 --zenith nan", "the luminance of the zenith must be above 0"),
    ("@o.h5 --sky overcast --axes camera", "--axes is for maps (--env); --rotate turns any light"),
    ("@o.h5 --sky overcast --layout cube", "--layout is for maps"),
    ("@o.h5 --sky overcast --method direct", "--method is for maps"),
    ("@o.h5 --edit light.h5 --transfer srgb", "--transfer is for maps"),
    ("@o.h5 --cap 0,0,1", "expected 4 numbers separated by commas, such as 0,0,1,30"),
    ("@o.h5 --cap 0,0,1,0", "the angle of a cap must be above 0 and at most 180 degrees, got 0"),
    ("@o.h5 --cap 0,0,1,181", "the angle of a cap must be above 0 and at most 180 degrees, got 181"),
    ("@o.h5 --cap 0,0,0,10", "three finite numbers that are not all zero"),
    ("@o.h5 --directional 0,0", "expected 3 numbers separated by commas"),
    ("@o.h5 --directional 0,0,0", "three finite numbers that are not all zero"),
    ("@o.h5 --directional 0,0,1 --colour 1,2", "--colour takes 1 or 3 numbers, got 2"),
    ("@o.h5 --directional 0,0,1 --colour 1,-2,0", "a colour is 1 or 3 finite numbers that are not negative"),
    ("@o.h5 --directional 0,0,1 --sun 10,0", "--sun is for --sky"),
    ("@o.h5 --cap 0,0,1,10 --zenith 1", "--zenith is for --sky"),
    ("@o.h5 --edit light.h5 --colour 1,1,1", "--colour is for --sky, --cap and --directional"),
    ("@o.h5 --cap 0,0,1,10 --at 0,0,1", "--at is for --blend"),
    ("@o.h5 --cap 0,0,1,10 --power 1", "--power is for --blend"),
    ("@o.h5 --cap 0,0,1,10 --sky overcast", "give the light by one of --env FILE, --edit LIGHT, --sky NAME, --cap"),
    ("@o.h5 --cap 0,0,1,10 --edit light.h5", "give the light by one of"),
    ("@o.h5 --blend light.h5", "expected a light file and its position, such as hall.h5@0,1.5,2"),
    ("@o.h5 --blend light.h5@0,1", "expected 3 numbers separated by commas, such as 0,1.5,2"),
    ("@o.h5 --blend nowhere.h5@0,1,2 --at 0,0,0", "there is no file nowhere.h5"),
    ("@o.h5 --blend nowhere.h5@0,1,2", "--blend needs the place where the light is wanted: --at X,Y,Z"),
    ("@o.h5 --directional 0,0,1 --degree 101", "101 is not in the range"),
    ("@o.h5 --directional 0,0,1 --shadow 0,0,1,0", "the angle of a shadow must be above 0 and at most 180"),
    ("@o.h5 --directional 0,0,1 --shadow 0,0,0,10", "not all zero"),
    ("@o.h5 --edit finer.h5 --shadow 0,0,1,10", "a shadow needs a light of degree 50 or less, got 51"),
    ("@o.h5 --edit light.h5 --rotate x", "expected an angle about z in degrees, such as 90, or euler:A,B,C"),
    ("@o.h5 --edit light.h5 --rotate 1,2", "expected an angle about z in degrees"),
    ("@o.h5 --edit light.h5 --rotate euler:1,2", "expected an angle about z in degrees"),
    ("@o.h5 --edit light.h5 --rotate turn:1,2,3", "expected an angle about z in degrees"),
    ("@o.h5 --edit light.h5 --rotate axis:0,0,1,inf", "expected an angle about z in degrees"),
    ("@o.h5 --edit light.h5 --rotate axis:0,0,0,10", "the axis of a rotation must not be all zeros"),
    ("@o.h5 --edit light.h5 --rotate quaternion:0,0,0,0", "the quaternion of a rotation must not be all zeros"),
]
RELIGHTS = [
    ("fit.h5 @o.png --light light.h5 --rotate axis:0,0,0,10", "the axis of a rotation must not be all zeros"),
    ("fit.h5 @o.png --light light.h5 --about 0,1,0", "--about X,Y,Z is the axis of --turntable N"),
    ("fit.h5 @o%d.png --light light.h5 --turntable 2 --about 0,0,0", "and not all zero"),
    ("fit.h5 @o.png --light 0,0,1 --about 0,1,0", "are for light files"),
]
CASES = [(f"light {words}", said) for words, said in LIGHTS] + [(f"relight {words}", said) for words, said in RELIGHTS]


@pytest.mark.parametrize(("words", "said"), CASES, ids=[words for words, _ in CASES])
def test_refused(made, tmp_path, words, said):
    out = next((word[1:] for word in words.split() if word.startswith("@")), None)
    refuse(words.split(), made, tmp_path, out, said)


def test_a_blend_does_not_overwrite_its_samples(made, tmp_path):
    path = tmp_path / "o.h5"
    path.write_bytes((made / "light.h5").read_bytes())
    ended = call("light", path, "--blend", f"{path}@0,0,0", "--at", "0,0,1")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "that is the input" in ended.err
    assert path.read_bytes() == (made / "light.h5").read_bytes()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--sky", "overcast"), sky_light("overcast")),
        (
            ("--sky", "clear", "--sun", "35,120", "--zenith", 4.5, "--degree", 3, "--colour", "1,0.9,0.8"),
            sky_light("clear", 35.0, 120.0, zenith=4.5, degree=3, colour=(1.0, 0.9, 0.8)),
        ),
        (("--sky", "13", "--sun", "0,-10"), sky_light("13", 0.0, -10.0)),
        (("--cap", "1,2,9,20", "--colour", 3), cap_light((1, 2, 9), 20, 6, (3.0,))),
        (("--directional", "0,6,8", "--degree", 2), directional_light((0, 3, 4), 2)),
        (
            ("--cap", "1,2,9,20", "--shadow", "0,0,1,15", "--rotate", "euler:10,20,30", "--window", "hann"),
            apply_window(shaded(rotate_light(cap_light((1, 2, 9), 20, 6), TURN)), "hann"),
        ),
    ],
)
def test_light_makes_what_was_asked(tmp_path, words, expected):
    printed = succeed("light", tmp_path / "o.h5", *words, "--json").json
    light = read_light(tmp_path / "o.h5")
    np.testing.assert_allclose(light.coeffs_kc, expected.coeffs_kc, atol=1e-13)
    assert printed["config"] == light.config
    assert (light.source, light.axes) == (expected.source, "")


def test_blends(made, tmp_path):
    samples = ("--blend", f"{made / 'light.h5'}@0,0,0", "--blend", f"{made / 'gray.h5'}@0,0,2")
    succeed("light", tmp_path / "o.h5", *samples, "--at", "0,0,0.5", "--power", 1)
    colour, gray = read_light(made / "light.h5").coeffs_kc, read_light(made / "gray.h5").coeffs_kc
    blend = read_light(tmp_path / "o.h5")
    np.testing.assert_allclose(blend.coeffs_kc[:9], 0.75 * colour[:9] + 0.25 * gray, atol=1e-14)
    np.testing.assert_allclose(blend.coeffs_kc[9:], 0.75 * colour[9:], atol=1e-14)
    assert (blend.source, blend.config["power"]) == ("blend of made, gray", 1.0)


def test_lights_below_the_horizon_are_told_of(tmp_path):
    for words, note in (
        (("--directional", "0,1,-0.1"), "the light is below the horizon (z < 0): relighting a fit"),
        (("--cap", "0,0,-1,89"), "the light is below the horizon"),
        (("--cap", "0,1,0.1,30"), "a part of the light is below the horizon"),
        (("--sky", "overcast", "--rotate", "axis:1,0,0,-90"), "a part of the light is below the horizon"),
    ):
        ended = call("light", tmp_path / "o.h5", *words)
        assert (ended.code, ended.err.count("\n")) == (0, 1)
        assert ended.err.startswith(f"note: {note}")
    succeed("light", tmp_path / "o.h5", "--cap", "0,0,1,89")
    # Once turned up it is not.
    succeed("light", tmp_path / "o.h5", "--directional", "0,0,-1", "--rotate", "axis:1,0,0,180")


def test_light_and_relight_rotate_alike(made, tmp_path):
    rotation = "quaternion:1,0.3,-0.2,0.5"
    succeed("light", tmp_path / "turned.h5", "--edit", made / "light.h5", "--rotate", rotation)
    expected = rotate_light(read_light(made / "light.h5"), rotation_matrix("quaternion", (1, 0.3, -0.2, 0.5)))
    turned = read_light(tmp_path / "turned.h5")
    np.testing.assert_allclose(turned.coeffs_kc, expected.coeffs_kc, atol=1e-13)
    np.testing.assert_allclose(
        turned.config["rotation"], rotation_matrix("quaternion", (1, 0.3, -0.2, 0.5)), atol=1e-15
    )
    call("relight", made / "fit.h5", tmp_path / "file.exr", "--light", tmp_path / "turned.h5")
    call("relight", made / "fit.h5", tmp_path / "option.exr", "--light", made / "light.h5", "--rotate", rotation)
    images = [read_image(tmp_path / f"{name}.exr") for name in ("file", "option")]
    np.testing.assert_allclose(*images, rtol=1e-5, atol=1e-6)
    # and once more undoes it
    succeed("light", tmp_path / "back.h5", "--edit", tmp_path / "turned.h5", "--rotate", "quaternion:1,-0.3,0.2,-0.5")
    back = read_light(tmp_path / "back.h5")
    np.testing.assert_allclose(back.coeffs_kc, read_light(made / "light.h5").coeffs_kc, atol=1e-13)
    np.testing.assert_allclose(back.config["rotation"], np.eye(3), atol=1e-15)


def test_a_turntable_about_another_axis(made, tmp_path):
    words = ("relight", made / "fit.h5", tmp_path / "t%d.exr", "--light", made / "light.h5")
    call(*words, "--turntable", 4, "--about", "0,2,0")
    call("relight", made / "fit.h5", tmp_path / "o.exr", "--light", made / "light.h5", "--rotate", "axis:0,1,0,90")
    np.testing.assert_allclose(read_image(tmp_path / "t1.exr"), read_image(tmp_path / "o.exr"), atol=1e-6)
    assert np.abs(read_image(tmp_path / "t0.exr") - read_image(tmp_path / "t1.exr")).max() > 1e-3


def test_shadows_to_degree_50(made, tmp_path):
    succeed("light", tmp_path / "o.h5", "--edit", made / "fine.h5", "--shadow", "0,0,1,10")
    assert read_light(tmp_path / "o.h5").degree == 50
