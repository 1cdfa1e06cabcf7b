"""Photographs of spheres on a table, rendered by themselves in float64: nothing here is of the package."""

import numpy as np
from scipy import ndimage

SAMPLES = 4
"""Of a pixel's side."""


def lamps(count, seed, least=0.1):
    """Return unit vectors above the horizon, z at least `least`."""
    rng = np.random.default_rng(seed)
    z_i, azimuth_i = rng.uniform(least, 1.0, count), rng.uniform(0.0, 2.0 * np.pi, count)
    across_i = np.sqrt(1.0 - z_i**2)
    return np.stack([across_i * np.cos(azimuth_i), across_i * np.sin(azimuth_i), z_i], axis=1)


def fine_grid(height, width):
    """Return x and y of the samples of all pixels; the centre of the first pixel is (0, 0)."""
    y = (np.arange(height * SAMPLES) + 0.5) / SAMPLES - 0.5
    x = (np.arange(width * SAMPLES) + 0.5) / SAMPLES - 0.5
    return np.meshgrid(x, y)


def see_sphere(x_hw, y_hw, x, y, radius, focal=None, size=None):
    """Return unit normals, unit vectors to the eye and where the sphere is.

    With a focal length the sphere has radius 1 and its centre is where (x, y) is seen, at the distance focal / radius.
    """
    if focal is None:
        u_hw, v_hw = (x_hw - x) / radius, (y - y_hw) / radius
        depth_hw = 1.0 - u_hw**2 - v_hw**2
        normals = np.stack([u_hw, v_hw, np.sqrt(np.maximum(depth_hw, 0.0))], axis=-1)
        return normals, np.broadcast_to([0.0, 0.0, 1.0], normals.shape), depth_hw > 0.0
    height, width = size
    middle_x, middle_y, far = (width - 1) / 2.0, (height - 1) / 2.0, focal / radius
    rays = np.stack([x_hw - middle_x, middle_y - y_hw, np.full(x_hw.shape, -focal)], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    centre = far * np.array([(x - middle_x) / focal, (middle_y - y) / focal, -1.0])
    along = rays @ centre
    inside = along**2 - centre @ centre + 1.0
    points = (along - np.sqrt(np.maximum(inside, 0.0)))[..., None] * rays
    return points - centre, -rays, inside > 0.0


def mirrored_lamp(normals, eyes, light, degrees, floor=0.95):
    """Return a round lamp, so many degrees across, in a mirror: as chrome shows it."""
    rays = 2.0 * np.sum(normals * eyes, axis=-1, keepdims=True) * normals - eyes
    return 6.0 * floor * (rays @ light > np.cos(np.radians(0.5 * degrees)))


def phong(normals, eyes, light, exponent):
    """Return Phong's lobe around the mirrored ray, as plastic."""
    rays = 2.0 * np.sum(normals * eyes, axis=-1, keepdims=True) * normals - eyes
    return 1.5 * np.maximum(rays @ light, 0.0) ** exponent * (normals @ light > 0.0)


def beckmann(normals, eyes, light, roughness):
    """Return Beckmann's lobe with Cook and Torrance's shadowing and Schlick's Fresnel term."""
    half = eyes + light
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    n_h, v_h, n_v = (
        np.clip(np.sum(a * b, axis=-1), 1e-4, 1.0) for a, b in ((normals, half), (eyes, half), (normals, eyes))
    )
    n_l = np.clip(normals @ light, 0.0, 1.0)
    density = np.exp((n_h**2 - 1.0) / (roughness**2 * n_h**2)) / (np.pi * roughness**2 * n_h**4)
    shadow = np.minimum(1.0, 2.0 * n_h * np.minimum(n_v, n_l) / v_h)
    return density * shadow * (0.05 + 0.95 * (1.0 - v_h) ** 5) / (4.0 * n_v) * (n_l > 0.0)


def blinn(normals, eyes, light, roughness):
    """Return a GGX lobe times Schlick's Fresnel term of glass, without shadowing."""
    half = eyes + light
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    n_h = np.clip(np.sum(normals * half, axis=-1), 0.0, 1.0)
    v_h = np.clip(np.sum(eyes * half, axis=-1), 0.0, 1.0)
    squared = roughness**4
    density = squared / (np.pi * (n_h**2 * (squared - 1.0) + 1.0) ** 2)
    return 0.25 * density * (0.05 + 0.95 * (1.0 - v_h) ** 5) * (normals @ light > 0.0)


def photograph_spheres(
    lights_i3,
    size,
    spheres,
    *,
    roughness=0.2,
    diffuse=0.05,
    room=0.02,
    focal=None,
    texture=0.25,
    seed=0,
    windows=(),
    table=0.0,
    shade=0.0,
    matte=False,
    blur=0.7,
    noise=0.005,
    exposure=1.0,
    gloss=blinn,
    ground=0.35,
):
    """Return photographs in [0, 1], linear, (n_light, height, width), of spheres (x, y, radius) on a rough table.

    windows: directions of lights of the room, which stay on; table: how bright it is in the spheres' lower rim, moving
    with the lamp; shade: share of each sphere that something darkens from the left, in all photographs; gloss: what the
    sphere's highlights are like, of `roughness`; ground: how bright the table is.
    """
    rng, (height, width) = np.random.default_rng(seed), size
    x_hw, y_hw = fine_grid(height, width)
    cells = rng.random((height // 7 + 2, width // 9 + 2))
    fine = ndimage.zoom(cells, (7 * SAMPLES, 9 * SAMPLES), order=1)[: height * SAMPLES, : width * SAMPLES]
    grain = ndimage.gaussian_filter(rng.standard_normal(x_hw.shape), SAMPLES)
    ground_hw = np.clip(ground + texture * (2.0 * fine - 1.0) + 0.4 * texture * grain, 0.02, 1.0)
    seen = []
    for x, y, radius in spheres:
        reach = (1.0 if focal is None else 1.5) * radius + 2.0
        rows = slice(max(0, int((y - reach) * SAMPLES)), int((y + reach + 1) * SAMPLES))
        columns = slice(max(0, int((x - reach) * SAMPLES)), int((x + reach + 1) * SAMPLES))
        part = rows, columns
        seen.append((x, radius, part, see_sphere(x_hw[part], y_hw[part], x, y, radius, focal, size)))
    pictures = []
    for light in lights_i3:
        picture_hw = ground_hw * max(light[2], 0.0) + 0.01
        for x, radius, part, (normals, eyes, inside_hw) in seen:
            shown_hw = room + diffuse * np.maximum(normals @ light, 0.0)
            if not matte:
                shown_hw = shown_hw + gloss(normals, eyes, light, roughness)
                for window in windows:
                    shown_hw = shown_hw + 0.5 * blinn(normals, eyes, np.asarray(window), roughness)
                # The rim mirrors the table around, as bright as the lamp makes it.
                shown_hw = shown_hw + table * max(light[2], 0.0) * np.clip(0.45 - normals[..., 2], 0.0, 1.0)
            shown_hw = np.where((x_hw[part] - x) / radius < 2.0 * shade - 1.0, 0.3 * shown_hw, shown_hw)
            picture_hw[part] = np.where(inside_hw, shown_hw, picture_hw[part])
        # The lens blurs, then a pixel takes the mean of its square.
        blurred_hw = ndimage.gaussian_filter(exposure * picture_hw, blur * SAMPLES, truncate=4.0)
        sharp_hw = blurred_hw.reshape(height, SAMPLES, width, SAMPLES).mean(axis=(1, 3))
        pictures.append(np.clip(sharp_hw + noise * rng.standard_normal(sharp_hw.shape), 0.0, 1.0))
    return np.array(pictures)


def srgb_codes(linear):
    """Return 8-bit sRGB codes, (n_light, height, width, 3)."""
    coded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.repeat(np.rint(255.0 * coded).astype(np.uint8)[..., None], 3, axis=-1)
