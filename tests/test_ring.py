import hashlib
import sys

import numpy as np
import pytest

pytest.importorskip("embreex")

from clrelight.errors import InputError
from clrelight.sampling import make_pattern
from clrelight.transfer.brdfs import Ggx
from datasets_synth.render import GROUND, SUBSAMPLES, Material, TorusTracer, reflect_ggx, shade_pixels
from datasets_synth.ring import CAMERA, EXPOSURE, RINGS, render_ring, sample_albedo
from datasets_synth.texture import hash_lattice, tile_albedo
from tests.reference.ring import first_hit, ggx_brdf, is_visible

TORI = [ring.torus for ring in RINGS]
MATERIALS = [ring.material for ring in RINGS]
LIGHTS = [np.array(v) / np.linalg.norm(v) for v in [(0.1, 0.2, 1), (-1, -0.5, 0.8), (0.7, -1, 0.3), (0.3, 1, 0.15)]]
SIZE = 48


@pytest.fixture(scope="module")
def tracer():
    return TorusTracer(TORI)


@pytest.fixture(scope="module")
def samples(tracer):
    return tracer.see(CAMERA, SIZE, range(SIZE))


def test_the_eye_sees_what_the_exact_surfaces_give(samples):
    rays = -samples.views_s3.astype(np.float64)
    distance, owner = first_hit(TORI, np.array(CAMERA.eye), rays)
    same = owner == samples.owner_s
    assert same.mean() > 0.998
    assert set(np.unique(owner)) == {GROUND, *range(len(TORI))}
    points = np.array(CAMERA.eye) + distance[:, None] * rays
    away = np.linalg.norm(points - samples.points_s3, axis=1)[same]
    # The mesh is 1e-4 off the surface; where the eye looks along it, that grows.
    assert np.median(away) < 1e-5
    assert np.mean(away < 3e-3) > 0.995


def test_picture_axes(samples):
    # Rows go down, x to the right, y away from the eye; the subsamples of a pixel are together.
    points = samples.points_s3.reshape(SIZE, SIZE, SUBSAMPLES**2, 3)
    assert np.all(np.diff(points[-1, :, :, 0].mean(axis=-1)) > 0)
    assert points[0, :, :, 1].min() > points[-1, :, :, 1].max()
    ground = samples.owner_s.reshape(SIZE, SIZE, -1) == GROUND
    spread = np.ptp(points, axis=2)[np.all(ground, axis=-1)]
    assert spread.max() < 2.0 * 3.0 / SIZE


def test_points_and_normals_lie_on_the_surfaces(samples):
    for index, torus in enumerate(TORI):
        mine = samples.owner_s == index
        p = samples.points_s3[mine].astype(np.float64) - torus.centre
        axis = np.array(torus.axis) / np.linalg.norm(torus.axis)
        flat = p - np.outer(p @ axis, axis)
        to_core = p - torus.major * flat / np.linalg.norm(flat, axis=1, keepdims=True)
        np.testing.assert_allclose(np.linalg.norm(to_core, axis=1), torus.minor, atol=1e-6)
        np.testing.assert_allclose(samples.normals_s3[mine], to_core / torus.minor, atol=2e-5)
    ground = samples.owner_s == GROUND
    assert np.all(samples.points_s3[ground, 2] == 0)
    assert np.all(samples.normals_s3[ground] == [0, 0, 1])


@pytest.mark.parametrize("light", LIGHTS)
def test_shadows_are_those_of_the_exact_surfaces(tracer, samples, light):
    chosen = np.arange(0, len(samples.owner_s), 2)
    points, normals = (a[chosen].astype(np.float64) for a in (samples.points_s3, samples.normals_s3))
    expected = is_visible(TORI, points, normals, light)
    seen = tracer.visible(samples, light)[chosen]
    # Where light grazes a surface, the reference cannot tell the point itself from the next crossing.
    clear = np.abs(normals @ light) > 0.05
    assert np.mean(seen[clear] == expected[clear]) > 0.998
    on_ring = samples.owner_s[chosen] != GROUND
    for part in (on_ring, ~on_ring):
        lit = expected[part & clear].mean()
        assert 0.05 < lit < 0.99
        assert np.mean(seen[part & clear] == expected[part & clear]) > 0.995


