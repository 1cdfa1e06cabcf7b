"""The compiled decoder of maps against the coder in NumPy: the same indices, statistics and refusals."""

import numpy as np
import pytest

from clrelight.codec.entropy.range_coding import Decoder, Encoder
from clrelight.codec.entropy.subband_kernel import SubbandDecoder, decoder_for
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.transforms.lifting import list_subbands
from clrelight.errors import PayloadError

LARGEST = 1 << 29
SHAPES = [(1, 1, 1), (3, 1, 1), (1, 1, 33), (3, 29, 1), (3, 17, 22), (4, 8, 8), (2, 90, 131)]


@pytest.fixture(autouse=True)
def kernel_of_the_cpu(device):
    if not (device.shares_memory and device.info.float64):
        pytest.skip("the compiled decoder is for CPUs with doubles")


def make_maps(shape, scale, seed=3):
    """Return index maps: noise, an extreme, channels that follow each other, and nothing."""
    rng = np.random.default_rng(seed)
    noise = np.rint(np.clip(rng.laplace(scale=scale, size=shape), -LARGEST, LARGEST)).astype(np.int32)
    follow = np.clip(noise[:1].astype(np.int64) * -np.arange(1, shape[0] + 1)[:, None, None], -LARGEST, LARGEST)
    return [noise, np.full(shape, -LARGEST, np.int32), follow.astype(np.int32), np.zeros(shape, np.int32), noise[::-1]]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scale", [0.05, 0.7, 20.0, 1e4, 1e8])
def test_indices_and_statistics_are_the_same(device, shape, scale):
    bands = list_subbands(*shape[1:], 3)
    encoder, of_plain = Encoder(), Statistics()
    maps = make_maps(shape, scale)
    for index in maps:
        code_indices(encoder, of_plain, bands, shape, index)
    decoder, of_compiled = SubbandDecoder(device, encoder.to_bytes()), Statistics()
    for index in maps:
        np.testing.assert_array_equal(code_indices(decoder, of_compiled, bands, shape, None), index)
    decoder.finish()
    np.testing.assert_array_equal(of_plain.magnitudes.counts, of_compiled.magnitudes.counts)
    np.testing.assert_array_equal(of_plain.signs.counts, of_compiled.signs.counts)
    assert of_plain.products == of_compiled.products


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
    for _ in range(60):
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
    assert 0 < refused < 60


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
    assert isinstance(decoder_for(b"", device), SubbandDecoder)
