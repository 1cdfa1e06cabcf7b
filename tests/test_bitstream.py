"""docs/bitstream.md against the program: decoders that know the page alone read what our encoders write."""

import hashlib
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from clrelight.codec import codec_class, codec_ids, decode, encode
from clrelight.codec.entropy import batches, planes, range_coding, subbands
from clrelight.codec.entropy.symbols import class_floor, classify, geometric_prior
from clrelight.codec.formats import codestream, klt_regions, klt_units
from clrelight.codec.minimum_size import pad_body, pad_to_minimum
from clrelight.codec.transforms import principal
from clrelight.codec.transforms.lifting import list_subbands
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.errors import PayloadError
from tests.reference import entropy
from tests.reference.bc6h import decode_bc6h
from tests.reference.cpca import decode_cpca
from tests.reference.klt import (
    PlaneTables,
    decode_by_shells,
    decode_klt,
    decode_planes,
    decode_vectors,
    hemisphere_axes,
)
from tests.reference.klt4 import START, crc, decode_klt4, read_streams
from tests.reference.payload import Refused, open_payload, without_minimum_padding, without_padding
from tests.reference.s3tc import decode_s3tc
from tests.reference.uniform import decode_uniform
from tests.reference.vq import decode_vq
from tests.reference.wavelet6 import decode_wavelet6, decode_wavelet7
from tests.reference.wavelet_decoder import Learnt, decode_indices, decode_wavelet, prior_of

ROOT = Path(__file__).resolve().parent
FROZEN = sorted((ROOT / "frozen").glob("*.bin"))
PAGE = (ROOT.parent / "docs" / "bitstream.md").read_text(encoding="utf-8")
EPS = float(np.finfo(np.float32).eps)


def decode_jpeg2000(body, shape):
    n, (height, width) = shape[0] * shape[3], shape[1:3]
    low, step = np.frombuffer(body, "<f4", 2 * n).reshape(2, n).astype(float)
    sizes = np.frombuffer(body, "<u4", n, 8 * n)
    at = 12 * n + (1 + 2 * (3 * min(5, min(height, width).bit_length() - 1) + 1) if sizes.any() else 0)
    steps, maps = body[12 * n : at], np.repeat(low, height * width).reshape(n, height, width)
    for m in np.flatnonzero(sizes):
        maps[m] += step[m] * codestream.decode_plane(steps, body[at : at + sizes[m]], height, width)
        at += int(sizes[m])
    without_padding(body, at, shape)
    return maps.reshape(shape[0], shape[3], height, width).transpose(0, 2, 3, 1)


def decode_inside(body, shape):
    """Return the inner codec's id, and what stands behind it."""
    end = 1 + body[0] % 128
    return body[1:end].decode("ascii"), body[end:]


def decode_whitened(body, shape):
    inverse = hemisphere_axes(round(shape[0] ** 0.5) - 1, "damped" if body[0] >= 128 else "singular")[1]
    codec, body = decode_inside(body, shape)
    return np.tensordot(inverse, DECODERS[codec](body, (inverse.shape[1], *shape[1:])), 1)


def decode_principal(body, shape):
    inverse = hemisphere_axes(round(shape[0] ** 0.5) - 1, "damped" if body[0] >= 128 else "smooth")[1]
    codec, body = decode_inside(body, shape)
    count, components = int.from_bytes(body[:2], "little"), inverse.shape[1]
    axes = np.frombuffer(body, "<f2", count * components, 2).reshape(count, components).astype(float)
    maps = DECODERS[codec](body[2 + axes.size * 2 :], (count, *shape[1:]))
    return np.tensordot(inverse @ axes.T, maps, 1)


def decode_any_klt(body, shape):
    return decode_klt4(body, shape) if body[:1] == b"\4" else decode_klt(body, shape)


def decode_any_wavelet(body, shape):
    decoders = {6: decode_wavelet6, 7: decode_wavelet7}
    return decoders.get(body[0], decode_wavelet)(body, shape)


