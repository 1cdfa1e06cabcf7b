"""What ``encode`` and ``decode`` hold in memory: a map that is small, else parts of it beside files without a name."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clrelight.codec import Codec, Encoded, array_source, decode, decode_stream, encode_stream
from clrelight.codec.bodies import MemoryBody
from clrelight.codec.streams import ArraySource, Source
from clrelight.codec.workspace import Shape
from clrelight.dataset import CoefficientMap
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.memory import DEFAULT_MEMORY
from clrelight.store.coding import PlanesTarget, StoredSource
from clrelight.store.scratch import ScratchBody, ScratchWorkspace


def fits(workspace: ScratchWorkspace, shape: Shape) -> bool:
    """Return whether a workspace's memory holds whole maps and what is made of them."""
    return workspace.holds(4 * math.prod(shape))


def check_memory(work: str, needed: int, memory: int | None, otherwise: str = "") -> list[str]:
    """Return what to say of work that needs more than the usual budget; InputError where the user set it, and lower.

    `memory` is None where it was not set. The error says what could be done `otherwise`, if anything.
    """
    if needed <= (DEFAULT_MEMORY if memory is None else memory):
        return []
    text = f"{work} takes {needed / 2**20:.3g} MiB at once"
    if memory is not None:
        advice = f"; {otherwise}" if otherwise else ""
        raise InputError(f"{text}, more than the {memory / 2**20:.3g} MiB of --memory{advice}")
    return [text]


def take_source(coefficients: CoefficientMap, codec: Codec, device: Device, workspace: ScratchWorkspace) -> Source:
    """Return the coefficients of a fit: in memory where they, or the workspace, or else the codec hold them whole."""
    shape = tuple(coefficients.coeffs_khwc.shape)
    in_memory = isinstance(coefficients.coeffs_khwc, np.ndarray)
    if in_memory or fits(workspace, shape) or codec.encoding_holds:
        held = coefficients.to_float32().coeffs_khwc
        return array_source(held, device, coefficients.basis, coefficients.fitted_lights)
    return StoredSource(coefficients.coeffs_khwc, device, workspace, coefficients.basis, coefficients.fitted_lights)


def encode_source(source: Source, codec: Codec, workspace: ScratchWorkspace) -> Encoded:
    """Return an encoding whose body is in memory where its source is, else in a file of the workspace."""
    if isinstance(source, ArraySource):
        written = MemoryBody()
        info = encode_stream(source, codec, written)
        return Encoded(codec.id, codec.to_config(), source.shape, written.to_bytes(), info)
    body = ScratchBody(workspace)
    info = encode_stream(source, codec, body)
    return Encoded(codec.id, codec.to_config(), source.shape, body, info)


def decode_again(
    encoded: Encoded, coefficients: CoefficientMap, device: Device, workspace: ScratchWorkspace
) -> CoefficientMap:
    """Return what the bytes alone decode to, as ``decode`` does it, in memory where the body is."""
    if isinstance(encoded.body, bytes):
        return replace(coefficients, coeffs_khwc=decode(encoded.to_bytes(), device))
    target = PlanesTarget(encoded.shape, device, workspace, codec_id=encoded.codec)
    decode_stream(Encoded.from_parts(encoded.header(), encoded.body), target, device)
    return replace(coefficients, coeffs_khwc=target.planes)
