"""Normals of pixels that are matte and glossy at once: Gauss-Newton steps on each pixel's own reflectance.

A sample is a sum of a few reflectances with weights that are not negative (as of a dictionary: Hui and Sankaranarayanan
2017), so that gloss is explained instead of left out; what is left of shadows and of light that other parts send on
counts the less the further it is off. ``variation/reflectance.cl`` is the same on a device.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.variation.normals import DARK, LEAST_DETERMINANT, LOST, SHADOW, PixelNormals, order_limits

MATTE_NAMES = ("Lambert", "limb-darkened", "Lommel-Seeliger")
"""The matte terms ``s``, ``s^2`` and ``s / (s + v)`` with s and v the cosines to the light and to the camera."""
ROUGHNESS = (0.1, 0.2, 0.35, 0.6)
"""Widths ``a`` of the lobes of gloss, from polished to satin."""
PULL = 1.6
"""How far a round of coordinate descent goes beyond the least of each unknown, which takes fewer rounds."""
HELD = 0.1
"""Residual at which a light that was left out counts half as wrong."""
LEAST_GLOSSY = 12
"""Lights from which on gloss is looked for: below, its terms would explain whatever there is."""
_RIDGE, _DAMPING, _MOST_TURN, _LEAST_SEEN, _TINY = 1e-4, 1e-3, 0.15, 0.1, 1e-12


@dataclass(frozen=True)
class Steps:
    """How far to go.

    Attributes
    ----------
    scales : tuple of float
        Residual, as a share of model and reference, at which a weight has halved, step by step.
    rounds : int
        Of coordinate descent in a step; a third of those before the first.
    """

    scales: tuple[float, ...]
    rounds: int


STEPS = Steps((0.3, 0.15, 0.08, 0.05, 0.03, 0.03), 10)
"""For all pixels of a stack."""
MORE_STEPS = Steps((0.3, 0.2, 0.15, 0.1, 0.08, 0.06, 0.05, 0.04, 0.03, 0.03, 0.03, 0.03), 16)
"""To tell laws apart."""


@dataclass(frozen=True)
class Law:
    """Which reflectances pixels are sums of, and from where they are seen.

    Attributes
    ----------
    matte : tuple of bool
        Which of the three matte terms are used.
    glossy : bool
        Whether the lobes are.
    field : float
        Angle in degrees that the longer side of the images takes in the camera; 0: a camera far away.
    """

    matte: tuple[bool, bool, bool] = (True, False, False)
    glossy: bool = True
    field: float = 0.0

    @property
    def text(self) -> str:
        """Return what a report calls it."""
        names = [name for name, used in zip(MATTE_NAMES, self.matte, strict=True) if used]
        seen = f"seen over {self.field:g}°" if self.field else "seen from afar"
        return f"{' + '.join(names)}{' + gloss' if self.glossy else ''}, {seen}"


@dataclass(frozen=True)
class PixelLaw:
    """Normals as of a law, and how well lights that were left out are predicted.

    Attributes
    ----------
    found : PixelNormals
        Albedo is that of the matte terms.
    error, count : float
        Sum over lit samples that were left out of ``u / (1 + u)``, ``u = (residual / held)^2``, and how many they are.
    """

    found: PixelNormals
    error: float
    count: float


def lobe_table() -> NDArray[np.float64]:
    """Return ``a^2 - 1`` and ``a^4`` of each lobe."""
    a_j = np.array(ROUGHNESS)
    return np.stack([a_j**2 - 1.0, a_j**4], axis=1)


def view_vectors(rows_p: NDArray, columns_p: NDArray, shape: tuple[int, int], field: float) -> NDArray[np.float32]:
    """Return unit vectors from pixels to the camera, (P, 3), whose longer side takes `field` degrees."""
    height, width = shape
    slope = np.tan(np.radians(field) / 2.0) / (max(height, width) / 2.0)
    x_p, y_p = columns_p - (width - 1) / 2.0, (height - 1) / 2.0 - rows_p
    view_p3 = np.stack([-slope * x_p, -slope * y_p, np.ones(len(x_p))], axis=1)
    return (view_p3 / np.linalg.norm(view_p3, axis=1, keepdims=True)).astype(np.float32)


def fit_law(
    samples_cip: NDArray[np.floating],
    lights: NDArray[np.floating],
    view_p3: NDArray[np.floating],
    law: Law,
    *,
    fitted_i: NDArray[np.bool_] | None = None,
    most: float = np.inf,
    floor: float = 0.0,
    steps: Steps = STEPS,
    held: float = HELD,
) -> PixelLaw:
    """Return the normals of pixels by a law of their reflectance.

    Parameters
    ----------
    samples_cip : ndarray, shape (channel, n_light, P)
        Linear radiance in units of the peak; under near lights times the squared distance.
    lights : ndarray, shape (n_light, 3) or (n_light, P, 3)
        Unit vectors to the lights, of all pixels or of each.
    view_p3 : ndarray, shape (P, 3)
        Unit vectors to the camera.
    law : Law
    fitted_i : ndarray, shape (n_light,), bool, optional
        False: a light that is left out, and predicted.
    most : float
        Samples from here on are clipped, and left out.
    floor : float
        What shadows hold of light from elsewhere, as a share of the reference.
    steps : Steps
    held : float
        Residual, as a share of model and reference, at which a light that was left out counts as half wrong.
    """
    count = samples_cip.shape[2]
    lights_ip3 = np.broadcast_to(lights[:, None] if lights.ndim == 2 else lights, (len(lights), count, 3))
    used_i = np.ones(len(lights), bool) if fitted_i is None else fitted_i
    grey_ip = samples_cip.mean(axis=0, dtype=np.float64)
    clipped_ip = np.any(samples_cip >= most, axis=0)
    reference_p = np.sort(grey_ip[used_i], axis=0)[order_limits(int(used_i.sum()))[0] - 1]
    offset_p = np.minimum(grey_ip[used_i].min(axis=0), floor * reference_p)
    lit_ip = (grey_ip - offset_p) / np.maximum(reference_p, _TINY)
    usable_ip = (lit_ip > SHADOW) & ~clipped_ip
    normals_p3 = _plain(grey_ip[used_i], lights_ip3[used_i])
    weight_pm = np.zeros((count, len(law.matte) + len(ROUGHNESS)))
    for step in range(-1, len(steps.scales)):
        frame = _frame(normals_p3)
        terms_mip, cosine_ip = _terms(normals_p3, frame, lights_ip3[used_i], view_p3, weight_pm, law)
        model_ip = np.einsum("mip,pm->ip", terms_mip[:-2], weight_pm)
        lit, usable = lit_ip[used_i], usable_ip[used_i]
        if step < 0:
            weight_ip = (usable & (cosine_ip > 0.5 * DARK)) / (lit + 1.0) ** 2
        else:
            off_ip = (lit - model_ip) / (model_ip + 1.0) / steps.scales[step]
            weight_ip = (usable & (cosine_ip > DARK)) / (model_ip + 1.0) ** 2 / (1.0 + off_ip**2)
        weight_pm, turn_p2 = _descend(terms_mip, weight_ip, lit, weight_pm, (3 if step < 0 else 1) * steps.rounds)
        normals_p3 = normals_p3 + turn_p2[:, :1] * frame[0] + turn_p2[:, 1:] * frame[1]
        normals_p3 /= np.maximum(np.linalg.norm(normals_p3, axis=1, keepdims=True), _TINY)
    terms_mip, cosine_ip = _terms(normals_p3, _frame(normals_p3), lights_ip3, view_p3, weight_pm, law)
    model_ip = np.einsum("mip,pm->ip", terms_mip[:-2], weight_pm)
    matte_ip = np.einsum("mip,pm->ip", terms_mip[: len(law.matte)], weight_pm[:, : len(law.matte)])
    residual_ip = np.abs(lit_ip - model_ip)
    shown_ip = usable_ip & (cosine_ip > DARK)
    held_ip = ((residual_ip / (model_ip + 1.0) / held) ** 2)[~used_i]
    error = float(np.sum(np.where(shown_ip[~used_i], held_ip / (1.0 + held_ip), 0.0)))
    lost_p = np.minimum(np.where(clipped_ip, LOST, residual_ip), LOST)[used_i].sum(axis=0)
    span_ip = used_i[:, None] * shown_ip * (matte_ip / (model_ip + 1.0) ** 2) ** 2
    weight_ip = span_ip / (1.0 + (residual_ip / (model_ip + 1.0) / steps.scales[-1]) ** 2) * model_ip
    seen_p = np.maximum(np.sum(normals_p3 * view_p3, axis=1), _LEAST_SEEN)
    frontal_p = weight_pm[:, :3] @ np.array((*law.matte[:2], 0.0)) + law.matte[2] * weight_pm[:, 2] / (1.0 + seen_p)
    whole_p = np.sum(weight_ip * model_ip, axis=0)
    albedo_pc = np.einsum("ip,cip->pc", weight_ip, samples_cip - offset_p)
    albedo_pc *= np.where(whole_p > _TINY, frontal_p / np.maximum(whole_p, _TINY), 0.0)[:, None]
    is_found_p = reference_p > _TINY
    found = PixelNormals(
        np.where(is_found_p[:, None], normals_p3, 0.0).astype(np.float32),
        np.maximum(albedo_pc, 0.0).astype(np.float32),
        np.where(is_found_p, 1.0 - lost_p / (LOST * len(lights)), 0.0).astype(np.float32),
    )
    return PixelLaw(found, error, float(np.count_nonzero(shown_ip[~used_i])))


def _plain(grey_ip: NDArray[np.float64], lights_ip3: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the directions of the plain least-squares normals, (P, 3)."""
    energy_p33 = np.einsum("ipa,ipb->pab", lights_ip3, lights_ip3, optimize=True)
    energy_p33 = energy_p33 / np.trace(energy_p33, axis1=1, axis2=2)[:, None, None]
    right_p3 = np.einsum("ipa,ip->pa", lights_ip3, grey_ip, optimize=True)
    is_sound_p = np.linalg.det(energy_p33) > LEAST_DETERMINANT
    energy_p33 = np.where(is_sound_p[:, None, None], energy_p33, np.eye(3))
    found_p3 = np.where(is_sound_p[:, None], np.linalg.solve(energy_p33, right_p3[..., None])[..., 0], [0.0, 0.0, 1.0])
    return found_p3 / np.maximum(np.linalg.norm(found_p3, axis=1, keepdims=True), _TINY)


