"""Run a fit over a stack, tile by tile."""

from __future__ import annotations

import functools
import itertools
import math
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.fit.plan import FitPlan, make_lighting
from clrelight.fit.precision import DOUBLE, MIXED, SINGLE, check_precision, compute_dtype
from clrelight.fit.registry import Columns, FitMethod, OnePass, method_class
from clrelight.fit.samples import Samples
from clrelight.fit.scaling import ScaledTile, TileScaling, round_coefficients
from clrelight.fit.selection import AUTO, DEGREES, METHODS, WITHIN, Choice, choose_model
from clrelight.fit.threads import on_one_thread
from clrelight.harmonics.basis import MAX_DEGREE
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import split_chosen
from clrelight.matmul import PackedOperator, SampleCurve, apply_operator, pack_operator, pad_columns
from clrelight.opencl.arguments import DeviceArray
from clrelight.streaming import Buffer, reading_ahead

DEFAULT_MEMORY = 1 << 28
"""Bytes that the tiles of a fit may take: that being read, that being fitted, and those that the caller still holds."""


@dataclass
class FitReport:
    """What a fit cost and what the user should know.

    Attributes
    ----------
    seconds : dict
        Per stage: ``plan``, ``read``, ``project``, ``shrink``, ``synthesize``; or ``fit`` for the last three, where a
        method has them in one kernel. Of reading it is what was waited for.
    notes : list of str
    condition : float
        Condition of the weighted basis matrix.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    condition: float = 1.0

    def add(self, stage: str, since: float) -> float:
        """Add the time since `since` to a stage, and return now."""
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        return now


@dataclass(frozen=True)
class PreparedFit:
    """A fit of one stack, ready to run: what is the same for all tiles."""

    stack: LightStack
    method: FitMethod
    degree: int
    config: Mapping[str, Any]
    plan: FitPlan
    device: Device
    report: FitReport
    choice: Choice | None = None
    precision: str = MIXED


@dataclass(frozen=True)
class FittedTile:
    """Rows first..end of a fit, as `CoefficientMap` holds them."""

    first: int
    end: int
    coeffs_khwc: NDArray
    lambda_hwc: NDArray[np.float32] | None
    rank_hwc: NDArray[np.int32] | None


def fit(
    stack: LightStack,
    method: str | FitMethod = "cls",
    degree: int | str = 6,
    *,
    options: Mapping[str, Any] | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    precision: str = MIXED,
    within: float = WITHIN,
    holdout: int | None = None,
    device: Device | None = None,
    memory_bytes: int = DEFAULT_MEMORY,
) -> CoefficientMap:
    """Fit spherical-harmonic coefficients to every pixel and channel of a stack.

    Parameters
    ----------
    stack : LightStack
    method : str or FitMethod
        An id of `method_ids`, a method with its options, or ``"auto"``: that with the least error at unseen lights
        (`clrelight.fit.selection`), as far as the lights to fit can tell.
    degree : int or str
        Largest degree, or ``"auto"``.
    options : mapping, optional
        Options of the method where it is given by id, such as ``{"energy": 0.5}``.
    weights : str
        ``"uniform"``, or ``"solid-angle"``: least squares and bound weighted by the lights' Voronoi cells.
    sampling : str
        ``"hemisphere"``, or ``"scattered"`` for samples that cover a part of it (section V-D).
    precision : str
        ``"mixed"``: float32, and float64 where lambda would be in doubt; ``"single"``: no float64 on the device;
        ``"double"``: float64 on the device, coefficients rounded at the end.
    within : float
        Decibels at unseen lights that ``"auto"`` may give for fewer coefficients.
    holdout : int, optional
        Keep every K-th light out of the fit.
    device : Device, optional
        Default: `open_device()`.
    memory_bytes : int
        Bytes that tiles may take.

    Returns
    -------
    CoefficientMap
        Coefficients of linear radiance in units of the peak, float32.

    Raises
    ------
    InputError
        If the method cannot fit this degree to these lights, samples are negative or not finite, or the device cannot
        compute in this precision.
    """
    fitted, held = split_chosen(stack.directions_i3, holdout)
    unseen_t3 = stack.directions_i3[held] if len(held) else None
    if holdout is not None:
        stack = stack.select(fitted)
    prepared = prepare_fit(
        stack,
        method,
        degree,
        options=options,
        weights=weights,
        sampling=sampling,
        precision=precision,
        within=within,
        device=device,
        unseen_t3=unseen_t3,
    )
    return collect_fit(prepared, memory_bytes=memory_bytes)


def prepare_fit(
    stack: LightStack,
    method: str | FitMethod,
    degree: int | str,
    *,
    options: Mapping[str, Any] | None = None,
    weights: str = "uniform",
    sampling: str = "hemisphere",
    precision: str = MIXED,
    within: float = WITHIN,
    device: Device | None = None,
    unseen_t3: NDArray[np.float64] | None = None,
) -> PreparedFit:
    """Check the request and make the matrices; see `fit` for the parameters.

    `unseen_t3` are directions that the choice's prediction is for, such as those of held-out lights; they change
    nothing else.
    """
    device = device or open_device()
    check_precision(precision, device)
    if not 0.0 <= within < math.inf:
        raise InputError(f"within must be 0 or more decibels, got {within!r}")
    methods, degrees = _check_model(method, degree, options or {})
    lighting = make_lighting(stack, weights, sampling)
    samples = Samples(stack)
    report = FitReport(notes=list(stack.notes))
    start = time.perf_counter()
    choice = None
    if AUTO in (method, degree):
        with on_one_thread():
            choice = choose_model(samples, methods, degrees, weights, sampling, within, unseen_t3)
        report.notes.append(choice.note)
        methods, degrees = [choice.settled or choice.chosen.method], [choice.chosen.degree]
        start = report.add("choose", start)
    method, degree = methods[0].settle(lighting, degrees[0], samples), degrees[0]
    plan = method.plan(lighting, degree)
    report.notes += [*plan.notes, *_note_precision(method, plan, precision, device)]
    report.condition = plan.condition
    report.add("plan", start)
    config = {**method.to_config(), "weights": weights, "sampling": sampling, "precision": precision}
    return PreparedFit(stack, method, degree, config, plan, device, report, choice, precision)


def _note_precision(method: FitMethod, plan: FitPlan, precision: str, device: Device) -> list[str]:
    notes = []
    if precision == MIXED and method.is_refined and not device.info.float64:
        notes.append(f"{device.info.name} has no float64: mixed precision is single precision here")
        precision = SINGLE
    note = method.note_precision(plan, precision)
    return notes if note is None else [*notes, note]


def _check_model(
    method: str | FitMethod, degree: int | str, options: Mapping[str, Any]
) -> tuple[list[FitMethod], list[int]]:
    """Return the methods and degrees asked for: one of each, or those that auto chooses from."""
    if degree == AUTO:
        degrees = list(DEGREES)
    elif isinstance(degree, str) or not 0 <= degree <= MAX_DEGREE:
        raise InputError(f"degree must be auto or 0 to {MAX_DEGREE}, got {degree!r}")
    else:
        degrees = [degree]
    if method == AUTO:
        if options:
            raise InputError(f"auto chooses the options too; {', '.join(options)} needs a method by name")
        return [method_class(name)() for name in METHODS], degrees
    if isinstance(method, str):
        method = method_class(method).from_config(options)
    elif options:
        raise InputError(f"options belong to a method given by its id; this {method.id} has its own: {method}")
    if degree == AUTO and not method.is_regression:
        raise InputError(f"degree auto needs a method that fits samples, such as cls or spline; {method.id} does not")
    return [method], degrees


def collect_fit(
    prepared: PreparedFit,
    *,
    memory_bytes: int = DEFAULT_MEMORY,
    progress: Callable[[int, int], None] | None = None,
) -> CoefficientMap:
    """Run a prepared fit and return the whole map."""
    with closing(fit_tiles(prepared, memory_bytes=memory_bytes)) as tiles:
        return collect_tiles(prepared, tiles, progress=progress)


def collect_tiles(
    prepared: PreparedFit,
    tiles: Iterable[FittedTile],
    *,
    dtype: DTypeLike = np.float32,
    progress: Callable[[int, int], None] | None = None,
) -> CoefficientMap:
    """Return the whole map of a fit from its tiles, whose coefficients are of type `dtype`."""
    stack, method = prepared.stack, prepared.method
    n_coeff = coefficient_count(prepared.degree)
    coeffs_khwc = np.empty((n_coeff, *stack.image_shape), dtype)
    lambda_hwc = np.empty(stack.image_shape, np.float32) if method.has_lambda else None
    rank_hwc = np.empty(stack.image_shape, np.int32) if method.has_rank else None
    for tile in tiles:
        rows = slice(tile.first, tile.end)
        if rows == slice(0, stack.image_shape[0]):
            # One tile is the whole map: no second copy.
            coeffs_khwc, lambda_hwc, rank_hwc = tile.coeffs_khwc, tile.lambda_hwc, tile.rank_hwc
        else:
            coeffs_khwc[:, rows] = tile.coeffs_khwc
            if lambda_hwc is not None and tile.lambda_hwc is not None:
                lambda_hwc[rows] = tile.lambda_hwc
            if rank_hwc is not None and tile.rank_hwc is not None:
                rank_hwc[rows] = tile.rank_hwc
        if progress is not None:
            progress(tile.end, stack.image_shape[0])
    return CoefficientMap(
        coeffs_khwc,
        prepared.degree,
        method.id,
        stack.peak,
        stack.transfer,
        stack.directions_i3,
        prepared.config,
        lambda_hwc,
        rank_hwc,
        stack.name,
    )


def rows_per_tile(
    prepared: PreparedFit, memory_bytes: int, *, held: int = 1, row_step: int = 1, beside: int = 0
) -> int:
    """Return how many rows a tile has within the budget; see `fit_tiles`."""
    stack = prepared.stack
    height, width, channel = stack.image_shape
    sample = stack.n_light * np.dtype(stack.images_ihwc.dtype).itemsize
    n_coeff, plan = coefficient_count(prepared.degree), prepared.plan
    # Components, the bound and its doubt; and what is handed on: coefficients, lambda or rank.
    work = compute_dtype(prepared.precision).itemsize * (len(plan.singular_r) + 1) + 4
    if prepared.precision == DOUBLE and plan.synthesis_kr is not None:
        work += 8 * n_coeff  # before they are rounded
    result = 4 * (n_coeff + 1)
    if memory_bytes // (width * channel * (sample + work + result + beside)) >= height:
        return height  # one tile: nothing is read ahead
    row_bytes = width * channel * (2 * sample + work + held * result + beside)
    rows = memory_bytes // row_bytes
    if rows < 1:
        raise InputError(f"one row of this fit takes {row_bytes} bytes, more than the memory budget {memory_bytes}")
    # Whole chunks of the images as well, where there is room for both.
    chunks = getattr(stack.images_ihwc, "chunks", None)
    chunk_rows = chunks[1] if chunks else 1
    for step in (math.lcm(row_step, chunk_rows), row_step):
        if step <= rows:
            rows -= rows % step
            break
    return int(min(rows, height))


def fit_tiles(
    prepared: PreparedFit, *, memory_bytes: int = DEFAULT_MEMORY, held: int = 1, row_step: int = 1, beside: int = 0
) -> Generator[FittedTile, None, None]:
    """Yield the fitted rows from top to bottom; times go to ``prepared.report``.

    The next tile is read in a thread meanwhile, into memory that tiles use in turns. Close the generator where it is
    left before its end (`contextlib.closing`): then the thread has ended.

    Parameters
    ----------
    prepared : PreparedFit
    memory_bytes : int
        Bytes that tiles may take: samples of the one being read, samples and components of the one being fitted, and
        the coefficients of those held.
    held : int
        A tile's coefficients keep their values until so many more have been asked for; its other maps are its own.
    row_step : int
        Tiles have a multiple of this many rows where the budget has room: those of a chunk of where they are written.
    beside : int
        Bytes that the caller takes of the budget for each pixel and channel of a tile.

    Raises
    ------
    InputError
        If a row does not fit the budget, or samples are negative or not finite.
    """
    stack, plan, device, report = prepared.stack, prepared.plan, prepared.device, prepared.report
    dtype = compute_dtype(prepared.precision)
    scaling = TileScaling(stack, plan, dtype)

    @functools.cache
    def one_pass_of(curve: SampleCurve) -> OnePass | None:
        return prepared.method.one_pass(device, plan, curve, prepared.precision)

    @functools.cache
    def operators() -> _Operators:
        return _Operators.upload(device, plan, scaling.curve.operator_scale(), dtype)

    height, width, channel = stack.image_shape
    step = rows_per_tile(prepared, memory_bytes, held=held, row_step=row_step, beside=beside)
    tiles = [(first, min(first + step, height)) for first in range(0, height, step)]
    # Fresh memory costs a page fault per 4 KiB, as much time as a kernel: tiles share these.
    samples_of = itertools.cycle([Buffer() for _ in tiles[:2]])
    coeffs_of = itertools.cycle([Buffer() for _ in tiles[:held]])
    components, energies, unrounded = Buffer(), Buffer(), Buffer()

    def read(rows: tuple[int, int]) -> ScaledTile:
        if len(tiles) == 1:
            return scaling.load(*rows)
        shape = (stack.n_light, rows[1] - rows[0], width, channel)
        return scaling.load(*rows, next(samples_of).lend(shape, stack.images_ihwc.dtype))

    since = time.perf_counter()
    with reading_ahead(read, tiles) as samples:
        for (first, end), scaled in zip(tiles, samples, strict=True):
            since = report.add("read", since)
            tile_ihwc, curve = scaled.samples_ihwc, scaled.curve
            one_pass = one_pass_of(curve)
            source_ip = device.upload(tile_ihwc.reshape(len(tile_ihwc), -1))
            columns = source_ip.shape[1]
            if one_pass is not None:
                coeffs = _lend(device, next(coeffs_of), (coefficient_count(prepared.degree), columns), dtype)
                maps = one_pass(source_ip, coeffs)
                coeffs_kp = device.download(coeffs)
            else:
                apart, padded = operators(), pad_columns(columns)
                z_rq = _lend(device, components, (apart.analysis.shape[0], padded), dtype)
                energy_q = _lend(device, energies, (padded,), dtype)
                apply_operator(
                    device, apart.analysis, source_ip, z_rq, curve=curve, energy_q=energy_q, weight_i=apart.energy_i
                )
                device.finish()
                since = report.add("project", since)
                tile_columns = Columns(source_ip, curve, z_rq, energy_q, apart.singular_r, prepared.precision)
                maps = prepared.method.shrink(device, plan, tile_columns)
                device.finish()
                since = report.add("shrink", since)
                coeffs_kp = _synthesize(device, apart.synthesis, z_rq, columns, next(coeffs_of), unrounded)
            shape_hwc = tile_ihwc.shape[1:]
            tile = FittedTile(
                first,
                end,
                coeffs_kp.reshape(-1, *shape_hwc),
                None if maps.lambda_q is None else device.download(maps.lambda_q)[:columns].reshape(shape_hwc),
                None if maps.rank_q is None else device.download(maps.rank_q)[:columns].reshape(shape_hwc),
            )
            scaled.restore(tile.coeffs_khwc)
            if stack.mask_hw is not None:
                _clear_masked(tile, ~stack.mask_hw[first:end])
            report.add("synthesize" if one_pass is None else "fit", since)
            yield tile
            since = time.perf_counter()


@dataclass(frozen=True)
class _Operators:
    """The plan on the device, for methods that project, shrink and synthesize one after another."""

    analysis: PackedOperator
    synthesis: PackedOperator | None
    energy_i: DeviceArray
    singular_r: DeviceArray

    @classmethod
    def upload(cls, device: Device, plan: FitPlan, scale: float, dtype: np.dtype) -> Self:
        return cls(
            pack_operator(device, plan.analysis_ri * scale, dtype),
            None if plan.synthesis_kr is None else pack_operator(device, plan.synthesis_kr, dtype),
            device.upload((plan.energy_i * scale**2).astype(dtype)),
            device.upload(plan.singular_r.astype(dtype)),
        )


def _lend(device: Device, buffer: Buffer, shape: tuple[int, ...], dtype: np.dtype) -> DeviceArray:
    return device.empty(shape, dtype, buffer.lend(shape, dtype) if device.shares_memory else None)


def _synthesize(
    device: Device,
    synthesis: PackedOperator | None,
    z_rq: DeviceArray,
    columns: int,
    buffer: Buffer,
    unrounded: Buffer,
) -> NDArray[np.float32]:
    """Return coefficients in `buffer`; `unrounded` is for those of float64."""
    dtype = z_rq.dtype
    if synthesis is None:
        values_kp = device.download(z_rq)[:, :columns]
    else:
        where = buffer if dtype == np.float32 else unrounded
        coeffs = _lend(device, where, (synthesis.shape[0], columns), dtype)
        apply_operator(device, synthesis, z_rq, coeffs)
        values_kp = device.download(coeffs)
        if dtype == np.float32:
            return values_kp
    coeffs_kp = buffer.lend(values_kp.shape, np.float32)
    round_coefficients(values_kp, coeffs_kp)
    return coeffs_kp


def _clear_masked(tile: FittedTile, outside_hw: NDArray[np.bool_]) -> None:
    # Pixels that do not count must not cost bits either.
    tile.coeffs_khwc[:, outside_hw] = 0.0
    if tile.lambda_hwc is not None:
        tile.lambda_hwc[outside_hw] = 0.0
    if tile.rank_hwc is not None:
        tile.rank_hwc[outside_hw] = 0
