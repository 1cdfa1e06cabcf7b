"""Nonlinear least squares of a few values, where what is linear follows by itself: Levenberg and Marquardt's steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

State = TypeVar("State")

_MOST_STEP, _TRIES = 0.5, 4
_DAMPING, _LEAST_DAMPING, _DAMPED_MORE = 1e-3, 1e-6, 10.0


@dataclass(frozen=True)
class Descended(Generic[State]):
    """Where a descent ended.

    Attributes
    ----------
    values_k : ndarray, shape (n_value,), float64
    energy : float
        Sum of squares of what is left.
    left_n : ndarray, shape (n,), float64
    state
        What `evaluate` returned beside.
    slopes_nk : ndarray, shape (n, n_value), float64
        How what is left changes with each value, before the last step.
    """

    values_k: NDArray[np.float64]
    energy: float
    left_n: NDArray[np.float64]
    state: State
    slopes_nk: NDArray[np.float64]


def descend(
    values_k: NDArray[np.float64],
    evaluate: Callable[[NDArray[np.float64]], tuple[NDArray[np.float64], State]],
    slopes: Callable[[NDArray[np.float64], State], NDArray[np.float64]],
    *,
    steps: int,
    settled_k: NDArray[np.float64],
    confine: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None,
) -> Descended[State]:
    """Return the values that leave least, at most half of each one's unit a step.

    SciPy's `least_squares` has no such limit to a step, without which an outline or a highlight jumps to another one,
    and asks for all slopes at once, which are many times as dear as what is left.

    Parameters
    ----------
    values_k : ndarray, shape (n_value,), float64
        Where to begin.
    evaluate : callable
        Takes values; returns what is left, (n,), the linear unknowns solved for, and what `slopes` needs.
    slopes : callable
        Takes values and the state; returns how what is left changes with each, (n, n_value), the linear unknowns
        following (Kaufman's variable projection).
    steps : int
    settled_k : ndarray, shape (n_value,), float64
        Steps that end the descent; infinite of values that need not settle.
    confine : callable, optional
        Brings tried values into their range.
    """
    values_k = np.asarray(values_k, np.float64)
    left_n, state = evaluate(values_k)
    energy, damping = float(left_n @ left_n), _DAMPING
    slopes_nk = np.zeros((len(left_n), len(values_k)))
    for _ in range(steps):
        slopes_nk = slopes(values_k, state)
        hessian_kk, right_k = slopes_nk.T @ slopes_nk, -slopes_nk.T @ left_n
        for _ in range(_TRIES):
            damped_kk = hessian_kk + np.diag(damping * np.diag(hessian_kk) + 1e-15)
            tried_k = values_k + np.clip(np.linalg.solve(damped_kk, right_k), -_MOST_STEP, _MOST_STEP)
            tried_k = tried_k if confine is None else confine(tried_k)
            tried_n, tried_state = evaluate(tried_k)
            if tried_n @ tried_n < energy:
                break
            damping *= _DAMPED_MORE
        else:
            break
        moved_k = np.abs(tried_k - values_k)
        values_k, left_n, state = tried_k, tried_n, tried_state
        energy, damping = float(left_n @ left_n), max(damping / _DAMPED_MORE, _LEAST_DAMPING)
        if np.all(moved_k < settled_k):
            break
    return Descended(values_k, energy, left_n, state, slopes_nk)
