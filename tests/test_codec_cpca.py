import numpy as np
import pytest

from clrelight.codec import decode, encode, slabs
from clrelight.codec.entropy.bitpack import STRETCH, pack_codes, packed_size, unpack_codes
from clrelight.codec.formats import cpca_search
from clrelight.codec.formats.cpca import Cpca
from clrelight.errors import InputError, PayloadError
from tests.mutations import check_large_claims
from tests.reference.cpca import decode_cpca, read_bits


def mixture(shape, clusters, axes, noise=0.0, seed=0):
    """Pixels in a few random affine subspaces, as random means and axes give them."""
    rng = np.random.default_rng(seed)
    k, h, w, c = shape
    means = rng.standard_normal((clusters, k * c))
    basis = rng.standard_normal((clusters, axes, k * c))
    which = rng.integers(0, clusters, h * w)
    values = means[which] + np.einsum("pr,prd->pd", rng.standard_normal((h * w, axes)), basis[which])
    values += noise * rng.standard_normal(values.shape)
    return values.reshape(h, w, k, c).transpose(2, 0, 1, 3).astype(np.float32)


def root_mean_square(values):
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


@pytest.mark.parametrize("bits", range(17))
@pytest.mark.parametrize("count", [1, 7, 8, 13])
def test_bits_are_packed_lowest_first(bits, count):
    codes = np.random.default_rng(bits).integers(0, 1 << bits, count).astype(np.uint16)
    packed = pack_codes(codes, bits)
    assert len(packed) == packed_size(count, bits)
    assert [read_bits(packed, i * bits, bits) for i in range(count)] == codes.tolist()
    np.testing.assert_array_equal(unpack_codes(packed, count, bits), codes)


@pytest.mark.parametrize("bits", [1, 3, 11, 16])
def test_long_runs_of_bits(bits):
    codes = np.random.default_rng(0).integers(0, 1 << bits, 2 * STRETCH + 5).astype(np.uint16)
    np.testing.assert_array_equal(unpack_codes(pack_codes(codes, bits), codes.size, bits), codes)


@pytest.mark.parametrize("codec", [Cpca(), Cpca(1, 1, 1), Cpca(5, 3, 7), Cpca(3, 150, 16)], ids=repr)
@pytest.mark.parametrize("shape", [(1, 1, 1, 1), (4, 1, 13, 3), (9, 7, 5, 1), (4, 11, 13, 3), (4, 3, 5, 2)])
def test_decoder_against_reference(device, codec, shape):
    coeffs = mixture(shape, 3, 2, 0.1)
    encoded = encode(coeffs, codec, device)
    expected = decode_cpca(encoded.body, shape)
    np.testing.assert_allclose(
        decode(encoded.to_bytes(), device), expected, rtol=0, atol=2e-6 * np.abs(coeffs).max() * codec.components
    )
    clusters, axes = min(codec.clusters, shape[1] * shape[2]), min(codec.components, shape[0] * shape[3])
    tables = 7 + 2 * clusters * (1 + axes) * shape[0] * shape[3] + 8 * clusters * axes
    assert encoded.info["table_bytes"] == tables
    pixels = shape[1] * shape[2]
    index_bits = int(np.ceil(np.log2(clusters)))
    assert encoded.encoded_bytes == tables + -(-pixels * index_bits // 8) + -(-pixels * axes * codec.bits // 8)


@pytest.mark.parametrize("axes", [1, 4, 9])
def test_one_cluster_is_as_good_as_principal_components(device, axes):
    rng = np.random.default_rng(0)
    scales = 0.7 ** np.arange(27).reshape(9, 1, 1, 3)
    coeffs = (rng.standard_normal((9, 40, 50, 3)) * scales + 3).astype(np.float32)
    values = coeffs.transpose(1, 2, 0, 3).reshape(2000, 27).astype(np.float64)
    lost = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)[axes:]
    best = np.sqrt(np.square(lost).sum() / values.size)
    ours = root_mean_square(decode(encode(coeffs, Cpca(1, axes, 16), device), device) - coeffs)
    assert ours < 1.02 * best + 2e-3  # binary16 tables
    assert ours > best - 1e-6


def test_subspaces_are_found(device):
    """Clusters by distance to means would cut through these subspaces; their own axes make them nearly exact."""
    coeffs = mixture((9, 60, 70, 3), 6, 3)
    ours = root_mean_square(decode(encode(coeffs, Cpca(12, 3, 12), device), device) - coeffs)
    one = root_mean_square(decode(encode(coeffs, Cpca(1, 3, 12), device), device) - coeffs)
    assert ours < 0.25 * one
    finer = root_mean_square(decode(encode(coeffs, Cpca(32, 3, 12), device), device) - coeffs)
    assert finer < ours


