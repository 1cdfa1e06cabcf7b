import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from clrelight.errors import InputError
from clrelight.sampling import PATTERNS, farthest_point_subset, make_pattern, solid_angle_weights
from tests.reference.sampling import count_solid_angles, voronoi_solid_angles

HEMISPHERE = 2.0 * np.pi
ZENITH = np.array([[0.0, 0.0, 1.0]])


def on_cone(count, elevation):
    azimuth = 2.0 * np.pi * np.arange(count) / count
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1) * np.cos(elevation)
    return np.concatenate([flat, np.full((count, 1), np.sin(elevation))], axis=1)


def on_arc(count):
    angle = np.linspace(0.0, np.pi, count)
    return np.stack([np.cos(angle), np.zeros(count), np.sin(angle)], axis=1)


@pytest.mark.parametrize("pattern", PATTERNS)
@pytest.mark.parametrize("count", [2, 3, 4, 60, 256, 1000])
def test_pattern_has_exactly_count_distinct_unit_vectors_above_the_horizon(pattern, count):
    directions = make_pattern(pattern, count, seed=3)
    assert directions.shape == (count, 3)
    assert directions.dtype == np.float64
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, atol=1e-14)
    assert np.all(directions[:, 2] > 0)
    assert len(np.unique(directions.round(9), axis=0)) == count


def test_uniform_covers_equal_areas():
    directions = make_pattern("uniform", 512)
    # One light per band of height 1/512 (equal area), and a mean near the hemisphere's own, (0, 0, 1/2).
    np.testing.assert_array_equal(np.floor(directions[:, 2] * 512), np.arange(512)[::-1])
    np.testing.assert_allclose(directions.mean(axis=0), [0, 0, 0.5], atol=2e-3)
    weights = solid_angle_weights(directions)
    assert np.median(weights) == pytest.approx(HEMISPHERE / 512, rel=0.02)


def test_grid_is_rows_by_columns_with_equal_steps():
    directions = make_pattern("grid", 256)
    elevation = np.degrees(np.arcsin(directions[:, 2]))
    azimuth = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])) % 360
    assert len(np.unique(elevation.round(6))) == 8
    assert len(np.unique(azimuth.round(6))) == 32
    np.testing.assert_allclose(np.diff(np.unique(elevation.round(6))), 11.25, atol=1e-5)
    np.testing.assert_allclose(np.diff(np.unique(azimuth.round(6))), 11.25, atol=1e-5)


@pytest.mark.parametrize(("count", "near"), [(1, ": 2$"), (11, ": 10 and 12"), (257, ": 256 and 258")])
def test_grid_names_the_nearest_counts(count, near):
    with pytest.raises(InputError, match=near):
        make_pattern("grid", count)


