import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from clrelight.cli.app import cli
from clrelight.conventions import linear_to_srgb
from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import collect_fit, method_class, prepare_fit
from clrelight.fit.leave_out_error import Trials, try_method
from clrelight.fit.places import spread_points
from clrelight.fit.samples import Samples
from clrelight.harmonics.basis import evaluate_basis
from clrelight.holdout import split_chosen
from clrelight.ingest import ingest_folder
from clrelight.jobs.fit import fit
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.sampling import make_pattern
from clrelight.store import open_stack, write_stack
from tests.reference import spline as reference


def make_scene(degree, n_light=80, shape_hwc=(5, 40, 3), noise=0.02, seed=0, pattern="uniform", **fields):
    """Columns of one degree, with noise."""
    rng = np.random.default_rng(seed)
    directions = make_pattern(pattern, n_light)
    coeffs = 0.1 * rng.standard_normal(((degree + 1) ** 2, int(np.prod(shape_hwc))))
    coeffs[0] += 1.5
    value = evaluate_basis(directions, degree) @ coeffs + noise * rng.standard_normal((n_light, coeffs.shape[1]))
    images = np.rint(np.clip(value, 0, 1) * 255).astype(np.uint8).reshape(n_light, *shape_hwc)
    return LightStack(images, directions, 255.0, **fields)


def columns(stack):
    return np.asarray(stack.images_ihwc, np.float64).reshape(stack.n_light, -1) / stack.peak


METHODS = [
    ("uls", {}, np.zeros(16)),
    ("spline", {"lam": 1e-3}, 1e-3 * np.diag(reference.penalty(3))),
    ("spline", {"lam": 1.0}, np.diag(reference.penalty(3))),
]


def shown_error(predicted_p, true_p):
    return np.mean((np.clip(predicted_p, 0, 1) - np.clip(true_p, 0, 1)) ** 2)


def fit_without(basis_ik, sample_ip, weights_i, penalty_kk, zone, judged):
    """Return the value at one light of a penalised fit to all lights outside its zone."""
    kept = np.setdiff1d(np.arange(len(basis_ik)), zone)
    weighted_ki = basis_ik[kept].T * weights_i[kept]
    return basis_ik[judged] @ np.linalg.solve(weighted_ki @ basis_ik[kept] + penalty_kk, weighted_ki @ sample_ip[kept])


@pytest.mark.parametrize(("method", "options", "penalty"), METHODS)
@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
def test_the_closed_form_is_what_leaving_zones_out_gives(method, options, penalty, weights):
    stack = make_scene(6, 60, weights_i=np.random.default_rng(5).random(60) + 0.1, pattern="grid")
    weights_i = stack.weights_i / stack.weights_i.mean() if weights == "solid-angle" else np.ones(60)
    trials = Trials.make(Samples(stack), weights, "hemisphere")
    found = try_method(method_class(method)(**options), 3, trials)
    basis_ik = evaluate_basis(stack.directions_i3, 3)
    assert max(len(zone) for zone in trials.zones) > 1
    for i, zone in enumerate(trials.zones):
        exact = fit_without(basis_ik, columns(stack), weights_i, np.diag(penalty), zone, i)
        assert found[i] == pytest.approx(shown_error(exact, columns(stack)[i]), rel=1e-6)


def test_a_saturated_fit_is_unknown():
    stack = make_scene(3, 25)
    trials = Trials.make(Samples(stack), "uniform", "hemisphere")
    assert np.isnan(try_method(method_class("uls")(), 4, trials)).all()
    assert np.isfinite(try_method(method_class("uls")(), 1, trials)).all()


def test_photographs_of_one_light_are_left_out_together():
    stack = make_scene(3, 30)
    twice = LightStack(np.repeat(stack.images_ihwc, 2, axis=0), np.repeat(stack.directions_i3, 2, axis=0), 255.0)
    once, both = (Trials.make(Samples(s), "uniform", "hemisphere") for s in (stack, twice))
    spline = method_class("spline")
    first, second = try_method(spline(lam=1e-3), 5, once), try_method(spline(lam=1e-3), 5, both)
    np.testing.assert_allclose(first, second, rtol=1e-6)


