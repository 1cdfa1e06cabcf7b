"""How klt finds its step and fills a budget: pieces are coded as if alone, and what is coded anew decodes."""

import re

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from clrelight.codec.entropy.units import Window, list_units
from clrelight.codec.formats.klt import Klt
from clrelight.codec.formats.klt_encode import Encoder
from clrelight.codec.formats.klt_fill import MULTIPLIER_POWER, _choose, _take, fill
from clrelight.codec.formats.klt_steer import steer
from clrelight.codec.streams import ArraySource
from clrelight.codec.transforms.metric import hemisphere_metric
from clrelight.codec.transforms.pixels import Pixels
from clrelight.codec.transforms.principal import ROTATION_UNIT, quantise_mean
from clrelight.codec.transforms.whitening import AXES, whitening_of
from clrelight.errors import InputError
from tests.reference.klt4 import decode_klt4
from tests.styles import both_styles


def rough_map(height, width):
    """Return coefficients of degree 1 whose detail differs from place to place, and a little noise."""
    rng = np.random.default_rng(7)
    y, x = np.mgrid[:height, :width] / 37.0
    planes = [np.cos((1 + 5 * rng.random()) * x + 9 * rng.random() * y * (y > 4)) for _ in range(6)]
    coeffs = np.einsum("kr,rhw->khw", rng.standard_normal((4, 6)), np.array(planes))
    return (coeffs + 0.03 * rng.standard_normal(coeffs.shape)).astype(np.float32)[..., None]


@pytest.mark.parametrize(("height", "width"), [(128, 128), (61, 90)])
def test_pieces_side_by_side_are_those_alone(device, height, width):
    encoder = Encoder(Pixels(ArraySource(rough_map(600, 520), device)), "linear")
    planes = encoder._whitening.exact(3)
    windows = [Window(top, left, top + height, left + width) for top in (0, 96, 416) for left in (32, 352)]
    together = encoder.take_pieces(windows, planes)
    for step, count in ((0.02, 3), (0.3, 2)):
        alone = [encoder.try_pieces(encoder.take_pieces([window], planes), step, count)[0] for window in windows]
        for one, other in zip(encoder.try_pieces(together, step, count), alone, strict=True):
            assert one.size == other.size > 0
            for name in ("bits_j", "error_j", "energy_j"):
                np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
                assert getattr(one, name).shape == (count,)


@both_styles
@pytest.mark.parametrize("rate", [0.02, 0.15, 1.0])
def test_what_fills_a_budget_decodes(device, rate):
    coeffs = rough_map(530, 600)
    encoder = Encoder(Pixels(ArraySource(coeffs, device)), "linear")

    def error_of(body):
        return float(np.mean((Klt.decode_body(body, coeffs.shape, device) - coeffs) ** 2))

    budget = int(rate * coeffs.size / 8)
    filled, found = encoder.encode_within(budget)
    plain, _ = encoder.encode(found["step"])
    assert 0.99 * budget <= len(filled) <= budget
    # At the same step, more bytes are less error, and the other way round.
    assert error_of(filled) == pytest.approx(error_of(plain) * len(plain) / len(filled), rel=0.15)


def test_no_budget_is_refused_that_the_mean_fits(device):
    """Whatever trials foretold of axes that take a few bytes more."""
    coeffs = rough_map(13, 17)

    def encode_within(budget):
        return Encoder(Pixels(ArraySource(coeffs, device)), "linear").encode_within(budget)[0]

    with pytest.raises(InputError, match="even at its coarsest step") as refused:
        encode_within(12)
    least = int(re.search(r"needs (\d+) bytes", str(refused.value))[1])
    coeffs = coeffs[:, :2, :2].copy()
    with pytest.raises(InputError, match="even at its coarsest step"):
        encode_within(1)  # at the step that is guessed no axis counts
    coeffs = rough_map(13, 17)
    for budget in range(least, least + 40, 3):
        assert least <= len(encode_within(budget)) <= budget


def test_no_piece_is_coded_twice_at_a_step(device, monkeypatch):
    tried = []
    code = Encoder.try_pieces

    def counted(self, pieces, step, count):
        tried.append((id(pieces), step, count))
        return code(self, pieces, step, count)

    monkeypatch.setattr(Encoder, "try_pieces", counted)
    coeffs = rough_map(760, 700)  # larger than what is tried as a whole
    encoder = Encoder(Pixels(ArraySource(coeffs, device)), "linear")
    encoder.encode_within(int(0.05 * coeffs.size / 8))
    assert len(tried) == len(set(tried)) > 1
    assert len(encoder._windows) > 1
    assert len({pieces for pieces, _, _ in tried}) == 2  # few at first, then more with them


