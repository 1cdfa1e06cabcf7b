"""Photographs of glossy balls on a table of which everything is drawn at random, for `benchmarks.random_spheres`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from benchmarks.variation import through_jpeg
from tests.reference.spheres import beckmann, blinn, mirrored_lamp, phong, see_sphere

Array = NDArray[np.float64]
_CUT, _COLOURED, _FILLED, _ROOMED, _JPEG, _NEAR, _TWO = 0.12, 0.3, 0.2, 0.25, 0.4, 0.15, 0.12
"""Shares of scenes: cut off, coloured, with fill lamps, with windows, JPEG files, by a near camera, of two balls."""
_GOLDEN = 2.399963


@dataclass
class Scene:
    """A scene, as `draw_scene` draws it; lengths in pixels, brightness in the linear range."""

    size: tuple[int, int]
    spheres: list[tuple[float, float, float]]
    lights_i3: Array
    gloss: str
    width: float
    shine: float
    diffuse: float
    room: float
    lamp: float
    fill: tuple[float, float] | None
    windows: Array
    ground: float
    texture: float
    pattern: str
    glow: float
    colours_23: Array
    exposure: float
    blur: float
    noise: float
    jpeg: int | None
    transfer: str
    focal: float | None
    seed: int


def draw_scene(seed: int) -> Scene:
    """Return a scene of its seed alone."""
    rng = np.random.default_rng([16, seed])
    radius = float(np.exp(rng.uniform(np.log(12.0), np.log(200.0 if rng.random() < 0.2 else 70.0))))
    around = rng.uniform(2.6, 2.9) if radius > 110 else rng.uniform(3.0, 4.5)
    height = int(max(90, around * radius))
    size = height, int(height * rng.uniform(1.0, 1.4))
    is_near = rng.random() < _NEAR
    spheres = [_place(rng, size, radius, rng.random() < _CUT and not is_near)]
    if rng.random() < _TWO and radius < 60:
        size = size[0], size[1] + int(3.0 * radius)
        spheres.append(
            (size[1] - 1.35 * radius, float(rng.uniform(1.3 * radius, size[0] - 1.3 * radius)), 0.9 * radius)
        )
    count = int(rng.integers(8, 19))
    cosine_i, azimuth_i = rng.uniform(np.cos(np.radians(80.0)), 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    if rng.random() < 0.3:  # a dome's rings
        cosine_i, azimuth_i = (
            np.sin(np.radians(rng.choice([15.0, 35.0, 55.0, 75.0], count))),
            np.arange(count) * _GOLDEN,
        )
    sine_i = np.sqrt(1.0 - cosine_i**2)
    lights_i3 = np.stack([sine_i * np.cos(azimuth_i), sine_i * np.sin(azimuth_i), cosine_i], axis=1)
    gloss = str(rng.choice(["blinn", "beckmann", "phong", "chrome"], p=[0.4, 0.25, 0.15, 0.2]))
    is_chrome = gloss == "chrome"
    windows = rng.standard_normal((int(rng.integers(1, 4)) if rng.random() < _ROOMED else 0, 3))
    windows[:, 2] = np.abs(windows[:, 2]) + 0.3
    is_coloured = rng.random() < _COLOURED
    return Scene(
        size, spheres, lights_i3, gloss,
        width=float(np.exp(rng.uniform(np.log(0.06), np.log(0.35)))),
        shine=float(np.exp(rng.uniform(np.log(0.3), np.log(6.0)))),
        diffuse=0.0 if is_chrome else float(rng.uniform(0.0, 0.4)),
        room=float(rng.uniform(0.0, 0.1)),
        lamp=float(rng.uniform(1.0 if is_chrome else 0.0, 5.0)),
        fill=(float(rng.uniform(0.7, 2.5)), float(rng.uniform(0.1, 0.6))) if rng.random() < _FILLED else None,
        windows=windows / np.linalg.norm(windows, axis=1, keepdims=True),
        ground=float(np.exp(rng.uniform(np.log(0.04), np.log(1.1)))),
        texture=float(rng.choice([0.0, rng.uniform(0.02, 0.3), rng.uniform(0.3, 0.7)])),
        pattern=str(rng.choice(["patches", "boards", "stripes", "grain"])),
        glow=float(rng.uniform(0.0, 0.9 if is_chrome else 0.4)),
        colours_23=rng.uniform(0.3, 1.0, (2, 3)) if is_coloured else np.ones((2, 3)),
        exposure=float(np.exp(rng.uniform(np.log(0.15), np.log(1.4)))),
        blur=float(rng.uniform(0.4, 0.9 if radius < 20 else 2.0)),
        noise=float(np.exp(rng.uniform(np.log(0.001), np.log(0.02)))),
        jpeg=int(rng.integers(60, 97)) if rng.random() < _JPEG else None,
        transfer=str(rng.choice(["srgb", "srgb", "linear"])),
        focal=float(rng.uniform(1.5, 6.0)) * size[1] if is_near else None,
        seed=seed,
    )  # fmt: skip


def _place(rng: np.random.Generator, size: tuple[int, int], radius: float, is_cut: bool) -> tuple[float, float, float]:
    reach = 1.06 * radius + 2.0
    y, x = (float(rng.uniform(reach, max(side - reach, reach + 1.0))) for side in size)
    if is_cut:  # up to three tenths of the radius are beyond the edge
        x = (
            float(rng.uniform(0.7, 1.0)) * radius
            if rng.random() < 0.5
            else size[1] - float(rng.uniform(0.7, 1.0)) * radius
        )
    return x, y, radius


def photograph(scene: Scene) -> NDArray[np.uint8]:
    """Return a scene's photographs, 8-bit codes (n_light, height, width, 3)."""
    rng, (height, width) = np.random.default_rng([17, scene.seed]), scene.size
    fine = int(np.clip(np.ceil(90.0 / scene.spheres[0][2]), 2, 6))
    x_hw, y_hw = np.meshgrid(*((np.arange(side * fine) + 0.5) / fine - 0.5 for side in (width, height)))
    ground_hw = _ground(rng, scene, x_hw, y_hw, fine)
    seen = []
    for x, y, radius in scene.spheres:
        reach = (1.02 if scene.focal is None else 1.4) * radius + 2.0
        part = tuple(slice(max(0, int((at - reach) * fine)), max(0, int((at + reach + 1) * fine))) for at in (y, x))
        seen.append((part, see_sphere(x_hw[part], y_hw[part], x, y, radius, scene.focal, scene.size)))
    codes = []
    for light_3 in scene.lights_i3:
        lamps = _lamps(scene, light_3)
        table_hw = np.full(x_hw.shape, scene.room * 0.5)
        for source_3, strength in [(light_3, 1.0)] + lamps[-1:] * (scene.fill is not None):
            table_hw += strength * max(source_3[2], 0.0) * _unshaded(scene, x_hw, y_hw, source_3)
        table_hw *= ground_hw
        shine_hw = np.zeros(x_hw.shape)
        shade_hw = table_hw
        for part, (normals, eyes, inside_hw) in seen:
            matte_hw, mirror_hw = _ball(scene, normals, eyes, light_3, lamps)
            shade_hw[part] = np.where(inside_hw, matte_hw, shade_hw[part])
            shine_hw[part] = np.where(inside_hw, mirror_hw, shine_hw[part])
        ball_hw = np.zeros(x_hw.shape, bool)
        for part, (_, _, inside_hw) in seen:
            ball_hw[part] |= inside_hw
        codes.append(_expose(rng, scene, shade_hw, shine_hw, ball_hw, fine))
    codes_ihwc = np.stack(codes)
    return codes_ihwc if scene.jpeg is None else through_jpeg(codes_ihwc, scene.jpeg)


