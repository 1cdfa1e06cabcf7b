"""What ``encode`` and ``decode`` hold in memory: a map that is small, else parts of it beside files without a name."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clrelight.errors import InputError

if TYPE_CHECKING:
    from clrelight.codec import Codec, Encoded
    from clrelight.codec.streams import Shape, Source
    from clrelight.dataset import CoefficientMap
    from clrelight.device import Device
    from clrelight.store.scratch import ScratchRoom


def fits(room: ScratchRoom, shape: Shape) -> bool:
    """Return whether a room's memory holds whole maps and what is made of them."""
    return room.holds(4 * math.prod(shape))


def check_memory(work: str, needed: int, memory: int, asked: bool, otherwise: str = "") -> list[str]:
    """Return what to say of work that needs more than the budget; InputError where the user set that.

    It says what could be done `otherwise`, if anything.
    """
    if needed <= memory:
        return []
    text = f"{work} holds whole maps, about {needed / 2**20:.0f} MiB"
    if asked:
        advice = f"; {otherwise}" if otherwise else ""
        raise InputError(f"{text}, more than the {memory / 2**20:.3g} MiB of --memory{advice}")
    return [text]


def take_source(coefficients: CoefficientMap, codec: Codec, device: Device, room: ScratchRoom) -> Source:
    """Return the coefficients of an open fit: in memory where the room, or else the codec, holds them whole."""
    from clrelight.codec import array_source
    from clrelight.store.coding import StoredSource

    shape = tuple(coefficients.coeffs_khwc.shape)
    if fits(room, shape) or codec.bytes_to_encode(shape):
        return array_source(coefficients.to_float32().coeffs_khwc, device)
    return StoredSource(coefficients.coeffs_khwc, device, room)


def encode_source(source: Source, codec: Codec, room: ScratchRoom) -> Encoded:
    """Return an encoding whose body is in memory where its source is, else in a file of the room."""
    from clrelight.codec import Encoded, encode_stream
    from clrelight.codec.streams import ArraySource, MemoryBody
    from clrelight.store.scratch import ScratchBody

    if isinstance(source, ArraySource):
        written = MemoryBody()
        info = encode_stream(source, codec, written)
        return Encoded(codec.id, codec.to_config(), source.shape, written.to_bytes(), info)
    body = ScratchBody(room)
    info = encode_stream(source, codec, body)
    return Encoded(codec.id, codec.to_config(), source.shape, body, info)


def decode_again(encoded: Encoded, coefficients: CoefficientMap, device: Device, room: ScratchRoom) -> CoefficientMap:
    """Return what the bytes alone decode to, as ``decode`` does it, in memory where the body is."""
    from dataclasses import replace

    from clrelight.codec import Encoded, decode, decode_stream
    from clrelight.store.coding import PlanesTarget

    if isinstance(encoded.body, bytes):
        return replace(coefficients, coeffs_khwc=decode(encoded.to_bytes(), device))
    target = PlanesTarget(encoded.shape, device, room, codec_id=encoded.codec)
    decode_stream(Encoded.from_parts(encoded.header(), encoded.body), target, device)
    return replace(coefficients, coeffs_khwc=target.planes)
