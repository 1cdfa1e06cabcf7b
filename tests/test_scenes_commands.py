"""torus and dama through the commands: synth, fit, bench, report; and the pictures that they leave."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from clrelight.dataset import CoefficientMap
from clrelight.experiment.portraits import SIDE, SurfacePortrait
from clrelight.harmonics.basis import evaluate_basis
from clrelight.report.paper_figures import figures_of
from clrelight.store import open_fit, open_stack, read_results
from clrelight.surface import Surface
from clrelight.transfer.functions import sample_transfer
from datasets_synth.scenes import SCENES, scenes_with
from datasets_synth.studio import studio_lights
from datasets_synth.torus import torus_surface
from tests.commands import call, succeed

pytest.importorskip("embreex")


def test_synth_writes_the_surface_and_fits_hand_it_on(tmp_path):
    told = succeed("synth", "torus", tmp_path / "t.h5", "--size", 12, "--lights", 40, "--albedo", "tiles",
                   "--dtype", "uint8", "--pattern", "scattered", "--seed", 3, "--json").json  # fmt: skip
    assert told.pop("seconds").keys() == {"render", "write"}
    assert told == {"file": str(tmp_path / "t.h5"), "lights": 40, "size": 12, "pattern": "scattered", "seed": 3,
                    "dtype": "uint8", "albedo": "tiles"}  # fmt: skip
    succeed("fit", tmp_path / "t.h5", tmp_path / "f.h5", "--degree", 2, "--method", "cls", "--no-measure")
    with open_stack(tmp_path / "t.h5") as stack, open_fit(tmp_path / "f.h5") as fitted:
        assert (stack.name, stack.peak, stack.images_ihwc.shape) == ("torus", 255.0, (40, 12, 12, 3))
        for held in (stack.surface, fitted.surface):
            assert held.grid == (12, 12)
            np.testing.assert_array_equal(held.vertices_v3, torus_surface(12, 12).vertices_v3)
        assert np.ptp(stack.surface.albedo_vc, axis=0).min() > 0.05


def test_dama_through_bench_and_report(tmp_path):
    words = ["--size", 10, "--lights", 60, "--material", "ggx", "--degrees", 2, "--methods", "uls,cls"]
    told = succeed("bench", "dama", *words, "--codecs", "none,uniform", "--out", tmp_path / "r.h5", "--json").json
    assert [row["scene"] for row in told["rows"]] == ["ggx-dama"] * 4
    results = read_results(tmp_path / "r.h5")
    assert set(results.pictures) == {"ggx-dama/reference"} | {
        f"ggx-dama/{method}/2/{codec}" for method in ("uls", "cls") for codec in ("none", "uniform@8")
    }
    assert results.pictures["ggx-dama/uls/2/none"].shape == (SIDE, 2 * SIDE, 3)
    pytest.importorskip("matplotlib")
    succeed("report", tmp_path / "r.h5", "--out", tmp_path / "report")
    assert {"figure_6.png", "figure_14.png"} <= {p.name for p in (tmp_path / "report" / "figures").iterdir()}
    page = (tmp_path / "report" / "report.md").read_text()
    assert "Figure 6: ULS, as fitted and coded" in page
    assert "Figure 10: Sloan ULS, as fitted and coded: left out" in page


def test_toml_takes_options_of_every_scene(tmp_path):
    (tmp_path / "e.toml").write_text(
        'scenes = ["torus", "dama"]\nmethods = ["cls"]\ndegrees = [2]\n[torus]\nsize = 8\nlights = 40\n'
        "[dama]\nsize = 8\nlights = 30\n"
    )
    told = succeed("bench", tmp_path / "e.toml", "--out", tmp_path / "r.h5", "--json").json
    assert [(row["scene"], row["n_light"], row["channel"]) for row in told["rows"]] == [
        ("torus", 40, 1),
        ("dama", 30, 3),
    ]
    figures = {"torus": [5, 9, 13], "tiles-torus": [5, 9, 13], "dama": [6, 10, 14], "ring": [], "my torus": []}
    assert {name: [*figures_of(name).values()] for name in figures} == figures


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("synth torus o.h5 --material ggx", "No such option '--material'"),
        ("synth torus o.h5 --size 4", "4 is not in the range"),
        ("synth dama o.h5 --material wood", "'wood' is not one of"),
        ("bench torus --out o.h5 --material ggx", "--material is an option of the dama scene, not of torus"),
        ("bench ring --out o.h5 --albedo tiles", "--albedo is an option of the torus scene, not of ring"),
        (
            "bench stack.h5 --out o.h5 --seed 1",
            "--seed is an option of the scenes ring, torus, dama, head, not of stack.h5",
        ),
        ("bench torus --out o.h5 --albedo red", "albedo must be one of white, tiles, got 'red'"),
    ],
)
def test_refusals(tmp_path, monkeypatch, words, message):
    monkeypatch.chdir(tmp_path)
    ended = call(*words.split())
    assert ended.code == 2
    assert message in " ".join(ended.err.split())
    assert list(tmp_path.iterdir()) == []


def test_registry_says_what_renderers_take():
    assert list(SCENES) == ["ring", "torus", "dama", "head"]
    assert scenes_with("material") == ("dama",)
    assert SCENES["torus"].stack_name({"albedo": "tiles", "dtype": "float32", "size": 9}) == "tiles-torus"
    for scene in SCENES.values():
        stack = scene.render({o.name: 8 if o.name in ("size", "lights") else o.default for o in scene.options})
        assert stack.images_ihwc.shape[:3] == (8, 8, 8)


def coefficients_of(surface, coeffs_kvc, degree):
    coeffs_khwc = coeffs_kvc.reshape(len(coeffs_kvc), *surface.map_shape, -1).astype(np.float32)
    return CoefficientMap(coeffs_khwc, degree, "uls", 1.0, "linear", np.array([[0.0, 0, 1]]), surface=surface)


def test_portrait_of_a_cosine_is_lamberts_law():
    """Functions that are s_z on the whole sphere: under one light its cosine, under many the sum above the horizon."""
    surface = torus_surface(24, 24)
    portrait = SurfacePortrait(sample_transfer(surface, np.eye(3)[2:], "unshadowed"), surface)
    coeffs_kv = np.zeros((4, surface.n_vertex, 1))
    coeffs_kv[2] = math.sqrt(4 * math.pi / 3)
    seen = {}
    portrait._render = lambda values: seen.update(values=values)
    portrait.draw(coefficients_of(surface, coeffs_kv, 1))
    environment_vc, direct_vc = seen["values"]
    light = np.array([0.5, 0.5, math.sqrt(0.5)])
    np.testing.assert_allclose(direct_vc[:, 0], np.maximum(surface.normals_v3 @ light, 0.0), atol=1e-6)
    studio = studio_lights()
    cosine_vl = np.maximum(surface.normals_v3 @ studio.directions_l3.T, 0.0)
    expected = cosine_vl @ studio.irradiance_lc / math.pi
    ratio = environment_vc / expected
    np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-6)  # the exposure


def test_portrait_of_views_looks_along_the_cameras_rays():
    """Functions of the view whose value is the view's own x in global axes, turned into each vertex's frame."""
    surface = replace(torus_surface(24, 24), argument="view")
    images = np.ones((1, *surface.map_shape, 3), np.float32)
    stack = replace(sample_transfer(torus_surface(24, 24), np.eye(3)[2:], "unshadowed"), surface=None)
    portrait = SurfacePortrait(replace(stack, images_ihwc=images, surface=surface), surface)
    y = evaluate_basis(np.eye(3), 1)[:, 1:]  # of axes x, y, z: rows; columns k = 1, 2, 3
    coeffs_kv = np.zeros((4, surface.n_vertex, 3))
    coeffs_kv[1:] = np.linalg.solve(y, surface.frames()[:, :, 0].T)[:, :, None]
    seen = {}
    portrait._render = lambda values: seen.update(values=values)
    portrait.draw(coefficients_of(surface, coeffs_kv, 1))
    for values_vc, sign in zip(seen["values"], (-1.0, 1.0), strict=True):
        shown = values_vc[:, 0][values_vc[:, 0] != 0]
        assert len(shown) > 200
        assert (np.sign(shown) == sign).mean() > 0.9  # the cameras stand left and right of the middle


def test_report_json_of_a_surface_without_a_grid(tmp_path):
    """A stack file of any mesh is measured and pictured alike."""
    whole = torus_surface(16, 10)
    surface = Surface(whole.vertices_v3, whole.faces_f3, whole.normals_v3, whole.tangents_v3, name="mesh")
    from clrelight.sampling import make_pattern
    from clrelight.store import write_stack

    write_stack(tmp_path / "m.h5", sample_transfer(surface, make_pattern("uniform", 60)))
    done = call("bench", tmp_path / "m.h5", "--methods", "cls", "--degrees", 2, "--codecs", "none", "--out",
                tmp_path / "r.h5", "--json")  # fmt: skip
    row = json.loads(done.out)["rows"][0]
    assert (row["scene"], row["height"], row["width"]) == ("mesh", 160, 1)
    assert read_results(tmp_path / "r.h5").pictures["mesh/cls/2/none"].shape == (SIDE, 2 * SIDE, 3)
