"""Encodings of a surface's functions hold no geometry: a mesh beside them is taken as it was when they were made."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.jobs.report import Report
from clrelight.sampling import make_pattern
from clrelight.transfer.functions import sample_transfer
from tests.commands import call
from tests.rendering import torus_grid, trimesh

LIGHTS = [(0.4, -0.6, 0.7), (0.0, 0.8, -0.6)]


@pytest.fixture(scope="module")
def mesh(tmp_path_factory):
    """A bumpy ball whose y is up, without normals."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.vertices *= 1.0 + 0.2 * np.sin(5.0 * ball.vertices[:, :1]) + 0.3 * (ball.vertices[:, 1:2] > 0)
    path = tmp_path_factory.mktemp("mesh") / "bumpy.ply"
    ball.export(path)
    return path


@pytest.mark.parametrize("frame", ["global", "local"])
@pytest.mark.parametrize("order", ["file", "hilbert", "sorted"])
@pytest.mark.parametrize("up", ["y", None])
def test_a_mesh_file_is_taken_as_the_map_says(mesh, tmp_path, frame, order, up):
    options = {"frame": frame, "order": order, "up": up}
    made = cr.transfer(mesh, degree=3, samples=64, **options)
    coded = cr.encode(made, "half")
    cr.write_encoded(tmp_path / "coded.h5", coded)
    how = {"size": 32, "subsamples": 1, "camera": cr.Camera((3.0, -4.0, 2.0), field_of_view=40.0)}
    for light in LIGHTS:
        expected = cr.render(made, light, **how)
        assert expected.max() > 0.1
        found = cr.render(tmp_path / "coded.h5", light, mesh=mesh, **how)
        np.testing.assert_allclose(found, expected, atol=2e-3 * expected.max())


def test_frames_that_a_mesh_file_cannot_hold_are_refused(tmp_path):
    torus = torus_grid(12, 8)
    stack = sample_transfer(torus, make_pattern("uniform", 40), kind="unshadowed")
    cr.write_stack(tmp_path / "stack.h5", stack)
    cr.fit(stack, "cls", 2, out=tmp_path / "fit.h5")
    cr.encode(tmp_path / "fit.h5", "half", out=tmp_path / "coded.h5")
    trimesh.Trimesh(torus.vertices_v3, torus.faces_f3, process=False).export(tmp_path / "torus.ply")
    ended = call(
        "render", tmp_path / "coded.h5", tmp_path / "o.png", "--mesh", tmp_path / "torus.ply", "--light", "0,0,1"
    )
    assert ended.code == 2
    assert "frames of the vertices that torus does not hold: give the fit or the stack" in ended.err
    lit = [
        cr.render(tmp_path / name, (0.3, 0.2, 1), size=24, **more)
        for name, more in (
            ("fit.h5", {}),
            ("coded.h5", {"mesh": tmp_path / "fit.h5"}),
            ("coded.h5", {"mesh": tmp_path / "stack.h5"}),
        )
    ]
    np.testing.assert_allclose(lit[1], lit[0], atol=1e-3)
    np.testing.assert_array_equal(lit[2], lit[1])


@pytest.mark.parametrize("codec", [None, "half", "klt"])
def test_below_the_horizon_of_a_surface_is_nothing_unknown(mesh, codec):
    made, report = cr.transfer(mesh, degree=2, samples=64), Report()
    cr.relight(made if codec is None else cr.encode(made, codec, report=Report()), (0, 0, -1), report=report)
    assert not any("below the horizon" in note for note in report.notes)


@pytest.mark.parametrize(
    ("codec", "frame", "told"), [("klt", "global", 1), ("klt", "local", 0), ("wavelet", "global", 0)]
)
def test_codecs_of_the_hemisphere_say_what_they_leave_open(mesh, codec, frame, told):
    made, report = cr.transfer(mesh, degree=3, samples=64, frame=frame), Report()
    cr.encode(made, codec, rate=2.0, report=report)
    assert sum("z < 0" in note for note in report.notes) == told
