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

from clrelight.conventions import srgb_to_linear
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.experiment.scenes import PICTURE_LIGHT, Survey, shrink_picture
from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.index import coefficient_count
from clrelight.memory import PIECE_BYTES
from clrelight.relight import relight, to_display
from clrelight.surface import Surface
from clrelight.transfer.cameras import frame_surface
from clrelight.transfer.rays import RayScene
from clrelight.transfer.views import look
from datasets_synth.studio import studio_lights

SIDE = 256
"""Width and height of each of the two renderings."""

LIT_FROM = (0.35, -1.0, 0.85)
VIEWED_FROM = (-0.45, -1.0, 0.2), (1.0, -0.6, 0.3)
"""From the middle of a surface to the eye: of functions of the light, and of the view."""

_BRIGHT = 0.9
"""Of full scale: what all but the brightest vertices stay below in the reference under the environment."""
_NEIGHBOURS = 7

Evaluation = Callable[[NDArray[np.float64], slice], NDArray[np.float64]]
"""Values (vertex, channel) of some vertices' functions, each at one direction in its frame (vertex, 3)."""


class Portrait(Protocol):
    """What makes pictures of a fit, all of one kind."""

    reference: NDArray[np.uint8]

    def draw(self, coefficients: CoefficientMap, behind: str = "linear") -> NDArray[np.uint8]:
        """Return the picture of a fit; `behind` is that of `clrelight.metrics.measure_errors`."""
        ...


def portrait_of(stack: LightStack, survey: Survey, device: Device) -> Portrait:
    """Return what makes pictures of fits to a stack."""
    return LightPortrait(stack, survey, device) if stack.surface is None else SurfacePortrait(stack, stack.surface)


class LightPortrait:
    """The image under one of the stack's lights, beside the photograph."""

    def __init__(self, stack: LightStack, survey: Survey, device: Device) -> None:
        self._device, self._transfer, self.reference = device, stack.transfer, survey.picture_hwc
        self._towards_13 = stack.directions_i3[survey.light : survey.light + 1]

    def draw(self, coefficients: CoefficientMap, behind: str = "linear") -> NDArray[np.uint8]:
        """Return the picture of a fit."""
        relit_hwc = relight(coefficients, self._towards_13, device=self._device)[0]
        radiance_hwc = srgb_to_linear(relit_hwc, np.float32) if behind == "srgb" else relit_hwc
        return shrink_picture(to_display(radiance_hwc, self._transfer))


