"""Transfer at the texels of a texture: points on the mesh, in whose way the mesh is, and which gather its light."""

from dataclasses import replace

import numpy as np
import pytest

import clrelight as cr
from clrelight import store
from clrelight.errors import InputError
from clrelight.transfer.texels import texel_surface
from clrelight.transfer.transport import transfer_vertices
from tests.commands import succeed
from tests.meshes import open_box, quad

CONSTANT = np.sqrt(4 * np.pi)


def textured(cells=4):
    """Return a box whose floor fills the lower left quarter of its texture; its walls have none of it."""
    box = open_box(cells)
    texture = np.full((box.n_vertex, 2), 2.0)
    floor = slice(0, (cells + 1) ** 2)
    texture[floor] = 0.25 * (box.vertices_v3[floor, :2] + 1)
    colour = np.random.default_rng(3).random((box.n_vertex, 3), np.float32)
    return replace(box, texture_v2=texture, albedo_vc=colour)


def test_texels_are_points_on_the_mesh():
    found = texel_surface(textured(), 8, 10)
    assert found.grid == (8, 10)
    rows, columns = np.indices((8, 10))
    inside = (rows >= 4) & (columns < 5)
    expected = np.stack([4 * (columns + 0.5) / 10 - 1, 4 * (1 - (rows + 0.5) / 8) - 1, 0 * rows], axis=2)
    np.testing.assert_allclose(found.vertices_v3.reshape(8, 10, 3)[inside], expected[inside], atol=1e-12)
    np.testing.assert_allclose(found.normals_v3, np.tile([0, 0, 1.0], (80, 1)))
    outside = found.vertices_v3.reshape(8, 10, 3)[~inside]
    assert (np.abs(outside[:, :2]) <= 1).all()  # filled with the nearest
    np.testing.assert_allclose(found.vertices_v3.reshape(8, 10, 3)[0, 0], expected[4, 0], atol=1e-12)
    assert "60 of 80 texels are in no chart" in found.notes[0]
    assert len(found.faces_f3) == 2 * 3 * 4
    assert inside.ravel()[found.faces_f3].all()
    a, b, c = (found.vertices_v3[found.faces_f3[:, i]] for i in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()


@pytest.mark.parametrize("kind", ["unshadowed", "shadowed", "interreflected"])
@pytest.mark.parametrize("frame", ["global", "local"])
def test_a_texel_at_a_vertex_has_its_function(kind, frame):
    """Of 2 × 2 texels of the floor, each middle is a vertex."""
    box = textured(4)
    asked = {"kind": kind, "degree": 3, "samples": 256, "frame": frame, "report": cr.Report()}
    at_vertices = cr.transfer(box, **asked).coeffs_khwc[:, :, 0]
    found = cr.transfer(box, texels=(4, 4), **asked)
    assert found.coeffs_khwc.shape == (16, 4, 4, 3)
    points = found.surface.vertices_v3.reshape(4, 4, 3)
    for row, column in ((2, 0), (2, 1), (3, 0), (3, 1)):
        vertex = np.linalg.norm(box.vertices_v3[:25] - points[row, column], axis=1).argmin()
        np.testing.assert_allclose(box.vertices_v3[vertex], points[row, column], atol=1e-12)
        np.testing.assert_allclose(found.coeffs_khwc[:, row, column], at_vertices[:, vertex], atol=5e-6)


def test_white_texels_in_a_white_world_are_white():
    box = replace(textured(), albedo_vc=None)
    found = cr.transfer(
        box, kind="interreflected", texels=(8, 8), samples=256, bounces=60, degree=1, report=cr.Report()
    )
    np.testing.assert_allclose(found.coeffs_khwc[0] * CONSTANT, 1.0, atol=1e-2)
    none = cr.transfer(box, kind="interreflected", texels=(8, 8), samples=256, bounces=0, degree=1, report=cr.Report())
    direct = cr.transfer(box, kind="shadowed", texels=(8, 8), samples=256, degree=1, report=cr.Report())
    np.testing.assert_allclose(none.coeffs_khwc, direct.coeffs_khwc, atol=1e-6)
    assert (direct.coeffs_khwc[0] * CONSTANT < 0.9).all()


def test_charts_are_not_joined():
    """Two sheets, far apart in space and side by side in the texture."""
    near, far = quad((0, 0, 0), (1, 0, 0), (0, 1, 0)), quad((9, 0, 0), (1, 0, 0), (0, 1, 0))
    texture = np.concatenate(
        [near.vertices_v3[:, :2] * [0.5, 1], [0.5, 0] + (far.vertices_v3[:, :2] - [9, 0]) * [0.5, 1]]
    )
    both = cr.Surface(
        np.concatenate([near.vertices_v3, far.vertices_v3]),
        np.concatenate([near.faces_f3, far.faces_f3 + 4]),
        np.concatenate([near.normals_v3, far.normals_v3]),
        texture_v2=texture,
    )
    found = texel_surface(both, 6, 8)
    assert found.notes == ()
    edges = found.vertices_v3[found.faces_f3] - found.vertices_v3[np.roll(found.faces_f3, 1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() < 0.5
    assert len(found.faces_f3) == 2 * 2 * 5 * 3


def test_the_command_writes_a_grid(tmp_path):
    mesh = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
    (tmp_path / "a.obj").write_text(mesh)
    succeed("transfer", tmp_path / "a.obj", tmp_path / "a.h5", "--texels", "5,7", "--samples", 64, "--json")
    read = store.read_fit(tmp_path / "a.h5")
    assert read.coeffs_khwc.shape == (25, 5, 7, 1)
    assert read.surface.grid == (5, 7)
    np.testing.assert_allclose(read.coeffs_khwc[0] * CONSTANT, 1.0, rtol=1e-5)


def test_wrong_requests():
    with pytest.raises(InputError, match="no texture coordinates"):
        texel_surface(open_box(2), 8, 8)
    with pytest.raises(InputError, match="2 to"):
        texel_surface(textured(), 1, 8)
    with pytest.raises(InputError, match="too coarse"):
        texel_surface(textured(), 2, 2)
    away = replace(textured(), texture_v2=np.full((textured().n_vertex, 2), 7.0))
    with pytest.raises(InputError, match="within 0 and 1"):
        texel_surface(away, 8, 8)
    with pytest.raises(InputError, match="rows and columns"):
        cr.transfer(textured(), texels=(8,), report=cr.Report())
    assert transfer_vertices(texel_surface(textured(), 8, 8), 1, "unshadowed").shape == (4, 64, 3)
