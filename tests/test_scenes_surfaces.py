"""The grids of the torus and the sculpture: exact geometry, seams that close, faces that look outward."""

import numpy as np
import pytest

from clrelight.errors import InputError
from datasets_synth.implicit import blend, ellipsoid, gradients, last_crossing, limb
from datasets_synth.lady import BASE, lady_solid, lady_surface
from datasets_synth.torus import MAJOR, MINOR, torus_surface


def face_normals(surface):
    a, b, c = np.moveaxis(surface.vertices_v3[surface.faces_f3], 1, 0)
    return np.cross(b - a, c - a) / 2.0  # as long as the area


def edges_of(surface):
    """Return how often each directed edge occurs."""
    f = surface.faces_f3
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    return np.unique(edges, axis=0, return_counts=True)


def test_torus_lies_on_the_torus_with_its_normals():
    surface = torus_surface(17, 23)
    x, y, z = surface.vertices_v3.T
    ring = np.hypot(x, y)
    np.testing.assert_allclose(np.hypot(ring - MAJOR, z), MINOR, rtol=1e-14)
    core = np.stack([MAJOR * x / ring, MAJOR * y / ring, 0 * z], axis=1)
    np.testing.assert_allclose(surface.normals_v3, (surface.vertices_v3 - core) / MINOR, atol=1e-14)
    around = np.stack([-y, x, 0 * z], axis=1) / ring[:, None]
    np.testing.assert_allclose(surface.tangents_v3, around, atol=1e-14)
    assert surface.map_shape == (17, 23)
    # Row by row around the axis, the first row and column at x.
    np.testing.assert_allclose(surface.vertices_v3[0], [MAJOR + MINOR, 0, 0])
    assert surface.vertices_v3[23, 1] > 0.3  # next row
    assert surface.vertices_v3[1, 2] > 0.1  # next column: upwards


def test_torus_area_grows_to_the_exact_one_with_the_square_of_the_step():
    exact = 4.0 * np.pi**2 * MAJOR * MINOR
    short = [exact - np.linalg.norm(face_normals(torus_surface(n, n)), axis=1).sum() for n in (32, 64)]
    assert 0 < short[1] < 0.002 * exact
    assert 3.8 < short[0] / short[1] < 4.2


@pytest.mark.parametrize("surface", [torus_surface(9, 12), lady_surface(24, 20)], ids=["torus", "dama"])
def test_grids_are_closed_and_look_outward(surface):
    edges, counts = edges_of(surface)
    assert counts.max() == 1
    backwards = {tuple(edge) for edge in edges[:, ::-1]}
    assert {tuple(edge) for edge in edges} == backwards  # each edge has two faces, turned alike
    normals = face_normals(surface)
    centres = surface.vertices_v3[surface.faces_f3].mean(axis=1)
    assert np.einsum("fa,fa->", centres, normals) > 0  # three times the volume
    assert surface.n_vertex == np.unique(surface.faces_f3).size == np.unique(surface.vertices_v3, axis=0).shape[0]
    frames = surface.frames()
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-9)


def test_lady_stands_on_her_implicit_surface():
    surface = lady_surface(40, 36)
    assert np.abs(lady_solid()(surface.vertices_v3)).max() < 1e-8
    agree = np.einsum("fa,fca->fc", face_normals(surface), surface.normals_v3[surface.faces_f3]).max(axis=1) > 0
    assert agree.mean() > 0.97  # but where a fold is narrower than the grid
    assert surface.vertices_v3[:, 2].min() >= BASE - 1e-9
    assert 1.5 < np.ptp(surface.vertices_v3[:, 2]) < 2.5
    assert surface.vertices_v3[surface.vertices_v3[:, 2] > 1.4, 1].min() < -0.3  # the nose is before


def test_parts_of_solids():
    ball = ellipsoid((1.0, 2.0, 3.0), (0.5, 0.5, 0.5))
    points = np.array([[1.0, 2.0, 3.6], [1.0, 2.0, 3.5], [1.2, 2.0, 3.0]])
    np.testing.assert_allclose(ball(points), [0.1, 0.0, -0.3], atol=1e-12)
    np.testing.assert_allclose(gradients(ball, points[:2]), [[0, 0, 1], [0, 0, 1]], atol=1e-9)
    rod = limb((0, 0, 0), (0, 0, 2), 0.3, 0.1)
    np.testing.assert_allclose(rod(np.array([[1.0, 0, 1.0], [0, 0, 2.5], [0, 0, -1.0]])), [0.8, 0.4, 0.7])
    both = blend(rod, rod, 0.2)
    np.testing.assert_allclose(both(points), rod(points) - 0.05)
    # Of two shells along a ray, the outer one counts.
    pair = blend(ellipsoid((0, 0, 0), (0.2,) * 3), ellipsoid((0, 0, 0.7), (0.1,) * 3), 1e-6)
    found = last_crossing(pair, np.zeros((2, 3)), np.array([[0, 0, 1.0], [1.0, 0, 0]]), 1.5)
    np.testing.assert_allclose(found, [0.8, 0.2], atol=1e-8)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: torus_surface(2, 8), "at least 3 rows and 3 columns, got 2 and 8"),
        (lambda: torus_surface(8, 8, 1.0, 1.0), "radius must be above 0 and below 1"),
        (lambda: lady_surface(8, 7), "at least 8 rows and 8 columns"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(InputError, match=message):
        make()
