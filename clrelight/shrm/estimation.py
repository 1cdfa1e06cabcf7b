"""A reflectance from pictures of known shape under known light, by least squares (illumination-variation, 0.5.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CENTRES
from clrelight.brdf.coefficients import BrdfCoefficients
from clrelight.brdf.expanded import own_energy
from clrelight.errors import InputError, counted
from clrelight.shrm.observation import Observations, Terms, make_terms, observation_matrix
from clrelight.shrm.priors import typical_root

PRIORS = ("typical", "none")
"""What reflectances are taken to be like where pictures do not tell."""

RIDGES = 10.0 ** np.arange(-14.0, 0.5, 0.5)
"""Of the largest squared singular value: what is tried where no ridge is given."""

Decomposition = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True)
class FoundBrdf:
    """A reflectance that was found, and how well.

    Attributes
    ----------
    coefficients : BrdfCoefficients
    condition_l : ndarray, shape (degree + 1,)
        By how much more noise of the pictures grows in each degree than in the best one, as that of
        frequency-space-environment-maps, eq. 37, does: where
        points face all ways, a degree's part goes with ``||L_l|| / sqrt(2 l + 1)``.
    error_l : ndarray, shape (degree + 1,)
        Standard error that noise leaves in each degree's coefficients, as a part of the norm of all; what pictures do
        not tell, and the prior fills, is not in it.
    ridge : tuple of float
        What each channel was damped by, of the largest squared singular value.
    residual : float
        Part of the radiance's norm that is not explained.
    """

    coefficients: BrdfCoefficients
    condition_l: NDArray[np.float64]
    error_l: NDArray[np.float64]
    ridge: tuple[float, ...]
    residual: float


def estimate_brdf(
    seen: Observations,
    light_kc: NDArray[np.float64],
    degree: int,
    order: int,
    *,
    centre: str = "reflection",
    azimuth: bool = True,
    ridge: float | None = None,
    prior: str = "typical",
) -> FoundBrdf:
    """Return the isotropic reflectance that explains pictures best.

    Each channel by itself minimises ``||A T z - B||^2 + ridge s^2 ||z||^2`` for ``x = T z``, where s is the largest
    singular value of A T; ``||x||^2`` is the reflectance's energy.

    Parameters
    ----------
    seen : Observations
        Of several views, or of one, which sees a two-dimensional part of the four-dimensional light field.
    light_kc : ndarray, shape (n_coeff, 1 or 3)
    degree, order : int
        F and P of what is looked for.
    centre : str
        What `seen.central_n3` are, one of `brdf.centred.CENTRES`.
    azimuth : bool
        Whether coefficients of q > 0 are looked for.
    ridge : float, optional
        At least 0; by default what generalised cross-validation prefers (Golub, Heath and Wahba 1979).
    prior : str
        One of `PRIORS`: T of `priors.typical_root`, or 1, where what pictures do not tell is 0.

    Raises
    ------
    InputError
        If there are fewer points than unknowns, or the light lacks a degree altogether.
    """
    if centre not in CENTRES:
        raise InputError(f"centre must be one of {', '.join(CENTRES)}, got {centre!r}")
    if ridge is not None and not 0.0 <= ridge < np.inf:
        raise InputError(f"a ridge is a number of at least 0, got {ridge!r}")
    if prior not in PRIORS:
        raise InputError(f"a prior is one of {', '.join(PRIORS)}, got {prior!r}")
    terms = make_terms(degree, order, azimuth=azimuth)
    count, channels = seen.radiance_nc.shape
    if count < len(terms):
        raise InputError(
            f"{counted(count, 'point does', 'points do')} not tell the {len(terms)} coefficients "
            f"of F = {degree}, P = {order} apart"
        )
    matrices = matrices_of(seen, light_kc, terms)
    values, errors, ridges, left = [], [], [], 0.0
    root_jj = typical_root(degree, order, azimuth, centre) if prior == "typical" else np.eye(len(terms))
    decompositions = [_decompose(matrix_nj, root_jj) for matrix_nj in matrices]
    for c in range(channels):
        svd = decompositions[min(c, len(decompositions) - 1)]
        found = _solve(svd, seen.radiance_nc[:, c], ridge)
        values.append(found.values_j)
        errors.append(found.variance_j)
        ridges.append(found.ridge)
        left += found.left
    values_jc = np.stack(values, axis=1)
    rho_lpqc = terms.coefficients(values_jc)
    config = {"brdf": "estimated", "degree": degree, "order": order}
    made = BrdfCoefficients(rho_lpqc, own_energy(rho_lpqc), centre, config)
    variance_l = np.bincount(terms.l_j, np.sum(errors, axis=0), degree + 1)
    norm = float(np.linalg.norm(values_jc)) or 1.0
    return FoundBrdf(
        made,
        _conditions(matrices, terms),
        np.sqrt(variance_l) / norm,
        tuple(ridges),
        float(np.sqrt(left) / (np.linalg.norm(seen.radiance_nc) or 1.0)),
    )


def matrices_of(seen: Observations, light_kc: NDArray[np.float64], terms: Terms) -> list[NDArray[np.float64]]:
    """Return the equations (n, unknown) of each channel of the light, one for all where the light has one.

    A light of three channels on radiance of one counts by its mean.
    """
    if light_kc.ndim != 2 or light_kc.shape[1] not in (1, 3):
        raise InputError(f"a light is (n_coeff, 1 or 3), got shape {light_kc.shape}")
    if seen.radiance_nc.shape[1] == 1 and light_kc.shape[1] == 3:
        light_kc = light_kc.mean(axis=1, keepdims=True)
    gray = np.ptp(light_kc, axis=1).max() <= 1e-9 * np.abs(light_kc).max()
    columns = light_kc.T[:1] if gray else light_kc.T
    return [observation_matrix(light_k, terms, seen.central_n3, seen.views_n3) for light_k in columns]


def _decompose(matrix_nj: NDArray[np.float64], root_jj: NDArray[np.float64]) -> Decomposition:
    """Return U, s and T V of ``A T = U s V^T``, by the decomposition of a triangle: A is tall."""
    tall_nj, triangle_jj = np.linalg.qr(matrix_nj @ root_jj)
    left_jr, singular_r, right_rj = np.linalg.svd(triangle_jj)
    return tall_nj @ left_jr, singular_r, root_jj @ right_rj.T


@dataclass(frozen=True)
class _Solved:
    values_j: NDArray[np.float64]
    variance_j: NDArray[np.float64]
    ridge: float
    left: float


def _solve(svd: Decomposition, radiance_n: NDArray[np.float64], ridge: float | None) -> _Solved:
    """Return the damped solution of one channel, what noise makes of it, the ridge, and the residual's square."""
    left_nr, singular_r, right_jr = svd
    along_r = left_nr.T @ radiance_n
    beyond = max(float(radiance_n @ radiance_n - along_r @ along_r), 0.0)
    square_r = singular_r**2
    if not square_r[0] > 0.0:
        raise InputError("the light is 0 where the points reflect it: nothing can be told from them")
    count = len(radiance_n)

    def rest(each: float) -> tuple[float, float]:
        """Return the residual's square and how many points are left to tell the noise."""
        shrink_r = square_r / (square_r + each * square_r[0])
        free = max(count - float(shrink_r.sum()), 1e-9)
        return beyond + float(np.sum(((1.0 - shrink_r) * along_r) ** 2)), free

    if ridge is None:
        scores = [squares / free**2 for squares, free in map(rest, RIDGES.tolist())]
        ridge = float(RIDGES[int(np.argmin(scores))])
    squares, free = rest(ridge)
    with np.errstate(divide="ignore"):
        inverse_r = singular_r / (square_r + ridge * square_r[0])
    inverse_r[~np.isfinite(inverse_r)] = 0.0
    values_j = right_jr @ (inverse_r * along_r)
    variance_j = squares / free * ((right_jr * inverse_r) ** 2).sum(axis=1)
    return _Solved(values_j, variance_j, ridge, squares)


def _conditions(matrices: list[NDArray[np.float64]], terms: Terms) -> NDArray[np.float64]:
    """Return the largest mean norm of a degree's columns over each one's."""
    square_j = sum((matrix_nj**2).sum(axis=0) for matrix_nj in matrices)
    counts_l = np.bincount(terms.l_j, minlength=terms.degree + 1)
    norm_l = np.sqrt(np.bincount(terms.l_j, square_j, terms.degree + 1) / counts_l)
    if not norm_l.all():
        missing = int(np.flatnonzero(norm_l == 0.0)[0])
        raise InputError(f"the light has nothing of degree {missing}: ask for a smaller degree F")
    return np.asarray(norm_l.max() / norm_l)
