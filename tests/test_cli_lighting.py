"""The commands light and irradiance, relight under light files, and what they refuse."""

import json

import h5py
import numpy as np
import pytest

from clrelight.device import open_device
from clrelight.images import read_image, write_image
from clrelight.lighting.light import Light, share_below, turn_about_z
from clrelight.store import read_light, write_light
from tests.commands import attributes, call, contents, succeed
from tests.hdf5 import unseal
from tests.test_cli_refusals import refuse


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with maps of each kind, a fit, a light, and spoilt ones."""
    folder = tmp_path_factory.mktemp("made")
    rng = np.random.default_rng(0)
    latlong = rng.random((16, 32, 3)).astype(np.float32) + 0.5
    write_image(folder / "map.exr", latlong)
    write_image(folder / "gray.exr", latlong[..., :1])
    write_image(folder / "square.exr", latlong[:, :16])
    write_image(folder / "sky_posx.exr", latlong[:, :16])
    write_image(folder / "odd.exr", latlong[:15])
    write_image(folder / "display.png", (latlong * 80).astype(np.uint8))
    for name, value in (("negative", -1.0), ("nan", np.nan), ("infinite", np.inf)):
        spoilt = latlong.copy()
        spoilt[3, 7, 1] = value
        write_image(folder / f"{name}.exr", spoilt)
    (folder / "text.hdr").write_text("no picture")
    (folder / "text.dds").write_text("no texture")
    (folder / "short.dds").write_bytes(b"DDS " + bytes(124))
    (folder / "empty.exr").touch()
    succeed("synth", "ring", folder / "stack.h5", "--size", 16, "--lights", 36)
    succeed("fit", folder / "stack.h5", folder / "fit.h5", "--degree", 3)
    succeed("encode", folder / "fit.h5", folder / "enc.h5", "--codec", "klt")
    # 1 + z / 2, so that a known part comes from below the horizon
    coeffs_kc = np.zeros((9, 3))
    coeffs_kc[0], coeffs_kc[2] = np.sqrt(4 * np.pi), np.sqrt(4 * np.pi / 3) / 2
    coeffs_kc[3] = 0.3
    write_light(folder / "light.h5", Light(coeffs_kc, "made", "right,forward,up"))
    return folder


LIGHTS = [
    ("@o.h5", "give the light by one of --env FILE, --edit LIGHT"),
    ("@o.h5 --env map.exr --edit light.h5", "give the light by one of"),
    ("@o.h5 --env nowhere.exr", "there is no image nowhere.exr"),
    ("@o.h5 --env text.hdr", "cannot read image"),
    ("@o.h5 --env empty.exr", "cannot read image"),
    ("@o.h5 --env text.dds", "is no DDS file"),
    ("@o.h5 --env nowhere.dds", "nowhere.dds"),
    ("@o.h5 --env short.dds", "texel format 0; read are cube maps of half or single floats"),
    ("@o.h5 --env negative.exr", "radiance -1.0 at row 3, column 7, channel 1; expected a finite number >= 0 (--clip-"),
    ("@o.h5 --env nan.exr", "the texel at row 3, column 7, channel 1 is nan"),
    ("@o.h5 --env infinite.exr", "the texel at row 3, column 7, channel 1 is inf"),
    ("@o.h5 --env odd.exr", "has 32×15 texels, which no layout has (latlong 2:1, angular 1:1"),
    ("@o.h5 --env map.exr --layout angular", "has 32×16 texels, layout angular must be 1:1"),
    ("@o.h5 --env map.exr --layout vertical-cross", "layout vertical-cross must be 3:4"),
    ("@o.h5 --env map.exr --layout sphere", "layout must be one of latlong, angular"),
    ("@o.h5 --env map.exr --layout cube", "a cube is six files or a DDS file"),
    ("@o.h5 --env sky_posx.exr", "is named as one face of a cube: give all six"),
    ("@o.h5 --env map.exr --env gray.exr", "one picture or the six faces of a cube, got 2 files"),
    ("@o.h5" + 5 * " --env square.exr" + " --env map.exr", "the faces of a cube are squares of one size"),
    ("@o.h5" + 6 * " --env square.exr" + " --layout latlong", "is a cube map, it cannot be of layout latlong"),
    ("@o.h5 --env map.exr --axes up", "axes must be z-up, probe, camera, or three directions"),
    ("@o.h5 --env map.exr --axes right,left,up", "axes must be"),
    ("@o.h5 --env map.exr --degree 101", "101 is not in the range"),
    ("@o.h5 --env map.exr --degree -1", "-1 is not in the range"),
    ("@o.h5 --env square.exr --method separable", "the separable transform is for latlong maps whose up is z"),
    ("@o.h5 --env map.exr --method separable --axes camera", "the separable transform is for latlong maps"),
    ("@o.h5 --env map.exr --window box", "window must be one of gaussian, hann, lanczos, got 'box'"),
    ("@o.h5 --env map.exr --window hann:x", "expected a window such as hann or hann:8"),
    ("@o.h5 --env map.exr --window hann:0", "positive number of degrees, got 0"),
    ("@o.h5 --env map.exr --window hann:nan", "positive number of degrees, got nan"),
    ("@o.h5 --env map.exr --scale nan", "--scale must be a finite number"),
    ("@o.h5 --edit light.h5 --scale 1e308", "coefficient 0 of channel 0 is inf"),
    ("@o.h5 --edit light.h5 --set L00=1.7e308,1,1", "summing them to radiance overflows"),
    ("@o.h5 --env map.exr --set L11", "such as L20,10=1 or L1-1=0.4,0.3,0.5, got 'L11'"),
    ("@o.h5 --env map.exr --set L510=1", "such as L20,10=1 or L1-1=0.4,0.3,0.5, got 'L510=1'"),
    ("@o.h5 --env map.exr --set L123=1", "expected a coefficient and 1 or 3 numbers"),
    ("@o.h5 --env map.exr --set L11=1,2", "expected a coefficient and 1 or 3 numbers"),
    ("@o.h5 --env map.exr --set L11=nan", "expected a coefficient and 1 or 3 numbers"),
    ("@o.h5 --env map.exr --set L12=1", "there is no coefficient L12: |m| is at most 1"),
    ("@o.h5 --env map.exr --set L101,0=1", "degree must be 0 to 100"),
    ("@o.h5 --env gray.exr --set L11=1,2,3", "L11 needs 1 number, got 3"),
    ("@o.h5 --edit fit.h5", "it is a fit/1 file, expected light/1"),
    ("@o.h5 --edit light.h5 --degree 3", "the light has degree 2, it cannot be cut to 3"),
    ("light.h5 --edit light.h5", "that is the input"),
    ("map.exr --env map.exr", "that is the input"),
    ("@no/o.h5 --env map.exr", "there is no folder"),
]
RELIGHTS = [
    ("fit.h5 @o.png --light nowhere.h5", "there is no file nowhere.h5"),
    ("fit.h5 @o.png --light stack.h5", "it is a stack/1 file, expected light/1"),
    ("fit.h5 @o.png --light map.exr", "is not an HDF5 file"),
    ("fit.h5 @o.png --light light.h5 --light 0,0,1", "a light file is light from everywhere: give one --light"),
    ("fit.h5 @o.png --light light.h5 --rotate x", "expected an angle about z in degrees"),
    ("fit.h5 @o.png --light light.h5 --rotate nan", "expected an angle about z in degrees"),
    ("fit.h5 @o.png --light light.h5 --turntable 3", "3 images need a number field in their name"),
    ("fit.h5 @o.png --light light.h5 --turntable 0", "0 is not in the range"),
    ("fit.h5 @o.png --light light.h5 --tonemap film", "'film' is not one of"),
    ("fit.h5 @o.exr --light light.h5 --tonemap clip", "--tonemap is for 8-bit files"),
    ("fit.h5 @o.exr --light light.h5 --transfer srgb", "--transfer is for 8-bit files"),
    ("fit.h5 @o.png --light light.h5 --exposure 99", "exposure must be a number of stops from -64 to 64, got 99"),
    ("fit.h5 @o.png --light 0,0,1 --rotate 90", "are for light files"),
    ("fit.h5 @o.png --light 0,0,1 --exposure auto", "are for light files"),
    ("fit.h5 light.h5 --light light.h5", "that is the input"),
]
IRRADIANCES = [
    ("map.exr @o.png", "write it to .exr, .hdr, .tif"),
    ("map.exr map.exr", "that is the input"),
    ("nowhere.exr @o.exr", "there is no image"),
    ("nan.exr @o.exr", "row 3, column 7, channel 1 is nan"),
    ("map.exr @o.exr --size 0", "0 is not in the range"),
    ("map.exr @o.exr --method both", "'both' is not one of"),
    ("map.exr @no/o.exr", "there is no folder"),
]
CASES = [(f"light {words}", expected) for words, expected in LIGHTS]
CASES += [(f"relight {words}", expected) for words, expected in RELIGHTS]
CASES += [(f"irradiance {words}", expected) for words, expected in IRRADIANCES]


@pytest.mark.parametrize(("words", "expected"), CASES, ids=[words for words, _ in CASES])
def test_refused(made, tmp_path, words, expected):
    out = next((word[1:] for word in words.split() if word.startswith("@") and "/" not in word), None)
    refuse(words.split(), made, tmp_path, out, expected)


def test_light_writes_what_it_prints(made, tmp_path):
    out = tmp_path / "o.h5"
    printed = succeed("light", out, "--env", made / "map.exr", "--degree", 4, "--window", "hann:8", "--json").json
    light = read_light(out)
    assert (light.degree, light.channels) == (4, 3)
    np.testing.assert_array_equal(printed["coefficients"], light.coeffs_kc[:9])
    assert printed["config"] == {"layout": "latlong", "method": "separable", "window": "hann", "window_width": 8.0}
    assert json.loads(attributes(out)["config"]) == printed["config"]
    assert attributes(out)["axes"] == "right,forward,up"
    assert attributes(out)["source"] == "map.exr"
    radiance = read_image(made / "map.exr")
    assert printed["mean"] == pytest.approx(radiance.mean(), rel=0.1)


def test_a_light_survives_its_file(tmp_path):
    coeffs_kc = np.random.default_rng(1).standard_normal((16, 1))
    light = Light(coeffs_kc, "made by hand", "", {"window": "hann"})
    write_light(tmp_path / "o.h5", light)
    back = read_light(tmp_path / "o.h5")
    np.testing.assert_array_equal(back.coeffs_kc, coeffs_kc)
    assert (back.source, back.axes, back.config) == (light.source, light.axes, light.config)
    first = (tmp_path / "o.h5").read_bytes()
    write_light(tmp_path / "o.h5", light)
    assert (tmp_path / "o.h5").read_bytes() == first


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("degree", 4, "attribute degree is 4, but there are 9 coefficients"),
        ("config", b"[1]", "attribute config must be a JSON object"),
        ("config", b'{"rotation": "abc"}', "attribute config: a rotation is an orthogonal 3 by 3 matrix"),
        ("config", b'{"rotation": [[1, 0], [0, 1, 0]]}', "attribute config: a rotation is an orthogonal 3 by 3 matrix"),
        ("config", b'{"rotation": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}', "a rotation is an orthogonal 3 by 3 matrix"),
        ("config", b'{"shadows": 3}', "attribute config: shadows must be rows of X, Y, Z, ANGLE"),
        ("config", b'{"shadows": [[0, 0, 1]]}', "attribute config: shadows must be rows of X, Y, Z, ANGLE"),
        ("config", b'{"shadows": [[0, 0, 1, 1e999]]}', "attribute config: shadows must be rows of X, Y, Z, ANGLE"),
        ("coefficients", np.nan, "coefficient 4 of channel 1 is nan"),
        ("coefficients", np.zeros((8, 3)), "a square"),
        ("coefficients", np.zeros((9, 2)), "light must be float64"),
    ],
)
def test_a_light_file_that_contradicts_itself_is_refused(made, tmp_path, name, value, said):
    path = tmp_path / "o.h5"
    path.write_bytes((made / "light.h5").read_bytes())
    with h5py.File(path, "a") as file:
        unseal(file)
        if name == "coefficients" and np.ndim(value) == 0:
            file[name][4, 1] = value
        elif name == "coefficients":
            for each in ("coefficients", "coefficient", "channel"):
                del file[each]
            file[name] = value
        else:
            file.attrs[name] = np.bytes_(value) if isinstance(value, bytes) else value
    for words in (("info", path), ("light", tmp_path / "new.h5", "--edit", path)):
        ended = call(*words)
        assert (ended.code, ended.err.count("\n")) == (2, 1)
        assert said in ended.err


def test_light_edits_and_scales(made, tmp_path):
    out = tmp_path / "o.h5"
    changes = ("--set", "L1-1=-0.4", "--set", "L22=1,2,3", "--set", "3,-2=5")
    shown = succeed("light", out, "--edit", made / "light.h5", "--scale", 2, *changes, "--print").out
    light = read_light(out)
    assert light.degree == 3
    before = read_light(made / "light.h5").coeffs_kc
    np.testing.assert_array_equal(light.coeffs_kc[0], 2 * before[0])
    np.testing.assert_array_equal(light.coeffs_kc[1], [-0.4] * 3)
    np.testing.assert_array_equal(light.coeffs_kc[8], [1, 2, 3])
    np.testing.assert_array_equal(light.coeffs_kc[10], [5] * 3)
    (row,) = (line.split() for line in shown.splitlines() if line.startswith("L22"))
    assert row == ["L22", "1", "2", "3"]
    succeed("light", tmp_path / "cut.h5", "--edit", out, "--degree", 1)
    np.testing.assert_array_equal(read_light(tmp_path / "cut.h5").coeffs_kc, light.coeffs_kc[:4])


@pytest.mark.parametrize(
    ("change", "index"),
    [
        ("L5,1=7", 31),
        ("L5 1=7", 31),
        (" L20 10 = 7 ", 430),
        ("L20,10=7", 430),
        ("L20+10=7", 430),
        ("L3 , -2 = 7", 10),
        ("22 =7", 8),
    ],
)
def test_a_change_names_one_coefficient(made, tmp_path, change, index):
    succeed("light", tmp_path / "o.h5", "--edit", made / "light.h5", "--set", change)
    coeffs_kc = read_light(tmp_path / "o.h5").coeffs_kc
    before_kc = np.zeros_like(coeffs_kc)
    before_kc[:9] = read_light(made / "light.h5").coeffs_kc
    before_kc[index] = 7.0
    np.testing.assert_array_equal(coeffs_kc, before_kc)


def test_a_blank_between_degree_and_order_parts_them(made, tmp_path):
    ended = call("light", tmp_path / "o.h5", "--edit", made / "light.h5", "--set", "L5 10=1")
    assert (ended.code, ended.err.count("\n")) == (2, 1)
    assert "there is no coefficient L5,10: |m| is at most 5" in ended.err


def test_lights_say_where_they_were_computed(made, tmp_path):
    label = open_device().info.label
    printed = succeed("irradiance", made / "map.exr", tmp_path / "o.exr", "--size", 4, "--json").json
    assert printed["device"] == label
    for words, device in (
        (("--env", made / "square.exr"), label),
        (("--env", made / "map.exr"), None),
        (("--edit", made / "light.h5"), None),
    ):
        assert succeed("light", tmp_path / "o.h5", *words, "--degree", 2, "--json").json["device"] == device


def test_info_knows_lights(made):
    facts = succeed("info", made / "light.h5", "--json").json
    assert facts["schema"] == "light/1"
    assert facts["attributes"] == {"degree": 2, "source": "made", "axes": "right,forward,up", "config": {}}
    assert facts["datasets"]["coefficients"]["shape"] == [9, 3]


@pytest.mark.parametrize(
    ("words", "note"),
    [
        (("--env", "display.png"), "display.png holds 8-bit values, taken as srgb"),
        (("--env", "display.png", "--transfer", "linear"), "taken as linear"),
        (("--env", "map.exr", "--degree", 9), "the map is fine enough for degree 7"),
    ],
)
def test_light_notes_what_limits_a_map(made, tmp_path, words, note):
    paths = [made / word if str(word).endswith((".png", ".exr")) else word for word in words]
    ended = call("light", tmp_path / "o.h5", *paths)
    assert ended.code == 0
    assert ended.err.startswith("note: ")
    assert ended.err.count("\n") == 1
    assert note in ended.err


@pytest.mark.parametrize("fitted", ["fit.h5", "enc.h5"])
def test_relighting_says_what_is_cut_and_turns(made, tmp_path, fitted):
    ended = call("relight", made / fitted, tmp_path / "o.exr", "--light", made / "light.h5")
    assert ended.code == 0
    # 1 + z / 2 sends 3/8 of its light from below; the x part cancels.
    assert (
        ended.err == "note: 37.5% of the light comes from below the horizon, where the fit knows nothing: it is cut\n"
    )
    turned = tmp_path / "turned.h5"
    write_light(turned, turn_about_z(read_light(made / "light.h5"), np.pi / 2))
    call("relight", made / fitted, tmp_path / "file.exr", "--light", turned)
    call("relight", made / fitted, tmp_path / "option.exr", "--light", made / "light.h5", "--rotate", 90)
    call("relight", made / fitted, tmp_path / "t%d.exr", "--light", made / "light.h5", "--turntable", 4)
    images = {name: read_image(tmp_path / f"{name}.exr") for name in ("o", "file", "option", "t0", "t1")}
    np.testing.assert_allclose(images["option"], images["file"], rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(images["t0"], images["o"])
    np.testing.assert_allclose(images["t1"], images["option"], atol=1e-6)
    assert np.abs(images["o"] - images["option"]).max() > 1e-3


def test_automatic_exposure_fills_the_display(made, tmp_path):
    words = ("relight", made / "fit.h5", tmp_path / "o.png", "--light", made / "light.h5", "--exposure", "auto")
    printed = succeed(*words, "--json").json
    assert printed["below"] == pytest.approx(0.375)
    assert 250 <= np.percentile(read_image(tmp_path / "o.png").max(axis=2), 99) <= 255
    bright = read_image(tmp_path / "o.png").astype(int)
    call(*words, "--tonemap", "reinhard")
    assert read_image(tmp_path / "o.png").astype(int).max() < bright.max()


def test_a_turntable_as_an_animation(made, tmp_path):
    pillow = pytest.importorskip("PIL.Image", reason="animations are written by Pillow")
    call("relight", made / "fit.h5", tmp_path / "o.gif", "--light", made / "light.h5", "--turntable", 3)
    with pillow.open(tmp_path / "o.gif") as animation:
        assert (animation.size, animation.n_frames) == ((16, 16), 3)
    assert list(contents(tmp_path)) == ["o.gif"]


def test_an_animation_keeps_8_bit_frames(made, tmp_path, monkeypatch):
    pytest.importorskip("PIL.Image", reason="animations are written by Pillow")
    kept = []
    monkeypatch.setattr("clrelight.jobs.relighting.write_animation", lambda name, frames: kept.extend(frames))
    words = ("--light", made / "light.h5", "--turntable", 3, "--exposure", "auto", "--tonemap", "reinhard")
    call("relight", made / "fit.h5", tmp_path / "o.gif", *words)
    call("relight", made / "fit.h5", tmp_path / "o%d.png", *words)
    assert [frame.dtype for frame in kept] == [np.uint8] * 3
    for step, frame in enumerate(kept):
        np.testing.assert_array_equal(frame, read_image(tmp_path / f"o{step}.png"))


def test_a_turntable_says_what_is_cut_at_its_worst_step(made, tmp_path):
    succeed("light", tmp_path / "up.h5", "--cap", "0,0,1,30", "--degree", 4)
    words = ("relight", made / "fit.h5", tmp_path / "o%d.png", "--light", tmp_path / "up.h5")
    words += ("--turntable", 4, "--about", "0,1,0")
    # Half a turn puts the zenith at the nadir, and its ringing above: what was above is then below.
    upright = 1.0 - share_below(read_light(tmp_path / "up.h5"))
    assert upright > 0.9
    ended = call(*words)
    assert f"note: up to {upright:.1%} of the light comes from below the horizon" in ended.err
    assert call(*words, "--json").json["below"] == pytest.approx(upright)


@pytest.mark.parametrize("shape", ["latlong", "angular"])
def test_irradiance_by_both_methods(made, tmp_path, shape):
    words = ("irradiance", made / "map.exr", tmp_path / "o.exr", "--size", 8, "--map", shape)
    nine = succeed(*words, "--json").json
    nine_hwc = read_image(tmp_path / "o.exr")
    brute = succeed(*words, "--method", "brute", "--json").json
    brute_hwc = read_image(tmp_path / "o.exr")
    assert nine_hwc.shape == brute_hwc.shape == ((8, 16, 3) if shape == "latlong" else (8, 8, 3))
    assert 0 < brute["nine_error_maximum"] < 0.05
    assert np.abs(nine_hwc - brute_hwc).max() < 0.05 * 4 * np.pi
    assert (nine_hwc[0, 0] == 0).all() == (shape == "angular")
    assert np.shape(nine["matrix"]) == (3, 4, 4)


def test_irradiance_and_light_look_the_same_way(made, tmp_path):
    # A matte surface facing the lamp gets most: the map keeps the view of its environment.
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[4, 9] = 1.0
    write_image(tmp_path / "lamp.exr", radiance)
    for axes in ("z-up", "camera", "left,forward,down"):
        succeed("irradiance", tmp_path / "lamp.exr", tmp_path / "o.exr", "--size", 16, "--axes", axes)
        brightest = np.unravel_index(np.argmax(read_image(tmp_path / "o.exr")[..., 0]), (16, 32))
        assert np.abs(np.array(brightest) - (4, 9)).max() <= 1
