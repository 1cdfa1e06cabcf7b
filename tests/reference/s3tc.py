"""The S3TC-like code in float64: decoding, and the squared error of an encoder by the book."""

import numpy as np


def decode_s3tc(body, shape):
    """Return float64 coefficients (k, h, w, c) of a body: words (group, 7, block), see the codec."""
    k, h, w, c = shape
    planes = k * c
    rows, columns = -(-h // 4), -(-w // 4)
    words = np.frombuffer(body, "<u4").reshape(-(-planes // 3), 7, rows, columns)
    ends = words[:, :6].view("<f4").astype(np.float64)
    level = (words[:, 6, :, :, None] >> (2 * np.arange(16, dtype=np.uint32))) & 3
    weight = level[:, None] / 3.0
    a, b = ends[:, :3, ..., None], ends[:, 3:, ..., None]
    texels = (a * (1 - weight) + b * weight).reshape(-1, 3, rows, columns, 4, 4)
    maps = texels.transpose(0, 1, 2, 4, 3, 5).reshape(-1, 4 * rows, 4 * columns)[:planes, :h, :w]
    return maps.reshape(k, c, h, w).transpose(0, 2, 3, 1)


def blocks_of(coeffs):
    """Return (group, block row, block column, 16, 3) float64 blocks, filled up by replication and zero planes."""
    k, h, w, c = coeffs.shape
    planes = coeffs.astype(np.float64).transpose(0, 3, 1, 2).reshape(k * c, h, w)
    planes = np.pad(planes, ((0, 0), (0, -h % 4), (0, -w % 4)), mode="edge")
    planes = np.pad(planes, ((0, -len(planes) % 3), (0, 0), (0, 0)))
    g, height, width = len(planes) // 3, planes.shape[1], planes.shape[2]
    blocks = planes.reshape(g, 3, height // 4, 4, width // 4, 4)
    return blocks.transpose(0, 2, 4, 3, 5, 1).reshape(g, height // 4, width // 4, 16, 3)


def block_error(block, rounds=2):
    """Return the squared error of one (16, 3) block: principal axis by LAPACK, then `rounds` of least squares."""
    mean = block.mean(axis=0)
    axis = np.linalg.svd(block - mean)[2][0]
    along = (block - mean) @ axis
    a, b = mean + along.min() * axis, mean + along.max() * axis
    for round_ in range(rounds + 1):
        line = b - a
        square = line @ line
        t = (block - a) @ line / square if square > 0 else np.zeros(16)
        weight = np.clip(np.rint(3 * t), 0, 3) / 3
        if round_ < rounds:
            a, b = np.linalg.lstsq(np.stack([1 - weight, weight], axis=1), block, rcond=None)[0]
    return float(((a + weight[:, None] * (b - a) - block) ** 2).sum())
