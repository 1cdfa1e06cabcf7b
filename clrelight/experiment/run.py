"""Run an experiment row by row; a results file that exists goes on where it stopped."""

from __future__ import annotations

import itertools
import json
import math
import os
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import decode, encode
from clrelight.conventions import TRANSFERS
from clrelight.dataset import CoefficientMap, LightStack, split_lights
from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.experiment.grid import RING, CodecSetting, Experiment
from clrelight.experiment.provenance import software_versions, source_commit
from clrelight.fit import FitMethod
from clrelight.fit.run import collect_fit, prepare_fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.relight import relight, to_display
from clrelight.results import ROW_DTYPE, Results
from clrelight.store import open_stack, read_results, write_results

PICTURE_RATE = 4.0
"""Of the wavelet rows, the rate whose pictures are kept (figures 4c, 8c, 12c)."""
PICTURE_LIGHT = np.array([0.5, 0.5, math.sqrt(0.5)])
"""Pictures show the light nearest to this direction."""
MAX_PICTURE_SIDE = 512

Progress = Callable[[str, int, int], None]


def run_experiment(
    experiment: Experiment,
    out: str | os.PathLike[str],
    *,
    device: Device | None = None,
    progress: Progress | None = None,
    force: bool = False,
) -> Results:
    """Measure every row of an experiment; rows that `out` holds already are kept, not measured again.

    Parameters
    ----------
    experiment : Experiment
    out : path
        Results file; written whole after every row.
    device : Device, optional
    progress : callable, optional
        Called with what is being done, rows done, and rows in all.
    force : bool
        Start anew although `out` exists.

    Returns
    -------
    Results
        The table with the rows in the experiment's order, and rows of earlier experiments before them.
    """
    device = device or open_device()
    results = read_results(out) if Path(out).exists() and not force else Results(np.empty(0, ROW_DTYPE))
    done = {_key(row) for row in results.table}
    report = progress or (lambda what, count, total: None)
    count = 0
    for scene in experiment.scenes:
        planned = [
            (method, degree, setting)
            for method in experiment.methods
            for degree in experiment.degrees
            for setting in experiment.codecs
        ]
        report(f"open {_scene_name(scene)}", count, experiment.row_count)
        with _open_scene(scene, experiment, report, count) as stack:
            bench = _Bench(stack, experiment, device)
            for (method, degree), group in itertools.groupby(planned, key=lambda item: item[:2]):
                for _, _, setting in group:
                    identity = bench.identity(method, degree, setting)
                    if _key(identity) not in done:
                        report(
                            f"{stack.name}: {method.title} degree {degree}, {setting.picture_name}",
                            count,
                            experiment.row_count,
                        )
                        results = bench.measure(results, identity, method, degree, setting)
                        write_results(out, results)
                        done.add(_key(identity))
                    count += 1
    report("done", count, experiment.row_count)
    return results


_IDENTITY = (
    "scene",
    "method",
    "degree",
    "fit_config",
    "codec",
    "codec_config",
    "n_light",
    "n_holdout",
    "height",
    "width",
    "channel",
    "seed",
)


def _key(row: np.void) -> tuple:
    return tuple(row[name] for name in _IDENTITY)


def _scene_name(scene: str) -> str:
    return scene if scene == RING else Path(scene).stem


@contextmanager
def _open_scene(scene: str, experiment: Experiment, report: Progress, count: int) -> Iterator[LightStack]:
    if scene != RING:
        with open_stack(scene) as stack:
            yield stack
        return
    from datasets_synth.ring import render_ring

    try:
        stack = render_ring(
            **experiment.ring,
            progress=lambda i, n: report(f"render ring, light {i} of {n}", count, experiment.row_count),
        )
    except TypeError as error:
        raise InputError(f"ring: {error}") from None
    yield stack


