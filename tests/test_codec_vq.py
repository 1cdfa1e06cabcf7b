import numpy as np
import pytest

from clrelight.codec import decode, encode, slabs
from clrelight.codec.formats.vq import Vq
from clrelight.codec.formats.vq_search import search_codebook
from clrelight.errors import InputError, PayloadError
from tests.mutations import check_large_claims
from tests.reference.vq import decode_vq, squared_distances
from tests.styles import both_styles

EPS = float(np.finfo(np.float32).eps)


def some_map(shape, seed=0, noise=0.05):
    rng = np.random.default_rng(seed)
    k, h, w, c = np.indices(shape)
    values = np.sin(h / 5 + w / 7 + k) / (1 + k) + 0.2 * c + noise * rng.standard_normal(shape)
    return values.astype(np.float32)


@both_styles
@pytest.mark.parametrize("words", [1, 3, 4, 5, 64])
@pytest.mark.parametrize("count", [1, 15, 16, 17, 257])
@pytest.mark.parametrize("dims", [1, 3, 49])
def test_search_against_force(device, words, count, dims):
    rng = np.random.default_rng(words + count)
    vectors = rng.standard_normal((dims, count)).astype(np.float32)
    codebook = rng.standard_normal((words, dims)).astype(np.float32)
    codes, squares = search_codebook(vectors, codebook, device)
    distances = squared_distances(vectors, codebook)
    tolerance = (dims + 4) * EPS * distances.min(axis=1)
    assert (np.abs(squares - distances.min(axis=1)) <= tolerance).all()
    assert (distances[np.arange(count), codes] <= distances.min(axis=1) + 2 * tolerance).all()


@both_styles
def test_the_lowest_of_equal_codewords_is_taken(device):
    codebook = np.float32([[2.0], [1.0], [1.0], [3.0], [1.0]])
    codes, squares = search_codebook(np.ones((1, 40), np.float32), codebook, device)
    assert (codes == 1).all()
    assert (squares == 0).all()


