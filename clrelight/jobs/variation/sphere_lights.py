"""Lamps by spheres whose places are known: their outlines, and the highlight on each, or its shading."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from clrelight.errors import InputError
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.variation.light_doubts import CLIPPED, doubts
from clrelight.jobs.variation.light_frames import Frames
from clrelight.jobs.variation.sphere_rims import inner_circle, rim_of, seen_by_rim, uncertainty
from clrelight.variation.circles import Circle, refine_circle
from clrelight.variation.highlights import Highlight, find_highlights
from clrelight.variation.shading import ShadingLights, lights_from_normals
from clrelight.variation.spheres import SphereView, view_sphere

_AROUND = 1.35
"""What is read around a sphere, of its radius."""
_SHARP_RADIUS = 250.0
"""Pixels of the radius that are enough: then a pixel is worth a quarter of a degree."""
_SAMPLE_BYTES, _PIXEL_BYTES = 24, 150
"""What finding highlights holds of each photograph's pixels, and of those of the view."""
LEAST_OUTLINE, _MEAN_SHARE, _WHOLE = 0.5, 0.75, 0.95
_SINGLE = 8
"""Photographs that are looked at one by one, at most."""
_INSIDE = 0.97
"""Share of a matte sphere's radius within which its shading counts."""


@dataclass(frozen=True)
class SphereLights:
    """What one sphere tells.

    Attributes
    ----------
    circle : Circle
        In pixels of the photographs.
    lights_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors to the lamps; 0 where it does not tell.
    highlights : tuple of Highlight or None
        Of a glossy sphere.
    residual_i : ndarray, shape (n_light,), float64
        Of a glossy sphere degrees that its highlight is wide, of a matte one what it is off the law.
    degrees_a_pixel_i : ndarray, shape (n_light,), float64
    uncertain_i : ndarray, shape (n_light,), float64
        Degrees, one standard deviation, that outline and highlight leave a lamp; NaN where they do not tell how much.
    doubts : tuple of str
        Why a lamp is not to be trusted; "" without a reason.
    """

    circle: Circle
    lights_i3: NDArray[np.float64]
    highlights: tuple[Highlight | None, ...]
    residual_i: NDArray[np.float64]
    degrees_a_pixel_i: NDArray[np.float64]
    uncertain_i: NDArray[np.float64]
    doubts: tuple[str, ...]


def pictures_of(samples_ihw: NDArray[np.float32]) -> list[NDArray[np.floating]]:
    """Return the mean, what is odd of each pixel, how odd that is, the spread and the brightest of some photographs.

    Odd is what goes with the lamp otherwise than most pixels do: a table's texture, however strong, is not, a sphere
    is. It is what is left of a pixel's samples off the median of all, each of length 1; how odd, the angle to that.
    """
    energy_hw = np.einsum("ihw,ihw->hw", samples_ihw, samples_ihw)
    length_hw = np.sqrt(energy_hw) + 1e-6
    usual_i = np.median((samples_ihw / length_hw).reshape(len(samples_ihw), -1), axis=1)
    usual_i /= max(float(np.linalg.norm(usual_i)), 1e-12)
    along_hw = np.einsum("i,ihw->hw", usual_i, samples_ihw)
    odd_hw = np.sqrt(np.maximum(energy_hw - along_hw**2, 0.0))
    angle_hw = np.arccos(np.clip(along_hw / length_hw, -1.0, 1.0))
    return [samples_ihw.mean(axis=0), odd_hw, angle_hw, samples_ihw.std(axis=0), samples_ihw.max(axis=0)]


def outlined(pictures: Sequence[NDArray[np.floating]], start: Circle) -> tuple[Circle, NDArray[np.float64]]:
    """Return the circle by the picture that shows it best without moving it.

    The mean over the photographs keeps an edge of the sphere where it is, and so does what is odd of pixels: where the
    edge runs through a pixel, both are mixtures. The others, which are none, find what these do not.
    """
    tried = [refine_circle([picture_hw], start) for picture_hw in pictures]
    best = max(tried, key=lambda each: each[0].outline)
    mean, odd = refine_circle(pictures[:1], best[0]), refine_circle(pictures[1:2], best[0])
    if odd[0].outline >= _WHOLE and mean[0].outline < _WHOLE * odd[0].outline:
        return odd
    return mean if mean[0].outline >= _MEAN_SHARE * best[0].outline else best


