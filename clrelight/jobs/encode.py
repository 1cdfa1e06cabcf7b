"""Compress the coefficients of a fit."""

from __future__ import annotations

import math
import os
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, overload

from clrelight import codec as codecs
from clrelight.codec import Codec, Encoded
from clrelight.codec.rate.noise import Noise
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device
from clrelight.errors import counted
from clrelight.jobs.coding_noise import coding_psnr, predicted_psnr
from clrelight.jobs.coding_request import CodingRequest, advise_codecs, read_request
from clrelight.jobs.inputs import FitLike, StackLike, lend_fit, lend_stack, opened_on, paths_among
from clrelight.jobs.measure import measure_regions, measure_split
from clrelight.jobs.outputs import claimed
from clrelight.jobs.outshining import outshining_notes
from clrelight.jobs.parts import check_memory, decode_again, encode_source, take_source
from clrelight.jobs.preview import check_preview, draw_preview, write_preview
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.sizes import payload_budget, size_facts, unused_notes
from clrelight.jobs.target import encode_to_quality
from clrelight.jobs.written import count_bytes
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store import write_encoded
from clrelight.store.encodings import container_bytes
from clrelight.store.scratch import ScratchWorkspace, scratch_workspace

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
    preview: str | os.PathLike[str] | None = None,
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
    preview: str | os.PathLike[str] | None = None,
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
        ``"klt"``. Default: ``"klt"`` where a size, a rate or a quality is asked for, or `basis` is ``"klt"``; else
        ``"s3tc"``, as far as the options are its own.
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
    preview : path, optional
        A picture to write beside `out`, of what decodes under a light from the upper left (`clrelight.preview`).
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
    wanted = read_request(codec, basis, budget, target_psnr, stack is not None, options)
    limit = None if memory is None else count_bytes(memory)
    held = limit or DEFAULT_MEMORY
    if preview is not None:
        check_preview(preview, out)
    with (
        claimed([out, preview], paths_among(source, stack), kept),
        opened_on(device, kept) as opened,
        lend_fit(source, any_basis=True) as coefficients,
        scratch_workspace(tempfile.gettempdir() if out is None else Path(os.fsdecode(out)).parent, held) as workspace,
    ):
        if out is not None and wanted.byte_budget is not None:
            shape = tuple(coefficients.coeffs_khwc.shape)
            overhead = container_bytes(FitRecord.of(coefficients), shape)
            wanted = replace(wanted, byte_budget=payload_budget(wanted.byte_budget, overhead, shape, str(wanted.codec)))
        encoded = _Encode(coefficients, wanted, opened, workspace, limit, kept, progress).run(stack)
        if out is None:
            return replace(encoded, body=encoded.body[:], record=FitRecord.of(coefficients))
        picture_hwc = None if preview is None else draw_preview(encoded, coefficients, opened, kept)
        since = time.perf_counter()
        write_encoded(out, encoded, coefficients)
        if preview is not None and picture_hwc is not None:
            write_preview(preview, picture_hwc, kept)
        kept.add("write", since)
        kept.facts = {"file": os.fsdecode(out), **kept.facts, "bytes_on_disk": os.stat(out).st_size}
    return kept


@dataclass(frozen=True)
class _Encode:
    """An encoding of an open fit that makes sense, and how it shall run; `memory` is what the user set."""

    coefficients: CoefficientMap
    wanted: CodingRequest
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
            report.note(f"{counted(clamped, 'coefficient was', 'coefficients were')} clamped")
        report.note(*unused_notes(encoded))
        report.facts |= {**size_facts(encoded), "config": dict(encoded.config)}
        report.facts["coding_noise"] = predicted_psnr(noise)
        if stack is not None:
            self._measure(encoded, noise, stack)
        return encoded

    def _to_quality(self, stack: StackLike, target_psnr: float) -> Encoded:
        report, codec = self.report, self.wanted.codec
        since = time.perf_counter()
        needed = _TARGET_HOLDS * 4 * math.prod(self.coefficients.coeffs_khwc.shape)
        advice = f"give --memory {-(-needed >> 20)}MiB, or --rate or --bytes in place of --target-psnr"
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
        advice = advise_codecs(codec, shape, self.memory)
        report.note(*check_memory(f"encoding by {codec.id}", needed, self.memory, advice))
        maps = take_source(self.coefficients, codec, self.device, workspace)
        with maps.rows() as parts:
            report.note(*outshining_notes(parts, maps.shape))
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
            regions = codecs.bent_regions(encoded)
            if regions is None:
                report.psnr = measure_split(decoded, source, self.device, progress=self.progress)
            else:
                del decoded  # its memory goes first
                report.psnr = measure_regions(regions, held, source, self.device, self.progress)
            report.add("measure", since)
