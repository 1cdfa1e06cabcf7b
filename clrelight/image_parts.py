"""Which pixels of an image file are its picture: the part or page, and the channels that hold radiance."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clrelight.errors import InputError, counted

_MORE_BANDS = "expected gray or R, G, B; images of more bands are read from a stack file of HDF5 (docs/files.md)"
_RGB = (("R", "G", "B"), ("RED", "GREEN", "BLUE"))
_LUMINANCE_CHROMA = {"RY", "BY"}
# Renderers' words for the picture itself, the most final first; compared with the last word of a layer's name.
_BEAUTY = ("composite", "combined", "beauty", "rgba", "rgb", "final", "image", "color", "colour", "main", "default")
# Depth, coverage, coordinates and identities: numbers of each pixel, but no light.
_NO_RADIANCE = re.compile(
    r"z|zback|z_?depth|depth.*|distance|a|alpha|.*\.a|mask|matte|mist|coverage|[uvwxn]|uv|ids?|index.*|samples|variance|"
    r"crypto.*|normals?|position|motion|velocity"
)
_SPECTRAL = re.compile(r"[0-9.,]+ ?nm|nir|ir|swir|lwir|rededge|red_edge|band.*|channel[0-9]+")
_CRYPTOMATTE = re.compile(r".*crypto(matte|object|asset|material)?[0-9_]*", re.IGNORECASE)


@dataclass(frozen=True)
class Picture:
    """What is read of a file.

    Attributes
    ----------
    part : int
        Part of an EXR, or page of a TIFF, counted from 0.
    channels : tuple of int
        Their numbers in the part: R, G and B, or one.
    alpha : int, optional
        The alpha channel beside them.
    layer : str
        How users call it; empty where a file has nothing else to choose from.
    notes : tuple of str
        What a user should know: which layer it is, and what is left unread.
    """

    part: int
    channels: tuple[int, ...]
    alpha: int | None = None
    layer: str = ""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Layer:
    """The channels of one name before the last dot, in one part, without alpha and depth."""

    part: int
    name: str
    part_name: str
    channels: tuple[int, ...]
    words: tuple[str, ...]
    alpha: int | None

    @property
    def label(self) -> str:
        return self.name or self.part_name

    @property
    def answers_to(self) -> set[str]:
        """Names by which a user may ask for it."""
        both = f"{self.part_name}.{self.name}" if self.name and self.part_name else ""
        named = {text.casefold() for text in (self.label, both) if text}
        return named or {"rgb"}

    @property
    def rank(self) -> int:
        """Smaller is more likely the picture, by the renderers' words."""
        words = {self.label.casefold().split(".")[place] for place in (0, -1)}
        return next((place for place, word in enumerate(_BEAUTY) if word in words), len(_BEAUTY))


def choose_picture(what: str, specs: Sequence[Any], *, is_exr: bool, layer: str | None = None) -> Picture:
    """Return what a file's picture is.

    Of an EXR: the layer of the name asked for; else channels R, G, B of no layer; else the layer that renderers name
    as theirs (``Combined``, ``beauty``, ...); else the only one with colours, or the only one that is one channel of
    luminance. Of other files: the largest page, the first of equal ones.

    Parameters
    ----------
    what : str
        Names the file in messages.
    specs : sequence of OpenImageIO.ImageSpec
        Of each part.
    is_exr : bool
    layer : str, optional
        Name of a layer or part of an EXR, number of a page (counted from 1) of another file.

    Raises
    ------
    InputError
        If nothing here is a picture in gray or R, G, B, or it cannot be told which.
    """
    if is_exr:
        return _choose_layer(what, specs, layer)
    return _choose_page(what, specs, layer)


def _choose_page(what: str, specs: Sequence[Any], layer: str | None) -> Picture:
    sizes = [spec.width * spec.height for spec in specs]
    page = sizes.index(max(sizes))
    notes: tuple[str, ...] = ()
    if layer is not None:
        if not layer.isascii() or not layer.isdigit() or not 1 <= int(layer) <= len(specs):
            raise InputError(f"{what} has no layer {layer!r}; it has {counted(len(specs), 'page')}, counted from 1")
        page = int(layer) - 1
    elif len(specs) > 1:
        notes = (f"of {len(specs)} pages number {page + 1} is read" + (", the largest" if page else ""),)
    spec = specs[page]
    alpha = spec.alpha_channel if spec.alpha_channel >= 0 else None
    colours = tuple(i for i in range(spec.nchannels) if i != alpha)
    if len(colours) != 1 and [spec.channelnames[i].upper() for i in colours] != ["R", "G", "B"]:
        raise InputError(f"{what} has {len(colours)} channels ({_list(spec.channelnames)}), {_MORE_BANDS}")
    return Picture(page, colours, alpha, str(page + 1) if len(specs) > 1 else "", notes)


