"""Codecs at constant maps, single pixels, odd sizes and numbers from 1e-30 to 1e30; PSNR of nothing and of the same."""

import numpy as np
import pytest

from clrelight.codec import codec_class, codec_ids, decode, encode
from clrelight.codec.encoded import Encoded
from clrelight.codec.transforms.lifting import forward_transform, inverse_transform
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.jobs.fit import fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.sampling import make_pattern
from tests.styles import both_styles

RNG = np.random.default_rng(0)
NOISE = RNG.standard_normal((4, 11, 13, 3)).astype(np.float32)
MAPS = {
    "constant": np.full((4, 9, 7, 3), 0.3, np.float32),
    "zero": np.zeros((4, 5, 6, 1), np.float32),
    "minus zero": -np.zeros((4, 5, 6, 3), np.float32),
    "one pixel": NOISE[:, :1, :1],
    "one row": NOISE[:, :1],
    "one column": NOISE[:, :, :1, :1],
    "primes": NOISE,
    "1e-30": NOISE * np.float32(1e-30),
    "1e30": NOISE * np.float32(1e30),
    "largest": np.full((4, 9, 9, 1), 3e38, np.float32),
    "negative": -np.abs(NOISE),
    "subnormal": np.full((4, 9, 9, 1), 1e-42, np.float32),
    "mixed": NOISE * np.array([1e-30, 1e-10, 1.0, 1e30], np.float32)[:, None, None, None],
}
# Of maps of few numbers, of which heads are a good part: klt has 40 bytes of them, as much as a column's numbers.
RATES = {"wavelet": {"rate": 16.0}, "jpeg2000": {"rate": 120.0}, "klt": {"rate": 14.0}}
LEAST_RATES = {"wavelet": 0.3, "klt": 0.3, "jpeg2000": 0.3}
NOT_HELD = {
    **dict.fromkeys([("half", name) for name in ("1e30", "largest", "mixed")], "binary16 cannot hold"),
    **dict.fromkeys([("bc6h", name) for name in ("1e30", "largest", "mixed")], "bc6h cannot hold"),
    **dict.fromkeys([(c, n) for c in ("half", "bc6h") for n in ("1e-30", "subnormal")], "as binary16 all would be 0"),
    ("klt", "one pixel"): "klt needs",
    **dict.fromkeys([(c, "largest") for c in ("principal", "whitened")], "too large to be summed in float32"),
}
# Largest error as a part of the largest number. These maps are noise, no pixel like another: what codes blocks of
# pixels, or few axes of them, keeps little of it, but more than zeros do. What rounds each number alone is near.
DENSE = ("one row", "one column", "primes", "1e-30", "1e30", "negative", "mixed")
FURTHEST_OFF = {
    "half": 2.0**-11,
    "uniform": 1.0 / 255,  # half a step; the range is at most twice the largest
    "jpeg2000": 1e-3,
    "wavelet": 0.005,
    "klt": 0.1,
    "cpca": 0.15,
    "vq": 0.5,
    "bc6h": 0.75,
    "s3tc": 0.75,
    "principal": 0.75,
    "whitened": 0.75,
}


@pytest.mark.parametrize("name", MAPS)
@pytest.mark.parametrize("codec", codec_ids())
def test_every_codec_holds_a_map_or_refuses_it(device, codec, name):
    options = {"rate": 24.0} if (codec, name) == ("klt", "one column") else RATES.get(codec, {})
    coeffs, made = MAPS[name], codec_class(codec).from_config(options)
    if (codec, name) in NOT_HELD:
        with pytest.raises(InputError, match=NOT_HELD[codec, name]):
            encode(coeffs, made, device)
        return
    encoded = encode(coeffs, made, device)
    found = decode(encoded, device)
    assert found.shape == coeffs.shape
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(decode(Encoded.from_bytes(encoded.to_bytes()), device), found)
    off = np.abs(found.astype(np.float64) - coeffs).max()
    top = np.abs(coeffs).astype(np.float64).max()
    if name in DENSE:
        assert off <= FURTHEST_OFF[codec] * top
    elif name.endswith("zero"):
        assert not found.any()
    elif name == "one pixel":
        assert off < top
    else:  # constant; float32 has steps of 1.4e-45 among the subnormal, and a change of axes may round twice
        assert off < 2e-3 * top + 2 * np.finfo(np.float32).smallest_subnormal


