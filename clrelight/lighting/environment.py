"""Environment maps: pictures of the light that arrives from every direction."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from clrelight.arrays import check_transfer
from clrelight.conventions import default_peak, srgb_to_linear
from clrelight.errors import InputError
from clrelight.image_header import ImageHeader
from clrelight.images import read_header, read_image
from clrelight.lighting import layouts
from clrelight.lighting.dds import read_dds_faces
from clrelight.negatives import Negatives

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
        """Largest degree whose products with itself the rows from pole to pole can tell apart; 0 of a single texel."""
        height, width = self.radiance_hwc.shape[:2]
        rows = {"latlong": height, "angular": height // 2, "cube": 2 * width}[self.layout]
        return max(rows - 1, 0) // 2

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
    layer: str | None = None,
    clip_negative: bool = False,
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
    layer : str, optional
        Which layer of an EXR is read; see `image_parts.choose_picture`.
    clip_negative : bool
        Set negative texels to 0, however large. By default only those within a thousandth of the typical one are,
        which lossy compression leaves; others are refused.

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
    check_transfer(transfer)
    layouts.parse_axes(axes)
    if len(files) not in (1, 6):
        raise InputError(f"an environment is one picture or the six faces of a cube, got {len(files)} files")
    source = ", ".join(file.name for file in files)
    notes: list[str] = []
    reading = _Reading(transfer, layer, clip_negative, notes)
    if len(files) == 6:
        files = [files[i] for i in layouts.face_order([file.name for file in files])]
        picture, stored = _read_faces(files, layout, reading), "cube"
    elif files[0].suffix.lower() == ".dds":
        _want_cube(layout, "a DDS file")
        if layer is not None:
            raise InputError(f"a DDS file has no layers, got --layer {layer}")
        faces = read_dds_faces(files[0]).astype(np.float32)
        stacked_hwc = faces.reshape(-1, *faces.shape[2:])
        picture, stored = reading.clip(stacked_hwc, layouts.used_texels("cube", *stacked_hwc.shape[:2]), source), "cube"
    else:
        picture, stored = _read_picture(files[0], layout, reading)
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


@dataclass(frozen=True)
class _Reading:
    """How files are read, and what is to be said of them."""

    transfer: str
    layer: str | None
    clip_negative: bool
    notes: list[str]

    def read_linear(self, header: ImageHeader) -> NDArray[np.float32]:
        """Return a picture's linear radiance."""
        x, y, width, height = header.covers
        name = header.path.name
        if (width, height) != (header.width, header.height):
            raise InputError(
                f"{header.path} stores only {width}×{height} pixels at ({x}, {y}) of a picture of {header.width}×"
                f"{header.height} (its data and display windows), a map must show every direction"
            )
        self.notes.extend(f"{name}: {note}" for note in header.notes)
        if header.camera_orientation != 1:
            self.notes.append(f"{name} carries EXIF orientation {header.camera_orientation}, not applied")
        values = read_image(header)
        if values.dtype.kind == "f":
            return values.astype(np.float32)
        self.notes.append(
            f"{name} holds {8 * values.dtype.itemsize}-bit values, taken as {self.transfer}: what was brighter than "
            "white in it is clipped"
        )
        codes = np.arange(np.iinfo(values.dtype).max + 1) / default_peak(values.dtype)
        table = srgb_to_linear(codes) if self.transfer == "srgb" else codes
        return table.astype(np.float32)[values]

    def clip(self, radiance_hwc: NDArray[np.float32], used_hw: NDArray[np.bool_], what: str) -> NDArray[np.float32]:
        """Return radiance without small negative texels, or any where the user wants so; InputError else."""
        below = (radiance_hwc < 0) & used_hw[..., None] & np.isfinite(radiance_hwc)
        if below.any():
            lit = radiance_hwc[used_hw[..., None] & (radiance_hwc > 0)]
            negatives = Negatives(self.clip_negative)
            radiance_hwc = negatives.clip(np.where(used_hw[..., None], radiance_hwc, np.float32(0)), 0, what)
            typical = float(np.median(lit)) if lit.size else 0.0
            self.notes.extend(f"{Path(what).name}: {note}" for note in negatives.conclude(typical))
        check_texels(radiance_hwc, used_hw, what)
        return radiance_hwc


def _read_faces(files: list[Path], layout: str | None, reading: _Reading) -> NDArray[np.float32]:
    _want_cube(layout, "what six files hold")
    faces = [reading.read_linear(read_header(file, layer=reading.layer)) for file in files]
    for file, face_hwc in zip(files, faces, strict=True):
        if face_hwc.shape != faces[0].shape or face_hwc.shape[0] != face_hwc.shape[1]:
            raise InputError(
                f"the faces of a cube are squares of one size and channel count: {file} has shape {face_hwc.shape}, "
                f"{files[0]} {faces[0].shape}"
            )
    used_hw = np.ones(faces[0].shape[:2], bool)
    return np.concatenate([reading.clip(face, used_hw, str(file)) for file, face in zip(files, faces, strict=True)])


def _read_picture(file: Path, layout: str | None, reading: _Reading) -> tuple[NDArray[np.float32], str]:
    header = read_header(file, layer=reading.layer)
    height, width = header.height, header.width
    is_exr_cube = header.envmap == "cube" and layout in (None, "cube")
    found = "vertical-strip" if is_exr_cube else layout or header.envmap or layouts.detect_layout(height, width)
    if found is None:
        aspects = ", ".join(f"{name} {wide}:{high}" for name, (wide, high) in layouts.ASPECTS.items())
        raise InputError(f"{file} has {width}×{height} texels, which no layout has ({aspects})")
    if found == "cube":
        raise InputError(f"a cube is six files or a DDS file, {file} is one picture: say which cross or strip it is")
    if found == "angular" and layout is None and layouts.face_of(file.name) is not None:
        raise InputError(f"{file} is named as one face of a cube: give all six, or --layout angular")
    layouts.check_layout(found, height, width, str(file))
    picture_hwc = reading.clip(reading.read_linear(header), layouts.used_texels(found, height, width), str(file))
    if found in STORED_LAYOUTS:
        return picture_hwc, found
    faces = layouts.cut_faces(picture_hwc, found)
    if is_exr_cube:
        faces = faces[list(layouts.OPENEXR_FACES)]
        reading.notes.append(f"{file.name} is a cube as its envmap attribute says: -z is forward in it, y up")
    return faces.reshape(-1, *faces.shape[2:]), "cube"
