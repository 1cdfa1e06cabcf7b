"""Signed BC6H blocks of one region in plain Python, from the bit layouts of Microsoft's "BC6H format" page."""

import numpy as np

# Fields in the order of the bits; [high:low] is stored from `low` on, so [10:15] comes with its top bit first.
LAYOUTS = {
    3: (10, None, "rw[9:0] gw[9:0] bw[9:0] rx[9:0] gx[9:0] bx[9:0]"),
    7: (11, 9, "rw[9:0] gw[9:0] bw[9:0] rx[8:0] rw[10:10] gx[8:0] gw[10:10] bx[8:0] bw[10:10]"),
    11: (12, 8, "rw[9:0] gw[9:0] bw[9:0] rx[7:0] rw[10:11] gx[7:0] gw[10:11] bx[7:0] bw[10:11]"),
    15: (16, 4, "rw[9:0] gw[9:0] bw[9:0] rx[3:0] rw[10:15] gx[3:0] gw[10:15] bx[3:0] bw[10:15]"),
}
WEIGHTS = [0, 4, 9, 13, 17, 21, 26, 30, 34, 38, 43, 47, 51, 55, 60, 64]


def signed(value, bits):
    return value - (1 << bits) if value >> (bits - 1) else value


def unquantise(value, bits):
    if bits >= 16:
        return value
    magnitude = abs(value)
    if magnitude == 0:
        spread = 0
    elif magnitude >= (1 << (bits - 1)) - 1:
        spread = 0x7FFF
    else:
        spread = ((magnitude << 15) + 0x4000) >> (bits - 1)
    return -spread if value < 0 else spread


def decode_block(block):
    """Return the mode and the halves (4, 4, 3) of 16 bytes."""
    word = int.from_bytes(block, "little")
    mode = word & 31
    bits, delta_bits, layout = LAYOUTS[mode]
    fields, at = dict.fromkeys(["rw", "gw", "bw", "rx", "gx", "bx"], 0), 5
    for item in layout.split():
        name, span = item[:2], item[3:-1]
        high, low = (int(i) for i in span.split(":"))
        for bit in range(low, high + (1 if high >= low else -1), 1 if high >= low else -1):
            fields[name] |= (word >> at & 1) << bit
            at += 1
    assert at == 65
    ends = []
    for name in "rgb":
        a, b = signed(fields[name + "w"], bits), signed(fields[name + "x"], delta_bits or bits)
        ends.append((a, signed(a + b & (1 << bits) - 1, bits) if delta_bits else b))
    texels = np.zeros((16, 3), np.uint16)
    for t in range(16):
        length = 3 if t == 0 else 4
        level = word >> at & (1 << length) - 1
        at += length
        for m, (a, b) in enumerate(ends):
            u = unquantise(a, bits) * (64 - WEIGHTS[level]) + unquantise(b, bits) * WEIGHTS[level] + 32 >> 6
            texels[t, m] = (0x8000 if u < 0 else 0) | abs(u) * 31 >> 5
    assert at == 128
    return mode, texels.view(np.float16).reshape(4, 4, 3)


def decode_bc6h(body, shape):
    """Return coefficients (k, h, w, c), float16, of groups of blocks in raster order."""
    k, h, w, c = shape
    rows, columns = -(-h // 4), -(-w // 4)
    groups = k if c == 3 else -(-k * c // 3)
    texels = np.array([decode_block(body[i : i + 16])[1] for i in range(0, len(body), 16)])
    maps = texels.reshape(groups, rows, columns, 4, 4, 3).transpose(0, 1, 3, 2, 4, 5)
    maps = maps.reshape(groups, 4 * rows, 4 * columns, 3)[:, :h, :w]
    if c == 3:
        return maps
    planes = maps.transpose(0, 3, 1, 2).reshape(-1, h, w)[: k * c]
    return planes.reshape(k, c, h, w).transpose(0, 2, 3, 1)


def simple_error(texels):
    """Return the squared error of texels (16, 3) on the line between their extremes, 10-bit ends, as a bound."""
    mean = texels.mean(axis=0)
    axis = np.linalg.svd(texels - mean)[2][0]
    along = (texels - mean) @ axis
    ends = mean + np.outer([along.min(), along.max()], axis)
    codes = np.arange(-511, 512)
    halves = np.array([value_of(unquantise(int(i), 10)) for i in codes])
    ends = [[int(codes[np.abs(halves - v).argmin()]) for v in end] for end in ends]
    palette = np.array(
        [
            [
                value_of(unquantise(a, 10) * (64 - weight) + unquantise(b, 10) * weight + 32 >> 6)
                for a, b in zip(*ends, strict=True)
            ]
            for weight in WEIGHTS
        ]
    )
    return ((texels[:, None] - palette) ** 2).sum(axis=2).min(axis=1).sum()


def value_of(u):
    half = np.uint16(abs(u) * 31 >> 5).view(np.float16)
    return float(-half if u < 0 else half)
