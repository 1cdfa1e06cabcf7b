"""Coefficient maps as textures that renderers load, with a JSON file that says what they mean (docs/textures.md)."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clrelight.bases import require_sh
from clrelight.codec import Encoded
from clrelight.codec.formats.dds import dds_header
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.durable import check_output, naming, replacing, replacing_folder
from clrelight.errors import InputError, unknown
from clrelight.exchange.block_files import BlockFiles, put_blocks
from clrelight.exchange.channels import ExrFile, exr_spec
from clrelight.passes import map_rows

EXPORTS = {"dds": "BC6H_SF16", "exr": "float32", "exr-half": "float16"}
"""Formats, and the type of a texel's components in each."""

NOTES = "textures.json"
_OPEN_IMAGES = 64
"""Images that are written at once: a process may have few files open."""
_PLAIN_RANGE = (2.0**-6, 2.0**15)
"""Largest magnitudes that halves hold well as they are; others are scaled by a power of two."""


@dataclass(frozen=True)
class _Texture:
    """One texture: its name without extension, and the (coefficient, channel) that each component holds."""

    name: str
    planes: list[tuple[int, int]]


def check_export(out: str | os.PathLike, file_format: str, inputs: Iterable[str | os.PathLike] = ()) -> None:
    """Raise InputError if an export cannot go to `out` as it looks now; for asking before long work."""
    if file_format not in EXPORTS:
        raise unknown("format", file_format, EXPORTS)
    target = Path(os.fsdecode(out))
    if _is_array(target):
        if file_format != "dds":
            raise InputError(f"a texture array is a DDS file, format {file_format} needs a folder, got {target}")
        for file in (target, _notes_of(target)):
            check_output(file, inputs)
        return
    with naming(target):
        if not target.name or not target.parent.is_dir():
            raise InputError(f"cannot write {target}: there is no folder {target.parent}")
        if target.exists() and not (target.is_dir() and not any(target.iterdir())):
            raise InputError(f"cannot write {target}: it is there and is no empty folder, choose another name")


def export_textures(
    coefficients: CoefficientMap,
    out: str | os.PathLike,
    file_format: str = "dds",
    *,
    blocks: Encoded | None = None,
    device: Device,
    progress: Callable[[int, int], None] | None = None,
) -> list[Path]:
    """Write a map's coefficients as textures.

    A texture holds the channels of one coefficient. A DDS texture has three components: with a channel count other
    than 3 it holds three consecutive planes ``k channel + c``; such an EXR file holds one plane.

    Parameters
    ----------
    coefficients : CoefficientMap
    out : path
        A name that ends in ``.dds`` becomes one texture array of all coefficients, with the notes in
        ``NAME.dds.json`` beside it; any other a new folder of textures, with the notes in ``textures.json``.
    file_format : str
        One of `EXPORTS`.
    blocks : Encoded, optional
        The map as codec `bc6h` has encoded it, so that a DDS file holds these very blocks.
    device : Device
        Where blocks are encoded.
    progress : callable, optional
        Called with rows done and in all.

    Returns
    -------
    list of Path
        What was written, the notes last.

    Raises
    ------
    InputError
        If the format is unknown, coefficients are not of spherical harmonics, or `out` cannot be written: nothing was.
    """
    require_sh(coefficients.basis)
    check_export(out, file_format)
    target, shape = Path(os.fsdecode(out)), (coefficients.n_coeff, *coefficients.image_shape)
    scale = 1.0 if file_format == "exr" or blocks is not None else _choose_scale(coefficients)
    textures = _list_textures(shape, whole_texels=file_format == "dds")
    notes = _describe(coefficients, textures, file_format, scale)
    if _is_array(target):
        for layer, entry in enumerate(notes["textures"]):
            entry |= {"file": target.name, "layer": layer}
        with replacing(target) as array, replacing(_notes_of(target)) as beside, naming(target):
            header = dds_header(shape, len(textures))
            array.write(header)
            files = BlockFiles([array.descriptor], len(header))
            put_blocks(blocks or coefficients, files, device, scale=scale, progress=progress)
            beside.write(_to_json(notes))
        return [target, _notes_of(target)]
    with replacing_folder(target) as folder, naming(target):
        names = [folder / entry["file"] for entry in notes["textures"]]
        if file_format == "dds":
            _write_blocks(names, blocks or coefficients, shape, scale, device, progress)
        else:
            _write_images(names, coefficients, textures, EXPORTS[file_format], scale, progress)
        (folder / NOTES).write_bytes(_to_json(notes))
    return [target / name for name in (*(entry["file"] for entry in notes["textures"]), NOTES)]


