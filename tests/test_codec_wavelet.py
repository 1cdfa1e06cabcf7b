import re

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clrelight.codec import Encoded, Wavelet, decode, decode_regions, encode
from clrelight.codec.bodies import MemoryBody
from clrelight.codec.streams import ArraySource, ArrayTarget
from clrelight.codec.views import Region
from clrelight.codec.workspace import BoundedWorkspace
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.basis import evaluate_basis


def make_maps(shape, seed=0, scales=True):
    """Smooth random fields with edges and a little noise; channels alike, maps of different magnitude."""
    rng = np.random.default_rng(seed)
    k, h, w, c = shape
    fields = gaussian_filter(rng.standard_normal((k, h, w, 1)), (0, 2, 2, 0)) * rng.uniform(0.5, 1.5, (k, 1, 1, c))
    fields += 0.3 * (fields[..., :1] > 0.05) + 0.005 * rng.standard_normal(shape)
    if scales:
        fields *= 10.0 ** rng.uniform(-2, 2, (k, 1, 1, 1))
    return fields.astype(np.float32)


def snr(coeffs, decoded):
    """Mean over maps, in dB."""
    error = np.mean((coeffs.astype(np.float64) - decoded) ** 2, axis=(1, 2, 3))
    return float(np.mean(10 * np.log10(np.mean(coeffs.astype(np.float64) ** 2, axis=(1, 2, 3)) / error)))


# From about 1 kB of body up, the 4-byte words of the range coder fit into the 1% easily.
@pytest.mark.parametrize("allocation", ["map", "global"])
@pytest.mark.parametrize(
    ("shape", "rate"),
    [
        ((1, 128, 128, 3), 0.1),
        ((1, 64, 64, 1), 2.0),
        ((4, 47, 61, 3), 0.3),
        ((4, 47, 61, 3), 4.0),
        ((9, 31, 32, 1), 2.0),
        ((1, 1, 1009, 1), 8.0),
        ((4, 48, 48, 3), 14.0),
    ],
)
def test_bytes_lie_within_one_percent_below_the_rate(device, shape, rate, allocation):
    coeffs = make_maps(shape, scales=allocation == "map")
    encoded = encode(coeffs, Wavelet(rate=rate, allocation=allocation), device)
    assert 0.99 * rate <= encoded.bits_per_coefficient <= rate
    assert len(encoded.body) == encoded.encoded_bytes
    assert decode(encoded.to_bytes(), device).shape == shape


def test_lowest_rate(device):
    coeffs = make_maps((1, 400, 400, 3))
    encoded = encode(coeffs, Wavelet(rate=0.01), device)
    assert 0.0099 <= encoded.bits_per_coefficient <= 0.01
    assert snr(coeffs, decode(encoded, device)) > 1.0


@pytest.mark.parametrize("channels", [1, 3])
def test_more_bits_give_less_error(device, channels):
    coeffs = make_maps((4, 40, 41, channels))
    quality = []
    for rate in (0.2, 0.5, 1, 2, 4, 8, 16):
        quality.append(snr(coeffs, decode(encode(coeffs, Wavelet(rate=rate), device), device)))
    assert (np.diff(quality) > 1.0).all()
    # At high rates one bit is worth 6.02 dB.
    assert quality[-1] - quality[-2] == pytest.approx(8 * 6.02, abs=2.5)


def test_every_map_gets_the_same_rate(device):
    # The same map many times over, at different scales: equal bits mean equal relative error.
    one = make_maps((1, 48, 48, 3), seed=3)
    coeffs = np.concatenate([one * np.float32(2.0**e) for e in (0, 20, -20, 3, -7, 1, 0, 90, -90)])
    decoded = decode(encode(coeffs, Wavelet(rate=2.0), device), device)
    each = [snr(coeffs[k : k + 1], decoded[k : k + 1]) for k in range(9)]
    # The first two also pay for what the tables learn, some 2000 bits: much for maps as small as these.
    assert max(each[2:]) - min(each[2:]) < 0.8
    assert max(each) - min(each) < 3.0


def test_one_step_for_all_maps(device):
    coeffs = make_maps((4, 48, 48, 3), seed=3, scales=False) * np.float32([1, 5, 25, 125])[:, None, None, None]
    decoded = decode(encode(coeffs, Wavelet(rate=3.0, allocation="global"), device), device)
    errors = np.sqrt(np.mean((coeffs - decoded) ** 2, axis=(1, 2, 3)))
    assert errors[1:].max() < 1.3 * errors[1:].min()
    fair = decode(encode(coeffs, Wavelet(rate=3.0), device), device)
    assert np.mean((coeffs - decoded) ** 2) < np.mean((coeffs - fair) ** 2)


