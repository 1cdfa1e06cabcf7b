"""Who is in a photograph under light that may be any, and what subspaces hold of pictures."""

import csv

import numpy as np
import pytest

import clrelight as cr
from clrelight.images import read_image, write_image
from clrelight.sampling import make_pattern
from clrelight.threads import on_one_thread
from clrelight.variation.comparing import Products, compare_spaces, lee_directions
from clrelight.variation.recognition import Space, spaces_of_normals, spaces_of_photographs
from datasets_synth.heads import make_head, photograph_head, shade_head
from tests.commands import call, contents, succeed
from tests.meshes import icosphere
from tests.reference.basis import real_harmonics

SUBJECTS, SIDE = 20, 26


@pytest.fixture(scope="module")
def heads():
    return [make_head(seed, SIDE) for seed in range(SUBJECTS)]


def environment(rng, directions_i3):
    """Return radiance of a few soft lamps and a room, in colour."""
    radiance_ic = np.full((len(directions_i3), 3), rng.uniform(0.02, 0.3))
    for _ in range(rng.integers(1, 4)):
        towards_3 = rng.standard_normal(3)
        towards_3[2] = abs(towards_3[2])
        cosine_i = directions_i3 @ (towards_3 / np.linalg.norm(towards_3))
        radiance_ic += rng.uniform(0.5, 1.0, 3) * np.exp(rng.uniform(5, 40) * (cosine_i[:, None] - 1.0))
    return radiance_ic


def test_heads_differ_and_shade_themselves(heads):
    first, second = heads[0], heads[1]
    assert first.mask_hw.any()
    assert np.abs(first.normals_hw3 - second.normals_hw3).max() > 0.1
    np.testing.assert_array_equal(make_head(0, SIDE).albedo_hwc, first.albedo_hwc)
    directions_i3 = make_pattern("uniform", 30, sphere=True)
    open_ip = shade_head(first, directions_i3, cast=False)
    expected_ip = np.maximum(directions_i3 @ first.normals_hw3[first.mask_hw].T, 0)
    np.testing.assert_allclose(open_ip, expected_ip, atol=1e-6)
    cast_ip = shade_head(first, directions_i3)
    assert np.all((cast_ip == 0) | (cast_ip == open_ip))
    assert 0.01 < np.mean((cast_ip == 0) & (open_ip > 0)) < 0.2


@pytest.fixture(autouse=True)
def alone():
    """Small products gain nothing from threads, and lose where tests run beside others."""
    with on_one_thread():
        yield


def test_nine_dimensions_know_who_it_is(heads):
    rng, directions_i3 = np.random.default_rng(0), make_pattern("uniform", 100, sphere=True)
    share_hw = np.stack([head.mask_hw for head in heads]).all(axis=0)
    gallery = [
        spaces_of_normals(head.normals_hw3[share_hw], head.albedo_hwc[share_hw], ("3d", "4d", "9d")) for head in heads
    ]
    right = dict.fromkeys(("3d", "4d", "9d"), 0)
    for who, head in enumerate(heads):
        shade_ip = shade_head(head, directions_i3)
        for _ in range(2):
            picture_hwc = photograph_head(head, shade_ip, environment(rng, directions_i3))
            picture_hwc /= picture_hwc.max()
            seen_pc = picture_hwc[share_hw] + 0.01 * rng.standard_normal((int(share_hw.sum()), 3))
            for name in right:
                right[name] += int(np.argmin([each[name].distance(seen_pc) for each in gallery])) == who
    total = 2 * len(heads)
    assert right["9d"] >= 0.95 * total
    assert right["9d"] >= right["3d"]


