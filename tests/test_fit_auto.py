import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from clrelight.basis import evaluate_basis
from clrelight.cli.app import cli
from clrelight.dataset import LightStack, split_lights
from clrelight.errors import InputError
from clrelight.fit import collect_fit, fit, method_class, prepare_fit
from clrelight.fit.plan import make_lighting
from clrelight.fit.prediction import measure_prediction, predict_in_folds, predict_left_out
from clrelight.fit.samples import Samples
from clrelight.ingest import ingest_folder
from clrelight.metrics import measure_errors, summarize_errors
from clrelight.sampling import make_pattern
from clrelight.store import open_stack, write_stack
from tests.reference import spline as reference


def make_scene(degree, n_light=80, shape_hwc=(5, 40, 3), noise=0.02, seed=0, **fields):
    """Columns of one degree, with noise."""
    rng = np.random.default_rng(seed)
    directions = make_pattern("uniform", n_light)
    coeffs = 0.1 * rng.standard_normal(((degree + 1) ** 2, int(np.prod(shape_hwc))))
    coeffs[0] += 1.5
    value = evaluate_basis(directions, degree) @ coeffs + noise * rng.standard_normal((n_light, coeffs.shape[1]))
    images = np.rint(np.clip(value, 0, 1) * 255).astype(np.uint8).reshape(n_light, *shape_hwc)
    return LightStack(images, directions, 255.0, **fields)


def columns(stack):
    return np.asarray(stack.images_ihwc, np.float64).reshape(stack.n_light, -1) / stack.peak


METHODS = [
    ("uls", {}, np.zeros),
    ("spline", {"lam": 1e-3}, lambda n: 1e-3 * np.diag(reference.penalty(3))),
    ("spline", {"lam": 1.0}, lambda n: np.diag(reference.penalty(3))),
]


@pytest.mark.parametrize(("method", "options", "penalty"), METHODS)
@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
def test_the_closed_form_is_what_leaving_lights_out_gives(method, options, penalty, weights):
    stack = make_scene(6, 40, weights_i=np.random.default_rng(5).random(40) + 0.1)
    weights_i = stack.weights_i / stack.weights_i.mean() if weights == "solid-angle" else np.ones(40)
    lighting = make_lighting(stack, weights, "hemisphere")
    found = predict_left_out(method_class(method)(**options), 3, Samples(stack), lighting)
    basis_ik = evaluate_basis(stack.directions_i3, 3)
    exact = reference.leave_out(basis_ik, columns(stack), weights_i, np.diag(penalty(16)))
    np.testing.assert_allclose(found, exact, atol=1e-9)
    assert np.abs(exact - columns(stack)).max() > 0.05


def test_the_closed_form_without_y10_and_for_the_lambda_of_each_column(device):
    stack = make_scene(6, 40)
    lighting = make_lighting(stack, "uniform", "hemisphere")
    basis_ik, sample_ip = evaluate_basis(stack.directions_i3, 3), columns(stack)
    found = predict_left_out(method_class("sloan")(), 3, Samples(stack), lighting)
    exact = reference.leave_out(np.delete(basis_ik, 2, axis=1), sample_ip, np.ones(40), np.zeros((15, 15)))
    np.testing.assert_allclose(found, exact, atol=1e-9)
    found = predict_left_out(method_class("cls")(energy=0.8), 3, Samples(stack), lighting)
    lambda_p = fit(stack, "cls", 3, options={"energy": 0.8}).lambda_hwc.ravel().astype(np.float64)
    assert (lambda_p > 0).any()
    for p in range(0, 600, 29):
        exact = reference.leave_out(basis_ik, sample_ip[:, p : p + 1], np.ones(40), lambda_p[p] * np.eye(16))
        np.testing.assert_allclose(found[:, p : p + 1], exact, atol=2e-4)


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


def test_a_fold_does_not_see_its_own_lights():
    stack = make_scene(3, 23)
    spline = method_class("spline")()
    first = predict_in_folds(spline, 5, Samples(stack), "uniform", "hemisphere")
    changed = stack.images_ihwc.copy()
    changed[7] = 255 - changed[7]
    second = predict_in_folds(spline, 5, Samples(replace(stack, images_ihwc=changed)), "uniform", "hemisphere")
    same = (first == second).all(axis=1)
    assert same[7]
    assert 23 // 5 <= same.sum() <= 23 // 5 + 1  # its fold alone


def test_predictions_are_measured_as_images_are(device):
    stack = replace(make_scene(3, 30, noise=0.2), transfer="srgb")
    fitted = fit(stack, "uls", 2)
    samples = Samples(stack)
    predicted_ip = evaluate_basis(stack.directions_i3, 2) @ fitted.coeffs_khwc.reshape(9, -1).astype(np.float64)
    expected = summarize_errors(measure_errors(fitted, stack)).psnr_pooled
    assert measure_prediction(predicted_ip, samples) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(("degree", "highest"), [(1, 2), (2, 3)])
def test_a_simple_scene_gets_a_low_degree(device, degree, highest):
    stack = make_scene(degree)
    prepared = prepare_fit(stack, "auto", "auto", device=device)
    assert degree <= prepared.degree <= highest
    assert prepared.choice.note in prepared.report.notes
    unseen = make_scene(degree, 81, noise=0.0, seed=0)  # other lights, the same columns
    truth = summarize_errors(measure_errors(collect_fit(prepared), unseen)).psnr_pooled
    # The prediction is of noisy samples: 34 dB for a noise of 0.02.
    assert prepared.choice.chosen.predicted == pytest.approx(34.0, abs=0.7)
    assert truth > 40.0


def test_photographs_get_a_high_degree(device, real_data, tmp_path):
    ingest_folder(real_data / "stacks" / "loewenkopf", tmp_path / "stack.h5")
    with open_stack(tmp_path / "stack.h5") as stack:
        fitted, held = split_lights(stack.n_light, 5)
        prepared = prepare_fit(stack.select(fitted), "auto", "auto", device=device)
        psnr = summarize_errors(measure_errors(collect_fit(prepared), stack.select(held))).psnr_pooled
    assert prepared.degree >= 12
    assert psnr >= 34.2
    choice = prepared.choice
    assert psnr == pytest.approx(choice.chosen.predicted, abs=0.5)
    assert psnr == pytest.approx(choice.chosen.in_folds, abs=0.5)
    assert {candidate.method.id for candidate in choice.tried} == {"uls", "sloan", "cls", "ceb", "spline"}


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


@pytest.mark.parametrize("n_light", [2, 3, 4, 7])
def test_few_lights(device, n_light):
    stack = make_scene(1, n_light)
    fitted = fit(stack, "auto", "auto")
    assert np.isfinite(fitted.coeffs_khwc).all()
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
    with pytest.raises(InputError, match="uls at degree 1 has 4 coefficients but there are 3 lights"):
        prepare_fit(stack, "uls", "auto")
    with pytest.raises(InputError, match="needs 2 lights or more, got 1"):
        prepare_fit(stack.select(np.array([1])), "auto", "auto")


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
