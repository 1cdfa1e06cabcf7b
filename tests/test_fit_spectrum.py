import numpy as np
import OpenImageIO as oiio
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import collect_fit, method_class, prepare_fit
from clrelight.fit.evidence import Likelihood
from clrelight.fit.kriging import KrigingModel
from clrelight.fit.left_out import PRIOR_MEAN, Objective, solve_zones
from clrelight.fit.places import find_places, find_zones, spread_points
from clrelight.fit.plan import make_lighting
from clrelight.fit.zonal import Theta, degree_variances
from clrelight.harmonics.basis import evaluate_basis
from clrelight.ingest import ingest_folder
from clrelight.jobs.fit import fit
from clrelight.jobs.report import Report
from clrelight.metrics import measure_errors
from clrelight.sampling import make_pattern
from clrelight.store import open_stack
from tests.reference import spectrum as reference
from tests.reference.basis import real_harmonics

SPECTRUM = {"level": 0.4, "slope": 2.2, "edge": 0.05, "heat": 0.02, "noise": 1e-3}
GIVEN = {**SPECTRUM, "azimuth": 0.0, "tilt": 1.0, "share": 0.0}


def make_stack(n_light=40, noise=0.01, seed=0, directions=None, columns=240, dtype=np.uint8, peak=255.0, **fields):
    """Shaded, glossy and noisy columns."""
    rng = np.random.default_rng(seed)
    directions = make_pattern("uniform", n_light) if directions is None else directions
    normals = np.random.default_rng(1).standard_normal((3, columns)) * [[0.6], [0.6], [0.3]] + [[0], [0], [1]]
    cosine = directions @ (normals / np.linalg.norm(normals, axis=0))
    value = 0.1 + 0.6 * np.maximum(cosine, 0) + 0.25 * np.maximum(cosine, 0) ** 8
    value = np.clip(value + noise * rng.standard_normal(value.shape), 0, 1)
    images = np.rint(value * peak) if dtype == np.uint8 else value * peak
    return LightStack(images.astype(dtype).reshape(len(directions), 2, -1, 3), directions, peak, **fields)


def columns_of(stack):
    return np.asarray(stack.images_ihwc, np.float64).reshape(stack.n_light, -1) / stack.peak


def mean_psnr(fitted, tested):
    return float(np.mean(-10 * np.log10(measure_errors(fitted, tested))))


