"""What an experiment leaves behind: one row per (scene, method, degree, codec, rate), and a few pictures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

NO_CODEC = "none"
"""Name of the rows that measure the float32 coefficients as they were fitted."""

ROW_DTYPE = np.dtype(
    [
        ("scene", "S64"),
        ("method", "S32"),
        ("degree", "<i4"),
        ("fit_config", "S256"),  # JSON
        ("codec", "S32"),  # NO_CODEC: float32 coefficients
        ("codec_config", "S256"),  # JSON
        ("rate", "<f8"),  # bits per coefficient asked for; NaN where the codec is not asked for one
        ("n_light", "<i4"),  # fitted lights
        ("n_holdout", "<i4"),
        ("n_coeff", "<i4"),
        ("height", "<i4"),
        ("width", "<i4"),
        ("channel", "<i4"),
        ("encoded_bytes", "<i8"),  # payload and every side table
        ("bits_per_coefficient", "<f8"),
        ("entropy_bits", "<f8"),  # an estimate, where the codec gives one, else NaN
        ("mean_energy", "<f8"),  # mean over columns of the squared norm of the coefficients
        (
            "coding_psnr_independent",
            "<f8",
        ),  # dB below peak^2, of coding noise alone (noise-resistant-fitting, eq. 11), before encoding
        ("coding_psnr_predicted", "<f8"),  # the same with the errors' moments between coefficients; NaN: no model
        ("coding_psnr", "<f8"),  # measured; inf where nothing is lost
        ("psnr_mean", "<f8"),  # dB, at the fitted lights; inf where identical
        ("psnr_pooled", "<f8"),
        ("psnr_mean_holdout", "<f8"),  # NaN without held-out lights
        ("psnr_pooled_holdout", "<f8"),
        ("seconds_fit", "<f8"),
        ("seconds_encode", "<f8"),
        ("seconds_decode", "<f8"),
        ("seconds_measure", "<f8"),
        ("note", "S192"),  # why a row has no PSNR, such as a coefficient beyond half's range, or an infinite mean
        ("seed", "<i8"),
        ("device", "S192"),
        ("versions", "S256"),
        ("commit", "S64"),
    ]
)
"""A row of the table. Strings have fixed length so that checksums cover them."""

TIME_FIELDS = tuple(name for name in ROW_DTYPE.names or () if name.startswith("seconds_"))


@dataclass(frozen=True)
class Results:
    """The table of an experiment, with what its report shows beside it.

    Attributes
    ----------
    table : ndarray of ROW_DTYPE
    pictures : mapping of str to ndarray, shape (height, width, channel), uint8
        ``SCENE/reference`` and ``SCENE/METHOD/DEGREE/CODEC[@RATE]``: one light's image in display values.
    profiles : mapping of str to ndarray, shape (n_coeff,), float64
        ``SCENE/METHOD/DEGREE``: coefficients of a typical pixel.
    """

    table: NDArray
    pictures: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict)
    profiles: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.table.dtype != ROW_DTYPE or self.table.ndim != 1:
            raise TypeError(f"expected a one-dimensional table of {ROW_DTYPE.names}, got {self.table.dtype}")