def _frame(normals_p3: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors across each normal (Duff and others 2017)."""
    x_p, y_p, z_p = normals_p3.T
    sign_p = np.where(z_p >= 0.0, 1.0, -1.0)
    a_p = -1.0 / (sign_p + z_p)
    c_p = x_p * y_p * a_p
    first_p3 = np.stack([1.0 + sign_p * x_p * x_p * a_p, sign_p * c_p, -sign_p * x_p], axis=1)
    return first_p3, np.stack([c_p, sign_p + y_p * y_p * a_p, -y_p], axis=1)


def _terms(
    normals_p3: NDArray[np.float64],
    frame: tuple[NDArray[np.float64], NDArray[np.float64]],
    lights_ip3: NDArray[np.floating],
    view_p3: NDArray[np.floating],
    weight_pm: NDArray[np.float64],
    law: Law,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return terms, how their weighted sum changes as normals turn along a frame, and the lights' cosines."""
    raw_ip = np.einsum("ipa,pa->ip", lights_ip3, normals_p3)
    s_ip, lit_ip = np.maximum(raw_ip, 0.0), raw_ip > 0.0
    facing_p = np.sum(normals_p3 * view_p3, axis=1)
    seen_p = np.maximum(facing_p, _LEAST_SEEN)
    wide_ip = np.sqrt(np.maximum(2.0 + 2.0 * np.einsum("ipa,pa->ip", lights_ip3, view_p3), 0.16))
    half_ip, visible_ip = np.maximum((raw_ip + facing_p) / wide_ip, 0.0), 4.0 / wide_ip**2
    both_ip = 1.0 / (s_ip + seen_p)
    terms = [used * each_ip for used, each_ip in zip(law.matte, (s_ip, s_ip**2, s_ip * both_ip), strict=True)]
    weight_mp = weight_pm.T * np.array([*law.matte, *(law.glossy for _ in ROUGHNESS)], float)[:, None]
    by_view_ip = -weight_mp[2] * s_ip * both_ip**2
    by_light_ip = weight_mp[0] + 2.0 * weight_mp[1] * s_ip + weight_mp[2] * seen_p * both_ip**2
    by_half_ip = np.zeros_like(s_ip)
    for (e, peak), weight_p in zip(lobe_table(), weight_mp[len(law.matte) :], strict=True):
        x_ip = 1.0 / (half_ip**2 * e + 1.0)
        lobe_ip = x_ip**2 * visible_ip * peak * law.glossy
        terms.append(lobe_ip * s_ip)
        by_light_ip = by_light_ip + weight_p * lobe_ip
        by_half_ip -= weight_p * 4.0 * half_ip * e * x_ip * lobe_ip * s_ip
    by_half_ip /= wide_ip
    for across_p3 in frame:
        light_ip = np.einsum("ipa,pa->ip", lights_ip3, across_p3)
        view_p = np.sum(across_p3 * view_p3, axis=1)
        terms.append(lit_ip * by_light_ip * light_ip + by_half_ip * (light_ip + view_p) + by_view_ip * view_p)
    return np.stack(terms), raw_ip


def _descend(
    terms_mip: NDArray[np.float64],
    weight_ip: NDArray[np.float64],
    lit_ip: NDArray[np.float64],
    start_pm: NDArray[np.float64],
    rounds: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return weights that are not negative and turns (P, 2), by coordinate descent on the weighted squares."""
    n_weight = start_pm.shape[1]
    gram_pmk = np.einsum("mip,kip,ip->pmk", terms_mip, terms_mip, weight_ip, optimize=True)
    right_pm = np.einsum("mip,ip->pm", terms_mip, weight_ip * lit_ip)
    own_pm = np.einsum("pmm->pm", gram_pmk).copy()
    index = np.arange(n_weight + 2)
    damped_pm = np.empty_like(own_pm)
    damped_pm[:, :n_weight] = _RIDGE * own_pm[:, :n_weight].sum(axis=1, keepdims=True) + 1e-9
    damped_pm[:, n_weight:] = _DAMPING * own_pm[:, n_weight:].sum(axis=1, keepdims=True) + 1e-9
    gram_pmk[:, index, index] += damped_pm
    found_pm = np.concatenate([start_pm, np.zeros((len(start_pm), 2))], axis=1)
    for _ in range(rounds):
        for m in range(n_weight + 2):
            left_p = right_pm[:, m] - np.sum(gram_pmk[:, m] * found_pm, axis=1)
            found_pm[:, m] += PULL * left_p / gram_pmk[:, m, m]
            if m < n_weight:
                np.maximum(found_pm[:, m], 0.0, out=found_pm[:, m])
    turn_p2 = found_pm[:, n_weight:]
    size_p = np.linalg.norm(turn_p2, axis=1, keepdims=True)
    return found_pm[:, :n_weight], turn_p2 * np.minimum(1.0, _MOST_TURN / np.maximum(size_p, _TINY))