def test_cls_is_fitted_anew_without_the_zone(device):
    stack = make_scene(4, 40, shape_hwc=(4, 20, 3))
    trials = Trials.make(Samples(stack), "uniform", "hemisphere")
    found = try_method(method_class("cls")(), 3, trials)
    assert np.isfinite(found).sum() == len(trials.refits)
    place = trials.refits[2][0]
    kept = np.setdiff1d(np.arange(40), trials.zones[place])
    fitted = fit(stack.select(kept), "cls", 3).coeffs_khwc.reshape(16, -1)
    exact = evaluate_basis(stack.directions_i3[[place]], 3) @ fitted
    assert found[place] == pytest.approx(shown_error(exact[0], columns(trials.samples.stack)[place]), rel=1e-3)


@pytest.mark.parametrize(
    ("method", "options"),
    [
        ("uls", {}),
        ("sloan", {}),
        ("cls", {"energy": 0.7, "solver": "bisection"}),
        ("ceb", {"energy": 0.7}),
        ("ceb-crossing", {"energy": 0.7}),
        ("spline", {"lam": 0.01}),
        ("spline", {"lam": [1e-3, 1e-2, 1.0], "per": "channel"}),
    ],
)
@pytest.mark.parametrize("sampling", ["hemisphere", "scattered"])
def test_gains_on_the_host_are_what_kernels_do(device, method, options, sampling):
    stack = make_scene(6, 60)
    prepared = prepare_fit(stack, method, 4, options=options, sampling=sampling)
    plan, sample_ip = prepared.plan, columns(stack)
    z_rp = plan.analysis_ri @ sample_ip
    gain_rp = prepared.method.find_gains(plan, z_rp, plan.energy_i @ sample_ip**2)
    expected = plan.synthesis_kr @ (gain_rp * z_rp)
    found = collect_fit(prepared).coeffs_khwc.reshape(25, -1)
    # Where the bound is met within rounding, float32 may keep one component more or less.
    same = (np.abs(found - expected) <= 2e-4 * np.linalg.norm(expected, axis=0)).all(axis=0)
    assert same.mean() > 0.99


def mean_psnr(fitted, tested):
    return float(np.mean(-10.0 * np.log10(np.maximum(measure_errors(fitted, tested), 1e-13))))


def dome(shade, columns=200, dtype=np.float32, seed=3, lights=None):
    """A stack of a dome of four rings, or of other lights, and one at lights all over the hemisphere."""
    rings = [(10, 12, 0.0), (32, 11, 0.2), (55, 8, 0.1), (78, 5, 0.3)]
    ringed = np.array([
        [np.cos(np.radians(e)) * np.cos(a), np.cos(np.radians(e)) * np.sin(a), np.sin(np.radians(e))]
        for e, n, start in rings for a in np.arange(n) * 2 * np.pi / n + start
    ])  # fmt: skip
    targets = spread_points(120, False)
    normals = np.random.default_rng(seed).standard_normal((columns, 3)) * [0.6, 0.6, 0.3] + [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    made = []
    for directions in (ringed if lights is None else lights, targets):
        value = np.clip(shade(directions, normals), 0.0, 1.0)
        images = np.rint(255 * value) if dtype == np.uint8 else value
        made.append(LightStack(images.astype(dtype)[:, None, :, None], directions, 255.0 if dtype == np.uint8 else 1.0))
    return made


def cubic(directions, normals):
    cosine = directions @ normals.T
    return 0.6 * (0.3 + 0.35 * cosine + 0.1 * cosine**2 + 0.1 * cosine**3)


def lambert(directions, normals):
    return 0.8 * np.maximum(directions @ normals.T, 0.0)


def waves(directions, normals):
    sine, azimuth = np.sqrt(1 - directions[:, 2] ** 2), np.arctan2(directions[:, 1], directions[:, 0])
    return np.repeat((0.5 + 0.3 * sine**6 * np.cos(6 * azimuth))[:, None], len(normals), axis=1)


@pytest.mark.parametrize(
    ("shade", "dtype", "least", "below"),
    [
        (cubic, np.float32, 70.0, 0.0),
        (cubic, np.uint8, 54.0, 1.0),
        (lambert, np.float32, 41.0, 0.7),
        (lambert, np.uint8, 41.0, 0.7),
        (waves, np.float32, 50.0, 0.0),
        (waves, np.uint8, 45.0, 0.0),
    ],
)
def test_smooth_domes(device, shade, dtype, least, below):
    stack, unseen = dome(shade, dtype=dtype)
    prepared = prepare_fit(stack, "auto", "auto")
    reached = mean_psnr(collect_fit(prepared), unseen)
    assert reached > least
    if below:
        grid = [("spline", n, {"lam": lam}) for n in (4, 8, 15) for lam in (1e-5, 3e-4, 1e-3)]
        grid += [("cls", n, {}) for n in (2, 3, 4, 6, 9)] + [("uls", 2, {}), ("uls", 3, {}), ("ceb", 3, {})]
        best = max(mean_psnr(fit(stack, method, n, **options), unseen) for method, n, options in grid)
        assert reached > best - below
    predicted = prepared.choice.chosen.predicted
    assert (predicted is None) == (prepared.choice.why_unknown is not None)


@pytest.mark.parametrize("n_light", [6, 9, 16, 36])
@pytest.mark.parametrize("shade", [cubic, lambert])
def test_smooth_scenes_are_foretold_or_said_to_be_unknown(device, shade, n_light):
    """On even patterns half a gap's radius and a whole one leave out the same lights: wider zones tell the law."""
    stack, unseen = dome(shade, lights=make_pattern("uniform", n_light))
    prepared = prepare_fit(stack, "auto", "auto")
    predicted, reached = prepared.choice.chosen.predicted, mean_psnr(collect_fit(prepared), unseen)
    assert predicted is None or predicted == pytest.approx(reached, abs=3.0 if n_light < 10 else 1.5)


def cap(n_light, degrees):
    """Lights evenly spread around the zenith, no farther from it than so many degrees."""
    index = np.arange(n_light) + 0.5
    z, azimuth = 1 - (1 - np.cos(np.radians(degrees))) * index / n_light, index * np.pi * (3 - np.sqrt(5))
    return np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z], axis=1)


