"""Deleting basis functions, as noise-resistant-fitting (section IV-D) argues against it: condition and norms."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from clrelight.harmonics.basis import evaluate_basis
from clrelight.harmonics.hemisphere import hemisphere_autocorrelation
from clrelight.harmonics.index import coefficient_index
from clrelight.reproduction.parts import Part, cls_norms, name_of, prose, ring_columns, table
from clrelight.threads import on_one_thread

LIGHTS = 256
DIGITS = 1e-9
"""Condition numbers within this of the least are alike to the paper's ten digits, but for the last."""
TRIED = 200
"""Of the candidates that are alike, so many have their coefficients computed, evenly spread."""


def deletion() -> Part:
    """Return the tables: one function of 25 and of 49, two and four of 49."""
    samples_ip, directions_i3 = ring_columns(LIGHTS)
    with on_one_thread():
        one = [line for degree in (4, 6) for line in _single(degree, samples_ip, directions_i3)]
        several, verdicts = [], []
        for count in (1, 2, 3, 4):
            line, facts = _several(6, count, samples_ip, directions_i3)
            several.append(line)
            verdicts.append(facts)
    pair, four = verdicts[1], verdicts[3]
    headers = ["n", "deleted", "condition of A", "mean ‖c‖", "largest ‖c‖", "mean ‖c‖², beside all functions"]
    of_sets = ["deleted of 49", "sets", "least condition", "sets that have it", "mean ‖c‖ among these", "largest ‖c‖"]
    text = [
        "### Deleting basis functions (section IV-D)",
        "",
        prose(f"""Condition number of A over the hemisphere, and mean and largest ‖c‖ of the ring's pixels (48²,
        {LIGHTS} lights) by least squares without the functions."""),
        "",
        table(headers, one),
        "",
        prose("""Sloan's third function, y10, is none of its own: y00, y20 and y30 do the same, in condition and in
        norm. At n = 25 one deletion takes most of the norm away, as Sloan et al. found; at n = 49 a norm
        stays that is far above that of CLS, as the paper says."""),
        "",
        table([*of_sets, "best set"], several),
        "",
        prose(f"""The paper prints more than 100 pairs that are alike to 10 digits, and two of them with norms 6.51
        and 42: here {pair["alike"]} pairs are, whose mean norms are {pair["least"]:.3g} to
        {pair["most"]:.3g}; of one pixel the norms are up to {pair["apart"]:.3g} times apart. Why so many
        are alike: A falls into blocks by order m, and as soon as the worst block is mended the next one
        decides, whatever else is deleted. Of 4 out of 49 the paper counts "more than 200,000" sets:
        {four["sets"]}; {four["alike"]} of them are alike, with norms from {four["least"]:.3g} to
        {four["most"]:.3g} among those tried. CLS has {four["cls"]:.3g} without a search."""),
    ]
    verdicts_of = {
        "more than 100 pairs of 49 are alike": pair["alike"] > 100,
        "norms of one pixel among them are as far apart as 42 and 6.51": pair["apart"] > 42 / 6.51,
        "more than 200 000 sets of 4": four["sets"] > 200_000,
        "deleting y10 does much for 25 functions": _cut(one, "25") > 10.0,
    }
    numbers = {
        "pairs": float(verdicts[1]["sets"]),
        "alike": float(pair["alike"]),
        "apart": float(pair["apart"]),
        "fours": float(four["sets"]),
        "y10": _cut(one, "25"),
        "y10 of 49": _cut(one, "49"),
    }
    return Part(
        "deletion", "\n".join(text), {what: bool(holds) for what, holds in verdicts_of.items()}, numbers=numbers
    )


def _cut(lines: list[list[str]], count: str) -> float:
    """Return by how much y10 alone lowers the mean squared norm."""
    line = next(each for each in lines if each[:2] == [count, "y10"])
    return float(line[-1].split(", ")[1].split()[0])


def condition_numbers(matrix_kk: NDArray[np.float64], sets: Sequence[tuple[int, ...]]) -> NDArray[np.float64]:
    """Return the condition number of a block-diagonal matrix without the rows and columns of each set.

    Largest and least eigenvalue are those of a block; a block has few functions, so few sets of its own to try.
    """
    blocks = list(_blocks(matrix_kk))
    block_of = {k: number for number, members in enumerate(blocks) for k in members}
    extremes: dict[tuple[int, frozenset[int]], tuple[float, float]] = {}

    def of_block(number: int, gone: frozenset[int]) -> tuple[float, float]:
        key = number, gone
        if key not in extremes:
            left = [k for k in blocks[number] if k not in gone]
            values = np.linalg.eigvalsh(matrix_kk[np.ix_(left, left)]) if left else np.array([np.inf, -np.inf])
            extremes[key] = (values[0], values[-1]) if left else (np.inf, -np.inf)
        return extremes[key]

    whole = [of_block(number, frozenset()) for number in range(len(blocks))]
    order_low = sorted(range(len(blocks)), key=lambda number: whole[number][0])
    order_high = sorted(range(len(blocks)), key=lambda number: -whole[number][1])
    found = np.empty(len(sets))
    for place, gone in enumerate(sets):
        touched: dict[int, list[int]] = {}
        for k in gone:
            touched.setdefault(block_of[k], []).append(k)
        low = next((whole[number][0] for number in order_low if number not in touched), np.inf)
        high = next((whole[number][1] for number in order_high if number not in touched), -np.inf)
        for number, members in touched.items():
            least, most = of_block(number, frozenset(members))
            low, high = min(low, least), max(high, most)
        found[place] = high / low
    return found


