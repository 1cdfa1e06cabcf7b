import functools

import numpy as np
import pytest

from clrelight.codec import S3tc, decode, encode
from clrelight.errors import PayloadError
from tests.reference.s3tc import block_error, blocks_of, decode_s3tc
from tests.styles import both_styles

EPS = float(np.finfo(np.float32).eps)
SIZES = [(1, 1), (3, 4), (5, 3), (4, 7), (8, 8), (9, 31), (7, 32), (4, 33), (13, 61), (3, 64)]


def smooth_map(shape, seed=0):
    rng = np.random.default_rng(seed)
    k, h, w, c = (np.arange(n, dtype=np.float64) for n in shape)
    phase = rng.uniform(0, 6, (shape[0], 1, 1, shape[3]))
    wave = np.sin(0.2 * h[:, None, None] + 0.13 * w[:, None] + phase) * (1 + k[:, None, None, None]) + 0.3 * c
    return (wave + 0.01 * rng.standard_normal(shape)).astype(np.float32)


def decoded_error(coeffs, device):
    """Squared error of each block as the float64 reference decodes it."""
    encoded = encode(coeffs, S3tc(), device)
    k, h, w, c = coeffs.shape
    padded = (k, h + -h % 4, w + -w % 4, c)
    difference = blocks_of(decode_s3tc(encoded.body, padded)) - blocks_of(coeffs)
    return (difference**2).sum(axis=(-1, -2)).ravel()


