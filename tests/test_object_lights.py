"""Whether photographs are of one object under lamps, or of noise: both drawn here."""

import numpy as np
import pytest
from scipy import ndimage

import clrelight as cr
from clrelight.images import write_image
from clrelight.variation.shading import are_sums_of_three, lights_from_normals, shade_explains
from tests.commands import call, contents
from tests.reference.spheres import lamps

SIDE = 40


def bumps():
    """Return unit normals, (SIDE, SIDE, 3), of a bumpy surface."""
    y_hw, x_hw = np.mgrid[:SIDE, :SIDE]
    normals = np.stack([0.6 * np.sin(x_hw / 4.0), 0.6 * np.cos(y_hw / 5.0), np.ones((SIDE, SIDE))], axis=2)
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def noise(count, smooth):
    rng = np.random.default_rng(count)
    if not smooth:
        return rng.random((count, SIDE, SIDE))
    return 0.5 + ndimage.gaussian_filter(rng.standard_normal((count, SIDE, SIDE)), (0, 3, 3))


def shaded(count, noise_of, seed=6):
    rng = np.random.default_rng(seed)
    albedo_hw = 0.3 + 0.5 * rng.random((SIDE, SIDE))
    lights_i3 = lamps(count, seed, least=0.4)
    lit_ihw = albedo_hw * np.maximum(np.einsum("hwa,ia->ihw", bumps(), lights_i3), 0.0)
    return np.clip(lit_ihw + noise_of * rng.standard_normal(lit_ihw.shape), 0.0, 1.0), albedo_hw, lights_i3


@pytest.mark.parametrize("count", [6, 16, 60])
@pytest.mark.parametrize("smooth", [False, True])
def test_noise_is_no_object(count, smooth):
    samples_ip = noise(count, smooth).reshape(count, -1)
    assert are_sums_of_three(samples_ip) is False
    normals_p3, albedo_p = bumps().reshape(-1, 3), np.full(SIDE * SIDE, 0.5)
    found = lights_from_normals(samples_ip, normals_p3, albedo_p)
    assert not shade_explains(samples_ip, normals_p3, found.lights_i3, albedo_p)


@pytest.mark.parametrize("count", [4, 6, 40])
@pytest.mark.parametrize("noise_of", [0.0, 0.1])
def test_an_object_under_lamps_is_one_though_it_is_noisy(count, noise_of):
    samples_ihw, albedo_hw, lights_i3 = shaded(count, noise_of)
    samples_ip = samples_ihw.reshape(count, -1)
    assert are_sums_of_three(samples_ip) is True
    assert shade_explains(samples_ip, bumps().reshape(-1, 3), lights_i3, albedo_hw.ravel())


def test_one_lamp_is_told_by_known_albedo_alone():
    """Six photographs of one lamp are sums of one picture: nothing stands out, but shading explains them."""
    samples_ihw, albedo_hw, lights_i3 = shaded(1, 0.0)
    samples_ip = np.repeat(samples_ihw.reshape(1, -1), 6, axis=0)
    samples_ip = samples_ip + 0.01 * np.random.default_rng(0).standard_normal(samples_ip.shape)
    assert are_sums_of_three(samples_ip) is False
    assert are_sums_of_three(samples_ip[:3]) is None
    assert shade_explains(samples_ip, bumps().reshape(-1, 3), np.repeat(lights_i3, 6, axis=0), albedo_hw.ravel())


@pytest.mark.parametrize("normals", [False, True])
def test_the_command_refuses_noise(tmp_path, normals):
    stack = cr.LightStack(np.float32(noise(8, True))[..., None], lamps(8, 1), 1.0)
    cr.write_stack(tmp_path / "noise.h5", stack)
    write_image(tmp_path / "n.exr", bumps().astype(np.float32))
    words = ["find-lights", tmp_path / "noise.h5", tmp_path / "l.lp", "--by", "object", "--csv", tmp_path / "l.csv"]
    before = contents(tmp_path)
    ended = call(*words, *(["--normals", tmp_path / "n.exr"] if normals else []))
    assert (ended.code, ended.out, len(ended.err.splitlines())) == (2, "", 1)
    assert "they look like noise" in ended.err
    assert contents(tmp_path) == before