def test_ggx_lobe_is_the_textbook_one():
    rng = np.random.default_rng(1)
    normals, views = rng.normal(size=(2, 500, 3))
    normals, views = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (normals, views))
    light = LIGHTS[1]
    both = (normals @ light > 0.05) & (np.sum(normals * views, axis=1) > 0.05)
    normals, views = normals[both], views[both]
    assert len(normals) > 80
    for roughness in (0.12, 0.3):
        material = Material(diffuse=(0, 0, 0), specular=(0.9, 0.5, 0.04), roughness=roughness)
        actual = reflect_ggx(normals.astype(np.float32), views.astype(np.float32), light, material)
        expected = ggx_brdf(normals, views, light, material.specular, roughness)
        # 1 - (n.h)^2 (1 - a^2) cancels down to a^2 at the peak: eps32 / a^2, squared, with a dozen roundings.
        np.testing.assert_allclose(actual, expected, rtol=30 * np.finfo(np.float32).eps / roughness**2)


def test_ggx_lobe_is_that_of_surfaces():
    """Whose roughness is the root of the ring's."""
    light, view = np.array([0.48, 0.0, 0.64]) / 0.8, np.array([[-0.36, 0.48, 0.8]])
    material = Material(diffuse=(0, 0, 0), specular=(0.9, 0.5, 0.04), roughness=0.3)
    ring = reflect_ggx(np.float32([[0, 0, 1]]), view.astype(np.float32), light, material)
    np.testing.assert_allclose(ring, Ggx(0.0, material.specular, roughness=0.3**0.5).gloss(light, view), rtol=1e-4)


def test_ggx_lobe_reflects_no_more_than_it_gets():
    # All but the light lost to single scattering comes back: 1 for a mirror-like metal, never above.
    lights = make_pattern("uniform", 4000)
    normal, view = np.float32([[0, 0, 1]]), np.float32([[0.6, 0, 0.8]])
    material = Material(diffuse=(0, 0, 0), specular=(1, 1, 1), roughness=0.2)
    total = sum(reflect_ggx(normal, view, light, material)[0, 0] * light[2] for light in lights)
    assert 0.93 < total * 2 * np.pi / len(lights) < 1.0


def test_pixels_are_the_mean_of_brdf_times_cosine_times_visibility(tracer, samples):
    light = LIGHTS[1]
    albedo = sample_albedo(samples, 0)
    actual = shade_pixels(tracer, samples, albedo, MATERIALS, light)
    normals, views = samples.normals_s3.astype(np.float64), samples.views_s3.astype(np.float64)
    reflectance = albedo.astype(np.float64)
    for index, material in enumerate(MATERIALS):
        mine = np.flatnonzero((samples.owner_s == index) & (normals @ light > 0))
        lobe = ggx_brdf(normals[mine], views[mine], light, material.specular, material.roughness)
        reflectance[mine] = material.diffuse + np.pi * lobe
    visible = is_visible(TORI, samples.points_s3.astype(np.float64), normals, light)
    shaded = reflectance * (visible * (normals @ light))[:, None]
    expected = shaded.reshape(-1, SUBSAMPLES**2, 3).mean(axis=1)
    close = np.all(np.abs(actual - expected) <= 1e-4 * expected + 1e-6, axis=1)
    assert np.mean(close) > 0.98
    # One sample whose visibility differs moves its pixel; nothing else may, so the sums agree.
    assert actual.sum() == pytest.approx(expected.sum(), rel=2e-3)


def test_open_ground_is_lambertian_to_rounding(samples):
    stack = render_ring(size=SIZE, lights=12, dtype="float32", seed=4)
    images = stack.images_ihwc.astype(np.float64)
    xy = samples.points_s3[:, :2].astype(np.float64)
    albedo = tile_albedo(xy, 4).reshape(-1, SUBSAMPLES**2, 3).mean(axis=1).reshape(SIZE, SIZE, 3)
    ground = (samples.owner_s == GROUND).reshape(SIZE, SIZE, -1).all(axis=-1)
    points, normals = samples.points_s3.astype(np.float64), samples.normals_s3.astype(np.float64)
    for index in (0, 5, 11):
        light = stack.directions_i3[index]
        lit = is_visible(TORI, points, normals, light, nearest=0.0).reshape(SIZE, SIZE, -1).all(axis=-1)
        open_hw = ground & lit
        # A pixel at a shadow's very edge may differ in one sample; the others are exact.
        exact = np.isclose(images[index], EXPOSURE * albedo * light[2], rtol=2e-6).all(axis=-1)
        assert open_hw.mean() > 0.1
        assert exact[open_hw].mean() > 0.99


