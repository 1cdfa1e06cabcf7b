"""Principal axes of all coefficients and channels of a pixel together, and how their table is coded."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.entropy.known_batches import plan_signed
from clrelight.codec.entropy.range_coding import Coder, Decoder, Encoder, ModelSet, Step, code_integers
from clrelight.codec.entropy.symbols import CLASSES, class_floor, classify, even_prior, geometric_prior
from clrelight.errors import PayloadError

ROTATION_UNIT = 127
"""The rotation of the channels is sent as whole numbers of this unit."""

MEAN_STEPS = 16
"""The mean is quantised this much finer than the planes, or 4, 16 or 64 times as fine as that: see `quantise_mean`."""
_MEAN_FINENESS = range(4)
_MEAN_MULTIPLIER = 0.15
"""Squared steps of error that a bit of the mean must save."""
STEP_RANGE = (2.0**-22, 2.0**3)
SCALES_PER_OCTAVE = 4
_COARSER = 1.4
"""Entries of the table are this much coarser than equal slopes ask: planes are solved against what is left of them."""
_ROUNDING = 0.3
_SAMPLED_PIXELS = 16384
MAX_ENTRY = 1 << 24
_FIRST_EXPECTED = 16 * 64
"""Sixteenths of an entry's size that are expected where nothing is known."""


@dataclass(frozen=True)
class Axes:
    """Principal axes as the decoder knows them.

    Attributes
    ----------
    entries_jd : ndarray, shape (n_axis, channel * n_component), int64
    scales_j : ndarray, shape (n_axis,), uint8
        An entry of axis j means ``entry / 2**(scale / 4)``.
    """

    entries_jd: NDArray[np.int64]
    scales_j: NDArray[np.uint8]

    @property
    def vectors_jd(self) -> NDArray[np.float64]:
        """The axes, near to unit length."""
        return self.entries_jd / np.exp2(self.scales_j[:, None] / SCALES_PER_OCTAVE)


def quantise_axes(
    vectors_jd: NDArray[np.float64],
    deviation_j: NDArray[np.float64],
    n_pixel: int,
    step: float,
    root_nn: NDArray[np.float64],
) -> Axes:
    """Return the axes in steps that cost the image what a step of the planes costs it.

    An error e of an entry of axis j adds ``n_pixel deviation_j^2 e^2`` to the squared error, one of a plane's sample
    adds e^2: equal slopes of distortion and bits ask for ``step / (deviation sqrt(n_pixel))``. An axis may come out as
    zeros. Errors e of a channel's components cost ``|root e|^2``: see `round_jointly`.
    """
    ratio = deviation_j * np.sqrt(n_pixel * np.mean(np.diag(root_nn) ** 2)) / (_COARSER * step)
    scales = np.clip(np.rint(SCALES_PER_OCTAVE * np.log2(np.maximum(ratio, 1.0))), 0, 80).astype(np.uint8)
    exact = vectors_jd * np.exp2(scales[:, None] / SCALES_PER_OCTAVE)
    return Axes(round_jointly(exact, root_nn, _ROUNDING), scales)


def round_jointly(exact_jd: NDArray[np.float64], root_nn: NDArray[np.float64], part: float = 0.5) -> NDArray[np.int64]:
    """Return whole numbers near to rows of one part for each channel, whose errors e cost ``|root e|^2``.

    Each makes up for what those after it were rounded by, as far as it can (Babai's nearest plane): `root_nn` is upper
    triangular. A fraction is rounded up that is more than 1 less `part`.
    """
    # One component of all rows and channels in a row.
    wanted_nr = exact_jd.reshape(-1, len(root_nn)).T.copy()
    rounded_nr = np.empty_like(wanted_nr)
    after_nn = np.triu(root_nn, 1) / np.diag(root_nn)[:, None]
    for n in range(len(root_nn) - 1, -1, -1):
        value = wanted_nr[n] + after_nn[n, n + 1 :] @ (wanted_nr[n + 1 :] - rounded_nr[n + 1 :])
        rounded_nr[n] = np.sign(value) * np.floor(np.abs(value) + part)
    return rounded_nr.T.reshape(exact_jd.shape).astype(np.int64)


