"""Normals from photographs under known lights: exact where the law holds, close where shadow and gloss break it."""

import numpy as np
import OpenImageIO as oiio
import pytest
import scipy.io

import clrelight as cr
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.variation.heights import integrate_normals
from clrelight.variation.kernel import NormalSolver
from clrelight.variation.normals import find_normals
from tests.commands import call, contents, succeed
from tests.styles import every_width

ALBEDO = np.array([0.8, 0.5, 0.3])


def dome(size=48):
    """Return normals of a shallow dome, (size, size, 3), and its heights in pixels."""
    y_h, x_w = np.linspace(1, -1, size), np.linspace(-1, 1, size)
    x_hw, y_hw = np.meshgrid(x_w, y_h)
    step = 2 / (size - 1)
    normals_hw3 = np.stack([x_hw, 0.5 * y_hw, np.ones_like(x_hw)], axis=2)
    height_hw = -(0.5 * x_hw**2 + 0.25 * y_hw**2) / step
    return normals_hw3 / np.linalg.norm(normals_hw3, axis=2, keepdims=True), height_hw


def angles(a_p3, b_p3):
    return np.degrees(np.arccos(np.clip(np.sum(np.asarray(a_p3, np.float64) * b_p3, axis=-1), -1, 1)))


def make_stack(*, gloss=0.0, floor=0.0, lights=49, dtype=np.float32, mask_hw=None, size=48, cast=0.0):
    normals_hw3, _ = dome(size)
    directions_i3 = make_pattern("uniform", lights)
    cosine_ihw = np.maximum(np.einsum("ia,hwa->ihw", directions_i3, normals_hw3), 0.0)
    half_i3 = directions_i3 + np.array([0, 0, 1])
    half_i3 /= np.linalg.norm(half_i3, axis=1, keepdims=True)
    shine_ihw = gloss * np.maximum(np.einsum("ia,hwa->ihw", half_i3, normals_hw3), 0.0) ** 40
    if cast:
        cosine_ihw *= np.random.default_rng(0).random(cosine_ihw.shape) >= cast
    images = ALBEDO * (cosine_ihw + floor)[..., None] + shine_ihw[..., None]
    if dtype != np.float32:
        images = np.rint(images.clip(0, 1) * np.iinfo(dtype).max)
    peak = 1.0 if dtype == np.float32 else float(np.iinfo(dtype).max)
    return cr.LightStack(images.astype(dtype), directions_i3, peak, mask_hw=mask_hw)


def picture(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT))


@pytest.mark.parametrize("method", ["quick", "least-squares"])
def test_matte_and_unshadowed_is_exact(method):
    directions_i3 = make_pattern("uniform", 60)
    directions_i3 = directions_i3[directions_i3[:, 2] > 0.75]
    normals_p3 = dome()[0].reshape(-1, 3)
    normals_p3 = normals_p3[(directions_i3 @ normals_p3.T > 0.2).all(axis=0)]
    samples_cip = (ALBEDO[:, None, None] * (directions_i3 @ normals_p3.T)).astype(np.float32)
    found = find_normals(samples_cip, directions_i3, method)
    assert len(normals_p3) > 500
    assert angles(found.normals_p3, normals_p3).max() < 0.1
    np.testing.assert_allclose(found.albedo_pc, np.tile(ALBEDO, (len(normals_p3), 1)), rtol=1e-4)


@pytest.mark.parametrize(
    ("broken", "most"), [({}, 0.05), ({"gloss": 0.5}, 1.0), ({"floor": 0.1}, 1.0), ({"cast": 0.2}, 0.2)]
)
def test_robust_is_close_where_the_law_is_broken(broken, most):
    stack, (expected, _) = make_stack(**broken), dome()
    errors = {
        name: angles(cr.normals(stack, method=name, report=cr.Report()).normals_hw3, expected).mean()
        for name in ("robust", "least-squares")
    }
    assert errors["robust"] < most
    assert errors["robust"] < 0.5 * errors["least-squares"]


def test_clipped_codes_are_left_out():
    normals_hw3, _ = dome()
    stack = make_stack(dtype=np.uint8)
    bright = np.minimum(np.rint(stack.images_ihwc[:] * 1.6), 255).astype(np.uint8)
    found = cr.normals(cr.LightStack(bright, stack.directions_i3, 255.0), report=cr.Report())
    assert angles(found.normals_hw3, normals_hw3).mean() < 0.5