DECODERS = {
    "half": lambda body, shape: np.frombuffer(body, "<f2").reshape(shape).astype(float),
    "uniform": decode_uniform,
    "s3tc": decode_s3tc,
    "bc6h": lambda body, shape: decode_bc6h(body, shape).astype(float),
    "vq": decode_vq,
    "cpca": decode_cpca,
    "jpeg2000": decode_jpeg2000,
    "wavelet": lambda body, shape: decode_any_wavelet(body, shape)[1],
    "klt": lambda body, shape: decode_any_klt(body, shape).coeffs,
    "whitened": decode_whitened,
    "principal": decode_principal,
}


def test_every_codec_has_its_section():
    assert {line[3:] for line in PAGE.splitlines() if line.startswith("## ")} >= set(codec_ids())
    assert set(DECODERS) == set(codec_ids())


@pytest.mark.parametrize("path", FROZEN, ids=lambda path: path.stem)
def test_frozen_payloads_decode_by_the_page(path):
    payload, expected = open_payload(path.read_bytes()), np.load(path.with_suffix(".npy"))
    found = DECODERS[payload.codec](payload.body, payload.shape)
    np.testing.assert_allclose(found, expected, rtol=0, atol=8 * EPS * np.abs(expected).max())


def smooth_map(degree, shape, seed=0):
    """Return waves with noise that fall with the degree, and positive in the mean, as fits are."""
    rng = np.random.default_rng(seed)
    k, h, w, c = np.indices(((degree + 1) ** 2, *shape))
    waves = np.sin(0.3 * h + k) * np.cos(0.2 * w * (1 + k % 3) + 0.2 * c) + 2.0 * (k == 0)
    values = 0.3 * waves + 0.05 * rng.standard_normal(waves.shape) * (rng.random(waves.shape) < 0.3)
    return (values / (1 + np.sqrt(k).astype(int)) ** 2).astype(np.float32)


@pytest.fixture
def taken(monkeypatch):
    """Return the indices that our decoders found, and the vectors of klt, filled while they run."""
    found = {"indices": [], "vectors": []}

    def spy(module, name, keep):
        original = getattr(module, name)

        def run(*arguments):
            result = original(*arguments)
            keep(arguments, result)
            return result

        monkeypatch.setattr(module, name, run)

    spy(klt_regions, "decode_streams", lambda a, _: found["indices"].append(a[0].download(a[5]).copy()))
    for name in ("code_vectors", "code_by_shells"):
        spy(klt_units, name, lambda _, result: found["vectors"].append(result))
    return found


@pytest.mark.parametrize(
    ("degree", "shape", "options"),
    [
        (0, (1, 1, 1), {"rate": 400.0}),
        (0, (17, 13, 3), {"rate": 30.0}),  # to float32's own precision
        (1, (9, 11, 3), {"rate": 2.0}),
        (2, (13, 7, 1), {"rate": 4.0}),
        (2, (1, 33, 3), {"rate": 3.0}),
        (3, (5, 8, 2), {"rate": 12.0, "allocation": "global"}),
        (6, (7, 9, 3), {"rate": 1.0, "allocation": "global"}),
        (6, (7, 9, 1), {"rate": 6.0}),
        (4, (40, 50, 3), {"rate": 12.0}),  # bits that are written as they are, streams of their own, groups
    ],
)
def test_wavelet(device, taken, degree, shape, options):
    coeffs = smooth_map(degree, shape)
    encoded = encode(coeffs, codec_class("wavelet").from_config(options), device)
    taken["indices"].clear()
    indices, found = decode_wavelet6(encoded.body, encoded.shape)
    expected = decode(encoded, device)
    assert len(indices)
    (index,) = taken["indices"]
    np.testing.assert_array_equal(indices, index[..., : shape[1]])
    scale = np.abs(expected).max(axis=(1, 2, 3), keepdims=True)
    assert (np.abs(found - expected) <= 96 * EPS * scale).all()


