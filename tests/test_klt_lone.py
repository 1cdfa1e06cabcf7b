"""Pixels that the sample of klt's axes misses, and maps near the end of float32."""

import numpy as np
import pytest

import clrelight as cr
from clrelight.codec import decode, encode
from clrelight.codec.formats.klt import Klt
from clrelight.errors import InputError
from clrelight.sampling import make_pattern

PLACE = (301, 305)
"""In no row that is sampled of an image of 600: these are every third from the second on."""


@pytest.mark.parametrize("ground", [0.0, 1.0])
@pytest.mark.parametrize("options", [{"step": 0.01}, {"rate": 0.01}, {"step": 0.01, "transfer": "srgb"}])
def test_a_lone_pixel_is_kept(device, ground, options):
    coeffs_khwc = np.full((4, 600, 600, 1), ground, np.float32)
    coeffs_khwc[(slice(None), *PLACE)] += np.array([[1.0], [0.5], [0.25], [0.1]], np.float32)
    decoded_khwc = decode(encode(coeffs_khwc, Klt(**options), device), device)
    assert np.abs(decoded_khwc - coeffs_khwc).max() < 0.08


def test_what_differs_by_less_than_a_step_is_the_mean(device):
    coeffs_khwc = np.zeros((4, 600, 600, 1), np.float32)
    coeffs_khwc[(0, *PLACE)] = 1e-3
    encoded = encode(coeffs_khwc, Klt(step=0.1), device)
    assert encoded.info["planes"] == 0
    assert encoded.encoded_bytes < 200


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_what_decoders_would_refuse_is_refused_with_what_is_wrong(device, transfer):
    rng = np.random.default_rng(0)
    coeffs_khwc = (rng.standard_normal((4, 20, 20, 3)).clip(-1, 1) * 3.4e38).astype(np.float32)
    with pytest.raises(InputError, match=r"channel.* = .* too near the end of float32 for klt: scale") as raised:
        encode(coeffs_khwc, Klt(rate=0.1, transfer=transfer), device)
    assert raised.type is InputError  # of what was given, not of a payload
    less = encode(coeffs_khwc / 100, Klt(rate=0.1, transfer=transfer), device)
    assert np.isfinite(decode(less, device)).all()


def told(coeffs_khwc, **options):
    report, lights_i3 = cr.Report(), make_pattern("uniform", 9)
    fitted = cr.CoefficientMap(coeffs_khwc, 1, "uls", 1.0, "linear", lights_i3)
    encoded = cr.encode(fitted, "klt", report=report, **options)
    return encoded.encoded_bytes, [note for note in report.notes if "asked for" in note]


def test_what_is_left_of_a_rate_is_told():
    rough = np.random.default_rng(0).standard_normal((4, 1, 4096, 1)).astype(np.float32)
    used, notes = told(rough, rate=0.5)
    assert notes == []
    assert 0.99 * 1024 <= used <= 1024
    used, (note,) = told(np.zeros((4, 64, 64, 1), np.float32), bytes=4000)
    assert note.startswith(f"{used} of the 4000 bytes that were asked for are used: it is the map's mean")
