"""Environment maps: pictures of the light that arrives from every direction."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.conventions import TRANSFERS, default_peak, srgb_to_linear
from clrelight.errors import InputError
from clrelight.images import read_image
from clrelight.lighting import layouts
from clrelight.lighting.dds import read_dds_faces

STORED_LAYOUTS = ("angular", "latlong", "cube")
"""Layouts that maps are held in; crosses and strips are cut into the faces of a cube."""


@dataclass(frozen=True)
class Environment:
    """Radiance on the whole sphere; checked when made.

    Attributes
    ----------
    radiance_hwc : ndarray, shape (height, width, 1 or 3), float32
        Linear radiance, finite and not negative where the layout shows something.
    layout : str
        One of `STORED_LAYOUTS`; the six faces of a cube lie one below the other.
    axes : str
        Where our x, y and z point in the map's view: a name or words, see `layouts.parse_axes`.
    source : str
        What it was read from.
    """

    radiance_hwc: NDArray[np.float32]
    layout: str
    axes: str = "z-up"
    source: str = "environment"

    def __post_init__(self) -> None:
        shape = self.radiance_hwc.shape
        if self.layout not in STORED_LAYOUTS:
            raise InputError(f"layout must be one of {', '.join(STORED_LAYOUTS)}, got {self.layout!r}")
        if self.radiance_hwc.dtype != np.float32 or len(shape) != 3 or shape[2] not in (1, 3):
            raise InputError(
                f"an environment is float32 (height, width, 1 or 3), got {self.radiance_hwc.dtype} {shape}"
            )
        layouts.check_layout(_aspect_name(self.layout), shape[0], shape[1], self.source)
        check_texels(self.radiance_hwc, layouts.used_texels(self.layout, *shape[:2]), self.source)
        object.__setattr__(self, "axes", layouts.parse_axes(self.axes)[0])

    @property
    def channels(self) -> int:
        """1 or 3."""
        return int(self.radiance_hwc.shape[2])

    @property
    def resolved_degree(self) -> int:
        """Largest degree whose products with itself the rows from pole to pole can tell apart."""
        height, width = self.radiance_hwc.shape[:2]
        rows = {"latlong": height, "angular": height // 2, "cube": 2 * width}[self.layout]
        return (rows - 1) // 2

    def geometry(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return directions (n_texel, 3) in our axes and solid angles (n_texel,) of the texels, float64."""
        view_t3, weights_t = layouts.texel_geometry(self.layout, *self.radiance_hwc.shape[:2])
        return view_t3 @ layouts.parse_axes(self.axes)[1].T, weights_t


def read_environment(
    paths: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    *,
    layout: str | None = None,
    axes: str = "z-up",
    transfer: str = "srgb",
) -> tuple[Environment, list[str]]:
    """Read an environment map from one picture, or from six faces of a cube.

    Parameters
    ----------
    paths : path or sequence of paths
        HDR, EXR, DDS or any picture; or six faces in the order +X -X +Y -Y +Z -Z of Direct3D (in any order where their
        names say which is which: posx, px, right, ...).
    layout : str, optional
        One of `layouts.LAYOUTS`; by default the one whose aspect the picture has.
    axes : str
        See `layouts.parse_axes`.
    transfer : str
        Curve of pictures of integers, ``"srgb"`` or ``"linear"``; floats are linear radiance.

    Returns
    -------
    Environment
    notes : list of str
        What a user should know, such as that the highlights of an 8-bit picture are clipped.

    Raises
    ------
    InputError
        If a file cannot be read, the size is not of the layout, or a texel is negative or not finite.
    """
    files = [Path(paths)] if isinstance(paths, str | os.PathLike) else [Path(path) for path in paths]
    if layout is not None and layout not in layouts.LAYOUTS:
        raise InputError(f"layout must be one of {', '.join(layouts.LAYOUTS)}, got {layout!r}")
    if transfer not in TRANSFERS:
        raise InputError(f"transfer must be one of {', '.join(TRANSFERS)}, got {transfer!r}")
    layouts.parse_axes(axes)
    if len(files) not in (1, 6):
        raise InputError(f"an environment is one picture or the six faces of a cube, got {len(files)} files")
    source = ", ".join(file.name for file in files)
    notes: list[str] = []
    if len(files) == 6:
        files = [files[i] for i in layouts.face_order([file.name for file in files])]
        picture, stored = _read_faces(files, layout, transfer, notes), "cube"
    elif files[0].suffix.lower() == ".dds":
        _want_cube(layout, "a DDS file")
        faces = read_dds_faces(files[0]).astype(np.float32)
        picture, stored = faces.reshape(-1, *faces.shape[2:]), "cube"
    else:
        picture, stored = _read_picture(files[0], layout, transfer, notes)
    return Environment(np.ascontiguousarray(picture), stored, axes, source), notes


