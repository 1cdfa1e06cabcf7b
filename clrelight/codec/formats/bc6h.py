"""Codec `bc6h`: the signed 16-byte block format that GPUs sample themselves (DXGI_FORMAT_BC6H_SF16)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter, columns_of
from clrelight.codec.formats.half import OVERFLOW, check_not_vanishing, count_overflows, largest_at_first
from clrelight.codec.rate.noise import Noise, sample_blocks
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.slabs import group_size, round_up
from clrelight.codec.streams import Source, Target
from clrelight.codec.transforms import blocks
from clrelight.device import Device
from clrelight.errors import InputError, PayloadError


@register
@dataclass(frozen=True)
class Bc6h(PartsCodec):
    """Code blocks of 4 x 4 texels of three components in 16 bytes: 8 bits per texel, 2.667 per coefficient.

    Texels, groups and edges are those of `s3tc`. Values are halves: below 6e-8 they vanish.

    Body: for each group (a coefficient's RGB map, or three planes) the blocks in raster order, exactly as a DDS or
    KTX2 file and a GPU take them.

    Attributes
    ----------
    clamp : bool
        Store ±65504 for what binary16 cannot hold, and count it as ``info["clamped"]``, instead of refusing it.
    """

    id: ClassVar[str] = "bc6h"
    summary: ClassVar[str] = "BC6H signed half blocks, a GPU's own format, 2.667 bits per coefficient"

    clamp: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.clamp, bool):
            raise InputError(f"codec bc6h: clamp must be true or false, got {self.clamp!r}")

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write the blocks; InputError names the first coefficient of a part beyond binary16, unless clamping."""
        groups, n_block = blocks.block_counts(source.shape)
        body.reserve(16 * groups * n_block)
        clamped, largest = 0, 0.0
        with source.rows(4) as parts:
            for first, coeffs_khwc in parts:
                largest = largest_at_first(coeffs_khwc, largest)
                if max(coeffs_khwc.max(), -coeffs_khwc.min()) >= OVERFLOW:
                    clamped += count_overflows(coeffs_khwc, first, self.id, clamp=self.clamp)
                blocks_gbj = _encode_blocks(coeffs_khwc, source.device)
                start = 16 * blocks.blocks_above(first, source.shape[2])
                body.write_columns(16 * n_block, start, blocks_gbj.reshape(groups, -1))
        check_not_vanishing(largest)
        return {"clamped": float(clamped)}

    def predict_noise(self, source: Source) -> Noise:
        """See `Codec`; blocks know nothing of each other, so that a sample of them tells of all."""
        return self.try_on(sample_blocks(source, 4), source.device)

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put the coefficients; PayloadError on a wrong length, a mode of other encoders, or an infinity."""
        n_coeff, _, width, channel = target.shape
        groups, n_block = blocks.block_counts(target.shape)
        expected = 16 * groups * n_block
        if len(body) != expected:
            raise PayloadError(f"codec bc6h: shape {target.shape} takes {expected} bytes, the body has {len(body)}")
        for rows in target.row_parts(4):
            shape = (n_coeff, rows.stop - rows.start, width, channel)
            start = blocks.blocks_above(rows.start, width)
            ends = 16 * start, 16 * (start + blocks.block_counts(shape)[1])
            blocks_gbj = columns_of(body, groups, *ends).view(np.uint64).reshape(groups, -1, 2)
            target.put_rows(rows.start, _decode_blocks(blocks_gbj, shape, device))
        target.finish()


def _encode_blocks(coeffs_khwc: NDArray[np.float32], device: Device) -> NDArray[np.uint64]:
    maps_khwc = blocks.as_maps(coeffs_khwc)
    blocks_gbj = np.empty((*blocks.block_counts(coeffs_khwc.shape), 2), np.uint64)
    for groups, maps in blocks.group_slabs(coeffs_khwc.shape):
        out = device.empty(blocks_gbj[groups].shape, np.uint64, blocks_gbj[groups])
        source = device.upload(maps_khwc[maps])
        _launch(device, "encode_bc6h_gbj", out.shape[:2], source.shape, out, source)
        device.fetch(out, blocks_gbj[groups])
    return blocks_gbj


def _decode_blocks(
    blocks_gbj: NDArray[np.uint64], shape: tuple[int, int, int, int], device: Device
) -> NDArray[np.float32]:
    maps_khwc = np.empty(blocks.maps_shape(shape), np.float32)
    for groups, maps in blocks.group_slabs(shape):
        out = device.empty(maps_khwc[maps].shape, np.float32, maps_khwc[maps])
        source = device.upload(blocks_gbj[groups])
        refused = device.empty(source.shape[:2], np.uint8)
        _launch(device, "decode_bc6h_khwc", source.shape[:2], out.shape, out, refused, source)
        if device.download(refused).any():
            raise PayloadError("codec bc6h: a block has a mode that is not written here, or an infinite endpoint")
        device.fetch(out, maps_khwc[maps])
    return blocks.from_maps(maps_khwc, shape)


def _launch(device: Device, kernel: str, counts: tuple[int, ...], shape: tuple[int, ...], *arrays: object) -> None:
    group = group_size(device)
    device.launch(
        "codec/bc6h.cl",
        kernel,
        (round_up(counts[1], group), counts[0]),
        *arrays,
        *shape[:3],
        defines={"CHANNELS": shape[3]},
        local_size=(group, 1),
    )
