"""The stacks of the benchmark of coding peers, fitted, and the measure of whatever becomes of them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.peer_search import CODING, HELD_OUT, SEEN
from benchmarks.photographs import Scene
from benchmarks.rti_stacks import DATA_VARIABLE, HOLDOUT, crop, find_stacks, read_case
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.harmonics.basis import evaluate_basis
from clrelight.holdout import split_chosen
from clrelight.jobs.fit import fit
from clrelight.jobs.ingest import ingest
from clrelight.jobs.report import Note, Report
from clrelight.metrics import psnr_of
from clrelight.sampling import make_pattern

PIXELS_QUICK, LIGHTS_QUICK = 40, 16
_WIDTH, _HEIGHT, _LIGHTS, _MARGIN = 1224, 816, 30, 128
_BAND = 1 << 16
"""Pixels that are relit at once."""
_FIT, _SMOOTHING = "spline", 1e-3


@dataclass(frozen=True)
class Request:
    """A stack that can be had.

    Attributes
    ----------
    name : str
    degree : int
        Of the fit.
    make : callable
        Returns the stack, the lights to fit and those held out; takes whether a small part of it will do.
    """

    name: str
    degree: int
    make: Callable[[bool], tuple[LightStack, NDArray[np.intp], NDArray[np.intp]]]


@dataclass(frozen=True)
class FittedStack:
    """A stack and its fit.

    Attributes
    ----------
    name : str
    stack : LightStack
        Code values, taken as they are (`transfer` linear), one mask for all pixels.
    fitted_i, unseen_i : ndarray of int
        Lights.
    coeffs_khwc : ndarray, float32
    degree : int
    """

    name: str
    stack: LightStack
    fitted_i: NDArray[np.intp]
    unseen_i: NDArray[np.intp]
    coeffs_khwc: NDArray[np.float32]
    degree: int

    @property
    def basis_ik(self) -> NDArray[np.float64]:
        """The functions of the fit at all lights."""
        return evaluate_basis(self.stack.directions_i3, self.degree)

    @property
    def seen_lights(self) -> NDArray[np.float64]:
        """Directions of the lights that were fitted."""
        return self.stack.directions_i3[self.fitted_i]

    def photographs(self, rows: slice) -> NDArray[np.float32]:
        """Return rows of all photographs in units of the peak (light, row, column, channel)."""
        return self.stack.images_ihwc[:, rows] / np.float32(self.stack.peak)

    def score_unseen(self, images_ihwc: NDArray[np.float32]) -> dict[str, float]:
        """Return the pooled PSNR of images at the lights held out."""
        total = 0.0
        for rows in self._bands():
            total += _square(np.clip(images_ihwc[:, rows], 0.0, 1.0) - self.photographs(rows)[self.unseen_i])
        return {HELD_OUT: float(psnr_of(total / images_ihwc.size))}

    def score(self, relit: Callable[[slice], NDArray[np.float32]], *, of_fit: bool = False) -> dict[str, float]:
        """Return the pooled PSNR of images that come rows by rows, of all lights (light, row, column, channel).

        Against photographs values are clipped to [0, peak]; against images from the fit, with `of_fit`, they are not.
        """
        total = {CODING: 0.0, SEEN: 0.0, HELD_OUT: 0.0}
        channel = self.stack.image_shape[2]
        basis_ik = self.basis_ik.astype(np.float32)
        for rows in self._bands():
            given_ihwc, relit_ihwc = self.photographs(rows), relit(rows)
            if of_fit:
                exact_ip = basis_ik @ self.coeffs_khwc[:, rows].reshape(len(self.coeffs_khwc), -1)
                total[CODING] += _square(relit_ihwc.reshape(exact_ip.shape) - exact_ip)
            error_ihwc = np.clip(relit_ihwc, 0.0, 1.0) - given_ihwc
            total[SEEN] += _square(error_ihwc[self.fitted_i])
            total[HELD_OUT] += _square(error_ihwc[self.unseen_i])
        n_pixel = np.prod(self.stack.image_shape[:2]) * channel
        count = {CODING: self.stack.n_light, SEEN: len(self.fitted_i), HELD_OUT: len(self.unseen_i)}
        return {
            name: float(psnr_of(total[name] / (n_pixel * count[name])))
            for name in ([CODING] if of_fit else []) + [SEEN, HELD_OUT]
        }

    def score_coefficients(self, coeffs_khwc: NDArray[np.float32]) -> dict[str, float]:
        """Return the PSNR of images from other coefficients."""
        basis_ik = self.basis_ik.astype(np.float32)

        def relit(rows: slice) -> NDArray[np.float32]:
            part_khwc = coeffs_khwc[:, rows]
            relit_ip = basis_ik @ part_khwc.reshape(len(part_khwc), -1)
            return relit_ip.reshape(len(basis_ik), *part_khwc.shape[1:])

        return self.score(relit, of_fit=True)

    def _bands(self) -> Iterator[slice]:
        height, width, _ = self.stack.image_shape
        step = max(_BAND // width, 1)
        return (slice(top, min(top + step, height)) for top in range(0, height, step))


def _square(values: NDArray[np.float32]) -> float:
    flat = values.ravel()
    return float(np.dot(flat, flat))


def requests() -> list[Request]:
    """Return the stacks that there are: those of CLRELIGHT_DATA where it is set."""
    found = []
    if DATA_VARIABLE in os.environ:
        folder = Path(os.environ[DATA_VARIABLE]) / "stacks" / "loewenkopf"
        if folder.is_dir():
            found.append(Request("loewenkopf", 15, lambda quick: _loewenkopf(folder, quick)))
        names = ("Single/Object1/material1", "Multi/Object2/material5", "Real/item6")
        for source in find_stacks():
            if source.name in names:
                found.append(Request(source.name, 6, lambda quick, source=source: _field(source, quick)))
    found.append(Request("ring", 6, _ring))
    found.append(Request("photographs 1 MP", 4, _photographs))
    return found


def fit_stack(request: Request, device: Device, *, quick: bool = False) -> FittedStack:
    """Return a stack of which some lights are fitted; with `quick`, a small part of it.

    Raises
    ------
    InputError
        If the stack cannot be read or made.
    """
    stack, fitted_i, unseen_i = request.make(quick)
    stack = replace(stack, name=request.name, mask_hw=None, weights_i=None)
    degree = min(request.degree, 3) if quick else request.degree
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Note)
        fitted = fit(stack.select(fitted_i), _FIT, degree, lam=_SMOOTHING, device=device)
    coeffs_khwc = np.ascontiguousarray(fitted.coeffs_khwc, np.float32)
    return FittedStack(request.name, stack, fitted_i, unseen_i, coeffs_khwc, degree)


def _split(stack: LightStack, quick: bool) -> tuple[LightStack, NDArray[np.intp], NDArray[np.intp]]:
    if quick:
        every = -(-stack.n_light // LIGHTS_QUICK)
        stack = crop(stack.select(np.arange(0, stack.n_light, every)), PIXELS_QUICK)
    return stack, *split_chosen(stack.directions_i3, HOLDOUT)


def _loewenkopf(folder: Path, quick: bool) -> tuple[LightStack, NDArray[np.intp], NDArray[np.intp]]:
    return _split(ingest(folder / "jpg", report=Report(), lights=folder / "dirs.lp", transfer="linear"), quick)


def _field(source, quick: bool) -> tuple[LightStack, NDArray[np.intp], NDArray[np.intp]]:
    case = read_case(source, pixels=PIXELS_QUICK if quick else None)
    return case.stack, case.fitted_i, case.unseen_i


def _ring(quick: bool) -> tuple[LightStack, NDArray[np.intp], NDArray[np.intp]]:
    try:
        from datasets_synth.ring import render_ring
    except ImportError:
        raise InputError("ray tracing needs the extra synth") from None
    stack = render_ring(size=PIXELS_QUICK if quick else 256, lights=LIGHTS_QUICK if quick else 128)
    return stack, *split_chosen(stack.directions_i3, HOLDOUT)


def _photographs(quick: bool) -> tuple[LightStack, NDArray[np.intp], NDArray[np.intp]]:
    """Return the middle of larger photographs."""
    width, height, lights = (PIXELS_QUICK, PIXELS_QUICK, LIGHTS_QUICK) if quick else (_WIDTH, _HEIGHT, _LIGHTS)
    directions_i3 = make_pattern("uniform", lights)
    scene = Scene(width + 2 * _MARGIN, height + 2 * _MARGIN)
    rows, columns = slice(_MARGIN, _MARGIN + height), slice(_MARGIN, _MARGIN + width)
    images_ihwc = np.empty((lights, height, width, 3), np.uint8)

    def take(light: int) -> None:
        images_ihwc[light] = scene.photograph(directions_i3[light], light)[rows, columns]

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(take, range(lights)))
    stack = LightStack(images_ihwc, directions_i3, peak=255.0, transfer="linear", name="photographs 1 MP")
    return stack, *split_chosen(directions_i3, HOLDOUT)