def check_texels(radiance_hwc: NDArray, used_hw: NDArray[np.bool_], what: str) -> None:
    """Raise InputError, naming the first used texel that is negative or not finite."""
    with np.errstate(invalid="ignore"):
        bad = ~(np.isfinite(radiance_hwc) & (radiance_hwc >= 0)) & used_hw[..., None]
    if bad.any():
        row, column, channel = (int(v) for v in np.argwhere(bad)[0])
        raise InputError(
            f"{what}: the texel at row {row}, column {column}, channel {channel} is "
            f"{radiance_hwc[row, column, channel]}: radiance must be finite and not negative"
        )


def _aspect_name(layout: str) -> str:
    return "vertical-strip" if layout == "cube" else layout


def _want_cube(layout: str | None, what: str) -> None:
    if layout not in (None, "cube"):
        raise InputError(f"{what} is a cube map, it cannot be of layout {layout}")


def _read_faces(files: list[Path], layout: str | None, transfer: str, notes: list[str]) -> NDArray[np.float32]:
    _want_cube(layout, "what six files hold")
    faces = [_read_linear(file, transfer, notes) for file in files]
    for file, face_hwc in zip(files, faces, strict=True):
        if face_hwc.shape != faces[0].shape or face_hwc.shape[0] != face_hwc.shape[1]:
            raise InputError(
                f"the faces of a cube are squares of one size and channel count: {file} has shape {face_hwc.shape}, "
                f"{files[0]} {faces[0].shape}"
            )
        check_texels(face_hwc, layouts.used_texels("latlong", *face_hwc.shape[:2]), str(file))
    return np.concatenate(faces)


def _read_picture(file: Path, layout: str | None, transfer: str, notes: list[str]) -> tuple[NDArray[np.float32], str]:
    picture_hwc = _read_linear(file, transfer, notes)
    height, width = picture_hwc.shape[:2]
    found = layout or layouts.detect_layout(height, width)
    if found is None:
        aspects = ", ".join(f"{name} {wide}:{high}" for name, (wide, high) in layouts.ASPECTS.items())
        raise InputError(f"{file} has {width}×{height} texels, which no layout has ({aspects})")
    if found == "cube":
        raise InputError(f"a cube is six files or a DDS file, {file} is one picture: say which cross or strip it is")
    if found == "angular" and layout is None and layouts.face_of(file.name) is not None:
        raise InputError(f"{file} is named as one face of a cube: give all six, or --layout angular")
    layouts.check_layout(found, height, width, str(file))
    check_texels(picture_hwc, layouts.used_texels(found, height, width), str(file))
    if found in STORED_LAYOUTS:
        return picture_hwc, found
    faces = layouts.cut_faces(picture_hwc, found)
    return faces.reshape(-1, *faces.shape[2:]), "cube"


def _read_linear(file: Path, transfer: str, notes: list[str]) -> NDArray[np.float32]:
    values = read_image(file)
    if values.dtype.kind == "f":
        return values.astype(np.float32)
    bits = 8 * values.dtype.itemsize
    notes.append(
        f"{file.name} holds {bits}-bit values, taken as {transfer}: what was brighter than white in it is clipped"
    )
    scaled = values / default_peak(values.dtype)
    return (srgb_to_linear(scaled) if transfer == "srgb" else scaled).astype(np.float32)
