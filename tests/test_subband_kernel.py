"""The compiled coder of maps against the one in NumPy: the same bytes, indices, statistics and refusals."""

import numpy as np
import pytest

from clrelight.codec.entropy.range_coding import Decoder, Encoder
from clrelight.codec.entropy.subband_kernel import SubbandDecoder, SubbandEncoder, decoder_for, encoder_for
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.transforms.lifting import list_subbands
from clrelight.errors import PayloadError

LARGEST = 1 << 29
SHAPES = [(1, 1, 1), (3, 1, 1), (1, 1, 33), (3, 29, 1), (3, 17, 22), (4, 8, 8), (2, 90, 131)]


@pytest.fixture(autouse=True)
def kernel_of_the_cpu(device):
    if not (device.shares_memory and device.info.float64):
        pytest.skip("the compiled coder is for CPUs with doubles")


def make_maps(shape, scale, seed=3):
    """Return index maps: noise, an extreme, channels that follow each other, and nothing."""
    rng = np.random.default_rng(seed)
    noise = np.rint(np.clip(rng.laplace(scale=scale, size=shape), -LARGEST, LARGEST)).astype(np.int32)
    follow = np.clip(noise[:1].astype(np.int64) * -np.arange(1, shape[0] + 1)[:, None, None], -LARGEST, LARGEST)
    return [noise, np.full(shape, -LARGEST, np.int32), follow.astype(np.int32), np.zeros(shape, np.int32), noise[::-1]]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scale", [0.05, 0.7, 20.0, 1e4, 1e8])
def test_bytes_and_statistics_are_the_same(device, shape, scale):
    bands = list_subbands(*shape[1:], 3)
    plain, compiled = Encoder(), SubbandEncoder(device)
    of_plain, of_compiled = Statistics(), Statistics()
    maps = make_maps(shape, scale)
    for index in maps:
        code_indices(plain, of_plain, bands, shape, index)
        code_indices(compiled, of_compiled, bands, shape, index)
        assert plain.to_bytes() == compiled.to_bytes()
        assert plain.byte_count == compiled.byte_count == len(compiled.to_bytes())
    np.testing.assert_array_equal(of_plain.magnitudes.counts, of_compiled.magnitudes.counts)
    np.testing.assert_array_equal(of_plain.signs.counts, of_compiled.signs.counts)
    assert of_plain.products == of_compiled.products
    decoder, learnt = SubbandDecoder(device, plain.to_bytes()), Statistics()
    for index in maps:
        np.testing.assert_array_equal(code_indices(decoder, learnt, bands, shape, None), index)
    decoder.finish()


def test_carries_run_through_words(device):
    # Long runs of what is nearly certain let words of ones pend for long.
    shape = (1, 64, 64)
    bands, rng = list_subbands(64, 64, 3), np.random.default_rng(0)
    plain, compiled, of_plain, of_compiled = Encoder(), SubbandEncoder(device), Statistics(), Statistics()
    for n in range(60):
        index = (rng.random(shape) < 10.0 ** -(n % 6)).astype(np.int32)
        code_indices(plain, of_plain, bands, shape, index)
        code_indices(compiled, of_compiled, bands, shape, index)
        assert plain.to_bytes() == compiled.to_bytes()


def test_a_copy_goes_on_alone(device):
    shape, bands = (3, 20, 24), list_subbands(20, 24, 3)
    first, second, *_ = make_maps(shape, 5.0)
    encoder, learnt = SubbandEncoder(device), Statistics()
    code_indices(encoder, learnt, bands, shape, first)
    before = encoder.to_bytes()
    code_indices(encoder.copy(), learnt.copy(), bands, shape, second)
    assert encoder.to_bytes() == before
    code_indices(encoder, learnt, bands, shape, second)
    decoder, learnt = SubbandDecoder(device, encoder.to_bytes()), Statistics()
    for index in (first, second):
        np.testing.assert_array_equal(code_indices(decoder, learnt, bands, shape, None), index)
    decoder.finish()


def decode_or_refuse(decoder, bands, shape):
    """Return the indices of two maps and whether anything was left, or None."""
    learnt = Statistics()
    try:
        found = [code_indices(decoder, learnt, bands, shape, None) for _ in range(2)]
    except PayloadError:
        return None
    try:
        decoder.finish()
    except PayloadError:
        return np.array(found), True
    return np.array(found), False


def test_damage_ends_alike(device):
    shape, bands = (3, 17, 22), list_subbands(17, 22, 3)
    encoder, learnt = Encoder(), Statistics()
    for index in make_maps(shape, 300.0)[:2]:
        code_indices(encoder, learnt, bands, shape, index)
    sound, rng, refused = encoder.to_bytes(), np.random.default_rng(7), 0
    for _ in range(150):
        damaged = bytearray(sound)
        for _ in range(rng.integers(1, 4)):
            damaged[rng.integers(len(damaged))] = rng.integers(256)
        if rng.random() < 0.3:
            damaged = damaged[: 4 * rng.integers(len(damaged) // 4)] + rng.bytes(4 * rng.integers(3))
        outcomes = [
            decode_or_refuse(decoder, bands, shape)
            for decoder in (Decoder(bytes(damaged)), SubbandDecoder(device, bytes(damaged)))
        ]
        assert (outcomes[0] is None) == (outcomes[1] is None)
        if outcomes[0] is None:
            refused += 1
        else:
            np.testing.assert_array_equal(outcomes[0][0], outcomes[1][0])
            assert outcomes[0][1] == outcomes[1][1]
    assert 0 < refused < 150


def test_lengths_that_are_no_words_are_refused(device):
    with pytest.raises(PayloadError, match="multiple of 4"):
        SubbandDecoder(device, b"abc")
    for payload in (b"", b"abcd"):
        outcomes = [
            decode_or_refuse(decoder, list_subbands(4, 4, 3), (1, 4, 4))
            for decoder in (Decoder(payload), SubbandDecoder(device, payload))
        ]
        assert (outcomes[0] is None) == (outcomes[1] is None)


def test_cpus_take_the_compiled_one(device):
    assert isinstance(encoder_for(device), SubbandEncoder)
    assert isinstance(decoder_for(b"", device), SubbandDecoder)