@pytest.mark.parametrize("codec", [Vq(), Vq(3, 0), Vq(1, 1), Vq(5, 2), Vq(7, 4), Vq(2, 7)], ids=repr)
@pytest.mark.parametrize(
    "shape", [(1, 1, 1, 1), (1, 1, 1, 3), (4, 1, 13, 3), (9, 7, 5, 1), (4, 11, 13, 3), (4, 4, 8, 2)]
)
def test_decoder_against_reference(device, codec, shape):
    coeffs = some_map(shape)
    encoded = encode(coeffs, codec, device)
    np.testing.assert_array_equal(decode(encoded.to_bytes(), device), decode_vq(encoded.body, shape).astype(np.float32))
    k, h, w, c = shape
    count = h * w if codec.block == 0 else k * -(-h // codec.block) * -(-w // codec.block)
    dims = k * c if codec.block == 0 else codec.block**2 * c
    bits = min(codec.bits, int(np.log2(count)))
    assert encoded.info["table_bytes"] == 4 + 2 * dims * 2**bits
    assert encoded.encoded_bytes == 4 + 2 * dims * 2**bits + -(-count * bits // 8)


# Least mean squared error of a quantiser of a unit normal variable: Max 1960, table I.
@pytest.mark.parametrize(("bits", "least"), [(1, 0.3634), (2, 0.1175), (3, 0.03454), (4, 0.009497)])
def test_normal_values_reach_the_known_optimum(device, bits, least):
    coeffs = np.random.default_rng(0).standard_normal((4, 128, 128, 1)).astype(np.float32)
    decoded = decode(encode(coeffs, Vq(bits, 1), device), device)
    error = np.mean(np.square(decoded - coeffs, dtype=np.float64))
    # Passes stop when they gain less than 0.05%, somewhat before the optimum.
    assert 0.97 * least < error < 1.05 * least


@pytest.mark.parametrize("block", [0, 2])
def test_vectors_that_are_few_are_found(device, block):
    rng = np.random.default_rng(0)
    words = rng.standard_normal((8, 4, 2, 2, 3))
    coeffs = np.zeros((4, 40, 44, 3), np.float32)
    for y, x in np.ndindex(20, 22):
        coeffs[:, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2] = words[rng.integers(0, 8)]
    if block == 0:
        coeffs = coeffs[:, ::2, ::2].copy()
    # 8 pixels, or 4 maps times 8 blocks; a few codewords more, since splitting may end beside the best.
    decoded = decode(encode(coeffs, Vq(5 if block == 0 else 7, block), device), device)
    assert np.square(decoded - coeffs).mean() < 1e-3 * np.square(coeffs).mean()


def test_error_falls_with_the_bits_and_with_smaller_blocks(device):
    coeffs = some_map((9, 40, 50, 3))

    def error(codec):
        return float(np.square(decode(encode(coeffs, codec, device), device) - coeffs).mean())

    for block in (0, 1, 2, 4):
        errors = [error(Vq(bits, block)) for bits in (2, 4, 6, 8)]
        assert errors == sorted(errors, reverse=True)
    assert error(Vq(6, 1)) < error(Vq(6, 2)) < error(Vq(6, 4))


@pytest.mark.parametrize("value", [0.0, 1.0, -7.3, 1e-45, 1e30, 3.4e38])
@pytest.mark.parametrize("block", [0, 3])
def test_constant_maps(device, value, block):
    coeffs = np.full((4, 5, 7, 3), value, np.float32)
    decoded = decode(encode(coeffs, Vq(4, block), device), device)
    np.testing.assert_allclose(decoded.astype(np.float64), coeffs, rtol=2.0**-11, atol=1e-45)


@pytest.mark.parametrize("scale", [1e-45, 1e-40, 3.4e38])
def test_ends_of_float32(device, scale):
    coeffs = (np.random.default_rng(0).uniform(-1, 1, (4, 9, 21, 1)) * scale).astype(np.float32)
    decoded = decode(encode(coeffs, Vq(7, 1), device), device)
    assert np.isfinite(decoded).all()
    assert np.sqrt(np.mean(((decoded.astype(np.float64) - coeffs) / scale) ** 2)) < (0.02 if scale > 1e-44 else 1.0)


def test_same_input_same_bytes_whatever_the_slabs(device, monkeypatch):
    coeffs = some_map((4, 31, 37, 3))
    for block in (0, 2):
        body = encode(coeffs, Vq(5, block), device).body
        assert encode(coeffs.copy(), Vq(5, block), device).body == body
        with monkeypatch.context() as context:
            context.setattr(slabs, "SLAB_BYTES", 1 << 12)
            assert encode(coeffs, Vq(5, block), device).body == body


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("bits", 0),
        ("bits", 13),
        ("bits", 8.0),
        ("bits", True),
        ("block", -1),
        ("block", 9),
        ("block", False),
        ("block", "2"),
    ],
)
def test_bad_options(option, value):
    with pytest.raises(InputError, match=option):
        Vq(**{option: value})


def test_damaged_bodies(device):
    shape = (4, 5, 7, 3)
    body = encode(some_map(shape), Vq(3, 2), device).body
    bad = [b"", body[:3], body[:-1], body + b"\0", body[:4] + b"\x00\x7c" + body[6:], body[:2] + b"\x97\0" + body[4:]]
    bad += [bytes([bits]) + body[1:] for bits in (0, 2, 4, 13, 255)]
    bad += [body[:1] + bytes([block]) + body[2:] for block in (0, 1, 3, 9, 255)]
    # Codewords for one vector, of which there are more.
    bad += [b"\0\x02\0\0" + bytes(24)]
    for damaged in bad:
        with pytest.raises(PayloadError):
            Vq.decode_body(damaged, shape, device)
    check_large_claims(device, Vq, [b"", bytes(4), b"\1\0\0\0", b"\0\x08\0\0" + bytes(1000), b"\1\1\0\0" + bytes(1000)])