def test_floor_is_found_and_told():
    report = cr.Report()
    found = cr.normals(make_stack(floor=0.1), report=report)
    assert abs(found.floor - 0.1) < 0.02
    assert report.facts["floor"] == found.floor
    assert "of the albedo" in report.notes[0]
    assert cr.normals(make_stack(), report=cr.Report()).floor < 1e-6


def test_tiles_and_mask_change_nothing(tmp_path):
    mask_hw = np.zeros((48, 48), bool)
    mask_hw[5:30, 7:40] = True
    whole = cr.normals(make_stack(dtype=np.uint16), report=cr.Report())
    cr.write_stack(tmp_path / "s.h5", make_stack(dtype=np.uint16, mask_hw=mask_hw))
    for memory in ("3M", "1G"):
        part = cr.normals(tmp_path / "s.h5", memory=memory, report=cr.Report())
        assert not part.normals_hw3[~mask_hw].any()
        assert not part.confidence_hw[~mask_hw].any()
        assert angles(part.normals_hw3, whole.normals_hw3)[mask_hw].max() < 0.05
        np.testing.assert_allclose(part.albedo_hwc[mask_hw], whole.albedo_hwc[mask_hw], rtol=1e-3)


@pytest.mark.parametrize("exponent", [-60, 60])
def test_peaks_far_from_one(exponent):
    stack, usual = make_stack(), cr.normals(make_stack(), report=cr.Report())
    scaled = cr.LightStack(np.ldexp(stack.images_ihwc, exponent), stack.directions_i3, 1.0)
    found = cr.normals(scaled, report=cr.Report())
    np.testing.assert_array_equal(found.normals_hw3, usual.normals_hw3)
    np.testing.assert_array_equal(np.ldexp(found.albedo_hwc, -exponent), usual.albedo_hwc)


def test_black_pixels_have_none():
    stack = make_stack()
    images = stack.images_ihwc.copy()
    images[:, 3, 4] = 0
    found = cr.normals(cr.LightStack(images, stack.directions_i3, 1.0), report=cr.Report())
    assert not found.normals_hw3[3, 4].any()
    assert np.isfinite(found.albedo_hwc).all()
    assert found.confidence_hw[3, 4] == 0
    assert 0 <= found.confidence_hw.min() <= found.confidence_hw.max() <= 1


def test_heights():
    normals_hw3, height_hw = dome()
    found = integrate_normals(normals_hw3.astype(np.float32))
    np.testing.assert_allclose(found, height_hw - height_hw.mean(), atol=1e-3)
    mask_hw = np.hypot(*np.mgrid[-1:1:48j, -1:1:48j]) < 0.8
    found = integrate_normals(normals_hw3.astype(np.float32), mask_hw)
    np.testing.assert_allclose(found[mask_hw], height_hw[mask_hw] - height_hw[mask_hw].mean(), atol=1e-3)
    assert not found[~mask_hw].any()
    with pytest.raises(InputError, match="no pixel"):
        integrate_normals(np.zeros((4, 5, 3), np.float32))


def test_command(tmp_path):
    cr.write_stack(tmp_path / "s.h5", make_stack(dtype=np.uint16))
    names = {"albedo": "a.png", "confidence": "c.exr", "height": "h.exr", "ply": "m.ply"}
    options = [word for name, file in names.items() for word in (f"--{name}", tmp_path / file)]
    told = succeed("normals", tmp_path / "s.h5", tmp_path / "n.exr", *options, "--json").json
    assert told["files"] == [str(tmp_path / name) for name in ("n.exr", *names.values())]
    assert {"read", "solve", "integrate", "write"} <= told["seconds"].keys()
    assert (told["n_light"], told["pixels"]) == (49, 48 * 48)
    held = cr.normals(tmp_path / "s.h5", report=cr.Report())
    np.testing.assert_array_equal(picture(tmp_path / "n.exr"), held.normals_hw3)
    np.testing.assert_allclose(picture(tmp_path / "a.png"), held.albedo_hwc, atol=1e-5)
    np.testing.assert_array_equal(picture(tmp_path / "c.exr")[..., 0], held.confidence_hw)
    np.testing.assert_array_equal(picture(tmp_path / "h.exr")[..., 0], integrate_normals(held.normals_hw3))
    header, _, body = (tmp_path / "m.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex 2304\n" in header
    assert b"element face 4418\n" in header
    assert len(body) == 2304 * 24 + 4418 * 13
    for green, sign in (("up", 1), ("down", -1)):
        lines = succeed("normals", tmp_path / "s.h5", tmp_path / "n.png", "--green", green).out
        assert "49 lights" in lines
        shown = 2 * picture(tmp_path / "n.png") - 1
        np.testing.assert_allclose(shown, held.normals_hw3 * [1, sign, 1], atol=2e-5)


def coplanar(count):
    angle = np.linspace(0.2, 2.9, count)
    return np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)


