"""Axes that are turned until few planes hold what there is at a place: against a search of all angles in float64."""

import numpy as np
import pytest

from clrelight.codec import decode, encode
from clrelight.codec.formats import klt_search
from clrelight.codec.formats.klt import Klt
from clrelight.codec.transforms.local_axes import cut_cells, guess_step, turn_axes
from clrelight.codec.transforms.principal import round_jointly
from clrelight.codec.transforms.whitening import whitening_of

STEP = 0.03


def spread(angle):
    return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def sparse_cells(rng, n_plane, n_cell=900):
    """Return cells, (n_plane, 4, n_cell), in each of which one plane is loud."""
    cells = rng.normal(0.0, 0.2 * STEP, (n_plane, 4, n_cell))
    cells[rng.integers(0, n_plane, n_cell), :, np.arange(n_cell)] += rng.normal(0.0, 9 * STEP, (n_cell, 4))
    return cells


def log_sum(cells):
    return np.log(np.mean((cells / STEP) ** 2, axis=1) + 0.2).sum()


@pytest.mark.parametrize("angle", [0.1, 0.7, 1.3])
def test_the_best_of_all_angles_is_found(angle):
    cells = np.einsum("ij,jsc->isc", spread(angle), sparse_cells(np.random.default_rng(3), 2))
    turn = turn_axes(cells.astype(np.float32), STEP)
    least = min(log_sum(np.einsum("ij,jsc->isc", spread(each), cells)) for each in np.linspace(0.0, np.pi, 721))
    gain = log_sum(cells) - least
    assert log_sum(np.einsum("ij,jsc->isc", turn, cells)) < least + 0.02 * gain
    assert gain > 0.05 * abs(least)


def test_what_was_mixed_is_told_apart():
    rng = np.random.default_rng(5)
    mixed = np.linalg.qr(rng.standard_normal((7, 7)))[0]
    cells = np.einsum("ij,jsc->isc", mixed, sparse_cells(rng, 7))
    turn = turn_axes(cells.astype(np.float32), STEP)
    np.testing.assert_allclose(turn @ turn.T, np.eye(7), atol=1e-12)
    apart = np.abs(turn @ mixed)
    np.testing.assert_allclose(np.sort(apart, axis=1)[:, -1], 1.0, atol=0.02)
    assert sorted(apart.argmax(axis=1)) == list(range(7))


def test_axes_stay_where_nothing_is_to_be_gained():
    cells = sparse_cells(np.random.default_rng(1), 3, 40).astype(np.float32)
    for still in (cells[:0], cells[:1], np.zeros_like(cells), 1e-4 * cells, np.full_like(cells, 1e30), cells[..., :0]):
        np.testing.assert_array_equal(turn_axes(still, STEP), np.eye(len(still)))


def test_a_value_beyond_float32_is_not_looked_at():
    rng = np.random.default_rng(2)
    cells = np.einsum("ij,jsc->isc", spread(0.4), sparse_cells(rng, 2)).astype(np.float32)
    usual = turn_axes(cells, STEP)
    cells[0, 1, 450] = 3e38
    np.testing.assert_allclose(turn_axes(cells, STEP), usual, atol=0.01)


@pytest.mark.parametrize(("height", "width"), [(32, 64), (37, 50), (1, 9), (5, 5)])
def test_cells_are_squares_of_subbands(height, width):
    planes = np.random.default_rng(4).standard_normal((2, 3, height, width)).astype(np.float32)
    found, low_h, low_w = [], height, width
    for _ in range(5):
        half_h, half_w = (low_h + 1) // 2, (low_w + 1) // 2
        found += [(0, half_h, half_w, low_w), (half_h, low_h, 0, half_w), (half_h, low_h, half_w, low_w)]
        low_h, low_w = half_h, half_w
    wanted = []
    for top, bottom, left, right in [*found, (0, low_h, 0, low_w)]:
        for y in range(top, bottom, 2):
            for x in range(left, right, 2):
                part = planes[..., y : min(y + 2, bottom), x : min(x + 2, right)].astype(np.float64)
                wanted += (part**2).sum(axis=(2, 3)).T.tolist()
    cells = cut_cells(planes, 5).astype(np.float64)
    assert cells.shape[:2] == (2, 4)
    np.testing.assert_allclose(sorted((cells**2).sum(axis=1).T.tolist()), sorted(wanted), rtol=1e-6)


