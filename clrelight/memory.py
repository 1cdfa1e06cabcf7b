"""Bytes that are held at a time where nobody says otherwise: one number for one thing."""

from __future__ import annotations

DEFAULT_MEMORY = 1 << 28
"""Of what goes tile by tile: a fit's rows of all photographs and their coefficients, parts of a map that is coded,
decoded or measured."""

IMAGE_MEMORY = 1 << 30
"""Of photographs that become a stack, and of a stack that is gone through again and again. It is more than the above,
since photographs are decoded whole, several at once, each to a processor, and as many together as a chunk of a stack
has lights: of 24 megapixels, three colours and 16 bits one takes 0.15 GB."""

ARRAY_MEMORY = 1 << 30
"""Of the parts that a codec makes of a map which is in memory anyway. Payloads of `klt` hang on it: a map that takes
more is coded in tiles."""

TILE_BYTES = 1 << 26
"""Of a tile where no budget is asked for: coefficients or pictures of some rows, made and gone again."""

PIECE_BYTES = 1 << 24
"""Of rows that pass while they are converted or measured: less than a tile, and enough to make a call worth while."""