@pytest.mark.parametrize("power", [0.2, 0.35])
@pytest.mark.parametrize("miss", [-0.02, 0.0, 0.02, 0.5])
def test_a_budget_is_filled_while_the_last_units_are_coded(miss, power):
    """By units that take what their parents foretell but for some noise, and far from even in one corner."""
    units, usual, rng = list_units(900, 1300), 0.15, np.random.default_rng(4)
    sample_t = np.array([135 * unit.side**2 for unit in units])
    rough = np.array([2.0 if unit.row << (unit.level or 5) < 512 else 0.7 for unit in units])
    size_t = sample_t * rough * [0.02 if unit.level == 1 else 0.03 for unit in units]
    size_t *= rng.normal(1.0, 0.03, len(units))
    budget, turns = (1.0 - miss) * size_t.sum(), []

    def encode(chosen, multiplier):
        turns.append((list(chosen), multiplier))
        return [bytes(int(size_t[t] * (multiplier / usual) ** -power)) for t in chosen]

    streams = steer(encode, units, sample_t, usual, lambda size_t: budget - size_t.sum())
    order = [t for chosen, _ in turns for t in chosen]
    assert sorted(order) == list(range(len(units)))
    assert all(list(chosen) == sorted(chosen) for chosen, _ in turns)
    coarse = {t for t, unit in enumerate(units) if unit.level != 1}
    assert coarse <= set(turns[0][0])  # on which others hang
    assert turns[0][1] == usual
    within = 0.003 if abs(miss) < 0.1 else 1.0
    assert abs(sum(map(len, streams)) - budget) < within * budget
    assert all(usual / 1.61 < multiplier < usual * 1.61 for _, multiplier in turns)
    few = list_units(400, 500)
    streams = steer(encode, few, sample_t, usual, lambda size_t: 0.0)
    assert turns[-1] == (list(range(len(few))), usual)
    assert len(streams) == len(few)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("count", [1, 4, 10, 13])
