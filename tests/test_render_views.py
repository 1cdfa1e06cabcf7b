"""Pictures of surfaces: cameras, what their rays meet, and what is made of it."""

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera, frame_surface, picture_size
from clrelight.transfer.rays import RayScene
from clrelight.transfer.views import look, render_surface
from tests.rendering import meet_sphere, pixel_rays, sphere, torus_grid, unit

CAMERA = Camera((3.0, -4.0, 2.0), (0.1, 0.0, 0.05), field_of_view=33.0)


def inward(surface):
    return Surface(surface.vertices_v3, surface.faces_f3[:, ::-1], -surface.normals_v3)


def test_a_sphere_is_shaded_as_by_its_formula():
    width, height = 90, 70
    ball = sphere(6)
    normals_v3 = ball.normals_v3
    light = unit([0.3, -0.8, 0.5])
    radiance_vc = np.stack([np.maximum(0, normals_v3 @ light), 0.5 + 0.5 * normals_v3[:, 2]], axis=1)
    image = render_surface(ball, radiance_vc, CAMERA, (width, height), subsamples=1, background=(0.25, 7.0))
    assert (image.shape, image.dtype) == ((height, width, 2), np.float32)
    points, met = meet_sphere(*pixel_rays(CAMERA, width, height))
    expected = np.where(
        met[..., None], np.stack([np.maximum(0, points @ light), 0.5 + 0.5 * points[..., 2]], axis=-1), (0.25, 7.0)
    )
    difference = np.abs(image - expected).max(axis=-1)
    outline = met & ~np.all([np.roll(met, s, a) for s in (1, -1) for a in (0, 1)], axis=0)
    outline |= ~met & np.any([np.roll(met, s, a) for s in (1, -1) for a in (0, 1)], axis=0)
    assert difference[~outline].max() < 2e-3
    assert 1000 < met.sum() < met.size


def test_subsamples_are_the_means_of_a_finer_picture():
    ball = sphere(3)
    values_vc = np.random.default_rng(0).random((ball.n_vertex, 1))
    fine = render_surface(ball, values_vc, CAMERA, (60, 48), subsamples=1)
    coarse = render_surface(ball, values_vc, CAMERA, (20, 16), subsamples=3)
    np.testing.assert_allclose(coarse, fine.reshape(16, 3, 20, 3, 1).mean(axis=(1, 3)), atol=1e-6)


def test_a_far_eye_sees_as_exactly_as_a_near_one():
    ball = sphere(5)
    direction = unit([1.0, -2.0, 1.0])
    flat = frame_surface(ball, direction, orthographic=True)
    far = Camera(1e7 * direction, field_of_view=2 * np.degrees(np.arctan(flat.height / 2e7)))
    values_vc = ball.vertices_v3[:, :1] + 2
    near_image, far_image = (render_surface(ball, values_vc, each, 64, subsamples=2) for each in (flat, far))
    assert np.abs(near_image - far_image).mean() < 1e-3


@pytest.mark.parametrize("direction", [(1, -2, 1), (0, 0, 1), (0, 0, -1), (0, 1, 0), (-3, 0.1, 0.2)])
@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("size", [(80, 40), (40, 80)])
def test_the_automatic_camera_sees_all_and_wastes_little(direction, orthographic, size):
    ring = torus_grid()
    camera = frame_surface(ring, direction, orthographic=orthographic, aspect=size[0] / size[1])
    covered = look(RayScene(ring), camera, size, subsamples=1).coverage_hw > 0
    edges = np.concatenate([covered[0], covered[-1], covered[:, 0], covered[:, -1]])
    assert not edges.any()
    rows, columns = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
    assert max(np.ptp(rows) / size[1], np.ptp(columns) / size[0]) > 0.88
    assert abs(rows[0] + rows[-1] - size[1] + 1) <= 5
    assert abs(columns[0] + columns[-1] - size[0] + 1) <= 5