def test_error_falls_with_clusters_components_and_bits(device):
    coeffs = mixture((9, 40, 50, 3), 20, 6, 0.02)
    error = [
        root_mean_square(decode(encode(coeffs, codec, device), device) - coeffs)
        for codec in (Cpca(2, 2, 4), Cpca(16, 2, 4), Cpca(16, 8, 4), Cpca(16, 8, 10))
    ]
    assert error[0] > error[1] > error[2] > error[3]


@pytest.mark.parametrize("value", [0.0, 1.0, -7.3, 1e-45, 1e30, 3.4e38])
def test_constant_maps(device, value):
    coeffs = np.full((4, 5, 7, 3), value, np.float32)
    decoded = decode(encode(coeffs, Cpca(), device), device)
    # Binary16 has 11 bits.
    np.testing.assert_allclose(decoded.astype(np.float64), coeffs, rtol=2.0**-11, atol=1e-45)


@pytest.mark.parametrize("scale", [1e-45, 1e-40, 3.4e38])
def test_ends_of_float32(device, scale):
    coeffs = (np.random.default_rng(0).uniform(-1, 1, (4, 9, 21, 1)) * scale).astype(np.float32)
    decoded = decode(encode(coeffs, Cpca(8, 4, 12), device), device)
    assert np.isfinite(decoded).all()
    assert root_mean_square((decoded.astype(np.float64) - coeffs) / scale) < (0.01 if scale > 1e-44 else 1.0)


def test_clusters_of_equal_vectors(device):
    """Weights that do not vary have a range of a rounding error, or less than none."""
    rng = np.random.default_rng(0)
    coeffs = rng.standard_normal((4, 4, 3))[:, rng.integers(0, 4, (9, 11))].astype(np.float32)
    encoded = encode(coeffs, Cpca(16, 8, 8), device)
    np.testing.assert_allclose(decode(encoded.to_bytes(), device), coeffs, rtol=0, atol=2.0**-10)


def test_same_input_same_bytes(device):
    coeffs = mixture((4, 31, 37, 3), 4, 2, 0.1)
    assert encode(coeffs, Cpca(), device).body == encode(coeffs.copy(), Cpca(), device).body


def test_batches_change_nothing(device, monkeypatch):
    encoded = encode(mixture((4, 31, 37, 3), 4, 2, 0.1), Cpca(), device)
    values = decode(encoded, device)
    monkeypatch.setattr(slabs, "SLAB_BYTES", 4000)
    np.testing.assert_allclose(decode(encoded, device), values, rtol=0, atol=1e-5)


def test_samples_stand_for_all(device, monkeypatch):
    coeffs = mixture((4, 60, 61, 3), 4, 2, 0.05)
    everything = root_mean_square(decode(encode(coeffs, Cpca(4, 2, 10), device), device) - coeffs)
    monkeypatch.setattr(cpca_search, "SAMPLES", 400)
    assert root_mean_square(decode(encode(coeffs, Cpca(4, 2, 10), device), device) - coeffs) < 1.3 * everything


@pytest.mark.parametrize("option", ["clusters", "components", "bits"])
@pytest.mark.parametrize("value", [0, -1, 1 << 20, 2.0, True, "8"])
def test_bad_options(option, value):
    with pytest.raises(InputError, match=option):
        Cpca(**{option: value})


def test_damaged_bodies(device):
    shape = (4, 5, 7, 3)
    body = encode(mixture(shape, 3, 2), Cpca(5, 2, 8), device).body
    tables = 7 + 2 * 5 * 12
    bad = [b"", body[:6], body[:-1], body + b"\0", body[:5] + b"\x97\0" + body[7:]]
    bad += [value + body[2:] for value in (b"\0\0", b"\x24\0", b"\xff\xff")]
    bad += [body[:4] + bytes([bits]) + body[5:] for bits in (0, 17, 255)]
    bad += [body[:at] + b"\x00\x7c" + body[at + 2 :] for at in (7, tables)]  # infinity
    weights = tables + 2 * 5 * 2 * 12
    bad += [
        body[:at] + np.float32(v).tobytes() + body[at + 4 :] for at in (weights, weights + 40) for v in (np.nan, 1e30)
    ]
    bad += [body[: weights + 80] + b"\xff" * 4 + body[weights + 84 :]]  # cluster 7 of 5
    for damaged in bad:
        with pytest.raises(PayloadError):
            Cpca.decode_body(damaged, shape, device)
    head = (1).to_bytes(2, "little") * 2 + b"\x01\0\0"
    check_large_claims(device, Cpca, [b"", bytes(7), head, head + bytes(1000)])
