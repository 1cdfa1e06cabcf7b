"""Lights that no fit sees: which they are, how far they are from those that are fitted, photographs of one light."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.dataset import CoefficientMap, LightStack, split_lights
from clrelight.errors import InputError, counted
from clrelight.light_codes import WITHIN
from clrelight.sampling import farthest_point_subset

HOLDOUTS = ("index", "place")
"""Ways to choose the lights that are held out; see `split_chosen`."""
SAME_DIRECTION = math.radians(0.05)
"""Photographs whose lights are no farther apart, in radians, are of one direction."""

_ROUNDING = 1e-9
_NOISE_ROWS = 16
_FEW_PAIRS = 1 << 22


def group_directions(directions_i3: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the number of each light's direction, counted as they first appear; chains of near ones are one."""
    n_light, reach = len(directions_i3), 2.0 * math.sin(SAME_DIRECTION / 2.0)
    # Whether there are any is seen along one axis, without SciPy, which is slow to load.
    order_i = np.argsort(directions_i3[:, 0], kind="stable")
    sorted_i3 = directions_i3[order_i]
    for step in range(1, n_light):
        apart_i3 = sorted_i3[step:] - sorted_i3[:-step]
        if not (apart_i3[:, 0] <= reach).any():
            return np.arange(n_light)
        if (np.linalg.norm(apart_i3, axis=1) <= reach).any():
            break
    else:
        return np.arange(n_light)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs_n2 = cKDTree(directions_i3).query_pairs(reach, output_type="ndarray")
    linked = coo_array((np.ones(len(pairs_n2), bool), pairs_n2.T), shape=(n_light, n_light))
    label_i = connected_components(linked, directed=False)[1]
    _, first_g, group_i = np.unique(label_i, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first_g))[group_i.reshape(-1)]