class _Bench:
    """One scene of an experiment, with the last fit kept while its codecs are measured."""

    def __init__(self, stack: LightStack, experiment: Experiment, device: Device) -> None:
        self.stack, self.experiment, self.device = stack, experiment, device
        self.fitted, self.held = split_lights(stack.n_light, experiment.holdout)
        self.fit_stack = stack if experiment.holdout is None else stack.select(self.fitted)
        self._fit: tuple[tuple, CoefficientMap, float] | None = None
        self._reference: tuple[int, NDArray[np.uint8], int] | None = None

    def identity(self, method: FitMethod, degree: int, setting: CodecSetting) -> np.void:
        """Return the row with all that is known before measuring."""
        experiment = self.experiment
        height, width, channel = self.stack.image_shape
        fit_config = {**method.to_config(), "weights": experiment.weights, "sampling": experiment.sampling}
        values = {
            "scene": self.stack.name,
            "method": method.id,
            "degree": degree,
            "fit_config": _json(fit_config),
            "codec": setting.id,
            "codec_config": _json(setting.config),
            "rate": setting.rate,
            "n_light": len(self.fitted),
            "n_holdout": len(self.held),
            "n_coeff": (degree + 1) ** 2,
            "height": height,
            "width": width,
            "channel": channel,
            "seed": int(experiment.ring.get("seed", 0)),
            "device": self.device.info.label,
            "versions": software_versions(),
            "commit": source_commit(),
        }
        row = np.zeros(1, ROW_DTYPE)
        for name, kind in ROW_DTYPE.fields.items() if ROW_DTYPE.fields else ():
            if name in values:
                row[0][name] = _fixed(values[name], kind[0])
        return row[0]

    def measure(self, results: Results, row: np.void, method: FitMethod, degree: int, setting: CodecSetting) -> Results:
        """Fit if need be, encode, decode, compare; return the results with this row and its pictures."""
        coefficients, row["seconds_fit"] = self._coefficients(method, degree)
        row["mean_energy"] = _mean_energy(coefficients.coeffs_khwc)
        row["entropy_bits"] = math.nan
        row["bits_per_coefficient"], row["encoded_bytes"] = 32.0, coefficients.coeffs_khwc.nbytes
        row["seconds_encode"] = row["seconds_decode"] = 0.0
        if setting.codec is not None:
            start = time.perf_counter()
            try:
                encoded = encode(coefficients.coeffs_khwc, setting.codec, self.device)
            except InputError as error:
                return _append(results, _without_quality(row, str(error)))
            row["seconds_encode"] = time.perf_counter() - start
            start = time.perf_counter()
            # From the bytes alone, so that nothing the encoder knows can leak into the measurement.
            decoded_khwc = decode(encoded.to_bytes(), self.device)
            row["seconds_decode"] = time.perf_counter() - start
            row["bits_per_coefficient"], row["encoded_bytes"] = encoded.bits_per_coefficient, encoded.encoded_bytes
            row["entropy_bits"] = encoded.info.get("entropy_bits", math.nan)
            coefficients = replace(coefficients, coeffs_khwc=decoded_khwc)
        start = time.perf_counter()
        mse_i = measure_errors(coefficients, self.stack, device=self.device)
        row["seconds_measure"] = time.perf_counter() - start
        at_fitted = summarize_errors(mse_i[self.fitted])
        row["psnr_mean"], row["psnr_pooled"] = at_fitted.psnr_mean, at_fitted.psnr_pooled
        row["psnr_mean_holdout"] = row["psnr_pooled_holdout"] = math.nan
        if len(self.held):
            at_held = summarize_errors(mse_i[self.held])
            row["psnr_mean_holdout"], row["psnr_pooled_holdout"] = at_held.psnr_mean, at_held.psnr_pooled
        pictures, profiles = self._illustrate(results, coefficients, method, degree, setting)
        return replace(_append(results, row), pictures=pictures, profiles=profiles)

    def _coefficients(self, method: FitMethod, degree: int) -> tuple[CoefficientMap, float]:
        key = (method, degree)
        if self._fit is None or self._fit[0] != key:
            self._fit = None  # let the old map go before the new one is made
            prepared = prepare_fit(
                self.fit_stack,
                method,
                degree,
                weights=self.experiment.weights,
                sampling=self.experiment.sampling,
                device=self.device,
            )
            coefficients = collect_fit(prepared)
            self._fit = (key, coefficients, sum(prepared.report.seconds.values()))
        return self._fit[1], self._fit[2]

    def _illustrate(
        self, results: Results, coefficients: CoefficientMap, method: FitMethod, degree: int, setting: CodecSetting
    ) -> tuple[dict[str, NDArray[np.uint8]], dict[str, NDArray[np.float64]]]:
        pictures, profiles = dict(results.pictures), dict(results.profiles)
        name, scene = f"{self.stack.name}/{method.id}/{degree}", self.stack.name
        light, reference, pixel = self._reference_picture()
        if setting.codec is None:
            column = coefficients.coeffs_khwc.reshape(coefficients.n_coeff, -1)[:, pixel]
            profiles[name] = column.astype(np.float64)
        if math.isnan(setting.rate) or setting.rate == PICTURE_RATE:
            image = relight(coefficients, self.stack.directions_i3[light : light + 1], device=self.device)[0]
            pictures[f"{scene}/reference"] = reference
            pictures[f"{name}/{setting.picture_name}"] = shrink_picture(to_display(image, self.stack.transfer))
        return pictures, profiles

    def _reference_picture(self) -> tuple[int, NDArray[np.uint8], int]:
        """Return the light that pictures show, its photograph, and the typical pixel's column.

        Typical is the column whose mean over the lights is the median of all that are not black.
        """
        if self._reference is None:
            light = int(np.argmax(self.stack.directions_i3 @ PICTURE_LIGHT))
            height = self.stack.image_shape[0]
            step = max(1, (1 << 26) // (self.stack.n_light * self.stack.image_shape[1] * self.stack.image_shape[2] * 4))
            means, rows = [], []
            for first in range(0, height, step):
                tile_ihwc = self.stack.read_rows(first, min(first + step, height))
                means.append(tile_ihwc.mean(axis=0, dtype=np.float64).ravel())
                rows.append(tile_ihwc[light].astype(np.float32) / self.stack.peak)
            mean_p = np.concatenate(means)
            order = np.argsort(mean_p, kind="stable")
            lit = order[mean_p[order] > 0]
            image = np.concatenate(rows)
            # The photograph is in the stack's transfer already, which is what a display gets.
            shown = shrink_picture(to_display(image, TRANSFERS[0]))
            self._reference = (light, shown, int(lit[len(lit) // 2]) if len(lit) else 0)
        return self._reference


def _append(results: Results, row: np.void) -> Results:
    return replace(results, table=np.concatenate([results.table, np.array([row], ROW_DTYPE)]))


def _without_quality(row: np.void, reason: str) -> np.void:
    """Return the row of a codec that refused the coefficients: a result too, with the reason as its note."""
    for name in ("bits_per_coefficient", "psnr_mean", "psnr_pooled", "psnr_mean_holdout", "psnr_pooled_holdout"):
        row[name] = math.nan
    row["encoded_bytes"] = 0
    row["note"] = _fixed(reason, ROW_DTYPE["note"])
    return row


def _mean_energy(coeffs_khwc: NDArray[np.float32]) -> float:
    planes = (np.vdot(plane.astype(np.float64), plane.astype(np.float64)) for plane in coeffs_khwc)
    return float(sum(planes)) / float(np.prod(coeffs_khwc.shape[1:]))


def shrink_picture(image_hwc: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image averaged over square blocks until no side is above `MAX_PICTURE_SIDE`."""
    height, width, channel = image_hwc.shape
    block = -(-max(height, width) // MAX_PICTURE_SIDE)
    if block == 1:
        return image_hwc
    kept = image_hwc[: height // block * block, : width // block * block]
    blocks = kept.reshape(height // block, block, width // block, block, channel)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def _json(config: Mapping[str, Any]) -> str:
    return json.dumps(config, sort_keys=True, separators=(",", ":"))


def _fixed(value: Any, dtype: np.dtype) -> Any:
    if dtype.kind != "S":
        return value
    encoded = str(value).encode("utf-8")
    return encoded[: dtype.itemsize].decode("utf-8", "ignore").encode("utf-8")