@pytest.mark.parametrize("n_light", [8, 20, 40])
def test_a_cap_of_lights_tells_nothing_of_the_hemisphere(device, n_light):
    stack = flash(cap(n_light, 30), 10)
    choice = prepare_fit(stack, "auto", "auto").choice
    assert choice.chosen.predicted is None
    assert "% of the hemisphere only" in choice.note
    # Who asks for directions among the lights is told of those.
    between = flash(cap(3 * n_light + 1, 26), 10, seed=1)
    asked = prepare_fit(stack, "auto", "auto", unseen_t3=between.directions_i3)
    predicted, reached = asked.choice.chosen.predicted, mean_psnr(collect_fit(asked), between)
    assert predicted is None or predicted == pytest.approx(reached, abs=3.0 if n_light < 10 else 1.5)


@pytest.mark.parametrize("n_light", [4, 9, 16, 25, 36])
def test_as_many_coefficients_as_lights_are_not_taken_on_trust(device, n_light):
    """A scene rougher than so many lights can hold, at lights in its gaps."""
    stack, unseen = make_scene(9, n_light, noise=0.0), make_scene(9, 101, noise=0.0)
    prepared = prepare_fit(stack, "auto", "auto")
    spline = mean_psnr(fit(stack, "spline", 15, lam=1e-3), unseen)
    assert mean_psnr(collect_fit(prepared), unseen) > spline - 0.7
    side = int(np.sqrt(n_light)) - 1
    saturated = [c for c in prepared.choice.tried if c.method.id == "uls" and c.degree == side]
    assert all(c.in_folds is None for c in saturated)


def photograph_again(copies_g, noise, common=0.0, degree=9):
    """So many photographs of each light, with noise, some of it common to them, of a scene of this degree."""
    rng = np.random.default_rng(0)
    clean_ip = columns(make_scene(degree, len(copies_g), noise=0.0, shape_hwc=(4, 20, 3)))
    clean_ip = np.clip(clean_ip + common * rng.standard_normal(clean_ip.shape), 0, 1)
    place_i = np.repeat(np.arange(len(copies_g)), copies_g)
    value = clean_ip[place_i] + noise * rng.standard_normal((len(place_i), 240))
    images = np.rint(255 * np.clip(value, 0, 1)).astype(np.uint8).reshape(-1, 4, 20, 3)
    return LightStack(images, make_pattern("uniform", len(copies_g))[place_i], 255.0)


UNEVEN = np.where(np.arange(60) % 7 == 0, 30, 1)
AGAIN = [
    ("auto", "auto"),
    ("spectrum", 15),
    ("spline", 15),
    ("cls", 6),
    ("ceb", 6),
    ("uls", 4),
    ("sloan", 4),
    ("project", 6),
]


