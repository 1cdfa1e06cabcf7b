"""Linear algebra on one thread."""

from __future__ import annotations

from contextlib import AbstractContextManager


def on_one_thread() -> AbstractContextManager[object]:
    """Return a context in which NumPy and SciPy use one thread.

    Learning and choosing are thousands of products of small matrices, which gain nothing from more; where other work
    keeps the cores busy, OpenBLAS's threads wait for each other, and the same takes several times as long. And sums
    that threads share anew each time differ in their last digits.
    """
    from threadpoolctl import threadpool_limits  # of no use to most commands

    return threadpool_limits(1, user_api="blas")