def test_variances_are_the_references_and_so_are_their_slopes():
    logs = Theta(**SPECTRUM).to_logs()
    found, slopes = degree_variances(logs)
    np.testing.assert_allclose(found, reference.variances(0.4, 2.2, 0.05, 0.02), rtol=1e-12)
    for k in range(4):
        step = np.zeros(7)
        step[k] = 1e-6
        numeric = (degree_variances(logs + step)[0] - degree_variances(logs - step)[0]) / 2e-6
        np.testing.assert_allclose(slopes[k], numeric, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(Theta.from_logs(logs).to_logs(), logs)


@pytest.mark.parametrize("kind", [Objective, Likelihood])
def test_the_gradient_is_that_of_finite_differences(kind):
    stack = make_stack(17)
    places = find_places(make_lighting(stack, "uniform", "hemisphere"))
    mean = places.mean_gi @ columns_of(stack)
    objective = kind.make(places, mean @ mean.T / mean.shape[1] / np.mean(mean**2), 1e-5)
    for logs in (PRIOR_MEAN, np.array([1.0, 0.5, -2.0, -2.0, -5.0, -0.7, 0.6])):
        _, gradient = objective.evaluate(logs)
        for k in range(7):
            step = np.zeros(7)
            step[k] = 1e-5
            numeric = (objective.evaluate(logs + step)[0] - objective.evaluate(logs - step)[0]) / 2e-5
            assert gradient[k] == pytest.approx(numeric, rel=2e-4, abs=2e-4)


def test_zones_are_left_out_exactly():
    stack = make_stack(23)
    sample_ip = columns_of(stack)
    model = KrigingModel.make(find_places(make_lighting(stack, "uniform", "hemisphere")), Theta(**SPECTRUM))
    zones = find_zones(stack.directions_i3, 0.7)
    assert len({len(zone) for zone in zones}) > 1
    errors_gz, _ = solve_zones(model.inverse_gg, zones)
    found = sample_ip - errors_gz.T @ model.inverse_gg @ sample_ip
    a_l = reference.variances(0.4, 2.2, 0.05, 0.02)
    for i, zone in enumerate(zones):
        assert zone[0] == i
        kept = np.setdiff1d(np.arange(23), zone)
        exact = reference.predict(a_l, 1e-3, stack.directions_i3[kept], sample_ip[kept], stack.directions_i3[[i]])
        np.testing.assert_allclose(found[[i]], exact, atol=1e-9)


@pytest.mark.parametrize("precision", ["mixed", "single", "double"])
@pytest.mark.parametrize("n_light", [1, 2, 3, 40, 700])
def test_the_map_is_the_posterior_mean(device, n_light, precision):
    if precision == "double" and not device.info.float64:
        pytest.skip(f"{device.info.name} has no float64")
    stack = make_stack(n_light, columns=60)
    fitted = fit(stack, "spectrum", 25, **GIVEN, precision=precision)
    a_l = reference.variances(0.4, 2.2, 0.05, 0.02)
    exact_kp = reference.operator(a_l, 1e-3, real_harmonics(stack.directions_i3, 25)) @ columns_of(stack)
    assert np.abs(fitted.coeffs_khwc.reshape(676, -1) - exact_kp).max() < 2e-5
    targets = spread_points(50, False)
    shown = evaluate_basis(targets, 25) @ fitted.coeffs_khwc.reshape(676, -1)
    exact = reference.predict(a_l, 1e-3, stack.directions_i3, columns_of(stack), targets)
    assert np.abs(shown - exact).max() < 2e-5


def test_photographs_of_one_light_count_as_so_many(device):
    lights = make_pattern("uniform", 12)
    directions = np.concatenate([lights, lights[:5], lights[:2]])
    stack = make_stack(directions=directions, noise=0.05)
    prepared = prepare_fit(stack, "spectrum", 25, options=GIVEN)
    found = evaluate_basis(lights, 25) @ collect_fit(prepared).coeffs_khwc.reshape(676, -1)
    a_l = reference.variances(0.4, 2.2, 0.05, 0.02)
    exact = reference.predict(a_l, 1e-3, directions, columns_of(stack), lights)
    assert np.abs(found - exact).max() < 1e-5
    assert any("19 photographs of 12 lights" in note for note in prepared.report.notes)


@pytest.mark.parametrize(("degree", "most"), [(8, 4e-3), (15, 5e-4), (26, 1e-6)])
def test_lower_degrees_are_near_the_whole_on_the_hemisphere(device, degree, most):
    stack = make_stack(50)
    whole, cut = (fit(stack, "spectrum", n, **GIVEN) for n in (25, degree))
    targets = spread_points(300, False)
    first = evaluate_basis(targets, 25) @ whole.coeffs_khwc.reshape(676, -1)
    second = evaluate_basis(targets, degree) @ cut.coeffs_khwc.reshape((degree + 1) ** 2, -1)
    assert np.sqrt(np.mean((first - second) ** 2)) < most


def test_what_is_learnt_stands_in_the_config_and_what_is_given_stays(device):
    stack = make_stack(30)
    learnt = fit(stack, "spectrum", 6)
    values = {name: learnt.config[name] for name in GIVEN}
    assert all(value is not None for value in values.values())
    again = fit(stack, "spectrum", 6, **values)
    np.testing.assert_array_equal(again.coeffs_khwc, learnt.coeffs_khwc)
    fixed = fit(stack, "spectrum", 6, slope=3.0, noise=0.01)
    assert fixed.config["slope"] == pytest.approx(3.0, rel=1e-12)
    assert fixed.config["noise"] == pytest.approx(0.01, rel=1e-12)


def test_noise_is_told_from_the_scene(device):
    quiet, loud = (fit(make_stack(60, noise=noise), "spectrum", 12).config["noise"] for noise in (0.0, 0.1))
    assert loud > 5 * quiet


@pytest.mark.parametrize(("n_light", "note"), [(1, "cannot tell how smooth"), (2, "cannot tell how smooth"), (3, None)])
def test_few_lights(device, n_light, note):
    prepared = prepare_fit(make_stack(n_light), "spectrum", 4)
    assert np.isfinite(collect_fit(prepared).coeffs_khwc).all()
    assert any("cannot tell how smooth" in said for said in prepared.report.notes) == (note is not None)


@pytest.mark.parametrize("peak", [1e-20, 1.0, 1e20])
def test_the_unit_of_the_samples_does_not_matter(device, peak):
    one, other = (make_stack(20, dtype=np.float32, peak=value) for value in (1.0, peak))
    first, second = (fit(stack, "spectrum", 6) for stack in (one, other))
    np.testing.assert_allclose(first.coeffs_khwc, second.coeffs_khwc, atol=1e-4)


def test_a_light_of_no_weight_is_none(device):
    weights = np.ones(30)
    weights[7] = 0.0
    stack = make_stack(30, weights_i=weights)
    other = np.asarray(stack.images_ihwc).copy()
    other[7] = 255 - other[7]
    changed = LightStack(other, stack.directions_i3, 255.0, weights_i=weights)
    first, second = (fit(s, "spectrum", 8, weights="solid-angle").coeffs_khwc for s in (stack, changed))
    np.testing.assert_allclose(first, second, atol=1e-6)
    assert make_lighting(stack, "solid-angle", "hemisphere").row_weights_i[7] == 0.0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": 0.0}, "noise must be a number from 1e-12 to 1e.06, got 0.0"),
        ({"slope": 9.0}, "slope must be a number from -3 to 6, got 9.0"),
        ({"heat": "much"}, "heat must be a number"),
        ({"lam": 1.0}, "method spectrum has no option 'lam'"),
    ],
)
def test_bad_options(device, options, message):
    with pytest.raises(InputError, match=message):
        fit(make_stack(9), "spectrum", 3, **options)
    assert method_class("spectrum")().noise is None


