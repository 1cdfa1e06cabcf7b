"""Surfaces as jobs are given them: a record, a mesh file, or a fit or stack of ours."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from clrelight.errors import InputError
from clrelight.jobs.inputs import path_text
from clrelight.store import file_schema, open_fit, open_stack
from clrelight.surface import Surface, surface_facts
from clrelight.transfer.frames import with_frames
from clrelight.transfer.mesh_files import read_mesh
from clrelight.transfer.vertex_order import reorder

MeshLike = str | os.PathLike[str] | Surface


def take_surface(mesh: MeshLike, *, colors: bool = False, up: str | None = None) -> Surface:
    """Return the surface of a mesh file (see `read_mesh`), or of a fit or stack; InputError if there is none."""
    if isinstance(mesh, Surface):
        return mesh
    name = path_text(mesh, "a mesh")
    if is_mesh_file(mesh):
        return read_mesh(name, colors=colors, up=up)
    if up is not None:
        raise InputError("--up is for mesh files: fits and stacks hold their surface as it stands")
    opening: Any = open_stack if file_schema(name).startswith("stack") else open_fit
    with opening(name) as held:
        if held.surface is None:
            raise InputError(f"{name} holds no surface: its pixels are those of a picture")
        surface: Surface = held.surface
        return surface


def mesh_config(order: str, up: str | None) -> dict[str, str]:
    """Return what a map says of how its mesh was taken, for `take_surface_of`."""
    return ({} if order == "file" else {"order": order}) | ({} if up is None else {"up": up})


def take_surface_of(config: Mapping[str, Any], mesh: MeshLike, *, up: str | None = None) -> Surface:
    """Return the surface with its vertices in the order that a map of this config has them in.

    A mesh file is turned as the map's was, where `up` says nothing else.
    """
    if not is_mesh_file(mesh):
        return take_surface(mesh, up=up)
    surface, order = take_surface(mesh, up=up or config.get("up")), config.get("order", "file")
    return surface if order == "file" else reorder(surface, order)[0]


def frame_as_made(config: Mapping[str, Any], surface: Surface) -> Surface:
    """Return the surface with functions in the frames, and of the directions, that a map of this config says.

    Maps that were encoded say them (see `clrelight.codec.Encoded`). A mesh file holds no frames: those that transfer
    makes are made again, others are an InputError.
    """
    said = surface_facts(None, config) or {}
    frame = said.get("frame", config.get("frame"))
    if frame == "local" and surface.tangents_v3 is None and "frame" not in config:
        raise InputError(
            f"the functions are in frames of the vertices that {surface.name} does not hold: give the fit or the stack "
            "that was encoded as --mesh"
        )
    framed = surface if frame is None else with_frames(surface, frame)
    return replace(framed, argument=said.get("argument", surface.argument))


def is_mesh_file(mesh: MeshLike) -> bool:
    """Return whether this is the path of anything but a fit or a stack of ours."""
    return not isinstance(mesh, Surface) and not path_text(mesh, "a mesh").lower().endswith((".h5", ".hdf5"))
