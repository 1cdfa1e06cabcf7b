"""Codec `s3tc`: 4x4 blocks of RGB texels on a line between two float endpoints (Lam, Leung and Wong, III-B-2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from clrelight.codec.bodies import Body, BodyWriter, columns_of
from clrelight.codec.rate.noise import Noise, sample_blocks
from clrelight.codec.registry import PartsCodec, register
from clrelight.codec.slabs import group_size, round_up
from clrelight.codec.streams import Source, Target
from clrelight.codec.transforms.blocks import as_maps, block_counts, blocks_above, from_maps, group_slabs, maps_shape
from clrelight.device import Device
from clrelight.errors import PayloadError

WORDS = 7
"""32-bit words of a block: two endpoints of three floats, and sixteen 2-bit levels."""


@register
@dataclass(frozen=True)
class S3tc(PartsCodec):
    """Code blocks of 4 x 4 texels as two float32 endpoints and sixteen 2-bit levels: 28 bytes for 48 values.

    A texel is the pixel of one coefficient's RGB map. With a channel count other than 3 it is three consecutive
    planes of one pixel, where plane ``k channel + c`` is channel c of coefficient k; the last group is filled up
    with zero planes. Edges are filled up to multiples of 4 by replication. So the size is exactly 14/3 bits per
    coefficient where height and width are multiples of 4 and the planes of 3, else a little more.

    Body: little-endian 32-bit words (group, 7, block): three floats of the first endpoint, three of the second,
    levels; blocks in raster order. Nothing else.
    """

    id: ClassVar[str] = "s3tc"
    summary: ClassVar[str] = "S3TC-like blocks with float endpoints, 4.667 bits per coefficient"

    def encode_parts(self, source: Source, body: BodyWriter) -> dict[str, float]:
        """Write the blocks of all groups."""
        groups, blocks = block_counts(source.shape)
        body.reserve(4 * groups * WORDS * blocks)
        with source.rows(4) as parts:
            for first, coeffs_khwc in parts:
                blocks_gjb = _encode_blocks(coeffs_khwc, source.device)
                blocks_nb = blocks_gjb.reshape(groups * WORDS, -1)
                body.write_columns(4 * blocks, 4 * blocks_above(first, source.shape[2]), blocks_nb)
        return {}

    def predict_noise(self, source: Source) -> Noise:
        """See `Codec`; blocks know nothing of each other, so that a sample of them tells of all."""
        return self.try_on(sample_blocks(source, 4), source.device)

    @classmethod
    def decode_parts(cls, body: Body, target: Target, device: Device) -> None:
        """Put the coefficients; PayloadError on a wrong length or an endpoint that is not finite."""
        n_coeff, _, width, channel = target.shape
        groups, blocks = block_counts(target.shape)
        expected = 4 * groups * WORDS * blocks
        if len(body) != expected:
            raise PayloadError(f"codec s3tc: shape {target.shape} takes {expected} bytes, the body has {len(body)}")
        for rows in target.row_parts(4):
            shape = (n_coeff, rows.stop - rows.start, width, channel)
            start = blocks_above(rows.start, width)
            ends = 4 * start, 4 * (start + block_counts(shape)[1])
            blocks_gjb = columns_of(body, groups * WORDS, *ends).view(np.uint32).reshape(groups, WORDS, -1)
            # All ones in the exponent of a float32: infinity or NaN.
            if ((blocks_gjb[:, :6] & 0x7F800000) == 0x7F800000).any():
                raise PayloadError("codec s3tc: the body holds an endpoint that is not finite")
            target.put_rows(rows.start, _decode_blocks(blocks_gjb, shape, device))
        target.finish()


def _encode_blocks(coeffs_khwc: NDArray[np.float32], device: Device) -> NDArray[np.uint32]:
    maps_khwc = as_maps(coeffs_khwc)
    n_group, n_block = block_counts(coeffs_khwc.shape)
    blocks_gjb = np.empty((n_group, WORDS, n_block), np.uint32)
    for groups, maps in group_slabs(coeffs_khwc.shape):
        out = device.empty(blocks_gjb[groups].shape, np.uint32, blocks_gjb[groups])
        source = device.upload(maps_khwc[maps])
        _launch(device, "encode_s3tc_gjb", out, source, source.shape)
        device.fetch(out, blocks_gjb[groups])
    return blocks_gjb


def _decode_blocks(
    blocks_gjb: NDArray[np.uint32], shape: tuple[int, int, int, int], device: Device
) -> NDArray[np.float32]:
    maps_khwc = np.empty(maps_shape(shape), np.float32)
    for groups, maps in group_slabs(shape):
        out = device.empty(maps_khwc[maps].shape, np.float32, maps_khwc[maps])
        _launch(device, "decode_s3tc_khwc", out, device.upload(blocks_gjb[groups]), out.shape)
        device.fetch(out, maps_khwc[maps])
    return from_maps(maps_khwc, shape)


def _launch(device: Device, kernel: str, out: object, source: object, shape_khwc: tuple[int, ...]) -> None:
    k, h, w, c = shape_khwc
    group = group_size(device)
    lanes = 8 if device.style == "cpu" else 1
    # On a CPU one work-item goes along a whole row of blocks; on a GPU each takes a block.
    across = 1 if device.style == "cpu" else round_up(-(-w // 4), group)
    device.launch(
        "codec/s3tc.cl",
        kernel,
        (across, block_counts((k, h, w, c))[0] * -(-h // 4)),
        out,
        source,
        k,
        h,
        w,
        defines={"LANES": lanes, "CHANNELS": c},
        local_size=(group, 1),
    )
