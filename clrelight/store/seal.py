"""The seal of a file: one checksum over the checksums of its blocks, its attributes, and the shapes of its arrays.

The table of block checksums is a dataset in a group of its own, where no reader of arrays with named axes looks; the
seal is an attribute of the root, or of the array that a schema says. A file that has neither is another program's, and
is read as it is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import xxhash
from numpy.typing import NDArray

SEAL_ATTRIBUTE = "clrelight_checksums"
MOST_IN_TEXT = 4
"""Checksums of blocks that stand behind the seal where a schema needs no table: so its files are small."""
TABLE = "clrelight/checksums"
"""XXH3-64 of every block, uint64: the blocks of each array in C order, the arrays in the order of their names."""


def seal_of(
    schema: str, attributes: Mapping[str, Any], arrays: Mapping[str, tuple[Any, ...]], table_b: NDArray[np.uint64]
) -> str:
    """Return the text of the seal.

    Parameters
    ----------
    schema : str
        ``stack/1`` or the like.
    attributes : mapping
        Root attributes that the schema knows.
    arrays : mapping of str to tuple
        Of each array that the schema knows: type, shape, extent of a block, attributes that are read.
    table_b : ndarray, uint64
        Checksums of all blocks.
    """
    manifest = json.dumps([schema, attributes, arrays], sort_keys=True, separators=(",", ":"), default=bytes.hex)
    summed = xxhash.xxh3_64(manifest.encode("ascii"))
    summed.update(np.ascontiguousarray(table_b, "<u8").view(np.uint8).data)
    return f"xxh3-64 {summed.intdigest():016x}"


def sums_text(table_b: NDArray[np.uint64]) -> str:
    """Return checksums of blocks as text."""
    return "".join(f" {int(each):016x}" for each in table_b)


def parse_sums(text: str) -> tuple[str, NDArray[np.uint64] | None]:
    """Return the seal, and the checksums behind it; None where there are none. ValueError if they are no numbers."""
    parts = text.split(" ")
    if len(parts) == 2:
        return text, None
    return " ".join(parts[:2]), np.array([int(part, 16) for part in parts[2:]], "<u8")


def type_text(dtype: np.dtype) -> str:
    """Return a type as the manifest has it."""
    return dtype.str if dtype.names is None else str(dtype.descr)
