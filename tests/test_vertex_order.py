"""Orders of vertices and images of them: permutations that change nothing but places."""

import numpy as np
import pytest
import scipy.spatial

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.surface import Surface
from clrelight.transfer.vertex_images import hilbert_walk
from clrelight.transfer.vertex_order import IMAGES, ORDERS, fold_surface, reorder, reorder_map, vertex_order


@pytest.fixture(scope="module")
def ball():
    points = np.random.default_rng(0).standard_normal((503, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    faces = scipy.spatial.ConvexHull(points).simplices
    outward = np.einsum(
        "fa,fa->f", np.cross(*(points[faces[:, i]] - points[faces[:, 0]] for i in (1, 2))), points[faces[:, 0]]
    )
    faces = np.where(outward[:, None] > 0, faces, faces[:, ::-1])
    tangents = np.cross(points, np.roll(points, 1, axis=1))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    rng = np.random.default_rng(1)
    return Surface(
        points, faces, points, tangents, rng.random((503, 3)).astype(np.float32), rng.random((503, 2)), name="ball"
    )


def mean_step(values):
    return np.linalg.norm(np.diff(values, axis=0), axis=-1).mean()


@pytest.mark.parametrize("order", ORDERS)
def test_a_surface_stays_what_it_was(ball, order):
    made, places = reorder(ball, order)
    np.testing.assert_array_equal(np.unique(places.source_p), np.arange(503))
    np.testing.assert_array_equal(made.vertices_v3[made.faces_f3], ball.vertices_v3[ball.faces_f3])
    for name in ("vertices_v3", "normals_v3", "tangents_v3", "albedo_vc", "texture_v2"):
        np.testing.assert_array_equal(getattr(made, name), getattr(ball, name)[places.source_p])
        np.testing.assert_array_equal(places.undo(getattr(made, name)), getattr(ball, name))
    assert made.name == "ball"
    assert made.grid == ((22, 23) if order in IMAGES else None)


@pytest.mark.parametrize("order", ORDERS)
def test_maps_follow_and_come_back(ball, order):
    values = np.random.default_rng(2).random((4, 503, 1, 3)).astype(np.float32)
    ranks = np.arange(503 * 3, dtype=np.int32).reshape(503, 1, 3)
    held = CoefficientMap(values, 1, "transfer", 1.0, "linear", [[0, 0, 1]], rank_hwc=ranks, surface=ball)
    surface, places = fold_surface(ball, order)
    made = reorder_map(held, surface, places)
    assert made.coeffs_khwc.shape == (4, 22, 23, 3)
    assert made.surface is surface
    flat = made.coeffs_khwc.reshape(4, -1, 3)
    np.testing.assert_array_equal(places.undo(flat, 1), values[:, :, 0])
    np.testing.assert_array_equal(places.undo(made.rank_hwc.reshape(-1, 3)), ranks[:, 0])
    np.testing.assert_array_equal(made.surface.vertices_v3[places.places()], ball.vertices_v3)
    with pytest.raises(InputError, match="503 vertices"):
        reorder_map(made, surface, places)


def test_orders_bring_near_what_is_near(ball):
    steps = {order: mean_step(ball.vertices_v3[vertex_order(ball, order)]) for order in ORDERS[:-2]}
    assert steps["hilbert"] < steps["morton"] < 0.3 * steps["file"]
    assert steps["hilbert"] < 0.16 * steps["file"]
    places = np.argsort(vertex_order(ball, "graph"))
    edges = ball.faces_f3[:, :2]
    assert abs(np.diff(places[edges], axis=1)).max() < 0.3 * abs(np.diff(edges, axis=1)).max()  # a narrow band


def test_images_bring_near_what_is_near(ball):
    across = {}
    for order in ("file", "hilbert", "blocks", "sorted"):
        image = fold_surface(ball, order)[0].vertices_v3.reshape(22, 23, 3)
        across[order] = (mean_step(image) + mean_step(image.transpose(1, 0, 2))) / 2
    assert across["blocks"] < 0.35 * across["file"]
    assert across["hilbert"] < 0.35 * across["file"]
    assert across["sorted"] < 0.8 * across["blocks"]


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 3), (8, 8), (13, 20), (20, 13), (31, 30)])
def test_a_walk_goes_through_every_pixel_once(shape):
    walk = np.array(list(hilbert_walk(*shape)))
    assert len(walk) == shape[0] * shape[1]
    assert len(np.unique(walk, axis=0)) == len(walk)
    assert walk.min() == 0
    np.testing.assert_array_equal(walk.max(axis=0), np.array(shape) - 1)
    steps = abs(np.diff(walk, axis=0)).sum(axis=1) if len(walk) > 1 else np.ones(1)
    assert (steps > 1).sum() <= 1


def test_hilbert_goes_through_a_cube_step_by_step():
    cells = np.indices((8, 8, 8)).reshape(3, -1).T.astype(float)
    cube = Surface(cells, [[0, 1, 2]], np.tile([0, 0, 1.0], (512, 1)))
    ordered = cells[vertex_order(cube, "hilbert")]
    np.testing.assert_array_equal(abs(np.diff(ordered, axis=0)).sum(axis=1), 1)


def test_few_vertices_and_flat_ones():
    for count in (1, 2, 3, 5):
        flat = Surface(np.zeros((count, 3)), [[0, 0, count - 1]], np.tile([0, 0, 1.0], (count, 1)))
        for order in ORDERS:
            made, places = reorder(flat, order)
            np.testing.assert_array_equal(np.unique(places.source_p), np.arange(count))
            assert made.n_vertex >= count


def test_an_unknown_order_is_refused(ball):
    with pytest.raises(InputError, match="ordered by file, morton"):
        reorder(ball, "random")