def test_maps_of_noise_get_the_same_rate_where_bits_fall_off_a_cliff(device):
    coeffs = np.random.default_rng(8).standard_normal((4, 67, 90, 1)).astype(np.float32)
    found = decode(encode(coeffs, Wavelet(rate=1.0), device), device)
    error = np.sqrt(((found - coeffs) ** 2).mean(axis=(1, 2, 3)))
    assert error.max() < 1.1 * error.min()
    assert error.max() < 0.7


def decode_body(body, shape, device):
    return Wavelet.decode_body(body, shape, device)


def test_bytes_are_the_same_every_time(device):
    coeffs = make_maps((4, 20, 30, 3))
    for allocation in ("map", "global"):
        codec = Wavelet(rate=1.5, allocation=allocation)
        assert encode(coeffs, codec, device).body == encode(coeffs.copy(), codec, device).body


def test_maps_without_content_hand_their_bits_on(device):
    coeffs = make_maps((9, 40, 40, 3))
    coeffs[2] = 0.0  # as Sloan's fit leaves it
    coeffs[5] = -0.75
    encoded = encode(coeffs, Wavelet(rate=2.0), device)
    assert 1.98 <= encoded.bits_per_coefficient <= 2.0
    decoded = decode(encoded, device)
    assert (decoded[2] == 0.0).all()
    np.testing.assert_allclose(decoded[5], -0.75, rtol=1e-5)
    others = [0, 1, 3, 4, 6, 7, 8]
    alone = encode(coeffs[[*others, 0, 1]], Wavelet(rate=2.0 * 9 / 7), device)
    assert snr(coeffs[others], decoded[others]) == pytest.approx(
        snr(coeffs[others], decode(alone, device)[:7]), abs=0.5
    )


def test_content_exhausted_below_the_rate(device):
    coeffs = np.full((4, 16, 16, 3), 0.3, np.float32)
    encoded = encode(coeffs, Wavelet(rate=8.0), device)
    assert encoded.bits_per_coefficient < 4.0
    np.testing.assert_allclose(decode(encoded, device), coeffs, rtol=2.5e-6)
    nothing = encode(0.0 * coeffs, Wavelet(rate=8.0), device)
    assert nothing.encoded_bytes < 32
    assert (decode(nothing, device) == 0.0).all()


@pytest.mark.parametrize("magnitude", [1e30, 3.3e38, 1e-30, 1e-44])
def test_extreme_magnitudes(device, magnitude):
    coeffs = make_maps((1, 24, 24, 3), scales=False)
    coeffs = (coeffs / np.abs(coeffs).max() * magnitude).astype(np.float32)
    coeffs[0, 3, 4, 1] = -0.0
    decoded = decode(encode(coeffs, Wavelet(rate=16.0), device), device)
    assert np.isfinite(decoded).all()
    # Denormal numbers have few digits of their own, and some devices none.
    tolerance = max(1e-4 * magnitude, 3e-45)
    if magnitude > 1e-37:
        assert np.abs(decoded.astype(np.float64) - coeffs).max() <= tolerance


def test_single_pixel(device):
    coeffs = np.array([1.5, -0.25, 3e7, 0.0], np.float32).reshape(4, 1, 1, 1)
    encoded = encode(coeffs, Wavelet(rate=64.0), device)
    np.testing.assert_allclose(decode(encoded.to_bytes(), device), coeffs, rtol=1e-6)


def test_rate_below_the_side_tables_is_refused(device):
    with pytest.raises(InputError, match="side tables alone take 14"):
        encode(np.ones((1, 1, 1, 1), np.float32).repeat(4, 0), Wavelet(rate=4.0), device)


