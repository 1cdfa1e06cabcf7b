"""Linear algebra on one thread."""

from __future__ import annotations

from contextlib import AbstractContextManager


def on_one_thread() -> AbstractContextManager[object]:
    """Return a context in which NumPy and SciPy use one thread.

    Learning and choosing are thousands of products of small matrices, which gain nothing from more; where other work
    keeps the cores busy, OpenBLAS's threads wait for each other, and the same takes several times as long.
    """
    from threadpoolctl import threadpool_limits  # of no use to other methods

    return threadpool_limits(1, user_api="blas")
