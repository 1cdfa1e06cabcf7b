"""One view being packed: its size or quality, its coefficients, its code, and how good that is."""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clrelight.codec import Encoded, array_source, codec_class, decode_regions, encode_stream
from clrelight.codec.streams import Source
from clrelight.codec.transforms.principal import STEP_RANGE
from clrelight.codec.views import Regions
from clrelight.codec.workspace import Shape
from clrelight.dataset import CoefficientMap, FitRecord, LightStack
from clrelight.errors import InputError
from clrelight.fit import PreparedFit
from clrelight.fit.run import collect_fit
from clrelight.harmonics.index import coefficient_count
from clrelight.holdout import describe_duplicates, note_distance
from clrelight.jobs.bands import bands_of
from clrelight.jobs.fitted_source import fitted_source
from clrelight.jobs.measure_parts import SAMPLED_FROM, measure_parts, sample_windows
from clrelight.jobs.packing_farm import PackingFarm
from clrelight.jobs.perceived import measure_perceived, relit_regions
from clrelight.jobs.report import Progress, Report, stage
from clrelight.jobs.sizes import payload_budget, size_facts, unused_notes
from clrelight.jobs.split_quality import Split
from clrelight.jobs.target import TOLERANCE, encode_to_quality
from clrelight.search import search_falling
from clrelight.store.encodings import container_bytes
from clrelight.store.scratch import ScratchBody, ScratchWorkspace

DEFAULT_BYTES = 1.0
"""Of a file for each pixel that counts, where no size or quality is asked for."""

_IN_MEMORY_SHARE = 8
_LEAST_BYTES = 4096
_CORRECTIONS = 2
_MOSAIC_VALUES = 1 << 25
"""Coefficients of the pieces at which a step is found."""
_NO_ERROR = 200.0
"""Decibel that images without any error count for."""
_STEP_PER_DECIBEL = 0.5
"""Logarithm of the step, base 2, for a decibel."""


@dataclass(frozen=True)
class Size:
    """The one thing that is asked of the size."""

    rate: float | None = None
    byte_count: int | None = None
    target_psnr: float | None = None
    loss: float | None = None

    @classmethod
    def of(cls, rate: float | None, byte_count: int | None, target_psnr: float | None, loss: float | None) -> Size:
        """Return what is asked for; InputError where that is more than one thing, or none that there is."""
        given = [value for value in (rate, byte_count, target_psnr, loss) if value is not None]
        if len(given) > 1:
            raise InputError("give one of --rate, --bytes, --target-psnr and --loss")
        if any(not (isinstance(value, int | float) and 0 < value < math.inf) for value in given):
            raise InputError(f"a rate, bytes, PSNR or loss must be a positive number, got {given[0]!r}")
        return cls(rate, byte_count, target_psnr, loss)

    @property
    def is_quality(self) -> bool:
        """Whether it is a quality that is asked for."""
        return self.target_psnr is not None or self.loss is not None

    def check_least(self, stack: LightStack, fitted: NDArray[np.intp], degree: int | str) -> None:
        """Raise InputError if bytes are asked for that are too few for any fit; no image is read."""
        if self.byte_count is not None:
            least = degree if isinstance(degree, int) else 0
            directions_i3 = stack.directions_i3[fitted]
            record = FitRecord(least, "", stack.peak, stack.transfer, directions_i3, {}, stack.name)
            shape = (coefficient_count(least), *stack.image_shape)
            payload_budget(self.byte_count, container_bytes(record, shape), shape)

    def options(self, overhead: int, n_pixel: int, shape: Shape) -> dict[str, Any]:
        """Return what klt is told where no quality is asked for; a file of so many bytes holds `overhead` too."""
        if self.rate is not None:
            return {"rate": self.rate}
        if self.byte_count is None:
            return {"byte_budget": max(int(DEFAULT_BYTES * n_pixel) - overhead, _LEAST_BYTES)}
        return {"byte_budget": payload_budget(self.byte_count, overhead, shape)}


