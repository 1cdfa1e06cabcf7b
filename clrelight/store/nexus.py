"""What other programs open a file on: NeXus defaults, units, and a picture that they find by themselves.

The root is an ``NXroot`` whose default is the group `VIEW`, an ``NXentry``; in it lie ``NXdata`` groups, of which
``picture`` is the default: one image, its rows and columns the last two axes, or colours behind them. Pictures take no
room: they are virtual datasets over the file's own, and links to it. No reader of ours opens any of it, so checksums do
not cover it, and a file without it is the same file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import h5py
import numpy as np

from clrelight.store.schemas import Schema

VIEW = "view"
"""The group that other programs open first."""

MOST_PICTURES = 64
"""Of results that are shown beside each other."""

_SIDE = np.array([-1.0, 1.0, 2.0]) / np.sqrt(6.0)
"""The light that shows most of a relief: from the upper left, 35 degrees off the view."""

UNITS = {
    "images": ("", "code values; radiance is value / peak, after the curve of transfer"),
    "coefficients": ("1", "spherical-harmonic coefficients of radiance in units of the peak"),
    "maps": ("1", "spherical-harmonic coefficients of the view"),
    "directions": ("1", "unit vectors towards the lights: x right, y up, z to the camera"),
    "weights": ("sr", "solid angle of each light's cell"),
    "mask": ("1", "1 where pixels count"),
    "lambda": ("1", "regularisation"),
    "rank": ("1", "eigenvectors kept"),
    "light": ("1", "light"),
    "height": ("pixel", "row, from the top"),
    "width": ("pixel", "column, from the left"),
    "channel": ("1", "channel: red, green, blue where there are three"),
    "coefficient": ("1", "index l (l + 1) + m"),
    "xyz": ("1", "x, y, z"),
}
"""Units and a line for axes and legends, of datasets by their names."""


def describe(file: h5py.File, schema: Schema) -> None:
    """Add units to the datasets of a file that is being written, and the groups that others open it on."""
    for name in sorted(set(file) & UNITS.keys()):
        unit, words = UNITS[name]
        unit = unit or ("count" if file[name].dtype.kind == "u" else "1")
        _write(file[name], {"units": unit, "long_name": words})
    add = {"stack": _view_stack, "fit": _view_maps, "shrm": _view_maps, "light": _view_light, "results": _view_results}
    add.get(schema.kind, lambda file: None)(file)


def view_picture(file: h5py.File, picture_hwc: np.ndarray, title: str) -> None:
    """Store a small picture, uint8 (height, width, 1 or 3), as what others open a file on."""
    shown = picture_hwc[..., 0] if picture_hwc.shape[2] == 1 else picture_hwc
    group = _data(_entry(file, "picture"), "picture", "picture", ["."] * shown.ndim, title)
    held = group.create_dataset("picture", data=shown, compression="gzip", track_times=False)
    _write(held, {"interpretation": "rgb-image" if shown.ndim == 3 else "image", "long_name": title})


def _view_stack(file: h5py.File) -> None:
    images, directions = file["images"], file["directions"][...]
    if not images.size:
        return
    light = int(np.argmax(directions @ _SIDE))
    where = ", ".join(f"{part:.2f}" for part in directions[light])
    _view_series(file, images, light, f"light {light} of {len(images)}, from {where}")


def _view_maps(file: h5py.File) -> None:
    maps = file["coefficients" if "coefficients" in file else "maps"]
    if maps.size:
        _view_series(file, maps, 0, "coefficient 0: what light from everywhere shows")


def _view_series(file: h5py.File, source: h5py.Dataset, shown: int, title: str) -> None:
    """Add one image of a series (n, height, width, channel), and all of them."""
    entry, name = _entry(file, "picture"), source.name.strip("/")
    axes = _scales(source)
    parts: list[tuple[tuple, tuple]]
    coloured, channels = source.shape[3] == 3, range(source.shape[3])
    if coloured:
        _write(source, {"interpretation": "rgb-image"})
        parts, order = [((shown, ...), (...,))], axes[1:]
    elif len(channels) == 1:
        parts, order = [((shown, ..., 0), (...,))], axes[1:3]
    else:
        parts, order = [((shown, ..., c), (c, ...)) for c in channels], [axes[3], *axes[1:3]]
    group = _data(entry, "picture", "picture", order, title)
    _virtual(group, "picture", source, [len(file[axis]) for axis in order], parts)
    _write(group["picture"], {"interpretation": "rgb-image" if coloured else "image", "long_name": title})
    _link(group, file, order)

    if coloured:
        parts, order = [((...,), (...,))], axes
    elif len(channels) == 1:
        parts, order = [((..., 0), (...,))], axes[:3]
    else:
        parts, order = [((..., c), (c, ...)) for c in channels], [axes[3], *axes[:3]]
    group = _data(entry, name, name, order, f"all {len(source)}")
    _virtual(group, name, source, [len(file[axis]) for axis in order], parts)
    _write(group[name], {"interpretation": "rgb-image" if coloured else "image", "long_name": UNITS[name][1]})
    _link(group, file, order)


def _view_light(file: h5py.File) -> None:
    source = file["coefficients"]
    if not source.size:
        return
    group = _data(_entry(file, "coefficients"), "coefficients", "coefficients", ("channel", "coefficient"), "light")
    _virtual(group, "coefficients", source, source.shape[::-1], [((..., c), (c, ...)) for c in range(source.shape[1])])
    _write(group["coefficients"], {"interpretation": "spectrum", "long_name": UNITS["coefficients"][1]})
    _link(group, file, ("channel", "coefficient"))


def _view_results(file: h5py.File) -> None:
    pictures = [item for _, item in sorted(file["pictures"].items())] if "pictures" in file else []
    alike = [item for item in pictures if item.shape == pictures[0].shape][:MOST_PICTURES]
    if not alike:
        return
    coloured = alike[0].shape[2] == 3
    names = [item.name.rpartition("/")[2] for item in alike]
    group = _data(_entry(file, "pictures"), "pictures", names[0], ["."] * (2 + coloured), "one light's image")
    if len(names) > 1:
        _write(group, {"auxiliary_signals": names[1:]})
    for name, item in zip(names, alike, strict=True):
        if coloured:
            group[name] = item
        else:
            _virtual(group, name, item, item.shape[:2], [((..., 0), (...,))])
        key = bytes(item.attrs["key"]).decode()
        _write(group[name], {"interpretation": "rgb-image" if coloured else "image", "long_name": key})


def _entry(file: h5py.File, default: str) -> h5py.Group:
    entry = _group(file, VIEW)
    _write(file, {"NX_class": "NXroot", "default": VIEW})
    _write(entry, {"NX_class": "NXentry", "default": default})
    return entry


def _data(entry: h5py.Group, name: str, signal: str, axes: Sequence[str], title: str) -> h5py.Group:
    group = _group(entry, name)
    _write(group, {"NX_class": "NXdata", "signal": signal, "axes": list(axes)})
    group.attrs.create("title", title, dtype=h5py.string_dtype())  # silx shows one of fixed length as b'...'
    return group


def _group(parent: h5py.Group, name: str) -> h5py.Group:
    properties = h5py.h5p.create(h5py.h5p.GROUP_CREATE)
    properties.set_obj_track_times(False)  # the same input gives the same bytes
    return h5py.Group(h5py.h5g.create(parent.id, name.encode(), gcpl=properties))


def _virtual(
    group: h5py.Group,
    name: str,
    source: h5py.Dataset,
    shape: Sequence[int],
    parts: Sequence[tuple[tuple, tuple]],
) -> None:
    """Add a dataset whose `parts` are those of `source`: pairs of indices, there and here."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    for there, here in parts:
        spaces = [h5py.h5s.create_simple(tuple(extent)) for extent in (shape, source.shape)]
        for space, index in zip(spaces, (here, there), strict=True):
            extent = space.shape
            at = index.index(...)
            whole = [*index[:at], *[None] * (len(extent) - len(index) + 1), *index[at + 1 :]]
            space.select_hyperslab(
                tuple(0 if each is None else each for each in whole),
                tuple(n if each is None else 1 for each, n in zip(whole, extent, strict=True)),
            )
        properties.set_virtual(spaces[0], b".", source.name.encode(), spaces[1])
    # Programs in browsers read no halves: HDF5 converts them as they are read.
    held = h5py.h5t.IEEE_F32LE if source.dtype == np.float16 else source.id.get_type()
    h5py.h5d.create(group.id, name.encode(), held, h5py.h5s.create_simple(tuple(shape)), properties)


def _scales(source: h5py.Dataset) -> list[str]:
    return [axis[0].name.strip("/") for axis in source.dims]


def _link(group: h5py.Group, file: h5py.File, names: Sequence[str]) -> None:
    for name in names:
        group[name] = file[name]


def _write(target: h5py.HLObject, values: Mapping[str, str | list[str]]) -> None:
    for name, value in values.items():
        texts = [each.encode() for each in ([value] if isinstance(value, str) else value)]
        held = h5py.string_dtype("utf-8", max(map(len, texts)) or 1)
        target.attrs.create(name, np.array(texts[0] if isinstance(value, str) else texts, dtype=held))
