"""Subspaces of a view's pictures side by side: how much of pictures under single lamps each of them holds.

All follows from the products of pictures with each other, so that pictures themselves pass once. Illumination
variation, 0.2.2 and 0.3.3: Shashua's three, Koenderink and van Doorn's four, the nine harmonics, principal components,
the illumination cone; and nine photographs in their place (Lee, Ho and Kriegman 2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.variation.inverse import MOST_CONDITION
from clrelight.variation.recognition import ConeSolver

EPSTEIN = {3: 0.90, 5: 0.94}
"""Share of the variance of photographed faces that so many components hold (Epstein et al. 1995, by the chapter)."""
LEE_DEGREES = ((0, 0), (68, -90), (74, 108), (80, 52), (85, -42), (85, -137), (85, 146), (85, -4), (51, 67))
"""Angle from the camera's axis and azimuth of nine lights that served all faces of Lee, Ho and Kriegman alike."""
LEAST_LIGHTS = 10
_RELATIVE = 1e-10


@dataclass(frozen=True)
class Captured:
    """What a subspace holds of pictures that it was not made of.

    Attributes
    ----------
    name : str
    dimensions : int
        Of a cone its rays.
    energy : float
        Share of the pictures' energy.
    variance : float
        Share of what they differ from their mean by: below 0 where the mean alone would do better.
    lights : tuple of int
        Pictures that it was made of, where it is made of few.
    """

    name: str
    dimensions: int
    energy: float
    variance: float
    lights: tuple[int, ...] = ()


def lee_directions() -> NDArray[np.float64]:
    """Return the unit vectors of `LEE_DEGREES`, (9, 3)."""
    polar_i, azimuth_i = np.radians(np.array(LEE_DEGREES, np.float64)).T
    across_i = np.sin(polar_i)
    return np.stack([across_i * np.cos(azimuth_i), across_i * np.sin(azimuth_i), np.cos(polar_i)], axis=1)


