"""What is the same for every pixel: the matrices of a fit, made once in float64 on the host."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH, basis_of
from clrelight.dataset import LightStack
from clrelight.errors import InputError, counted
from clrelight.harmonics.decomposition import decompose
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import group_directions
from clrelight.sampling import solid_angle_weights

WEIGHTINGS = ("uniform", "solid-angle")
SAMPLINGS = ("hemisphere", "scattered")

HORIZON = 1e-6
"""A light counts as below the horizon where its z is under minus this."""

IMAGE_ROUNDING = 2e-9
"""Error of the image, as a part of the brightest sample, that float32 rounding of least-squares coefficients makes per
unit of the condition number: twice the most that the tests of extremes find."""

_SEEN = 1e-9
"""A basis function whose share of its energy on the samples is below this is not seen by them."""


@dataclass(frozen=True)
class Lighting:
    """The lights of a fit, and how much each counts.

    Attributes
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
    solid_angles_i : ndarray, shape (n_light,), float64
        Steradian; for the uniform weighting those of all directions are equal, and together the hemisphere, or the
        sphere where lights below the horizon were allowed. Photographs of one direction share its angle: that is the
        fit to their mean.
    copies_i : ndarray, shape (n_light,), int
        Photographs of each light's direction.
    sampling : str
        ``"hemisphere"``, or ``"scattered"`` for samples on a part of it (noise-resistant-fitting, section V-D).
    basis : str
        Id of the basis that is fitted.
    """

    directions_i3: NDArray[np.float64]
    solid_angles_i: NDArray[np.float64]
    copies_i: NDArray[np.intp]
    sampling: str = "hemisphere"
    basis: str = SH

    def functions(self, degree: int) -> NDArray[np.float64]:
        """Return the basis at the lights, (n_light, n_coeff) float64."""
        return basis_of(self.basis).evaluate(self.directions_i3, degree)

    @property
    def row_weights_i(self) -> NDArray[np.float64]:
        """Weights of the least squares; a direction's are 1 together, on average, so that lambda keeps its unit."""
        return self.solid_angles_i / (self.solid_angles_i.sum() / round((1.0 / self.copies_i).sum()))


@dataclass(frozen=True)
class FitPlan:
    """The matrices of one fit.

    Attributes
    ----------
    analysis_ri : ndarray, shape (rank, n_light), float64
        Radiance samples to components ``z``.
    synthesis_kr : ndarray, shape (n_coeff, rank), float64, or None
        Shrunk components to coefficients; None where the components are the coefficients.
    singular_r : ndarray, shape (rank,), float64
        Singular values of the weighted basis matrix.
    energy_i : ndarray, shape (n_light,), float64
        The bound is ``E_c = sum_i energy_i beta_i**2``.
    condition : float
        Largest over smallest singular value.
    notes : tuple of str
        What the user should know.
    """

    analysis_ri: NDArray[np.float64]
    synthesis_kr: NDArray[np.float64] | None
    singular_r: NDArray[np.float64]
    energy_i: NDArray[np.float64]
    condition: float
    notes: tuple[str, ...] = field(default=())


def is_sphere(directions_i3: NDArray[np.float64]) -> bool:
    """Return whether there are lights below the horizon, so that samples count as covering the whole sphere."""
    return bool((directions_i3[:, 2] < -HORIZON).any())


def make_lighting(stack: LightStack, weights: str, sampling: str, basis: str = SH) -> Lighting:
    """Return the lights of a stack with their weights; InputError for an unknown name, or a basis that lacks some."""
    if weights not in WEIGHTINGS:
        raise InputError(f"weights must be one of {', '.join(WEIGHTINGS)}, got {weights!r}")
    if sampling not in SAMPLINGS:
        raise InputError(f"sampling must be one of {', '.join(SAMPLINGS)}, got {sampling!r}")
    below = is_sphere(stack.directions_i3)
    if below and basis_of(basis).hemispherical:
        raise InputError(f"basis {basis} knows the upper hemisphere only and there are lights below: take --basis sh")
    _, group_i, count_g = np.unique(group_directions(stack.directions_i3), return_inverse=True, return_counts=True)
    copies_i = count_g[group_i]
    angles = (4.0 if below else 2.0) * np.pi / len(count_g) / copies_i
    if weights == "solid-angle":
        given = stack.weights_i
        angles = solid_angle_weights(stack.directions_i3, sphere=below) if given is None else given
    return Lighting(stack.directions_i3, angles, copies_i, sampling, basis)


