"""Cluster vectors by their distance to affine subspaces (Sloan et al. 2003, section 4.2), on the host."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.slabs import slabs
from clrelight.codec.transforms.vectors import spread_sample
from clrelight.threads import on_one_thread

SAMPLES = 16384
"""Vectors that the clustering iterates over; the last two passes see all of them."""

SEED_SAMPLES = 4096
MEAN_PASSES, SAMPLE_PASSES, FULL_PASSES = 4, 12, 2
POWER_STEPS = 2


@dataclass
class Subspaces:
    """Means (k, d), orthonormal axes (k, r, d), and the cluster of each vector (p,)."""

    means_kd: NDArray[np.float64]
    axes_krd: NDArray[np.float64]
    cluster_p: NDArray[np.intp]


def fit_subspaces(vectors_pd: NDArray[np.float32], n_cluster: int, n_axis: int) -> Subspaces:
    """Return `n_cluster` affine subspaces of `n_axis` dimensions that are near the vectors, always the same ones.

    Lloyd's algorithm from k-means++ seeds: first with the means alone, then with the distance to the subspaces. Axes
    are improved by power iteration from where the previous pass left them, so no covariance matrix is formed.

    Parameters
    ----------
    vectors_pd : ndarray, shape (vector, dimension), float32
        Of magnitude 1 at most.
    n_cluster, n_axis : int
        At most the number of vectors, and of dimensions.
    """
    with on_one_thread():  # five times as fast as many threads that wait for each other
        return _fit(vectors_pd, n_cluster, n_axis)


def _fit(vectors_pd: NDArray[np.float32], n_cluster: int, n_axis: int) -> Subspaces:
    rng = np.random.default_rng(0)
    sample_pd = vectors_pd[spread_sample(len(vectors_pd), SAMPLES)]
    means_kd = _seed_means(sample_pd, n_cluster, rng)
    start_rd = np.linalg.qr(rng.standard_normal((vectors_pd.shape[1], n_axis)))[0].T
    model = Subspaces(means_kd, np.repeat(start_rd[None], n_cluster, axis=0), np.zeros(0, np.intp))
    for _ in range(MEAN_PASSES):
        _assign(model, sample_pd, with_axes=False)
        _refit(model, sample_pd, power_steps=0)
    _refit(model, sample_pd, POWER_STEPS)
    for _ in range(SAMPLE_PASSES):
        _assign(model, sample_pd)
        _refit(model, sample_pd, POWER_STEPS)
    for _ in range(FULL_PASSES):
        _assign(model, vectors_pd)
        _refit(model, vectors_pd, POWER_STEPS)
    return model


def _seed_means(vectors_pd: NDArray[np.float32], n_cluster: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return seeds each drawn in proportion to the squared distance from those before (k-means++)."""
    seeds_pd = vectors_pd[spread_sample(len(vectors_pd), max(SEED_SAMPLES, 4 * n_cluster))].astype(np.float64)
    chosen = [0]
    distance_p = np.full(len(seeds_pd), np.inf)
    for _ in range(n_cluster - 1):
        distance_p = np.minimum(distance_p, np.square(seeds_pd - seeds_pd[chosen[-1]]).sum(axis=1))
        cumulative_p = np.cumsum(distance_p)
        at = np.searchsorted(cumulative_p, rng.random() * cumulative_p[-1], side="right")
        chosen.append(min(int(at), len(seeds_pd) - 1))
    return seeds_pd[chosen]


def _assign(model: Subspaces, vectors_pd: NDArray[np.float32], with_axes: bool = True) -> None:
    """Put each vector into the cluster of least residual; a cluster left empty takes the worst vector."""
    n_cluster, n_axis, n_dim = model.axes_krd.shape
    centre_d = model.means_kd.mean(axis=0).astype(np.float32)  # differences of large squares lose digits
    means_kd = (model.means_kd - centre_d).astype(np.float32)
    axes_dr = model.axes_krd.reshape(-1, n_dim).T.astype(np.float32)
    offsets_kr = (model.axes_krd @ means_kd[:, :, None])[:, :, 0].astype(np.float32)
    cluster_p = np.empty(len(vectors_pd), np.intp)
    residual_p = np.empty(len(vectors_pd))
    for rows in slabs(len(vectors_pd), 4 * (n_cluster * (n_axis + 1) + n_dim)):
        centred_pd = vectors_pd[rows] - centre_d
        residual_pk = np.square(means_kd).sum(axis=1) - 2 * (centred_pd @ means_kd.T)
        if with_axes:
            weights_pkr = (centred_pd @ axes_dr).reshape(-1, n_cluster, n_axis) - offsets_kr
            residual_pk -= np.einsum("pkr,pkr->pk", weights_pkr, weights_pkr)
        cluster_p[rows] = residual_pk.argmin(axis=1)
        residual_p[rows] = residual_pk.min(axis=1) + np.square(centred_pd).sum(axis=1)
    counts_k = np.bincount(cluster_p, minlength=n_cluster)
    for k in np.flatnonzero(counts_k == 0):
        worst = int(np.where(counts_k[cluster_p] > 1, residual_p, -np.inf).argmax())
        counts_k[cluster_p[worst]] -= 1
        counts_k[k] += 1
        cluster_p[worst], residual_p[worst] = k, 0.0
    model.cluster_p = cluster_p


def _refit(model: Subspaces, vectors_pd: NDArray[np.float32], power_steps: int) -> None:
    """Set each cluster's mean, and improve its axes by steps of power iteration, the strongest first."""
    order = np.argsort(model.cluster_p, kind="stable")
    ends = np.cumsum(np.bincount(model.cluster_p, minlength=len(model.means_kd)))
    for k, members in enumerate(np.split(order, ends[:-1])):
        if not len(members):
            continue
        members_pd = vectors_pd[members]
        model.means_kd[k] = members_pd.mean(axis=0, dtype=np.float64)
        members_pd -= model.means_kd[k].astype(np.float32)
        axes_rd = model.axes_krd[k]
        for _ in range(power_steps):
            weights_rp = axes_rd.astype(np.float32) @ members_pd.T
            axes_rd = np.linalg.qr((weights_rp @ members_pd).T.astype(np.float64))[0].T
        if power_steps:
            # Within the subspace, the principal directions: their weights have the narrowest ranges.
            weights_pr = (members_pd @ axes_rd.T.astype(np.float32)).astype(np.float64)
            axes_rd = np.linalg.eigh(weights_pr.T @ weights_pr)[1].T[::-1] @ axes_rd
            largest = np.abs(axes_rd).argmax(axis=1)[:, None]
            axes_rd = axes_rd * np.where(np.take_along_axis(axes_rd, largest, axis=1) < 0, -1.0, 1.0)
        model.axes_krd[k] = axes_rd
