import numpy as np
import pytest

from clrelight.codec.entropy.planes import code_planes
from clrelight.codec.entropy.range_coding import BitCounter, Decoder, Encoder, ModelSet, code_integers
from clrelight.codec.entropy.subbands import Statistics, code_indices
from clrelight.codec.entropy.symbols import (
    ALPHABET,
    CLASSES,
    PRIOR_WEIGHT,
    class_floor,
    classify,
    geometric_prior,
    zero_order_bits,
)
from clrelight.codec.transforms.lifting import list_subbands
from clrelight.errors import PayloadError


def models(contexts=3):
    return ModelSet(geometric_prior([0.5] * contexts))


def test_integers_of_every_size_come_back():
    rng = np.random.default_rng(0)
    edges = np.array([e for b in range(31) for e in (2**b - 1, 2**b, 2**b + 1)] + [2**31 - 1], np.int64)
    values = np.concatenate([edges, rng.integers(0, 2**31, 500), rng.geometric(0.3, 500)]).astype(np.int32)
    contexts = rng.integers(0, 3, len(values))
    encoder, counter = Encoder(), BitCounter()
    for coder in (encoder, counter):
        code_integers(coder, models(), contexts, values)
    payload = encoder.to_bytes()
    decoder = Decoder(payload)
    np.testing.assert_array_equal(code_integers(decoder, models(), contexts, None), values)
    decoder.finish()
    assert abs(8 * len(payload) - counter.bits) <= 64 + 0.001 * counter.bits


def test_learnt_tables_approach_the_entropy():
    values = np.minimum(np.random.default_rng(1).geometric(0.6, 100_000) - 1, 15).astype(np.int32)
    learnt, encoder = models(1), Encoder()
    for batch in np.array_split(values, 50):
        code_integers(encoder, learnt, np.zeros(len(batch), int), batch)
    p = np.bincount(values) / len(values)
    entropy = -len(values) * (p[p > 0] * np.log2(p[p > 0])).sum()
    assert entropy * 0.999 < 8 * encoder.byte_count < entropy * 1.01


def test_classes_are_monotonic_and_two_an_octave():
    activity = np.concatenate([np.arange(1 << 15), 2 ** np.arange(15, 31), [2**31 - 1]]).astype(np.int64)
    classes = classify(activity)
    assert (np.diff(classes.astype(int)) >= 0).all()
    assert classes.max() < CLASSES
    for index in range(1, 20):
        assert classify(np.array([class_floor(index) - 1, class_floor(index)])).tolist() == [index - 1, index]


def test_prior_is_a_distribution():
    prior = geometric_prior([0.01, 1.0, 1e6])
    assert prior.shape == (3, ALPHABET)
    assert prior.min() >= 1
    assert (abs(prior.sum(axis=1) - PRIOR_WEIGHT - ALPHABET / 2) <= ALPHABET / 2).all()


def test_zero_order_bits_of_small_integers_is_their_entropy():
    values = np.random.default_rng(2).integers(-7, 8, 10_000)
    _, counts = np.unique(values, return_counts=True)
    entropy = -(counts * np.log2(counts / counts.sum())).sum()
    assert zero_order_bits(np.abs(values)) == pytest.approx(entropy, rel=2e-3)


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 1, 1), (1, 1, 33), (3, 29, 1), (3, 17, 22), (4, 8, 8)])
@pytest.mark.parametrize("scale", [0.3, 3.0, 1e8])
def test_indices_come_back(shape, scale):
    rng = np.random.default_rng(3)
    bands = list_subbands(*shape[1:], 3)
    maps = [np.rint(np.clip(rng.laplace(scale=scale, size=shape), -(2**29), 2**29)).astype(np.int32) for _ in range(3)]
    maps.append(np.full(shape, -(1 << 29), np.int32))
    encoder, learnt = Encoder(), Statistics()
    for index in maps:
        code_indices(encoder, learnt, bands, shape, index)
    decoder, learnt = Decoder(encoder.to_bytes()), Statistics()
    for index in maps:
        np.testing.assert_array_equal(code_indices(decoder, learnt, bands, shape, None), index)
    decoder.finish()


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 1, 1), (1, 1, 33), (3, 29, 1), (9, 17, 22), (30, 8, 8)])
@pytest.mark.parametrize("scale", [0.02, 0.3, 3.0, 1e8])
def test_planes_come_back(shape, scale):
    rng = np.random.default_rng(3)
    bands = list_subbands(*shape[1:], 3)
    index = np.rint(np.clip(rng.laplace(scale=scale, size=shape), -(2**29), 2**29)).astype(np.int32)
    for planes in (index, np.full(shape, -(1 << 29), np.int32), np.zeros(shape, np.int32)):
        encoder, counter = Encoder(), BitCounter()
        for coder in (encoder, counter):
            code_planes(coder, bands, shape, planes.copy())
        assert abs(8 * encoder.byte_count - counter.bits) <= 64 + 0.002 * counter.bits
        decoder = Decoder(encoder.to_bytes())
        np.testing.assert_array_equal(code_planes(decoder, bands, shape, None), planes)
        decoder.finish()


def test_planes_alike_cost_less_than_planes_apart():
    rng = np.random.default_rng(8)
    edges = np.repeat(rng.random((1, 64, 64)) < 0.05, 12, axis=0)
    apart = rng.permuted(edges.reshape(12, -1), axis=1).reshape(edges.shape)
    signs = 2 * rng.integers(0, 2, edges.shape) - 1
    bands, bits = list_subbands(64, 64, 3), []
    for where in (edges, apart):
        counter = BitCounter()
        code_planes(counter, bands, where.shape, (where * signs).astype(np.int32))
        bits.append(counter.bits)
    assert bits[0] < 0.6 * bits[1]


def test_zeros_cost_next_to_nothing():
    index = np.zeros((20, 64, 64), np.int32)
    index[3, 40, 50] = -2
    counter = BitCounter()
    code_planes(counter, list_subbands(64, 64, 5), index.shape, index)
    assert counter.bits < 250


def test_counting_changes_nothing():
    index = np.random.default_rng(4).integers(-3, 4, (3, 16, 16)).astype(np.int32)
    bands, learnt = list_subbands(16, 16, 3), Statistics()
    before = learnt.magnitudes.counts.copy()
    code_indices(BitCounter(), learnt.copy(), bands, index.shape, index)
    np.testing.assert_array_equal(learnt.magnitudes.counts, before)
    assert learnt.products == {}


def test_decoder_refuses_wrong_lengths():
    with pytest.raises(PayloadError, match="multiple of 4"):
        Decoder(b"abc")
    encoder = Encoder()
    code_integers(encoder, models(), np.zeros(2000, int), np.arange(2000))
    decoder = Decoder(encoder.to_bytes())
    code_integers(decoder, models(), np.zeros(10, int), None)
    with pytest.raises(PayloadError, match="more than the indices"):
        decoder.finish()