def test_the_places_that_fill_a_budget_best(count, sign):
    change = sign * np.random.default_rng(count).integers(5, 400, count)
    # With more places than are combined, the first ones are taken in order.
    sets = [[n for n in range(count) if mask >> n & 1] for mask in range(1 << count)]
    allowed = [each for each in sets if (head := [n for n in each if n < count - 10]) == list(range(len(head)))]
    for most in (int(change.sum()) - 1, int(change.sum() // 2), 0):
        fitting = [int(change[each].sum()) for each in allowed if change[each].sum() <= most]
        wanted = max(fitting) if fitting else int(change.sum())
        assert int(change[_take(change, most)].sum()) == wanted


@pytest.mark.parametrize("change", [-0.25, -0.05, 0.05, 0.25])
def test_a_budget_is_filled_in_few_trials(change):
    """Also where all streams are to change, of which none can be left out."""
    units, usual, tried = list_units(1400, 1300), 0.15, []
    sizes = np.random.default_rng(1).integers(500, 2000, len(units))
    budget = int((1.0 + change) * sizes.sum())

    def encode(chosen, multiplier):
        tried.append(multiplier)
        return [bytes(int(sizes[t] * (multiplier / usual) ** -MULTIPLIER_POWER)) for t in chosen]

    def spare(streams):
        return budget - sum(map(len, streams))

    first = [bytes(int(size)) for size in sizes]
    assert 0 <= spare(fill(encode, units, first, usual, spare, 0.004 * budget)) <= 0.004 * budget
    assert len(tried) <= 2


def test_tiles_fit_a_budget_whatever_their_trials_said(device):
    """Noise at the top alone: three passes over the tiles missed the budget, and it was refused."""
    shape, rows, deviation, rate = (4, 2100, 700, 3), 700, 0.3, 2.0
    y, x = np.mgrid[: shape[1], : shape[2]]
    coeffs = np.empty(shape, np.float32)
    for k in range(shape[0]):
        for c in range(shape[3]):
            coeffs[k, :, :, c] = 0.3**k**0.5 * np.sin(x / (7 + k) + y / (11 + c) + k)
    noise = np.random.default_rng(2).normal(0.0, deviation, (shape[0], rows, *shape[2:]))
    coeffs[:, :rows] += noise.astype(np.float32)
    budget = int(rate * coeffs.size / 8)
    body, _ = Encoder(Pixels(ArraySource(coeffs, device)), "linear", memory=1 << 24).encode_within(budget)
    assert 0.9 * budget <= len(body) <= budget


def test_tiles_fill_a_budget_where_the_last_have_nothing_to_give(device):
    """Dark ground below: four passes left a twentieth."""
    coeffs = np.random.default_rng(2).standard_normal((4, 1540, 520, 1)).astype(np.float32)
    coeffs = gaussian_filter(coeffs, (0, 1.5, 1.5, 0))
    coeffs[:, 770:] *= 0.05
    budget = int(0.03 * coeffs.size / 8)
    body, _ = Encoder(Pixels(ArraySource(coeffs, device)), "linear", memory=1 << 22).encode_within(budget)
    assert 0.98 * budget <= len(body) <= budget


def test_streams_are_chosen_with_all_that_hang_on_them():
    units = list_units(700, 900)
    sizes = np.full(len(units), 100)
    assert _choose(units, sizes, -1e9) == [list(range(len(units)))]
    chosen = [t for place in _choose(units, sizes, 50.0) for t in place]
    assert 4 <= len(chosen) < len(units) / 2
    held = {(units[t].level, units[t].row, units[t].column) for t in chosen}
    assert {level for level, _, _ in held} == {1, 2}
    for unit in units:
        if unit.level == 1:
            parent = (2, unit.row // 128 * 64, unit.column // 128 * 64)
            assert ((1, unit.row, unit.column) in held) == (parent in held)


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_axes_are_those_of_the_pixels_themselves(scale):
    """What is found of moments, against coordinates of each pixel."""
    rng = np.random.default_rng(3)
    coeffs = (rng.standard_normal((4, 30, 20, 3)) * rng.uniform(0.1, 2.0, (4, 1, 1, 3)) * scale).astype(np.float32)
    coeffs[0] += np.float32(5 * scale)
    found = whitening_of(coeffs.shape, lambda places: np.concatenate([coeffs[:, y, x] for y, x in places], axis=1))
    pixels = coeffs.astype(np.float64).transpose(1, 2, 0, 3).reshape(600, 4, 3)
    metric = np.ldexp(hemisphere_metric(4, AXES).forward_jk, -found.exponent)
    channels = np.einsum("jk,pkc->pjc", metric, pixels).reshape(-1, 3)
    rotation = np.linalg.eigh(channels.T @ channels)[1][:, ::-1].T * ROTATION_UNIT
    rotation *= np.sign((rotation * found.rotation_cc).sum(axis=1))[:, None]
    assert np.abs(rotation - found.rotation_cc).max() <= 0.5 + 1e-6
    coordinates = pixels.reshape(600, -1) @ found.forward_dq.T
    np.testing.assert_allclose(found.mean_d, coordinates.mean(axis=0), atol=1e-12)
    along = (coordinates - coordinates.mean(axis=0)) @ found.vectors_jd.T
    np.testing.assert_allclose(found.deviation_j, along.std(axis=0), atol=1e-12)
    gram = along.T @ along / 600
    np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-12)
    assert (np.diff(found.deviation_j) <= 0).all()


@pytest.mark.parametrize(("n_pixel", "fineness"), [(4, 0), (2500, 1), (40_000, 2), (1_000_000, 3)])
def test_the_mean_is_finer_where_more_pixels_have_its_error(n_pixel, fineness):
    mean = np.random.default_rng(5).uniform(-2.0, 2.0, 75)
    found, entries = quantise_mean(mean, n_pixel, 0.05, np.eye(25))
    assert found == fineness
    np.testing.assert_array_equal(entries, np.rint(mean / 0.05 * 16 * 4**fineness))
    assert quantise_mean(2e3 * mean, n_pixel, 0.05, np.eye(25))[0] == min(fineness, 1)  # finer ones cannot be coded


@pytest.mark.parametrize(("side", "fineness"), [(2, 0), (50, 1), (200, 2)])
def test_a_finer_mean_is_read_by_the_page(device, side, fineness):
    exact = np.random.default_rng(2).uniform(0.5, 1.0, (4, 1, 1, 3))
    coeffs = np.broadcast_to(exact.astype(np.float32), (4, side, side, 3)).copy()
    body, info = Encoder(Pixels(ArraySource(coeffs, device)), "linear").encode(0.25)
    assert (info["planes"], body[10] >> 1 & 3) == (0, fineness)
    theirs = decode_klt4(body, coeffs.shape).coeffs
    np.testing.assert_allclose(Klt.decode_body(body, coeffs.shape, device), theirs, rtol=0, atol=1e-6)
    forward = hemisphere_metric(4, AXES).forward_jk
    error = np.linalg.norm(np.einsum("jk,kc->jc", forward, (theirs - coeffs)[:, 0, 0]))
    assert error < 0.25 / (16 * 4**fineness) * 12**0.5  # half a step each, the rotation rounded
