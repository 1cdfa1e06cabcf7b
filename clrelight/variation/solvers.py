"""Normals of a block of pixels by each method, on a device or in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.variation.kernel import NormalSolver
from clrelight.variation.near_lights import NearLights, places
from clrelight.variation.normals import PixelNormals, find_normals
from clrelight.variation.reflectance import Law, fit_law, view_vectors
from clrelight.variation.reflectance_kernel import LANES, LawSolver
from clrelight.variation.samples import SampleReader, in_range
from clrelight.variation.wanted import Found


class BlockSolver:
    """What turns samples of pixels into their normals.

    Parameters
    ----------
    stack : LightStack
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors to the lights; of near ones, from the middle.
    near : NearLights, optional
    heights_hw : ndarray, shape (height, width), float32
        Heights of pixels in pixels, which matter under near lights.
    method : str
        ``"robust"``, ``"quick"`` or ``"least-squares"``.
    found : Found
    device : Device, optional
    """

    def __init__(
        self,
        stack: LightStack,
        directions_i3: NDArray[np.float64],
        near: NearLights | None,
        heights_hw: NDArray[np.float32],
        method: str,
        found: Found,
        device: Device | None,
    ) -> None:
        self._stack, self._directions_i3, self._near, self._heights_hw = stack, directions_i3, near, heights_hw
        self._method, self._found, self._device = method, found, device
        self._law = found.law or Law()
        self.reader = SampleReader(stack, found.transfer, found.gains_ic)
        self._law_solver = self._quick_solver = None
        if device is not None and method == "robust":
            lights_i3 = directions_i3 if near is None else near.positions_i3
            self._law_solver = LawSolver(device, lights_i3, self._law, floor=found.floor, near=near is not None)
        if device is not None and method == "quick":
            self._quick_solver = NormalSolver(device, directions_i3, found.floor)

    def __call__(self, samples_cip: NDArray[np.float32], which: slice | NDArray[np.intp], first: int) -> PixelNormals:
        """Return the normals of pixels, and of a few more.

        Parameters
        ----------
        samples_cip : ndarray, shape (channel, n_light, P), float32
            As of `SampleReader.linear`.
        which : slice or ndarray of int
            Which pixels they are, counted from `first` along rows.
        first : int
        """
        width = self._stack.image_shape[1]
        count = samples_cip.shape[2]
        needs_places = self._near is not None or (self._method == "robust" and self._law.field > 0.0)
        if needs_places or self._method == "robust":
            index_p = np.arange(which.start, which.stop) if isinstance(which, slice) else which
            rows_p, columns_p = np.divmod(index_p + first, width)
        place_3p, falloff_ip = None, None
        if self._near is not None:
            place_3p = places(rows_p, columns_p, self._heights_hw)
            falloff_ip = self._near.falloff(place_3p)
        if self._method == "least-squares":
            even_cip, most = self.reader.scaled(samples_cip, falloff_ip), np.inf
        else:
            even_cip, most = self.reader.even(samples_cip, falloff_ip)
        is_bounded = self.reader.is_bounded and falloff_ip is None
        even_cip, exponent = (even_cip, 0) if is_bounded else in_range(even_cip)
        most = float(np.ldexp(most, -exponent))
        if self._method == "robust":
            view_p3 = view_vectors(rows_p, columns_p, self._stack.image_shape[:2], self._law.field)
            solved = self._robust(even_cip, view_p3, place_3p, most)
        elif place_3p is not None and self._near is not None:
            solved = plain_near(even_cip, self._near.towards(place_3p))
        elif self._quick_solver is not None:
            solved = self._quick_solver(_padded(even_cip), most)
        else:
            clipped_ip: NDArray[np.bool_] = np.any(even_cip >= most, axis=0)
            solved = find_normals(even_cip, self._directions_i3, self._method, clipped_ip, self._found.floor)
        solved = PixelNormals(solved.normals_p3[:count], solved.albedo_pc[:count], solved.confidence_p[:count])
        if not exponent:
            return solved
        return PixelNormals(solved.normals_p3, np.ldexp(solved.albedo_pc, exponent), solved.confidence_p)

    def _robust(
        self,
        samples_cip: NDArray[np.float32],
        view_p3: NDArray[np.float32],
        place_3p: NDArray[np.float32] | None,
        most: float,
    ) -> PixelNormals:
        if self._law_solver is None:
            lights: NDArray[np.floating] = self._directions_i3
            if place_3p is not None and self._near is not None:
                lights = self._near.towards(place_3p)
            return fit_law(samples_cip, lights, view_p3, self._law, most=most, floor=self._found.floor).found
        view_3q = _padded(np.ascontiguousarray(view_p3.T))
        place_3q = None if place_3p is None else _padded(place_3p)
        return self._law_solver(_padded(samples_cip), view_3q, most, place_3q).found


def _padded(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return an array whose last axis is a multiple of the lanes of a work-item."""
    padding = -values.shape[-1] % LANES
    if not padding:
        return values
    return np.pad(values, [(0, 0)] * (values.ndim - 1) + [(0, padding)], mode="edge")


def plain_near(samples_cip: NDArray[np.float32], towards_ip3: NDArray[np.float32]) -> PixelNormals:
    """Return least squares of all samples, where each pixel has its own directions to the lights.

    Parameters
    ----------
    samples_cip : ndarray, shape (channel, n_light, P), float32
        Linear radiance times the squared distance.
    towards_ip3 : ndarray, shape (n_light, P, 3), float32
        Unit vectors.
    """
    energy_p33 = np.einsum("ipa,ipb->pab", towards_ip3, towards_ip3, optimize=True).astype(np.float64)
    right_pac = np.einsum("ipa,cip->pac", towards_ip3, samples_cip, optimize=True)
    scaled_pac = np.linalg.solve(energy_p33, right_pac)
    scaled_p3: NDArray[np.float64] = scaled_pac.mean(axis=2)
    length_p = np.linalg.norm(scaled_p3, axis=1)
    unit_p3 = scaled_p3 / np.maximum(length_p, 1e-12)[:, None]
    normals_p3 = np.where(length_p[:, None] > 1e-12, unit_p3, 0.0)
    shade_ip: NDArray[np.floating] = np.maximum(np.einsum("ipa,pa->ip", towards_ip3, normals_p3), 0.0)
    whole_p = np.maximum(np.sum(shade_ip**2, axis=0), 1e-12)
    albedo_pc = np.maximum(np.einsum("ip,cip->pc", shade_ip, samples_cip) / whole_p[:, None], 0.0)
    residual_ip = np.abs(samples_cip.mean(axis=0) - shade_ip * length_p) / np.maximum(length_p, 1e-12)
    confidence_p = np.where(length_p > 1e-12, 1.0 - 2.0 * np.minimum(residual_ip, 0.5).mean(axis=0), 0.0)
    return PixelNormals(*(each.astype(np.float32) for each in (normals_p3, albedo_pc, confidence_p)))
