"""Which material a picture shows: principal components of known reflectances (illumination-variation, 0.5.3).

As Nillius and Eklundh do: what known light makes of few principal components is fitted to a picture, and compared with
what it makes of each known material.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.brdf.centred import CentredBrdf
from clrelight.brdf.coefficients import brdf_coefficients
from clrelight.brdf.radial import Lambert, Mirrored
from clrelight.errors import InputError
from clrelight.shrm.estimation import matrices_of
from clrelight.shrm.observation import Observations, Terms, make_terms


@dataclass(frozen=True)
class MaterialLibrary:
    """Known materials of one norm, and their principal components.

    Attributes
    ----------
    names : tuple of str
    terms : Terms
    mean_x : ndarray, shape (unknown * 3,)
        Of all materials, each of norm 1; unknowns of red, green, blue one after the other.
    axes_kx : ndarray, shape (component, unknown * 3)
        Orthonormal.
    places_nk : ndarray, shape (material, component)
        Of the materials.
    share_k : ndarray, shape (component,)
        Part of the variance that each component holds.
    """

    names: tuple[str, ...]
    terms: Terms
    mean_x: NDArray[np.float64]
    axes_kx: NDArray[np.float64]
    places_nk: NDArray[np.float64]
    share_k: NDArray[np.float64]
    centre: str = "reflection"


@dataclass(frozen=True)
class Recognition:
    """What a picture shows.

    Attributes
    ----------
    names : tuple of str
        Nearest first.
    distance_n : ndarray, shape (material,)
        Sine of the angle between what the light makes of the components that were fitted, and of each material: what
        is left of the picture whatever the exposure.
    unexplained : float
        Part of the picture's norm that no components explain: noise, and whatever the library does not know.
    """

    names: tuple[str, ...]
    distance_n: NDArray[np.float64]
    unexplained: float


def make_library(
    materials: Mapping[str, CentredBrdf], degree: int, order: int, components: int | None = None
) -> MaterialLibrary:
    """Return a library of reflectances about one central direction, by coefficients up to F and P.

    Lambert's is taken about the mirrored view, as others are.

    Parameters
    ----------
    materials : mapping of str to CentredBrdf
        Two at least; of one channel they are gray.
    degree, order : int
    components : int, optional
        1 to one fewer than materials, which is the default and tells them all apart.
    """
    if len(materials) < 2:
        raise InputError(f"materials are told apart from others: a library holds two at least, got {len(materials)}")
    most = len(materials) - 1
    count = most if components is None else components
    if not 1 <= count <= most:
        raise InputError(f"{len(materials)} materials have 1 to {most} principal components, got {count}")
    alike = [Mirrored(brdf) if isinstance(brdf, Lambert) else brdf for brdf in materials.values()]
    centres = {brdf.centre for brdf in alike}
    if len(centres) > 1:
        raise InputError(f"materials of a library share a central direction, got {', '.join(sorted(centres))}")
    terms = make_terms(degree, order)
    rows = []
    for brdf in alike:
        held = brdf_coefficients(brdf, degree, order)
        rho_lpqc = np.zeros((degree + 1, order + 1, order + 1, held.channels))
        rho_lpqc[: held.degree + 1, : held.order + 1, : held.order + 1] = held.rho_lpqc
        values_jc = np.broadcast_to(terms.unknowns(rho_lpqc), (len(terms), 3))
        rows.append(values_jc.T.ravel() / np.linalg.norm(values_jc))
    table_nx = np.stack(rows)
    mean_x = table_nx.mean(axis=0)
    _, singular_r, axes_rx = np.linalg.svd(table_nx - mean_x, full_matrices=False)
    share_k = singular_r**2 / max(float(np.sum(singular_r**2)), 1e-300)
    axes_kx = axes_rx[:count]
    places_nk = (table_nx - mean_x) @ axes_kx.T
    return MaterialLibrary(tuple(materials), terms, mean_x, axes_kx, places_nk, share_k[:count], centres.pop())


def library_pictures(
    library: MaterialLibrary, seen: Observations, light_kc: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what a light makes of the mean, (n * channel,), and of the components, (component, n * channel)."""
    matrices = matrices_of(seen, light_kc, library.terms)
    channels = seen.radiance_nc.shape[1]

    def shown(values_x: NDArray[np.float64]) -> NDArray[np.float64]:
        values_cj = values_x.reshape(3, -1)
        if channels == 1:
            values_cj = values_cj.mean(axis=0, keepdims=True)
        return np.concatenate([matrices[min(c, len(matrices) - 1)] @ values_cj[c] for c in range(channels)])

    return shown(library.mean_x), np.stack([shown(axis_x) for axis_x in library.axes_kx])


def recognise(
    library: MaterialLibrary,
    seen: Observations,
    light_kc: NDArray[np.float64],
    pictures: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
) -> Recognition:
    """Return which material of a library explains pictures under known light; their exposure does not matter.

    Parameters
    ----------
    library : MaterialLibrary
    seen : Observations
        Central directions are of the library's kind.
    light_kc : ndarray, shape (n_coeff, 1 or 3)
    pictures : optional
        What `library_pictures` returned for the same points and light.
    """
    mean_x, axes_kx = pictures or library_pictures(library, seen, light_kc)
    observed_x = seen.radiance_nc.T.ravel()
    basis_xk = np.column_stack([mean_x, axes_kx.T])
    fitted_k = np.linalg.lstsq(basis_xk, observed_x, rcond=1e-9)[0]
    fitted_x = basis_xk @ fitted_k
    size = float(np.linalg.norm(fitted_x))
    if not size > 0.0:
        raise InputError("the pictures are black where this light shows any of the materials")
    known_nx = mean_x + library.places_nk @ axes_kx
    cosine_n = known_nx @ fitted_x / (np.maximum(np.linalg.norm(known_nx, axis=1), 1e-300) * size)
    distance_n = np.where(cosine_n > 0.0, np.sqrt(np.maximum(1.0 - cosine_n**2, 0.0)), 1.0)
    order_n = np.argsort(distance_n, kind="stable")
    left = float(np.linalg.norm(observed_x - fitted_x) / np.linalg.norm(observed_x))
    return Recognition(tuple(library.names[i] for i in order_n), distance_n[order_n], left)
