import json

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.errors import InputError
from clrelight.fit import method_class, prepare_fit
from clrelight.fit.plan import make_lighting
from clrelight.fit.samples import Samples
from clrelight.fit.spline import SmoothingSpline, minimize_gcv
from clrelight.harmonics.basis import evaluate_basis
from clrelight.jobs.fit import fit
from clrelight.sampling import make_pattern
from tests.reference import spline as reference
from tests.styles import both_styles

EPS32 = 2.0**-23


def make_stack(n_light=70, shape_hwc=(4, 23, 3), noise=0.05, seed=0, dtype=np.uint8, **fields):
    """Shaded, shadowed and noisy columns."""
    rng = np.random.default_rng(seed)
    directions = make_pattern("uniform", n_light)
    normals = rng.standard_normal((3, int(np.prod(shape_hwc))))
    lit = np.maximum(directions @ (normals / np.linalg.norm(normals, axis=0)), 0.0)
    value = np.clip(0.8 * lit + 0.1 + noise * rng.standard_normal(lit.shape), 0.0, 1.0)
    peak = 1.0 if np.dtype(dtype).kind == "f" else float(np.iinfo(dtype).max)
    images = (value * peak if peak == 1.0 else np.rint(value * peak)).astype(dtype).reshape(n_light, *shape_hwc)
    return LightStack(images, directions, peak, **fields)


def columns(stack):
    return np.asarray(stack.images_ihwc, np.float64).reshape(stack.n_light, -1) / stack.peak


def uneven(n_light):
    return np.random.default_rng(n_light).random(n_light) + 0.05


@pytest.mark.parametrize("degree", [0, 1, 6, 15])
@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
@pytest.mark.parametrize("lam", [1e-6, 1e-2, 10.0])
def test_spline_is_the_dense_solution(device, degree, weights, lam):
    stack = make_stack(weights_i=uneven(70))
    weights_i = stack.weights_i if weights == "solid-angle" else np.ones(70)
    prepared = prepare_fit(stack, "spline", degree, options={"lam": lam}, weights=weights, device=device)
    found_kp = fit(stack, "spline", degree, lam=lam, weights=weights).coeffs_khwc.reshape(-1, 4 * 23 * 3)
    basis_ik = evaluate_basis(stack.directions_i3, degree)
    exact_kp = reference.operator(basis_ik, reference.penalty(degree), lam, weights_i) @ columns(stack)
    size_kp = np.abs(prepared.plan.synthesis_kr) @ (np.abs(prepared.plan.analysis_ri) @ columns(stack))
    assert (np.abs(found_kp - exact_kp) <= 20 * EPS32 * size_kp).all()
    # Rounding stays harmless in the image too, whatever the basis' condition.
    assert np.abs(basis_ik @ (found_kp - exact_kp)).max() < 3e-6


@both_styles
def test_each_channel_may_have_its_own_lambda(device):
    lam = (1e-4, 1e-1, 10.0)
    stack = make_stack(shape_hwc=(3, 37, 3))
    fitted = fit(stack, "spline", 5, lam=list(lam), per="channel")
    assert fitted.config["lam"] == list(lam)
    basis_ik, penalty_kk = evaluate_basis(stack.directions_i3, 5), reference.penalty(5)
    for c in range(3):
        exact_kp = reference.operator(basis_ik, penalty_kk, lam[c], np.ones(70)) @ columns(stack)[:, c::3]
        np.testing.assert_allclose(fitted.coeffs_khwc[..., c].reshape(36, -1), exact_kp, atol=3e-6)


@pytest.mark.parametrize(("n_light", "noise"), [(70, 0.05), (70, 0.3), (150, 0.02)])
@pytest.mark.parametrize("weights", ["uniform", "solid-angle"])
def test_lambda_minimises_cross_validation(device, n_light, noise, weights):
    stack = make_stack(n_light, noise=noise, dtype=np.float32, weights_i=uneven(n_light))
    weights_i = stack.weights_i if weights == "solid-angle" else np.ones(n_light)
    config = prepare_fit(stack, "spline", 15, weights=weights, device=device).config
    arguments = evaluate_basis(stack.directions_i3, 15), reference.penalty(15)
    assert config["lam"] > 1e-9  # not the end of the range
    grid = config["lam"] * 10.0 ** np.arange(-3, 3.01, 0.25)
    values = [reference.gcv(*arguments, lam, weights_i, columns(stack)) for lam in grid]
    least = reference.gcv(*arguments, config["lam"], weights_i, columns(stack))
    assert least <= min(values) * (1 + 1e-6)
    assert max(values) > 1.05 * least  # there is something to minimise