def test_scattered_leaves_most_of_the_hemisphere_out_and_depends_on_the_seed():
    first, again, other = (make_pattern("scattered", 300, seed=s) for s in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert not np.allclose(first, other)
    for directions in (first, other):
        far = (make_pattern("uniform", 2000) @ directions.T).max(axis=1) < np.cos(np.radians(10))
        assert far.mean() > 0.3


@pytest.mark.parametrize(("pattern", "count", "seed"), [("spiral", 4, 0), ("uniform", 0, 0), ("scattered", 4, -1)])
def test_pattern_refuses(pattern, count, seed):
    with pytest.raises(InputError):
        make_pattern(pattern, count, seed)


@pytest.mark.parametrize("count", [16, 64, 256])
@pytest.mark.parametrize("pattern", PATTERNS)
def test_weights_agree_with_both_references(pattern, count):
    directions = make_pattern(pattern, count, seed=5)
    weights = solid_angle_weights(directions)
    assert weights.sum() == pytest.approx(HEMISPHERE, abs=1e-12)
    np.testing.assert_allclose(weights, voronoi_solid_angles(directions), atol=1e-7)
    # 3e-5 sr per counted point; a border of a few hundred points is counted to some tens of them.
    np.testing.assert_allclose(weights, count_solid_angles(directions), atol=6e-4)


SYMMETRIC = {
    "one light": (ZENITH, [HEMISPHERE]),
    "one light on the horizon": (np.array([[0.0, -1.0, 0.0]]), [HEMISPHERE]),
    "two opposite": (on_cone(2, 0.7), [np.pi] * 2),
    "three": (on_cone(3, 0.2), [HEMISPHERE / 3] * 3),
    "ring on the horizon": (on_cone(5, 0.0), [HEMISPHERE / 5] * 5),
    "ring just above": (on_cone(7, 1e-9), [HEMISPHERE / 7] * 7),
    "five equal": (np.repeat(ZENITH, 5, axis=0), [HEMISPHERE / 5] * 5),
    "duplicate of one": (on_cone(3, 0.3)[[0, 1, 2, 2]], HEMISPHERE / np.array([3, 3, 6, 6])),
    "arc": (on_arc(9), np.array([np.pi / 8, *[np.pi / 4] * 7, np.pi / 8])),
}


@pytest.mark.parametrize("case", SYMMETRIC)
def test_weights_of_symmetric_sets_are_known(case):
    directions, expected = SYMMETRIC[case]
    np.testing.assert_allclose(solid_angle_weights(directions), expected, atol=1e-7)


def test_pole_cell_of_a_full_ring_tends_to_a_cap():
    weights = solid_angle_weights(np.concatenate([ZENITH, on_cone(1000, np.pi / 6)]))
    assert weights[0] == pytest.approx(HEMISPHERE * (1 - np.cos(np.pi / 6)), rel=1e-5)
    np.testing.assert_allclose(weights[1:], weights[1], rtol=1e-5)


@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-8, 1e-6, 1e-4])
def test_nearly_equal_nearly_horizontal_and_collinear_lights(offset):
    directions = np.concatenate([on_arc(5), on_arc(5) + np.array([0.0, offset, offset]), on_cone(4, offset)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    weights = solid_angle_weights(directions)
    assert np.all(np.isfinite(weights) & (weights >= 0))
    assert weights.sum() == pytest.approx(HEMISPHERE, abs=1e-9)
    if offset > 1e-9:
        return
    # Lights that are equal up to rounding share.
    np.testing.assert_allclose(weights[:5], weights[5:10], atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(*[st.integers(-3, 3)] * 2, st.integers(0, 3)), min_size=1, max_size=25))
def test_weights_of_lattice_sets_match_counting(points):
    # Lattice directions give coplanar, cocircular, horizontal and equal lights in all combinations.
    directions = np.array([p for p in points if any(p)] or [(0, 0, 1)], dtype=np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    weights = solid_angle_weights(directions)
    assert weights.sum() == pytest.approx(HEMISPHERE, abs=1e-9)
    _, first, owner, share = np.unique(
        directions.round(9) + 0.0, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    counted = count_solid_angles(directions[first], n_point=20_000)
    np.testing.assert_allclose(weights, (counted / share)[owner.reshape(-1)], atol=0.02)


def test_whole_sphere():
    corners = np.array([[x, y, z] for x in (1, -1) for y in (1, -1) for z in (1, -1)]) / np.sqrt(3)
    np.testing.assert_allclose(solid_angle_weights(corners, sphere=True), np.pi / 2, atol=1e-9)
    np.testing.assert_allclose(solid_angle_weights(ZENITH, sphere=True), 4 * np.pi, atol=1e-12)
    directions = make_pattern("uniform", 20) * np.where(np.arange(20) % 2, 1.0, -1.0)[:, None]
    np.testing.assert_allclose(
        solid_angle_weights(directions, sphere=True), count_solid_angles(directions, sphere=True), atol=1e-3
    )


def test_weights_refuse_lights_below_the_horizon():
    with pytest.raises(InputError, match=r"light 1 is below the horizon \(z = -1\)"):
        solid_angle_weights(np.concatenate([ZENITH, -ZENITH]))


@pytest.mark.parametrize("directions", [np.empty((0, 3)), np.ones((2, 3)), np.full((1, 3), np.nan)])
def test_weights_refuse_what_is_no_set_of_directions(directions):
    with pytest.raises(InputError):
        solid_angle_weights(directions)


def test_many_lights():
    weights = solid_angle_weights(make_pattern("uniform", 4096))
    assert weights.sum() == pytest.approx(HEMISPHERE, abs=1e-11)
    assert weights.min() > 0.4 * HEMISPHERE / 4096


def test_farthest_points_are_spread_and_every_prefix_is_the_same_choice():
    directions = make_pattern("uniform", 300)
    chosen = farthest_point_subset(directions, 40)
    assert len(set(chosen.tolist())) == 40
    np.testing.assert_array_equal(farthest_point_subset(directions, 10), chosen[:10])
    assert chosen[0] == 0
    # Greedy choice: no light left out is farther from the chosen than the last one chosen was.
    cosine = directions @ directions[chosen].T
    assert cosine.max(axis=1).min() >= (cosine[chosen[39], :39]).max() - 1e-12


def test_farthest_points_take_duplicates_last_and_can_take_all():
    directions = np.repeat(on_cone(3, 0.5), 2, axis=0)
    chosen = farthest_point_subset(directions, 6)
    assert sorted(chosen.tolist()) == list(range(6))
    assert sorted(chosen[:3] // 2) == [0, 1, 2]
    for count in (0, 7):
        with pytest.raises(InputError, match="1 to 6"):
            farthest_point_subset(directions, count)
