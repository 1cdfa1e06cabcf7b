"""The pictures that results keep of a fit: one light's image, or of a surface two renderings side by side.

As in the paper's figures 5, 6, 9, 10, 13 and 14: functions of the light under an environment (left) and under one
directional light (right), functions of the view from two sides.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.experiment.scenes import PICTURE_LIGHT, Survey, shrink_picture
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.memory import PIECE_BYTES
from clrelight.relight import relight, to_display
from clrelight.sampling import make_pattern, solid_angle_weights
from clrelight.surface import Surface
from clrelight.transfer.cameras import frame_surface
from clrelight.transfer.rays import RayScene
from clrelight.transfer.views import look
from datasets_synth.studio import studio_radiance

SIDE = 256
"""Width and height of each of the two renderings."""

LIT_FROM = (0.35, -1.0, 0.85)
VIEWED_FROM = (-0.45, -1.0, 0.2), (1.0, -0.6, 0.3)
"""From the middle of a surface to the eye: of functions of the light, and of the view."""

_ENVIRONMENT_LIGHTS = 600
_BRIGHT = 0.9
"""Of full scale: what all but the brightest vertices stay below in the reference under the environment."""
_NEIGHBOURS = 3

Evaluation = Callable[[NDArray[np.float64], slice], NDArray[np.float64]]
"""Values (vertex, direction, channel) of some vertices' functions at directions (direction, 3), or (vertex, 1, 3)."""


class Portrait(Protocol):
    """What makes pictures of a fit, all of one kind."""

    reference: NDArray[np.uint8]

    def draw(self, coefficients: CoefficientMap) -> NDArray[np.uint8]:
        """Return the picture of a fit."""
        ...


def portrait_of(stack: LightStack, survey: Survey, device: Device) -> Portrait:
    """Return what makes pictures of fits to a stack."""
    return LightPortrait(stack, survey, device) if stack.surface is None else SurfacePortrait(stack, stack.surface)


class LightPortrait:
    """The image under one of the stack's lights, beside the photograph."""

    def __init__(self, stack: LightStack, survey: Survey, device: Device) -> None:
        self._device, self._transfer, self.reference = device, stack.transfer, survey.picture_hwc
        self._towards_13 = stack.directions_i3[survey.light : survey.light + 1]

    def draw(self, coefficients: CoefficientMap) -> NDArray[np.uint8]:
        """Return the picture of a fit."""
        return shrink_picture(
            to_display(relight(coefficients, self._towards_13, device=self._device)[0], self._transfer)
        )