def test_lambda_of_a_channel_is_that_of_its_samples_alone(device):
    stack = make_stack(dtype=np.float32)
    noise = np.random.default_rng(1).random(stack.images_ihwc[..., 2].shape)
    stack.images_ihwc[..., 2] = 0.7 * stack.images_ihwc[..., 2] + 0.3 * noise
    found = prepare_fit(stack, "spline", 8, options={"per": "channel"}, device=device).config["lam"]
    for c in range(3):
        alone = LightStack(stack.images_ihwc[..., c : c + 1], stack.directions_i3, 1.0)
        assert prepare_fit(alone, "spline", 8, device=device).config["lam"] == pytest.approx(found[c], rel=1e-3)
    assert found[2] > 2 * found[0]


def test_a_minimum_inside_counts_before_the_end_where_every_sample_is_met():
    # As many components as lights; the last has no energy, so that V goes to 0 with lambda.
    singular = 10.0 ** np.array([0.0, -0.1, -0.2, -1.8, -2.2, -3.2, -4.0])
    energy = np.array([1.0, 1.0, 1.0, 1e-4, 1e-4, 3e-4, 1e-16])

    def value(lam):
        left = lam / (singular**2 + lam)
        return (left**2 * energy).sum() / left.sum() ** 2

    found = minimize_gcv(singular, energy, 0.0, 7)
    assert value(1e-10) < 0.5 * value(found)
    assert value(found) <= min(value(found * step) for step in (0.5, 0.9, 1.1, 2.0))
    assert found > 1e-9


def test_lambda_at_low_degree_is_that_of_the_scene(device):
    # Own cross-validation at a low degree would leave lambda near 0 and coefficients as large as those of uls.
    stack = make_stack(120, (2, 23, 3), noise=0.02)
    low, high = (prepare_fit(stack, "spline", degree, device=device).config["lam"] for degree in (3, 15))
    assert low == high
    energy = {method: (fit(stack, method, 6).coeffs_khwc ** 2).sum() for method in ("uls", "cls", "spline")}
    assert energy["spline"] < energy["cls"] < energy["uls"]


def test_an_exact_smooth_scene_needs_next_to_no_smoothing(device):
    directions = make_pattern("uniform", 120)
    coeffs = np.zeros((9, 40))
    coeffs[0], coeffs[1:] = 2.0, 0.2 * np.random.default_rng(3).standard_normal((8, 40))
    images = (evaluate_basis(directions, 2) @ coeffs).astype(np.float32)
    fitted = fit(LightStack(images.reshape(120, 1, 40, 1), directions, 1.0), "spline", 2)
    np.testing.assert_allclose(fitted.coeffs_khwc.reshape(9, 40), coeffs, atol=2e-3)


def test_black_single_and_masked(device):
    black = LightStack(np.zeros((20, 2, 3, 3), np.uint8), make_pattern("uniform", 20), 255.0)
    assert not fit(black, "spline", 4).coeffs_khwc.any()
    one = LightStack(np.full((1, 2, 3, 1), 90, np.uint8), np.array([[0.0, 0.0, 1.0]]), 255.0)
    assert np.isfinite(fit(one, "spline", 4).coeffs_khwc).all()
    mask = np.zeros((4, 23), bool)
    mask[1:3, 5:20] = True
    stack = make_stack(mask_hw=mask)
    wild = stack.images_ihwc.copy()
    wild[:, ~mask] = np.random.default_rng(0).integers(0, 256, wild[:, ~mask].shape)
    other = LightStack(wild, stack.directions_i3, 255.0, mask_hw=mask)
    first, second = (fit(s, "spline", 6) for s in (stack, other))
    assert first.config == second.config
    np.testing.assert_array_equal(first.coeffs_khwc, second.coeffs_khwc)
    assert not first.coeffs_khwc[:, ~mask].any()


