"""``clrelight psnr``, and what other commands need to measure quality."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from clrelight.cli.options import device_option, json_option
from clrelight.cli.output import decibel, print_facts, print_json, print_notes, seconds_line
from clrelight.cli.progress import progress_bar
from clrelight.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from clrelight.dataset import CoefficientMap, LightStack
    from clrelight.device import Device
    from clrelight.store import StoredArray


@click.command()
@click.argument("fitted", metavar="FIT_OR_ENC", type=click.Path())
@click.argument("stack", type=click.Path())
@device_option
@json_option
def psnr(fitted: str, stack: str, device: str | None, as_json: bool) -> None:
    """Measure PSNR of a fit or an encoded file against a stack.

    Lights that the fit has not seen are measured apart.

    \b
    Example:
      clrelight psnr enc.h5 stack.h5
    """
    from clrelight.device import open_device
    from clrelight.store import open_stack

    opened = open_device(device)
    seconds: dict[str, float] = {}
    with open_stack(stack) as source, lend_coefficients(fitted, opened, seconds) as coefficients:
        since = time.perf_counter()
        quality = measure(coefficients, source, opened)
        seconds["measure"] = time.perf_counter() - since
    if as_json:
        facts = {"file": fitted, "psnr": quality, "notes": list(source.notes), "seconds": seconds}
        print_json({**facts, "device": opened.info.label})
        return
    print_notes(source.notes)
    print_facts({**psnr_lines(quality), "time": seconds_line(seconds)})


@contextmanager
def lend_coefficients(path: str, device: Device, seconds: dict[str, float]) -> Iterator[CoefficientMap]:
    """Lend the coefficients of a fit file, or of an encoded file after decoding; `seconds` gets what it took.

    Those of a fit stay in the file until they are read. InputError where one that is read is not finite.
    """
    from clrelight.codec import decode
    from clrelight.store import file_schema, open_fit, read_encoded

    since = time.perf_counter()
    if file_schema(path).startswith("encoded/"):
        encoded, source = read_encoded(path)
        seconds["read"] = time.perf_counter() - since
        with progress_bar("decoding"):
            since = time.perf_counter()
            coefficients = source.to_map(decode(encoded, device))
            seconds["decode"] = time.perf_counter() - since
        _check_finite(path, coefficients.coeffs_khwc)
        yield coefficients
    else:
        with open_fit(path) as stored:
            seconds["read"] = time.perf_counter() - since
            yield replace(stored, coeffs_khwc=_Finite(path, stored.coeffs_khwc))


class _Finite:
    """The coefficients of an open file, each checked when it is read."""

    def __init__(self, path: str, stored_khwc: StoredArray) -> None:
        self.shape, self.dtype = stored_khwc.shape, stored_khwc.dtype
        self._path, self._stored = path, stored_khwc

    def read_rows_into(self, first: int, end: int, out: NDArray) -> None:
        self._stored.read_rows_into(first, end, out)
        _check_finite(self._path, out, first)


def _check_finite(path: str, coeffs_khwc: NDArray, first_row: int = 0) -> None:
    import numpy as np

    for k, plane_hwc in enumerate(coeffs_khwc):
        if not _all_finite(plane_hwc):
            row, column, channel = (int(v) for v in np.argwhere(~np.isfinite(plane_hwc))[0])
            raise InputError(
                f"{path}: coefficient {k} at row {first_row + row}, column {column}, channel {channel} is "
                f"{plane_hwc[row, column, channel]}, expected a finite number"
            )


def _all_finite(values: NDArray) -> bool:
    import numpy as np

    if values.dtype == np.float16:  # NumPy looks at halves one by one, and at their bits at the speed of memory
        return bool((values.view(np.uint16) & 0x7FFF).max() < 0x7C00)
    return bool(np.isfinite(values).all())


def measure(
    coefficients: CoefficientMap,
    stack: LightStack,
    device: Device,
    split: tuple[NDArray[np.intp], NDArray[np.intp]] | None = None,
) -> dict[str, float]:
    """Return PSNRs at the fitted lights and, apart, at those held out; by default all that were not fitted."""
    from clrelight.dataset import split_by_fit
    from clrelight.metrics import measure_errors, summarize_errors

    fitted, held = split_by_fit(stack, coefficients) if split is None else split
    with progress_bar("measuring") as bar:
        mse_i = measure_errors(coefficients, stack, device=device, progress=bar)
    quality: dict[str, float] = {}
    for name, lights in (("fitted", fitted), ("holdout", held)):
        if len(lights):
            measured = summarize_errors(mse_i[lights])
            quality[f"mean_{name}"], quality[f"pooled_{name}"] = measured.psnr_mean, measured.psnr_pooled
    return quality


def psnr_lines(quality: dict[str, Any] | None) -> dict[str, str]:
    """Return PSNRs as people read them."""
    lines = {}
    for name, title in (("fitted", "PSNR"), ("holdout", "PSNR, held out")):
        if quality and f"mean_{name}" in quality:
            mean, pooled = quality[f"mean_{name}"], quality[f"pooled_{name}"]
            lines[title] = f"{decibel(mean)} mean over lights, {decibel(pooled)} pooled"
    return lines


COMMANDS = (psnr,)