def each_channel(rows_jd: NDArray[np.float64], matrix_nn: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rows whose part of each channel is multiplied by a matrix."""
    # As one product: of an array of three dimensions NumPy makes as many small ones as it has rows.
    return (rows_jd.reshape(-1, len(matrix_nn)) @ matrix_nn).reshape(rows_jd.shape)


def mean_steps(fineness: int) -> int:
    """Return how much finer than the planes the mean is quantised, by the number that bodies have for it, 0 to 3."""
    return MEAN_STEPS << 2 * fineness


def quantise_mean(
    mean_d: NDArray[np.float64], n_pixel: int, step: float, root_nn: NDArray[np.float64]
) -> tuple[int, NDArray[np.int64]]:
    """Return the fineness at which the mean is worth its bits, and the mean in those steps.

    Its error is in each of `n_pixel` pixels: the more there are, the finer it is to be. Errors cost as `round_jointly`
    says.
    """
    found: list[tuple[float, int, NDArray[np.int64]]] = []
    for fineness in _MEAN_FINENESS:
        exact_d = mean_d * (mean_steps(fineness) / step)
        if fineness and np.abs(exact_d).max(initial=0.0) > MAX_ENTRY / 2:
            break  # numbers that cannot be coded, or nearly
        entries_d = round_jointly(exact_d, root_nn)
        error_d = each_channel(exact_d - entries_d, root_nn.T) / mean_steps(fineness)
        bits = np.log2(1.0 + 2.0 * np.abs(entries_d)).sum()
        found.append((float(n_pixel * np.square(error_d).sum() + _MEAN_MULTIPLIER * bits), fineness, entries_d))
    _, fineness, entries_d = min(found, key=lambda each: each[0])
    return fineness, entries_d


def make_operator(
    inverse_kj: NDArray[np.float64], rotation_cc: NDArray[np.int8], vectors_jd: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return what makes coefficients of planes, (n_coeff, channel, n_plane), from what a body says of its axes.

    `inverse_kj` leads from the coordinates of the hemisphere's metric to coefficients; a mean may stand among the axes.
    PayloadError where float32 cannot hold it.
    """
    channel, component = len(rotation_cc), inverse_kj.shape[1]
    rotation = np.linalg.pinv(rotation_cc / ROTATION_UNIT)
    vectors_jdn = vectors_jd.reshape(-1, channel, component)
    operator_kcj: NDArray[np.float64] = np.einsum("kn,cd,jdn->kcj", inverse_kj, rotation, vectors_jdn, optimize=True)
    if not np.abs(operator_kcj).max() <= np.finfo(np.float32).max:
        raise PayloadError("a klt body holds values beyond float32's range")
    return operator_kcj


def code_vectors(coder: Coder, shape: tuple[int, int, int], entries_rcj: NDArray[np.int64] | None) -> NDArray[np.int64]:
    """Code vectors of shape (rows, channel, component) one after another, each entry near others of its size.

    The context of an entry is the size of the same one, its left and its right neighbour in the row before. Of old
    bodies: those that are written now have `code_by_shells`.
    """
    rows, channel, component = shape
    models = ModelSet(_entry_prior())
    signs = ModelSet(even_prior(1, 2))
    entries = np.zeros(shape, np.int64)
    before = np.zeros((channel, component + 2), np.int64)
    before[:, 1:-1] = 4
    for row in range(rows):
        activity = 2 * before[:, 1:-1] + before[:, :-2] + before[:, 2:]
        entries[row] = _code_entries(coder, models, signs, activity, None if entries_rcj is None else entries_rcj[row])
        # Half of what was expected stays, so that one row of zeros does not end the expectation.
        before[:, 1:-1] = (before[:, 1:-1] + 3 * np.abs(entries[row])) >> 2
    return entries


def code_by_shells(
    coder: Encoder | Decoder, shape: tuple[int, int, int], entries_rcj: NDArray[np.int64] | None
) -> NDArray[np.int64]:
    """Code vectors of shape (rows, channel, component) as `code_vectors` does, the first one from smooth to rough.

    Of the first vector a shell of components, those of one degree, is expected to be as large as the shell before it:
    a map of a high degree has hundreds of entries that are 0, and nothing else says so. What is expected is in
    sixteenths.
    """
    rows, channel, component = shape
    if isinstance(coder, Encoder):
        assert entries_rcj is not None
        coder.put(_plan_shells(entries_rcj))
        return entries_rcj
    models = ModelSet(_shell_prior())
    signs = ModelSet(even_prior(1, 2))
    entries = np.zeros(shape, np.int64)
    if not rows:
        return entries
    expected_c = np.full(channel, _FIRST_EXPECTED)
    for part in _shells(component):
        activity = np.repeat(expected_c[:, None], part.stop - part.start, axis=1)
        found = _code_entries(coder, models, signs, activity, None)
        entries[0][:, part] = found
        expected_c = 16 * np.abs(found).sum(axis=1) // (part.stop - part.start)
    before = np.zeros((channel, component + 2), np.int64)
    before[:, 1:-1] = 16 * np.abs(entries[0])
    for row in range(1, rows):
        activity = (2 * before[:, 1:-1] + before[:, :-2] + before[:, 2:]) >> 2
        entries[row] = _code_entries(coder, models, signs, activity, None)
        before[:, 1:-1] = (before[:, 1:-1] + 16 * np.abs(entries[row])) >> 1
    return entries


def _shells(component: int) -> list[slice]:
    """Return the components of each degree, as far as there are some."""
    return [slice(n * n, min((n + 1) ** 2, component)) for n in range(math.isqrt(component - 1) + 1)]


def _plan_shells(entries_rcj: NDArray[np.int64]) -> list[Step]:
    """Return what makes the bytes of `code_by_shells`; ValueError where an entry is too large."""
    rows, channel, component = entries_rcj.shape
    sizes_rcj = np.abs(entries_rcj)
    if not rows:
        return []
    if sizes_rcj.max() > MAX_ENTRY:
        raise ValueError(f"entries of tables should be {MAX_ENTRY} at most, got {sizes_rcj.max()}")
    parts, expected_c, activities = _shells(component), np.full(channel, _FIRST_EXPECTED), []
    for part in parts:
        activities.append(np.repeat(expected_c, part.stop - part.start))
        expected_c = 16 * sizes_rcj[0, :, part].sum(axis=1) // (part.stop - part.start)
    before = np.zeros((rows, channel, component + 2), np.int64)
    inner = before[:, :, 1:-1]
    inner[0] = 16 * sizes_rcj[0]
    for row in range(1, rows):
        inner[row] = (inner[row - 1] + 16 * sizes_rcj[row]) >> 1
    later = before[:-1]
    activities.append(((2 * later[:, :, 1:-1] + later[:, :, :-2] + later[:, :, 2:]) >> 2).ravel())
    contexts = classify(np.minimum(np.concatenate(activities), 1 << 20))
    values = np.concatenate([*(entries_rcj[0, :, part].ravel() for part in parts), entries_rcj[1:].ravel()])
    lengths = [channel * (part.stop - part.start) for part in parts] + [channel * component] * (rows - 1)
    return plan_signed(_shell_prior(), contexts, values, lengths)


def _code_entries(
    coder: Coder,
    models: ModelSet,
    signs: ModelSet,
    activity_cj: NDArray[np.int64],
    given_cj: NDArray[np.int64] | None,
) -> NDArray[np.int64]:
    """Code entries in the contexts of their activity, and the signs of those that are not 0."""
    given = None if given_cj is None else given_cj.ravel()
    contexts = classify(np.minimum(activity_cj.ravel(), 1 << 20))
    sizes = code_integers(coder, models, contexts, None if given is None else np.abs(given))
    nonzero = np.flatnonzero(sizes)
    negative = coder.code(
        signs, np.zeros(len(nonzero), np.int32), None if given is None else (given[nonzero] < 0).astype(np.int32)
    )
    if sizes.size and sizes.max() > MAX_ENTRY:
        raise PayloadError("the range-coded bytes are damaged: a table entry is too large")
    values = sizes.astype(np.int64)
    values[nonzero[negative == 1]] *= -1
    return values.reshape(activity_cj.shape)


@functools.cache
def _entry_prior() -> NDArray[np.int64]:
    means = [Fraction(9, 20) * class_floor(i) for i in range(1, CLASSES)]
    return geometric_prior([Fraction(3, 20), *(min(mean, Fraction(10**6)) for mean in means)])


@functools.cache
def _shell_prior() -> NDArray[np.int64]:
    means = [Fraction(9, 160) * class_floor(i) for i in range(1, CLASSES)]
    return geometric_prior([Fraction(1, 30), *(min(mean, Fraction(10**6)) for mean in means)])


def sample_stride(n_pixel: int) -> int:
    """Return which n-th pixels statistics are made of; odd, so that no column of the image is preferred."""
    return max(n_pixel // _SAMPLED_PIXELS, 1) | 1 if n_pixel > _SAMPLED_PIXELS else 1