@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((4, 1, 1, 3), {"rate": 16.0}),
        ((9, 1, 5, 1), {"rate": 9.0, "allocation": "global"}),
        ((1, 1, 1, 1), {"rate": 60.0}),
    ],
)
def test_wavelet_of_few_numbers(device, shape, options):
    coeffs = smooth_map(round(shape[0] ** 0.5) - 1, shape[1:])
    coeffs[-1] *= shape[0] == 1  # a map that is zero
    encoded = encode(coeffs, codec_class("wavelet").from_config(options), device)
    assert encoded.body[0] == 7
    _, found = decode_wavelet7(encoded.body, shape)
    np.testing.assert_array_equal(found.astype(np.float32), decode(encoded, device))
    largest = np.abs(coeffs).max(axis=None if "allocation" in options else (1, 2, 3), keepdims=True)
    assert (np.abs(found - coeffs) <= 2.0 ** (2 - encoded.body[1]) * largest).all()


def test_a_wavelet_payload_has_all_that_the_page_says(device):
    """Groups, units that are streams, bits written as they are, and rotations of either kind."""
    coeffs = smooth_map(4, (40, 50, 3))
    fine = encode(coeffs, codec_class("wavelet").from_config({"rate": 12.0}), device).body
    assert fine[2] == 2 | 4 | 8 | 16
    assert int.from_bytes(fine[3:5], "little") < len(coeffs)
    coarse = encode(coeffs, codec_class("wavelet").from_config({"rate": 0.1}), device).body
    assert coarse[2] == 1 | 4


def check_klt(device, taken, coeffs, options):
    """Return what the page makes of an encoded map, which is what the program makes of it."""
    encoded = encode(coeffs, codec_class("klt").from_config(options), device)
    for seen in taken.values():
        seen.clear()  # encoding may have decoded to compare
    klt_units._read_tables.cache_clear()
    found, expected = decode_klt4(encoded.body, encoded.shape), decode(encoded, device)
    mean, axes = taken["vectors"]
    np.testing.assert_array_equal(found.mean, mean[0])
    np.testing.assert_array_equal(found.axes, axes)
    assert len(taken["indices"]) == (len(found.indices) > 0)
    for index in taken["indices"]:
        np.testing.assert_array_equal(found.indices, index[..., : coeffs.shape[2]])
    if options["transfer"] == "linear":
        np.testing.assert_allclose(found.coeffs, expected, rtol=0, atol=64 * EPS * np.abs(expected).max())
    # Behind the curve roundings are multiplied by its slope and projected back: magnified where no image shows them.
    forward = hemisphere_axes(round(len(coeffs) ** 0.5) - 1, "singular")[0]
    shown, error = (np.tensordot(forward, values, 1) for values in (expected, found.coeffs - expected))
    assert np.abs(error).max() <= (64 if options["transfer"] == "linear" else 256) * EPS * np.abs(shown).max()
    return found


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize(
    ("degree", "shape", "step"),
    [
        (0, (1, 1, 1), 2.0**-6),
        (0, (13, 9, 3), 2.0**-8),
        (0, (70, 131, 1), 2.0**-7),
        (1, (9, 11, 3), 2.0**-12),
        (2, (33, 1, 3), 2.0**-7),
        (2, (1, 150, 2), 2.0**-9),
        (3, (11, 10, 1), 2.0**-16),
        (4, (8, 7, 2), 2.0**-6),
        (5, (7, 9, 3), 2.0**-5),
        (6, (9, 9, 3), 2.0**-9),
    ],
)
def test_klt(device, taken, degree, shape, step, transfer):
    found = check_klt(device, taken, smooth_map(degree, shape), {"step": step, "transfer": transfer})
    assert len(found.indices) or step >= 2.0**-6


def test_klt_at_fine_steps_has_shifts_and_escapes(device, taken):
    found = check_klt(device, taken, smooth_map(1, (40, 50, 3)), {"step": 2.0**-17, "transfer": "linear"})
    assert len(found.indices) > 8  # all groups of contexts
    details = np.abs(found.indices[:, 2:, 2:])
    assert details.max() > 1 << 12
    assert (details == 0).any()