@dataclass(frozen=True)
class Pack:
    """A stack, a fit of it that is prepared, and what is asked of the file."""

    stack: LightStack
    split: Split
    prepared: PreparedFit
    size: Size
    metric: str
    workspace: ScratchWorkspace
    report: Report
    progress: Progress | None
    elsewhere: PackingFarm | None = None
    """What does parts of the work in other processes."""

    def tell_facts(self) -> None:
        """Report what is known before the work."""
        prepared, (height, width, channel) = self.prepared, self.stack.image_shape
        self.report.facts |= {
            "image_shape": [height, width, channel],
            "method": prepared.method.id,
            "degree": prepared.degree,
            "n_light": len(self.split[0]),
            "n_holdout": len(self.split[1]),
            "fit_config": dict(prepared.config),
        }
        if prepared.choice is not None:
            self.report.facts["choice"] = prepared.choice.to_config()
        for name, seconds in prepared.report.seconds.items():
            self.report.seconds[name] = self.report.seconds.get(name, 0.0) + seconds
        prepared.report.seconds.clear()
        self.report.note(*prepared.report.notes)
        if (duplicates := describe_duplicates(self.stack)) is not None:
            self.report.note(duplicates[1])
        if (near := note_distance(self.stack.directions_i3, *self.split)) is not None:
            self.report.note(near)

    def encode(self, measure: str, perceptual: bool = False) -> Encoded:
        """Return the encoding, measured as is asked for."""
        height, width, _ = self.stack.image_shape
        mask_hw = self.stack.mask_hw
        n_pixel = height * width if mask_hw is None else int(mask_hw.sum())
        sampled = measure == "sample" or (measure == "auto" and n_pixel > SAMPLED_FROM)
        with self._source() as source:
            if not self.size.is_quality:
                overhead = container_bytes(self.prepared.record, source.shape)
                encoded = self._code(source, self.size.options(overhead, n_pixel, source.shape))
            else:
                encoded = self._reach(source, sampled)
        self.report.facts |= {**size_facts(encoded), "config": dict(encoded.config)}
        self.report.note(*unused_notes(encoded))
        if measure != "none" and not self.report.psnr:
            self._measure(encoded, sampled)
        if perceptual:
            self._perceive(encoded)
        return encoded

    @contextmanager
    def _source(self) -> Iterator[Source]:
        """Lend the coefficients: in memory where they are few."""
        prepared, since = self.prepared, time.perf_counter()
        n_value = coefficient_count(prepared.degree) * math.prod(self.stack.image_shape)
        if 4 * n_value * _IN_MEMORY_SHARE <= self.workspace.memory_bytes:
            with stage(self.progress, f"fitting {prepared.method.title}") as tell:
                fitted = collect_fit(prepared, memory_bytes=self.workspace.memory_bytes, progress=tell)
            self.report.add("fit", since)
            yield array_source(fitted.coeffs_khwc, prepared.device, fitted.basis, fitted.fitted_lights)
        else:
            if self.elsewhere is not None:
                self.elsewhere.farm.begin()
            with fitted_source(prepared, self.workspace) as source:
                source.elsewhere = self.elsewhere
                yield source

    def _code(self, source: Source, options: dict[str, Any]) -> Encoded:
        codec = codec_class("klt").from_config({**options, "metric": self.metric}).for_transfer(self.stack.transfer)
        since, body = time.perf_counter(), ScratchBody(self.workspace)
        with stage(self.progress, "fitting and coding") as self.workspace.progress:
            info = encode_stream(source, codec, body)
        self.report.add("code", since)
        return Encoded(codec.id, codec.to_config(), source.shape, body, info, self.prepared.record)

    def _perceive(self, encoded: Encoded) -> None:
        """Add what an eye sees of the differences to what was measured."""
        since, relit = time.perf_counter(), relit_regions(_regions_of(encoded), self.prepared.device)
        self.report.psnr |= measure_perceived(relit, self.stack, self.split, self.progress)
        self.report.add("measure", since)

    def _measure(self, encoded: Encoded, sampled: bool) -> float:
        """Measure, and return the PSNR that a target is about."""
        since, report = time.perf_counter(), self.report
        report.psnr = measure_parts(
            _regions_of(encoded),
            self.prepared.record,
            self.stack,
            self.split,
            self.prepared.device,
            sampled=sampled,
            progress=self.progress,
            elsewhere=None if self.elsewhere is None else functools.partial(self.elsewhere.measure, encoded),
        )
        report.add("measure", since)
        return report.psnr["pooled_holdout" if len(self.split[1]) else "pooled_fitted"]

    def _reach(self, source: Source, sampled: bool) -> Encoded:
        """Return an encoding of about a quality: its step is found at pieces of the image, then corrected."""
        since, size = time.perf_counter(), self.size
        fitted, stack = self._mosaic(source)
        with stage(self.progress, "finding the step"):
            trial, _, _ = encode_to_quality(
                fitted,
                stack,
                size.target_psnr,
                loss=size.loss or 0.0,
                tolerance=TOLERANCE if size.loss is None else size.loss / 3,
                metric=self.metric,
                device=self.prepared.device,
            )
        self.report.add("search", since)
        step, transfer = float(trial.config["step"]), trial.config["transfer"]
        if size.target_psnr is None:
            return self._code(source, {"step": step, "transfer": transfer})
        return self._correct(source, size.target_psnr, step, transfer, sampled)

    def _correct(self, source: Source, target: float, step: float, transfer: str, sampled: bool) -> Encoded:
        """Return the smallest encoding that reaches a PSNR, of those at this step and a few others."""
        tried: list[tuple[float, float, Encoded]] = []

        def measure(place: float) -> float:
            encoded = self._code(source, {"step": 2.0**place, "transfer": transfer})
            tried.append((2.0**place, self._measure(encoded, sampled), encoded))
            self.report.note(f"tried step {2.0**place:.4g}: {encoded.encoded_bytes} bytes, {tried[-1][1]:.2f} dB")
            return min(tried[-1][1], _NO_ERROR)

        aim = target + TOLERANCE / 3
        search_falling(
            measure,
            math.log2(step),
            (math.log2(STEP_RANGE[0]), math.log2(STEP_RANGE[1])),
            aim,
            limit=target,
            is_enough=lambda psnr: 0.0 <= psnr - target <= TOLERANCE,
            expect=lambda place, psnr: place + _STEP_PER_DECIBEL * (psnr - aim),
            slopes=(-4.0, -0.125),
            most=1 + _CORRECTIONS,
            width=1e-3,
        )
        reached = [each for each in tried if each[1] >= target]
        best = min(reached, key=lambda each: each[2].encoded_bytes) if reached else max(tried, key=lambda each: each[1])
        if not 0.0 <= best[1] - target <= TOLERANCE:
            self.report.note(f"{best[1]:.2f} dB is the nearest to {target:g} dB that was found")
        if best is not tried[-1]:
            self._measure(best[2], sampled)
        return best[2]

    def _mosaic(self, source: Source) -> tuple[CoefficientMap, LightStack]:
        """Return the coefficients and the photographs of windows all over the image, one beside another."""
        stack, record = self.stack, self.prepared.record
        n_value = coefficient_count(self.prepared.degree) * stack.image_shape[2]
        windows = sample_windows(stack, _MOSAIC_VALUES // n_value)
        coeffs, images, masks = [], [], []
        with bands_of(stack) as bands:
            for window in windows:
                rows, columns = (window.top, window.bottom), (window.left, window.right)
                coeffs.append(np.array(source.read_part(rows, columns)))
                images.append(bands.part(rows, columns).copy())  # whole rows are lent for a while only
                if stack.mask_hw is not None:
                    masks.append(stack.mask_hw[slice(*rows), slice(*columns)])
        mosaic = replace(
            stack,
            images_ihwc=np.concatenate(images, axis=2),
            mask_hw=np.concatenate(masks, axis=1) if masks else None,
            surface=None,
        )
        return replace(record, surface=None).to_map(np.ascontiguousarray(np.concatenate(coeffs, axis=2))), mosaic


def _regions_of(encoded: Encoded) -> Regions:
    regions = decode_regions(encoded)
    if regions is None:
        raise TypeError("klt writes bodies of which parts can be decoded")
    return regions
