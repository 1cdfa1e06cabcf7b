"""Units of klt: streams, tiles, regions, levels and damage."""

import functools
from types import SimpleNamespace

import numpy as np
import pytest

from clrelight.codec import encode
from clrelight.codec.entropy.unit_streams import FLAGS, Tables, decode_streams, default_tables, encode_streams
from clrelight.codec.entropy.units import (
    LEVELS,
    Window,
    count_units,
    lay_out,
    list_tiles,
    list_units,
    low_side,
    place_units,
)
from clrelight.codec.formats import klt_decode, klt_regions, klt_rows, klt_units
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.klt_decode import UnitView
from clrelight.codec.formats.klt_encode import Encoder
from clrelight.codec.formats.klt_regions import UnitReader
from clrelight.codec.formats.klt_units import parse_body
from clrelight.codec.streams import ArraySource, ArrayTarget
from clrelight.codec.transforms.lifting import padded_width
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.views import Region
from clrelight.codec.zeros import zeros
from clrelight.errors import InputError, PayloadError
from clrelight.harmonics.basis import evaluate_basis
from tests.reference.entropy import join_plane
from tests.styles import both_styles


def decode_region(body, parsed, shape, region, device):
    return UnitView(body, parsed, shape).coefficients(region, device)


def code(device, values, *, together=True, multiplier=0.0, tables=None, finest=True):
    """Encode wavelet coefficients in steps, and return the streams with what they decode to and what was chosen."""
    tables = tables or default_tables()
    count, height, width = values.shape
    window, groups = Window(0, 0, height, width), [(0, count)]
    layout = lay_out(list_units(height, width), (height, width), window, width, together, groups)
    taken = device.hold(np.ascontiguousarray(values, np.float32))
    index = device.hold(np.zeros(values.shape, np.int32))
    coded = encode_streams(device, layout, taken, index, tables, multiplier, finest=finest)
    found = device.hold(np.zeros(values.shape, np.float32))
    fault = decode(device, coded.streams, tables, found, together)
    assert not fault.any()
    return coded, layout, device.download(found).copy(), device.download(index).copy()


def decode(device, streams, tables, found, together):
    """Decode streams of a whole image into planes."""
    count, *sides = found.shape
    units, window = list_units(*sides), Window(0, 0, *sides)
    known = tuple(low_side(side, 1) for side in sides)
    layout = lay_out(units, sides, window, known[1], together, [(0, count)])
    return decode_streams(device, layout, place_units(units, window), streams, tables, found, (count, *known))


def random_values(shape, scale, seed=0):
    """Mostly small numbers, and some large ones."""
    rng = np.random.default_rng(seed)
    return rng.laplace(size=shape) * scale * np.exp(rng.standard_normal(shape[:1]) * 2)[:, None, None]


@pytest.mark.parametrize("sides", [(1, 1), (1, 4097), (64, 64), (65, 63), (513, 1030), (2049, 128)])
def test_units_are_counted_without_being_listed(sides):
    assert count_units(*sides) == len(list_units(*sides))
    assert count_units(1 << 31, 1 << 31) > 1 << 47


@pytest.mark.parametrize("shape", [(3, 64, 96), (1, 1, 1), (2, 1, 70), (2, 33, 1), (4, 47, 131), (2, 200, 150)])
@pytest.mark.parametrize("scale", [0.1, 1.0, 300.0])
@pytest.mark.parametrize("together", [True, False])
def test_streams_decode_to_what_was_coded(device, shape, scale, together):
    values = random_values(shape, scale)
    coded, _, found, index = code(device, values, together=together)
    np.testing.assert_array_equal(found, index)
    assert np.abs(found - values).max() <= 0.5 * (1 + 1e-6 * np.abs(values).max()) + 0.05
    assert len(coded.streams) == (1 if together else len(list_units(*shape[1:])))


@pytest.mark.parametrize("together", [True, False])
def test_indices_that_no_unit_hangs_on_need_not_be_written(device, together):
    values = random_values((2, 141, 90), 1.0)
    coded, _, _, index = code(device, values, together=together)
    other, _, _, some = code(device, values, together=together, finest=False)
    assert other.streams == coded.streams
    np.testing.assert_array_equal(some[:, :71, :45], index[:, :71, :45])
    assert not some[:, 71:].any()
    assert not some[:, :, 45:].any()
    assert index[:, 71:].any()


