"""What the paper printed: Lam, Leung, Wong, *Noise-Resistant Fitting for Spherical Harmonics*."""

from __future__ import annotations

CITATION = "Lam, Leung, Wong: Noise-Resistant Fitting for Spherical Harmonics"

SCENE_PREFIX = "ring"
"""Tables I and III measure the example "ring" (noise-resistant-fitting, section III-A, figure 3a)."""

FIGURES = {
    "torus": {"uls": 5, "sloan": 9, "cls": 13},
    "dama": {"uls": 6, "sloan": 10, "cls": 14},
}
"""Figures that show surfaces, by scene and method."""

DEGREE = 6
"""The first 49 coefficients of each pixel (section VI, first paragraph)."""

S3TC_BITS = 4.667
"""Bits per coefficient of its floating-point S3TC (section III-B.2)."""

TABLE_I = {"uls": 32.21, "cls": 31.32}
"""Average PSNR in dB of the relit images (table I, section V-B)."""

TABLE_III = {
    "uls": (32.21, 15.28),
    "sloan": (31.67, 24.31),
    "cls": (31.32, 29.73),
    "ceb": (30.75, 29.79),
}
"""PSNR in dB with plain and with S3TC-compressed coefficients (table III, section VI)."""


def is_paper_setting(scene: str, degree: int) -> bool:
    """Say whether the paper's numbers may stand beside ours: its scene, at its degree."""
    return scene.startswith(SCENE_PREFIX) and degree == DEGREE
