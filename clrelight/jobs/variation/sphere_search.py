"""Where spheres are in photographs: circles that edges vote for, and that are lit as spheres are."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.jobs.report import Progress, stage
from clrelight.jobs.variation.light_doubts import RIVAL
from clrelight.jobs.variation.light_frames import Frames
from clrelight.jobs.variation.sphere_lights import (
    LEAST_OUTLINE,
    outlined,
    outlined_by_all,
    pictures_of,
    shaded_lights,
    window_of,
)
from clrelight.jobs.variation.sphere_rims import rim_of
from clrelight.variation.circles import Circle, find_circles
from clrelight.variation.highlights import find_highlights
from clrelight.variation.spheres import view_sphere

_SIDE, _MOST_LOOKED_AT = 640, 96
"""Pixels of the longer side, and photographs, in which spheres are looked for."""
_LEAST_RADIUS, _MOST_RADIUS = 6.0, 0.48
"""Of a sphere that is looked for, in those pixels, and as a share of the shorter side."""
_CANDIDATES, _SAME = 10, 0.3
"""Circles that are tried; pixels of place and radius within which two have come to the same."""
_LEAST_SCORE, _LEAST_TRIED, _CLEAR = 0.35, 0.1, 0.95
"""What a sphere scores at least; what a circle does whose outline is looked for in single photographs, and the share of
it beyond which that is of no use."""
_COMPACT, _WITH_RIVAL, _UNEXPLAINED, _UNSURE = 25.0, 0.6, 0.25, 0.6
"""Degrees of spread of a highlight; what counts less: one with a rival, lights that shade nothing else, a circle that
the photographs do not tell to be a sphere's outline, where there is another."""
_LEAST_TOLD, _SCENE_PIXELS = 8, 4000


