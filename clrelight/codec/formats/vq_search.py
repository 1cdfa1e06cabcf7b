"""Design a codebook by splitting and Lloyd's algorithm (Linde, Buzo and Gray 1980), and search it on a device."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import group_size, round_up, slabs
from clrelight.codec.transforms.vectors import spread_sample
from clrelight.device import Device
from clrelight.threads import on_one_thread

SAMPLES, SAMPLES_PER_WORD = 16384, 16
"""Vectors that the design looks at: the larger of the first, and of the second for each codeword."""

SPLIT_PASSES, FINAL_PASSES = 4, 32
LEAST_GAIN = 5e-4
"""Relative gain of a pass below which no more are made."""

LEFT_OUT, FEW = 0.03, 1024
"""Part of the vectors' variance that the design does not look at, where there are not few of them."""

ROWS = 4


def design_codebook(vectors_dp: NDArray[np.float32], bits: int, device: Device) -> NDArray[np.float32]:
    """Return ``2**bits`` codewords (j, d) for the vectors, always the same ones.

    From one codeword, the mean, each round splits all along their dimension of largest variance and improves them by
    Lloyd's algorithm: for a sample, along the axes that it needs. The last pass sees all of all vectors.
    """
    sample_dp = vectors_dp[:, spread_sample(vectors_dp.shape[1], max(SAMPLES, SAMPLES_PER_WORD << bits))]
    axes_rd = _principal_axes(sample_dp)
    codebook_jr = _design_by_sample(np.ascontiguousarray(axes_rd @ sample_dp), bits, device)
    codes_p, squares_p = search_codebook(axes_rd @ vectors_dp, codebook_jr, device)
    return _improve(vectors_dp, len(codebook_jr), codes_p, squares_p).astype(np.float32)


def _principal_axes(sample_dp: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the axes (r, d) that hold all but a little of what vectors differ by: distances are those along them."""
    if sample_dp.shape[1] < FEW:
        return np.eye(len(sample_dp), dtype=np.float32)
    with on_one_thread():
        deviation_dp = sample_dp - sample_dp.mean(axis=1, dtype=np.float64)[:, None].astype(np.float32)
        energy_r, axes_dr = np.linalg.eigh((deviation_dp @ deviation_dp.T).astype(np.float64))
    left_r = np.cumsum(np.maximum(energy_r, 0.0))
    first = min(int(np.searchsorted(left_r, LEFT_OUT * left_r[-1], side="right")), len(left_r) - 1)
    return np.ascontiguousarray(axes_dr[:, first:].T[::-1], np.float32)


def _design_by_sample(sample_dp: NDArray[np.float32], bits: int, device: Device) -> NDArray[np.float32]:
    """Return ``2**bits`` codewords (j, d) for a sample."""
    codebook_jd = sample_dp.mean(axis=1, dtype=np.float64)[None]
    codes_p = np.zeros(sample_dp.shape[1], np.uint16)
    for step in range(bits):
        variance_jd = _cell_means(np.square(sample_dp, dtype=np.float64), codes_p, len(codebook_jd))[0]
        variance_jd -= np.square(codebook_jd)
        widest_j = variance_jd.argmax(axis=1)
        shift_jd = np.zeros_like(codebook_jd)
        rows = np.arange(len(codebook_jd))
        shift_jd[rows, widest_j] = 0.5 * np.sqrt(np.maximum(variance_jd[rows, widest_j], 0.0))
        codebook_jd = np.concatenate([codebook_jd - shift_jd, codebook_jd + shift_jd])
        before = np.inf
        for _ in range(FINAL_PASSES if step == bits - 1 else SPLIT_PASSES):
            codes_p, squares_p = search_codebook(sample_dp, codebook_jd.astype(np.float32), device)
            error = float(squares_p.sum(dtype=np.float64))
            if not error < (1.0 - LEAST_GAIN) * before:
                break
            before = error
            codebook_jd = _improve(sample_dp, len(codebook_jd), codes_p, squares_p)
        codes_p = search_codebook(sample_dp, codebook_jd.astype(np.float32), device)[0]
        # For the variances of the next round, means and cells have to belong together.
        means_jd, counts_j = _cell_means(sample_dp, codes_p, len(codebook_jd))
        codebook_jd = np.where(counts_j[:, None] > 0, means_jd, codebook_jd)
    return codebook_jd.astype(np.float32)


def search_codebook(
    vectors_dp: NDArray[np.float32], codebook_jd: NDArray[np.float32], device: Device
) -> tuple[NDArray[np.uint16], NDArray[np.float32]]:
    """Return the index of each vector's nearest codeword, the lowest on a tie, and its squared distance."""
    n_dim, n_vector = vectors_dp.shape
    lanes, block = (8, 2) if device.style == "cpu" else (1, 1)
    group = group_size(device)
    rows = round_up(len(codebook_jd), ROWS) - len(codebook_jd)
    codebook = device.upload(np.ascontiguousarray(np.pad(codebook_jd, ((0, rows), (0, 0)), mode="edge")))
    codes_p, squares_p = np.empty(n_vector, np.uint16), np.empty(n_vector, np.float32)
    for part in slabs(n_vector, 4 * n_dim):
        n_part = part.stop - part.start
        n_item = round_up(-(-n_part // (lanes * block)), group)
        padded_dp = np.zeros((n_dim, n_item * lanes * block), np.float32)
        padded_dp[:, :n_part] = vectors_dp[:, part]
        codes = device.empty(padded_dp.shape[1:], np.uint16)
        squares = device.empty(padded_dp.shape[1:], np.float32)
        device.launch(
            "codec/vq.cl",
            "search_vq_p",
            (n_item,),
            codes,
            squares,
            device.upload(padded_dp),
            codebook,
            n_dim,
            codebook.shape[0],
            padded_dp.shape[1],
            defines={"LANES": lanes, "BLOCK": block, "ROWS": ROWS},
            local_size=(group,),
        )
        codes_p[part] = device.download(codes)[:n_part]
        squares_p[part] = device.download(squares)[:n_part]
    return codes_p, squares_p


def _cell_means(
    values_dp: NDArray[np.floating], codes_p: NDArray[np.uint16], n_word: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the mean of the values in each cell (j, d), 0 where it is empty, and the size of each cell."""
    counts_j = np.bincount(codes_p, minlength=n_word)
    sums_dj = np.array([np.bincount(codes_p, weights=values_p, minlength=n_word) for values_p in values_dp])
    return (sums_dj / np.maximum(counts_j, 1)).T, counts_j


def _improve(
    vectors_dp: NDArray[np.float32],
    n_word: int,
    codes_p: NDArray[np.uint16],
    squares_p: NDArray[np.float32],
) -> NDArray[np.float64]:
    """Return the mean of each cell; a codeword without vectors goes to one of the vectors that are worst off."""
    means_jd, counts_j = _cell_means(vectors_dp, codes_p, n_word)
    empty = np.flatnonzero(counts_j == 0)
    worst = np.argsort(-squares_p, kind="stable")[: empty.size]
    means_jd[empty[: worst.size]] = vectors_dp[:, worst].T
    return means_jd