@pytest.mark.parametrize("shape", [(290, 920, 1), (3, 90_000, 1)])
def test_klt_in_streams_of_their_own(device, taken, shape):
    coeffs = smooth_map(0, shape)
    coeffs[:, :, np.arange(shape[1]) // 40 % 20 == 0] += 2.0
    found = check_klt(device, taken, coeffs, {"step": 0.5, "transfer": "linear"})
    assert len(found.indices) == 1
    assert np.count_nonzero(found.indices) > 500


@pytest.mark.parametrize("rows", [99, 130])
def test_how_far_the_inverse_transform_looks(rows):
    """A unit is needed by pixels within three of its rows, or columns."""
    for band in entropy.list_bands(rows, 1, 5):
        for y in range(band.height):
            plane = np.zeros((rows, 1))
            plane[band.top + y] = 1.0
            changed = np.flatnonzero(entropy.join_plane(plane, 5))
            assert (changed[-1] >> band.level) - 3 <= y <= (changed[0] >> band.level) + 3


def test_a_klt_payload_behind_the_curve_is_among_those(device):
    codec = codec_class("klt").from_config({"step": 2.0**-5, "transfer": "srgb"})
    assert encode(smooth_map(2, (12, 12, 3)), codec, device).body[10] & 9 == 1 + 8  # and tables by shells


def test_the_tables_that_units_start_from_are_those_of_the_page():
    assert hashlib.sha256(START.read_bytes()).hexdigest() in PAGE


SHAPES = [(1, 1, 1), (3, 1, 1), (1, 1, 17), (3, 13, 1), (5, 6, 7), (8, 4, 4)]


def random_indices(shape, scale):
    rng = np.random.default_rng(shape[0])
    return np.rint(np.clip(rng.laplace(scale=scale, size=shape), -(2**29), 2**29)).astype(np.int32)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("scale", [0.1, 3.0, 1e4, 1e8])
def test_indices_of_any_size(shape, scale):
    bands = list_subbands(*shape[1:], 3)
    maps = [random_indices(shape, scale), np.full(shape, -(1 << 29), np.int32), random_indices(shape, scale)[::-1]]
    for pairs in (False, True):
        encoder, learnt = range_coding.Encoder(), subbands.Statistics()
        for index in maps:
            subbands.code_indices(encoder, learnt, bands, shape, index, group=2 if pairs else 1)
        decoder, learnt = entropy.RangeDecoder(encoder.to_bytes()), Learnt()
        for index in maps:
            np.testing.assert_array_equal(decode_indices(decoder, learnt, shape, 3, pairs), index)
        decoder.finish()


@pytest.mark.parametrize("shape", [*SHAPES, (23, 5, 3)])
@pytest.mark.parametrize("scale", [0.02, 0.5, 1e4, 1e8])
def test_planes_of_any_size(shape, scale):
    bands = list_subbands(*shape[1:], 3)
    for index in (random_indices(shape, scale), np.zeros(shape, np.int32)):
        encoder = range_coding.Encoder()
        planes.code_planes(encoder, bands, shape, index.copy())
        decoder = entropy.RangeDecoder(encoder.to_bytes())
        np.testing.assert_array_equal(decode_planes(decoder, shape, 3), index)
        decoder.finish()


@pytest.mark.parametrize(
    ("code", "decode"), [(principal.code_vectors, decode_vectors), (principal.code_by_shells, decode_by_shells)]
)
@pytest.mark.parametrize("components", [1, 2, 16, 23])
def test_vectors_of_any_size(code, decode, components):
    rng = np.random.default_rng(7)
    entries = rng.laplace(scale=[[[1.0]], [[1e3]], [[1e6]], [[0.1]], [[0.0]]], size=(5, 3, components))
    for rows in (entries, entries[::-1]):
        given = np.rint(np.clip(rows, -(2**24), 2**24)).astype(np.int64)
        encoder = range_coding.Encoder()
        code(encoder, given.shape, given)
        theirs, ours = entropy.RangeDecoder(encoder.to_bytes()), range_coding.Decoder(encoder.to_bytes())
        np.testing.assert_array_equal(decode(theirs, *given.shape), given)
        np.testing.assert_array_equal(code(ours, given.shape, None), given)
        theirs.finish()
        ours.finish()


def test_vectors_that_fill_a_table():
    entries = np.zeros((70, 3, 49), np.int64)  # 10290 entries: tables are halved after 8192
    entries[::7, :, :20] = np.random.default_rng(8).integers(-40, 40, (10, 3, 20))
    for given in (entries, np.sign(entries + 1)):
        encoder = range_coding.Encoder()
        principal.code_by_shells(encoder, given.shape, given)
        decoder = range_coding.Decoder(encoder.to_bytes())
        np.testing.assert_array_equal(principal.code_by_shells(decoder, given.shape, None), given)
        decoder.finish()


def test_entries_of_a_high_degree_that_are_zero_take_no_bytes():
    entries = np.zeros((20, 3, 24**2), np.int64)
    entries[:, :, :9] = np.random.default_rng(3).integers(-9, 9, (20, 3, 9))
    sizes = []
    for components in (9, 24**2):
        encoder = range_coding.Encoder()
        principal.code_by_shells(encoder, (20, 3, components), entries[:, :, :components])
        sizes.append(len(encoder.to_bytes()))
    assert sizes[1] < sizes[0] + 40  # 3 bits each were 650 bytes for the first vector alone


def test_tables_are_those_of_the_page():
    plane_tables = PlaneTables()
    quiet, counts, gaps = batches._priors()
    for ours, theirs in (
        (subbands._magnitude_prior(), prior_of),
        (planes._prior(), plane_tables.loud.prior),
        (quiet, plane_tables.quiet.prior),
        (counts, plane_tables.counts.prior),
        (gaps, plane_tables.gaps.prior),
    ):
        assert [ours[context].tolist() for context in range(len(ours))] == [
            theirs(context) for context in range(len(ours))
        ]
    assert subbands.Statistics().signs.counts.tolist() == [[8193, 8193]] * 5


def test_a_float_is_the_fraction_it_stands_for():
    exact = geometric_prior([Fraction(9, 20) * 7, Fraction(3, 20)])
    np.testing.assert_array_equal(geometric_prior([0.45 * 7, 0.15]), exact)


def test_bounds_are_those_of_the_page():
    rng = np.random.default_rng(3)
    for symbols in (2, 124):
        counts = rng.integers(1, 2 ** rng.integers(1, 17, (200, 1)), (200, symbols))
        counts[:50] = counts[:50, :1]  # sums that divide each other
        models = range_coding.ModelSet(counts)
        shares = range_coding._find_shares(models, [(context, slice(0)) for context in range(200)])
        for row, share in zip(counts.tolist(), shares, strict=True):
            left = np.append(0, np.cumsum(share + 1)).astype(int)
            assert entropy.bounds(row) == left.tolist()


def test_the_range_encoder_is_that_of_the_page():
    rng = np.random.default_rng(5)
    for trial in range(200):
        counts = rng.integers(1, 2 ** rng.integers(1, 18), (1, rng.choice([2, 124])))
        counts[0, 0] *= rng.choice([1, 4000])  # runs of what is nearly certain, whose carries come late
        symbols = rng.choice(counts.size, trial, p=counts[0] / counts.sum())
        ours, theirs = range_coding.Encoder(), entropy.RangeEncoder()
        ours.code(range_coding.ModelSet(counts), np.zeros(trial, int), symbols)
        left = entropy.bounds(counts[0].tolist())
        for symbol in symbols:
            theirs.put(left, symbol)
        assert ours.to_bytes() == theirs.to_bytes()


def test_classes_are_those_of_the_page():
    activity = np.concatenate([np.arange(5000), 2 ** np.arange(13, 31), [2**31 - 1]])
    assert [entropy.class_of(int(a)) for a in activity] == classify(activity).tolist()
    assert [entropy.floor_of(i) for i in range(62)] == [class_floor(i) for i in range(62)]


@pytest.mark.parametrize("axes", ["damped", "smooth", "singular"])
def test_the_metric_is_that_of_the_page(axes):
    for degree in range(9):
        ours = hemisphere_metric((degree + 1) ** 2, axes)
        forward, inverse = hemisphere_axes(degree, axes)
        tolerance = 1e-6 if degree < 7 else 1e-3
        np.testing.assert_allclose(forward @ ours.inverse_kj, np.eye(len(forward)), rtol=0, atol=tolerance)
        np.testing.assert_allclose(inverse, ours.inverse_kj, rtol=0, atol=tolerance * np.abs(inverse).max())


def test_the_page_counts_the_components():
    counts = [len(hemisphere_metric((degree + 1) ** 2).forward_jk) for degree in range(11, 41)]
    assert " ".join(map(str, counts)) in PAGE


@pytest.mark.parametrize("shape", [(1, 1 << 12, 1 << 12, 1), (4, 1 << 11, 1 << 11, 2), (1, 1 << 13, 1 << 13, 1)])
def test_least_sizes_are_those_of_the_page(shape):
    for body in (b"", bytes(range(1, 100)), b"\1" * 5000):
        assert without_minimum_padding(pad_to_minimum(body, shape), shape) == body
        assert without_padding(pad_body(body, 4096), len(body), (1, 64, 64, 1)) == body
    with pytest.raises(Refused):
        without_minimum_padding(b"\1\0\0\0\2\0\0\0" * 1000, (1, 1 << 13, 1 << 13, 1))


@pytest.mark.parametrize("codec", ["wavelet", "klt"])
def test_both_refuse_or_read_alike_what_is_damaged(device, codec):
    options = {"rate": 20.0} if codec == "wavelet" else {"step": 2.0**-6, "transfer": "linear"}
    encoded = encode(smooth_map(1, (5, 6, 1)), codec_class(codec).from_config(options), device)
    body, rng, refused = bytes(encoded.body), np.random.default_rng(2), 0
    for _ in range(40):
        damaged = bytearray(body)
        damaged[rng.integers(len(body))] ^= 1 << rng.integers(8)
        damaged = bytes(damaged[: len(damaged) - int(rng.choice([0, 0, 4]))])
        refused += check_damaged(device, codec, damaged, encoded.shape)
    assert refused


def check_damaged(device, codec, damaged, shape):
    """Return whether both decoders refuse a body; that they agree is checked."""
    try:
        expected = codec_class(codec).decode_body(damaged, shape, device)
    except PayloadError:
        with pytest.raises(Refused):
            DECODERS[codec](damaged, shape)
        return True
    found = DECODERS[codec](damaged, shape)
    assert np.abs(found - expected).max() <= 1e-4 * np.abs(expected).max()
    return False


@pytest.mark.parametrize(
    ("shape", "step"), [((5, 6, 1), 2.0**-6), ((21, 18, 3), 2.0**-7), ((6, 9, 2), 2.0**-19), ((70, 40, 1), 2.0**-6)]
)
def test_both_refuse_or_read_alike_units_damaged_behind_their_checksums(device, shape, step):
    encoded = encode(smooth_map(1, shape), codec_class("klt").from_config({"step": step, "transfer": "linear"}), device)
    front = encoded.body[: 15 + int.from_bytes(encoded.body[11:15], "little")]
    (stream,) = read_streams(encoded.body, len(front), 1)
    assert with_stream(front, stream) == encoded.body
    rng, refused = np.random.default_rng(4), []
    for trial in range(60):
        damaged, head = bytearray(stream), bytearray(front)
        match trial % 6:
            case 0:  # a state
                damaged[rng.integers(16)] ^= 1 << rng.integers(8)
            case 1:  # words
                damaged[rng.integers(16, len(stream))] = rng.integers(256)
            case 2:  # raw bits
                damaged[len(stream) - 1 - rng.integers(min(len(stream), 40))] ^= 1 << rng.integers(8)
            case 3:
                del damaged[rng.integers(len(stream)) :]
            case 4:
                damaged[16:] = rng.integers(0, [2, 256][trial % 2], len(stream) - 16, np.uint8).tobytes()
            case 5:
                head[rng.integers(2, len(front))] ^= 1 << rng.integers(8)
        refused.append(check_damaged(device, "klt", with_stream(bytes(head), bytes(damaged)), encoded.shape))
    assert any(refused)
    assert not all(refused)


def with_stream(front, stream):
    """Return a body whose checksums are those of what it holds."""
    size, index = len(stream), bytearray()
    while size >= 128:
        index.append(size % 128 | 128)
        size >>= 7
    front = front + bytes(index) + bytes([size]) + crc(stream)
    return front + crc(front) + stream