def plan_least_squares(
    lighting: Lighting,
    degree: int,
    *,
    without: tuple[int, ...] = (),
    penalty_k: NDArray[np.float64] | None = None,
    complete: bool = False,
) -> FitPlan:
    """Return the plan of a least-squares fit: ``z = W' beta`` with the thin SVD ``Y = W diag(sigma) U'``.

    Rows are weighted by the square root of the lights' weights. For scattered sampling the basis is scaled to
    ``Y* = Y D^-1`` with ``D^2 = kappa``, the energy of each basis function over the samples (noise-resistant-fitting,
    eq. 26-30). The area of the sampled region, the sum of the solid angles, scales kappa and the bound alike: it
    cancels in the coefficients, and lambda is proportional to its reciprocal. Under the uniform weighting the area is
    taken to be the hemisphere's, 2 pi, whatever part of it the samples cover.

    Parameters
    ----------
    lighting : Lighting
    degree : int
    without : tuple of int
        Indices of basis functions that the fit may not use; their coefficients are 0.
    penalty_k : ndarray, shape (n_coeff,), float64, optional
        Diagonal of a penalty P on the coefficients, all positive. The SVD is then that of ``Y P^-1/2``, in whose
        components ``(Y'Y + lambda P)^-1 Y'`` is diagonal; scattered sampling scales nothing, for the penalty settles
        what the samples do not see.
    complete : bool
        Have components of singular value 0 too, so that there are as many as basis functions, for methods that see
        more of a function than its samples.
    """
    basis_ik = lighting.functions(degree)
    weight_i = lighting.row_weights_i
    scale_k = np.ones(basis_ik.shape[1])
    # eq. 16: half the coefficients' energy is bounded by the function's over the hemisphere. Over the whole
    # sphere, where lights below the horizon were allowed, it is all of it; 4 pi / sum w covers both.
    energy_i = 4.0 * np.pi * lighting.solid_angles_i / lighting.solid_angles_i.sum()
    notes: list[str] = []
    used = np.ones(basis_ik.shape[1], bool)
    used[list(without)] = False
    if penalty_k is not None:
        scale_k = 1.0 / np.sqrt(penalty_k)
    elif lighting.sampling == "scattered":
        kappa_k = lighting.solid_angles_i @ basis_ik**2
        energy_i = lighting.solid_angles_i
        unseen = kappa_k < _SEEN * kappa_k.max()
        if unseen.any():
            notes.append(f"{unseen.sum()} basis functions vanish at all samples: their coefficients are 0")
        used &= ~unseen
        scale_k[used] = 1.0 / np.sqrt(kappa_k[used])
    root_i = np.sqrt(weight_i)
    svd = decompose(root_i[:, None] * basis_ik[:, used] * scale_k[used])
    if len(svd.singular_r) < min(used.sum(), len(basis_ik)):
        notes.append(f"only {len(svd.singular_r)} of {used.sum()} components can be told from zero in float64")
    analysis_ri, singular_r, right_kr = svd.left_ir.T * root_i, svd.singular_r, svd.right_kr
    if complete and len(singular_r) < used.sum():
        unseen_kr = np.linalg.svd(right_kr, full_matrices=True)[0][:, len(singular_r) :]
        right_kr = np.hstack([right_kr, unseen_kr])
        analysis_ri = np.vstack([analysis_ri, np.zeros((unseen_kr.shape[1], len(basis_ik)))])
        singular_r = np.append(singular_r, np.zeros(unseen_kr.shape[1]))
    synthesis_kr = np.zeros((basis_ik.shape[1], len(singular_r)))
    synthesis_kr[used] = scale_k[used, None] * right_kr
    return FitPlan(analysis_ri, synthesis_kr, singular_r, energy_i, svd.condition, tuple(notes))


def scale_components(plan: FitPlan, factor_r: NDArray[np.float64]) -> FitPlan:
    """Fold ``diag(factor)`` into the synthesis.

    The product is not multiplied out with the analysis: components first, then coefficients, keeps the rounding errors
    of large coefficients in the directions where they cancel in the image.
    """
    if plan.synthesis_kr is None:
        raise ValueError("expected a least-squares plan, got one without a synthesis")
    return replace(plan, synthesis_kr=plan.synthesis_kr * factor_r)


def require_lights(method: str, n_light: int, degree: int) -> None:
    """Raise InputError where there are fewer lights than coefficients; the message says which degree fits."""
    if n_light < coefficient_count(degree):
        fitting = int(np.sqrt(n_light)) - 1
        raise InputError(
            f"{method} at degree {degree} has {coefficient_count(degree)} coefficients but there "
            f"{'is' if n_light == 1 else 'are'} {counted(n_light, 'light')}: "
            f"degree {fitting} is the largest that fits; cls, ceb and spline accept any degree"
        )
