"""One scene's rows of an experiment: what identifies each, and measuring it."""

from __future__ import annotations

import math
import os
import statistics
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Codec, decode, decode_shown, encode, predict_noise
from clrelight.dataset import CoefficientMap, LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.experiment.grid import CodecSetting, Experiment
from clrelight.experiment.portraits import Portrait, portrait_of
from clrelight.experiment.provenance import software_versions, source_commit
from clrelight.experiment.row import append, fill, fixed, json_text, without_quality
from clrelight.experiment.scenes import Survey, survey_stack
from clrelight.fit import FitMethod, FitReport, PreparedFit, collect_fit, prepare_fit
from clrelight.fit.precision import MIXED, check_precision
from clrelight.fit.selection import AUTO
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import split_chosen
from clrelight.jobs.coding_noise import coding_psnr
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.results import ROW_DTYPE, Results

_CORNER = 32
"""Width and height of the maps on which kernels are built before they are timed."""

_LONG = 0.5
"""Seconds from which on one run tells a time well enough."""
_ENOUGH = 0.3
"""Seconds that repeats of short work go on for, where there are repeats."""
_BUILDING = 3.0
"""The same of a fit, whose first run may build a kernel that the first row did not need."""

Made = TypeVar("Made")


class _RefusalError(InputError):
    """A method cannot fit this degree to these lights: a result, not the end of the experiment."""


