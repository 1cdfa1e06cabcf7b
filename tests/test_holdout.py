"""Lights that no fit sees, against distances and groups by brute force."""

from dataclasses import replace

import numpy as np
import pytest

from clrelight import holdout
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.holdout import (
    HoldoutRule,
    describe_duplicates,
    distances_to,
    group_directions,
    split_by_fit,
    split_chosen,
    typical_gap,
)
from clrelight.jobs.fit import fit
from clrelight.jobs.measure import measure
from clrelight.jobs.report import Report
from clrelight.light_codes import kept_directions
from clrelight.sampling import make_pattern
from clrelight.store import write_stack
from tests.commands import call


def angles_between(a_i3, b_j3):
    return np.degrees(np.arccos(np.clip(a_i3 @ b_j3.T, -1.0, 1.0)))


def rings(elevations, count):
    z, azimuth = (
        np.sin(np.radians(np.repeat(elevations, count))),
        np.tile(np.arange(count) * 2 * np.pi / count, len(elevations)),
    )
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


def stack_of(directions, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    normals = rng.standard_normal((3, 60))
    normals /= np.linalg.norm(normals, axis=0)
    values = 0.7 * np.maximum(directions @ normals, 0.0) + 0.1 + noise * rng.standard_normal((len(directions), 60))
    return LightStack(values.astype(np.float32).reshape(-1, 4, 5, 3), directions, 1.0)


def jitter(directions, degrees, seed=0):
    moved = directions + np.radians(degrees) * np.random.default_rng(seed).uniform(-1, 1, directions.shape) / 3**0.5
    return moved / np.linalg.norm(moved, axis=1, keepdims=True)


def test_directions_are_counted_as_they_appear():
    sites = make_pattern("uniform", 20)
    order = np.random.default_rng(1).integers(0, 20, 90)
    group_i = group_directions(jitter(sites[order], 0.02))
    seen = list(dict.fromkeys(order))
    np.testing.assert_array_equal(group_i, [seen.index(site) for site in order])
    np.testing.assert_array_equal(group_directions(sites), np.arange(20))


@pytest.mark.parametrize("every", [2, 3, 5])
def test_photographs_of_one_direction_stay_together(every):
    sites = make_pattern("uniform", 20)
    order = np.random.default_rng(1).permutation(np.repeat(np.arange(20), 6))
    directions = jitter(sites[order], 0.02)
    for by in ("index", "place"):
        fitted, held = split_chosen(directions, every, by=by)
        assert len(held)
        assert not set(order[fitted]) & set(order[held])
        assert angles_between(directions[held], directions[fitted]).min() > 5.0
    fitted, held = split_chosen(directions, every)
    assert sorted([*fitted, *held]) == list(range(120))


def test_without_duplicates_every_kth_light_is_held_out():
    fitted, held = split_chosen(make_pattern("scattered", 23, seed=2), 4)
    np.testing.assert_array_equal(held, [3, 7, 11, 15, 19])
    assert len(fitted) == 18


@pytest.mark.parametrize(
    "directions",
    [
        make_pattern("uniform", 9),
        make_pattern("uniform", 240),
        make_pattern("grid", 100),
        make_pattern("scattered", 80),
        rings([5, 25, 45, 65, 85], 24),
        rings([10, 40, 80], 60),
    ],
    ids=["9", "240", "grid", "scattered", "rings", "dense rings"],
)
def test_by_place_all_held_out_lights_are_a_gap_away(directions):
    fitted, held = split_chosen(directions, 5, by="place")
    assert len(fitted) >= 0.5 * len(directions)
    assert len(held) >= 1
    assert not set(fitted) & set(held)
    gap = np.degrees(typical_gap(directions))
    assert angles_between(directions[held], directions[fitted]).min(axis=1).min() >= gap * (1 - 1e-6)


def test_where_lights_are_even_both_ways_are_one():
    directions = make_pattern("uniform", 128)
    for by_index, by_place in zip(*(split_chosen(directions, 5, by=by) for by in ("index", "place")), strict=True):
        np.testing.assert_array_equal(by_index, by_place)


@pytest.mark.parametrize("few", [0, 1 << 22])
def test_distances_are_those_to_the_nearest_fitted_light(monkeypatch, few):
    monkeypatch.setattr(holdout, "_FEW_PAIRS", few)
    rng = np.random.default_rng(3)
    fitted_j3, held_i3 = (each / np.linalg.norm(each, axis=1, keepdims=True) for each in rng.normal(size=(2, 40, 3)))
    held_i3[7] = fitted_j3[5]
    found_i = distances_to(fitted_j3, held_i3)
    np.testing.assert_allclose(found_i, angles_between(held_i3, fitted_j3).min(axis=1), atol=2e-6)
    assert found_i[7] == 0.0


def test_the_gap_of_dense_rings_is_half_their_distance():
    directions = rings([20, 40, 60], 90)
    assert 9.5 < np.degrees(typical_gap(directions)) < 12.0
    # Of these every fifth leaves neighbours 4 degrees away on its ring or nearer; by place, none within the gap.
    by_index, by_place = (split_chosen(directions, 5, by=by) for by in ("index", "place"))
    assert np.median(angles_between(directions[by_index[1]], directions[by_index[0]]).min(axis=1)) < 4.0
    assert angles_between(directions[by_place[1]], directions[by_place[0]]).min() > 9.5


@pytest.mark.parametrize(
    "directions",
    [rings([30], 12), make_pattern("uniform", 2), make_pattern("uniform", 3), -make_pattern("uniform", 30)],
)
def test_a_gap_of_any_lights(directions):
    assert 1.0 < np.degrees(typical_gap(directions)) < 180.0


def test_a_fit_and_psnr_print_the_same_figures(tmp_path, device):
    # Duplicates, and fewer lights than are left: what is measured follows the fit's record.
    sites = make_pattern("uniform", 30)
    stack = stack_of(jitter(np.repeat(sites, 2, axis=0), 0.02), noise=0.02)
    for number, options in enumerate(
        [{"holdout": 5}, {"holdout": 5, "holdout_by": "place"}, {"holdout": 4, "lights": 20}, {"lights": 17}, {}]
    ):
        path = tmp_path / f"{number}.h5"
        told = fit(stack, "cls", 3, out=path, device=device, report=Report(), **options).psnr
        again = measure(path, stack, device=device, report=Report())
        assert again == told
        assert ("mean_holdout" in told) == ("holdout" in options)


@pytest.mark.parametrize(
    "rule", [HoldoutRule(5), HoldoutRule(5, by="place"), HoldoutRule(4, 20), HoldoutRule(lights=9)]
)
def test_lights_of_an_encoding_are_those_of_its_fit(device, rule):
    """It holds directions rounded; what is neither fitted nor held out is not measured at either."""
    stack = stack_of(make_pattern("uniform", 60))
    fitted = fit(stack, "cls", 1, device=device, report=Report())
    seen, held = rule.split(stack.directions_i3)
    kept_i3 = kept_directions(stack.directions_i3[seen])
    assert np.abs(kept_i3 - stack.directions_i3[seen]).max() > 1e-5
    found = split_by_fit(stack, replace(fitted, directions_i3=kept_i3, config=rule.to_config()))
    for lights, expected in zip(found, (seen, held), strict=True):
        np.testing.assert_array_equal(lights, expected)


def test_of_another_stack_lights_near_fitted_ones_count_as_fitted(device):
    stack = stack_of(make_pattern("uniform", 20))
    fitted = fit(stack, "cls", 2, holdout=5, device=device, report=Report())
    other = stack_of(np.concatenate([jitter(fitted.directions_i3[:3], 0.02), rings([33], 7)]))
    seen, unseen = split_by_fit(other, fitted)
    np.testing.assert_array_equal(seen, [0, 1, 2])
    assert len(unseen) == 7


def test_records_that_are_not_understood_are_passed_over():
    for kept in (3, None, {"every": "x"}, {"every": True}, {"every": 5, "by": "moon"}, {"every": -1}):
        assert HoldoutRule.from_config({"holdout": kept}) is None
    rule = HoldoutRule(5, 12, "place")
    assert HoldoutRule.from_config(rule.to_config()) == rule
    assert HoldoutRule().to_config() == {}


def test_noise_of_duplicates_is_found():
    noise = 0.01
    directions = np.repeat(make_pattern("uniform", 30), 6, axis=0)
    facts, note = describe_duplicates(stack_of(directions, noise))
    assert facts["photographs"] == 180
    assert facts["directions"] == 30
    assert abs(facts["noise_db"] + 20 * np.log10(noise)) < 0.3
    assert note.startswith("180 of 180 photographs share their light's direction with others")
    assert describe_duplicates(stack_of(make_pattern("uniform", 30))) is None
    assert describe_duplicates(stack_of(directions))[0]["noise_db"] == np.inf
    codes = np.arange(1, 256, dtype=np.uint8).reshape(1, 5, 51, 1)  # a 255th of which float64 rounds, and their means
    equal = LightStack(np.repeat(codes, 12, axis=0), np.repeat(make_pattern("uniform", 1), 12, axis=0), 255.0)
    facts, note = describe_duplicates(equal)
    assert facts["noise_db"] == np.inf
    assert "and do not differ: they are" in note


def test_the_commands_print_the_distance(tmp_path):
    stack = stack_of(np.repeat(rings([20, 50, 80], 16), 2, axis=0), noise=0.01)
    path, out = tmp_path / "stack.h5", tmp_path / "fit.h5"
    write_stack(path, stack)
    ended = call("fit", path, out, "--degree", 3, "--holdout", 5, "--holdout-by", "place")
    assert ended.code == 0
    assert "° from the nearest fitted light (median)" in ended.out
    assert ended.err.count("photographs share their light's direction") == 1
    told = call("fit", path, out, "--degree", 3, "--holdout", 5, "--json").json
    assert told["duplicates"]["photographs"] == 96
    assert 0.0 < told["psnr"]["distance_median_holdout"] <= told["psnr"]["distance_largest_holdout"] < 60.0
    assert any("--holdout-by place measures there" in note for note in told["notes"])
    assert told["config"]["holdout"] == {"every": 5, "lights": None, "by": "index"}
    assert call("psnr", out, path, "--json").json["psnr"] == told["psnr"]
    ended = call("bench", path, "--out", tmp_path / "r.h5", "--holdout", 5, "--holdout-by", "place", "--methods", "cls",
                 "--degrees", 2, "--codecs", "none", "--json")  # fmt: skip
    assert any("degrees from the nearest of" in note for note in ended.json["notes"])
    assert b"place" in bytes(str(ended.json["rows"][0]["fit_config"]), "utf-8")


@pytest.mark.parametrize(
    ("directions", "options", "message"),
    [
        (np.repeat(make_pattern("uniform", 3), 4, axis=0), {"holdout": 5}, "holdout 5 keeps none of 3 directions out"),
        (make_pattern("uniform", 4), {"holdout": 5}, "holdout 5 keeps no light out of 4; use at most 4"),
        (make_pattern("uniform", 9), {"holdout": 3, "by": "time"}, "held out by index or place, got 'time'"),
        (make_pattern("uniform", 9), {"holdout": 1}, "holdout must be at least 2"),
        (make_pattern("uniform", 9), {"holdout": None, "by": "place"}, "holding out by place needs holdout"),
    ],
)
def test_refusals(directions, options, message):
    with pytest.raises(InputError, match=message):
        split_chosen(directions, **options)


def test_blocks_that_leave_nothing_are_refused(monkeypatch):
    monkeypatch.setattr(holdout, "typical_gap", lambda directions: np.pi)
    with pytest.raises(InputError, match="leaves none of 9 directions to fit: within 180"):
        split_chosen(make_pattern("uniform", 9), 3, by="place")