def _write_blocks(
    names: list[Path],
    held: CoefficientMap | Encoded,
    shape: tuple[int, int, int, int],
    scale: float,
    device: Device,
    progress: Callable[[int, int], None] | None,
) -> None:
    header = dds_header(shape, 1)
    for name in names:
        name.write_bytes(header)
    put_blocks(held, BlockFiles(names, len(header)), device, scale=scale, progress=progress)


def _write_images(
    names: list[Path],
    coefficients: CoefficientMap,
    textures: list[_Texture],
    component: str,
    scale: float,
    progress: Callable[[int, int], None] | None,
) -> None:
    """Write all images, so many at once as may be open, in one pass through the coefficients each."""
    height, width, _ = coefficients.image_shape
    letters = {1: "Y", 3: "RGB"}[len(textures[0].planes)]
    spec = exr_spec(width, height, letters, {"float32": "float", "float16": "half"}[component])
    passes = range(0, len(names), _OPEN_IMAGES)
    for done, start in enumerate(passes):
        some = textures[start : start + _OPEN_IMAGES]
        outputs = [ExrFile(name, spec) for name in names[start : start + _OPEN_IMAGES]]
        for (first, end), rows_khwc in map_rows(coefficients):
            if scale != 1.0:
                np.divide(rows_khwc, np.float32(scale), out=rows_khwc)
            for output, texture in zip(outputs, some, strict=True):
                pixels_hwc = np.stack([rows_khwc[k, :, :, c] for k, c in texture.planes], axis=-1)
                output.write(first, pixels_hwc.astype(component))
            if progress is not None:
                progress(done * height + end, len(passes) * height)
        for output in outputs:
            output.close()


def _is_array(target: Path) -> bool:
    return target.suffix.lower() == ".dds"


def _notes_of(array: Path) -> Path:
    return array.with_name(array.name + ".json")


def _choose_scale(coefficients: CoefficientMap) -> float:
    """Return the power of two that coefficients are divided by so that halves hold them: 1 for usual ones."""
    largest = 0.0
    for _, rows_khwc in map_rows(coefficients):
        largest = max(largest, float(rows_khwc.max()), -float(rows_khwc.min()))
    if largest == 0.0 or _PLAIN_RANGE[0] <= largest <= _PLAIN_RANGE[1]:
        return 1.0
    # Within what float32 can divide by, and multiply with again.
    return math.ldexp(1.0, min(max(math.frexp(largest)[1], -126), 127))


def _list_textures(shape: tuple[int, ...], *, whole_texels: bool) -> list[_Texture]:
    """Return the textures in the order of the coefficients; DDS layers in that of the encoded groups."""
    n_coeff, _, _, channel = shape
    planes = [(k, c) for k in range(n_coeff) for c in range(channel)]
    if channel == 3 or (channel == 1 and not whole_texels):
        digits = max(2, len(str(n_coeff - 1)))
        return [_Texture(f"coeff{k:0{digits}}", planes[k * channel : (k + 1) * channel]) for k in range(n_coeff)]
    size = 3 if whole_texels else 1
    digits = max(2, len(str(len(planes) - 1)))
    return [_Texture(f"planes{i:0{digits}}", planes[i : i + size]) for i in range(0, len(planes), size)]


def _describe(coefficients: CoefficientMap, textures: list[_Texture], file_format: str, scale: float) -> dict[str, Any]:
    height, width, channel = coefficients.image_shape
    extension = file_format.partition("-")[0]
    return {
        "format": extension,
        "component": EXPORTS[file_format],
        "name": coefficients.name,
        "method": coefficients.method,
        "degree": coefficients.degree,
        "n_coeff": coefficients.n_coeff,
        "height": height,
        "width": width,
        "channels": channel,
        "basis": "real spherical harmonics y_k, orthonormal on the sphere, no Condon-Shortley sign; k = l (l + 1) + m",
        "axes": "light direction s from the surface to the light: x right, y up, z to the camera; first row on top",
        "radiance": "radiance[c] = scale * sum over k of y_k(s) * value[k, c]; linear, 1 means the peak",
        "scale": scale,
        "peak": coefficients.peak,
        "transfer": coefficients.transfer,
        "planes": "what the components of each texture hold, in order, as [k, channel]",
        "textures": [
            {"file": f"{texture.name}.{extension}", "planes": [list(plane) for plane in texture.planes]}
            for texture in textures
        ],
    }


def _to_json(notes: dict[str, Any]) -> bytes:
    """Return one line for each fact and each texture."""
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in notes.items() if key != "textures"]
    textures = ",\n".join(f"  {json.dumps(texture)}" for texture in notes["textures"])
    return ("{\n" + ",\n".join([*lines, f' "textures": [\n{textures}\n ]']) + "\n}\n").encode()
