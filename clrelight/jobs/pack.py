"""From photographs to one small file that can be relit: read, fit and code, with no map of coefficients in between."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.bases import SH
from clrelight.codec import Encoded
from clrelight.codec.transforms.colour import METRICS, RADIANCE, check_metric
from clrelight.dataset import FitRecord, LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit import prepare_fit
from clrelight.fit.prepare import check_lights
from clrelight.fit.selection import WITHIN
from clrelight.holdout import HoldoutRule
from clrelight.ingest import Folder
from clrelight.jobs.farm import Chore, Farm, shared_path
from clrelight.jobs.ingest import keep_photographs, lend_photographs, read_photographs
from clrelight.jobs.inputs import Path as Name
from clrelight.jobs.inputs import StackLike, lend_stack, opened_on, paths_among, whole
from clrelight.jobs.memory import peak_memory
from clrelight.jobs.outputs import claimed
from clrelight.jobs.packing import Pack, Size
from clrelight.jobs.packing_farm import PackingFarm
from clrelight.jobs.report import Progress, Report, report_for, stage
from clrelight.jobs.written import count_bytes
from clrelight.memory import IMAGE_MEMORY
from clrelight.perception import check_perception
from clrelight.remote import is_remote
from clrelight.store import check_output, write_encoded
from clrelight.store.scratch import scratch_workspace

MEASURES = ("auto", "all", "sample", "none")
"""At which pixels quality is measured; auto: all of a small image, a sample of a large one."""


def pack(
    source: StackLike,
    out: str | os.PathLike[str],
    *,
    rate: float | None = None,
    bytes: int | str | None = None,
    target_psnr: float | None = None,
    loss: float | None = None,
    metric: str = RADIANCE,
    method: str = "auto",
    degree: int | str = "auto",
    basis: str = SH,
    within: float = WITHIN,
    holdout: int | None = None,
    holdout_by: str = "index",
    measure: str = "auto",
    perceptual: bool = False,
    keep_stack: str | os.PathLike[str] | None = None,
    preview: str | os.PathLike[str] | None = None,
    memory: int | str = IMAGE_MEMORY,
    device: Device | str | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
    farm: Farm | None = None,
    **options: Any,
) -> Report:
    """Turn photographs under known lights into one encoded file (codec ``klt``) that can be relit.

    Small images are fitted as a whole; of large ones coefficients are made of the photographs again whenever the coder
    asks for some, so that no map of them lies in memory or on a disk.

    Parameters
    ----------
    source : path or LightStack
        A folder of photographs (see `clrelight.ingest.ingest_folder`), a stack file, or a stack.
    out : path
        The encoded file to write.
    rate : float, optional
        Bits per coefficient.
    bytes : int or str, optional
        The file takes no more, such as ``"20M"``. Where nothing is asked for, a byte for each pixel that counts.
    target_psnr : float, optional
        Pooled PSNR in decibel with as few bytes as can be: at the lights held out, where there are any, else at the
        fitted ones.
    loss : float, optional
        Fewest bytes that cost so many decibels in the mean over those lights. From 50 dB on the fit is taken to be
        without error.
    metric : str
        What errors cost: ``"radiance"``, the same in every channel, or ``"perceptual"``, what they are in CIELAB.
    method, degree, basis, within
        As of `clrelight.jobs.fit.fit`.
    holdout, holdout_by
        Lights that are kept out of the fit and measured apart; as of `clrelight.jobs.fit.fit`.
    measure : str
        One of `MEASURES`.
    perceptual : bool
        Measure FLIP and colour differences as well; as of `clrelight.jobs.measure.measure`.
    keep_stack : path, optional
        Where the photographs are kept as a stack file; by default they lie in memory that the system has to spare, if
        they take a quarter of it at most, else in a file without a name beside `out`. Both go with the process.
    preview : path, optional
        A picture to write beside `out`, of what decodes under a light from the upper left (`clrelight.preview`).
    memory : int or str
        Bytes for photographs that are being read and for planes that are being coded.
    device, progress, report
        As of `clrelight.jobs.fit.fit`.
    farm : Farm, optional
        Other processes that do parts of the work, with the same result; photographs become a stack file that all of
        them read, where `keep_stack` says or in the farm's folder.
    **options
        Of reading a folder: ``lights``, ``transfer``, ``peak``, ``crop``, ``mask``, ``subset``, ...

    Returns
    -------
    Report
        With ``facts`` on the fit and the file, PSNRs, seconds a stage, ``peak_memory`` of the process in bytes, and
        ``photographs_in_memory``, bytes of a folder's photographs that lay there beside.

    Raises
    ------
    InputError
        As reading, fitting and encoding raise it; or if more than one size is asked for.
    """
    kept, budget = report_for(report), count_bytes(memory)
    size = Size.of(rate, None if bytes is None else count_bytes(bytes), target_psnr, loss)
    _check(measure, metric, out, keep_stack, preview)
    rule = HoldoutRule(None if holdout is None else whole(holdout, "holdout"), None, holdout_by)
    wanted = degree if isinstance(degree, str) else whole(degree, "degree")
    look, outs = _looking(size, rule, metric, perceptual, (method, wanted, basis)), [out, *paths_among(preview)]
    found = _found(source, budget, kept, options)
    with (
        claimed([out, keep_stack, preview], [each for each in paths_among(source) if not os.path.isdir(each)], kept),
        opened_on(device, kept) as opened,
        _photographs(source, found, outs, keep_stack, budget, options, look, kept, progress, farm) as (stack, stored),
        scratch_workspace(Path(os.fsdecode(out)).parent, budget) as workspace,
    ):
        split = rule.split(stack.directions_i3)
        chosen = stack if len(split[0]) == stack.n_light else stack.select(split[0])
        unseen = stack.directions_i3[split[1]] if len(split[1]) else None
        with stage(progress, "choosing a model"):
            prepared = prepare_fit(chosen, method, wanted, basis=basis, within=within, device=opened, unseen_t3=unseen)
        prepared = replace(prepared, config={**prepared.config, **rule.to_config()})
        elsewhere = None if farm is None else PackingFarm.of(farm, stored, prepared, split[0], budget)
        job = Pack(stack, split, prepared, size, metric, workspace, kept, progress, elsewhere)
        job.tell_facts()
        encoded = job.encode(measure, perceptual)
        show = None if preview is None else _drawn(preview, encoded, prepared.record, opened, kept)
        since = time.perf_counter()
        write_encoded(out, encoded)
        if show is not None:
            show()
        kept.add("write", since)
    kept.facts = {"file": os.fsdecode(out), **kept.facts, "bytes_on_disk": os.stat(out).st_size}
    kept.facts["peak_memory"] = peak_memory()
    return kept


def _drawn(
    preview: str | os.PathLike[str], encoded: Encoded, record: FitRecord, device: Device, report: Report
) -> Callable[[], None]:
    """Draw a preview; return what writes it."""
    from clrelight.jobs.preview import draw_preview, write_preview  # loads all that viewers' files take

    picture_hwc = draw_preview(encoded, record, device, report)
    return lambda: write_preview(preview, picture_hwc, report)


def _found(source: StackLike, memory: int, report: Report, options: dict[str, Any]) -> Folder | None:
    """Return what headers of a folder tell, None of what is none; InputError where there is no such file, or no lights.

    That comes before drivers are tested, which takes a minute.
    """
    for path in paths_among(source):
        name = os.fsdecode(path)
        if not is_remote(name) and "\0" not in name and not os.path.lexists(name):
            raise InputError(f"there is no file or folder {name}")
        if os.path.isdir(name):
            return read_photographs(path, memory, report, options)
    return None


def _check(measure: str, metric: str, out: Name, keep_stack: Name | None, preview: Name | None) -> None:
    if measure not in MEASURES:
        raise InputError(f"measure must be one of {', '.join(MEASURES)}, got {measure!r}")
    if metric not in METRICS:
        raise InputError(f"metric must be one of {', '.join(METRICS)}, got {metric!r}")
    if keep_stack is not None and os.path.abspath(keep_stack) == os.path.abspath(out):
        raise InputError(f"the stack that is kept and the packed file have the same name, {os.fsdecode(out)}")
    if preview is not None:
        from clrelight.jobs.preview import check_preview

        check_preview(preview, out)


def _looking(
    size: Size, rule: HoldoutRule, metric: str, perceptual: bool, model: tuple[str, int | str, str]
) -> Callable[[LightStack], None]:
    """Return what refuses, before a photograph is read, a stack of which that cannot be asked."""

    def look(stack: LightStack) -> None:
        check_metric(metric, stack.image_shape[2])
        if perceptual:
            check_perception(stack.image_shape[2])
        fitted = rule.split(stack.directions_i3)[0]
        check_lights(LightStack(np.zeros((len(fitted), 1, 1, 1)), stack.directions_i3[fitted], 1.0), *model)
        size.check_least(stack, fitted, model[1])

    return look


@contextmanager
def _photographs(
    source: StackLike,
    found: Folder | None,
    outs: list[str | os.PathLike[str]],
    keep_stack: str | os.PathLike[str] | None,
    memory: int,
    options: dict[str, Any],
    look: Callable[[LightStack], object],
    report: Report,
    progress: Progress | None,
    farm: Farm | None,
) -> Iterator[tuple[LightStack, str]]:
    """Lend the stack, which is read from a folder first where it is one, and the name of its file, if it has one."""
    if isinstance(source, LightStack) or found is None:
        given = [name for name, value in options.items() if value is not None and value is not False]
        if given or keep_stack is not None:
            named = ", ".join([*given, *(["keep_stack"] if keep_stack is not None else [])])
            raise InputError(f"{named}: for a folder of photographs, not for a stack")
        stored = "" if farm is None else shared_path(source, "the stack")
        with lend_stack(source, report) as stack:
            look(stack)
            yield stack, stored
        return
    if keep_stack is None and farm is None:
        folder = Path(os.fsdecode(outs[0])).parent
        with lend_photographs(found, folder, memory, report, progress, outs, look) as stack:
            yield stack, ""
        return
    for out in outs:
        check_output(out, found.inputs)
    look(found.stack)
    if farm is not None:
        kept_at = os.path.abspath(os.fsdecode(keep_stack) if keep_stack else os.path.join(farm.folder, "stack.h5"))
        since = time.perf_counter()
        report.note(*farm.write([(_ingesting(source, memory, options), kept_at)], "reading images"))
        report.add("ingest", since)
    else:
        kept_at = os.fsdecode(keep_stack)  # type: ignore[arg-type]
        reading = Report(tell=report.note)
        with claimed([kept_at], [], report), stage(progress, "reading images") as tell:
            keep_photographs(found, kept_at, memory, reading, tell)
        report.seconds["ingest"] += reading.seconds["ingest"]
    with lend_stack(kept_at, report) as stack:
        yield stack, kept_at


def _ingesting(folder: str | os.PathLike[str], memory: int, options: dict[str, Any]) -> Chore:
    """Return the reading of a folder as a chore."""
    given = {name: list(each) if isinstance(each, tuple) else each for name, each in options.items()}
    given = {name: each for name, each in given.items() if each is not None}
    for name in ("lights", "mask"):
        if name in given:
            given[name] = os.path.abspath(os.fsdecode(str(given[name])))
    reads = tuple(str(given[name]) for name in ("lights", "mask") if name in given)
    return Chore("ingest", os.path.abspath(os.fsdecode(folder)), {**given, "memory": memory}, reads)
