"""sRGB (IEC 61966-2-1) one value at a time, and squared errors of display values, in float64."""

import numpy as np


def decode(values):
    """Return linear radiance of encoded values."""
    return np.vectorize(lambda v: v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4, otypes=[float])(values)


def encode(values):
    """Return encoded values of linear radiance >= 0."""
    return np.vectorize(lambda v: 12.92 * v if v <= 0.0031308 else 1.055 * v ** (1 / 2.4) - 0.055, otypes=[float])(
        values
    )


def display(radiance, transfer):
    """Return values as they are shown: clipped to [0, 1], then encoded."""
    clipped = np.clip(np.asarray(radiance, np.float64), 0.0, 1.0)
    return encode(clipped) if transfer == "srgb" else clipped


def mean_squared_errors(relit_ihwc, code_ihwc, peak, transfer, mask_hw):
    """Return each light's error in units of the peak, over the pixels of the mask."""
    shown = np.clip(np.asarray(code_ihwc, np.float64) / peak, 0.0, 1.0)
    return ((display(relit_ihwc, transfer) - shown) ** 2)[:, mask_hw].mean(axis=(1, 2))


def psnr(mse):
    """Return decibel for a peak of 1."""
    return 10.0 * np.log10(1.0 / mse)