def test_distances_are_those_of_least_squares():
    rng = np.random.default_rng(1)
    normals_p3 = rng.standard_normal((60, 3))
    normals_p3 /= np.linalg.norm(normals_p3, axis=1, keepdims=True)
    albedo_pc = rng.uniform(0.2, 1, (60, 3))
    picture_pc = rng.random((60, 3))
    spaces = spaces_of_normals(normals_p3, albedo_pc)
    basis_pk = real_harmonics(normals_p3, 2)
    for name, part in (("3d", slice(1, 4)), ("4d", slice(0, 4)), ("9d", slice(0, 9))):
        left = 0.0
        for channel in range(3):
            columns = basis_pk[:, part] * albedo_pc[:, channel : channel + 1]
            best = np.linalg.lstsq(columns, picture_pc[:, channel], rcond=None)[0]
            left += np.sum((columns @ best - picture_pc[:, channel]) ** 2)
        assert spaces[name].distance(picture_pc) == pytest.approx(np.sqrt(left / np.sum(picture_pc**2)), abs=1e-9)
    within_pc = albedo_pc * (basis_pk @ rng.standard_normal((9, 3)))
    assert spaces["9d"].distance(within_pc) < 1e-7
    assert spaces["9d"].distance(np.zeros((60, 3))) == 1.0
    with pytest.raises(cr.InputError, match="2 channels"):
        spaces["9d"].distance(picture_pc[:, :2])


def test_a_cone_takes_no_negative_lamps():
    rays_kpc = np.array([[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]])[:, :, None]
    cone = Space.cone(rays_kpc)
    assert cone.distance(np.array([[3.0], [1.0], [0.0]])) < 1e-7
    # (0, 1, 0) is a difference of rays; nearest in the cone is (1/2, 1/2, 0).
    assert cone.distance(np.array([[0.0], [1.0], [0.0]])) == pytest.approx(np.sqrt(0.5))
    assert Space.spanned(rays_kpc).distance(np.array([[0.0], [1.0], [0.0]])) < 1e-7


def test_photographs_span_what_normals_do():
    rng, directions_i3 = np.random.default_rng(2), make_pattern("uniform", 40, sphere=True)
    pictures_kp = rng.random((9, 50))
    samples_ipc = (real_harmonics(directions_i3, 2) @ pictures_kp)[:, :, None]
    seen_pc = (rng.standard_normal(9) @ pictures_kp)[:, None]
    for known in (directions_i3, None):
        assert spaces_of_photographs(samples_ipc, known)["9d"].distance(seen_pc) < 1e-6
    few = spaces_of_photographs(samples_ipc[:3], None)
    assert few["9d"].distance(samples_ipc[1]) < 1e-7
    assert few["cone"].distance(samples_ipc[1]) < 1e-6


def write_subject(folder, head):
    folder.mkdir(parents=True)
    write_image(folder / "normals.exr", head.normals_hw3.astype(np.float32))
    write_image(folder / "albedo.exr", head.albedo_hwc.astype(np.float32))