@dataclass(frozen=True)
class Products:
    """Products of a view's pictures with each other.

    Attributes
    ----------
    gram_vv : ndarray, shape (n_picture + 9, n_picture + 9), float64
        Pictures under lamps, and then albedo times the nine harmonics of the normals.
    directions_i3 : ndarray, shape (n_picture, 3), float64
        To the lamps.
    made_of, tested : ndarray of int
        Pictures that subspaces may be made of, and those that they are tested by.
    """

    gram_vv: NDArray[np.float64]
    directions_i3: NDArray[np.float64]
    made_of: NDArray[np.intp]
    tested: NDArray[np.intp]

    def held(self, name: str, rows_rv: NDArray[np.float64], lights: tuple[int, ...] = ()) -> Captured:
        """Return what the span of some sums of pictures holds; `rows_rv` are the pictures' weights in each sum."""
        inner_rr, cross_rt = rows_rv @ self.gram_vv @ rows_rv.T, rows_rv @ self.gram_vv[:, self.tested]
        size_r, vectors_rr = np.linalg.eigh(inner_rr)
        kept_r = size_r > _RELATIVE * max(float(size_r[-1]), 1e-300)
        onto_rt = (vectors_rr[:, kept_r].T @ cross_rt) / np.sqrt(size_r[kept_r])[:, None]
        return self._told(name, int(kept_r.sum()), np.sum(onto_rt**2, axis=0), lights)

    def held_by_cone(self, name: str, rays: NDArray[np.intp]) -> Captured:
        """Return what sums of pictures with weights that are not negative hold."""
        solver = ConeSolver(self.gram_vv[np.ix_(rays, rays)])
        explained_t = np.array([solver.explained(self.gram_vv[rays, test]) for test in self.tested])
        return self._told(name, len(rays), explained_t)

    def _told(self, name: str, dimensions: int, held_t: NDArray, lights: tuple[int, ...] = ()) -> Captured:
        energy_t = self.gram_vv[self.tested, self.tested]
        left = float(np.maximum(energy_t - held_t, 0.0).sum())
        mean = np.zeros(len(self.gram_vv))
        mean[self.made_of] = 1.0 / len(self.made_of)
        around = float(np.sum(energy_t - 2.0 * (mean @ self.gram_vv)[self.tested]) + len(energy_t) * self._square(mean))
        variance = 1.0 - left / around if around > 0.0 else 0.0
        return Captured(name, dimensions, 1.0 - left / float(energy_t.sum()), variance, lights)

    def _square(self, row_v: NDArray[np.float64]) -> float:
        return float(row_v @ self.gram_vv @ row_v)

    def unit(self, picture: int) -> NDArray[np.float64]:
        """Return the weights of one picture."""
        row_v = np.zeros(len(self.gram_vv))
        row_v[picture] = 1.0
        return row_v

    def harmonics(self, first: int, end: int) -> NDArray[np.float64]:
        """Return the weights of albedo times some of the nine harmonics."""
        rows_rv = np.zeros((end - first, len(self.gram_vv)))
        count = len(self.directions_i3)
        rows_rv[np.arange(end - first), np.arange(count + first, count + end)] = 1.0
        return rows_rv

    def fitted(self) -> NDArray[np.float64] | None:
        """Return the weights of the nine pictures that photographs are sums of; None where lamps do not tell nine."""
        basis_ik = evaluate_basis(self.directions_i3[self.made_of], 2)
        if len(basis_ik) < 9 or not np.linalg.cond(basis_ik) <= MOST_CONDITION:
            return None
        rows_rv = np.zeros((9, len(self.gram_vv)))
        rows_rv[:, self.made_of] = np.linalg.pinv(basis_ik)
        return rows_rv

    def principal(self, count: int, centred: bool) -> NDArray[np.float64]:
        """Return the weights of principal components, behind those of the mean where it is taken off."""
        gram_ij, n_made = self.gram_vv[np.ix_(self.made_of, self.made_of)], len(self.made_of)
        off_ij = np.eye(n_made) - (1.0 / n_made if centred else 0.0)
        vectors_ir = np.linalg.eigh(off_ij @ gram_ij @ off_ij)[1][:, ::-1][:, :count]
        rows_rv = np.zeros((count + centred, len(self.gram_vv)))
        rows_rv[centred:, self.made_of] = (off_ij @ vectors_ir).T
        if centred:
            rows_rv[0, self.made_of] = 1.0 / n_made
        return rows_rv

    def greedy(self, near_rv: NDArray[np.float64], count: int = 9) -> list[int]:
        """Return lamps whose pictures span much and lie near a space, one after another (Lee, Ho and Kriegman, 3.1).

        The next is the picture of the largest distance to those taken, divided by the distance to that space.
        """
        gram_vv = self.gram_vv
        energy_i = gram_vv[self.made_of, self.made_of]
        usable = energy_i > _RELATIVE * energy_i.max()
        inner_rr, cross_ri = near_rv @ gram_vv @ near_rv.T, near_rv @ gram_vv[:, self.made_of]
        near_i = energy_i - np.sum(cross_ri * np.linalg.lstsq(inner_rr, cross_ri, rcond=_RELATIVE)[0], axis=0)
        near_i = np.sqrt(np.maximum(near_i, 1e-6 * energy_i.max()))
        chosen: list[int] = []
        for _ in range(min(count, int(usable.sum()))):
            left_i = energy_i.copy()
            if chosen:
                inner = gram_vv[np.ix_(chosen, chosen)]
                cross = gram_vv[np.ix_(chosen, self.made_of.tolist())]
                left_i -= np.sum(cross * np.linalg.lstsq(inner, cross, rcond=_RELATIVE)[0], axis=0)
            gain_i = np.where(usable, np.sqrt(np.maximum(left_i, 0.0)) / near_i, -1.0)
            chosen.append(int(self.made_of[int(gain_i.argmax())]))
        return chosen

    def nearest(self, directions_k3: NDArray[np.float64]) -> list[int]:
        """Return the lamps nearest to some directions, none twice."""
        cosine_ki = directions_k3 @ self.directions_i3[self.made_of].T
        chosen: list[int] = []
        for cosine_i in cosine_ki:
            order = np.argsort(-cosine_i, kind="stable")
            chosen.append(next(int(self.made_of[i]) for i in order if int(self.made_of[i]) not in chosen))
        return chosen


def compare_spaces(products: Products, fixed: list[int] | None = None) -> list[Captured]:
    """Return what each subspace holds of the tested pictures.

    Parameters
    ----------
    products : Products
    fixed : list of int, optional
        The pictures under Lee, Ho and Kriegman's nine lights; default: those of the nearest lamps.

    Raises
    ------
    InputError
        If there are fewer than ten pictures to make subspaces of, or none to test them by.
    """
    if len(products.made_of) < LEAST_LIGHTS or not len(products.tested):
        raise InputError(
            f"subspaces are made of at least {LEAST_LIGHTS} pictures and tested by others, got "
            f"{len(products.made_of)} and {len(products.tested)}"
        )
    if not products.gram_vv[products.tested, products.tested].sum() > 0.0:
        raise InputError("the pictures that subspaces are tested by are black")
    nine_rv, fitted_rv = products.harmonics(0, 9), products.fitted()
    rows = [
        products.held("3D, scaled normals", products.harmonics(1, 4)),
        products.held("4D, and albedo", products.harmonics(0, 4)),
        products.held("9D, harmonics of the normals", nine_rv),
    ]
    if fitted_rv is not None:
        rows.append(products.held("9D, harmonics of the lights", fitted_rv))
    near_rv = nine_rv if fitted_rv is None else fitted_rv
    for name, lights in (
        ("nine lights, greedy", products.greedy(near_rv)),
        ("nine lights, fixed", products.nearest(lee_directions()) if fixed is None else fixed),
    ):
        rows.append(products.held(name, np.array([products.unit(i) for i in lights]), tuple(lights)))
    for count in (3, 5):
        rows.append(products.held(f"mean and {count} components", products.principal(count, True)))
    for count in (5, 9):
        rows.append(products.held(f"{count}D, principal components", products.principal(count, False)))
    rows.append(products.held_by_cone("cone", products.made_of))
    return rows