class Bench:
    """One scene of an experiment, with the last fit kept while its codecs are measured.

    With `repeats`, what does not take long is run so many times or more, and its median time counts. The survey of the
    stack is made where none is given. Pictures and profiles are left out where it is not `illustrated`.
    """

    def __init__(
        self,
        stack: LightStack,
        experiment: Experiment,
        device: Device,
        seed: int = 0,
        *,
        repeats: int = 1,
        survey: Survey | None = None,
        illustrated: bool = True,
    ) -> None:
        check_precision(experiment.precision, device)
        self.seed, self.repeats, self.illustrated = seed, repeats, illustrated
        self.stack, self.experiment, self.device = stack, experiment, device
        directions_i3, by = stack.directions_i3, experiment.holdout_by
        self.fitted, self.held = split_chosen(directions_i3, experiment.holdout, experiment.lights, by)
        self.fit_stack = stack if len(self.fitted) == stack.n_light else stack.select(self.fitted)
        self.survey = survey or survey_stack(stack)
        self._fit: tuple[tuple, CoefficientMap, FitMethod, float] | None = None
        self._planned: dict[tuple, float] = {}
        self._fit_seconds: dict[tuple, float] = {}
        self._warm: list[dict[str, Any]] = []

    def check_earlier(self, results: Results, out: str | os.PathLike[str]) -> None:
        """Raise InputError if rows of this name were measured on other images: a report would mix them."""
        for row in self.own_rows(results):
            if f'"stack":"{self.survey.fingerprint}"'.encode() not in row["fit_config"]:
                raise InputError(
                    f"{out} holds rows of another stack that is named {self.stack.name!r} too: choose another --out, "
                    "or start anew with --force"
                )

    def check_device(self, results: Results, out: str | os.PathLike[str]) -> None:
        """Raise InputError if rows of this name were timed on another device: their seconds do not compare."""
        for row in self.own_rows(results):
            if row["device"] != fixed("device", self.device.info.label):
                raise InputError(
                    f"{out} holds times of another device ({row['device'].decode()}): choose another --out, "
                    "or start anew with --force"
                )

    def own_rows(self, results: Results) -> NDArray:
        """Return the rows of a stack of this name."""
        return results.table[results.table["scene"] == fixed("scene", self.stack.name)]

    def identity(self, method: FitMethod | str, degree: int | str, setting: CodecSetting) -> np.void:
        """Return the row with all that is known before measuring; a choice left to the fit is ``"auto"`` and -1."""
        height, width, channel = self.stack.image_shape
        values = {
            "scene": self.stack.name,
            **self._model_fields(method, degree, _chosen_by_auto(method, degree)),
            "codec": setting.id,
            "codec_config": json_text(setting.config),
            "rate": setting.rate,
            "n_light": len(self.fitted),
            "n_holdout": len(self.held),
            "height": height,
            "width": width,
            "channel": channel,
            "seed": self.seed,
            "device": self.device.info.label,
            "versions": software_versions(),
            "commit": source_commit(),
        }
        row = np.zeros(1, ROW_DTYPE)[0]
        fill(row, values)
        return row

    def _model_fields(self, method: FitMethod | str, degree: int | str, auto: str) -> dict[str, Any]:
        """Return the fields of a row that say what is fitted; `auto` names what the fit chooses, or has chosen."""
        config = {
            **({} if isinstance(method, str) else method.to_config()),
            **({"auto": auto} if auto else {}),
            "weights": self.experiment.weights,
            "sampling": self.experiment.sampling,
            # Rows of mixed precision have the configuration of files from before there was a choice.
            **({} if self.experiment.precision == MIXED else {"precision": self.experiment.precision}),
            # Their number is a field of its own.
            **({} if self.experiment.lights is None else {"lights": "farthest"}),
            **({} if self.experiment.holdout_by == "index" else {"holdout_by": self.experiment.holdout_by}),
            "stack": self.survey.fingerprint,
        }
        known = -1 if isinstance(degree, str) else degree
        name = method if isinstance(method, str) else method.id
        return {"method": name, "degree": known, "fit_config": json_text(config), "n_coeff": coefficient_count(known)}

    def measure(
        self, results: Results, row: np.void, asked: FitMethod | str, asked_degree: int | str, setting: CodecSetting
    ) -> Results:
        """Fit if need be, encode, decode, compare; return the results with this row and its pictures."""
        try:
            coefficients, method, row["seconds_fit"] = self._coefficients(asked, asked_degree)
            degree = coefficients.degree
        except _RefusalError as refusal:
            row["mean_energy"] = row["seconds_fit"] = math.nan
            return append(results, without_quality(row, str(refusal)))
        if auto := _chosen_by_auto(asked, asked_degree):
            fill(row, self._model_fields(method, degree, auto))
        row["mean_energy"] = _mean_energy(coefficients.coeffs_khwc)
        row["entropy_bits"] = math.nan
        row["bits_per_coefficient"], row["encoded_bytes"] = 32.0, coefficients.coeffs_khwc.nbytes
        row["seconds_encode"] = row["seconds_decode"] = 0.0
        row["coding_psnr_independent"] = row["coding_psnr_predicted"] = row["coding_psnr"] = math.inf
        shown, behind = coefficients, "linear"
        if setting.codec is not None:
            codec, coeffs_khwc = setting.codec.for_transfer(self.stack.transfer), coefficients.coeffs_khwc
            self._warm_up(codec, coeffs_khwc)
            try:
                noise = predict_noise(coeffs_khwc, codec, self.device)
                lights_i3 = coefficients.fitted_lights
                encoded, row["seconds_encode"] = self._timed(
                    lambda: encode(coeffs_khwc, codec, self.device, lights_i3=lights_i3)
                )
            except InputError as error:
                return append(results, without_quality(row, str(error)))
            # From the bytes alone, so that nothing the encoder knows can leak into the measurement.
            decoded_khwc, row["seconds_decode"] = self._timed(lambda: decode(encoded.to_bytes(), self.device))
            row["bits_per_coefficient"], row["encoded_bytes"] = encoded.bits_per_coefficient, encoded.encoded_bytes
            row["entropy_bits"] = encoded.info.get("entropy_bits", math.nan)
            fill(row, coding_psnr(noise, coeffs_khwc, decoded_khwc))
            coefficients = replace(coefficients, coeffs_khwc=decoded_khwc)
            shown_khwc, behind = decode_shown(encoded, self.device, decoded_khwc)
            shown = replace(coefficients, coeffs_khwc=shown_khwc)
        start = time.perf_counter()
        mse_i = measure_errors(shown, self.stack, behind=behind, device=self.device)
        row["seconds_measure"] = time.perf_counter() - start
        at_fitted = summarize_errors(mse_i[self.fitted])
        row["psnr_mean"], row["psnr_pooled"] = at_fitted.psnr_mean, at_fitted.psnr_pooled
        row["psnr_mean_holdout"] = row["psnr_pooled_holdout"] = math.nan
        notes = {"fitted": at_fitted.note}
        if len(self.held):
            at_held = summarize_errors(mse_i[self.held])
            row["psnr_mean_holdout"], row["psnr_pooled_holdout"] = at_held.psnr_mean, at_held.psnr_pooled
            notes["held out"] = at_held.note
        told = "; ".join(f"{lights}: {note}" for lights, note in notes.items() if note)
        row["note"] = fixed("note", told)
        if not self.illustrated:
            return append(results, row)
        # A surface is drawn under light from everywhere too, which takes radiance.
        drawn = (shown, behind) if self.stack.surface is None else (coefficients, "linear")
        pictures, profiles = self._illustrate(results, drawn, method, degree, setting)
        return replace(append(results, row), pictures=pictures, profiles=profiles)

    def _coefficients(self, method: FitMethod | str, degree: int | str) -> tuple[CoefficientMap, FitMethod, float]:
        """Return the fit, its method, and its seconds, those of a choice included."""
        key = (method, degree)
        if self._fit is None or self._fit[0] != key:
            self._fit = None  # let the old map go before the new one is made
            prepared = self._prepare(method, degree)
            # A kernel is built when it is first launched, which is no part of the time of a fit.
            row_ihwc = self.fit_stack.images_ihwc[:, :1]
            first_row = replace(self.fit_stack, images_ihwc=row_ihwc, mask_hw=None, surface=None)
            collect_fit(replace(prepared, stack=first_row, report=FitReport()))
            planned = self._planned[key] = sum(prepared.report.seconds.values())
            # What was fitted before needs no repeats to be timed.
            again = key in self._fit_seconds
            coefficients, seconds = self._timed(lambda: collect_fit(prepared), 0.0 if again else _BUILDING)
            seconds = self._fit_seconds.setdefault(key, planned + seconds)
            taken = prepared.choice.chosen.method if prepared.choice else prepared.method
            self._fit = (key, coefficients, taken, seconds)
        return self._fit[1], self._fit[2], self._fit[3]

    def _prepare(self, method: FitMethod | str, degree: int | str) -> PreparedFit:
        asked = self.experiment
        try:
            return prepare_fit(
                self.fit_stack,
                method,
                degree,
                weights=asked.weights,
                sampling=asked.sampling,
                precision=asked.precision,
                device=self.device,
            )
        except InputError as error:
            raise _RefusalError(str(error)) from error

    def plan_seconds(self, method: FitMethod | str, degree: int | str) -> float:
        """Return what of a fit's seconds no pixel adds to, measured anew where need be; 0 of what is refused."""
        key = (method, degree)
        if key not in self._planned:
            try:
                self._planned[key] = sum(self._prepare(method, degree).report.seconds.values())
            except _RefusalError:
                return 0.0
        return self._planned[key]

    @cached_property
    def _portrait(self) -> Portrait:
        return portrait_of(self.stack, self.survey, self.device)

    def _timed(self, work: Callable[[], Made], long: float = _LONG) -> tuple[Made, float]:
        """Return what some work makes, and its seconds; work that takes `long` or more is done once."""
        seconds: list[float] = []
        # The first run may build a kernel, and BLAS threads spin on for a while after a decomposition: the shortest
        # work needs the most repeats.
        while not seconds or (
            seconds[0] < long and self.repeats > 1 and (len(seconds) < self.repeats or sum(seconds[1:]) < _ENOUGH)
        ):
            start = time.perf_counter()
            made = work()
            seconds.append(time.perf_counter() - start)
        return made, statistics.median(seconds)

    def _warm_up(self, codec: Codec, coeffs_khwc: NDArray[np.float32]) -> None:
        """Build a codec's kernels on a corner of the maps, once for all its rows, apart from the times of any."""
        # Codecs build by their settings, but for the rate.
        kind = codec.to_config() | {"id": codec.id, "rate": None}
        if kind not in self._warm:
            self._warm.append(kind)
            with suppress(InputError):  # what it refuses here it may take as a whole, or refuses there
                corner_khwc = np.ascontiguousarray(coeffs_khwc[:, :_CORNER, :_CORNER])
                decode(encode(corner_khwc, codec, self.device).to_bytes(), self.device)

    def _illustrate(
        self, results: Results, drawn: tuple[CoefficientMap, str], method: FitMethod, degree: int, setting: CodecSetting
    ) -> tuple[dict[str, NDArray[np.uint8]], dict[str, NDArray[np.float64]]]:
        coefficients, pictures, profiles = drawn[0], dict(results.pictures), dict(results.profiles)
        name, survey = f"{self.stack.name}/{method.id}/{degree}", self.survey
        # Of rows that share a key the first one counts, here as in the report.
        if setting.codec is None and name not in profiles:
            column = coefficients.coeffs_khwc.reshape(coefficients.n_coeff, -1)[:, survey.column]
            profiles[name] = column.astype(np.float64)
        key = f"{name}/{setting.picture_name}"
        if key not in pictures and setting.is_pictured:
            pictures[f"{self.stack.name}/reference"] = self._portrait.reference
            pictures[key] = self._portrait.draw(*drawn)
        return pictures, profiles


def _chosen_by_auto(method: FitMethod | str, degree: int | str) -> str:
    """Return what the fit is asked to choose, for `fit_config`: nothing, ``"method"``, ``"degree"``, or both."""
    return " and ".join(name for name, value in (("method", method), ("degree", degree)) if value == AUTO)


def _mean_energy(coeffs_khwc: NDArray[np.float32]) -> float:
    planes = (np.vdot(plane.astype(np.float64), plane.astype(np.float64)) for plane in coeffs_khwc)
    return float(sum(planes)) / float(np.prod(coeffs_khwc.shape[1:]))