def test_command_over_a_gallery(tmp_path, heads):
    directions_i3, rng = make_pattern("uniform", 60), np.random.default_rng(5)
    for name, head in zip(("anna", "ben"), heads[:2], strict=True):
        write_subject(tmp_path / "people" / name, head)
    shade = [shade_head(head, directions_i3) for head in heads[:5]]
    lit = np.stack([photograph_head(heads[2], shade[2][i : i + 1], np.ones((1, 3))) for i in range(60)])
    cr.write_stack(tmp_path / "people" / "carl.h5", cr.LightStack(lit, directions_i3, 1.0))
    (tmp_path / "people" / "dora").mkdir()
    for i in range(0, 60, 6):
        picture_hwc = photograph_head(heads[3], shade[3][i : i + 1], np.ones((1, 3)))
        write_image(tmp_path / "people" / "dora" / f"{i:02d}.exr", picture_hwc)
    photographs = []
    for who in range(4):
        photographs.append(tmp_path / f"{who}.exr")
        radiance_ic = np.tile(rng.random((60, 1)), (1, 3))
        write_image(photographs[-1], photograph_head(heads[who], shade[who], radiance_ic))
    table = tmp_path / "t.csv"
    (tmp_path / "people" / "empty").mkdir()
    words = ("variation", "recognise", tmp_path / "people", *photographs)
    told = succeed(*words, "--csv", table, "--spaces", "9d,cone", "--json").json
    assert "empty holds no pictures: left out" in told["notes"]
    (tmp_path / "people" / "empty").rmdir()
    assert [each["kind"] for each in told["subjects"]] == ["normals", "normals", "stack", "photographs"]
    best = {(each["photograph"], each["space"]): each["subject"] for each in told["photographs"]}
    for photograph, name in zip(photographs, ("anna", "ben", "carl", "dora"), strict=True):
        assert best[str(photograph), "9d"] == name
    rows = list(csv.DictReader(table.open()))
    assert len(rows) == 4 * 2 * 4
    assert float(rows[0]["distance"]) <= float(rows[1]["distance"])
    assert float(rows[0]["margin"]) == pytest.approx(float(rows[1]["distance"]) - float(rows[0]["distance"]))
    assert "carl" in succeed(*words, "--pixels", "all").out
    before = contents(tmp_path)
    write_image(tmp_path / "small.exr", np.ones((5, 5, 3), np.float32))
    write_image(tmp_path / "black.exr", np.zeros_like(read_image(photographs[0])))
    (tmp_path / "bare" / "nobody").mkdir(parents=True)
    before = contents(tmp_path)
    for others, message in (
        ([tmp_path / "people", tmp_path / "small.exr"], "is 5×5, unlike"),
        ([tmp_path / "people", tmp_path / "black.exr"], "is black where the subjects are"),
        ([tmp_path / "none", photographs[0]], "there is no folder"),
        ([tmp_path / "people" / "anna", photographs[0]], "expected two or more"),
        ([tmp_path / "people", photographs[0], "--spaces", "7d"], "spaces are 3d"),
        ([tmp_path / "bare", photographs[0]], "0 subjects, and 1 folders without pictures"),
    ):
        ended = call("variation", "recognise", *others)
        assert (ended.code, ended.out) == (2, "")
        assert message in ended.err
        assert contents(tmp_path) == before


def test_head_is_a_scene(tmp_path):
    succeed("synth", "head", tmp_path / "h.h5", "--size", 16, "--lights", 12, "--seed", 3)
    with cr.open_stack(tmp_path / "h.h5") as stack:
        assert (stack.n_light, stack.image_shape, stack.name) == (12, (16, 16, 3), "head")
        assert 0 < np.count_nonzero(stack.mask_hw) < 256
        assert np.asarray(stack.images_ihwc[...]).std() > 10


def test_subspaces_side_by_side_of_a_sphere():
    report = cr.Report()
    cr.compare_subspaces(icosphere(4), report=report)
    held = {each["name"]: each for each in report.facts["spaces"]}
    energy = {name: each["energy"] for name, each in held.items()}
    assert energy["3D, scaled normals"] < energy["4D, and albedo"] < energy["9D, harmonics of the normals"]
    assert energy["9D, harmonics of the normals"] > 0.99
    assert energy["9D, principal components"] >= energy["9D, harmonics of the normals"] - 2e-4
    assert 0.96 < energy["nine lights, fixed"] <= energy["9D, principal components"]
    assert 0.96 < energy["nine lights, greedy"] <= energy["9D, principal components"]
    assert energy["cone"] > 0.998
    # Of a sphere in view the analytic components hold .922 and .969 of what pictures differ by.
    assert held["mean and 3 components"]["variance"] == pytest.approx(0.922, abs=0.015)
    assert held["mean and 5 components"]["variance"] == pytest.approx(0.969, abs=0.015)
    assert len(set(held["nine lights, greedy"]["lights"])) == 9
    np.testing.assert_allclose(held["nine lights, fixed"]["directions"], lee_directions(), atol=1e-12)


