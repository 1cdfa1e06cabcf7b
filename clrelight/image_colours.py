"""What an image file says of its colours: whose primaries they are, and which curve its codes have."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass

import numpy as np
import OpenImageIO as oiio

_SRGB_D50 = np.array([[0.4361, 0.3851, 0.1431], [0.2225, 0.7169, 0.0606], [0.0139, 0.0971, 0.7141]])
_REC709 = np.array([0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290])
_NEAR = 0.012
"""How far numbers of profiles that mean sRGB lie from it at most; Adobe RGB is .17 away, Display P3 .08."""

_HALF_SRGB = 0.2140
"""Radiance at half the code of white; .2176 by gamma 2.2, which is taken for the same curve."""

_PARAMETRIC = (1, 3, 4, 5, 7)
"""Numbers that a parametric curve of each type has: ICC.1:2022, parametricCurveType."""


@dataclass(frozen=True)
class ImageColours:
    """What a file says of its colours; nothing by default.

    Attributes
    ----------
    space : str
        Name of a space of other primaries than sRGB's; empty where they are sRGB's, or nobody says.
    half : float, optional
        Radiance that the file says half the code of white means: 0.5 where values are linear, 0.214 by sRGB's curve.
    is_camera : bool
        Of a format in which cameras and browsers write sRGB unless they say another.
    """

    space: str = ""
    half: float | None = None
    is_camera: bool = False

    @property
    def notes(self) -> tuple[str, ...]:
        """What is to be said where colours are not sRGB's."""
        if not self.space:
            return ()
        return (
            f"colours are those of {self.space}, and stay so: pictures made of them look wrong where they are shown as "
            "sRGB (convert the photographs to sRGB, or give the pictures that profile)",
        )

    def curve_note(self, transfer: str | None) -> str | None:
        """Return what is to be said of reading values by the curve `transfer`; None: nobody chose, and it is linear."""
        if self.half is None:
            if transfer is None and self.is_camera:
                return "read as linear (the default); those of a camera or phone want --transfer srgb"
            return None
        told = "linear" if abs(self.half - 0.5) < 0.05 else "srgb" if abs(self.half - _HALF_SRGB) < 0.02 else ""
        if not told and 0 < self.half < 1:
            gamma = math.log(self.half) / math.log(0.5)
            return f"their profile says gamma {gamma:.2g}, read as {transfer or 'linear'}: convert them to sRGB before"
        if told and told != (transfer or "linear"):
            taken = transfer or "linear"
            return f"their profile says that values are {told}, read as {taken}: is --transfer {told} meant?"
        return None


def read_colours(kind: str, spec: oiio.ImageSpec) -> ImageColours:
    """Return what a file of OpenImageIO's format `kind` says of its colours: by ICC profile, EXIF or chromaticities."""
    is_camera = kind in ("jpeg", "webp")
    profile = spec.getattribute("ICCProfile")
    if profile is not None:
        return _of_profile(bytes(np.asarray(profile, np.uint8)), spec, is_camera)
    if spec.nchannels < 3:  # gray has no primaries
        return ImageColours(is_camera=is_camera)
    if spec.get_int_attribute("Exif:ColorSpace", 1) != 1:
        return ImageColours("Adobe RGB or another that EXIF does not name", None, is_camera)
    told = spec.getattribute("chromaticities") if kind == "openexr" else None
    if told is not None and len(told) == 8 and np.abs(np.asarray(told, float) - _REC709).max() > _NEAR:
        return ImageColours(f"chromaticities {', '.join(f'{each:g}' for each in told)}")
    return ImageColours(is_camera=is_camera)


def _of_profile(profile: bytes, spec: oiio.ImageSpec, is_camera: bool) -> ImageColours:
    """Return what an ICC profile says; ICC.1:2022, clauses 7 and 10. What is damaged says nothing but its name."""
    name = spec.get_string_attribute("ICCProfile:profile_description").strip() or "an ICC profile without a name"
    name = "".join(each for each in name if each.isprintable())[:60]
    try:
        tags = _tags(profile)
        half = next((_half(tags[tag]) for tag in (b"gTRC", b"kTRC") if tag in tags), None)
        columns = [np.array(struct.unpack_from(">3i", tags[tag], 8)) / 65536 for tag in (b"rXYZ", b"gXYZ", b"bXYZ")]
    except (struct.error, ArithmeticError):
        return ImageColours(name, None, is_camera)
    except KeyError:
        # Tables instead of primaries, as printers and ICC's own sRGB v4 have, or a gray picture, which has none.
        if name.lower().startswith("srgb"):
            return ImageColours("", _HALF_SRGB if half is None else half, is_camera)
        return ImageColours("" if spec.nchannels < 3 else name, half, is_camera)
    is_srgb = np.abs(np.stack(columns, axis=1) - _SRGB_D50).max() <= _NEAR
    return ImageColours("" if is_srgb else name, half, is_camera)


def _tags(profile: bytes) -> dict[bytes, bytes]:
    count = min(struct.unpack_from(">I", profile, 128)[0], 100)
    entries = [struct.unpack_from(">4sII", profile, 132 + 12 * at) for at in range(count)]
    return {tag: profile[at : at + size] for tag, at, size in entries}


def _half(curve: bytes) -> float | None:
    """Return a curve's value at 0.5: a gamma, a table or a formula; None where it is of no known kind."""
    kind, count = curve[:4], struct.unpack_from(">I", curve, 8)[0]
    if kind == b"curv":
        if count == 0:
            return 0.5
        if count == 1:
            return float(0.5 ** (struct.unpack_from(">H", curve, 12)[0] / 256))
        below, above = (struct.unpack_from(">H", curve, 12 + 2 * at)[0] for at in ((count - 1) // 2, count // 2))
        return float((below + above) / 2 / 65535)
    formula = count >> 16
    if kind != b"para" or formula >= len(_PARAMETRIC):
        return None
    g, *rest = (each / 65536 for each in struct.unpack_from(f">{_PARAMETRIC[formula]}i", curve, 12))
    a, b = (rest[0], rest[1]) if rest else (1.0, 0.0)
    offset = {2: rest[2:3], 4: rest[4:5]}.get(formula, [])
    base = a * 0.5 + b
    return float(base**g + sum(offset)) if base > 0 else None
