"""What draws the figures of docs/shrm.md: truths, earlier methods, labels, files."""

import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks.reflection_materials import balls
from clrelight.brdf.analytic import KajiyaKay, Microfacet
from clrelight.images import read_header
from clrelight.lighting.environment import Environment
from clrelight.lighting.light import Light
from clrelight.lighting.projection import project_environment
from clrelight.reproduction.reflection_stage import Shown, Stage, difference, relative
from clrelight.shrm.observation import make_terms

VIEW = (0.3, -1.0, 0.2)


@pytest.fixture(scope="module")
def stage():
    radiance = np.random.default_rng(0).random((32, 64, 3), np.float32)
    radiance[8:12, 10:16] = 20.0
    environment = Environment(radiance, "latlong", "right,forward,up")
    return Stage(environment, project_environment(environment, 12))


def test_orders_come_nearer_than_earlier_methods(stage):
    for brdf, degree, order in ((Microfacet(0.4), 12, 4), (KajiyaKay(8.0), 12, 11)):
        truth = stage.truth(brdf, VIEW, 16)
        found = relative([stage.sphere(stage.shrm(brdf, degree, order), VIEW, 16)], [truth])
        assert found < 0.8 * relative([stage.texture(brdf, VIEW, 16, order + 1)], [truth])
        assert found < 0.6 * relative([stage.icosahedron(brdf, VIEW, 16)], [truth])


def test_pictures_are_drawn_with_their_labels(stage, tmp_path):
    pytest.importorskip("matplotlib")
    from benchmarks.reflection_figures import chart_8, draw, main

    truth = stage.truth(KajiyaKay(4.0), VIEW, 12)
    panels = [[Shown(truth, "integrated"), Shown(0.9 * truth, "P = 1", 0.1, truth)], [Shown(truth, "again")]]
    assert [shown.label() for shown in panels[0]] == ["integrated", "P = 1: 0.100"]
    assert difference(0.9 * truth, truth).max() > 0.0
    draw(tmp_path / "a.jpg", panels)
    assert read_header(tmp_path / "a.jpg").width == 2 * 226
    chart_8(tmp_path / "b.png", ([], [["skin", *(["0.1", "0.2", "0.3", "0.4", "0.5", "0.6"])]]))
    assert read_header(tmp_path / "b.png").width == 1000
    refused = CliRunner().invoke(main, ["--only", "11"])
    assert refused.exit_code == 2
    assert "CLRELIGHT_DATA" in refused.output or "figures and tables are" in refused.output


def test_balls_show_what_was_asked_for():
    light = Light(np.random.default_rng(0).standard_normal((121, 1)))
    seen = balls(light, Microfacet(0.3), make_terms(10, 3), (VIEW,))
    assert seen.radiance_nc.shape[1] == 3
    assert np.ptp(seen.radiance_nc, axis=1).max() < 1e-12