def _choose_layer(what: str, specs: Sequence[Any], asked: str | None) -> Picture:
    layers = [layer for part, spec in enumerate(specs) for layer in _list_layers(part, spec)]
    pictures = [layer for layer in layers if len(layer.channels) == 3] or [
        layer for layer in layers if len(layer.channels) == 1
    ]
    bands = [name for spec in specs for name in spec.channelnames if _is_band(name)]
    if asked is None and bands and (len(bands) > 1 or any(len(each.channels) == 3 for each in pictures)):
        alone = "; --layer rgb reads R, G, B alone" if any("rgb" in each.answers_to for each in pictures) else ""
        raise InputError(f"{what} has bands {_list(bands)}: {_MORE_BANDS}{alone}")
    if asked is not None:
        pictures = [each for each in layers if asked.casefold() in each.answers_to and each.channels]
        if not pictures:
            known = _list(dict.fromkeys(each.label for each in layers if each.channels and each.label)) or "none"
            raise InputError(f"{what} has no layer {asked!r} of gray or R, G, B; its layers are {known}")
    if not pictures:
        raise InputError(_refusal(what, specs))
    pictures = [each for each in pictures if not each.name] or pictures
    best = [each for each in pictures if each.rank == min(each.rank for each in pictures)]
    if len(best) > 1:
        labels = _list(dict.fromkeys(each.label or "(no name)" for each in best))
        raise InputError(f"{what} has several layers that could be the picture: say which by --layer: {labels}")
    chosen = best[0]
    return Picture(chosen.part, chosen.channels, chosen.alpha, chosen.label, _layer_notes(specs, chosen))


def _list_layers(part: int, spec: Any) -> list[_Layer]:
    if spec.deep:
        return []
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(spec.channelnames):
        groups.setdefault(name.rpartition(".")[0], []).append(i)
    part_name = spec.get_string_attribute("oiio:subimagename")
    layers = []
    for name, members in groups.items():
        words = {spec.channelnames[i].rpartition(".")[2].upper(): i for i in members}
        chosen = () if _CRYPTOMATTE.fullmatch(name or part_name) else _find_radiance(words, name or part_name)
        alpha = words.get("A", words.get("ALPHA"))
        layers.append(_Layer(part, name, part_name, chosen, tuple(words), alpha))
    return layers


def _find_radiance(words: dict[str, int], layer: str) -> tuple[int, ...]:
    """Return the channels of R, G and B, or of luminance, among those of a layer; none where there is no such."""
    for names in _RGB:
        if all(name in words for name in names):
            return tuple(words[name] for name in names)
    if words.keys() >= {"X", "Y", "Z"} or words.keys() & _LUMINANCE_CHROMA:
        return ()
    left = [name for name in words if not _NO_RADIANCE.fullmatch(name.casefold())]
    last = layer.split(".")[-1].casefold()
    if len(left) != 1 or (last and _NO_RADIANCE.fullmatch(last)):
        return ()
    return (words[left[0]],)


def _is_band(name: str) -> bool:
    """Return whether a channel's name is that of a band of the spectrum, which is radiance beside R, G, B."""
    return _SPECTRAL.fullmatch(name.rpartition(".")[2].casefold()) is not None


def _layer_notes(specs: Sequence[Any], chosen: _Layer) -> tuple[str, ...]:
    names = [
        spec.channelnames[i]
        for part, spec in enumerate(specs)
        for i in range(spec.nchannels)
        if part != chosen.part or i not in (*chosen.channels, chosen.alpha)
    ]
    if not names and not chosen.name:
        return ()
    read = _list(specs[chosen.part].channelnames[i] for i in chosen.channels)
    of = f" of part {chosen.part_name}" if len(specs) > 1 and chosen.part_name else ""
    return (f"channels {read}{of} are read" + (f", not {_list(names)}" if names else ""),)


def _refusal(what: str, specs: Sequence[Any]) -> str:
    if any(spec.deep for spec in specs):
        return f"{what} is deep or a volume, expected a flat picture"
    names = [name for spec in specs for name in spec.channelnames]
    if {name.rpartition(".")[2].upper() for name in names} >= _LUMINANCE_CHROMA:
        return f"{what} holds luminance and chroma ({_list(names)}), expected gray or R, G, B: save it as RGB"
    return f"{what} has channels {_list(names)}, none of which are radiance: expected gray (Y) or R, G, B"


def _list(names: Any, limit: int = 8) -> str:
    names = list(names)
    return ", ".join(names[:limit]) + (f" and {len(names) - limit} more" if len(names) > limit else "")
