"""What points of pictures say of a reflectance under known light: one linear equation for each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.coefficients import theta_tables
from clrelight.errors import InputError
from clrelight.harmonics.wigner import complex_coefficients, turn_functions


@dataclass(frozen=True)
class Observations:
    """Radiance of points towards the eye; checked when made.

    Attributes
    ----------
    radiance_nc : ndarray, shape (n, channel), float64
        Linear.
    central_n3, views_n3 : ndarray, shape (n, 3), float64
        Unit vectors in the axes of the light: central directions of a reflectance, and towards the eye.
    """

    radiance_nc: NDArray[np.float64]
    central_n3: NDArray[np.float64]
    views_n3: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.radiance_nc)
        if self.radiance_nc.ndim != 2 or self.radiance_nc.shape[1] not in (1, 3) or not count:
            raise InputError(f"observations are (n, 1 or 3) radiances, got shape {self.radiance_nc.shape}")
        if self.central_n3.shape != (count, 3) or self.views_n3.shape != (count, 3):
            raise InputError(f"{count} radiances need as many central directions and views, (n, 3)")
        if not all(np.isfinite(each).all() for each in (self.radiance_nc, self.central_n3, self.views_n3)):
            raise InputError("radiance and directions of observations must be finite numbers")


@dataclass(frozen=True)
class Terms:
    """Which coefficients are unknown: l, p and q of each, q at most l and p.

    Unknowns are ``sqrt(U_q) rho_lpq``, whose squares add up to the reflectance's energy (U_0 = 1, else 2).
    """

    degree: int
    order: int
    azimuth: bool
    l_j: NDArray[np.intp]
    p_j: NDArray[np.intp]
    q_j: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.l_j)

    def unknowns(self, rho_lpqc: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the unknowns (j, channel) of coefficients of these orders or more."""
        scale_j = np.where(self.q_j == 0, 1.0, np.sqrt(2.0))
        return rho_lpqc[self.l_j, self.p_j, self.q_j] * scale_j[:, None]

    def coefficients(self, values_jc: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return coefficients (F + 1, P + 1, P + 1, channel) of unknowns."""
        rho_lpqc = np.zeros((self.degree + 1, self.order + 1, self.order + 1, values_jc.shape[1]))
        scale_j = np.where(self.q_j == 0, 1.0, np.sqrt(0.5))
        rho_lpqc[self.l_j, self.p_j, self.q_j] = values_jc * scale_j[:, None]
        return rho_lpqc


def make_terms(degree: int, order: int, *, azimuth: bool = True) -> Terms:
    """Return the coefficients up to F and P, without azimuth those of q = 0."""
    l_j, p_j, q_j = np.indices((degree + 1, order + 1, order + 1)).reshape(3, -1)
    kept_j = q_j <= (np.minimum(l_j, p_j) if azimuth else 0)
    return Terms(degree, order, azimuth, l_j[kept_j], p_j[kept_j], q_j[kept_j])


def observation_matrix(
    light_k: NDArray[np.float64], terms: Terms, central_n3: NDArray[np.float64], views_n3: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return A with ``radiance_n = sum_j A_nj unknown_j`` (frequency-space-environment-maps, eq. 6 and 14).

    ``B = sum_lpq U_q rho_lpq f_pq(theta_o) Re(g_lq e^(i q phi_o))``, where ``g_lq = sum_m L_lm d^l_mq(alpha) e^(i m
    beta)`` is the light in the frame of the point's central direction, and the view is measured in that frame too.

    Parameters
    ----------
    light_k : ndarray, shape (n_coeff,)
        Of one channel; what it lacks of the degree counts as 0.
    terms : Terms
    central_n3, views_n3 : ndarray, shape (n, 3)
    """
    alpha_n = np.arctan2(np.hypot(central_n3[:, 0], central_n3[:, 1]), central_n3[:, 2])
    beta_n = np.arctan2(central_n3[:, 1], central_n3[:, 0])
    theta_n, phi_n = _local_angles(alpha_n, beta_n, views_n3)
    wanted = (terms.degree + 1) ** 2
    held_k1 = np.zeros((wanted, 1))
    held_k1[: min(wanted, len(light_k)), 0] = light_k[:wanted]
    orders = min(terms.order, terms.degree) if terms.azimuth else 0
    table = theta_tables(theta_n, terms.order)
    matrix_nj = np.empty((len(central_n3), len(terms)))
    for q in range(orders + 1):
        turned_ln = _turned_light(held_k1, terms.degree, q, alpha_n, beta_n)
        wave_ln = (turned_ln * np.exp(1j * q * phi_n)).real * (np.sqrt(2.0) if q else 1.0)
        for j in np.flatnonzero(terms.q_j == q):
            matrix_nj[:, j] = wave_ln[terms.l_j[j] - q] * table[q][terms.p_j[j] - q]
    return matrix_nj


def _turned_light(
    light_k1: NDArray[np.float64], degree: int, q: int, alpha_n: NDArray[np.float64], beta_n: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return ``g_lq`` of l = q .. degree, (degree + 1 - q, n); of real light, m and -m are summed together."""
    turned_ln = np.zeros((degree + 1 - q, len(alpha_n)), np.complex128)
    for m in range(degree + 1):
        first = max(m, q)
        wave_ln = complex_coefficients(light_k1, m)[first - m :, :1] * np.exp(1j * m * beta_n)
        turned_ln[first - q :] += turn_functions(alpha_n, degree, m, q) * wave_ln
        if m:
            turned_ln[first - q :] += turn_functions(alpha_n, degree, -m, q) * wave_ln.conj()
    return turned_ln


def _local_angles(
    alpha_n: NDArray[np.float64], beta_n: NDArray[np.float64], views_n3: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return polar angle and azimuth of views in the frames ``Rz(beta) Ry(alpha)``."""
    along_n = np.cos(beta_n) * views_n3[:, 0] + np.sin(beta_n) * views_n3[:, 1]
    y_n = np.cos(beta_n) * views_n3[:, 1] - np.sin(beta_n) * views_n3[:, 0]
    x_n = np.cos(alpha_n) * along_n - np.sin(alpha_n) * views_n3[:, 2]
    z_n = np.sin(alpha_n) * along_n + np.cos(alpha_n) * views_n3[:, 2]
    return np.arctan2(np.hypot(x_n, y_n), z_n), np.arctan2(y_n, x_n)