def split_chosen(
    directions_i3: NDArray[np.float64], holdout: int | None, lights: int | None = None, by: str = "index"
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the lights to fit and those held out; of the former only `lights` well-spread ones, in their order.

    Photographs of one direction are fitted together or held out together.

    Parameters
    ----------
    directions_i3 : ndarray, shape (n_light, 3), float64
        Unit vectors.
    holdout : int or None
        Hold out one direction in so many; None: none.
    lights : int, optional
        Fit so many only; the others are neither fitted nor held out.
    by : str
        ``"index"``: every K-th direction, in the order of the photographs (``index % K == K - 1``). ``"place"``: blocks
        of one direction in K, so that none that is held out is nearer to a fitted one than `typical_gap`. What lies
        in between is neither fitted nor held out.

    Raises
    ------
    InputError
        Nothing could be held out or nothing would be left to fit, or fewer than `lights` are.
    """
    if by not in HOLDOUTS:
        raise InputError(f"lights are held out by {' or '.join(HOLDOUTS)}, got {by!r}")
    if holdout is None and by != "index":
        raise InputError(f"holding out by {by} needs holdout, one direction in how many: such as 5")
    fitted, held = np.arange(len(directions_i3)), np.arange(0)
    if holdout is not None:
        group_i = group_directions(directions_i3)
        first_g = np.unique(group_i, return_index=True)[1]
        if len(first_g) < min(holdout, len(group_i)):
            hint = f"use at most {len(first_g)}" if len(first_g) > 1 else "one can only be fitted: leave holdout out"
            raise InputError(
                f"holdout {holdout} keeps none of {counted(len(first_g), 'direction')} out, of which there "
                f"{'is' if len(group_i) == 1 else 'are'} {counted(len(group_i), 'photograph')}; {hint}"
            )
        chosen = split_lights(len(first_g), holdout)
        if by == "place":
            chosen = _split_blocks(directions_i3[first_g], holdout)
        fitted, held = (np.flatnonzero(np.isin(group_i, groups)) for groups in chosen)
    if lights is None:
        return fitted, held
    if not 1 <= lights <= len(fitted):
        raise InputError(f"{len(fitted)} of {len(directions_i3)} lights are there to be fitted, got lights {lights}")
    return fitted[np.sort(farthest_point_subset(directions_i3[fitted], lights))], held


def _split_blocks(sites_g3: NDArray[np.float64], holdout: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the directions to fit, and those of the others that lie no nearer to them than the typical gap."""
    from scipy.spatial import cKDTree

    gap = typical_gap(sites_g3)
    chord = 2.0 * math.sin(min(gap, math.pi) / 2.0) * (1.0 - _ROUNDING)
    tree = cKDTree(sites_g3)
    # Centres of blocks: those that the index would choose, all of them where blocks are of one light; mixed, so that a
    # few come from everywhere. Patterns have strides of their own, which a stride through them could meet.
    mixed_g = np.random.default_rng(0).random(len(sites_g3))
    order = np.argsort(mixed_g + ~np.isin(np.arange(len(sites_g3)), split_lights(len(sites_g3), holdout)[1]))
    out_g = np.zeros(len(sites_g3), bool)
    for centre in order:
        out_g[tree.query_ball_point(sites_g3[centre], chord)] = True
        if out_g.sum() >= len(sites_g3) // holdout:
            break
    fitted = np.flatnonzero(~out_g)
    if not len(fitted):
        raise InputError(
            f"holding out by place leaves none of {len(sites_g3)} directions to fit: within {math.degrees(gap):.1f} "
            "degrees of one lie all others; hold out by index"
        )
    held = np.flatnonzero(out_g)
    return fitted, held[cKDTree(sites_g3[fitted]).query(sites_g3[held])[0] >= chord]


def typical_gap(directions_i3: NDArray[np.float64]) -> float:
    """Return how far, in radians, the middle of a gap between lights is from them.

    That is the median, by area, of the circles through three neighbouring lights that have no light inside: of a ring
    of lights around the zenith and the next one, about half their distance, however dense each of them is. Where
    lights are on one circle or fewer than four, the median distance to the nearest one.
    """
    from scipy.spatial import ConvexHull, QhullError, cKDTree

    sites_g3 = directions_i3[np.unique(group_directions(directions_i3), return_index=True)[1]]
    if len(sites_g3) == 1:
        return math.pi
    try:
        hull = ConvexHull(sites_g3)
    except (QhullError, ValueError):
        hull = None
    if hull is not None:
        # A facet's plane cuts the sphere in the circle through its corners; those of the unlit side are no gaps.
        radius_f = np.arccos(np.clip(-hull.equations[:, 3], -1.0, 1.0))
        between_f = radius_f < math.radians(60.0)
        if between_f.any():
            a_f3, b_f3, c_f3 = (sites_g3[hull.simplices[between_f, n]] for n in range(3))
            area_f = np.linalg.norm(np.cross(b_f3 - a_f3, c_f3 - a_f3), axis=1)
            order = np.argsort(radius_f[between_f])
            total_f = np.cumsum(area_f[order])
            return float(radius_f[between_f][order][np.searchsorted(total_f, total_f[-1] / 2.0)])
    chord_g = cKDTree(sites_g3).query(sites_g3, k=2)[0][:, 1]
    return float(np.median(2.0 * np.arcsin(np.clip(chord_g / 2.0, 0.0, 1.0))))


def distances_to(fitted_j3: NDArray[np.float64], held_i3: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the angle, in degrees, from each light to the nearest fitted one."""
    if len(fitted_j3) * len(held_i3) <= _FEW_PAIRS:
        chord_i = np.array([np.sqrt(np.min(np.sum((fitted_j3 - held_3) ** 2, axis=1))) for held_3 in held_i3])
    else:
        from scipy.spatial import cKDTree  # takes longer to load than as many pairs to look at

        chord_i = cKDTree(fitted_j3).query(held_i3)[0]
    return np.degrees(2.0 * np.arcsin(np.clip(chord_i / 2.0, 0.0, 1.0)))


def describe_distance(directions_i3: NDArray[np.float64], fitted: NDArray[np.intp], held: NDArray[np.intp]) -> str:
    """Return how far the lights held out lie from the fitted ones, for people."""
    away_i = distances_to(directions_i3[fitted], directions_i3[held])
    return (
        f"{counted(len(held), 'light')} held out, {np.median(away_i):.1f} degrees from the nearest of "
        f"{len(fitted)} fitted ones in the median, {away_i.max():.1f} at most"
    )


def note_distance(directions_i3: NDArray[np.float64], fitted: NDArray[np.intp], held: NDArray[np.intp]) -> str | None:
    """Return that lights held out are nearer to fitted ones than the gaps between photographs, where they are."""
    if not len(held):
        return None
    near, gap = (
        np.median(distances_to(directions_i3[fitted], directions_i3[held])),
        math.degrees(typical_gap(directions_i3)),
    )
    if near >= gap * (1.0 - 1e-6):
        return None
    return (
        f"the lights held out lie {near:.2g} degrees from the nearest fitted one, the middle of a gap between lights "
        f"{gap:.2g}: in the gaps the fit may do worse; --holdout-by place measures there"
    )


@dataclass(frozen=True)
class HoldoutRule:
    """Which lights of a stack a fit left out, as its file records it; attributes as of `split_chosen`."""

    holdout: int | None = None
    lights: int | None = None
    by: str = "index"

    def split(self, directions_i3: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the lights to fit and those held out."""
        return split_chosen(directions_i3, self.holdout, self.lights, self.by)

    def to_config(self) -> dict[str, Any]:
        """Return what is kept in a fit's ``config``: nothing where all lights are fitted."""
        if self.holdout is None and self.lights is None:
            return {}
        return {"holdout": {"every": self.holdout, "lights": self.lights, "by": self.by}}

    @classmethod
    def from_config(cls, config: Mapping[str, Any]) -> HoldoutRule | None:
        """Return the rule of a fit's ``config``, None where there is none that is understood."""
        kept = config.get("holdout")
        if not isinstance(kept, Mapping):
            return None
        every, lights, by = kept.get("every"), kept.get("lights"), kept.get("by", "index")
        numbers = all(value is None or (type(value) is int and 1 <= value < 1 << 31) for value in (every, lights))
        return cls(every, lights, by) if numbers and by in HOLDOUTS else None


def split_by_fit(stack: LightStack, coefficients: CoefficientMap) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the lights of a stack that a fit has seen, and those to measure it at.

    Of the stack that it was fitted to, they are those of the fit's record. Of others, all lights count as unseen but
    those of a direction that was fitted.
    """
    fitted_i3 = coefficients.directions_i3
    rule = HoldoutRule.from_config(coefficients.config)
    if rule is not None:
        try:
            fitted, held = rule.split(stack.directions_i3)
        except InputError:  # not that stack
            fitted = held = np.arange(0)
        if len(fitted) == len(fitted_i3) and np.allclose(stack.directions_i3[fitted], fitted_i3, rtol=0.0, atol=WITHIN):
            return fitted, held
    seen_i = distances_to(fitted_i3, stack.directions_i3) <= math.degrees(SAME_DIRECTION)
    return np.flatnonzero(seen_i), np.flatnonzero(~seen_i)


def describe_duplicates(stack: LightStack) -> tuple[dict[str, float], str] | None:
    """Return how many photographs share a direction with others, and their noise in dB: as facts and as a note.

    The noise is what they differ by: the root of their pooled variance, of code values in units of the peak, over rows
    spread over the image. None where every direction has one photograph.
    """
    group_i = group_directions(stack.directions_i3)
    count_g = np.bincount(group_i)
    if count_g.max() == 1:
        return None
    height = stack.image_shape[0]
    rows = np.unique(np.linspace(0, height - 1, min(height, _NOISE_ROWS)).astype(int))
    together = [np.flatnonzero(group_i == group) for group in np.flatnonzero(count_g > 1)]
    spread = freedom = 0.0
    for row in rows:
        tile_ip = np.clip(stack.read_rows(row, row + 1).reshape(stack.n_light, -1) / stack.peak, 0.0, 1.0)
        if stack.mask_hw is not None:
            tile_ip = tile_ip[:, np.repeat(stack.mask_hw[row], stack.image_shape[2])]
        for lights in together:
            values_ip = tile_ip[lights].astype(np.float64)
            values_ip -= values_ip[0]  # so that equal ones differ by nothing, not by the rounding of their mean
            spread += float(np.sum((values_ip - values_ip.mean(axis=0)) ** 2))
            freedom += (len(lights) - 1) * values_ip.shape[1]
    noise_db = -10.0 * math.log10(spread / freedom) if spread > 0.0 else math.inf
    photographs = int(count_g[count_g > 1].sum())
    facts = {"photographs": photographs, "directions": len(together), "noise_db": noise_db}
    told = f"whose noise is {noise_db:.1f} dB below the peak" if math.isfinite(noise_db) else "and do not differ"
    return facts, (
        f"{photographs} of {stack.n_light} photographs share their light's direction with others (within 0.05 degrees, "
        f"{len(together)} directions), {told}: they are fitted or held out together"
    )