@pytest.mark.parametrize("count", [9, 16, 25, 49])
def test_photographs_are_foretold_as_well_as_by_the_best_spline(device, real_data, tmp_path, count):
    ingest_folder(real_data / "stacks" / "loewenkopf", tmp_path / "stack.h5")
    with open_stack(tmp_path / "stack.h5") as stack:
        kept = np.round(np.linspace(0, stack.n_light - 1, count)).astype(np.intp)
        rest = stack.select(np.setdiff1d(np.arange(stack.n_light), kept))
        chosen = stack.select(kept)
        reached = mean_psnr(fit(chosen, "spectrum", 15), rest)
        assert reached > mean_psnr(fit(chosen, "spline", 15, lam=1e-3), rest) - 0.1


def test_rendered_domes_are_foretold_better_than_by_splines(device, real_data, tmp_path):
    folder = real_data / "stacks" / "synthrti" / "Single" / "Object1" / "material1"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    for name in ("Dome", "Test"):
        ingest_folder(folder / name, tmp_path / f"{name}.h5")
    with open_stack(tmp_path / "Dome.h5") as dome, open_stack(tmp_path / "Test.h5") as test:
        reached = mean_psnr(fit(dome, "spectrum", 15), test)
        assert reached > mean_psnr(fit(dome, "spline", 15, lam=1e-3), test) + 0.5


def test_the_variance_of_errors_is_that_of_drawn_functions():
    """A smooth function without noise, foretold by a model that takes it for another."""
    lights, targets = make_pattern("uniform", 17), make_pattern("grid", 10)
    model = KrigingModel.make(
        find_places(make_lighting(make_stack(17, directions=lights), "uniform", "hemisphere")), Theta(**SPECTRUM)
    )
    degree_k = np.repeat(np.arange(26), 2 * np.arange(26) + 1)
    variance_k = np.where(degree_k > 0, degree_k * (degree_k + 1) / 2, 1.0) ** -3.0
    coeffs_kp = np.sqrt(variance_k)[:, None] * np.random.default_rng(0).standard_normal((676, 20_000))
    sample_gp = evaluate_basis(lights, 25) @ coeffs_kp
    errors_tp = evaluate_basis(targets, 25) @ coeffs_kp - model.weights_at(targets) @ sample_gp
    np.testing.assert_allclose(model.error_variance_at(targets, 3.0), np.mean(errors_tp**2, axis=1), rtol=0.05)
    sums_gz = np.random.default_rng(1).standard_normal((17, 5))
    np.testing.assert_allclose(
        model.variance_of(sums_gz, 3.0), np.mean((sums_gz.T @ sample_gp) ** 2, axis=1), rtol=0.05
    )