def _ground(rng: np.random.Generator, scene: Scene, x_hw: Array, y_hw: Array, fine: int) -> Array:
    turn, pitch = rng.uniform(0.0, np.pi), rng.uniform(5.0, 30.0)
    along_hw = (x_hw * np.cos(turn) + y_hw * np.sin(turn)) / pitch
    across_hw = (y_hw * np.cos(turn) - x_hw * np.sin(turn)) / pitch
    if scene.pattern == "boards":
        shape_hw = np.sign(np.sin(np.pi * along_hw) * np.sin(np.pi * across_hw))
    elif scene.pattern == "stripes":
        shape_hw = np.sin(np.pi * along_hw)
    else:
        cell = 1 if scene.pattern == "grain" else int(rng.integers(4, 12))
        cells = rng.uniform(-1.0, 1.0, tuple(-(-side // cell) + 2 for side in scene.size))
        shape_hw = ndimage.zoom(cells, cell * fine, order=1)[: x_hw.shape[0], : x_hw.shape[1]]
    return np.maximum(scene.ground * (1.0 + scene.texture * shape_hw), 0.0)


def _lamps(scene: Scene, light_3: Array) -> list[tuple[Array, float]]:
    """Return points of the lamp, and the fill lamp, with their strengths."""
    points = [(light_3, 1.0)]
    if scene.lamp > 1.0 and scene.gloss != "chrome":
        side_3 = np.cross(light_3, [0.3, 1.0, 0.2])
        side_3 /= np.linalg.norm(side_3)
        up_3, half = np.cross(light_3, side_3), np.tan(np.radians(0.5 * scene.lamp))
        count = 6 if 2.0 * np.degrees(scene.width**2) > scene.lamp else 18
        pairs = np.arange(count // 2)  # opposite each other, so that their mean is the lamp's middle
        turns, away = 0.5 * _GOLDEN * pairs, half * np.sqrt((pairs + 0.5) / len(pairs))
        offs = (away * np.cos(turns))[:, None] * side_3 + (away * np.sin(turns))[:, None] * up_3
        discs = light_3 + np.concatenate([offs, -offs])
        points = [(each / np.linalg.norm(each), 1.0 / count) for each in discs]
    if scene.fill is not None:  # all turned alike, 39 to 51 degrees high
        turn, strength = scene.fill
        cosine, sine = np.cos(turn), np.sin(turn)
        fill_3 = np.array([cosine * light_3[0] - sine * light_3[1], sine * light_3[0] + cosine * light_3[1], 0.8])
        points.append((fill_3 / np.linalg.norm(fill_3), strength))
    return points


def _unshaded(scene: Scene, x_hw: Array, y_hw: Array, light_3: Array) -> Array:
    """Return where the ground, which balls touch, is not in their shadow."""
    lit_hw = np.ones(x_hw.shape)
    for x, y, radius in scene.spheres:
        right_hw, up_hw = (x_hw - x) / radius, (y - y_hw) / radius
        along_hw = right_hw * light_3[0] + up_hw * light_3[1] - light_3[2]
        off_hw = right_hw**2 + up_hw**2 + 1.0 - along_hw**2
        lit_hw[(off_hw < 1.0) & (along_hw < 0.0)] = 0.0
    return lit_hw


def _ball(
    scene: Scene, normals: Array, eyes: Array, light_3: Array, lamps: list[tuple[Array, float]]
) -> tuple[Array, Array]:
    """Return what is matte of a ball and what it mirrors: lamps, windows that stay, the lit ground below."""
    grazing = 1.0 - np.clip(np.sum(normals * eyes, axis=-1), 0.0, 1.0)
    rays = 2.0 * np.sum(normals * eyes, axis=-1, keepdims=True) * normals - eyes
    below = np.clip(-3.0 * rays[..., 2], 0.0, 1.0)
    mirror = scene.ground * max(light_3[2], 0.0) * scene.glow * (0.3 + 0.7 * grazing**3) * below
    matte = scene.room + scene.diffuse * np.maximum(normals @ light_3, 0.0)
    for window_3 in scene.windows:
        mirror = mirror + 0.3 * scene.shine * _lobe(scene, normals, eyes, window_3)
    for source_3, strength in lamps:
        mirror = mirror + strength * scene.shine * _lobe(scene, normals, eyes, source_3)
    return matte, mirror


def _lobe(scene: Scene, normals: Array, eyes: Array, light_3: Array) -> Array:
    """Return a lobe whose top is 1 or so where the light is high."""
    if scene.gloss == "chrome":
        return mirrored_lamp(normals, eyes, light_3, scene.lamp, 1.0 / 6.0)
    radius = scene.spheres[0][2]
    width = max(scene.width**2, 0.35 / radius)  # what samples can show
    if scene.gloss == "phong":
        return phong(normals, eyes, light_3, 0.5 / width**2) / 1.5
    if scene.gloss == "beckmann":
        return beckmann(normals, eyes, light_3, width) * 240.0 * np.pi * width**2
    return blinn(normals, eyes, light_3, np.sqrt(width)) * width**2 * 240.0


def _expose(
    rng: np.random.Generator, scene: Scene, shade_hw: Array, shine_hw: Array, ball_hw: Array, fine: int
) -> NDArray[np.uint8]:
    is_grey = bool(np.all(scene.colours_23 == 1.0))
    channels = []
    bright = scene.exposure / max(scene.ground, scene.room + scene.diffuse, 0.1)  # as one exposes for what is there
    for c in range(1 if is_grey else 3):
        ball, table = scene.colours_23[:, c]
        picture_hw = bright * (shade_hw * np.where(ball_hw, ball, table) + shine_hw)
        blurred_hw = ndimage.gaussian_filter(picture_hw, scene.blur * fine, truncate=3.5)
        height, width = scene.size
        linear_hw = blurred_hw.reshape(height, fine, width, fine).mean(axis=(1, 3))
        linear_hw = np.clip(linear_hw + scene.noise * rng.standard_normal(linear_hw.shape), 0.0, 1.0)
        if scene.transfer == "srgb":
            low_hw, high_hw = 12.92 * linear_hw, 1.055 * np.maximum(linear_hw, 1e-9) ** (1 / 2.4) - 0.055
            linear_hw = np.where(linear_hw <= 0.0031308, low_hw, high_hw)
        channels.append(np.rint(255.0 * linear_hw).astype(np.uint8))
    return np.stack(channels * 3 if is_grey else channels, axis=-1)
