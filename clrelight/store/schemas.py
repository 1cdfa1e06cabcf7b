"""What each kind of file holds: datasets with named axes, and root attributes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from clrelight.arrays import COEFFICIENT_DTYPES, SAMPLE_DTYPES
from clrelight.results import ROW_DTYPE

SCHEMA_ATTRIBUTE = "clrelight_schema"

SCALED_AXES = ("light", "height", "width", "channel", "coefficient", "xyz")
"""Axes that get a dimension scale: a dataset of their name, 0, 1, 2, ..."""

SCALE_DTYPE = np.dtype("<i4")


@dataclass(frozen=True)
class Field:
    """A dataset of a schema: its axes, the types it may have, and which of its attributes are read.

    Attributes
    ----------
    attributes : str
        ``floats`` for all that are numbers with a fraction, else the name of a text; none where empty.
    """

    axes: tuple[str, ...]
    dtypes: tuple[np.dtype, ...]
    required: bool = True
    attributes: str = ""


@dataclass(frozen=True)
class Schema:
    """A kind of file in the one version that this program reads and writes.

    Attributes
    ----------
    kind, version
        ``stack`` and 1 for ``stack/1``.
    fields : mapping of str to Field
        Datasets; a name that ends in ``/`` stands for every dataset of that group.
    attributes : mapping of str to type
        Scalar root attributes: int, float or str; or bytes, an array of uint8.
    is_scaled : bool
        Whether axes get dimension scales, which take 5 kB.
    has_table : bool
        Whether checksums of blocks lie in a table also where they are few, which takes 0.4 kB.
    sealed : str
        What bears the seal: the root, or a dataset, in whose header HDF5 leaves room for it.
    """

    kind: str
    version: int
    fields: Mapping[str, Field]
    attributes: Mapping[str, type] = field(default_factory=dict)
    is_scaled: bool = True
    has_table: bool = True
    sealed: str = "/"

    @property
    def name(self) -> str:
        """``kind/version``."""
        return f"{self.kind}/{self.version}"

    @property
    def scales(self) -> tuple[str, ...]:
        """Names of the dimension scales such a file may have."""
        if not self.is_scaled:
            return ()
        used = {axis for each in self.fields.values() for axis in each.axes}
        return tuple(axis for axis in SCALED_AXES if axis in used)

    def field_of(self, name: str) -> Field | None:
        """Return what the schema says of a dataset, by its path; None if it does not know it."""
        return self.fields.get(name) or self.fields.get(name.rpartition("/")[0] + "/")


def _dtypes(*names: str) -> tuple[np.dtype, ...]:
    return tuple(np.dtype(name).newbyteorder("<") for name in names)


_IMAGE = ("height", "width", "channel")
_DIRECTIONS = Field(("light", "xyz"), _dtypes("float64"))
_FIT_ATTRIBUTES = {"method": str, "degree": int, "peak": float, "transfer": str, "name": str}

SURFACE_FACTS = "surface"
"""The attribute of a surface's vertices with what is no array, JSON."""

SURFACE = {
    "surface/vertices": Field(("vertex", "xyz"), _dtypes("float64"), required=False, attributes=SURFACE_FACTS),
    "surface/faces": Field(("face", "corner"), _dtypes("int32"), required=False),
    "surface/normals": Field(("vertex", "xyz"), _dtypes("float64"), required=False),
    "surface/tangents": Field(("vertex", "xyz"), _dtypes("float64"), required=False),
    "surface/albedo": Field(("vertex", "albedo_channel"), _dtypes("float32"), required=False),
    "surface/texture": Field(("vertex", "uv"), _dtypes("float64"), required=False),
}
"""What the pixels of a stack or a fit are vertices of: all of the group or nothing, but for the last three."""

STACK = Schema(
    "stack",
    1,
    {
        "images": Field(("light", *_IMAGE), _dtypes(*SAMPLE_DTYPES)),
        "directions": _DIRECTIONS,
        "weights": Field(("light",), _dtypes("float64"), required=False),
        "mask": Field(("height", "width"), _dtypes("uint8"), required=False),
        **SURFACE,
    },
    {"peak": float, "transfer": str, "name": str},
)
FIT = Schema(
    "fit",
    1,
    {
        "coefficients": Field(("coefficient", *_IMAGE), _dtypes(*COEFFICIENT_DTYPES)),
        "directions": _DIRECTIONS,
        "lambda": Field(_IMAGE, _dtypes("float32"), required=False),
        "rank": Field(_IMAGE, _dtypes("int32"), required=False),
        **SURFACE,
    },
    {**_FIT_ATTRIBUTES, "config": str},
)
FIT_OF_BASIS = replace(FIT, version=2)
"""Fits of other bases than spherical harmonics, which ``config`` names: who reads `FIT` alone must not take them."""
TILES = Schema(
    "tiles",
    1,
    {"directions": _DIRECTIONS},
    {**_FIT_ATTRIBUTES, "config": str, "shards": str},
)
"""A fit whose rows lie in other files."""
ENCODED_1 = Schema(
    "encoded",
    1,
    {
        "header": Field(("header_byte",), _dtypes("uint8")),
        "payload": Field(("payload_byte",), _dtypes("uint8"), attributes="floats"),
        "directions": _DIRECTIONS,
    },
    {
        **_FIT_ATTRIBUTES,
        "fit_config": str,
        "codec": str,
        "config": str,
        "encoded_bytes": int,
        "bits_per_coefficient": float,
    },
    is_scaled=False,
)
ENCODED_2 = Schema(
    "encoded",
    2,
    {
        "payload": Field(("payload_byte",), _dtypes("uint8")),
        "directions": Field(("light", "xyz"), _dtypes("float64"), required=False),
    },
    {"record": bytes},
    is_scaled=False,
    has_table=False,
)
ENCODED_3 = replace(ENCODED_2, version=3)
"""Encodings of such fits, of before."""
ENCODED = replace(ENCODED_2, version=4, sealed="payload")
"""Encodings of fits of any basis."""
RESULTS = Schema(
    "results",
    1,
    {
        "table": Field(("row",), (ROW_DTYPE,)),
        # Sizes differ from picture to picture, so these axes bear no names that are compared.
        "pictures/": Field(("", "", ""), _dtypes("uint8"), required=False, attributes="key"),
        "profiles/": Field(("",), _dtypes("float64"), required=False, attributes="key"),
    },
)
LIGHT = Schema(
    "light",
    1,
    {"coefficients": Field(("coefficient", "channel"), _dtypes("float64"))},
    {"degree": int, "source": str, "axes": str, "config": str},
)

SHRM = Schema(
    "shrm",
    1,
    {"maps": Field(("coefficient", *_IMAGE), _dtypes("float32", "float64"))},
    {"frame": str, "degree": int, "centre": str, "source": str, "axes": str, "config": str},
)

SCHEMAS = {schema.kind: schema for schema in (STACK, FIT, TILES, ENCODED, RESULTS, LIGHT, SHRM)}

OTHERS = {schema.name: schema for schema in (ENCODED_1, ENCODED_2, ENCODED_3, FIT_OF_BASIS)}
"""Kinds of files in other versions that are read: older ones, and those of other bases."""