def test_a_step_is_guessed_by_what_cells_hold():
    cells = sparse_cells(np.random.default_rng(6), 5)
    energy = np.mean(cells**2, axis=1)
    for bits in (3e4, 3e5):
        place = guess_step(cells.astype(np.float32), 16.0, bits, (-22.0, 3.0))
        taken = [16.0 * 2.0 * np.log2(1.0 + energy / (0.14 * 4.0**at)).sum() for at in (place, place - 0.01)]
        assert taken[0] <= bits < taken[1]


def two_places(rng):
    """Return a map whose left and right halves differ along axes that are no right angle apart."""
    rough = rng.standard_normal((2, 96, 96)) * (rng.random((2, 96, 96)) < 0.2)
    ways = np.array([[1.0, 0.2, 0.5], [0.8, 0.9, -0.3]])
    image = np.concatenate([rough[0, :, :48, None] * ways[0], rough[1, :, 48:, None] * ways[1]], axis=1)
    return np.concatenate([image[None], 0.1 * image[None], np.zeros((2, 96, 96, 3))]).astype(np.float32)


def test_turned_axes_cost_errors_what_they_did(device):
    rng = np.random.default_rng(8)
    coeffs = two_places(rng)
    before = whitening_of(
        coeffs.shape, lambda places: np.stack([coeffs[:, y, x] for y, x in places], 1).reshape(4, -1, 3)
    )
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    after = before.turned(turn)
    np.testing.assert_allclose(after.cost_j(after.vectors_jd), 1.0, rtol=1e-9)
    np.testing.assert_allclose(after.vectors_jd[3:], before.vectors_jd[3:])
    between = after.vectors_jd[:3] @ np.linalg.pinv(before.vectors_jd[:3])
    np.testing.assert_allclose(between @ between.T, np.eye(3), atol=1e-9)
    assert (np.diff(after.deviation_j) <= 1e-12).all()
    np.testing.assert_allclose((after.deviation_j**2).sum(), (before.deviation_j**2).sum(), rtol=1e-9)
    planes = [w.exact(3)[0] @ coeffs.transpose(0, 3, 1, 2).reshape(12, -1) for w in (before, after)]
    np.testing.assert_allclose(planes[1], between @ planes[0], atol=1e-6)


def test_turned_axes_take_fewer_bytes(device, monkeypatch):
    """At the same step, and no larger an error."""
    coeffs = two_places(np.random.default_rng(9))

    def code():
        encoded = encode(coeffs, Klt(step=0.02), device)
        return encoded.encoded_bytes, float(np.mean((decode(encoded, device) - coeffs) ** 2))

    size, error = code()
    monkeypatch.setattr(klt_search, "turn_axes", lambda cells, step: np.eye(len(cells)))
    plain_size, plain_error = code()
    assert size < 0.95 * plain_size
    assert error < 1.05 * plain_error


def test_numbers_are_rounded_together():
    """Where errors of components are worth much in one direction, none costs more than those of each alone, by far."""
    rng = np.random.default_rng(10)
    root = np.linalg.qr(rng.standard_normal((12, 12)) * np.geomspace(1.0, 100.0, 12)[:, None])[1]
    root *= np.sign(np.diag(root))[:, None]
    wanted = 40.0 * rng.standard_normal((50, 2 * 12))
    found = round_jointly(wanted, root)

    def cost(numbers):
        return np.square((numbers - wanted).reshape(-1, 12) @ root.T).sum()

    assert found.dtype == np.int64
    assert cost(found) < 0.5 * cost(np.rint(wanted))
    # Babai: in the rows of the root no error is above half of the diagonal.
    assert (np.abs((found - wanted).reshape(-1, 12) @ root.T) <= np.diag(root) * 0.5 * (1 + 1e-9)).all()
    np.testing.assert_array_equal(round_jointly(wanted, 3.0 * np.eye(12)), np.rint(wanted))