@pytest.mark.parametrize("shape", [(4, 19, 23, 3), (4, 19, 23, 1), (9, 1, 2, 3), (1, 2, 3, 3), (4, 40, 1, 1)])
def test_the_least_size_that_is_told_is_the_least(device, shape):
    """In bytes, and in bits that are not rounded to fewer."""
    coeffs = np.random.default_rng(0).standard_normal(shape).astype(np.float32)
    least = Wavelet.least_bytes(shape)
    assert encode(coeffs, Wavelet(rate=8.0 * least / coeffs.size), device).encoded_bytes <= least
    with pytest.raises(InputError, match=rf"\({least - 1} bytes\) are too few") as refused:
        encode(coeffs, Wavelet(rate=8.0 * (least - 1) / coeffs.size), device)
    bits, told = re.search(r"alone take (\S+) \((\d+) bytes\)$", str(refused.value)).groups()
    assert int(told) == least == int(float(bits) * coeffs.size / 8)


@pytest.mark.parametrize("options", [{"rate": 0.0}, {"rate": float("nan")}, {"rate": "4"}, {"allocation": "x"}])
def test_bad_options_are_refused(options):
    with pytest.raises(InputError, match="wavelet"):
        Wavelet.from_config(options)


@pytest.mark.parametrize("rate", [0.2, 3.0])
def test_regions_and_levels_are_those_of_the_whole(device, rate):
    """Of a map whose units are streams of their own, and groups of maps too where the rate is high."""
    coeffs = make_maps((9, 530, 540, 1))
    encoded = encode(coeffs, Wavelet(rate=rate), device)
    whole, view = decode(encoded, device), decode_regions(encoded)
    part = view.coefficients(Region(300, 120, 340, 530), device)
    np.testing.assert_allclose(part, whole[:, 300:340, 120:530], rtol=0, atol=2e-6 * np.abs(whole).max())
    halved = view.coefficients(Region(10, 20, 60, 70, 1), device)
    near = whole[:, 20:120, 40:140].reshape(9, 50, 2, 50, 2, 1).mean(axis=(2, 4))
    assert snr(near, halved) > 10.0
    light = np.array([[0.3, 0.1, 0.9]]) / np.linalg.norm([0.3, 0.1, 0.9])
    weights = evaluate_basis(light, 2)
    expected = np.tensordot(weights, whole, 1)
    np.testing.assert_allclose(view.relight(light, device), expected, rtol=0, atol=1e-5 * np.abs(whole).max())


def test_maps_of_many_tiles_meet_the_rate_too(device):
    coeffs = make_maps((4, 700, 1100, 3))
    source = ArraySource(coeffs, device)
    source.workspace = BoundedWorkspace(16 << 20)
    body = MemoryBody()
    Wavelet(rate=0.5).encode_parts(source, body)
    content = body.to_bytes()
    assert 0.99 * 0.5 <= 8 * len(content) / coeffs.size <= 0.5
    target = ArrayTarget(coeffs.shape)
    target.workspace = BoundedWorkspace(16 << 20)
    Wavelet.decode_parts(content, target, device)
    found = target.coeffs()
    np.testing.assert_array_equal(found, decode_body(content, coeffs.shape, device))
    assert snr(coeffs, found) > 8.0


def test_a_damaged_unit_is_named(device):
    encoded = encode(make_maps((4, 40, 41, 3)), Wavelet(rate=3.0), device)
    body = bytearray(encoded.body)
    body[-20] ^= 4
    with pytest.raises(PayloadError, match="the wavelet body is damaged, and all of its units are one stream"):
        decode_body(bytes(body), encoded.shape, device)


def test_hostile_bytes_never_crash(device):
    shape = (4, 4, 3, 1)
    body = encode(make_maps(shape), Wavelet(rate=20.0), device).body
    rng = np.random.default_rng(5)
    refused = 0
    for trial in range(500):
        damaged = bytearray(body)
        kind = trial % 5
        if kind == 0:
            damaged = damaged[: rng.integers(0, len(damaged))]
        elif kind == 1:
            damaged += rng.bytes(int(rng.integers(1, 40)))
        elif kind == 2:
            damaged = bytearray(rng.bytes(len(damaged)))
            damaged[0] = 3
        else:
            for _ in range(kind):
                damaged[rng.integers(0, len(damaged))] = rng.integers(0, 256)
        try:
            decoded = decode_body(bytes(damaged), shape, device)
            assert decoded.shape == shape
            assert np.isfinite(decoded).all()
        except PayloadError:
            refused += 1
    assert refused > 150


def test_damage_to_the_wrapped_bytes_is_found(device):
    payload = bytearray(encode(make_maps((1, 8, 8, 1)), Wavelet(rate=4.0), device).to_bytes())
    payload[-1] ^= 1
    with pytest.raises(PayloadError):
        Encoded.from_bytes(bytes(payload))
