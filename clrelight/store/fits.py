"""``fit/1``: spherical-harmonic coefficients; ``fit/2``: those of other bases."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from clrelight.arrays import COEFFICIENT_DTYPES
from clrelight.bases import SH
from clrelight.codec.rounding import rounding_rows
from clrelight.dataset import CoefficientMap, FitRecord
from clrelight.device import Device, open_device
from clrelight.errors import InputError, StoreFormatError
from clrelight.harmonics.index import coefficient_count
from clrelight.store.opening import Opened, parse_config, refusing
from clrelight.store.schemas import FIT, FIT_OF_BASIS, Schema
from clrelight.store.shards import opening_fit
from clrelight.store.surfaces import surface_bytes, surface_of, write_surface
from clrelight.store.writing import Draft, Sink, chunk_shape, config_text, drafting, padded_bytes
from clrelight.tiles import row_tiles

_IMAGE_AXES = ("height", "width", "channel")
_MAX_DEGREE = 1 << 15  # far beyond use; keeps the count of coefficients within every integer


@dataclass(frozen=True)
class FitSink:
    """The arrays of a fit being written, to be filled by slices of rows.

    Attributes
    ----------
    coeffs_khwc : Sink, (n_coeff, height, width, channel) float32 or float16
    lambda_hwc : Sink, (height, width, channel) float32, or None
    rank_hwc : Sink, (height, width, channel) int32, or None
    """

    coeffs_khwc: Sink
    lambda_hwc: Sink | None
    rank_hwc: Sink | None

    def write_rows(
        self,
        first: int,
        coeffs_khwc: NDArray,
        lambda_hwc: NDArray[np.float32] | None,
        rank_hwc: NDArray[np.int32] | None,
    ) -> None:
        """Fill rows from `first` on, chunk by chunk: so the file's bytes do not depend on how many come at a time.

        Coefficients come in the type of their sink; `clrelight.codec.rounding` makes halves.
        """
        end = first + coeffs_khwc.shape[1]
        chunk_rows = self.coeffs_khwc.chunks[1]
        for row in range(first - first % chunk_rows, end, chunk_rows):
            target = slice(max(row, first), min(row + chunk_rows, end))
            part = slice(target.start - first, target.stop - first)
            self.coeffs_khwc.fill((slice(None), target), coeffs_khwc[:, part])
            if self.lambda_hwc is not None and lambda_hwc is not None:
                self.lambda_hwc.fill(target, lambda_hwc[part])
            if self.rank_hwc is not None and rank_hwc is not None:
                self.rank_hwc.fill(target, rank_hwc[part])


@contextmanager
def create_fit(
    path: str | os.PathLike,
    record: FitRecord,
    image_shape: tuple[int, int, int],
    *,
    has_lambda: bool = False,
    has_rank: bool = False,
    dtype: DTypeLike = np.float32,
) -> Iterator[FitSink]:
    """Write a fit piece by piece: lend its arrays, to be filled by slices of rows.

    The file stands at `path` once the block has ended well; until then an old one stays as it is.

    Parameters
    ----------
    path : path
        Where the file is to stand.
    record : FitRecord
    image_shape : tuple of int
        (height, width, channel).
    has_lambda, has_rank : bool
        Whether the method gives such a map.
    dtype : dtype
        Of the coefficients: float32 or float16.

    Raises
    ------
    InputError
        If the arguments make no coefficient map, or the file cannot be written.
    """
    if not 0 <= record.degree <= _MAX_DEGREE:
        raise InputError(f"degree must be within 0 and {_MAX_DEGREE}, got {record.degree}")
    shape, stored = (coefficient_count(record.degree), *image_shape), coefficient_dtype(dtype)
    blank = np.broadcast_to(stored.type(0), shape)  # takes no memory, carries shape and type to the checks
    record.to_map(blank)
    chunks = chunk_shape(shape, stored.itemsize)
    map_chunks = chunks[1:]  # written and read together
    n_bytes = padded_bytes(shape, chunks, stored.itemsize)
    n_bytes += (has_lambda + has_rank) * padded_bytes(image_shape, map_chunks, 4) + surface_bytes(record.surface)
    with drafting(path, FIT if record.basis == SH else FIT_OF_BASIS, n_bytes) as draft:
        write_record(draft, record, "config")
        write_surface(draft, record.surface)
        yield FitSink(
            draft.sink("coefficients", shape, stored, ("coefficient", *_IMAGE_AXES), chunks),
            draft.sink("lambda", image_shape, np.float32, _IMAGE_AXES, map_chunks) if has_lambda else None,
            draft.sink("rank", image_shape, np.int32, _IMAGE_AXES, map_chunks) if has_rank else None,
        )


def coefficient_dtype(dtype: DTypeLike) -> np.dtype:
    """Return the type that coefficients are to be stored in; InputError if they cannot be."""
    try:
        asked = np.dtype(dtype)
    except TypeError:
        asked = None
    if asked is None or asked not in (np.float32, np.float16):
        raise InputError(f"coefficients are stored as {' or '.join(COEFFICIENT_DTYPES)}, not as {dtype}")
    return asked


def write_fit(
    path: str | os.PathLike,
    coefficients: CoefficientMap,
    *,
    dtype: DTypeLike | None = None,
    device: Device | None = None,
) -> None:
    """Write a coefficient map.

    Parameters
    ----------
    path : path
        Where the file is to stand.
    coefficients : CoefficientMap
    dtype : dtype, optional
        Type to store coefficients in: float32, or float16, to which float32 is rounded as codec `half` does it.
        Default: the type that they have.
    device : Device, optional
        Where to round.

    Raises
    ------
    InputError
        If a coefficient is too large for float16 or the whole map too small, or the file cannot be written.
    """
    held = np.dtype(coefficients.coeffs_khwc.dtype)
    stored = held if dtype is None else coefficient_dtype(dtype)
    rounds = stored.itemsize < held.itemsize
    rounding = rounding_rows(device or open_device()) if rounds else nullcontext()
    sinking = create_fit(
        path,
        FitRecord.of(coefficients),
        coefficients.image_shape,
        has_lambda=coefficients.lambda_hwc is not None,
        has_rank=coefficients.rank_hwc is not None,
        dtype=stored,
    )
    with sinking as sink, rounding as round_rows:  # which may refuse the whole map before the file stands
        height, width, channel = coefficients.image_shape
        step = sink.coeffs_khwc.chunks[1]
        for first, end in row_tiles((0, height), step):
            shape = (coefficients.n_coeff, end - first, width, channel)
            coeffs_khwc = coefficients.read_rows(first, end, np.empty(shape, held if rounds else stored))
            if round_rows is not None:
                coeffs_khwc = round_rows(coeffs_khwc, np.empty(shape, stored), first)
            sink.write_rows(
                first,
                coeffs_khwc,
                None if coefficients.lambda_hwc is None else coefficients.lambda_hwc[first:end],
                None if coefficients.rank_hwc is None else coefficients.rank_hwc[first:end],
            )


@contextmanager
def open_fit(path: str | os.PathLike) -> Iterator[CoefficientMap]:
    """Open a fit; its coefficients, lambdas and ranks are each a `StoredArray`, read as it is indexed.

    Raises
    ------
    InputError
        If there is no such file.
    StoreFormatError
        If it holds no sound fit.
    """
    with opening_fit(path, "fit") as opened:
        with refusing(opened.path):
            coefficients = fit_of(opened, opened.arrays.get)
        yield coefficients


def read_fit(path: str | os.PathLike) -> CoefficientMap:
    """Read a whole fit into memory; errors as of `open_fit`."""
    with opening_fit(path, "fit") as opened, refusing(opened.path):
        return fit_of(opened, opened.optional)


def fit_of(opened: Opened, array: Callable[[str], Any]) -> CoefficientMap:
    """Return the fit in an open file; `array` gives a dataset by its name, read or not, or None.

    Raises StoreFormatError or InputError if it is not sound.
    """
    record = replace(read_record(opened, opened.attributes(), "config"), surface=surface_of(opened))
    check_version(opened, record, FIT)
    return record.to_map(array("coefficients"), array("lambda"), array("rank"))


def check_version(opened: Opened, record: FitRecord, of_harmonics: Schema) -> None:
    """Raise StoreFormatError where a file's version says that it is of spherical harmonics and its record does not."""
    if (record.basis == SH) != (opened.schema.version <= of_harmonics.version):
        raise StoreFormatError(f"{opened.schema.name} holds no coefficients of basis {record.basis}")


def write_record(draft: Draft, record: FitRecord, config: str) -> None:
    """Write the record of a fit; its options become an attribute of the name `config`."""
    draft.attributes({"method": record.method, "degree": int(record.degree), "peak": float(record.peak)})
    draft.attributes({"transfer": record.transfer, "name": record.name, config: config_text(record.config)})
    draft.dataset("directions", record.directions_i3, ("light", "xyz"))


def read_record(opened: Opened, held: Mapping[str, Any], config: str) -> FitRecord:
    """Return the record of a fit in an open file, whose attributes are `held`."""
    about = {name: held[name] for name in ("degree", "method", "peak", "transfer", "name")}
    return FitRecord(**about, directions_i3=opened.arrays["directions"][...], config=parse_config(held[config], config))
