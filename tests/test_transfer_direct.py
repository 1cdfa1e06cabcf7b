"""Transfer without bounces against what is known of spheres, half-skies and corners, at any place and size."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.harmonics.rotation import rotation_matrix
from clrelight.transfer.frames import tangents_of, with_frames
from clrelight.transfer.gathering import Tally
from clrelight.transfer.rays import RayScene
from clrelight.transfer.samples import given_samples, make_samples
from clrelight.transfer.transport import transfer_vertices
from tests.meshes import icosphere, joined, open_box, quad
from tests.reference.basis import real_harmonics
from tests.reference.transfer import clamped_cosine, meets_triangle, visible_cosine

CONSTANT = np.sqrt(4.0 * np.pi)
"""Coefficient of the light that is 1 everywhere."""


def test_unshadowed_is_the_clamped_cosine():
    sphere = icosphere(2)
    found = transfer_vertices(sphere, 6, "unshadowed")
    np.testing.assert_allclose(found[:, :, 0].T, clamped_cosine(sphere.normals_v3, 6), atol=1e-6)
    np.testing.assert_allclose(found[0] * CONSTANT, 1.0, rtol=1e-6)


def test_samples_of_the_unshadowed_function_come_closer():
    sphere, expected = icosphere(2), clamped_cosine(icosphere(2).normals_v3, 4)
    errors = {}
    for count in (256, 1024, 4096, 16384):
        found = [transfer_vertices(sphere, 4, "unshadowed", count, seed=seed)[:, :, 0].T for seed in range(4)]
        errors[count] = np.sqrt(np.mean(np.square(found - expected)))
        if count == 4096:
            assert np.abs(np.array(found) - expected).max() < 1.5e-3  # 2e-3 is wanted
    for count in (1024, 4096, 16384):  # 1 / sqrt(N) is a half at four times the samples
        assert errors[count] < 0.55 * errors[count // 4]


def test_a_sphere_does_not_shadow_itself():
    sphere = icosphere(3)
    found = transfer_vertices(sphere, 4, "shadowed", 1024)
    np.testing.assert_allclose(found[:, :, 0].T, clamped_cosine(sphere.normals_v3, 4), atol=1e-6)


@pytest.mark.parametrize("kind", ["unshadowed", "shadowed"])
def test_albedo_scales_the_function(kind):
    sphere = icosphere(1)
    white = transfer_vertices(sphere, 2, kind, 256)
    colour = np.random.default_rng(1).random((sphere.n_vertex, 3), np.float32)
    found = transfer_vertices(replace(sphere, albedo_vc=colour), 2, kind, 256)
    np.testing.assert_allclose(found, white * colour, rtol=1e-6)


HALF = joined(
    quad((-1, -1, 0), (2, 0, 0), (0, 2, 0), 2, 2),
    quad((1e-3, 2e3, -1e3), (0, -4e3, 0), (0, 0, 2e3)),
)
"""A sheet, and half the sky of its middle behind a wall that stands beside it; both sides of a wall block."""


def middle_of(surface):
    return int(np.abs(surface.vertices_v3[:9]).sum(axis=1).argmin())


def test_half_of_the_sky():
    middle = middle_of(HALF)
    expected = visible_cosine(np.array([0, 0, 1.0]), lambda d: d[:, 0] < 0, 4)
    errors = []
    for count in (1024, 4096, 16384):
        found = transfer_vertices(HALF, 4, "shadowed", count)[:, middle, 0]
        errors.append(np.abs(found - expected).max())
    assert errors[0] < 6e-3
    assert errors[2] < 1.5e-3
    np.testing.assert_allclose(transfer_vertices(HALF, 0, "shadowed", 4096)[0, middle, 0] * CONSTANT, 0.5, atol=5e-3)


def test_a_corner_of_a_box():
    """In the corner of three walls, an eighth of all directions is seen; a little beside it, what rays tell."""
    box = joined(
        quad((0, 0, 0), (9, 0, 0), (0, 9, 0)),
        quad((0, 0, 0), (0, 9, 0), (0, 0, 9)),
        quad((0, 0, 0), (0, 0, 9), (9, 0, 0)),
    )
    at, above = np.array([0.6, 0.7, 0.0]), np.array([0.6, 0.7, 1e-6])
    probe = joined(box, quad(at, (1e-3, 0, 0), (0, 1e-3, 0)))

    def seen(directions):
        triangles = box.vertices_v3[box.faces_f3[2:]]
        return ~np.any([meets_triangle(above, directions, *each) for each in triangles], axis=0)

    expected = visible_cosine(np.array([0, 0, 1.0]), seen, 4)
    found = transfer_vertices(probe, 4, "shadowed", 4096)[:, box.n_vertex, 0]
    assert np.abs(found - expected).max() < 4e-3
    corner = transfer_vertices(box, 2, "shadowed", 4096)[:, 0, 0]
    expected = visible_cosine(np.array([0, 0, 1.0]), lambda d: (d > 0).all(axis=1), 2)
    assert np.abs(corner - expected).max() < 4e-3


@pytest.mark.parametrize(
    ("scale", "shift"), [(1.0, 0.0), (1e-30, 0.0), (1e30, 0.0), (1.0, 1e6), (1e-3, 1e3), (1e9, -1e15)]
)
def test_place_and_size_change_nothing(scale, shift):
    box = open_box(4)
    moved = replace(box, vertices_v3=box.vertices_v3 * scale + shift)
    expected = transfer_vertices(box, 3, "interreflected", 1024)
    found = transfer_vertices(moved, 3, "interreflected", 1024)
    assert np.abs(found - expected).max() < 5e-3
    assert np.sqrt(np.mean((found - expected) ** 2)) < 2e-4


@pytest.mark.parametrize("kind", ["unshadowed", "shadowed", "interreflected"])
def test_local_frames_hold_the_same_functions(kind):
    box = open_box(3)
    turn = rotation_matrix("axis", (1.0, 2.0, 0.5, 40.0))
    box = replace(box, vertices_v3=box.vertices_v3 @ turn.T, normals_v3=box.normals_v3 @ turn.T)
    local = with_frames(box, "local")
    about = transfer_vertices(box, 5, kind, 256)
    inside = transfer_vertices(local, 5, kind, 256)
    directions = make_samples(64, seed=3).directions_s3
    for vertex in (0, 7, box.n_vertex - 1):
        there = directions @ local.frames()[vertex].T
        expected = real_harmonics(directions, 5) @ about[:, vertex, 0]
        np.testing.assert_allclose(real_harmonics(there, 5) @ inside[:, vertex, 0], expected, atol=2e-6)


def test_frames_are_sound_about_every_normal():
    rng = np.random.default_rng(2)
    normals = rng.normal(size=(10000, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3), [[1e-9, 0, -1], [0, 1e-4, -1], [1e-8, 1e-8, -1]]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = tangents_of(normals)
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0, rtol=1e-12)
    assert np.abs(np.einsum("va,va->v", tangents, normals)).max() < 1e-9
    near = normals[:10000] + 1e-4 * rng.normal(size=(10000, 3))
    near /= np.linalg.norm(near, axis=1, keepdims=True)
    jump = np.linalg.norm(tangents_of(near) - tangents[:10000], axis=1)
    assert jump[normals[:10000, 2] > -0.9].max() < 2e-2


def test_somebodys_directions_are_weighted_by_their_cells():
    sphere = icosphere(1)
    directions = make_samples(576, seed=5).directions_s3
    found = transfer_vertices(sphere, 3, "shadowed", directions)
    np.testing.assert_allclose(found[:, :, 0].T, clamped_cosine(sphere.normals_v3, 3), atol=1e-6)
    above = directions[directions[:, 2] > 0]
    samples = given_samples(above)
    assert not samples.is_whole
    np.testing.assert_allclose(samples.weights_s.sum(), 2 * np.pi)
    found = transfer_vertices(sphere, 3, "shadowed", samples)
    top, bottom = sphere.normals_v3[:, 2].argmax(), sphere.normals_v3[:, 2].argmin()
    expected = visible_cosine(sphere.normals_v3[top], lambda d: d[:, 2] > 0, 3)
    assert np.abs(found[:, top, 0] - expected).max() < 5e-3
    expected = visible_cosine(sphere.normals_v3[bottom], lambda d: d[:, 2] > 0, 3)
    assert np.abs(found[:, bottom, 0] - expected).max() < 5e-3


def test_the_number_of_vertices_at_a_time_changes_nothing():
    box = open_box(5)
    whole, tally = transfer_vertices(box, 3, "shadowed", 256), Tally()
    part = transfer_vertices(box, 3, "shadowed", 256, memory=256 * 64, tally=tally)
    np.testing.assert_allclose(part, whole, atol=1e-6)
    assert 0 < tally.rays <= 128 * box.n_vertex * 1.1
    with pytest.raises(InputError, match="that --memory leaves"):
        transfer_vertices(box, 3, "shadowed", 256, memory=256 * 63)


@pytest.mark.parametrize(
    ("asked", "phrase"),
    [
        ({"degree": 101}, "degree must be"),
        ({"kind": "glossy"}, "transfer must be"),
        ({"samples_s3": 1000}, "square count"),
        ({"samples_s3": 9}, "at least 16"),
        ({"samples_s3": np.zeros((3, 3))}, "no finite unit vector"),
        ({"kind": "interreflected", "bounces": -1}, "bounces must be"),
        ({"kind": "interreflected", "way": "wait"}, "gather or shoot"),
        ({"kind": "interreflected", "way": "shoot"}, "threshold must be"),
        ({"kind": "interreflected", "threshold": 1.0}, "threshold must be"),
    ],
)
def test_wrong_requests(asked, phrase):
    with pytest.raises(InputError, match=phrase):
        transfer_vertices(icosphere(1), **{"degree": 2, **asked})


def test_rays_tell_the_side_that_they_meet():
    sphere = icosphere(2)
    scene = RayScene(sphere)
    out = np.array([[0.1, 0.2, 3.0], [0.1, 0.2, 0.0], [0, 0, 3.0]])
    found = scene.hit_from(out, np.array([[0, 0, -1], [0, 0, 1], [0, 0, 1]], np.float32))
    assert found.from_behind_r.tolist()[:2] == [False, True]
    assert (found.face_r >= 0).tolist() == [True, True, False]
    at = np.einsum("rc,rca->ra", found.weights_r3[:2], sphere.vertices_v3[sphere.faces_f3[found.face_r[:2]]])
    np.testing.assert_allclose(at[:, :2], out[:2, :2], atol=1e-5)
    np.testing.assert_allclose(at[:, 2], out[:2, 2] + [-1, 1] * found.distance_r[:2], atol=1e-5)


def test_a_scanned_figure_is_closed_to_rays_wherever_it_stands(real_data):
    pytest.importorskip("trimesh")
    from clrelight.transfer.mesh_files import read_mesh
    from clrelight.transfer.notes import probe

    figure = read_mesh(real_data / "meshes" / "armadillo.ply")
    assert figure.notes == ("it has no normals: they are made from its faces",)
    assert (figure.n_vertex, len(figure.faces_f3)) == (15002, 30000)
    expected = None
    for scale, shift in ((1.0, 0.0), (1.0, 1e6), (1e-20, 0.0), (1e20, 0.0)):
        moved = replace(figure, vertices_v3=figure.vertices_v3 * scale + shift)
        scene = RayScene(moved)
        seen = probe(moved, scene, make_samples(64))
        assert seen.rays > 60000
        assert seen.hits > 0.2 * seen.rays
        assert seen.behind <= 1e-4 * seen.rays
        found = transfer_vertices(moved, 2, "shadowed", 64, scene=scene)
        expected = found if expected is None else expected
        assert np.abs(found - expected).max() < 0.02
        assert np.sqrt(np.mean((found - expected) ** 2)) < 1e-4
