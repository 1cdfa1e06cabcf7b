"""Stages of a fit: the projection alone, then whole fits from code values to coefficients."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from benchmarks.workload import Workload
from clrelight.dataset import CoefficientMap
from clrelight.fit import PreparedFit, collect_fit, prepare_fit
from clrelight.fit.plan import FitPlan
from clrelight.matmul import SampleCurve, apply_operator, multiply_columns, pack_operator
from clrelight.reproduction import exact
from clrelight.speed.peers import NewtonFit
from clrelight.speed.stage import Stage

PROJECTION_GOALS = {"uint8": 0.9, "float16": 0.9, "float32": 0.75}
SMALL_PROJECTION_GOAL = 0.7
FIT_GOAL = 1 / 1.4
"""A CLS fit beside the projection alone, both from a stack in memory to as many numbers in new memory."""
BISECTION_GOAL = 1 / 3
NUMPY_GOAL, ROOT_GOAL = 2.5, 1000.0
ROOT_COLUMNS = 64
NEWTON_STEPS = 16

_MATMUL = "NumPy float32 matmul"
_IMAGE_ERROR = "largest image error / peak"


class RootFit:
    """CLS as it is written down: for each pixel and channel a root-finder searches lambda (SciPy's brentq)."""

    def __init__(self, plan: FitPlan) -> None:
        if plan.synthesis_kr is None:
            raise ValueError("expected a least-squares plan, got one without a synthesis")
        self.plan, self.synthesis_kr = plan, plan.synthesis_kr

    def __call__(self, samples_is: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the coefficients of a few columns, shape (n_coeff, S), float64."""
        return np.stack([self._fit(column_i) for column_i in samples_is.T], axis=1)

    def _fit(self, samples_i: NDArray[np.float64]) -> NDArray[np.float64]:
        square_r = self.plan.singular_r**2
        b_r = self.plan.singular_r * (self.plan.analysis_ri @ samples_i)
        energy = self.plan.energy_i @ samples_i**2

        def excess(lam: float) -> float:
            return float(np.sum((b_r / (square_r + lam)) ** 2) - energy)

        held = excess(0.0) <= 0.0
        lam = 0.0 if held else brentq(excess, 0.0, np.linalg.norm(b_r) / np.sqrt(energy), xtol=1e-15, rtol=1e-9)
        return self.synthesis_kr @ (b_r / (square_r + lam))


def projection_stages(work: Workload) -> Iterator[Stage]:
    """Yield the projection of samples of each type, then of two smaller degrees; inputs are on the device."""
    for dtype in ("uint8", "float16", "float32"):
        yield _projection(work, work.degree, dtype)
    for degree in (2, 3):
        if degree < work.degree:
            yield _projection(work, degree, "uint8")


def _projection(work: Workload, degree: int, dtype: str) -> Stage:
    device = work.device
    analysis_ri = prepare_fit(work.stack, "uls", degree, device=device).plan.analysis_ri
    codes_ip = work.stack.images_ihwc.reshape(work.images_ip.shape)
    source, scale = (codes_ip, 1.0 / work.stack.peak) if dtype == "uint8" else (work.images_ip.astype(dtype), 1.0)
    operator, source_ip = pack_operator(device, analysis_ri * scale), device.upload(source)
    z_rp = device.empty((len(analysis_ri), work.columns), np.float32)
    peer_z_rp = np.empty(z_rp.shape, np.float32)
    peer_analysis_ri = analysis_ri.astype(np.float32)

    def relative_error(z_rp: NDArray, samples_ip: NDArray, scale: float) -> float:
        exact_rs = analysis_ri @ (samples_ip[:, work.checked_s].astype(np.float64) * scale)
        return float(np.abs(z_rp[:, work.checked_s] - exact_rs).max() / np.abs(exact_rs).max())

    return Stage(
        f"project {dtype}, n = {len(analysis_ri)}",
        _MATMUL,
        lambda: apply_operator(device, operator, source_ip, z_rp),
        lambda: np.matmul(peer_analysis_ri, work.images_ip, out=peer_z_rp),
        lambda: (
            relative_error(device.download(z_rp), source, scale),
            relative_error(peer_z_rp, work.images_ip, 1.0),
        ),
        "largest error / largest value",
        2.0 * analysis_ri.size * work.columns,
        PROJECTION_GOALS[dtype] if degree == work.degree else SMALL_PROJECTION_GOAL,
    )


def fit_stages(work: Workload) -> Iterator[Stage]:
    """Yield whole fits, uint8 stack to coefficients in host memory, beside the matmul of a projection."""
    uls, ceb = _prepare(work, "uls"), _prepare(work, "ceb")
    bisection = _prepare(work, "cls", {"solver": "bisection", "iterations": 32})
    newton = _prepare(work, "cls", {"solver": "newton", "iterations": NEWTON_STEPS})
    exact_uls_ks = exact.fit_uls(uls.plan, work.samples_is)
    exact_cls_ks = exact.fit_cls(bisection.plan, work.samples_is)
    newton_name = f"fit CLS, Newton {NEWTON_STEPS}"
    yield _fit(work, "fit ULS", uls, _compare(work, exact_uls_ks))
    yield _fit(work, "fit CLS, 32 bisections", bisection, _compare(work, exact_cls_ks), goal=BISECTION_GOAL)
    yield _fit(work, newton_name, newton, _compare(work, exact_cls_ks))
    yield _fit_beside_projection(work, newton_name, newton, exact_cls_ks)
    yield _fit_beside_numpy(work, newton_name, newton, exact_cls_ks)
    yield _fit_beside_root_finder(work, newton_name, newton, exact_cls_ks)
    yield _fit(work, "fit CEB", ceb, _compare_ranks(work, ceb), "largest image error / peak where ranks agree")


def _prepare(work: Workload, method: str, options: Mapping[str, object] | None = None) -> PreparedFit:
    return prepare_fit(work.stack, method, work.degree, options=options, device=work.device)


def _fit(
    work: Workload,
    name: str,
    prepared: PreparedFit,
    compare: Callable[[CoefficientMap], float],
    error_unit: str = _IMAGE_ERROR,
    *,
    goal: float | None = None,
) -> Stage:
    analysis_ri = prepared.plan.analysis_ri.astype(np.float32)
    z_rp = np.empty((len(analysis_ri), work.columns), np.float32)
    return Stage(
        name,
        _MATMUL,
        lambda: collect_fit(prepared),
        lambda: np.matmul(analysis_ri, work.images_ip, out=z_rp),
        lambda: (compare(collect_fit(prepared)), None),
        error_unit,
        goal=goal,
    )


def _fit_beside_projection(work: Workload, name: str, prepared: PreparedFit, exact_ks: NDArray[np.float64]) -> Stage:
    stack, compare = work.stack, _compare(work, exact_ks)
    curve = SampleCurve(stack.peak, stack.transfer)
    codes_ip = stack.images_ihwc.reshape(stack.n_light, -1)
    analysis_ri = prepared.plan.analysis_ri * curve.operator_scale()
    return Stage(
        name,
        "ours, the projection alone",
        lambda: collect_fit(prepared),
        lambda: multiply_columns(work.device, analysis_ri, codes_ip),
        lambda: (compare(collect_fit(prepared)), None),
        _IMAGE_ERROR,
        goal=FIT_GOAL,
    )


def _fit_beside_root_finder(work: Workload, name: str, prepared: PreparedFit, exact_ks: NDArray[np.float64]) -> Stage:
    compare, peer = _compare(work, exact_ks), RootFit(prepared.plan)
    some = np.arange(min(ROOT_COLUMNS, len(work.checked_s))) * len(work.checked_s) // ROOT_COLUMNS
    samples_is = np.ascontiguousarray(work.samples_is[:, some])
    return Stage(
        name,
        "SciPy brentq for each pixel and channel",
        lambda: collect_fit(prepared),
        lambda: peer(samples_is),
        lambda: (
            compare(collect_fit(prepared)),
            float(np.abs(work.basis_ik @ (peer(samples_is) - exact_ks[:, some])).max()),
        ),
        _IMAGE_ERROR,
        goal=ROOT_GOAL,
        peer_share=len(some) / work.columns,
    )


def _fit_beside_numpy(work: Workload, name: str, prepared: PreparedFit, exact_ks: NDArray[np.float64]) -> Stage:
    peer = NewtonFit(prepared.plan, NEWTON_STEPS)
    compare = _compare(work, exact_ks)
    return Stage(
        name,
        "the same in NumPy float32",
        lambda: collect_fit(prepared),
        lambda: peer(work.images_ip),
        lambda: (
            compare(collect_fit(prepared)),
            float(work.image_error(peer(work.images_ip)[:, work.checked_s], exact_ks).max()),
        ),
        _IMAGE_ERROR,
        goal=NUMPY_GOAL,
    )


def _checked(work: Workload, fitted: CoefficientMap) -> NDArray[np.float32]:
    return fitted.coeffs_khwc[:].reshape(fitted.n_coeff, -1)[:, work.checked_s]


def _compare(work: Workload, exact_ks: NDArray[np.float64]) -> Callable[[CoefficientMap], float]:
    return lambda fitted: float(work.image_error(_checked(work, fitted), exact_ks).max())


def _compare_ranks(work: Workload, prepared: PreparedFit) -> Callable[[CoefficientMap], float]:
    # Where the sum meets the bound within rounding, one eigenvector more or less is as good: not an error to tell.
    exact_ks, exact_rank_s = exact.fit_ceb(prepared.plan, work.samples_is)

    def compare(fitted: CoefficientMap) -> float:
        if fitted.rank_hwc is None:
            raise ValueError("expected a fit with ranks, got none")
        agree_s = fitted.rank_hwc.reshape(-1)[work.checked_s] == exact_rank_s
        if agree_s.mean() < 0.99:
            return float("nan")
        return float(work.image_error(_checked(work, fitted), exact_ks)[:, agree_s].max())

    return compare