@pytest.mark.parametrize(("method", "degree"), AGAIN)
@pytest.mark.parametrize(("copies_g", "noise", "common"), [
    (np.full(60, 6), 0.05, 0.0), (np.full(60, 6), 0.0, 0.02), (UNEVEN, 0.05, 0.0), (UNEVEN, 0.0, 0.02)
])  # fmt: skip
def test_more_photographs_of_the_same_lights_never_cost_quality(device, method, degree, copies_g, noise, common):
    unseen = make_scene(9, 97, noise=0.0, shape_hwc=(4, 20, 3))
    one, more = (photograph_again(counts, noise, common) for counts in (np.ones(60, int), copies_g))
    first, second = (mean_psnr(fit(stack, method, degree), unseen) for stack in (one, more))
    assert second > first - 0.05


def test_equal_photographs_change_nothing(device):
    one, six = (photograph_again(np.full(40, count), 0.0, 0.02) for count in (1, 6))
    for method, degree in AGAIN[1:]:
        first, second = (fit(stack, method, degree).coeffs_khwc for stack in (one, six))
        assert np.abs(first - second).max() < 3e-4 * np.abs(first).max()


def test_the_mean_of_more_photographs_is_better(device):
    one, six = (prepare_fit(photograph_again(np.full(60, n), 0.05, degree=4), "auto", "auto") for n in (1, 6))
    unseen = make_scene(4, 97, noise=0.0, shape_hwc=(4, 20, 3))
    assert mean_psnr(collect_fit(six), unseen) > mean_psnr(collect_fit(one), unseen) + 2.0
    assert any("360 photographs of 60 lights" in note for note in six.report.notes)


