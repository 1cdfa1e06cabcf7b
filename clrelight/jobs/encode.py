"""Compress the coefficients of a fit."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

import numpy as np

from clrelight import codec as codecs
from clrelight.codec import Codec, Encoded
from clrelight.codec.rate.noise import Noise
from clrelight.codec.workspace import Shape
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.jobs.coding_noise import coding_psnr, predicted_psnr
from clrelight.jobs.inputs import FitLike, StackLike, lend_fit, lend_stack, opened_on, paths_among
from clrelight.jobs.measure import measure_split
from clrelight.jobs.outputs import claimed
from clrelight.jobs.parts import check_memory, decode_again, encode_source, take_source
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.sizes import payload_budget, size_facts
from clrelight.jobs.target import encode_to_quality
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import write_encoded
from clrelight.store.encodings import container_bytes
from clrelight.store.scratch import ScratchWorkspace, scratch_workspace

BASES = ("sh", "whitened", "klt")
"""Coordinates that are coded: as fitted; in the metric of the image; its principal axes."""

_MAX_DECIBELS = 1000.0
_IN_PARTS = "half, s3tc, bc6h, uniform, wavelet, jpeg2000 and klt take parts"
_TARGET_HOLDS = 5
"""Times the bytes of a map that a search for a quality takes at least."""


@overload
def encode(
    source: FitLike,
    codec: str | Codec | None = None,
    *,
    out: None = None,
    basis: str = "sh",
    bytes: int | str | None = None,
    target_psnr: float | None = None,
    stack: StackLike | None = None,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Encoded: ...


@overload
def encode(
    source: FitLike,
    codec: str | Codec | None = None,
    *,
    out: str | os.PathLike[str],
    basis: str = "sh",
    bytes: int | str | None = None,
    target_psnr: float | None = None,
    stack: StackLike | None = None,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Report: ...


def encode(
    source: FitLike,
    codec: str | Codec | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    basis: str = "sh",
    bytes: int | str | None = None,
    target_psnr: float | None = None,
    stack: StackLike | None = None,
    memory: int | str | None = None,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    **options: Any,
) -> Encoded | Report:
    """Compress the coefficients of a fit.

    Parameters
    ----------
    source : path or CoefficientMap
    codec : str or Codec, optional
        ``"half"``, ``"s3tc"``, ``"bc6h"``, ``"uniform"``, ``"wavelet"``, ``"jpeg2000"``, ``"vq"``, ``"cpca"`` or
        ``"klt"``. Default: ``"klt"`` where a size or a quality is asked for, or `basis` is ``"klt"``; else ``"s3tc"``.
    out : path, optional
        An encoded file to write; without it the encoding is returned.
    basis : str
        ``"sh"``, ``"whitened"`` or ``"klt"``: coordinates that are coded.
    bytes : int or str, optional
        The file, or without `out` the payload, takes no more, such as ``"20k"`` (klt, wavelet, jpeg2000).
    target_psnr : float, optional
        Fewest bytes for this pooled PSNR in decibel at the lights of `stack` that the fit has not seen, where there
        are any, else at those it has (klt, wavelet).
    stack : path or LightStack, optional
        Measure PSNR of what decodes against it.
    memory : int or str, optional
        Bytes for parts of the map, such as ``"1GiB"``: a codec that needs more is refused. Without it parts take
        256 MiB, and a codec that needs more says so in a note.
    device : Device or str, optional
        As ``--device`` names it; default: a GPU if there is one, else the packaged PoCL.
    progress : callable, optional
        Told (done, total or None, stage).
    report : Report, optional
        Filled; without one, notes become warnings (`Note`).
    **options
        Of the codec, see docs/codecs.md: ``rate``, ``step``, ``bits``, ... None means the default.

    Returns
    -------
    Encoded
        Bytes that decode by themselves, and the record of the fit; with `out` instead the report.

    Raises
    ------
    InputError
        If the request contradicts itself, a coefficient is not finite or too large for the codec, the target is
        beyond what the fit reaches, `memory` does not do, or `out` cannot be written.
    """
    kept = report_for(report)
    budget = None if bytes is None else count_bytes(bytes)
    wanted = _ask(codec, basis, budget, target_psnr, stack is not None, options)
    limit = None if memory is None else count_bytes(memory)
    held = limit or DEFAULT_MEMORY
    with (
        claimed([out], paths_among(source, stack), kept),
        opened_on(device, kept) as opened,
        lend_fit(source, any_basis=True) as coefficients,
        scratch_workspace(tempfile.gettempdir() if out is None else Path(os.fsdecode(out)).parent, held) as workspace,
    ):
        if out is not None and wanted.byte_budget is not None:
            shape = tuple(coefficients.coeffs_khwc.shape)
            overhead = container_bytes(FitRecord.of(coefficients), shape)
            wanted = replace(wanted, byte_budget=payload_budget(wanted.byte_budget, overhead, shape))
        encoded = _Encode(coefficients, wanted, opened, workspace, limit, kept, progress).run(stack)
        if out is None:
            return replace(encoded, body=encoded.body[:], record=FitRecord.of(coefficients))
        since = time.perf_counter()
        write_encoded(out, encoded, coefficients)
        kept.add("write", since)
        kept.facts = {"file": os.fsdecode(out), **kept.facts, "bytes_on_disk": os.stat(out).st_size}
    return kept


@dataclass(frozen=True)
class _Wanted:
    """What was asked of an encoding, once it makes sense."""

    codec: str | Codec
    basis: str
    byte_budget: int | None
    target_psnr: float | None
    options: Mapping[str, Any]

    def make(self, shape: Shape) -> Codec:
        """Return the codec for a map."""
        if isinstance(self.codec, Codec):
            return self.codec
        options = dict(self.options)
        if self.byte_budget is not None:
            size = {"byte_budget": self.byte_budget}
            options |= size if self.codec == "klt" else {"rate": 8.0 * self.byte_budget / math.prod(shape)}
        return _choose(self.codec, self.basis, options)


def _ask(
    codec: str | Codec | None,
    basis: str,
    byte_budget: int | None,
    target_psnr: float | None,
    with_stack: bool,
    options: Mapping[str, Any],
) -> _Wanted:
    """Return what is wanted; InputError says what contradicts itself before the fit is read."""
    given = {name: value for name, value in options.items() if value is not None}
    if basis not in BASES:
        raise InputError(f"basis must be one of {', '.join(BASES)}, got {basis!r}")
    if isinstance(codec, Codec):
        if given or basis != "sh" or byte_budget is not None or target_psnr is not None:
            raise InputError(f"options, a basis and a size belong to a codec given by its id; this is {codec}")
        return _Wanted(codec, basis, None, None, {})
    if target_psnr is not None:
        if not isinstance(target_psnr, int | float | np.number) or not abs(target_psnr) <= _MAX_DECIBELS:
            raise InputError(f"--target-psnr must be a number of decibels, got {target_psnr}")
        turned = basis == "whitened" or (basis == "klt" and codec not in (None, "klt"))
        if not with_stack or byte_budget is not None or given or turned:
            raise InputError("--target-psnr needs --stack to measure against, and no other size or option beside it")
    if byte_budget is not None and ("rate" in given or "step" in given):
        raise InputError("--bytes says the size already, leave out --rate and --step")
    name = str(codec or "") or ("klt" if basis == "klt" or byte_budget or target_psnr is not None else "s3tc")
    if byte_budget is not None and not hasattr(codecs.codec_class(name), "rate"):
        raise InputError(f"--bytes: what {name} takes follows from its options; klt, wavelet and jpeg2000 meet a size")
    if target_psnr is None and byte_budget is None:
        _choose(name, basis, given)
    return _Wanted(name, basis, byte_budget, target_psnr, given)


def _choose(codec: str, basis: str, options: Mapping[str, Any]) -> Codec:
    """Return the codec in a basis; InputError where the two do not go together."""
    rest = dict(options)
    if basis == "whitened":
        return codecs.codec_class("whitened").from_config({"codec": codec, "options": rest})
    planes = rest.pop("planes", None)
    if basis == "klt" and codec != "klt":
        config = {"codec": codec, "options": rest, "planes": planes}
        return codecs.codec_class("principal").from_config(config)
    if planes is not None:
        raise InputError("--planes is for --basis klt with a codec other than klt, which chooses its own")
    return codecs.codec_class(codec).from_config(rest)


@dataclass(frozen=True)
class _Encode:
    """An encoding of an open fit that makes sense, and how it shall run; `memory` is what the user set."""

    coefficients: CoefficientMap
    wanted: _Wanted
    device: Device
    workspace: ScratchWorkspace
    memory: int | None
    report: Report
    progress: Progress | None

    def run(self, stack: StackLike | None) -> Encoded:
        """Encode, and measure against a stack where there is one; facts go to the report."""
        report, noise = self.report, None
        if self.wanted.target_psnr is not None and stack is not None:
            encoded = self._to_quality(stack, self.wanted.target_psnr)
        else:
            encoded, noise = self._by_codec()
        if clamped := int(encoded.info.get("clamped", 0)):
            report.note(f"{clamped} coefficients were clamped")
        report.facts |= {**size_facts(encoded), "config": dict(encoded.config)}
        report.facts["coding_noise"] = predicted_psnr(noise)
        if stack is not None:
            self._measure(encoded, noise, stack)
        return encoded

    def _to_quality(self, stack: StackLike, target_psnr: float) -> Encoded:
        report, codec = self.report, self.wanted.codec
        since = time.perf_counter()
        needed = _TARGET_HOLDS * 4 * math.prod(self.coefficients.coeffs_khwc.shape)
        advice = f"without it {_IN_PARTS}"
        report.note(*check_memory(f"encoding to a quality by {codec}", needed, self.memory, advice))
        whole = self.coefficients.to_float32()
        since = report.add("read", since)
        with lend_stack(stack, report) as source:
            encoded, trials, why = encode_to_quality(whole, source, target_psnr, codec=str(codec), device=self.device)
        report.add("encode", since)
        report.note(*(f"tried {t.byte_count} bytes: {t.psnr:.2f} dB" for t in trials))
        report.note(f"took {encoded.encoded_bytes} bytes: {why}")
        return encoded

    def _by_codec(self) -> tuple[Encoded, Noise | None]:
        report, workspace, shape = self.report, self.workspace, tuple(self.coefficients.coeffs_khwc.shape)
        since = time.perf_counter()
        codec = self.wanted.make(shape).for_transfer(self.coefficients.transfer)
        surface = self.coefficients.surface
        if codec.hemisphere and surface is not None and surface.frame == "global":
            report.note(f"{codec.id} leaves open what functions are at z < 0, from where these take light: see wavelet")
        needed = codec.bytes_to_encode(shape)
        report.note(*check_memory(f"encoding by {codec.id}", needed, self.memory, _IN_PARTS))
        maps = take_source(self.coefficients, codec, self.device, workspace)
        since = report.add("read", since)
        with stage(self.progress, f"encoding {codec.id}") as workspace.progress:
            noise = codecs.predict_noise_of(maps, codec)
            since = report.add("predict", since)
            encoded = encode_source(maps, codec, workspace)
        report.add("encode", since)
        return encoded, noise

    def _measure(self, encoded: Encoded, noise: Noise | None, stack: StackLike) -> None:
        report, held = self.report, self.coefficients
        with lend_stack(stack, report) as source:
            since = time.perf_counter()
            with stage(self.progress, "decoding") as self.workspace.progress:
                decoded = decode_again(encoded, held, self.device, self.workspace)
            since = report.add("decode", since)
            report.facts["coding_noise"] = coding_psnr(noise, held.coeffs_khwc, decoded.coeffs_khwc, held.basis)
            report.psnr = measure_split(decoded, source, self.device, progress=self.progress)
            report.add("measure", since)