def test_subspaces_follow_from_products():
    rng = np.random.default_rng(3)
    directions_i3 = make_pattern("uniform", 20, sphere=True)
    rows_vp = np.concatenate([rng.random((20, 80)), rng.standard_normal((9, 80))])
    tested = np.arange(4, 20, 5)
    made_of = np.setdiff1d(np.arange(20), tested)
    found = {each.name: each for each in compare_spaces(Products(rows_vp @ rows_vp.T, directions_i3, made_of, tested))}
    pictures_tp, mean_p = rows_vp[tested], rows_vp[made_of].mean(axis=0)
    around = np.sum((pictures_tp - mean_p) ** 2)

    def left(columns_kp):
        best = np.linalg.lstsq(columns_kp.T, pictures_tp.T, rcond=None)[0]
        return np.sum((columns_kp.T @ best - pictures_tp.T) ** 2)

    centred_ip = rows_vp[made_of] - mean_p
    components_rp = np.linalg.svd(centred_ip, full_matrices=False)[2][:3]
    for name, columns_kp in (
        ("3D, scaled normals", rows_vp[21:24]),
        ("9D, harmonics of the normals", rows_vp[20:29]),
        ("mean and 3 components", np.concatenate([mean_p[None], components_rp])),
        ("nine lights, greedy", rows_vp[list(found["nine lights, greedy"].lights)]),
    ):
        assert found[name].energy == pytest.approx(1 - left(columns_kp) / np.sum(pictures_tp**2), abs=1e-8)
        assert found[name].variance == pytest.approx(1 - left(columns_kp) / around, abs=1e-8)
    with pytest.raises(cr.InputError, match="at least 10 pictures"):
        compare_spaces(Products(rows_vp @ rows_vp.T, directions_i3, made_of[:5], tested))


def test_subspaces_of_photographs(tmp_path, heads):
    directions_i3 = make_pattern("uniform", 50)
    shade_ip = shade_head(heads[0], directions_i3)
    lit = np.stack([photograph_head(heads[0], shade_ip[i : i + 1], np.ones((1, 3))) for i in range(50)])
    stack = cr.LightStack(lit, directions_i3, 1.0, mask_hw=heads[0].mask_hw)
    cr.write_stack(tmp_path / "s.h5", stack)
    told = succeed("variation", "subspaces", tmp_path / "s.h5", "--memory", "400k", "--json").json
    assert (told["kind"], told["made_of"], told["tested"]) == ("stack", 40, 10)
    held = {each["name"]: each["energy"] for each in told["spaces"]}
    assert min(held["9D, harmonics of the lights"], held["9D, harmonics of the normals"]) > 0.95
    assert held["cone"] > 0.95
    whole = succeed("variation", "subspaces", tmp_path / "s.h5", "--json").json
    np.testing.assert_allclose([e["energy"] for e in whole["spaces"]], [*held.values()], atol=1e-5)
    assert "Epstein" in succeed("variation", "subspaces", tmp_path / "s.h5").out
    write_image(tmp_path / "n.exr", heads[0].normals_hw3.astype(np.float32))
    write_image(tmp_path / "a.exr", heads[0].albedo_hwc.astype(np.float32))
    words = ("variation", "subspaces", tmp_path / "n.exr")
    plain = succeed(*words, "--json").json["spaces"]
    painted = succeed(*words, "--albedo", tmp_path / "a.exr", "--lights", "hemisphere", "--json").json["spaces"]
    assert plain[2]["energy"] > 0.98
    assert painted[2]["energy"] > 0.97
    assert call("variation", "subspaces", tmp_path / "s.h5", "--albedo", tmp_path / "a.exr").code == 2
    for count, holdout, message in (
        (1, 5, "1 are too few"),
        (10, 11, "10 are too few"),
        (12, 13, "of 12, holdout must be 5 to 12, got 13"),
        (12, 2, "of 12, holdout must be 5 to 12, got 2"),
    ):
        few = cr.LightStack(lit[:count], directions_i3[:count], 1.0)
        with pytest.raises(cr.InputError, match=message):
            cr.compare_subspaces(few, holdout=holdout, report=cr.Report())