def test_the_largest_numbers_pass(device):
    values = np.array([[[-1e8, 1e8, 3.0], [1e7, -1e7, 0.0]]])
    _, _, found, index = code(device, values)
    np.testing.assert_array_equal(found, index)
    np.testing.assert_allclose(found, values, rtol=1e-6)


def test_bits_that_save_too_little_are_not_spent(device):
    values = random_values((4, 96, 96), 0.4)
    sizes, errors = [], []
    for multiplier in (0.0, 0.1, 0.3):
        coded, _, found, _ = code(device, values, multiplier=multiplier)
        sizes.append(coded.size)
        errors.append(float(((found - values) ** 2).sum()))
        np.testing.assert_allclose(coded.error_j.sum(), errors[-1], rtol=1e-3)
        assert abs(coded.bits_j.sum() / 8 - coded.size) < 0.02 * coded.size + 40
    assert sizes[0] > sizes[1] > sizes[2]
    assert errors[0] < errors[1] < errors[2]
    # What was saved is worth its multiplier at the least.
    assert errors[1] - errors[0] < 0.1 * 8 * (sizes[0] - sizes[1])


def test_tables_are_learnt_from(device):
    """What comes again and again costs less and less, whatever was expected."""
    counts = np.full_like(default_tables().count_ms, 10)
    flags = np.full((FLAGS, 2), (8192, 2), np.uint16)
    values = random_values((30, 128, 128), 0.5)
    plain, _, found, index = code(device, values, tables=Tables(counts, flags))
    np.testing.assert_array_equal(found, index)
    entropy = -sum(p * np.log2(p) for p in np.unique(index, return_counts=True)[1] / index.size)
    assert 8 * plain.size < 1.02 * entropy * index.size


def test_the_same_map_is_the_same_bytes(device):
    coeffs = made_map(96, 80)
    assert encode(coeffs, Klt(rate=0.3), device).body == encode(coeffs, Klt(rate=0.3), device).body


@pytest.mark.parametrize("seed", range(8))
def test_damage_ends_in_a_fault_or_in_numbers(device, seed):
    """The kernel alone, without the checksums that stand before it."""
    rng = np.random.default_rng(seed)
    values = random_values((5, 70, 90), 2.0, seed)
    coded, _, index, _ = code(device, values, together=bool(seed % 2))
    for trial in range(30):
        streams = [bytearray(stream) for stream in coded.streams]
        stream = streams[int(rng.integers(len(streams)))]
        kind = trial % 3
        if kind == 0:
            stream[int(rng.integers(len(stream)))] ^= int(rng.integers(1, 256))
        elif kind == 1:
            del stream[int(rng.integers(len(stream))) :]
        else:
            stream[:] = rng.integers(0, 256, len(stream), np.uint8).tobytes()
        found = device.hold(np.zeros(index.shape, np.float32))
        fault = decode(device, [bytes(s) for s in streams], default_tables(), found, bool(seed % 2))
        assert set(np.unique(fault)) <= {0, 1}
        assert fault.any() or kind == 0
        assert np.abs(device.download(found)).max() <= 1 << 29


