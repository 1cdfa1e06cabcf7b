"""Measured reflectances: Cornell's ``.brdf`` files of spectra at pairs of directions, and values between them."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf, Cosines, reflection_cosines
from clrelight.brdf.colour import rgb_of_xyz, xyz_weights
from clrelight.errors import InputError
from clrelight.text_rows import read_lines

_HALF_TURN = np.pi + 1e-5
_LEAST_PAIRS = 16
_NEIGHBOURS = 12
_FLOOR = 1e-3
"""Where a measurement is less than this part of the median, that is taken: a logarithm needs some value."""


@dataclass(frozen=True)
class BrdfSamples:
    """What a ``.brdf`` file holds; checked when made.

    Attributes
    ----------
    angles_j4 : ndarray, shape (n, 4), float64
        Polar angle and azimuth of the light, then of the view, from the normal, in radians. The mirrored view is at
        the light's azimuth plus pi.
    spectra_jw : ndarray, shape (n, n_wavelength), float64
        BRDF in 1/sr, not negative.
    wavelength_w : ndarray, shape (n_wavelength,), float64
        nm.
    name : str
    """

    angles_j4: NDArray[np.float64]
    spectra_jw: NDArray[np.float64]
    wavelength_w: NDArray[np.float64]
    name: str = "brdf"

    def __post_init__(self) -> None:
        angles, spectra = self.angles_j4, self.spectra_jw
        if len(angles) < _LEAST_PAIRS:
            raise InputError(f"{self.name}: {len(angles)} pairs of directions, at least {_LEAST_PAIRS} are needed")
        if not (np.isfinite(angles).all() and np.isfinite(spectra).all() and (spectra >= 0.0).all()):
            raise InputError(f"{self.name}: angles and values must be finite numbers, values not negative")
        if (angles[:, [0, 2]] < 0.0).any() or (angles[:, [0, 2]] > 0.5 * np.pi).any():
            raise InputError(f"{self.name}: polar angles must be radians from 0 to pi / 2")
        if (np.abs(angles[:, [1, 3]]) > 2.0 * _HALF_TURN).any():
            raise InputError(f"{self.name}: azimuths must be radians within 2 pi")
        if (np.diff(self.wavelength_w) <= 0.0).any() or not (200.0 <= self.wavelength_w[0] <= self.wavelength_w[-1]):
            raise InputError(f"{self.name}: wavelengths must ascend, in nm")

    @property
    def xyz_jc(self) -> NDArray[np.float64]:
        """X, Y and Z of each pair, (n, 3), where a perfect matte white has 1 / pi in each."""
        return self.spectra_jw @ xyz_weights(self.wavelength_w).T


def read_brdf(path: str | os.PathLike[str]) -> BrdfSamples:
    """Read a ``.brdf`` file: the count of wavelengths, the wavelengths, then a row for each pair of directions.

    Rows hold ``theta_i phi_i theta_s phi_s`` in radians and a value for each wavelength; ``#`` starts a comment.

    Raises
    ------
    InputError
        If the file is not of this form, or `BrdfSamples` refuses what it holds.
    """
    file = Path(path)
    lines, _ = read_lines(file)
    words = [(number, line.split()) for number, line in lines]
    try:
        count = int(words[0][1][0]) if words and len(words[0][1]) == 1 else 0
    except ValueError:
        count = 0
    if count < 1:
        raise InputError(f"{file} is no .brdf file: it must begin with the number of wavelengths")
    wavelengths: list[float] = []
    rows: list[list[float]] = []
    for number, line in words[1:]:
        try:
            numbers = [float(word) for word in line]
        except ValueError:
            raise InputError(f"{file}, line {number}: expected numbers, got {' '.join(line)[:40]!r}") from None
        if len(wavelengths) < count:
            wavelengths += numbers
        elif len(numbers) == 4 + count:
            rows.append(numbers)
        else:
            raise InputError(f"{file}, line {number}: expected 4 angles and {count} values, got {len(numbers)} numbers")
    if len(wavelengths) != count:
        raise InputError(f"{file}: {count} wavelengths are announced, {len(wavelengths)} found")
    table = np.array(rows, np.float64).reshape(-1, 4 + count)
    return BrdfSamples(table[:, :4], table[:, 4:], np.array(wavelengths), file.name)


@dataclass(frozen=True, eq=False)
class MeasuredBrdf(CentredBrdf):
    """A measured BRDF times ``max(N . L, 0)``; between measurements, logarithms of values are interpolated.

    In the half and difference angles of Rusinkiewicz (1998), where values of a lobe lie close: the `_NEIGHBOURS`
    nearest measured places ``(theta_h, theta_d cos phi_d, theta_d sin phi_d)`` are weighed by ``((r - d) / (r d))^2``,
    where d is their distance and r the farthest one's (Franke and Nielson 1980); a measurement keeps its own value.
    As the BRDF is isotropic and reciprocal, ``phi_d`` is folded to 0 .. pi / 2. What is interpolated are X, Y and Z,
    which are never negative; the sRGB of a deep colour may be, and is cut at 0.

    Attributes
    ----------
    samples : BrdfSamples
    """

    samples: BrdfSamples = field(repr=False)

    id: ClassVar[str] = "measured"

    @property
    def channels(self) -> int:
        """3."""
        return 3

    def evaluate(
        self, theta_i: NDArray[np.float64], theta_o: NDArray[np.float64], phi: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """See `CentredBrdf`."""
        cosines = reflection_cosines(theta_i, theta_o, phi)
        above = cosines.light_normal > 0.0
        values = np.zeros((*above.shape, 3))
        lit = Cosines(cosines.light_normal[above], cosines.view_normal[above], cosines.light_view[above])
        values[above] = self.interpolate(lit) * lit.light_normal[:, None]
        return values

    def interpolate(self, cosines: Cosines) -> NDArray[np.float64]:
        """Return the BRDF (n, 3) in 1/sr for directions (n,) above the horizon."""
        tree, logs_jc = self._places
        neighbours = min(_NEIGHBOURS, len(logs_jc))
        distance_ns, near_ns = tree.query(half_difference_places(cosines), k=neighbours)
        farthest_n1 = distance_ns[:, -1:] * (1.0 + 1e-4) + 1e-9
        weight_ns = ((farthest_n1 - distance_ns) / (farthest_n1 * np.maximum(distance_ns, 1e-9))) ** 2
        weight_ns /= weight_ns.sum(axis=1, keepdims=True)
        return rgb_of_xyz(np.exp(np.einsum("ns,nsc->nc", weight_ns, logs_jc[near_ns])))

    @functools.cached_property
    def _places(self) -> tuple[Any, NDArray[np.float64]]:
        """Return a tree of the measured places, and the logarithms of their X, Y, Z."""
        from scipy.spatial import cKDTree

        light_j3, view_j3 = (_unit(self.samples.angles_j4[:, first : first + 2]) for first in (0, 2))
        cosines = Cosines(light_j3[:, 2], view_j3[:, 2], np.sum(light_j3 * view_j3, axis=1))
        xyz_jc = self.samples.xyz_jc
        floor_c = np.maximum(_FLOOR * np.median(xyz_jc, axis=0), 1e-12)
        return cKDTree(half_difference_places(cosines)), np.log(np.maximum(xyz_jc, floor_c))

    def to_config(self) -> dict[str, Any]:
        """See `CentredBrdf`."""
        return {"brdf": self.id, "file": self.samples.name}


def half_difference_places(cosines: Cosines) -> NDArray[np.float64]:
    """Return ``(theta_h, theta_d cos phi_d, theta_d sin phi_d)``, (n, 3), with phi_d in 0 .. pi / 2.

    The parts of N and L across the half vector H have the product ``N . L - (N . H) (L . H) = (N . L - N . V) / 2``,
    so ``sin(theta_h) sin(theta_d) cos(phi_d)`` is that.
    """
    theta_h = np.arccos(cosines.half_normal)
    theta_d = np.arccos(np.clip(0.5 * cosines.half_length, 0.0, 1.0))
    across = np.abs(0.5 * (cosines.light_normal - cosines.view_normal))
    cosine_d = np.clip(across / np.maximum(np.sin(theta_h) * np.sin(theta_d), 1e-12), 0.0, 1.0)
    return np.stack([theta_h, theta_d * cosine_d, theta_d * np.sqrt(1.0 - cosine_d * cosine_d)], axis=-1)


def _unit(angles_j2: NDArray[np.float64]) -> NDArray[np.float64]:
    theta, phi = angles_j2.T
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=1)