def outlined_by_all(samples_ihw: NDArray[np.float32], start: Circle) -> tuple[Circle, NDArray[np.float64]]:
    """Return `outlined`, by the photographs one by one where no picture of all shows most of the outline.

    A ball casts its shadow on what it lies on: an edge beside it, elsewhere in each photograph, that pictures of all
    mix with the outline, which stays.
    """
    circle, points_n2 = outlined(pictures_of(samples_ihw), start)
    if not LEAST_OUTLINE <= circle.outline < _WHOLE:
        return circle, points_n2
    step = -(-len(samples_ihw) // _SINGLE)
    found, found_n2 = refine_circle(list(samples_ihw[::step]), circle)
    # Edges of many photographs leave no gap, so how much of the outline is seen is the pictures' to tell.
    return (replace(found, outline=circle.outline), found_n2) if found.outline > circle.outline else (circle, points_n2)


def window_of(circle: Circle, shape_hw: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return column, row, width and height of what is read around a sphere."""
    reach = _AROUND * circle.radius + 2.0
    left, top = max(0, int(circle.x - reach)), max(0, int(circle.y - reach))
    right, bottom = min(shape_hw[1], int(circle.x + reach) + 2), min(shape_hw[0], int(circle.y + reach) + 2)
    return left, top, right - left, bottom - top


def lights_of_sphere(
    frames: Frames,
    start: Circle,
    is_given: bool,
    is_matte: bool,
    focal: float | None,
    budget: int,
    progress: Progress | None,
    report: Report,
) -> SphereLights:
    """Return the lamps that one sphere tells of, at the resolution that the memory and the sphere ask for.

    A circle that is given is moved onto the outline, if there is one within a tenth of the radius; else taken as it is.
    """
    since = time.perf_counter()
    height, width = frames.shape_hw
    window = window_of(start, (height, width)) if start.radius <= height + width else (0, 0, 0, 0)
    if window[2] < 8 or window[3] < 8:
        raise InputError(
            f"sphere {start.x:g},{start.y:g},{start.radius:g} lies outside the photographs, {width}×{height}"
        )
    bytes_all = float(_SAMPLE_BYTES * len(frames.names) + _PIXEL_BYTES) * window[2] * window[3]
    factor = max(1, int(start.radius // _SHARP_RADIUS), int(np.ceil(np.sqrt(bytes_all / budget))))
    with stage(progress, "reading spheres") as tell:
        part_ihw = frames.take(window, factor, None, tell)
    since = report.add("read", since)
    corner = window[0], window[1]
    inside = inner_circle(start, factor, corner)
    refined, outline_n2 = outlined_by_all(part_ihw, inside)
    away = np.hypot(refined.x - inside.x, refined.y - inside.y) + abs(refined.radius - inside.radius)
    if refined.outline < LEAST_OUTLINE or (is_given and away > 0.1 * inside.radius):
        if is_given:
            report.note(f"no outline is seen at sphere {start.x:g},{start.y:g},{start.radius:g}: it is taken as it is")
        refined, outline_n2 = replace(inside, outline=0.0), np.zeros((0, 2))
    circle = refined.scaled(factor, *corner)
    outline_n2 = (outline_n2 + 0.5) * factor - 0.5 + np.array(corner)
    sphere = view_sphere(circle, (height, width), focal, outline_n2)
    rim = None if is_matte or not len(outline_n2) else rim_of(part_ihw, refined, sphere, factor, corner)
    if rim is not None:
        sphere = seen_by_rim(rim, sphere, (height, width), factor, corner)
        circle, refined = sphere.circle, inner_circle(sphere.circle, factor, corner)
    highlights: tuple[Highlight | None, ...] = ()
    if is_matte:
        refined = _settle(part_ihw, refined)
        circle = refined.scaled(factor, *corner)
        sphere = view_sphere(circle, (height, width), focal, None)
        lights_i3, residual_i = _matte_lights(part_ihw, refined, sphere, factor, corner)
    else:
        with stage(progress, "finding highlights"):
            blur = None if rim is None else rim.blur
            found = find_highlights(part_ihw, refined, sphere, factor, corner, frames.most(), blur)
        lights_i3 = np.array([np.zeros(3) if each is None else each.light_3 for each in found])
        highlights = tuple(found)
        residual_i = np.array([np.nan if each is None else each.spread for each in found])
    report.add("highlights" if not is_matte else "shading", since)
    worth_i = np.array([sphere.degrees_a_pixel(light_3) for light_3 in lights_i3])
    uncertain_i = uncertainty(sphere, highlights, worth_i, rim, factor)
    clipped_i = _clipped(part_ihw, refined, frames.most())
    if highlights and not any(highlights) and np.median(clipped_i) > CLIPPED:
        report.note(
            f"sphere {circle.x:.1f},{circle.y:.1f} is over-exposed in most photographs: no highlight shows there"
        )
    told = doubts(highlights, lights_i3, uncertain_i, rim is not None, clipped_i)
    return SphereLights(circle, lights_i3, highlights, residual_i, worth_i, uncertain_i, told)


def _clipped(part_ihw: NDArray[np.float32], circle: Circle, most: float) -> NDArray[np.float64]:
    """Return how much of a disc is at the end of the range, of each photograph; 0 where it is beside the picture."""
    over_ip = part_ihw[:, _disc(part_ihw.shape[1:], circle)] >= most
    return np.asarray(over_ip.sum(axis=1) / max(1, over_ip.shape[1]))


def _matte_lights(
    part_ihw: NDArray[np.float32], inner: Circle, sphere: SphereView, factor: float, corner: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return unit vectors to lamps and what is off the law; InputError where the disc is not shaded as a sphere is."""
    shaded = shaded_lights(part_ihw, inner, sphere, factor, corner)
    if not _is_shaded(part_ihw, shaded.lights_i3, inner, sphere, factor, corner):
        at = sphere.circle
        raise InputError(
            f"sphere {at.x:.1f},{at.y:.1f},{at.radius:.1f} is not shaded as a matte sphere is: one brightness all over "
            "explains it better than lamps do; say where it is, keep other light away, or leave out --kind matte if it "
            "shines"
        )
    length_i = np.linalg.norm(shaded.lights_i3, axis=1, keepdims=True)
    return np.where(length_i > 0.0, shaded.lights_i3 / np.maximum(length_i, 1e-12), 0.0), shaded.residual_i


def shaded_lights(
    part_ihw: NDArray[np.float32], inner: Circle, sphere: SphereView, factor: float, corner: tuple[int, int]
) -> ShadingLights:
    """Return the lamps of a matte sphere of one albedo in a part of the photographs."""
    samples_ip, normals_p3 = _of_disc(part_ihw, inner, sphere, factor, corner, 20_000)
    seen_p = normals_p3.any(axis=1)
    # One albedo all over: what a ball is painted with.
    return lights_from_normals(samples_ip[:, seen_p], normals_p3[seen_p], np.ones(int(seen_p.sum())))


def _of_disc(
    part_ihw: NDArray[np.float32],
    inner: Circle,
    sphere: SphereView,
    factor: float,
    corner: tuple[int, int],
    most: int | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return samples (n_light, pixel) of a disc, about `most` of them, and the normals there, 0 off the sphere."""
    y_p, x_p = np.nonzero(_disc(part_ihw.shape[1:], inner))
    step = 1 if most is None else max(1, len(y_p) // most)
    y_p, x_p = y_p[::step], x_p[::step]
    normals_p3 = sphere.normals((x_p + 0.5) * factor - 0.5 + corner[0], (y_p + 0.5) * factor - 0.5 + corner[1])
    return part_ihw[:, y_p, x_p], normals_p3


def _is_shaded(
    part_ihw: NDArray[np.float32],
    lights_i3: NDArray[np.float64],
    inner: Circle,
    sphere: SphereView,
    factor: float,
    corner: tuple[int, int],
) -> bool:
    """Return whether lamps explain a disc's brightness better than one brightness does, in most photographs."""
    found_ip, normals_p3 = _of_disc(part_ihw, inner, sphere, factor, corner)
    samples_ip = found_ip.astype(np.float64)
    left_i = np.sum((samples_ip - np.maximum(lights_i3 @ normals_p3.T, 0.0)) ** 2, axis=1)
    flat_i = np.sum((samples_ip - samples_ip.mean(axis=1, keepdims=True)) ** 2, axis=1)
    return bool(np.median(left_i / np.maximum(flat_i, 1e-30)) < 1.0)


def _settle(part_ihw: NDArray[np.float32], start: Circle) -> Circle:
    """Return the circle whose sphere explains the shading best: that of a matte one fades towards its outline."""
    y_p, x_p = np.nonzero(_disc(part_ihw.shape[1:], replace(start, radius=0.92 * start.radius)))
    step, stride = max(1, len(y_p) // 1500), max(1, len(part_ihw) // 16)
    y_p, x_p = y_p[::step], x_p[::step]
    samples_ip = part_ihw[::stride, y_p, x_p].astype(np.float64)
    lit_ip = samples_ip > 0.1 * np.quantile(samples_ip, 0.95, axis=1, keepdims=True)
    energy = float(np.sum(samples_ip[lit_ip] ** 2))
    if energy == 0.0:  # all black
        return start

    def off(parameters: NDArray[np.float64]) -> float:
        x, y, radius = parameters
        u_p, v_p = (x_p - x) / radius, (y - y_p) / radius
        normals_p3 = np.stack([u_p, v_p, np.sqrt(np.maximum(1.0 - u_p**2 - v_p**2, 0.0))], axis=1)
        left = 0.0
        for each_p, lit_p in zip(samples_ip, lit_ip, strict=True):
            found = np.linalg.lstsq(normals_p3[lit_p], each_p[lit_p], rcond=None)[0]
            left += float(np.sum((normals_p3[lit_p] @ found - each_p[lit_p]) ** 2))
        return left / energy

    begin = np.array([start.x, start.y, start.radius])
    simplex = begin + 0.04 * start.radius * np.concatenate([np.zeros((1, 3)), np.eye(3)])
    found = optimize.minimize(off, begin, method="Nelder-Mead", options={"initial_simplex": simplex, "maxiter": 80})
    x, y, radius = (float(each) for each in found.x)
    near = np.hypot(x - start.x, y - start.y) + abs(radius - start.radius) < 0.15 * start.radius
    return replace(start, x=x, y=y, radius=radius) if near else start


def _disc(shape_hw: tuple[int, int], circle: Circle) -> NDArray[np.bool_]:
    y_hw, x_hw = np.ogrid[: shape_hw[0], : shape_hw[1]]
    inside_hw: NDArray[np.bool_] = np.hypot(x_hw - circle.x, y_hw - circle.y) < _INSIDE * circle.radius
    return inside_hw