def read_picture(path):
    return np.asarray(oiio.ImageBuf(str(path)).get_pixels(oiio.FLOAT), np.float64)[..., 0]


def test_confidence_is_what_is_reached(device, tmp_path):
    stack = make_stack(49, noise=0.002)
    report = Report()
    fit(stack, "spectrum", 12, confidence=tmp_path / "c.exr", report=report)
    shown_hw = read_picture(tmp_path / "c.exr")
    size = len(shown_hw)
    centre = (np.arange(size) + 0.5) / size * 2 - 1
    x_hw, y_hw = np.meshgrid(centre, -centre)
    inside_hw = x_hw**2 + y_hw**2 <= 1
    assert (shown_hw[~inside_hw] == 0).all()
    told = report.facts["confidence"]
    assert told["psnr_least"] == pytest.approx(shown_hw[inside_hw].min())
    assert told["psnr_most"] == pytest.approx(shown_hw[inside_hw].max())
    # Where a light is, x to the right and y up, more is expected than in the gap around it.
    unseen_i3 = spread_points(60, False)
    unseen = make_stack(60, noise=0.002, directions=unseen_i3, seed=7)
    reached_i = -10 * np.log10(measure_errors(fit(stack, "spectrum", 12), unseen))
    pixel = ((np.stack([unseen_i3[:, 0], -unseen_i3[:, 1]]) + 1) / 2 * size).astype(int)
    expected_i = shown_hw[pixel[1], pixel[0]]
    assert np.mean(expected_i) == pytest.approx(np.mean(reached_i), abs=2.5)  # smooth: auto says 1.5 cannot be told
    high_i3 = stack.directions_i3[stack.directions_i3[:, 2] > 0.2]
    at = ((np.stack([high_i3[:, 0], -high_i3[:, 1]]) + 1) / 2 * size).astype(int)
    assert np.mean(shown_hw[at[1], at[0]]) > np.mean(shown_hw[inside_hw]) + 1.0


def test_confidence_in_code_values(device, tmp_path):
    directions = make_pattern("uniform", 40)
    stack = make_stack(30, directions=directions[directions[:, 0] < 0.3][:30])  # nothing from the right
    for name in ("c.exr", "c.png"):
        fit(stack, "spectrum", 8, confidence=tmp_path / name, report=Report())
    psnr_hw, code_hw = read_picture(tmp_path / "c.exr"), 255 * read_picture(tmp_path / "c.png")
    np.testing.assert_allclose(code_hw, np.rint(np.minimum(5 * psnr_hw, 255)), atol=1e-3)
    unseen_i3 = spread_points(120, False)
    reached_i = -10 * np.log10(measure_errors(fit(stack, "spectrum", 8), make_stack(120, directions=unseen_i3, seed=7)))
    right_i, right_w = unseen_i3[:, 0] > 0.6, np.arange(128) > 1.6 * 64
    for mean_right, mean_left in (
        (reached_i[right_i].mean(), reached_i[~right_i].mean()),
        (psnr_hw[50:78, right_w & (np.arange(128) < 120)].mean(), psnr_hw[50:78, 20:64].mean()),
    ):
        assert mean_right < mean_left - 3.0


def test_only_spectrum_has_confidence(device, tmp_path):
    with pytest.raises(InputError, match="a confidence map shows the variance that spectrum has; cls has none"):
        fit(make_stack(20), "cls", 3, confidence=tmp_path / "c.png", out=tmp_path / "f.h5", report=Report())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("n_light", [9, 10])
