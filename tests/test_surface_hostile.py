"""Numbers at the ends of what floats hold, and requests that are too large, end in a line before anything is made."""

import time
import warnings
from dataclasses import replace

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.surface.render import render
from clrelight.jobs.surface.transfer import transfer
from clrelight.transfer.cameras import Camera, frame_surface
from clrelight.transfer.frames import tangents_of, turn_into_frames
from clrelight.transfer.meshes import make_surface
from clrelight.transfer.samples import make_samples
from clrelight.transfer.transport import Transport, transfer_vertices
from tests.meshes import icosphere

pytest.importorskip("embreex")


def scaled(scale):
    ball = icosphere(1)
    return make_surface(scale * ball.vertices_v3, ball.faces_f3)


@pytest.mark.parametrize("scale", [1e-28, 1e-20, 1e20, 1e29])
def test_scale_makes_no_difference_and_no_warning(scale):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = transfer_vertices(scaled(scale), 2, "interreflected", 64)
    np.testing.assert_allclose(found, transfer_vertices(scaled(1.0), 2, "interreflected", 64), atol=1e-4)


@pytest.mark.parametrize(("scale", "says"), [(1e99, "finite numbers up to 1e"), (1e-40, "2e-40 across, expected at")])
def test_scales_that_rays_cannot_hold_are_refused(scale, says):
    with pytest.raises(InputError, match=says):
        scaled(scale)


@pytest.mark.parametrize("length", [1e-300, 1e-200, 1e200, 1e300])
def test_directions_of_cameras_have_any_length(length):
    ball = icosphere(1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = frame_surface(ball, (length, 0, 0), up=(0, 0, length))
        axes = camera.axes()
    np.testing.assert_allclose(axes, frame_surface(ball, (1, 0, 0)).axes(), atol=1e-12)


@pytest.mark.parametrize(("scale", "offset"), [(1e-20, 0.0), (1e20, 1e20), (1.0, 1e9), (1e-3, 1e3)])
def test_automatic_cameras_see_surfaces_anywhere_of_any_size(scale, offset):
    ball = icosphere(1)
    placed = replace(ball, vertices_v3=scale * ball.vertices_v3 + offset)
    pictures = [render(transfer(each, kind="unshadowed", degree=1), (0.3, 0.2, 1), size=24) for each in (ball, placed)]
    assert pictures[0].max() > 0.2
    np.testing.assert_allclose(pictures[1], pictures[0], atol=1e-3)


def test_nothing_is_no_direction_upwards():
    with pytest.raises(InputError, match="up for a camera is three finite numbers that are not all zero, got 0, 0, 0"):
        frame_surface(icosphere(1), up=(0, 0, 0))
    with pytest.raises(InputError, match="up for a camera"):
        Camera((1, 0, 0), up_3=(0, 0, 0))


def test_light_that_is_not_there_is_not_turned():
    made = transfer(icosphere(1), kind="unshadowed", degree=1)
    seen = replace(made, surface=replace(made.surface, argument="view"))
    assert render(seen, size=8).shape == (8, 8, 1)
    with pytest.raises(InputError, match="--rotate turns distant light, and there is none"):
        render(seen, size=8, rotate=30.0)


@pytest.mark.parametrize("degree", [0, 1, 4, 9])
def test_functions_are_turned_into_frames_exactly(degree):
    """Also into those of normals along the axes, where the angles of a turn are not unique."""
    normals = np.concatenate([icosphere(1).vertices_v3, np.eye(3), -np.eye(3)])
    tangents = tangents_of(normals)
    frames = np.stack([tangents, np.cross(normals, tangents), normals], axis=1)
    rng = np.random.default_rng(3)
    coeffs = rng.standard_normal((len(frames), 2, (degree + 1) ** 2)).astype(np.float32)
    turned = turn_into_frames(coeffs, frames)
    directions = rng.standard_normal((20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for frame, before, after in zip(frames, coeffs, turned, strict=True):
        told = before @ evaluate_basis(directions @ frame, degree).T
        np.testing.assert_allclose(after @ evaluate_basis(directions, degree).T, told, atol=2e-6 * (degree + 1) ** 2)


def test_too_many_samples_are_refused_before_rays(tmp_path):
    since = time.perf_counter()
    with pytest.raises(InputError, match=r"4194304 samples of degree 50 take .* more than the 67108864 that --memory"):
        transfer(tmp_path / "gone.ply", kind="interreflected", degree=50, samples=1 << 22, out=tmp_path / "out.h5")
    assert time.perf_counter() - since < 20.0
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("threshold", "way"), [(1.0, "gather"), (0.0, "shoot"), (np.nan, "gather")])
def test_thresholds_are_below_one(threshold, way):
    with pytest.raises(InputError, match="at least 0, above 0 where light is shot, and below 1"):
        Transport(2, "interreflected", make_samples(64), threshold=threshold, way=way)
