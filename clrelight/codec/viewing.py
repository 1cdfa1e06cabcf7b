"""Encoded maps that are relit, or decoded in parts, without becoming whole maps of coefficients."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from clrelight.bases import SH
from clrelight.codec.damage import Damage
from clrelight.codec.encoded import Encoded
from clrelight.codec.registry import decode, open_payload
from clrelight.codec.views import Region, Regions, View
from clrelight.device import Device
from clrelight.errors import PayloadError

Viewed = TypeVar("Viewed", bound="View | None")


def decode_view(payload: Encoded | bytes, device: Device) -> View | None:
    """Return what relights an encoded map in its own basis, at no cost per coefficient; None for the plain basis.

    PayloadError as `decode` raises it.
    """
    encoded, codec = open_payload(payload, summed=True)
    return _of_basis(codec.decode_view(encoded.body, encoded.shape, device), encoded)


def decode_regions(payload: Encoded | bytes, damage: Damage | None = None) -> Regions | None:
    """Return what decodes parts of an encoded map alone; None where there is no such thing.

    Parts have their own checksums, so that of an encoding may be due still. With `damage`, what is damaged is filled
    and told there; without, and where nothing is left, it is a PayloadError, as of `decode`.
    """
    encoded, codec = open_payload(payload)
    return _of_basis(codec.decode_regions(encoded.body, encoded.shape, damage), encoded)


def bent_regions(payload: Encoded | bytes) -> Regions | None:
    """Return the regions of an encoding that shows code values; None where it shows what `decode` returns."""
    regions = decode_regions(payload)
    return None if regions is None or regions.curve == "linear" else regions


def decode_shown(
    payload: Encoded | bytes, device: Device, decoded_khwc: NDArray[np.float32] | None = None
) -> tuple[NDArray[np.float32], str]:
    """Return coefficients of what relighting shows, and the curve that their values are behind.

    What `decode` returns and ``"linear"``, but of code values and ``"srgb"`` where these are coded: relighting
    evaluates them at a light, and no coefficients of radiance hold all of that. `decoded_khwc` is what `decode`
    returned, where that is known. PayloadError as `decode` raises it.
    """
    encoded, _ = open_payload(payload, summed=True)
    regions = bent_regions(encoded)
    if regions is None:
        return decode(encoded, device) if decoded_khwc is None else decoded_khwc, "linear"
    return regions.shown(Region(0, 0, *encoded.shape[1:3]), device), regions.curve


def _of_basis(view: Viewed, encoded: Encoded) -> Viewed:
    """Tell a view what the record says its coefficients are of; PayloadError where that cannot be."""
    basis = SH if encoded.record is None else encoded.record.basis
    take_basis = getattr(view, "take_basis", None)
    if take_basis is not None and encoded.record is not None:
        take_basis(basis)
    elif take_basis is None and view is not None and basis != SH:
        raise PayloadError(f"codec {encoded.codec} holds spherical harmonics, the record says basis {basis}")
    return view