def test_few_lights_tell_where_a_function_ends(n_light):
    """Fewer lights than coefficients: by being left out alone they do not."""
    lights, between = make_pattern("uniform", n_light), spread_points(120, False)
    coeffs_kp = (
        np.random.default_rng(1).standard_normal((16, 300)) * np.repeat([0.2, 0.1, 0.1, 0.1], [1, 3, 5, 7])[:, None]
    )
    coeffs_kp[0] += 1.7
    shown, truth = (real_harmonics(directions, 3) @ coeffs_kp for directions in (lights, between))
    seen, held = (
        LightStack(np.rint(255 * np.clip(value, 0, 1)).astype(np.uint8).reshape(-1, 10, 10, 3), directions, 255.0)
        for value, directions in ((shown, lights), (truth, between))
    )
    method = prepare_fit(seen, "spectrum", 25).method
    assert method.limit == 3
    reached, endless = (
        mean_psnr(collect_fit(prepare_fit(seen, "spectrum", 25, options=options)), held)
        for options in ({}, {"limit": 25})
    )
    assert reached > endless + 0.5


def shaded_dome(floor, lights):
    """Lambert's cosine over tilted normals: with shadows attached, and with a floor below them that is not black."""
    rng = np.random.default_rng(3)
    rng.standard_normal((16, 600))
    normals = rng.standard_normal((3, 600)) * [[0.6], [0.6], [0.3]] + [[0.0], [0.0], [1.0]]
    cosine = np.maximum(lights @ (normals / np.linalg.norm(normals, axis=0)), 0.0)
    value = floor + (1.0 - floor) * rng.uniform(0.3, 1.0, 600) * cosine
    return LightStack(np.rint(255 * value).astype(np.uint8).reshape(len(lights), 1, -1, 3), lights, 255.0)


def test_functions_clipped_at_black_have_no_end():
    """Under 9 lights all else asks for degree 3, at which such functions lose 0.9 dB."""
    lights, between = make_pattern("uniform", 9), spread_points(120, False)
    black, lifted = shaded_dome(0.0, lights), shaded_dome(0.1, lights)
    assert prepare_fit(lifted, "spectrum", 25).method.limit == 3
    free = prepare_fit(black, "spectrum", 25)
    assert free.method.limit == 25
    ended, held = prepare_fit(black, "spectrum", 25, options={"limit": 3}), shaded_dome(0.0, between)
    assert mean_psnr(collect_fit(free), held) > mean_psnr(collect_fit(ended), held) + 0.5


def test_two_rings_tell_no_end():
    """They do not see (z - z1) (z - z2), which degree 2 has: what is made of it no light judges."""
    angle = np.arange(7) * 2 * np.pi / 7
    rings = [
        np.stack([r * np.cos(angle + t), r * np.sin(angle + t), 0 * angle + z], 1)
        for r, z, t in ((0.8, 0.6, 0), (0.6, 0.8, 0.3))
    ]
    coeffs_kp = 0.1 * np.random.default_rng(4).standard_normal((9, 300)) / 3.0
    coeffs_kp[0] += 1.7
    for lights, limit in ((np.concatenate(rings), 25), (make_pattern("uniform", 14), 2)):
        codes = np.rint(255 * real_harmonics(lights, 2) @ coeffs_kp).astype(np.uint8)
        assert (
            prepare_fit(LightStack(codes.reshape(14, 10, 10, 3), lights, 255.0), "spectrum", 25).method.limit == limit
        )


@pytest.mark.parametrize("limit", [2, 3])
def test_a_band_limited_function_is_told(device, limit):
    rng = np.random.default_rng(4)
    count = (limit + 1) ** 2
    coeffs_kp = 0.1 * rng.standard_normal((count, 300)) / np.sqrt(count)
    coeffs_kp[0] += 1.7
    lights, between = make_pattern("uniform", 40), make_pattern("uniform", 163)
    shown = real_harmonics(lights, limit) @ coeffs_kp
    stack = LightStack(np.rint(255 * shown).astype(np.uint8).reshape(40, 10, 10, 3), lights, 255.0)
    prepared = prepare_fit(stack, "spectrum", 25)
    assert prepared.method.limit == limit
    assert any(f"nothing above degree {limit}" in note for note in prepared.report.notes)
    truth = (real_harmonics(between, limit) @ coeffs_kp).astype(np.float32).reshape(163, 10, 10, 3)
    held = LightStack(truth, between, 1.0)
    least_squares = mean_psnr(collect_fit(prepare_fit(stack, "uls", limit)), held)
    assert mean_psnr(collect_fit(prepared), held) > least_squares - 0.1
    assert prepare_fit(make_stack(40), "spectrum", 25).method.limit == 25
