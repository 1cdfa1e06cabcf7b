"""What a file is, without a caller knowing beforehand."""

from __future__ import annotations

import math
import os
from typing import Any

from clrelight.store.encodings import encoded_of, parts_of
from clrelight.store.fits import fit_of
from clrelight.store.lights import light_of
from clrelight.store.opening import Opened, opening, parse_config, refusing
from clrelight.store.schemas import FIT, SCHEMAS, STACK, TILES
from clrelight.store.shards import opening_fit
from clrelight.store.shrms import shrm_of
from clrelight.store.stacks import stack_of
from clrelight.store.surfaces import describe_surface
from clrelight.store.tables import results_of
from clrelight.surface import Surface


def file_schema(path: str | os.PathLike) -> str:
    """Return ``"stack/1"`` or the like; errors as of `open_stack`. Values are not looked at, only what there is."""
    with opening(path) as opened:
        return opened.schema.name


def describe(path: str | os.PathLike) -> dict[str, Any]:
    """Return a summary of a file whose small parts were read and found sound.

    Returns
    -------
    dict
        JSON values: ``file``, ``schema``, ``bytes_on_disk``, ``attributes``, and ``datasets`` with ``shape``,
        ``dtype``, ``axes`` and ``chunks`` of each; of results, numbers of rows and keys instead of each picture; of a
        stack, ``notes`` on what another program left open; where there is one, what ``surface`` it is of; of a file
        behind a URL, ``fetched``.

    Raises
    ------
    InputError
        If there is no such file.
    StoreFormatError
        If it is not sound.
    """
    with opening_fit(path, *SCHEMAS) as opened, refusing(opened.path):
        attributes = opened.attributes() if opened.sealed or opened.schema.kind != STACK.kind else {}
        for name in ("config", "fit_config"):
            if name in attributes:
                attributes[name] = parse_config(attributes[name], name)
        summary = {
            "file": opened.path,
            "schema": opened.schema.name,
            "bytes_on_disk": opened.place.size,
            "attributes": attributes,
            "datasets": _datasets(opened),
        }
        summary.update(_checked(opened))
        if traffic := opened.place.traffic():
            summary["fetched"] = traffic
        return summary


def _checked(opened: Opened) -> dict[str, Any]:
    """Run the checks of the file's own kind; return what only that kind has to tell."""
    match opened.schema.kind:
        case "stack":
            return _stack_facts(opened)
        case "fit" | "tiles":
            return _surface_facts(fit_of(opened, opened.arrays.get).surface)
        case "encoded":
            encoded, record = encoded_of(opened, *parts_of(opened), summed=opened.place.remote is None)
            info = {key: value if math.isfinite(value) else None for key, value in encoded.info.items()}
            facts = {
                **{name: getattr(record, name) for name in ("method", "degree", "peak", "transfer", "name")},
                **{"fit_config": dict(record.config), "codec": encoded.codec, "config": dict(encoded.config)},
                "encoded_bytes": encoded.encoded_bytes,
                "bits_per_coefficient": encoded.bits_per_coefficient,
            }
            return {
                "attributes": facts,
                "shape": list(encoded.shape),
                "info": info,
                "lights": len(record.directions_i3),
            }
        case "light":
            light_of(opened)
        case "shrm":
            shrm_of(opened)
        case "results":
            results = results_of(opened)
            return {"rows": len(results.table), "pictures": [*results.pictures], "profiles": [*results.profiles]}
    return {}


def _stack_facts(opened: Opened) -> dict[str, Any]:
    """Return what a stack is taken for, which may be more than another program wrote."""
    stack, datasets = stack_of(opened), _datasets(opened)
    datasets["images"]["shape"] = list(stack.images_ihwc.shape)
    facts = {"peak": stack.peak, "transfer": stack.transfer, "name": stack.name}
    notes = {"notes": list(stack.notes)} if stack.notes else {}
    return {"attributes": facts, "datasets": datasets, **notes, **_surface_facts(stack.surface)}


def _surface_facts(surface: Surface | None) -> dict[str, Any]:
    return {} if surface is None else {"surface": describe_surface(surface)}


def _datasets(opened: Opened) -> dict[str, Any]:
    fields = FIT.fields if opened.schema.kind == TILES.kind else opened.schema.fields
    return {
        name: {
            "shape": list(array.shape),
            "dtype": array.dtype.name if array.dtype.names is None else "row",
            "axes": [axis for axis in fields[name].axes if axis],
            "chunks": None if array.chunks is None else list(array.chunks),
        }
        for name, array in opened.arrays.items()
        if name in fields
    }