class SurfacePortrait:
    """Two renderings of a surface, beside those from the samples themselves.

    Those are interpolated between the nearest directions; the environment is the studio of the sculpture.
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
            self._towards = [self._in_frames(light_3)]
        else:
            self._towards = [self._in_frames(camera.towards(surface.vertices_v3)) for camera in cameras]
        self._environment = studio_lights()
        self._exposure = 1.0
        samples_ivc = np.asarray(stack.images_ihwc[...]).reshape(stack.n_light, surface.n_vertex, -1)
        values = self._values(_Samples(samples_ivc, stack.directions_i3, stack.peak).at)
        if surface.argument == "light":
            brightest = float(np.percentile(values[0].max(axis=1), 99.0))
            self._exposure = _BRIGHT / brightest if brightest > 0.0 else 1.0
            values[0] *= self._exposure
        self.reference = self._render(values)

    @property
    def _is_whole(self) -> bool:
        """Whether directions are all over the sphere: in the axes of the positions, half of them are below a vertex."""
        return self.surface.tangents_v3 is None

    def draw(self, coefficients: CoefficientMap, behind: str = "linear") -> NDArray[np.uint8]:
        """Return the picture of a fit, of radiance: dot products with each vertex's light, or its function at a place.

        By noise-resistant-fitting, eq. 5.
        """
        degree, n_vertex = coefficients.degree, self.surface.n_vertex
        coeffs_kvc = np.asarray(coefficients.coeffs_khwc).reshape(coefficients.n_coeff, n_vertex, -1)

        def evaluate(towards_v3: NDArray[np.float64], part: slice) -> NDArray[np.float64]:
            return np.einsum("vk,kvc->vc", evaluate_basis(towards_v3, degree), coeffs_kvc[:, part])

        values = self._values(evaluate, lambda: self._dot(coeffs_kvc, degree))
        if self.surface.argument == "light":
            values[0] *= self._exposure
        return self._render(values)

    def _values(
        self, evaluate: Evaluation, environment: Callable[[], NDArray[np.float64]] | None = None
    ) -> list[NDArray[np.float64]]:
        """Return what each of the two renderings shows at the vertices, (vertex, channel)."""
        shown = [self._looked_up(evaluate, towards_v3) for towards_v3 in self._towards]
        if self.surface.argument != "light":
            return shown
        if environment is not None:
            return [environment(), *shown]
        light = self._environment
        total_vc = np.zeros((self.surface.n_vertex, 3))
        for direction_3, irradiance_c in zip(light.directions_l3, light.irradiance_lc, strict=True):
            total_vc += self._looked_up(evaluate, self._in_frames(direction_3)) * (irradiance_c / math.pi)
        return [total_vc, *shown]

    def _looked_up(self, evaluate: Evaluation, towards_v3: NDArray[np.float64]) -> NDArray[np.float64]:
        value_vc = np.concatenate([evaluate(towards_v3[part], part) for part in self._parts(1 << 12)])
        return value_vc if self._is_whole else np.where(towards_v3[:, 2:] > 0.0, value_vc, 0.0)

    def _dot(self, coeffs_kvc: NDArray, degree: int) -> NDArray[np.float64]:
        """Return the dot products of each vertex's coefficients with its own light's (eq. 5), (vertex, 3)."""
        light_kvc = self._light_of(degree)
        return np.einsum("kvc,kvc->vc", np.broadcast_to(coeffs_kvc, light_kvc.shape), light_kvc)

    @functools.lru_cache(maxsize=1)  # noqa: B019 the portrait lives as long as its scene is measured
    def _light_of(self, degree: int) -> NDArray[np.float64]:
        """Return the coefficients of the environment in each vertex's frame, of its hemisphere alone (eq. 4)."""
        light = self._environment
        light_kvc = np.zeros((coefficient_count(degree), self.surface.n_vertex, 3))
        for direction_3, irradiance_c in zip(light.directions_l3, light.irradiance_lc, strict=True):
            towards_v3 = self._in_frames(direction_3)
            basis_vk = evaluate_basis(towards_v3, degree)
            if not self._is_whole:
                basis_vk *= towards_v3[:, 2:] > 0.0
            light_kvc += basis_vk.T[..., None] * (irradiance_c / math.pi)
        return light_kvc

    def _render(self, values: list[NDArray[np.float64]]) -> NDArray[np.uint8]:
        shown = zip(self._views, values, strict=True)
        halves = [view.interpolate(np.maximum(value_vc, 0.0)) for view, value_vc in shown]
        channel = max(half.shape[2] for half in halves)
        whole = np.concatenate([np.broadcast_to(half, (*half.shape[:2], channel)) for half in halves], axis=1)
        return to_display(whole, "srgb")

    def _in_frames(self, vectors_v3: NDArray[np.float64]) -> NDArray[np.float64]:
        vectors_v3 = np.broadcast_to(vectors_v3, (self.surface.n_vertex, 3))
        return np.einsum("vab,vb->va", self._frames_v33, vectors_v3)

    def _parts(self, bytes_each: int) -> list[slice]:
        step = max(1, PIECE_BYTES // bytes_each)
        return [slice(first, first + step) for first in range(0, self.surface.n_vertex, step)]


class _Samples:
    """A stack's samples as functions, smooth between the nearest few (Franke and Little's weights)."""

    def __init__(self, samples_ivc: NDArray, directions_i3: NDArray[np.float64], peak: float) -> None:
        self._samples_ivc, self._directions_i3, self._peak = samples_ivc, directions_i3, peak

    def at(self, towards_v3: NDArray[np.float64], part: slice) -> NDArray[np.float64]:
        """See `Evaluation`."""
        apart_vi = np.sqrt(np.maximum(2.0 - 2.0 * towards_v3 @ self._directions_i3.T, 1e-12))
        last = min(_NEIGHBOURS, len(self._directions_i3) - 1)
        near_vn = np.argpartition(apart_vi, last, axis=1)[:, : last + 1]
        apart_vn = np.take_along_axis(apart_vi, near_vn, axis=1)
        reach_v1 = 1.0001 * apart_vn.max(axis=1, keepdims=True)
        weights_vn = ((reach_v1 - apart_vn) / (reach_v1 * apart_vn)) ** 2
        weights_vn /= weights_vn.sum(axis=1, keepdims=True)
        picked_vnc = self._samples_ivc[near_vn, np.arange(part.start, part.start + len(near_vn))[:, None]]
        return np.einsum("vn,vnc->vc", weights_vn, picked_vnc) / self._peak
