"""Attributes: those to be written, and those of files that somebody else may have made."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np

from clrelight.errors import InputError, StoreFormatError

MAX_ATTRIBUTE_BYTES = 1 << 20
MAX_TEXT_BYTES = 32 << 10  # HDF5 keeps attributes up to 64 KiB within the checksummed object header


def read_bytes(attribute: h5py.h5a.AttrID, name: str) -> bytes:
    """Return the value of an attribute that is an array of uint8."""
    if attribute.dtype != np.uint8 or len(attribute.shape) != 1 or not 0 < attribute.shape[0] <= MAX_ATTRIBUTE_BYTES:
        raise StoreFormatError(f"attribute {name} must be bytes, got {attribute.dtype} {attribute.shape}")
    value = np.empty(attribute.shape, np.uint8)
    attribute.read(value)
    return value.tobytes()


def read_scalar(attribute: h5py.h5a.AttrID, name: str, kind: type) -> Any:
    """Return the value of an attribute of one element, whatever its shape; texts may have any length."""
    held, space = attribute.get_type(), attribute.get_space()
    classes = {str: (h5py.h5t.STRING,), int: (h5py.h5t.INTEGER,), float: (h5py.h5t.FLOAT, h5py.h5t.INTEGER)}[kind]
    if (
        space.get_simple_extent_type() not in (h5py.h5s.SCALAR, h5py.h5s.SIMPLE)
        or space.get_simple_extent_npoints() != 1
        or held.get_class() not in classes
        or held.get_size() > (MAX_ATTRIBUTE_BYTES if kind is str else 8)
    ):
        raise StoreFormatError(f"attribute {name} must be one {'text' if kind is str else kind.__name__}")
    value = np.empty(attribute.shape, dtype=attribute.dtype)
    attribute.read(value)
    if kind is not str:
        return kind(value.reshape(-1)[0])
    if held.is_variable_str():
        text = value.reshape(-1)[0]
        return text if isinstance(text, str) else bytes(text).decode("utf-8")
    padding = b" " if held.get_strpad() == h5py.h5t.STR_SPACEPAD else b"\0"
    return value.tobytes().rstrip(padding).decode("utf-8")


def text_bytes(name: str, value: str) -> bytes:
    """Return a text that is to be an attribute; InputError if it cannot be one."""
    try:
        text = value.encode("utf-8")
    except UnicodeEncodeError:
        raise InputError(f"{name} must be text without lone surrogates, got {value!r}") from None
    if b"\0" in text or len(text) > MAX_TEXT_BYTES:
        raise InputError(f"{name} must be at most {MAX_TEXT_BYTES} bytes without NUL, got {len(text)} bytes")
    return text
