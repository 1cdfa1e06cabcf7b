"""Whose photograph it is, whatever the light: the distance to the pictures that each subject can show.

Illumination variation, 0.4.1 (Basri and Jacobs 2003): pictures of a matte subject lie near the nine of harmonics as
light, and in the cone of those under single lamps. The subject whose pictures are nearest is taken.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.sampling import make_pattern
from clrelight.variation.inverse import MOST_CONDITION, basis_pictures

SPACES = ("3d", "4d", "9d", "cone")
"""Pictures of harmonics of degree 1, of degrees up to 1, up to 2, and of lamps with weights that are not negative."""
RAYS = 100
"""Lamps all around whose pictures stand for the cone's."""
_LEAST_SINGULAR = 1e-6
_RELATIVE = 1e-8
"""Of the products of a cone's rays, below which they are rounding."""


class ConeSolver:
    """What sums of rays with weights that are not negative hold of pictures, from products of rays alone.

    Parameters
    ----------
    products_kk : ndarray, shape (K, K), float64
        Of the rays with each other.
    """

    def __init__(self, products_kk: NDArray[np.float64]) -> None:
        variance_r, vectors_kr = np.linalg.eigh(products_kk)
        kept_r = variance_r > _RELATIVE * max(float(variance_r[-1]), 1e-300)
        root_r = np.sqrt(variance_r[kept_r])
        # |F w - g|^2 with F'F the products and F'g the right side: as small a problem as the rays are many.
        self._factor_rk = root_r[:, None] * vectors_kr[:, kept_r].T
        self._onto_rk = vectors_kr[:, kept_r].T / root_r[:, None]

    def explained(self, right_k: NDArray[np.float64]) -> float:
        """Return the part of a picture's energy that the cone holds, from its products with the rays."""
        target_r = self._onto_rk @ right_k
        off = optimize.nnls(self._factor_rk, target_r, maxiter=30 * len(right_k))[1]
        return float(target_r @ target_r - off**2)


@dataclass(frozen=True)
class Space:
    """Pictures that a subject can show, in each channel by itself: light may be coloured.

    Attributes
    ----------
    basis_ckp : ndarray, shape (channel, K, P), float64
        Orthonormal rows of each channel; 0 where there are fewer. Of a cone its rays.
    cones : tuple of ConeSolver
        Of a cone, one a channel.
    """

    basis_ckp: NDArray[np.float64]
    cones: tuple[ConeSolver, ...] = ()

    @classmethod
    def spanned(cls, pictures_kpc: NDArray[np.floating]) -> Space:
        """Return the space that some pictures span, (K, P, channel)."""
        channels = []
        for channel in range(pictures_kpc.shape[2]):
            pictures_kp = np.asarray(pictures_kpc[:, :, channel], np.float64)
            _, size_r, right_rp = np.linalg.svd(pictures_kp, full_matrices=False)
            kept_r = size_r > _LEAST_SINGULAR * max(float(size_r[0]), 1e-300)
            channels.append(right_rp * kept_r[:, None])
        return cls(np.stack(channels))

    @classmethod
    def cone(cls, pictures_kpc: NDArray[np.floating]) -> Space:
        """Return the cone of some pictures, (K, P, channel)."""
        rays_ckp = np.ascontiguousarray(np.asarray(pictures_kpc, np.float64).transpose(2, 0, 1))
        return cls(rays_ckp, tuple(ConeSolver(rays_kp @ rays_kp.T) for rays_kp in rays_ckp))

    def distance(self, picture_pc: NDArray[np.floating]) -> float:
        """Return how far a picture is off, as a share of its root mean square: 0 within, 1 at a right angle.

        A grey picture of a coloured subject is compared with the mean of its channels' pictures.
        """
        picture_pc = np.asarray(picture_pc, np.float64)
        basis_ckp, energy = self.basis_ckp, float(np.sum(picture_pc**2))
        if not energy > 0.0:
            return 1.0
        channels = picture_pc.shape[1]
        if len(basis_ckp) not in (1, channels):
            raise InputError(f"a picture of {channels} channels, and a subject of {len(basis_ckp)}")
        left = 0.0
        for channel in range(channels):
            basis_kp, seen_p = basis_ckp[min(channel, len(basis_ckp) - 1)], picture_pc[:, channel]
            onto_k = basis_kp @ seen_p
            cone = self.cones[min(channel, len(self.cones) - 1)] if self.cones else None
            held = float(onto_k @ onto_k) if cone is None else cone.explained(onto_k)
            left += max(float(seen_p @ seen_p) - held, 0.0)
        return float(np.sqrt(max(left, 0.0) / energy))