def made_map(height, width, degree=2, channel=3, seed=3):
    """A smooth map with edges and a little noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    planes = np.stack([np.sin(0.031 * x + 0.05 * y), np.cos(0.11 * y), ((x // 37 + y // 51) % 3) * 0.3])
    loadings = rng.standard_normal(((degree + 1) ** 2, channel, 3)) * 0.4
    coeffs = np.einsum("kcr,rhw->khwc", loadings, planes)
    return (coeffs + 0.004 * rng.standard_normal(coeffs.shape)).astype(np.float32)


@functools.cache
def encode_large(device):
    """Return a map of many precincts and streams, its body, and that parsed."""
    coeffs = made_map(1100, 1300, degree=1, channel=2)
    encoder = Encoder(Pixels(ArraySource(coeffs, device)), "linear")
    body, _ = encoder.encode(0.03)
    return coeffs, body, parse_body(body, coeffs.shape)


@pytest.fixture
def large(device):
    return encode_large(device)


def test_a_region_is_a_part_of_the_whole(device, large):
    coeffs, body, parsed = large
    whole = decode_region(body, parsed, coeffs.shape, Region(0, 0, 1100, 1300), device)
    assert np.abs(whole - coeffs).max() < 0.2
    for top, left, bottom, right in [(0, 0, 1, 1), (500, 500, 530, 525), (511, 513, 1025, 1100), (900, 0, 1100, 1300)]:
        part = decode_region(body, parsed, coeffs.shape, Region(top, left, bottom, right), device)
        np.testing.assert_allclose(part, whole[:, top:bottom, left:right], atol=2e-6)


@pytest.mark.parametrize("at_once", [1, 4_000_000, 30_000_000])
@pytest.mark.parametrize("level", [0, 1, 3, 5])
def test_a_region_in_parts_is_the_same(device, large, monkeypatch, at_once, level):
    """As where its planes are more than a device holds at once."""
    coeffs, body, parsed = large
    regions = [Region(0, 0, low_side(1100, level), low_side(1300, level), level), Region(3, 1, 34, 40, level)]
    light = np.array([[0.36, 0.48, 0.8]])

    def decoded():
        view = UnitView(body, parsed, coeffs.shape)
        for region in regions:
            yield decode_region(body, parsed, coeffs.shape, region, device)
            yield view.relight_region(light, region, device)

    expected = list(decoded())
    monkeypatch.setattr(klt_regions, "_AT_ONCE", at_once)
    for found, wanted in zip(decoded(), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=2e-6)


def test_a_region_reads_few_units(device, large):
    coeffs, body, parsed = large
    taken = []

    class Counted:
        def __len__(self):
            return len(body)

        def __getitem__(self, part):
            taken.append(part)
            return body[part]

    decode_region(Counted(), parsed, coeffs.shape, Region(750, 750, 790, 790), device)
    assert sum(part.stop - part.start for part in taken) < 0.2 * len(body)


@pytest.mark.parametrize("level", [1, 2, 5])
def test_a_level_is_the_low_subband(device, large, level):
    coeffs, body, parsed = large
    reader = UnitReader(body, parsed.stored, coeffs.shape, device)
    size = [-(-side >> level) for side in coeffs.shape[1:3]]
    planes = reader.planes(Region(0, 0, *size, level))
    transformed = device.download(reader._decode(Region(0, 0, 1100, 1300), Window(0, 0, 1100, 1300), None))
    # An independent synthesis of what stands in the low subband of the level.
    for plane, coded in zip(planes, transformed[:, : size[0], : size[1]], strict=True):
        expected = join_plane(coded.astype(np.float64), LEVELS - level) * 0.5**level
        np.testing.assert_allclose(plane, expected, atol=1e-4 * np.abs(expected).max())
    part = reader.planes(Region(3, 5, 20, 21, level))
    np.testing.assert_allclose(part, planes[:, 3:20, 5:21], atol=1e-4 * np.abs(planes).max())


@pytest.mark.parametrize("level", [0, 1, 3, 5])
def test_rows_come_as_the_sums_that_they_are(device, large, monkeypatch, level):
    """Row of precincts by row, with what transforms look at beyond, and no unit decoded twice."""
    coeffs, body, parsed = large
    read = []

    class Counted:
        def __len__(self):
            return len(body)

        def __getitem__(self, part):
            read.append(part.start)
            return body[part]

    light, region = np.array([[0.36, 0.48, 0.8]]), Region(7 >> level, 300 >> level, 1099 >> level, 1210 >> level, level)
    view = UnitView(Counted(), parsed, coeffs.shape)
    monkeypatch.setattr(klt_rows, "_SMALL_BYTES", 0)
    bands = list(view.relight_rows(light, region, device))
    assert len(read) == len(set(read)) > 8
    assert [rows.start for rows, _ in bands] == [0, *(rows.stop for rows, _ in bands[:-1])]
    assert len(bands) == 3
    found = np.concatenate([band for _, band in bands], axis=1)
    expected = np.einsum("ik,khwc->ihwc", evaluate_basis(light, 1), view.coefficients(region, device))
    np.testing.assert_allclose(found, expected, atol=1e-5)
    monkeypatch.setattr(klt_rows, "_SMALL_BYTES", 1 << 30)
    read.clear()
    ((_, together),) = view.relight_rows(light, region, device)
    assert len(read) == len(set(read)) > 8
    np.testing.assert_array_equal(together, found)


def test_tables_of_a_body_are_decoded_once(large, monkeypatch):
    coeffs, body, _ = large
    again = parse_body(body, coeffs.shape)
    monkeypatch.setattr(klt_units, "make_operator", None)
    assert parse_body(bytes(bytearray(body)), coeffs.shape).operator_kcj is again.operator_kcj
    with pytest.raises(ValueError, match="read-only"):
        again.operator_kcj[0] = 0.0
    other = bytearray(body)
    other[40] ^= 1
    with pytest.raises((PayloadError, TypeError)):  # which are not those
        parse_body(bytes(other), coeffs.shape)


def test_an_image_needs_no_planes(device, large):
    coeffs, body, parsed = large
    directions = np.array([[0.3, -0.2, np.sqrt(1 - 0.13)], [0.0, 0.0, 1.0]])
    view = UnitView(body, parsed, coeffs.shape)
    expected = np.einsum("ik,khwc->ihwc", evaluate_basis(directions, 1), view.to_coeffs(device))
    one = view.relight(directions[:1], device)
    np.testing.assert_allclose(one, expected[:1], atol=1e-5)
    region = Region(400, 700, 900, 1000)
    np.testing.assert_allclose(
        view.relight_region(directions, region, device), expected[:, 400:900, 700:1000], atol=1e-5
    )


def test_strips_say_what_the_whole_says(device):
    coeffs = made_map(1200, 600, degree=1, channel=1)
    sizes, decoded = [], []
    for memory in (1 << 30, 1 << 20):
        encoder = Encoder(Pixels(ArraySource(coeffs, device)), "linear", memory=memory)
        body, _ = encoder.encode(0.02)
        sizes.append(len(body))
        decoded.append(
            decode_region(body, parse_body(body, coeffs.shape), coeffs.shape, Region(0, 0, 1200, 600), device)
        )
    assert abs(sizes[0] - sizes[1]) <= 1e-3 * sizes[0]
    assert np.abs(decoded[0] - decoded[1]).max() < 0.1
    assert np.mean((decoded[0] - decoded[1]) ** 2) < 1e-7
    assert len(list_tiles(1200, 600, 4, 1 << 20)) == 6


@pytest.mark.parametrize("sides", [None, (512, 1300), (512, 512)])
def test_rows_are_decoded_as_the_whole(device, large, monkeypatch, sides):
    """At once, in strips as wide as the image, and in pieces of strips."""
    coeffs, body, parsed = large
    if sides is not None:
        monkeypatch.setattr(klt_decode, "_strip_sides", lambda *_: sides)

    class Rows(ArrayTarget):
        def row_parts(self, multiple=1):
            return [slice(0, 100), slice(100, 700), slice(700, 1100)]

    target = Rows(coeffs.shape)
    view = UnitView(body, parsed, coeffs.shape)
    view.put_rows(target, device)
    np.testing.assert_allclose(target.coeffs(), view.to_coeffs(device), atol=2e-6)


def test_strips_are_wide_where_pieces_take_as_much():
    shape = (49, 4000, 2448, 3)
    pieces = klt_decode.bytes_at_once(shape, 45)
    assert klt_decode._strip_sides(shape, 45, 1 << 40)[1] == 2448
    assert klt_decode._strip_sides(shape, 45, pieces) == (512, 2448)
    assert klt_decode._strip_sides(shape, 45, 1 << 20) == (512, 2448)
    wider = (49, 4000, 6000, 3)
    assert klt_decode._strip_sides(wider, 45, klt_decode.bytes_at_once(wider, 45))[1] < 6000
    assert klt_decode._strip_sides(wider, 45, 1 << 28) == (512, 6000)


def test_a_map_that_fits_is_one_strip():
    """Of planes that fit half of the memory no unit is decoded twice; of others strips are as high as they can be."""
    shape, planes = (25, 816, 1224, 3), 4 * 29 * 816 * 1224
    assert klt_decode._strip_sides(shape, 29, 2 * planes) == (816, 1224)
    assert klt_decode._strip_sides(shape, 29, 2 * planes - 8)[0] == 512
    rows, columns = klt_decode._strip_sides((25, 9000, 1224, 3), 29, 8 * 29 * 1224 * 4000)
    assert (rows, columns) == (3584, 1224)
    assert klt_decode._strip_sides((25, 5, 7, 3), 0, 1) == (5, 7)


@pytest.mark.parametrize(("count", "most"), [(1, 18), (40, 2), (900, 1)])
def test_rows_of_precincts_are_decoded_together_where_sizes_are_few(count, most):
    shape, stored = (1, 9000, 3000, 1), SimpleNamespace(n_plane=count, together=False)
    reader = UnitReader(b"", stored, shape, None)
    chosen = reader._needed(Region(0, 0, *shape[1:3]))
    groups = reader._groups(chosen)
    assert sorted(t for group in groups for t in group) == chosen
    for group in groups:
        assert group == sorted(group)  # from coarse to fine
        covered = klt_regions._cover([reader._units[t] for t in group], *shape[1:3]).shape
        assert -(-covered[0] // 512) <= most
        assert covered[0] <= 512 or count * covered[0] * covered[1] // 4 <= klt_regions._KNOWN_BYTES
    few = reader._groups(reader._needed(Region(0, 1100, 9000, 1300)))  # as wide as what is looked at
    assert len(few) < len(groups) or count != 40


@both_styles
@pytest.mark.parametrize("shape", [(1,), (3, 5, 7), (1, (1 << 16) - 1), ((1 << 16) + 1,), (2, 3, 1 << 16)])
def test_zeros_are_zeros(device, shape):
    for _ in range(2):
        made = zeros(shape, device)
        values = device.download(made)
        assert values.shape == shape
        assert values.dtype == np.float32
        assert not values.any()
        values[...] = np.nan  # memory that was used
        del made, values


@pytest.mark.parametrize("memory", [1 << 30, 1 << 20])
@pytest.mark.parametrize("rate", [0.1, 0.5])
def test_a_budget_is_used_and_not_passed(device, memory, rate):
    coeffs = made_map(1200, 700, degree=1, channel=3)
    encoder = Encoder(Pixels(ArraySource(coeffs, device)), "linear", memory=memory)
    budget = int(rate * coeffs.size / 8)
    body, _ = encoder.encode_within(budget)
    assert 0.99 * budget <= len(body) <= budget


def test_no_budget_is_passed_by_a_byte(device):
    coeffs = made_map(60, 50)
    with pytest.raises(InputError, match=r"klt needs [0-9]+ bytes for this map even at its coarsest step"):
        encode(coeffs, Klt(byte_budget=20), device)


def read_all(body, shape):
    """Look at every byte of a body."""
    parsed = parse_body(body, shape)
    for stream in range(len(parsed.stored.sum_t)):
        parsed.stored.read(body, stream)


def test_every_byte_is_guarded(device, large):
    coeffs, body, parsed = large
    rng = np.random.default_rng(0)
    first = int(parsed.stored.start_t[0])
    for at in [*range(0, first, 7), *rng.integers(first, len(body), 40)]:
        damaged = bytearray(body)
        damaged[at] ^= int(rng.integers(1, 256))
        with pytest.raises(PayloadError):
            read_all(bytes(damaged), coeffs.shape)


@pytest.mark.parametrize("seed", range(40))
def test_units_lie_in_their_planes(seed):
    """What the kernel takes for granted: units and their parents lie in the planes that a launcher allocates."""
    rng = np.random.default_rng(seed)
    height, width = (int(side) for side in np.exp(rng.uniform(0, np.log(4000), 2)).astype(int))
    level = int(rng.integers(0, LEVELS + 1))
    sides = [low_side(side, level) for side in (height, width)]
    top, left = (int(rng.integers(0, side)) for side in sides)
    bottom, right = (int(rng.integers(first, side)) + 1 for first, side in zip((top, left), sides, strict=True))
    reader = UnitReader(b"", None, (1, height, width, 1), None)
    chosen = [reader._units[t] for t in reader._needed(Region(top, left, bottom, right, level))]
    window = klt_regions._cover(chosen, height, width)
    pitch = padded_width(window.shape[1])
    fields = lay_out(chosen, (height, width), window, pitch, seed % 2 == 0, [(0, 1)]).unit_uf
    for unit in fields:
        most = 16 if unit[0] == 0 else 64
        for band in range(1 if unit[0] == 0 else 3):
            offset, rows, columns, parent, parent_rows, parent_columns = unit[(1 + band) :: 3][:6]
            places = [(offset, rows, columns)] if rows > 0 < columns else []
            assert rows <= most
            assert columns <= most
            if places and parent >= 0:
                assert parent_rows > 0 < parent_columns
                places.append((parent, min(parent_rows, (rows + 1) // 2), min(parent_columns, (columns + 1) // 2)))
            for at, high, wide in places:
                assert at >= 0
                assert at % pitch + wide <= window.shape[1]
                assert at // pitch + high <= window.shape[0]
