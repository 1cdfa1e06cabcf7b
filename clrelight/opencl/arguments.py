"""Arrays on a device, and whether they fit the arguments of a kernel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# OpenCL scalar and element types and the NumPy types that have the same bits.
_DTYPES: dict[str, tuple[str, ...]] = {
    "char": ("int8",),
    "uchar": ("uint8",),
    "short": ("int16",),
    "ushort": ("uint16", "float16"),
    "half": ("float16",),
    "int": ("int32",),
    "uint": ("uint32",),
    "long": ("int64",),
    "ulong": ("uint64",),
    "float": ("float32",),
    "double": ("float64",),
}
_ACCEPTED = {element: frozenset(map(np.dtype, names)) for element, names in _DTYPES.items()}


@dataclass(frozen=True)
class DeviceArray:
    """An array in device memory; on a CPU it shares the memory of `host`."""

    buffer: Any
    shape: tuple[int, ...]
    dtype: np.dtype
    host: NDArray | None = None


def check_arguments(where: str, parameters: list[tuple[str, str]], arguments: tuple) -> list[Any]:
    """Return the arguments ready for a kernel, or say which one does not fit (see `Device.launch`)."""
    if len(arguments) != len(parameters):
        names = ", ".join(name for _, name in parameters)
        raise TypeError(f"{where} takes {len(parameters)} arguments ({names}), got {len(arguments)}")
    extents: dict[str, tuple[int, str]] = {}
    for (type_name, name), value in zip(parameters, arguments, strict=True):
        if type_name.endswith("*"):
            _check_array(where, type_name, name, value, extents)
    return [
        value if type_name.endswith("*") else _check_scalar(where, type_name, name, value, extents)
        for (type_name, name), value in zip(parameters, arguments, strict=True)
    ]


def _check_array(where: str, type_name: str, name: str, value: Any, extents: dict[str, tuple[int, str]]) -> None:
    element = type_name.rstrip("* ").rstrip("0123456789")
    if not isinstance(value, DeviceArray):
        raise TypeError(f"{where}: {name} must be an array on the device, got {type(value).__name__}")
    if value.dtype not in _ACCEPTED[element]:  # a name takes long to make
        raise TypeError(f"{where}: {name} is {type_name}, which takes {_DTYPES[element][0]}, got {value.dtype.name}")
    letters = name.rsplit("_", 1)[-1]
    if len(value.shape) != len(letters):
        raise ValueError(f"{where}: {name} has {len(letters)} axes by its name, got shape {value.shape}")
    for letter, extent in zip(letters, value.shape, strict=True):
        known, owner = extents.setdefault(letter, (extent, name))
        if known != extent:
            raise ValueError(f"{where}: {name} has {extent} along {letter}, but {owner} has {known}")


def _check_scalar(where: str, type_name: str, name: str, value: Any, extents: dict[str, tuple[int, str]]) -> Any:
    if not isinstance(value, int | float | np.generic) and (isinstance(value, DeviceArray) or np.ndim(value) != 0):
        raise TypeError(f"{where}: {name} must be one {type_name}, got {type(value).__name__}")
    dtype = np.dtype(_DTYPES[type_name][0])
    if dtype.kind in "iu" and not isinstance(value, int | np.integer):
        raise TypeError(f"{where}: {name} must be a whole number, got {value!r}")
    scalar = dtype.type(value)
    if name.startswith("size_") and name[5:] in extents and extents[name[5:]][0] != int(scalar):
        extent, owner = extents[name[5:]]
        raise ValueError(f"{where}: {name} is {int(scalar)}, but {owner} has {extent} along {name[5:]}")
    return scalar