class SurfacePortrait:
    """Two renderings of a surface, beside those from the samples themselves.

    The samples are summed over the environment with their solid angles, and interpolated between the nearest three
    directions where one direction is asked for.
    """

    def __init__(self, stack: LightStack, surface: Surface) -> None:
        self.surface = surface
        self._frames_v33 = surface.frames()
        scene = RayScene(surface)
        places = (LIT_FROM, LIT_FROM) if surface.argument == "light" else VIEWED_FROM
        cameras = [frame_surface(surface, place) for place in places]
        self._views = [look(scene, camera, SIDE) for camera in cameras]
        if surface.argument == "light":
            light_3 = PICTURE_LIGHT / np.linalg.norm(PICTURE_LIGHT)
            self._towards = [self._in_frames(np.broadcast_to(light_3, (surface.n_vertex, 3)))]
        else:
            self._towards = [self._in_frames(camera.towards(surface.vertices_v3)) for camera in cameras]
        self._exposure = 1.0
        samples_iv = np.asarray(stack.images_ihwc[...]).reshape(stack.n_light, surface.n_vertex, -1)
        weights_i = stack.weights_i
        if weights_i is None:
            weights_i = solid_angle_weights(stack.directions_i3, sphere=self._is_whole)
        sampled = _Samples(samples_iv, stack.directions_i3, stack.peak)
        values = self._values(sampled.at, lambda: self._under_environment(sampled.directions_i3, weights_i, sampled.at))
        if surface.argument == "light":
            brightest = float(np.percentile(values[0].max(axis=1), 99.0))
            self._exposure = _BRIGHT / brightest if brightest > 0.0 else 1.0
            values[0] *= self._exposure
        self.reference = self._render(values)

    @property
    def _is_whole(self) -> bool:
        """Whether directions are all over the sphere: in the axes of the positions, half of them are below a vertex."""
        return self.surface.tangents_v3 is None

    def draw(self, coefficients: CoefficientMap) -> NDArray[np.uint8]:
        """Return the picture of a fit: dot products with each vertex's light (eq. 5), or its function at a place."""
        degree, n_vertex = coefficients.degree, self.surface.n_vertex
        coeffs_kvc = np.asarray(coefficients.coeffs_khwc).reshape(coefficients.n_coeff, n_vertex, -1)

        def evaluate(directions: NDArray[np.float64], part: slice) -> NDArray[np.float64]:
            basis = evaluate_basis(directions.reshape(-1, 3), degree).reshape(*directions.shape[:-1], -1)
            return np.einsum("v...k,kvc->v...c", basis, coeffs_kvc[:, part])

        def environment() -> NDArray[np.float64]:
            light_kvc = self._light_of(degree)
            return np.einsum("kvc,kvc->vc", np.broadcast_to(coeffs_kvc, light_kvc.shape), light_kvc)

        values = self._values(evaluate, environment)
        if self.surface.argument == "light":
            values[0] *= self._exposure
        return self._render(values)

    def _values(
        self, evaluate: Evaluation, environment: Callable[[], NDArray[np.float64]]
    ) -> list[NDArray[np.float64]]:
        """Return what each of the two renderings shows at the vertices, (vertex, channel)."""
        shown = []
        for towards_v3 in self._towards:
            parts = [evaluate(towards_v3[part, None], part)[:, 0] for part in self._parts(1 << 12)]
            value_vc = np.concatenate(parts)
            shown.append(value_vc if self._is_whole else np.where(towards_v3[:, 2:] > 0.0, value_vc, 0.0))
        return [environment(), *shown] if self.surface.argument == "light" else shown

    def _render(self, values: list[NDArray[np.float64]]) -> NDArray[np.uint8]:
        halves = [
            view.interpolate(np.maximum(value_vc, 0.0)) for view, value_vc in zip(self._views, values, strict=True)
        ]
        channel = max(half.shape[2] for half in halves)
        whole = np.concatenate([np.broadcast_to(half, (*half.shape[:2], channel)) for half in halves], axis=1)
        return to_display(whole, "srgb")

    @functools.lru_cache(maxsize=2)  # noqa: B019 the portrait lives as long as its scene is measured
    def _light_of(self, degree: int) -> NDArray[np.float64]:
        """Return the coefficients of the environment in each vertex's frame, those of its hemisphere alone (eq. 4)."""
        directions_d3 = make_pattern("uniform", _ENVIRONMENT_LIGHTS, sphere=self._is_whole)
        weight = (4.0 if self._is_whole else 2.0) * math.pi / len(directions_d3)
        basis_dk = weight / math.pi * evaluate_basis(directions_d3, degree)
        light_kvc = np.empty((coefficient_count(degree), self.surface.n_vertex, 3))
        for part in self._parts(len(directions_d3) * 24):
            light_kvc[:, part] = np.einsum("vdc,dk->kvc", self._radiance(directions_d3, part), basis_dk, optimize=True)
        return light_kvc

    def _under_environment(
        self, directions_i3: NDArray[np.float64], weights_i: NDArray[np.float64], evaluate: Evaluation
    ) -> NDArray[np.float64]:
        sums = []
        for part in self._parts(len(directions_i3) * 48):
            radiance_vic = self._radiance(directions_i3, part) * (weights_i / math.pi)[:, None]
            sums.append(
                np.einsum(
                    "vic,vic->vc", np.broadcast_to(evaluate(directions_i3, part), radiance_vic.shape), radiance_vic
                )
            )
        return np.concatenate(sums)

    def _radiance(self, directions_d3: NDArray[np.float64], part: slice) -> NDArray[np.float64]:
        """Return what light comes to some vertices from directions in their frames, (vertex, direction, 3)."""
        world_vd3 = directions_d3 @ self._frames_v33[part]
        return studio_radiance(world_vd3.reshape(-1, 3)).reshape(world_vd3.shape)

    def _in_frames(self, vectors_v3: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.einsum("vab,vb->va", self._frames_v33, vectors_v3)

    def _parts(self, bytes_each: int) -> list[slice]:
        step = max(1, PIECE_BYTES // bytes_each)
        return [slice(first, first + step) for first in range(0, self.surface.n_vertex, step)]


class _Samples:
    """A stack's samples as functions: exact at their directions, and between the nearest few elsewhere."""

    def __init__(self, samples_ivc: NDArray, directions_i3: NDArray[np.float64], peak: float) -> None:
        self._samples_ivc, self.directions_i3, self._peak = samples_ivc, directions_i3, peak

    def at(self, directions: NDArray[np.float64], part: slice) -> NDArray[np.float64]:
        """See `Evaluation`; directions that all vertices share are the samples' own."""
        values_ivc = self._samples_ivc[:, part]
        if directions.ndim == 2:
            return np.moveaxis(values_ivc, 0, 1) / self._peak
        apart_vi = np.maximum(1.0 - directions[:, 0] @ self.directions_i3.T, 1e-9)  # half the squared distance
        count = min(_NEIGHBOURS, len(self.directions_i3))
        near_vn = np.argpartition(apart_vi, count - 1, axis=1)[:, :count]
        weights_vn = 1.0 / np.take_along_axis(apart_vi, near_vn, axis=1)
        weights_vn /= weights_vn.sum(axis=1, keepdims=True)
        picked_vnc = values_ivc[near_vn, np.arange(len(near_vn))[:, None]]
        return np.einsum("vn,vnc->vc", weights_vn, picked_vnc)[:, None] / self._peak