def spaces_of_normals(
    normals_p3: NDArray[np.floating], albedo_pc: NDArray[np.floating], names: tuple[str, ...] = SPACES
) -> dict[str, Space]:
    """Return the spaces of a matte convex subject.

    Parameters
    ----------
    normals_p3 : ndarray, shape (P, 3)
    albedo_pc : ndarray, shape (P, 1 or 3)
    names : tuple of str
        Which of `SPACES`.
    """
    normals_p3, found = np.asarray(normals_p3, np.float64), {}
    basis_kp = evaluate_basis(normals_p3, 2).T
    for name, part in (("3d", slice(1, 4)), ("4d", slice(0, 4)), ("9d", slice(0, 9))):
        if name in names:
            found[name] = Space.spanned(basis_kp[part, :, None] * albedo_pc)
    if "cone" in names:
        shade_kp = np.maximum(make_pattern("uniform", RAYS, sphere=True) @ normals_p3.T, 0.0)
        found["cone"] = Space.cone(shade_kp[:, :, None] * albedo_pc)
    return found


def spaces_of_photographs(
    samples_ipc: NDArray[np.floating],
    directions_i3: NDArray[np.float64] | None,
    names: tuple[str, ...] = SPACES,
) -> dict[str, Space]:
    """Return the spaces of a subject that was photographed; so cast shadows are in them.

    Of known lights they are spanned by the pictures of harmonics that photographs are sums of, of unknown ones by their
    first principal components; the cone's rays are the photographs. With fewer photographs, or lights in a cap, spaces
    have fewer dimensions.

    Parameters
    ----------
    samples_ipc : ndarray, shape (n_light, P, channel)
        Linear radiance.
    directions_i3 : ndarray, shape (n_light, 3), optional
    """
    samples_ipc, found = np.asarray(samples_ipc, np.float64), {}
    count, pixels, channels = samples_ipc.shape
    for name, first, end in (("3d", 1, 4), ("4d", 0, 4), ("9d", 0, 9)):
        if name not in names:
            continue
        degree = 1 if end == 4 else None
        if directions_i3 is not None and _tells(directions_i3, 4):
            pictures_kp = basis_pictures(samples_ipc.reshape(count, -1), directions_i3, degree).pictures_kp
            found[name] = Space.spanned(pictures_kp[first:end].reshape(-1, pixels, channels))
        else:
            found[name] = _principal(samples_ipc, end - first)
    if "cone" in names:
        found["cone"] = Space.cone(samples_ipc)
    return found


def _tells(directions_i3: NDArray[np.float64], count: int) -> bool:
    if len(directions_i3) < count:
        return False
    return bool(np.linalg.cond(evaluate_basis(directions_i3, 1)) <= MOST_CONDITION)


def _principal(samples_ipc: NDArray[np.floating], count: int) -> Space:
    channels = []
    for channel in range(samples_ipc.shape[2]):
        _, size_r, right_rp = np.linalg.svd(samples_ipc[:, :, channel], full_matrices=False)
        kept_r = size_r[:count] > _LEAST_SINGULAR * max(float(size_r[0]), 1e-300)
        channels.append(right_rp[:count] * kept_r[:, None])
    return Space(np.stack(channels))