@both_styles
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("size", SIZES)
def test_decoder_against_reference(device, size, channels):
    shape = (4, *size, channels)
    coeffs = smooth_map(shape)
    encoded = encode(coeffs, S3tc(), device)
    groups = -(-4 * channels // 3)
    assert encoded.encoded_bytes == 28 * groups * -(-size[0] // 4) * -(-size[1] // 4)
    expected = decode_s3tc(encoded.body, shape)
    np.testing.assert_allclose(
        decode(encoded.to_bytes(), device), expected, rtol=0, atol=4 * EPS * np.abs(expected).max()
    )


def test_exactly_fourteen_thirds_bits(device):
    assert encode(smooth_map((4, 8, 12, 3)), S3tc(), device).bits_per_coefficient == 14 / 3
    assert encode(smooth_map((9, 8, 12, 1)), S3tc(), device).bits_per_coefficient == 14 / 3


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("kind", ["noise", "smooth", "outlier"])
def test_encoder_is_as_good_as_the_reference(device, kind, size, channels):
    shape = (4, *size, channels)
    coeffs = smooth_map(shape)
    if kind == "noise":
        coeffs = np.random.default_rng(1).standard_normal(shape).astype(np.float32)
    elif kind == "outlier":
        coeffs[:, size[0] // 2, size[1] // 2] *= 1000
    ours = decoded_error(coeffs, device)
    reference = np.array([block_error(b) for b in blocks_of(coeffs).reshape(-1, 16, 3)])
    rounding = 48 * (4 * EPS * float(np.abs(coeffs).max())) ** 2
    # Levels at a tie may go either way and then lead elsewhere: a block may differ, their sum may not.
    assert ours.sum() <= 1.02 * reference.sum() + rounding
    assert np.quantile(ours / (reference + rounding), 0.9) <= 1.02


@functools.cache
def hard_blocks():
    rng = np.random.default_rng(3)
    line = np.linspace(-1, 1, 16)
    noise = rng.standard_normal((16, 3))
    equal = np.array([[1, 1, 0], [-1, -1, 0]] * 8) * 0.5**0.5 + np.array(
        [[0, 0, 0.97], [0, 0, 0.97], [0, 0, -0.97], [0, 0, -0.97]] * 4
    )
    return {
        "axis hidden from the largest variance": equal,
        "one component": line[:, None] * [0, 1, 0],
        "negatively correlated": line[:, None] * [1, -1, 0] + 0.01 * noise,
        "two values": np.where(np.arange(16)[:, None] < 5, [1.0, 2, 3], [-1.0, 0.5, 9]),
        "one outlier": np.eye(16)[:, :1] * [1.0, 2, 3],
        "isotropic": noise,
        "large offset": 1000 + 1e-3 * noise,
        "a few units in the last place": 1 + rng.integers(-2, 3, (16, 3)) * 2.0**-23,
        "one component far larger": noise * [1e6, 1, 1e-6],
    }


@pytest.mark.parametrize("name", hard_blocks())
@pytest.mark.parametrize("scale", [1e-36, 1e-30, 1.0, 1e30, 1e34])
def test_hard_blocks(device, name, scale):
    if name == "one component far larger":
        scale = min(max(scale, 1e-30), 1e30)  # its own range takes the rest of float32's
    block = (hard_blocks()[name] * scale).astype(np.float32)
    coeffs = block.reshape(1, 4, 4, 3)
    exact = block.astype(np.float64) / scale
    ours = decoded_error(coeffs, device)[0] / scale / scale
    reference = block_error(exact)
    # Endpoints are stored with 2**-24 relative error; below 2**-126 with 2**-150 absolute.
    rounding = 48 * (EPS * np.abs(exact).max() + 2.0**-149 / scale) ** 2
    assert ours <= 1.02 * reference + rounding


@pytest.mark.parametrize("value", [0.0, 1.0, -7.3, 1e-45, -3e-39, 1e-30, 1e30, 3.4028235e38])
def test_constant_blocks_are_exact(device, value):
    for shape in [(1, 5, 6, 3), (4, 5, 6, 1), (1, 4, 40, 3)]:
        coeffs = np.full(shape, value, np.float32)
        coeffs[..., 0] = -0.3
        np.testing.assert_array_equal(decode(encode(coeffs, S3tc(), device), device), coeffs)


@pytest.mark.parametrize("scale", [1.4e-45, 1e-40, 3.4e38])
def test_ends_of_float32(device, scale):
    coeffs = (np.random.default_rng(0).uniform(-1, 1, (4, 9, 41, 3)) * scale).astype(np.float32)
    decoded = decode(encode(coeffs, S3tc(), device), device)
    assert np.isfinite(decoded).all()
    relative = (decoded.astype(np.float64) - coeffs) / scale
    # Uniform texels deviate by 1/sqrt(3) = 0.577 from their mean; the line takes a third of the variance away.
    assert np.sqrt(np.mean(relative**2)) < (0.5 if scale > 1e-44 else 1.0)


def test_same_input_same_bytes(device):
    coeffs = smooth_map((4, 31, 77, 3))
    assert encode(coeffs, S3tc(), device).body == encode(coeffs.copy(), S3tc(), device).body


def test_vector_lanes_and_edge_path_agree(device):
    """Blocks in a wide image take the vector path, the same blocks in a narrow one the other."""
    wide = smooth_map((4, 8, 64, 3))
    narrow = np.concatenate(
        [decode(encode(wide[:, :, x : x + 4].copy(), S3tc(), device), device) for x in range(0, 64, 4)], axis=2
    )
    np.testing.assert_allclose(
        decode(encode(wide, S3tc(), device), device), narrow, rtol=0, atol=8 * EPS * np.abs(wide).max()
    )


def test_damaged_bodies(device):
    shape = (1, 4, 5, 3)
    body = encode(smooth_map(shape), S3tc(), device).body
    infinite = np.frombuffer(body, "<u4").copy()
    infinite[5] = 0x7F800000
    not_a_number = np.frombuffer(body, "<u4").copy()
    not_a_number[0] = 0xFFC00001
    for damaged in (b"", body[:-1], body + b"\0", infinite.tobytes(), not_a_number.tobytes()):
        with pytest.raises(PayloadError):
            S3tc.decode_body(damaged, shape, device)


def test_hostile_endpoints_decode_to_finite_values(device):
    words = np.full((1, 7, 2), 0x7F7FFFFF, "<u4")  # the largest float
    words[:, :3] = 0xFF7FFFFF
    words[:, 6] = 0xE4E4E4E4
    decoded = S3tc.decode_body(words.tobytes(), (1, 4, 8, 3), device)
    largest = float(np.finfo(np.float32).max)
    expected = np.tile(np.array([-1, -1 / 3, 1 / 3, 1])[:, None] * largest, (2, 3))
    np.testing.assert_allclose(decoded[0, 0].astype(np.float64), expected, rtol=4 * EPS)
