"""Figures with surfaces: 1 and 4 of irradiance-environment-maps, 6 to 15 of spherical-harmonic-lighting."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.harmonics.product import transfer_matrix
from clrelight.harmonics.quadrature import product_rule
from clrelight.jobs.report import Report
from clrelight.jobs.surface.transfer import transfer
from clrelight.lighting.environment import Environment
from clrelight.lighting.irradiance import evaluate_irradiance, irradiance_light
from clrelight.lighting.lamps import cap_light, cap_visibility
from clrelight.lighting.light import Light, apply_window
from clrelight.lighting.lookup import look_up
from clrelight.lighting.projection import project_environment
from clrelight.lighting.relighting import map_tones
from clrelight.lighting.sky import sky_light
from clrelight.relight import to_display
from clrelight.reproduction.figure_surfaces import BALL_AT, join, object_scene, plain, table_scene
from clrelight.surface import Surface
from clrelight.transfer.cameras import Camera, frame_surface
from clrelight.transfer.rays import RayScene
from clrelight.transfer.shading import shade_vertices
from clrelight.transfer.sources import DistantLight
from clrelight.transfer.views import look, render_surface

SUN = (30.0, 225.0)
SKIES = ("overcast", "partly-cloudy", "clear")
CAPS = (10.0, 30.0, 60.0, 90.0)
DEGREE = 4
KINDS = ("unshadowed", "shadowed", "interreflected")
GROUND = 0.93
GREEN, BLUE = np.array([0.1, 0.75, 0.15]), np.array([0.15, 0.2, 0.85])


def shown(image_hwc: NDArray, tonemap: str = "clip") -> NDArray[np.uint8]:
    """Return display values of radiance, in three channels."""
    codes = to_display(map_tones(image_hwc.astype(np.float32), tonemap), "srgb")
    return np.repeat(codes, 3, axis=2) if codes.shape[2] == 1 else codes


def strip(panels: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Return pictures side by side."""
    return np.concatenate(panels, axis=1)


def objects(armadillo: Surface, grace: Environment, width: int) -> NDArray[np.uint8]:
    """Return figure 1: a mirror ball, a white ball, the armadillo on a white table, and a pool ball."""
    surface, part_v = table_scene(armadillo)
    height = width * 9 // 16
    camera = Camera((0.0, -9.5, 2.6), (0.0, 0.0, 0.75), field_of_view=25.0)
    view = look(RayScene(surface), camera, (width, height), subsamples=3)
    normals_s3 = view.at_samples(surface.normals_v3)
    normals_s3 /= np.linalg.norm(normals_s3, axis=1, keepdims=True)
    points_s3 = view.at_samples(surface.vertices_v3)
    eye_s3 = camera.towards(points_s3)
    light = project_environment(grace, 2)
    matte_sc = evaluate_irradiance(light, normals_s3) / np.pi
    white = float(np.percentile(matte_sc, 97))
    mirror_s3 = 2.0 * np.einsum("sa,sa->s", eye_s3, normals_s3)[:, None] * normals_s3 - eye_s3
    bright_sc = map_tones(look_up(grace, mirror_s3) / (0.25 * white), "reinhard").astype(np.float64)
    part_s = part_v[view.corners_sj[:, 0]]
    band_s1 = (np.abs(normals_s3 @ np.array([0.3, 0.2, 0.93])) < 0.42)[:, None]
    pool_sc = np.where(band_s1, [0.85, 0.55, 0.06], 0.85) * matte_sc / white + 0.12 * bright_sc
    chosen = [matte_sc / white, bright_sc, pool_sc]  # white things, the mirror, the pool ball
    colour_sc = np.choose(part_s[:, None], chosen)
    behind = camera.rays(*_middles(width, height))[1]
    back_hwc = map_tones(look_up(grace, behind) / (0.25 * white), "reinhard").reshape(height, width, 3)
    return shown(view.average(colour_sc) + (1.0 - view.coverage_hw[..., None]) * back_hwc)


