"""``clrelight operators`` and ``reflect`` on files, and their verbs."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.jobs.surface.meshes import take_surface
from clrelight.surface import Surface
from clrelight.transfer.brdfs import Phong
from clrelight.transfer.operators import transfer_operators
from clrelight.transfer.reflection import reflect
from clrelight.transfer.vertex_order import reorder
from tests.commands import arrays, call, contents, succeed

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("embreex")
WHITE = np.sqrt(4 * np.pi)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a mesh of two balls that shade each other, and a light."""
    path = tmp_path_factory.mktemp("glossy")
    first, second = trimesh.creation.icosphere(1), trimesh.creation.icosphere(1)
    second.apply_translation([0, 0, 2.1])
    trimesh.util.concatenate([first, second]).export(str(path / "balls.ply"), vertex_normal=True)
    succeed("light", path / "sky.h5", "--sky", "clear", "--sun", "35,120", "--degree", 4)
    return path


@pytest.fixture(scope="module")
def glossy(folder):
    line = ("operators", folder / "balls.ply", folder / "glossy.h5", "--brdf", "phong:8", "--diffuse", "0.3")
    succeed(*line, "--specular", "0.5", "--degree", 3, "--samples", 64)
    return folder / "glossy.h5"


def test_the_file_holds_what_the_function_makes(folder, glossy):
    surface = take_surface(folder / "balls.ply")
    expected = transfer_operators(surface, Phong(diffuse=0.3, specular=0.5, exponent=8), 3, samples=64)
    assert expected.coeffs_khwc.shape == (256, 84, 1, 1)
    np.testing.assert_allclose(arrays(glossy)["coefficients"], expected.coeffs_khwc, atol=1e-6)
    with cr.open_fit(glossy) as held:
        assert (held.method, held.degree, held.config["brdf"], held.config["light_degree"]) == (
            "operator",
            15,
            "phong",
            3,
        )
        np.testing.assert_array_equal(held.surface.faces_f3, surface.faces_f3)
        assert held.surface.name == "balls"


def test_tiles_make_the_same_file(folder, glossy, tmp_path):
    line = ("operators", folder / "balls.ply", tmp_path / "tiled.h5", "--brdf", "phong:8", "--diffuse", "0.3")
    told = succeed(*line, "--specular", "0.5", "--degree", 3, "--samples", 64, "--memory", "200k", "--json").json
    assert (told["n_vertex"], told["rays"], told["shape"]) == (84, 84 * 64, [256, 84, 1, 1])
    assert told["bytes_on_disk"] == (tmp_path / "tiled.h5").stat().st_size
    np.testing.assert_allclose(arrays(tmp_path / "tiled.h5")["coefficients"], arrays(glossy)["coefficients"], atol=1e-6)


def test_what_is_reflected_from_files_and_encodings(folder, glossy, tmp_path):
    light = cr.read_light(folder / "sky.h5")
    succeed("reflect", glossy, tmp_path / "seen.h5", "--light", folder / "sky.h5")
    view = np.array([0.36, 0.48, 0.8])
    radiance = cr.reflect(glossy, light, view=5 * view)
    with cr.open_fit(glossy) as held:
        np.testing.assert_allclose(radiance, reflect(held, light.coeffs_kc, view), atol=1e-6)
    with cr.open_fit(tmp_path / "seen.h5") as seen:
        assert (seen.degree, seen.surface.argument) == (3, "view")
    np.testing.assert_allclose(cr.relight(tmp_path / "seen.h5", view), radiance, atol=1e-5)
    succeed("encode", glossy, tmp_path / "small.h5", "--codec", "cpca", "--clusters", 2, "--components", 60)
    ended = call(
        "reflect", tmp_path / "small.h5", tmp_path / "again.h5", "--light", folder / "sky.h5", "--mesh", glossy
    )
    assert ended.code == 0, ended.err
    np.testing.assert_allclose(cr.relight(tmp_path / "again.h5", view), radiance, atol=0.02 * abs(radiance).max())
    given = cr.reflect(tmp_path / "small.h5", light, view=view, mesh=folder / "balls.ply")
    np.testing.assert_allclose(given, radiance, atol=0.02 * abs(radiance).max())