def _blocks(matrix_kk: NDArray[np.float64]) -> Iterator[list[int]]:
    left = set(range(len(matrix_kk)))
    while left:
        reached, new = set(), {min(left)}
        while new:
            reached |= new
            new = {k for each in new for k in np.flatnonzero(np.abs(matrix_kk[each]) > 1e-14).tolist()} - reached
        left -= reached
        yield sorted(reached)


def _norms(
    degree: int, gone: Sequence[int], samples_ip: NDArray[np.float64], directions_i3: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return |c| of each column by least squares without some functions."""
    triangle_kk, turned_kp = _triangle(degree, samples_ip.tobytes(), directions_i3.tobytes(), len(samples_ip))
    left = np.delete(triangle_kk, list(gone), axis=1)
    return np.linalg.norm(np.linalg.lstsq(left, turned_kp, rcond=None)[0], axis=0)


@functools.lru_cache(maxsize=4)
def _triangle(
    degree: int, samples: bytes, directions: bytes, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return R and Q' beta of ``Y = Q R``: the residual outside Q's span is the same whatever is deleted."""
    directions_i3 = np.frombuffer(directions).reshape(count, 3)
    turned_ik, triangle_kk = np.linalg.qr(evaluate_basis(directions_i3, degree))
    return triangle_kk, turned_ik.T @ np.frombuffer(samples).reshape(count, -1)


def _single(degree: int, samples_ip: NDArray[np.float64], directions_i3: NDArray[np.float64]) -> list[list[str]]:
    matrix_kk = hemisphere_autocorrelation(degree)
    count = len(matrix_kk)
    conditions = condition_numbers(matrix_kk, [(k,) for k in range(count)])
    plain = _norms(degree, (), samples_ip, directions_i3)
    worst = float(np.linalg.cond(matrix_kk))
    lines = [_line(count, "none", worst, plain, plain)]
    wanted = {coefficient_index(1, 0), *np.argsort(conditions, kind="stable")[:5].tolist()}
    for k in sorted(wanted, key=lambda each: conditions[each]):
        lines.append(_line(count, name_of(k), conditions[k], _norms(degree, (k,), samples_ip, directions_i3), plain))
    return lines


def _line(count: int, name: str, condition: float, norm_p: NDArray, plain_p: NDArray) -> list[str]:
    square, before = float(np.mean(norm_p**2)), float(np.mean(plain_p**2))
    return [
        str(count),
        name,
        f"{condition:.3g}",
        f"{norm_p.mean():.3g}",
        f"{norm_p.max():.3g}",
        f"{square:.3g}, {before / square:.3g} times less",
    ]


def _several(
    degree: int, count: int, samples_ip: NDArray[np.float64], directions_i3: NDArray[np.float64]
) -> tuple[list[str], dict[str, float]]:
    matrix_kk = hemisphere_autocorrelation(degree)
    sets = list(itertools.combinations(range(len(matrix_kk)), count))
    conditions = condition_numbers(matrix_kk, sets)
    alike = np.flatnonzero(conditions <= conditions.min() * (1.0 + DIGITS))
    tried = alike[np.unique(np.linspace(0, len(alike) - 1, min(TRIED, len(alike))).astype(int))]
    norms = [_norms(degree, sets[place], samples_ip, directions_i3) for place in tried]
    means = np.array([norm_p.mean() for norm_p in norms])
    best = int(np.argmin(means))
    apart_p = np.max(norms, axis=0) / np.maximum(np.min(norms, axis=0), 1e-12)
    facts = {"sets": len(sets), "alike": len(alike), "least": means.min(), "most": means.max(), "apart": apart_p.max()}
    facts["cls"] = float(cls_norms(degree, samples_ip, directions_i3).mean())
    line = [
        str(count),
        f"{len(sets)}",
        f"{conditions.min():.6g}",
        f"{len(alike)}" + (f" ({len(tried)} tried)" if len(tried) < len(alike) else ""),
        f"{means.min():.3g} to {means.max():.3g}",
        f"{max(norm_p.max() for norm_p in norms):.3g}",
        " ".join(name_of(k) for k in sets[tried[best]]),
    ]
    return line, facts