def test_scattered_sampling_changes_nothing(device):
    directions = make_pattern("scattered", 60)
    stack = make_stack(60)
    stack = LightStack(stack.images_ihwc, directions, 255.0)
    first, second = (fit(stack, "spline", 8, sampling=s) for s in ("hemisphere", "scattered"))
    np.testing.assert_array_equal(first.coeffs_khwc, second.coeffs_khwc)


def test_what_is_recorded_fits_again(device):
    stack = make_stack()
    for per in ("stack", "channel"):
        fitted = fit(stack, "spline", 7, per=per)
        config = json.loads(json.dumps(fitted.config))
        again = method_class("spline").from_config({name: config[name] for name in ("lam", "per")})
        assert again.to_config() == {name: config[name] for name in ("lam", "per")}
        np.testing.assert_array_equal(fit(stack, again, 7).coeffs_khwc, fitted.coeffs_khwc)
        assert config["lam"] is not None
    assert f"lambda {config['lam'][0]:.3g}" in prepare_fit(stack, again, 7).report.notes[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"lam": 0.0}, "lam must be a positive number, got 0.0"),
        ({"lam": float("nan")}, "lam must be a positive number"),
        ({"lam": "auto"}, "lam must be a positive number, got 'auto'"),
        ({"lam": [1.0, 2.0, 3.0]}, "lam must be one number where per is stack"),
        ({"lam": [1.0, 2.0], "per": "channel"}, "one number for each of 3 channels, got 2"),
        ({"per": "tile"}, "per must be stack or channel, got 'tile'"),
        ({"energy": 1.0}, "method spline has no option 'energy'; it has: lam, per"),
    ],
)
def test_bad_options(device, options, message):
    with pytest.raises(InputError, match=message.replace("(", r"\(")):
        prepare_fit(make_stack(), "spline", 3, options=options)


class Unread:
    shape, dtype = (20, 2, 3, 3), np.dtype(np.uint8)

    def __getitem__(self, key):
        raise RuntimeError("read")


def test_only_a_method_that_needs_samples_reads_them_when_it_is_prepared(device):
    stack = LightStack(Unread(), make_pattern("uniform", 20), 255.0)
    for method, options in (("uls", {}), ("cls", {}), ("spline", {"lam": 1.0})):
        prepare_fit(stack, method, 2, options=options)
    with pytest.raises(RuntimeError, match="read"):
        prepare_fit(stack, "spline", 2)
    with pytest.raises(ValueError, match="not settled"):
        SmoothingSpline().plan(make_lighting(stack, "uniform", "hemisphere"), 2)


@pytest.mark.parametrize("shape", [(1, 1), (300, 1), (1, 300), (97, 131)])
@pytest.mark.parametrize("max_columns", [1, 30, 999, 10**6])
def test_samples_are_distinct_pixels_spread_over_the_mask(shape, max_columns):
    pixels = np.arange(shape[0] * shape[1], dtype=np.float32).reshape(1, *shape, 1)
    stack = LightStack(np.repeat(pixels, 3, axis=3), np.array([[0.0, 0.0, 1.0]]), 1.0)
    row, column = np.indices(shape)
    line = row == column * shape[0] // shape[1]  # thin: between the points of a lattice
    for mask in (None, (row + column) % 2 == 0, line):
        taken = Samples(LightStack(stack.images_ihwc, stack.directions_i3, 1.0, mask_hw=mask), max_columns)
        found = taken.stack.images_ihwc[0, 0, :, 0].astype(int)
        inside = np.flatnonzero(np.ones(shape, bool) if mask is None else mask)
        assert len(np.unique(found)) == len(found)
        assert np.isin(found, inside).all()
        wanted = max(1, max_columns // 3)
        assert min(len(inside), wanted) <= 2 * len(found) <= 2 * wanted
        assert taken.encoded_ip.shape == (1, 3 * len(found))
        thin = taken.thin(max_columns // 3).stack.images_ihwc[0, 0, :, 0]
        assert 1 <= len(thin) <= max(1, max_columns // 9)
        assert np.isin(thin, found).all()
    empty = Samples(LightStack(stack.images_ihwc, stack.directions_i3, 1.0, mask_hw=np.zeros(shape, bool)))
    with pytest.raises(InputError, match="the mask leaves no pixel"):
        empty.thin(1)
