"""The mathematics of reflection maps as NumPy and ducc0 do it: projection, products, transforms of spin q, frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.harmonics.index import band, coefficient_index
from clrelight.harmonics.rotations import turns_about_y
from clrelight.shrm.record import grid_angles


@dataclass
class DuccPipeline:
    """A reflection map of a lat-long map by ducc0, with all tables that do not depend on the map made beforehand.

    Everything is planar, as ducc0 wants it, and azimuths rise from column to column.

    Attributes
    ----------
    brdf : BrdfCoefficients
    height, width : int
        Of the light's map.
    rows, columns : int
        Of the reflection map.
    real : dtype
        float32 or float64.
    threads : int
    """

    brdf: BrdfCoefficients
    height: int
    width: int
    rows: int
    columns: int
    real: np.dtype
    threads: int

    def __post_init__(self) -> None:
        import ducc0

        self._sht = ducc0.sht
        degree = self.brdf.degree
        self._complex = np.result_type(self.real, np.complex64)
        self._weights = ducc0.sht.get_gridweights("F1", self.height) / self.width
        l = np.concatenate([np.arange(m, degree + 1) for m in range(degree + 1)])
        scale_l = np.sqrt(4.0 * np.pi / (2.0 * np.arange(degree + 1) + 1.0))
        # _sY_lm is d^l_mq e^(i m beta) over that scale.
        self._factor_pqcx = {
            (p, q): (self.brdf.rho_lpqc[:, p, q] * scale_l[:, None])[l].T.astype(self.real)
            for p in range(self.brdf.order + 1)
            for q in range(min(p, degree) + 1)
        }
        alpha_h, beta_w = grid_angles(self.rows, self.columns)
        blocks = turns_about_y(tuple(alpha_h.tolist()), self.brdf.order, self.real.name).blocks_lnij
        self._blocks = blocks
        angle_qw = np.arange(self.brdf.order + 1)[:, None] * beta_w[::-1]
        self._waves = np.cos(angle_qw).astype(self.real), np.sin(angle_qw).astype(self.real)

    @staticmethod
    def _first(width: int) -> float:
        return -0.5 * np.pi + np.pi / width

    def project(self, map_chw: NDArray) -> list[NDArray]:
        """Return a_lm of each channel: quadrature with Fejer's weights, which takes less time than ``analysis_2d``."""
        common = {"spin": 0, "lmax": self.brdf.degree, "geometry": "F1", "nthreads": self.threads}
        return [
            self._sht.adjoint_synthesis_2d(
                map=map_chw[c : c + 1], ringfactor=self._weights, phi0=self._first(self.width), **common
            )
            for c in range(len(map_chw))
        ]

    def local(self, alms: list[NDArray]) -> NDArray:
        """Return the local map, (k, channel, row, column): one transform of spin q for each p, q and channel."""
        order = self.brdf.order
        maps_kchw = np.zeros(((order + 1) ** 2, len(alms), self.rows, self.columns), self.real)
        common = {"lmax": self.brdf.degree, "geometry": "F1", "nthreads": self.threads}
        common |= {"ntheta": self.rows, "nphi": self.columns, "phi0": self._first(self.columns)}
        for c, alm in enumerate(alms):
            for (p, q), factor_cx in self._factor_pqcx.items():
                factor_x = factor_cx[c % len(factor_cx)]
                plus, minus = coefficient_index(p, q), coefficient_index(p, -q)
                if q == 0:
                    self._sht.synthesis_2d(alm=alm * factor_x, spin=0, map=maps_kchw[plus, c : c + 1], **common)
                    continue
                both = np.zeros((2, alm.shape[1]), self._complex)
                both[0] = alm[0] * (factor_x * self.real.type(-((-1) ** q) * np.sqrt(2.0)))
                made = self._sht.synthesis_2d(alm=both, spin=q, **common)
                maps_kchw[plus, c], maps_kchw[minus, c] = made
        return maps_kchw

    def turn(self, maps_kchw: NDArray) -> NDArray:
        """Return the global map of a local one: a matrix for each row and degree p, then a turn of each column."""
        cosine_qw, sine_qw = self._waves
        made_kchw = np.empty_like(maps_kchw)
        for p, block_hij in enumerate(self._blocks):
            rows_hjx = np.moveaxis(maps_kchw[band(p)], 2, 0)
            turned_hix = block_hij @ rows_hjx.reshape(self.rows, 2 * p + 1, -1)
            made_kchw[band(p)] = np.moveaxis(turned_hix.reshape(rows_hjx.shape), 0, 2)
            for q in range(1, p + 1):
                plus, minus = coefficient_index(p, q), coefficient_index(p, -q)
                before = made_kchw[plus].copy()
                made_kchw[plus] = cosine_qw[q] * before - sine_qw[q] * made_kchw[minus]
                made_kchw[minus] = sine_qw[q] * before + cosine_qw[q] * made_kchw[minus]
        return made_kchw

    def run(self, map_chw: NDArray, frame: str) -> NDArray:
        """Return the reflection map of a lat-long map."""
        local = self.local(self.project(map_chw))
        return local if frame == "local" else self.turn(local)

    @staticmethod
    def planar(map_hwc: NDArray, real: np.dtype) -> NDArray:
        """Return a map as `run` takes it."""
        return np.ascontiguousarray(np.moveaxis(map_hwc[:, ::-1], 2, 0), real)

    @staticmethod
    def as_ours(maps_kchw: NDArray) -> NDArray:
        """Return maps as `shrm.record.Shrm` holds them."""
        return np.moveaxis(maps_kchw, 1, 3)[:, :, ::-1]