def _middles(width: int, height: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    down, across = 0.5 - (np.arange(height) + 0.5) / height, ((np.arange(width) + 0.5) - 0.5 * width) / height
    y, x = np.meshgrid(down, across, indexing="ij")
    return x.ravel(), y.ravel()


def signed(values_vc: NDArray, scale: float) -> NDArray[np.float64]:
    """Return colours of values: green where they are positive, blue where negative."""
    share = np.clip(values_vc / scale, -1.0, 1.0)
    return np.where(share > 0.0, share * GREEN, -share * BLUE)


def basis(armadillo: Surface, side: int) -> NDArray[np.uint8]:
    """Return figure 4: the nine irradiance basis functions on a ball and on the armadillo from two sides."""
    ball = plain("ball")
    rows = []
    scenes = ((ball, (0.0, -1.0, 0.0)), (armadillo, (0.25, 1.0, 0.15)), (armadillo, (-1.0, 0.5, 0.2)))
    for surface, direction in scenes:
        scene, camera = RayScene(surface), frame_surface(surface, direction)
        view = look(scene, camera, side)
        panels = []
        for k in range(9):
            unit = Light(np.eye(9)[:, k : k + 1].copy())
            values_vc = evaluate_basis(surface.normals_v3, 2) @ irradiance_light(unit)
            panels.append(shown(view.interpolate(signed(values_vc, 1.2)) + (1.0 - view.coverage_hw[..., None])))
        rows.append(strip(panels))
    return np.concatenate(rows)


def lamp_function(directions_n3: NDArray) -> NDArray:
    """Return the two lamps of spherical-harmonic-lighting, section SH Projection."""
    sine = np.sqrt(np.maximum(0.0, 1.0 - directions_n3[:, 2] ** 2))
    across = np.cos(np.arctan2(directions_n3[:, 1], directions_n3[:, 0]) - 2.5)
    second = np.maximum(0.0, 4.0 * sine * across - 3.0)  # -4 sin(theta - pi) = 4 sin(theta)
    return np.maximum(0.0, 5.0 * directions_n3[:, 2] - 4.0) + second


def spherical_plot(
    coefficients_or_values: NDArray, side: int, *, is_values: bool = False, camera: Camera | None = None
) -> NDArray[np.uint8]:
    """Return the picture of a function whose value is the distance from the middle, yellow or blue by its sign."""
    ball = plain("ball", 6)
    value_v = coefficients_or_values
    if not is_values:
        degree = int(np.sqrt(len(value_v))) - 1
        value_v = evaluate_basis(ball.vertices_v3, degree) @ value_v
    radius_v = np.abs(value_v) + 1e-3
    shape = join([(ball.vertices_v3 * radius_v[:, None], ball.faces_f3)])
    camera = camera or Camera((2.6, 3.4, 1.7), (-0.22, 0.22, 0.42), field_of_view=25.0)
    shade_v = 0.35 + 0.65 * np.maximum(0.0, shape.normals_v3 @ np.array([0.62, 0.62, 0.48]))
    colour_vc = np.where(value_v[:, None] > 0.0, [0.85, 0.75, 0.2], [0.2, 0.35, 0.9]) * shade_v[:, None]
    return shown(render_surface(shape, colour_vc, camera, side, background=1.0))


def projections(side: int) -> NDArray[np.uint8]:
    """Return figures 6 to 8: two lamps as they are, and of degrees 1 to 5, 8 and 12."""
    nodes_q3, weights_q = product_rule(60, sphere=True)
    coeffs_k = evaluate_basis(nodes_q3, 12).T @ (weights_q * lamp_function(nodes_q3))
    panels = [spherical_plot(lamp_function(plain("ball", 6).vertices_v3), side, is_values=True)]
    panels += [spherical_plot(coeffs_k[: coefficient_count(degree)], side) for degree in (1, 2, 3, 5, 8, 12)]
    return strip(panels)


def products(side: int) -> NDArray[np.uint8]:
    """Return figures 9 and 10: where the matrix of a shadow is not 0, a light, and the light in that shadow."""
    shadow_k = cap_visibility((0.0, 0.0, 1.0), 40.0, 6)
    matrix = np.abs(transfer_matrix(shadow_k, 3))
    cell = -(-side // 16)
    dots = np.repeat(np.repeat(np.clip(matrix / matrix.max(), 0, 1) ** 0.4 * (matrix > 1e-10), cell, 0), cell, 1)
    shown_matrix = (255 * (1.0 - dots[..., None] * [1.0, 0.75, 0.2])).astype(np.uint8)
    nodes_q3, weights_q = product_rule(60, sphere=True)
    light_k = evaluate_basis(nodes_q3, 3).T @ (weights_q * lamp_function(nodes_q3))
    side = len(shown_matrix)
    return strip(
        [shown_matrix, spherical_plot(light_k, side), spherical_plot(transfer_matrix(shadow_k, 3) @ light_k, side)]
    )


@functools.cache
def object_maps(samples: int) -> dict[str, CoefficientMap]:
    """Return the transfer functions of figures 11, 13 and 15's scene, of degree 4."""
    surface, _ = object_scene()
    return {kind: _transfer(surface, kind, DEGREE, samples) for kind in KINDS}


def _transfer(surface: Surface, kind: str, degree: int, samples: int) -> CoefficientMap:
    return cast("CoefficientMap", transfer(surface, kind=kind, degree=degree, samples=samples, report=Report()))


def transfers(side: int, samples: int) -> dict[str, NDArray[np.uint8]]:
    """Return figures 11, 13 and 15: a scene under a white hemisphere, unshadowed, shadowed and interreflected.

    And figure 14: the functions of a place that looks down at the floor, for red: alone, what comes by way of others,
    and their sum.
    """
    surface, camera = object_scene()
    light = cap_light((0.0, 0.0, 1.0), 90.0, DEGREE)
    maps = object_maps(samples)
    panels = []
    for made in maps.values():
        radiance_vc = shade_vertices(made, [DistantLight(light)])
        panels.append(shown(render_surface(surface, radiance_vc, camera, (side, side * 3 // 4), background=GROUND)))
    ball_v = np.linalg.norm(surface.vertices_v3 - BALL_AT, axis=1) < 1.0
    vertex = int(np.argmax(np.where(ball_v, surface.normals_v3 @ np.array([-0.5, -0.3, -0.8]), -2.0)))
    alone_k, all_k = (maps[kind].coeffs_khwc[:, vertex, 0, 0].astype(np.float64) for kind in KINDS[1:])
    ball_v3 = plain("ball", 6).vertices_v3
    largest = float(np.abs(evaluate_basis(ball_v3, DEGREE) @ all_k).max())
    near = Camera((2.6, 3.4, 1.7), (-0.25, -0.2, -0.35), field_of_view=26.0)
    shown_k = (alone_k, all_k - alone_k, all_k)
    functions = [spherical_plot(each_k / largest, side * 2 // 5, camera=near) for each_k in shown_k]
    return {"transfer": strip(panels), "bounce": strip(functions)}


def lights(side: int, samples: int) -> NDArray[np.uint8]:
    """Return a gray ball and a torus under the skies and caps of four sizes: balls above, tori below."""
    lamps = [sky_light(sky, *SUN, degree=6) for sky in SKIES]
    lamps += [cap_light((0.45, -0.55, 0.7), angle, 6) for angle in CAPS]
    rows = []
    for shape in ("ball", "torus"):
        surface = replace(plain(shape), albedo_vc=np.full((plain(shape).n_vertex, 1), 0.5, np.float32))
        made = _transfer(surface, "shadowed", 6, samples)
        view = look(RayScene(surface), frame_surface(surface, (0.5, -2.0, 1.2)), side)
        panels = []
        for lamp in lamps:
            image_hwc = view.interpolate(shade_vertices(made, [DistantLight(apply_window(lamp, "hann", 9.0))]))
            white = float(np.percentile(image_hwc[view.coverage_hw == 1.0], 99)) / 0.75
            panels.append(shown(image_hwc / white + (1.0 - view.coverage_hw[..., None])))
        rows.append(strip(panels))
    return np.concatenate(rows)