def look_for_spheres(frames: Frames, count: int, is_matte: bool, progress: Progress | None) -> list[Circle]:
    """Return the circles of the spheres in photographs, the surest first.

    Circles are voted for by edges of the mean, the spread and the brightest of all photographs; a glossy sphere is one
    with a small highlight in each photograph, in changing places, a matte one is shaded as a sphere is.

    Raises
    ------
    InputError
        If fewer than `count` are found.
    """
    height, width = frames.shape_hw
    factor = max(1, -(-max(height, width) // _SIDE))
    n_light = len(frames.names)
    lights = np.unique(np.linspace(0, n_light - 1, min(n_light, _MOST_LOOKED_AT)).round().astype(int)).tolist()
    with stage(progress, "looking for spheres") as tell:
        samples_ihw = frames.take((0, 0, width, height), factor, lights, tell)
    pictures = pictures_of(samples_ihw)
    radii = _LEAST_RADIUS, _MOST_RADIUS * min(samples_ihw.shape[1:])
    if radii[1] <= radii[0]:
        raise InputError(f"photographs of {width}×{height} pixels are too small for a sphere to be found in them")
    with stage(progress, "trying circles") as tell:
        scored = _score(samples_ihw, pictures, find_circles(pictures, radii, _CANDIDATES), is_matte, tell)
    scored.sort(key=lambda each: each[0], reverse=True)
    kept: list[Circle] = []
    for score, circle in scored:
        apart = all(np.hypot(circle.x - o.x, circle.y - o.y) > 0.7 * max(circle.radius, o.radius) for o in kept)
        if score >= _LEAST_SCORE and apart and len(kept) < count:
            kept.append(circle)
    if len(kept) < count:
        found = f"only {len(kept)} of {count} spheres are" if kept else "no sphere is"
        hint = "" if is_matte else ", --kind matte if it does not shine"
        others = [score for score, each in scored if each not in kept and score < _LEAST_SCORE]
        best = (
            f" (the best {'other ' * bool(kept)}candidate scores {others[0]:.2f} of {_LEAST_SCORE:g})" if others else ""
        )
        raise InputError(f"{found} found in the photographs{best}: say where with --sphere X,Y,RADIUS{hint}")
    return [circle.scaled(factor) for circle in kept]


def _score(
    samples_ihw: NDArray[np.float32],
    pictures: Sequence[NDArray[np.floating]],
    starts: Sequence[Circle],
    is_matte: bool,
    tell: Callable[[int, int], object],
) -> list[tuple[float, Circle]]:
    """Return the outlines that circles lead to, and how much they look like those of spheres."""
    judge = _matte_share if is_matte else _highlight_share
    scored: list[tuple[float, Circle]] = []
    tried: list[Circle] = []
    for count, start in enumerate(starts, 1):
        circle, _ = outlined(pictures, start)
        is_new = all(np.hypot(circle.x - o.x, circle.y - o.y) + abs(circle.radius - o.radius) > _SAME for o in tried)
        tried.append(circle)
        if circle.outline >= LEAST_OUTLINE and is_new:
            score = circle.outline * judge(samples_ihw, circle)
            if score > _LEAST_TRIED and circle.outline < _CLEAR:
                part_ihw, inner, corner = _cut(samples_ihw, circle)
                circle = outlined_by_all(part_ihw, inner)[0].scaled(1.0, *corner)
                score = circle.outline * judge(samples_ihw, circle)
            scored.append((score, circle))
        tell(count, len(starts))
    good = [each for score, each in scored if score >= _LEAST_SCORE]
    if not is_matte and any(np.hypot(each.x - good[0].x, each.y - good[0].y) > 1.0 for each in good):
        # What is out anyway is not looked at: an outline takes longer than all else.
        weights = [
            1.0 if score < _LEAST_SCORE or _is_outlined(samples_ihw, each) else _UNSURE for score, each in scored
        ]
        scored = [(score * weight, each) for weight, (score, each) in zip(weights, scored, strict=True)]
    return scored


def _highlight_share(samples_ihw: NDArray[np.float32], circle: Circle) -> float:
    """Return the share of photographs with one small highlight, less where it does not move or tells false lights."""
    part_ihw, inner, corner = _cut(samples_ihw, circle)
    sphere = view_sphere(circle, samples_ihw.shape[1:])
    found = find_highlights(part_ihw, inner, sphere, 1.0, corner)
    told = [i for i, each in enumerate(found) if each is not None and each.spread < _COMPACT]
    sound = [each for i, each in enumerate(found) if each is not None and i in told]
    if not sound:
        return 0.0
    places = np.array([(each.x, each.y) for each in sound])
    moved = float(np.hypot(*places.std(axis=0)) / circle.radius) if len(samples_ihw) > 1 else 1.0
    # A fill lamp leaves a second highlight on a sphere; many things that are none have several.
    share = sum(1.0 if each.rival < RIVAL else _WITH_RIVAL for each in sound) / len(samples_ihw) * min(1.0, moved / 0.1)
    explained = _explained(samples_ihw[told], np.array([each.light_3 for each in sound]))
    return share * (_UNEXPLAINED + (1.0 - _UNEXPLAINED) * explained)


def _is_outlined(samples_ihw: NDArray[np.float32], circle: Circle) -> bool:
    part_ihw, inner, corner = _cut(samples_ihw, circle)
    return rim_of(part_ihw, inner, view_sphere(circle, samples_ihw.shape[1:]), 1.0, corner) is not None


def _explained(samples_ihw: NDArray[np.float32], lights_i3: NDArray[np.float64]) -> float:
    """Return how much of what the whole view changes by goes with lights, as a matte scene's shading does: 0 to 1.

    Coins and buttons are round and shine too, but what is taken for their lights shades nothing else.
    """
    if len(lights_i3) < _LEAST_TOLD:
        return 1.0
    step = max(1, samples_ihw[0].size // _SCENE_PIXELS)
    series_ip = samples_ihw.reshape(len(samples_ihw), -1)[:, ::step].astype(np.float64)
    moved_ip = series_ip - series_ip.mean(axis=0)
    towards_i3 = lights_i3 - lights_i3.mean(axis=0)
    left_ip = moved_ip - towards_i3 @ np.linalg.lstsq(towards_i3, moved_ip, rcond=None)[0]
    energy = float(np.sum(moved_ip**2))
    return 1.0 - float(np.sum(left_ip**2)) / energy if energy > 0.0 else 1.0


def _matte_share(samples_ihw: NDArray[np.float32], circle: Circle) -> float:
    """Return how much of the brightness inside a circle is a matte sphere's, of one albedo."""
    part_ihw, inner, corner = _cut(samples_ihw, circle)
    lights = shaded_lights(part_ihw, inner, view_sphere(circle, samples_ihw.shape[1:]), 1.0, corner)
    return float(np.mean((1.0 - np.minimum(4.0 * lights.residual_i, 1.0)) * (lights.lit_i > 0.1)))


def _cut(samples_ihw: NDArray[np.float32], circle: Circle) -> tuple[NDArray[np.float32], Circle, tuple[int, int]]:
    x, y, width, height = window_of(circle, samples_ihw.shape[1:])
    inner = Circle(circle.x - x, circle.y - y, circle.radius, circle.outline, circle.off)
    return samples_ihw[:, y : y + height, x : x + width], inner, (x, y)