@pytest.mark.parametrize(("codec", "part"), [("half", 2.0**-11), ("wavelet", 1e-4), ("whitened", 0.05), ("klt", 0.12)])
def test_a_smooth_map_comes_back_by_default(device, codec, part):
    y, x = np.meshgrid(np.linspace(-1, 1, 48), np.linspace(-1, 1, 40), indexing="ij")
    coeffs = np.stack([np.cos(x) * np.cos(y), x, y, x * y])[..., None] * np.array([1.0, 0.8, 0.6])
    coeffs = coeffs.astype(np.float32)
    found = decode(encode(coeffs, codec_class(codec).from_config({}), device), device)
    assert np.abs(found.astype(np.float64) - coeffs).max() < part * np.abs(coeffs).max()


@both_styles
def test_wavelets_come_back_at_all_sizes(device):
    unit = np.ones(1, np.float32)
    for size in range(1, 41):
        for shape in {(1, size, size, 1), (1, size, 41 - size, 1), (1, 1, size, 1)}:
            coeffs = RNG.standard_normal(shape).astype(np.float32)
            back = inverse_transform(forward_transform(coeffs, unit, 3, device), shape, unit, 3, device)
            assert np.abs(back - coeffs).max() < 1e-6 * max(1.0, np.abs(coeffs).max())


@pytest.mark.parametrize("codec", ["wavelet", "klt", "jpeg2000"])
@pytest.mark.parametrize("rate", [0.01, 0.3, 2.0, 8.0, 16.0])
def test_rates_are_kept_or_refused(device, codec, rate):
    coeffs = RNG.standard_normal((4, 24, 20, 3)).astype(np.float32)
    made = codec_class(codec).from_config({"rate": rate})
    if rate < LEAST_RATES[codec]:
        with pytest.raises(InputError, match=r"too few|tables alone|klt needs"):
            encode(coeffs, made, device)
        return
    encoded = encode(coeffs, made, device)
    assert encoded.bits_per_coefficient <= rate
    assert np.isfinite(decode(encoded, device)).all()


def test_psnr_of_the_same_image_is_infinite(device):
    lights = make_pattern("uniform", 9)
    black = LightStack(np.zeros((9, 2, 3, 1), np.float32), lights, 1.0)
    quality = summarize_errors(measure_errors(fit(black, "cls", 2), black))
    assert quality.psnr_mean == quality.psnr_pooled == np.inf


def test_psnr_of_no_pixel_is_refused(device):
    stack = LightStack(np.ones((9, 2, 3, 1), np.float32), make_pattern("uniform", 9), 1.0)
    fitted = fit(stack, "cls", 1)
    empty = LightStack(stack.images_ihwc, stack.directions_i3, 1.0, mask_hw=np.zeros((2, 3), bool))
    with pytest.raises(InputError, match="the mask leaves no pixel to measure"):
        measure_errors(fitted, empty)


def test_infinite_psnr_is_stored_and_printed(tmp_path):
    from clrelight.store import write_stack
    from tests.commands import call, succeed

    lights = make_pattern("uniform", 9)
    write_stack(tmp_path / "s.h5", LightStack(np.zeros((9, 4, 4, 1), np.float32), lights, 1.0))
    out = succeed("fit", tmp_path / "s.h5", tmp_path / "f.h5", "--degree", 1).out
    assert "inf dB (identical)" in out
    words = ("bench", tmp_path / "s.h5", "--methods", "cls", "--codecs", "none", "--out", tmp_path / "r.h5")
    succeed(*words)
    told = call("info", tmp_path / "r.h5", "--json")
    assert told.code == 0
    import h5py

    with h5py.File(tmp_path / "r.h5") as results:
        table = results["table"][:]
    assert any(np.isinf(table[name]).any() for name in table.dtype.names if "psnr" in name)