def flash(directions, exponent, seed=0):
    """Photographs of something matt that flashes under lights around the zenith."""
    normals = np.random.default_rng(3).standard_normal((200, 3)) * [0.3, 0.3, 0.1] + [0, 0, 1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    half = directions + np.array([0, 0, 1])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    value = 0.1 + 0.3 * np.maximum(directions @ normals.T, 0) + 0.6 * np.maximum(half @ normals.T, 0) ** exponent
    value += 0.01 * np.random.default_rng(seed).standard_normal(value.shape)
    return LightStack(np.rint(255 * np.clip(value, 0, 1)).astype(np.uint8)[:, None, :, None], directions, 255.0)


@pytest.mark.parametrize("exponent", [60, 120])
def test_a_hole_among_the_lights_is_foretold_by_who_asks_for_it(device, exponent):
    """Where the scene is roughest, three lights in four are held out: the mean of all gaps says nothing about them."""
    stack = flash(make_pattern("uniform", 80), exponent)
    low = stack.directions_i3[:, 2] < 0.85
    fitted, held = np.flatnonzero(low | (np.arange(80) % 4 == 0)), np.flatnonzero(~low & (np.arange(80) % 4 != 0))
    everywhere = prepare_fit(stack.select(fitted), "auto", "auto")
    there = prepare_fit(stack.select(fitted), "auto", "auto", unseen_t3=stack.directions_i3[held])
    reached = mean_psnr(collect_fit(there), stack.select(held))
    assert reached < 31.0
    assert everywhere.choice.chosen.predicted is None
    assert there.choice.chosen.predicted == pytest.approx(reached, abs=1.5)
    assert "predicted at the lights held out" in there.choice.note
    # The directions decide nothing.
    assert there.config == everywhere.config
    assert (there.method, there.degree) == (everywhere.method, everywhere.degree)


def test_values_as_displayed_are_offered_where_they_fit_better(device):
    """Columns smooth in code values are not in radiance, and the other way round."""
    smooth = make_scene(3, 60, noise=0.0)
    coded, linear = (
        prepare_fit(replace(smooth, transfer=transfer), "spectrum", "auto") for transfer in ("srgb", "linear")
    )
    assert coded.choice.code_gain > 3.0
    assert "spectrum-curve, which fits values as displayed, could be" in coded.choice.note
    assert linear.choice.code_gain is None
    assert "spectrum-curve" not in linear.choice.note
    encoded = np.rint(255 * linear_to_srgb(np.asarray(smooth.images_ihwc) / 255)).astype(np.uint8)
    radiance = prepare_fit(replace(smooth, images_ihwc=encoded, transfer="srgb"), "auto", "auto")
    assert radiance.choice.code_gain < 0.0
    assert "spectrum-curve" not in radiance.choice.note


def test_samples_above_the_peak(device):
    def scale(stack, factor):
        return replace(stack, images_ihwc=np.asarray(stack.images_ihwc, np.float32) / 255 * factor, peak=1.0)

    stack, unseen = scale(make_scene(5, 60), 1.4), scale(make_scene(5, 97, noise=0.0), 1.4)
    assert 0.005 < (stack.images_ihwc > 1).mean() < 0.9
    prepared = prepare_fit(stack, "auto", "auto")
    reached = mean_psnr(collect_fit(prepared), unseen)
    best = max(mean_psnr(fit(stack, "spline", n, lam=1e-3), unseen) for n in (4, 6, 15))
    assert reached > best - 0.3


def test_within_buys_fewer_coefficients(device):
    stack = make_scene(8, 90, noise=0.01)
    degrees = [prepare_fit(stack, "auto", "auto", within=within).degree for within in (0.0, 0.05, 1.0, 20.0)]
    assert degrees == sorted(degrees, reverse=True)
    assert degrees[0] > degrees[-1]
    for within in (-1.0, float("nan"), float("inf")):
        with pytest.raises(InputError, match="within must be 0 or more decibels"):
            prepare_fit(stack, "auto", "auto", within=within)


def test_few_lights_get_no_more_coefficients_than_tell(device):
    """What errors may be at the least asks for more, and rounding of photographs for more yet."""
    y, x = np.mgrid[0:40, 0:60] / 60.0
    normals = np.stack([0.5 * np.sin(6 * x), 0.5 * np.cos(6 * y), np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)

    def photographs(n_light):
        lights_i3 = make_pattern("uniform", n_light)
        shaded = np.clip(np.einsum("hwd,id->ihw", normals, lights_i3), 0, None)[..., None] * [0.9, 0.6, 0.3]
        return LightStack(np.rint(255 * shaded).astype(np.uint8), lights_i3, 255.0, "srgb")

    seen, unseen = photographs(6), photographs(41)
    prepared = prepare_fit(seen, "auto", "auto", device=device)
    assert (prepared.degree + 1) ** 2 <= 9 * 6
    assert prepared.choice.most > prepared.degree
    assert f"degree {prepared.choice.most}, " in prepared.choice.note

    def reached(degree):
        fitted = collect_fit(prepare_fit(seen, prepared.method.id, degree, device=device))
        return summarize_errors(measure_errors(fitted, unseen)).psnr_mean

    assert reached(prepared.degree) > reached(prepared.choice.most) - 0.1


@pytest.mark.parametrize("degree", [1, 2])
def test_a_simple_scene_gets_a_low_degree(device, degree):
    stack = make_scene(degree)
    prepared = prepare_fit(stack, "auto", "auto", device=device)
    assert degree <= prepared.degree <= 5
    assert prepared.choice.note in prepared.report.notes
    unseen = make_scene(degree, 81, noise=0.0, seed=0)  # other lights, the same columns
    assert summarize_errors(measure_errors(collect_fit(prepared), unseen)).psnr_pooled > 40.0


def test_photographs_are_foretold(device, real_data, tmp_path):
    ingest_folder(real_data / "stacks" / "loewenkopf", tmp_path / "stack.h5")
    with open_stack(tmp_path / "stack.h5") as stack:
        for count in (9, 25, 49):
            kept = np.round(np.linspace(0, stack.n_light - 1, count)).astype(np.intp)
            prepared = prepare_fit(stack.select(kept), "auto", "auto", device=device)
            rest = stack.select(np.setdiff1d(np.arange(stack.n_light), kept))
            reached = mean_psnr(collect_fit(prepared), rest)
            spline = mean_psnr(fit(stack.select(kept), "spline", 15, lam=1e-3), rest)
            assert reached > spline - 0.15
            assert prepared.choice.chosen.predicted == pytest.approx(reached, abs=3.0 if count == 9 else 1.5)


@pytest.mark.parametrize("item", ["item2", "item3", "item12"])
def test_objects_are_foretold_or_said_to_be_unknown(device, real_data, tmp_path, item):
    folder = real_data / "stacks" / "realrti" / item
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    ingest_folder(folder, tmp_path / "stack.h5")
    with open_stack(tmp_path / "stack.h5") as stack:
        some = Samples(stack, 6000).stack
    fitted, held = split_chosen(some.directions_i3, 5)
    seen, unseen = some.select(fitted), some.select(held)
    prepared = prepare_fit(seen, "auto", "auto", unseen_t3=unseen.directions_i3)
    reached = mean_psnr(collect_fit(prepared), unseen)
    predicted = prepared.choice.chosen.predicted
    if item == "item3":  # most lights near the zenith are held out, where it flashes
        assert predicted is None
        assert "it depends on where the light is" in prepared.choice.note
    else:
        assert predicted == pytest.approx(reached, abs=1.5)
        assert reached > max(mean_psnr(fit(seen, "spline", 15, lam=lam), unseen) for lam in (3e-4, 1e-3)) - 0.3


def test_held_out_lights_are_not_seen(device):
    stack = make_scene(4, 50)
    wild = stack.images_ihwc.copy()
    wild[4::5] = np.random.default_rng(9).integers(0, 256, wild[4::5].shape)
    first, second = (fit(s, "auto", "auto", holdout=5) for s in (stack, replace(stack, images_ihwc=wild)))
    assert (first.method, first.degree, first.config) == (second.method, second.degree, second.config)
    np.testing.assert_array_equal(first.coeffs_khwc, second.coeffs_khwc)


def test_either_may_be_given(device):
    stack = make_scene(4, 60)
    fixed_degree = prepare_fit(stack, "auto", 3, device=device)
    assert fixed_degree.degree == 3
    assert {c.degree for c in fixed_degree.choice.tried} == {3}
    fixed_method = prepare_fit(stack, "cls", "auto", options={"energy": 2.0}, device=device)
    assert fixed_method.method == method_class("cls")(energy=2.0)
    assert {c.method for c in fixed_method.choice.tried} == {fixed_method.method}
    assert prepare_fit(stack, "cls", 3, device=device).choice is None


@pytest.mark.parametrize("n_light", [1, 2, 3, 4, 7])
def test_few_lights(device, n_light):
    stack = make_scene(1, n_light)
    prepared = prepare_fit(stack, "auto", "auto")
    assert np.isfinite(collect_fit(prepared).coeffs_khwc).all()
    assert n_light >= 6 or "unknown" in prepared.choice.note
    uls = prepare_fit(stack, "uls", "auto", device=device) if n_light >= 4 else None
    assert uls is None or (uls.degree + 1) ** 2 <= n_light


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("auto", "auto", {"energy": 1.0}), "auto chooses the options too; energy needs a method by name"),
        (("project", "auto", {}), "degree auto needs a method that fits samples, such as cls or spline; project"),
        (("uls", "high", {}), "degree must be auto or 0 to 100, got 'high'"),
    ],
)
def test_bad_requests(device, arguments, message):
    method, degree, options = arguments
    with pytest.raises(InputError, match=message):
        prepare_fit(make_scene(1, 9), method, degree, options=options)


