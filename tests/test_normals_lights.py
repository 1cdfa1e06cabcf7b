"""Normals where more or less is known of lights than directions: positions, intensities, or nothing."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.variation.gains import estimate_gains
from clrelight.variation.near_lights import NearLights, read_gains, read_positions
from clrelight.variation.unknown import factor_four, factor_nine, harmonics, null_vectors
from tests.commands import call, contents
from tests.test_normals import ALBEDO, angles

SIZE, PIXEL = 48, 0.5


def relief(size=SIZE):
    """Return normals (size, size, 3) and heights in pixels of bumps on a dome, by hand."""
    y_h, x_w = np.linspace(1, -1, size), np.linspace(-1, 1, size)
    x_hw, y_hw = np.meshgrid(x_w, y_h)
    z_hw = -0.35 * x_hw**2 - 0.25 * y_hw**2 + 0.05 * np.sin(4 * x_hw + 1) * np.cos(3 * y_hw)
    right_hw = -0.7 * x_hw + 0.2 * np.cos(4 * x_hw + 1) * np.cos(3 * y_hw)
    up_hw = -0.5 * y_hw - 0.15 * np.sin(4 * x_hw + 1) * np.sin(3 * y_hw)
    normals_hw3 = np.stack([-right_hw, -up_hw, np.ones_like(x_hw)], axis=2)
    normals_hw3 /= np.linalg.norm(normals_hw3, axis=2, keepdims=True)
    return normals_hw3, z_hw * (size - 1) / 2


def lamps(count=24, distance=40.0):
    """Return positions of lamps in millimetres, at distances of 0.8 to 1.2."""
    directions_i3 = make_pattern("uniform", count)
    directions_i3 = directions_i3[directions_i3[:, 2] > 0.35]
    return directions_i3 * distance * np.linspace(0.8, 1.2, len(directions_i3))[:, None]


def near_stack(positions_i3, gains_i=1.0, pixel=PIXEL, encode=None):
    """Return what lamps at positions make of the relief, and the directions from its middle."""
    normals_hw3, height_hw = relief()
    x_hw, y_hw = np.meshgrid(np.arange(SIZE) - (SIZE - 1) / 2, (SIZE - 1) / 2 - np.arange(SIZE))
    place_hw3 = np.stack([x_hw, y_hw, height_hw - height_hw.mean()], axis=2) * pixel
    towards_ihw3 = positions_i3[:, None, None] - place_hw3
    distance_ihw = np.linalg.norm(towards_ihw3, axis=3)
    cosine_ihw = np.maximum(np.sum(towards_ihw3 * normals_hw3, axis=3) / distance_ihw, 0.0)
    falloff_ihw = np.mean(np.sum(positions_i3**2, axis=1)) / distance_ihw**2
    gains_ihw = np.broadcast_to(np.asarray(gains_i, float).reshape(-1, 1, 1), falloff_ihw.shape)
    images = ALBEDO * (gains_ihw * cosine_ihw * falloff_ihw)[..., None]
    directions_i3 = positions_i3 / np.linalg.norm(positions_i3, axis=1, keepdims=True)
    return cr.LightStack(images.astype(np.float32), directions_i3, 4.0)


def error(stack, **options):
    return angles(cr.normals(stack, report=cr.Report(), **options).normals_hw3, relief()[0])


def gains_of(count):
    gains_i = np.exp(0.4 * np.random.default_rng(3).standard_normal(count))
    return gains_i / gains_i.mean()


@pytest.mark.parametrize("method", ["auto", "least-squares"])
def test_near_lights(method):
    positions_i3 = lamps()
    stack = near_stack(positions_i3)
    distant = error(stack, method=method)
    near = error(stack, method=method, positions=positions_i3, pixel=PIXEL)
    assert distant.mean() > 3.0
    assert near.mean() < (0.4 if method == "auto" else 1.2)
    assert near.mean() < 0.15 * distant.mean()


def test_near_lights_of_unknown_gains():
    positions_i3 = lamps()
    gains_i = gains_of(len(positions_i3))
    stack, report = near_stack(positions_i3, gains_i), cr.Report()
    found = cr.normals(stack, positions=positions_i3, pixel=PIXEL, gains="estimate", report=report)
    assert angles(found.normals_hw3, relief()[0]).mean() < 0.7
    assert error(stack, positions=positions_i3, pixel=PIXEL).mean() > 3.0
    np.testing.assert_allclose(report.facts["gains"], gains_i, rtol=0.03)
    assert report.facts["rounds"] > 1
    np.testing.assert_allclose(np.median(found.albedo_hwc, axis=(0, 1)), ALBEDO / 4, rtol=0.05)


def test_near_lights_far_away_are_distant():
    stack = near_stack(lamps(distance=1e5))
    near = cr.normals(stack, positions=lamps(distance=1e5), pixel=PIXEL, report=cr.Report())
    distant = cr.normals(stack, report=cr.Report())
    # Their distances differ, which directions alone do not tell.
    assert angles(near.normals_hw3, relief()[0]).mean() < 0.05
    assert angles(distant.normals_hw3, relief()[0]).mean() > 1.0


@pytest.mark.parametrize("broken", ["nothing", "noise", "gloss", "shadow", "clipped"])
def test_gains(broken):
    rng, directions_i3 = np.random.default_rng(1), make_pattern("uniform", 30)
    normals_p3 = rng.standard_normal((600, 3)) * 0.4 + [0, 0, 1]
    normals_p3 /= np.linalg.norm(normals_p3, axis=1, keepdims=True)
    samples_ip = np.maximum(directions_i3 @ normals_p3.T, 0.0) * rng.uniform(0.2, 0.8, 600)
    if broken == "noise":
        samples_ip = np.maximum(samples_ip + 0.003 * rng.standard_normal(samples_ip.shape), 0.0)
    if broken == "gloss":
        half_i3 = directions_i3 + np.array([0, 0, 1])
        half_i3 /= np.linalg.norm(half_i3, axis=1, keepdims=True)
        samples_ip += 0.3 * np.maximum(half_i3 @ normals_p3.T, 0.0) ** 40
    if broken == "shadow":
        samples_ip *= rng.random(samples_ip.shape) > 0.15
    gains_i = gains_of(30)
    samples_ip = samples_ip * gains_i[:, None]
    most = np.inf
    if broken == "clipped":
        most = 0.6
        samples_ip = np.minimum(samples_ip, most)
    found = estimate_gains(samples_ip[None].astype(np.float32), directions_i3, most)
    np.testing.assert_allclose(
        found.gains_i, gains_i, rtol={"nothing": 1e-4, "noise": 3e-3, "gloss": 0.03}.get(broken, 1e-4)
    )
    assert found.spread < 0.01


def test_gains_from_a_file_and_per_channel(tmp_path):
    positions_i3 = lamps()
    gains_i = gains_of(len(positions_i3))
    stack = near_stack(positions_i3, gains_i)
    for name, values in (
        ("line.txt", gains_i[:, None]),
        ("columns.txt", gains_i[None]),
        ("rgb.csv", gains_i[:, None] * ALBEDO),
    ):
        np.savetxt(tmp_path / name, values, delimiter="," if name.endswith("csv") else " ")
        assert error(stack, positions=positions_i3, pixel=PIXEL, gains=tmp_path / name).mean() < 0.6
    np.testing.assert_allclose(read_gains(tmp_path / "rgb.csv", len(gains_i), 3).mean(), 1.0)
    assert error(stack, positions=positions_i3, pixel=PIXEL, gains=3.0 * gains_i).mean() < 0.6


def test_positions_as_people_write_them(tmp_path):
    positions_i3 = lamps()
    rows = ["lamp,x,y,z", *(f"img_{i:02}.png,{x:.4f},{y:.4f},{z:.4f}" for i, (x, y, z) in enumerate(positions_i3))]
    (tmp_path / "lamps.csv").write_text("\n".join(rows), "utf-8")
    (tmp_path / "lamps.lp").write_text("\n".join([str(len(rows) - 1), *(each.replace(",", " ") for each in rows[1:])]))
    np.savetxt(tmp_path / "lamps.txt", positions_i3.T)
    for name in ("lamps.csv", "lamps.lp", "lamps.txt"):
        found, _ = read_positions(tmp_path / name, len(positions_i3), PIXEL)
        np.testing.assert_allclose(found.positions_i3 * PIXEL, positions_i3, atol=1e-3)
    cr.write_stack(tmp_path / "s.h5", near_stack(positions_i3, gains_of(len(positions_i3))))
    ended = call(
        *("normals", tmp_path / "s.h5", tmp_path / "n.exr", "--positions", tmp_path / "lamps.csv"),
        *("--pixel", PIXEL, "--gains", "estimate"),
    )
    assert ended.code == 0
    assert "gains       " in ended.out
    assert "of normals and heights" in ended.out


SCREEN = np.array([1, 1, 1, 1, 0.35, 0.35, 0.35, 0.35, 0.35])


def unknown_stack(degree, size=SIZE, albedo=0.6):
    """Return a stack under random light of a degree, exactly."""
    rng, normals_hw3 = np.random.default_rng(degree), relief(size)[0]
    count = {1: 4, 2: 9}[degree]
    shade_khw = harmonics(normals_hw3.transpose(2, 0, 1))[:count]
    light_ik = 0.3 * rng.standard_normal((25, count)) * SCREEN[:count]
    light_ik[:, 0] = 2.0 + np.abs(light_ik[:, 0])
    y_h, x_w = np.linspace(1, -1, size), np.linspace(-1, 1, size)
    albedo_hw = albedo + 0.2 * np.sin(7 * x_w) + 0.15 * (y_h[:, None] > 0.1)
    images = np.einsum("ik,khw->ihw", light_ik, shade_khw * albedo_hw)[..., None] * ALBEDO
    assert images.min() >= 0.0
    return cr.LightStack(images.astype(np.float32), make_pattern("uniform", 25), 1.0), albedo_hw, light_ik


@pytest.mark.parametrize("degree", [1, 2])
def test_unknown_light_is_exact_up_to_the_ambiguity(degree):
    """Within 1e-3 degrees after the Lorentz transformation that is nearest, which is one."""
    normals_p3 = relief(24)[0].reshape(-1, 3)
    _, albedo_hw, light_ik = unknown_stack(degree, 24)
    seen_kp = albedo_hw.ravel() * harmonics(normals_p3.T)[: light_ik.shape[1]]
    components_kp = np.linalg.svd(light_ik @ seen_kp, full_matrices=False)[2][: light_ik.shape[1]]
    components_kp *= np.sqrt(len(normals_p3))
    if degree == 1:
        factored = factor_four(components_kp)
    else:
        start = factor_four(components_kp[:4]).rows_4k @ components_kp[:4]
        factored = factor_nine(components_kp, (start,))
    assert factored.residual < 1e-6
    found_4p = null_vectors(factored.rows_4k @ components_kp, degree)
    true_4p = null_vectors(albedo_hw.ravel() * np.concatenate([np.ones((1, len(normals_p3))), normals_p3.T]), degree)
    turn_44 = true_4p @ np.linalg.pinv(found_4p)
    metric_44 = turn_44 @ np.diag([1, -1, -1, -1]) @ turn_44.T
    np.testing.assert_allclose(metric_44 / metric_44[0, 0], np.diag([1, -1, -1, -1]), atol=1e-5)
    aligned_3p = (turn_44 @ found_4p)[1:]
    assert angles((aligned_3p / np.linalg.norm(aligned_3p, axis=0)).T, normals_p3).max() < 1e-3


@pytest.mark.parametrize("degree", [1, 2])
def test_unknown_light_is_resolved_by_the_surface(degree):
    stack, albedo_hw, _ = unknown_stack(degree, 96)
    normals_hw3 = relief(96)[0]
    report = cr.Report()
    found = cr.normals(stack, lighting="unknown", degree=degree, report=report)
    assert angles(found.normals_hw3, normals_hw3).mean() < 0.3
    assert report.facts["degree"] == degree
    assert report.facts["energy"] > 0.999
    assert "Lorentz" in report.facts["ambiguity"]
    assert "Lorentz" in report.notes[0]
    assert len(report.notes) == 1
    ratio_hwc = found.albedo_hwc / (albedo_hw[..., None] * ALBEDO)
    np.testing.assert_allclose(ratio_hwc / ratio_hwc.mean(), 1.0, atol=0.05)
    hollow = cr.normals(stack, lighting="unknown", degree=degree, concave=True, report=cr.Report())
    np.testing.assert_allclose(hollow.normals_hw3, found.normals_hw3 * [-1, -1, 1], atol=1e-6)


def test_unknown_light_in_tiles_and_a_mask(tmp_path):
    stack, _, _ = unknown_stack(1, 96)
    mask_hw = np.hypot(*np.mgrid[-1:1:96j, -1:1:96j]) < 0.9
    masked = cr.LightStack(stack.images_ihwc, stack.directions_i3, 1.0, mask_hw=mask_hw)
    cr.write_stack(tmp_path / "s.h5", masked)
    found = cr.normals(tmp_path / "s.h5", lighting="unknown", memory="2M", report=cr.Report())
    assert angles(found.normals_hw3, relief(96)[0])[mask_hw].mean() < 0.5
    assert not found.normals_hw3[~mask_hw].any()
    out = call("normals", tmp_path / "s.h5", tmp_path / "n.exr", "--lighting", "unknown", "--concave")
    assert out.code == 0
    assert "unknown, degree 1: its components hold 100.0% of the energy" in out.out
    assert "the concave one was taken" in out.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--positions", "p.txt"], "go together"),
        (["--pixel", "1"], "go together"),
        (["--positions", "few.txt", "--pixel", "1"], "holds 4 positions, the stack has"),
        (["--positions", "behind.txt", "--pixel", "1"], "expected lights in front of the surface"),
        (["--positions", "p.txt", "--pixel", "0"], "width of a pixel must be positive"),
        (["--positions", "p.txt", "--pixel", "1", "--method", "quick"], "takes lights as distant"),
        (["--gains", "few.txt"], "intensities, expected"),
        (["--gains", "zero.txt"], "expected positive numbers"),
        (["--gains", "none.txt"], "cannot read"),
        (["--field", "170"], "must be 0 to 150"),
        (["--field", "wide"], "expected degrees"),
        (["--field", "40", "--method", "quick"], "does not look at the camera"),
        (["--degree", "2"], "leave out degree"),
        (["--concave"], "leave out concave"),
        (["--lighting", "unknown", "--gains", "zero.txt"], "leave out gains"),
        (["--lighting", "unknown", "--method", "robust"], "leave out method"),
        (["--lighting", "unknown", "--transfer", "auto"], "name linear or srgb"),
    ],
)
def test_refusals(tmp_path, arguments, message):
    positions_i3 = lamps()
    cr.write_stack(tmp_path / "s.h5", near_stack(positions_i3))
    np.savetxt(tmp_path / "p.txt", positions_i3)
    np.savetxt(tmp_path / "few.txt", positions_i3[:4])
    np.savetxt(tmp_path / "behind.txt", positions_i3 * [1, 1, -1])
    np.savetxt(tmp_path / "zero.txt", np.arange(len(positions_i3)))
    before = contents(tmp_path)
    words = [tmp_path / word if word.endswith(".txt") else word for word in arguments]
    ended = call("normals", tmp_path / "s.h5", tmp_path / "n.exr", *words)
    assert (ended.code, ended.out) == (2, "")
    assert message in ended.err
    assert contents(tmp_path) == before


def test_refusals_of_the_verb():
    stack, _, _ = unknown_stack(2)
    with pytest.raises(InputError, match="as many images"):
        cr.normals(stack.select(np.arange(8)), lighting="unknown", degree=2)
    with pytest.raises(InputError, match="degree 1 or 2"):
        cr.normals(stack, lighting="unknown", degree=3)
    with pytest.raises(InputError, match="lighting must be known or unknown"):
        cr.normals(stack, lighting="some")
    flat = cr.LightStack(np.ones((9, 20, 20, 1), np.float32), make_pattern("uniform", 9), 1.0)
    with pytest.raises(InputError, match="vary in fewer than 4 ways"):
        cr.normals(flat, lighting="unknown")
    with pytest.raises(InputError, match="transfer must be"):
        cr.normals(stack, transfer="gamma")
    with pytest.raises(InputError, match="at least 5 lights"):
        estimate_gains(np.ones((1, 4, 100), np.float32), make_pattern("uniform", 4))
    with pytest.raises(InputError, match="that are not black"):
        estimate_gains(np.zeros((1, 9, 100), np.float32), make_pattern("uniform", 9))
    with pytest.raises(InputError, match="a line a light"):
        NearLights.of(np.ones((4, 2)), 4, 1.0)
