"""What a fit may be off by, against float64 column by column.

Coefficients are in units of the peak; errors in the image at the fitted lights are relative to the brightest sample.
"""

import numpy as np

from clrelight.dataset import LightStack
from clrelight.jobs.fit import fit
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import columns_of, make_samples, samples_of

IMAGE = 2e-5
"""Of the brightest sample: the error that float32 may make."""
BOUND = 1e-5
"""Of E_c: how far the coefficients' energy may be above it."""
EPS32 = float(np.finfo(np.float32).eps)


def cap(n_light, radius):
    """Return directions that cover a cap of this radius in degrees, by a spiral of equal areas."""
    step = np.arange(n_light)
    z = 1.0 - (1.0 - np.cos(np.radians(radius))) * (step + 0.5) / n_light
    azimuth = step * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), z], axis=1)


def stack_of(directions_i3, scale=1.0, *, peak=1.0, columns=48, seed=0, dtype=np.float32):
    """Return pixels half shadowed with highlights and noise, one black and one constant, times `scale`."""
    images = make_samples(directions_i3, (1, columns, 1), seed) * scale
    return LightStack(images.astype(dtype), directions_i3, peak)


def with_images(images_ip, directions_i3, peak=1.0):
    return LightStack(np.asarray(images_ip, np.float32)[:, None, :, None], directions_i3, peak)


def image_error(stack, fitted, exact_kp):
    basis_ik = basis.real_harmonics(stack.directions_i3, fitted.degree)
    return float(np.abs(basis_ik @ (columns_of(fitted) - exact_kp)).max() / samples_of(stack).max())


def judge(stack, method, degree, factor=1.0, *, precision="mixed", bound=BOUND, **options):
    """Fit, check that all is finite and the bound holds, and return the error of the image."""
    asked = {"energy": factor, **options} if factor != 1.0 else options
    fitted = fit(stack, method, degree, **asked, precision=precision)
    found_kp, sample_ip = columns_of(fitted), samples_of(stack)
    assert np.isfinite(found_kp).all()
    energy_p = factor * reference.bound(sample_ip, np.ones(stack.n_light))
    assert (np.sum(found_kp**2, axis=0) <= energy_p * (1.0 + bound)).all()
    basis_ik = basis.real_harmonics(stack.directions_i3, degree)
    if method == "cls":
        exact_kp = reference.constrained(basis_ik, sample_ip, np.ones(stack.n_light), factor)[0]
    else:
        exact_kp = truncated_alike(basis_ik, sample_ip, energy_p, fitted.rank_hwc.ravel())
    return image_error(stack, fitted, exact_kp)


def truncated_alike(basis_ik, sample_ip, energy_p, rank_p):
    """Return the coefficients of eq. 31-35 at these ranks, having checked that no other rank is right.

    A rank is a step function of the samples: where a sum meets the bound within its rounding errors, either side is
    right. A component's error is a few eps32 times the norm of the samples, divided by its singular value.
    """
    rotation, sigma, z_rp = reference.decomposed(basis_ik, sample_ip, np.ones(len(sample_ip)))
    term_rp = (z_rp / sigma) ** 2
    error_rp = 4.0 * EPS32 * np.linalg.norm(sample_ip, axis=0) / sigma
    for p, rank in enumerate(rank_p):
        kept, tried = np.arange(len(sigma)) < rank, np.arange(len(sigma)) < rank + 1
        least = np.sum(np.maximum(np.sqrt(term_rp[kept, p]) - error_rp[kept, p], 0.0) ** 2)
        most = np.sum((np.sqrt(term_rp[tried, p]) + error_rp[tried, p]) ** 2)
        assert least <= energy_p[p] * (1.0 + BOUND), f"column {p} keeps {rank} components, beyond its bound"
        assert rank == len(sigma) or most >= energy_p[p] * (1.0 - BOUND), f"column {p} keeps {rank} and may keep more"
    return rotation @ np.where(np.arange(len(sigma))[:, None] < rank_p, z_rp / sigma, 0.0)