def test_lights_that_cannot_tell(device):
    stack = make_scene(1, 3)
    with pytest.raises(InputError, match="sloan at degree 1 has 4 coefficients but there are 3 lights"):
        prepare_fit(stack, "sloan", "auto")


def test_command_says_what_it_chose(device, tmp_path):
    write_stack(tmp_path / "stack.h5", make_scene(2, 40))
    arguments = ["fit", str(tmp_path / "stack.h5"), str(tmp_path / "fit.h5"), "--method", "auto", "--degree", "auto"]
    done = CliRunner().invoke(cli, [*arguments, "--holdout", "5", "--json"], catch_exceptions=False)
    assert done.exit_code == 0
    facts = json.loads(done.stdout)
    chosen, after = facts["choice"]["chosen"], facts["choice"]["runner_up"]
    assert (chosen["method"], chosen["degree"]) == (facts["method"], facts["degree"])
    assert after in facts["choice"]["tried"]
    assert facts["psnr"]["pooled_holdout"] > 25
    spoken = CliRunner().invoke(cli, arguments, catch_exceptions=False)
    assert f"auto took {chosen['method']} at degree" in spoken.stderr
    refused = CliRunner().invoke(cli, [*arguments[:-1], "x"])
    assert refused.exit_code == 2
    assert "not a whole number or auto" in refused.output