def test_same_arguments_give_the_same_bytes_and_seeds_differ():
    def digest(**change):
        stack = render_ring(**{"size": 32, "lights": 6, "pattern": "scattered", "seed": 2, **change})
        return hashlib.sha256(stack.images_ihwc.tobytes() + stack.directions_i3.tobytes()).hexdigest()

    assert digest() == digest()
    assert digest(seed=3) != digest()


def test_bands_of_rows_do_not_show(monkeypatch):
    whole = render_ring(size=24, lights=2).images_ihwc
    monkeypatch.setattr("datasets_synth.ring._BAND_SAMPLES", 24 * 4 * 5)
    np.testing.assert_array_equal(render_ring(size=24, lights=2).images_ihwc, whole)


def test_sample_types_are_the_same_picture():
    exact, half, byte = (render_ring(size=32, lights=5, dtype=d) for d in ("float32", "float16", "uint8"))
    assert (exact.peak, half.peak, byte.peak) == (1.0, 1.0, 255.0)
    assert {exact.transfer, half.transfer, byte.transfer} == {"linear"}
    assert {exact.name, half.name, byte.name} == {"ring"}
    values = exact.images_ihwc
    np.testing.assert_array_equal(half.images_ihwc, values.astype(np.float16))
    np.testing.assert_array_equal(byte.images_ihwc, np.rint(np.clip(values, 0, 1) * np.float32(255)))


def test_picture_uses_its_range():
    images = render_ring(size=64, lights=64).images_ihwc
    assert 0.2 < images.mean() / 255 < 0.4
    assert 1e-3 < np.mean(images == 255) < 0.05
    assert np.mean(images == 0) > 0.05


@pytest.mark.parametrize("pattern", ["uniform", "grid", "scattered"])
def test_each_pattern_gives_its_lights(pattern):
    stack = render_ring(size=8, lights=16, pattern=pattern, seed=1)
    np.testing.assert_array_equal(stack.directions_i3, make_pattern(pattern, 16, 1))
    assert stack.images_ihwc.shape == (16, 8, 8, 3)


def test_progress_counts_to_the_end():
    calls = []
    render_ring(size=16, lights=3, progress=lambda done, total: calls.append((done, total)))
    assert [done for done, _ in calls] == list(range(1, calls[-1][1] + 1))
    assert len({total for _, total in calls}) == 1


def test_rings_do_not_run_into_each_other():
    angles = np.linspace(0, 2 * np.pi, 1500, endpoint=False)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    cores = [torus.centre + torus.major * circle @ torus.frame()[:2] for torus in TORI]
    for i, (torus, core) in enumerate(zip(TORI, cores, strict=True)):
        for other, other_core in zip(TORI[:i], cores[:i], strict=True):
            gap2 = (core**2).sum(1)[:, None] + (other_core**2).sum(1) - 2 * core @ other_core.T
            assert np.sqrt(gap2.min()) > torus.minor + other.minor


def test_lattice_hash_is_even_and_repeats():
    i, j = np.divmod(np.arange(40_000) - 20_000, 200)
    values = hash_lattice(i, j, 7)
    np.testing.assert_allclose(np.histogram(values, bins=8, range=(0, 1))[0], 5000, rtol=0.06)
    assert abs(np.corrcoef(values[:-1], values[1:])[0, 1]) < 0.02
    np.testing.assert_array_equal(values, hash_lattice(i, j, 7))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"size": 7}, "size must be at least 8"),
        ({"lights": 0}, "at least 1 light"),
        ({"pattern": "spiral"}, "pattern must be one of uniform, grid, scattered"),
        ({"pattern": "grid", "lights": 13}, "nearest that do: 12 and 14"),
        ({"dtype": "float64"}, "dtype must be one of uint8, float16, float32"),
        ({"seed": -1}, "seed must be at least 0"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        render_ring(**{"size": 8, "lights": 2, **arguments})


def test_absent_ray_tracer_is_named(monkeypatch):
    for name in [m for m in sys.modules if m.split(".")[0] == "embreex"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "embreex", None)
    monkeypatch.setattr("datasets_synth.ring.TorusTracer", TorusTracer)  # no scene that was made before: conftest.py
    with pytest.raises(InputError, match=r"pip install 'clrelight\[synth\]'"):
        render_ring(size=8, lights=1)