@pytest.mark.parametrize(
    ("directions", "arguments", "message"),
    [
        (coplanar(7), ["n.exr"], "condition of their directions is"),
        (coplanar(2), ["n.exr"], "at least 3 lights, got 2"),
        (None, ["n.jpg"], "cannot write"),
        (None, ["n.exr", "--height", "h.png"], "heights are floats"),
        (None, ["n.exr", "--ply", "h.obj"], "a mesh goes to a .ply"),
        (None, ["n.exr", "--memory", "10k"], "more than the memory budget"),
    ],
)
def test_refusals(tmp_path, directions, arguments, message):
    stack = make_stack()
    if directions is not None:
        stack = cr.LightStack(stack.images_ihwc[: len(directions)], directions, 1.0)
    cr.write_stack(tmp_path / "s.h5", stack)
    before = contents(tmp_path)
    words = [tmp_path / word if "." in word else word for word in arguments]
    ended = call("normals", tmp_path / "s.h5", *words)
    assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1)
    assert message in ended.err
    assert contents(tmp_path) == before


def test_refusals_of_the_verb():
    with pytest.raises(InputError, match="method must be one of"):
        cr.normals(make_stack(), method="best")
    with pytest.raises(InputError, match="green must be up or down"):
        cr.normals(make_stack(), green="left")
    with pytest.raises(InputError, match="give out"):
        cr.normals(make_stack(), albedo="a.exr")


def test_photographs_beside_least_squares(real_data, tmp_path):
    """DiLiGenT's crops: shadows, gloss and light between parts; their normals were scanned."""
    ratios = []
    for name in ("cat", "bear", "pot1"):
        folder = real_data / "stacks" / "diligent" / f"{name}PNG"
        stack = cr.ingest(folder, report=cr.Report())
        expected = scipy.io.loadmat(folder / "Normal_gt.mat")["Normal_gt"]
        errors = [
            angles(cr.normals(stack, method=method, report=cr.Report()).normals_hw3, expected)[stack.mask_hw].mean()
            for method in ("auto", "least-squares")
        ]
        ratios.append(errors[0] / errors[1])
    assert max(ratios) <= 0.7


@every_width
@pytest.mark.parametrize("count", [16, 112])
@pytest.mark.parametrize(("lights", "channel"), [(3, 1), (7, 3), (49, 3), (70, 1)])
def test_kernel_is_the_numpy_form(device, count, lights, channel):
    rng, directions_i3 = np.random.default_rng(count), make_pattern("uniform", lights)
    normals_p3 = dome()[0].reshape(-1, 3)[:count]
    shade_ip = np.maximum(directions_i3 @ normals_p3.T, 0.0) + 0.3 * rng.random((lights, count)) ** 12
    albedo_c = ALBEDO[:channel, None, None]
    samples_cip = (albedo_c * shade_ip + 0.01).astype(np.float32)
    samples_cip[:, :, 3] = 0.0
    held = find_normals(samples_cip, directions_i3, "quick", np.any(samples_cip >= 0.7, axis=0), 0.05)
    found = NormalSolver(device, directions_i3, 0.05)(samples_cip, 0.7)
    apart = angles(found.normals_p3, held.normals_p3)[np.arange(count) != 3]
    assert not found.normals_p3[3].any()
    assert found.confidence_p[3] == 0
    assert np.median(apart) < 0.05
    assert np.mean(apart < 1.0) >= 0.85  # a sample at the brightest that counts may fall to either side
    close = np.flatnonzero(np.arange(count) != 3)[apart < 0.05]
    np.testing.assert_allclose(found.albedo_pc[close], held.albedo_pc[close], rtol=0.05)
    np.testing.assert_allclose(found.confidence_p[close], held.confidence_p[close], atol=0.02)