@pytest.mark.parametrize("order", ["morton", "sorted"])
def test_orders_frames_and_files(folder, glossy, tmp_path, order):
    line = ("operators", folder / "balls.ply", tmp_path / "o.h5", "--brdf", "phong:8", "--diffuse", "0.3")
    line = (*line, "--specular", "0.5", "--degree", 3, "--samples", 64, "--order", order)
    succeed(*line, "--frame", "local", "--light-frame", "local")
    _, places = reorder(take_surface(folder / "balls.ply"), order)
    light = cr.read_light(folder / "sky.h5")
    view = np.array([0, 0.6, 0.8])
    expected = cr.reflect(glossy, light, view=view).reshape(-1)
    made = places.undo(cr.reflect(tmp_path / "o.h5", light, view=view).reshape(-1))
    np.testing.assert_allclose(made, expected, atol=0.06 * abs(expected).max())  # views were fitted in other axes


def test_transfer_is_added(folder, glossy, tmp_path):
    surface = take_surface(folder / "balls.ply")
    vectors = np.full((16, 84, 1, 1), 0.25, np.float32)
    cr.write_fit(
        tmp_path / "t.h5", cr.CoefficientMap(vectors, 3, "transfer", 1.0, "linear", [[0, 0, 1]], surface=surface)
    )
    line = ("operators", folder / "balls.ply", tmp_path / "both.h5", "--brdf", "phong:8", "--diffuse", "0.3")
    succeed(*line, "--specular", "0.5", "--degree", 3, "--samples", 64, "--add", tmp_path / "t.h5")
    added = arrays(tmp_path / "both.h5")["coefficients"] - arrays(glossy)["coefficients"]
    np.testing.assert_allclose(added[:16], 0.25 * WHITE, atol=1e-6)
    np.testing.assert_array_equal(added[16:], 0)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("operators balls.ply o.h5 --brdf shiny", "a BRDF is diffuse"),
        ("operators balls.ply o.h5 --brdf phong:-3", "exponent"),
        ("operators balls.ply o.h5 --brdf phong:20 --diffuse 0.9", "together"),
        ("operators balls.ply o.h5 --brdf ggx:0.3 --specular 2", "from 0 to 1"),
        ("operators balls.ply o.h5 --specular 0.1,0.2", "1 or 3 numbers"),
        ("operators balls.ply o.h5 --degree 26", "26"),
        ("operators balls.ply o.h5 --samples 4", "samples"),
        ("operators balls.ply o.h5 --memory 1k", "allow --memory"),
        ("operators balls.ply o.h5 --light-frame local", "tangents"),
        ("operators balls.ply o.h5 --add sky.h5", "light/1"),
        ("operators sky.h5 o.h5", "light/1"),
        ("operators balls.ply balls.ply", "balls.ply"),
        ("reflect glossy.h5 o.h5 --light glossy.h5", "light/1"),
        ("reflect sky.h5 o.h5 --light sky.h5", "light/1"),
        ("reflect glossy.h5 o.h5", "--light"),
        ("relight glossy.h5 o.png --light 0,0,1", "clrelight reflect"),
        ("relight glossy.h5 o.png --light sky.h5", "clrelight reflect"),
        ("operators missing.ply o.h5", "missing.ply"),
        ("operators balls.xyz o.h5", "balls.xyz"),
    ],
)
def test_bad_input_is_told_in_a_line(folder, glossy, monkeypatch, line, words):
    monkeypatch.chdir(folder)
    before = contents(folder)
    ended = call(*line.split())
    assert (ended.code, ended.out) == (2, "")
    assert words in ended.err
    assert ended.err.count("\n") == 1
    assert contents(folder) == before


def test_a_map_of_other_things_is_no_operator(folder, tmp_path):
    surface = Surface(np.eye(3), [[0, 1, 2]], np.tile([0, 0, 1.0], (3, 1)))
    plain = cr.CoefficientMap(np.zeros((16, 3, 1, 1)), 3, "uls", 1.0, "linear", [[0, 0, 1]], surface=surface)
    with pytest.raises(cr.InputError, match="holds no operators"):
        cr.reflect(plain, folder / "sky.h5")
    with pytest.raises(cr.InputError, match="no length"):
        cr.reflect(plain, folder / "sky.h5", view=(0, 0, 0))
    with pytest.raises(cr.InputError, match="no view beside"):
        cr.reflect(plain, folder / "sky.h5", view=(0, 0, 1), out=tmp_path / "o.h5")