def test_rows_of_a_picture_are_the_picture():
    ring = torus_grid()
    scene, camera = RayScene(ring), frame_surface(ring, (1, 1, 1))
    values_vc = ring.vertices_v3[:, :2]
    whole = look(scene, camera, (30, 31)).interpolate(values_vc)
    parts = [look(scene, camera, (30, 31), rows=rows).interpolate(values_vc) for rows in ((0, 7), (7, 30), (30, 31))]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_a_texture_is_read_between_the_corners_of_a_cell():
    """A function that is bilinear in a cell is exact there; between faces' corners it is not."""
    ring = torus_grid(12, 8)
    view = look(RayScene(ring), frame_surface(ring, (1, 1, 1)), 50, subsamples=1, texture=True)
    assert view.corners_sj.shape[1] == 4
    np.testing.assert_allclose(view.weights_sj.sum(axis=1), 1, atol=1e-6)
    assert view.weights_sj.min() >= -1e-6
    rows_sj, columns_sj = np.divmod(view.corners_sj, 8)
    assert (
        {*np.unique((rows_sj[:, 2] - rows_sj[:, 0]) % 12)}
        == {*np.unique((columns_sj[:, 1] - columns_sj[:, 0]) % 8)}
        == {1}
    )
    plain = look(RayScene(ring), frame_surface(ring, (1, 1, 1)), 50, subsamples=1)
    # Both read a function that is linear along rows or columns the same way, round the ends too.
    for values_v in (np.cos(2 * np.pi * np.divmod(np.arange(96), 8)[0] / 12),):
        np.testing.assert_allclose(view.at_samples(values_v[:, None]), plain.at_samples(values_v[:, None]), atol=1e-5)


def test_the_inner_side_is_black_and_counted():
    plate = Surface([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 3, 2]], [[0, 0, 1.0]] * 4)
    camera = frame_surface(plate, (0, 0, 1), orthographic=True)
    view = look(RayScene(plate), camera, 64)
    assert view.behind == pytest.approx(0.5, abs=0.02)
    assert view.interpolate(np.ones((4, 1))).mean() == pytest.approx(0.5 * view.coverage_p.mean(), rel=0.05)


def test_what_cannot_be_seen_is_said():
    ball = sphere(2)
    values_vc = np.ones((ball.n_vertex, 1))
    with pytest.raises(InputError, match=r"sees nothing of the surface, which lies in the box \(-1, -1, -1\)"):
        render_surface(ball, values_vc, Camera((0, -5, 0), (0, -9, 0)), 16)
    with pytest.raises(InputError, match="stands inside"):
        render_surface(ball, values_vc, Camera((0, 0, 0), (0, -9, 0)), 16)
    with pytest.raises(InputError, match="turned inwards"):
        render_surface(inward(ball), values_vc, None, 16)
    scene = RayScene(ball)
    with pytest.raises(InputError, match="one row a vertex"):
        render_surface(ball, values_vc[1:], None, 16)
    with pytest.raises(InputError, match="subsamples must be 1 to 16"):
        look(scene, CAMERA, 16, subsamples=0)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"eye_3": (0, 0, 0)}, "stands where it looks"),
        ({"eye_3": (0, 0, 3)}, "up must not point along the view"),
        ({"eye_3": (0, np.nan, 3)}, "eye must be three finite numbers"),
        ({"eye_3": (0, 1)}, "eye must be three finite numbers"),
        ({"eye_3": (1, 0, 0), "field_of_view": 180}, "below 180 degrees"),
        ({"eye_3": (1, 0, 0), "height": 0.0}, "height of an orthographic view"),
        ({"eye_3": (1, 0, 0), "up_3": (0, 0, 0)}, "up for a camera is three finite numbers that are not all zero"),
    ],
)
def test_what_is_no_camera_is_refused(fields, told):
    with pytest.raises(InputError, match=told):
        Camera(**fields)


@pytest.mark.parametrize("size", [0, (3, 0), (1, 2, 3), 2.5, 1 << 15, (-1, 4), "x"])
def test_what_is_no_size_is_refused(size):
    with pytest.raises(InputError, match="picture's size"):
        picture_size(size)
