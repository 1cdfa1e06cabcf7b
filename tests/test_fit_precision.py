"""Precision as a setting of every fit: float64 against references, float32 without float64, notes and refusals."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from clrelight import device as device_module
from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError, KernelBuildError
from clrelight.fit import collect_fit, fit_tiles, method_class, prepare_fit
from clrelight.fit.precision import differing_precisions
from clrelight.fit.run import rows_per_tile
from clrelight.fit.scaling import round_coefficients
from clrelight.jobs.fit import fit
from clrelight.kernel_source import read_kernel_source
from clrelight.opencl.devices import loaded_devices
from clrelight.sampling import make_pattern
from tests.commands import call, contents, succeed
from tests.reference import basis, spline
from tests.reference import fit as reference
from tests.stacks import FLAT, columns_of, make_samples, make_stack, samples_of
from tests.styles import both_styles

UNIT = 2.0**-24
"""Error of rounding to float32."""
SEARCHES = [{"solver": "newton"}, {"solver": "bisection", "iterations": 64}]


def with_limits(device, **changed):
    """The same device, said to be another than it is, with nothing built yet."""
    _, raw = loaded_devices()[device.info.index]
    return Device(replace(device.info, **changed), raw)


def exact(stack, method, degree, options=None, weight_i=None):
    """Return the coefficients by the references, and lambda or None."""
    options = options or {}
    weight_i = np.ones(stack.n_light) if weight_i is None else weight_i
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, degree), samples_of(stack)
    if method == "project":
        return reference.project(basis_ik, sample_ip, 2.0 * np.pi * weight_i / weight_i.sum()), None
    if method in ("uls", "sloan"):
        kept = np.arange(basis_ik.shape[1]) != (2 if method == "sloan" else -1)
        coeffs_kp = np.zeros((basis_ik.shape[1], sample_ip.shape[1]))
        coeffs_kp[kept] = reference.least_squares(basis_ik[:, kept], sample_ip, weight_i)
        return coeffs_kp, None
    if method == "cls":
        return reference.constrained(basis_ik, sample_ip, weight_i)[:2]
    if method == "spline":
        lams = np.resize(options["lam"], stack.image_shape[2])
        each = [spline.operator(basis_ik, spline.penalty(degree), lam, weight_i) for lam in lams]
        parts = [each[p % len(each)] @ sample_ip[:, p] for p in range(sample_ip.shape[1])]
        return np.stack(parts, axis=1), None
    return reference.truncated(basis_ik, sample_ip, weight_i, crossing=method == "ceb-crossing")[0], None


def check_rounded(found_kp, exact_kp):
    """Check that values are off by no more than the rounding of the result, a tenth of the last place allowed for."""
    assert (np.abs(found_kp - exact_kp) <= UNIT * (1.1 * np.abs(exact_kp) + 0.01 * np.abs(exact_kp).max())).all()


CASES = [
    ("project", {}, 4),
    ("project", {}, 3),
    ("uls", {}, 0),
    ("uls", {}, 4),
    ("sloan", {}, 4),
    *[("cls", options, degree) for options in SEARCHES for degree in (2, 8)],
    ("ceb", {}, 4),
    ("ceb-crossing", {}, 8),
    ("spline", {"lam": 0.1}, 6),
    ("spline", {"lam": [0.1, 1.0, 10.0], "per": "channel"}, 6),
]


@both_styles
@pytest.mark.parametrize(("method", "options", "degree"), CASES)
def test_double_is_off_by_the_rounding_of_its_result(device, method, options, degree):
    stack = make_stack()
    fitted = fit(stack, method, degree, **options, precision="double")
    assert fitted.config["precision"] == "double"
    found_kp, (exact_kp, lambda_p) = columns_of(fitted), exact(stack, method, degree, options)
    # A constant pixel's energy is its bound: chance decides on the last component.
    compared = np.arange(found_kp.shape[1]) != (FLAT if method.startswith("ceb") else -1)
    check_rounded(found_kp[:, compared], exact_kp[:, compared])
    assert np.abs(found_kp - exact_kp)[:, compared].max() < 1e-7 * max(1.0, np.abs(exact_kp).max())
    if lambda_p is not None:
        bent = lambda_p > 1e-6
        np.testing.assert_allclose(fitted.lambda_hwc.ravel()[bent], lambda_p[bent], rtol=1e-6)


@both_styles
@pytest.mark.parametrize("transfer", ["linear", "srgb"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_double_reads_every_sample_in_float64(device, dtype, transfer):
    directions = make_pattern("uniform", 90)
    values = 200.0 * make_samples(directions, (2, 19, 3))
    stack = LightStack((np.rint(values) if dtype[0] == "u" else values).astype(dtype), directions, 201.7, transfer)
    check_rounded(columns_of(fit(stack, "uls", 3, precision="double")), exact(stack, "uls", 3)[0])


@both_styles
@pytest.mark.parametrize("count", [65, 257, 600])
@pytest.mark.parametrize("width", [1, 31, 33, 257])
def test_double_of_any_size(device, width, count):
    stack = make_stack(count, (1, width, 2))
    check_rounded(columns_of(fit(stack, "cls", 4, precision="double")), exact(stack, "cls", 4)[0])


@both_styles
def test_double_with_more_components_than_a_chunk(device):
    stack = make_stack(320, (1, 5, 1))
    # A constant pixel meets its bound at a lambda near 0, where rounding errors of float64 decide too.
    compared = np.arange(5) != FLAT
    fitted = fit(stack, "cls", 17, precision="double")
    check_rounded(columns_of(fitted)[:, compared], exact(stack, "cls", 17)[0][:, compared])


def test_double_with_weights_and_scattered_samples(device):
    weights = 10.0 ** np.random.default_rng(0).uniform(-3, 0, 90)
    stack = make_stack(weights_i=weights)
    fitted = fit(stack, "cls", 4, weights="solid-angle", precision="double")
    check_rounded(columns_of(fitted), exact(stack, "cls", 4, weight_i=weights)[0])
    # Eq. 26 without a decomposition, whose root is found to 1e-13.
    stack = make_stack(directions_i3=make_pattern("scattered", 90, seed=5), shape_hwc=(5, 7, 1))
    fitted = fit(stack, "cls", 3, sampling="scattered", precision="double")
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 3), samples_of(stack)
    angle_i = np.full(90, 2 * np.pi / 90)
    for p in np.flatnonzero(fitted.lambda_hwc.ravel() > 1e-3)[:5]:
        scale_k, energy = np.sqrt(angle_i @ basis_ik**2), angle_i @ sample_ip[:, p] ** 2
        exact_k, _ = reference.constrained_dense(basis_ik, sample_ip[:, p], scale_k, energy)
        assert np.abs(columns_of(fitted)[:, p] - exact_k).max() < 1e-7 * np.abs(exact_k).max()


@both_styles
@pytest.mark.parametrize("peak", [1e-30, 1e30])
def test_double_decodes_extreme_peaks_in_float64(device, peak):
    directions = make_pattern("uniform", 90)
    stack = LightStack((peak * make_samples(directions, (2, 19, 3))).astype(np.float32), directions, peak, "srgb")
    check_rounded(columns_of(fit(stack, "uls", 3, precision="double")), exact(stack, "uls", 3)[0])


@pytest.mark.parametrize("power", [-60, 60, 110])
@pytest.mark.parametrize("method", ["uls", "cls", "ceb"])
def test_double_needs_no_scaling(device, method, power):
    stack = make_stack()
    scaled = replace(stack, images_ihwc=np.ldexp(stack.images_ihwc, power))
    plain, found = (fit(each, method, 4, precision="double") for each in (stack, scaled))
    np.testing.assert_array_equal(found.coeffs_khwc, np.ldexp(plain.coeffs_khwc, power))


def test_coefficients_that_float32_cannot_hold_are_refused(device):
    stack = make_stack()
    huge = replace(stack, images_ihwc=np.full(stack.images_ihwc.shape, 3e38, np.float32))
    for precision in ("mixed", "double"):
        with pytest.raises(InputError, match="coefficients, or images of them, exceed float32"):
            fit(huge, "cls", 2, precision=precision)


@both_styles
@pytest.mark.parametrize("precision", ["single", "double"])
@pytest.mark.parametrize("method", ["project", "cls", "ceb"])
def test_tiles_change_no_bit(device, method, precision):
    stack = make_stack(90, (7, 61, 3))
    prepared = prepare_fit(stack, method, 4, precision=precision)
    real = 8 if precision == "double" else 4
    # Samples being read and fitted, components and the bound, its doubt, coefficients and lambda, those to round.
    column = 4 * 180 + real * (len(prepared.plan.singular_r) + 1) + 4 + 4 * 26
    column += 8 * 25 if precision == "double" and method != "project" else 0
    memory = 2 * 61 * 3 * column
    assert rows_per_tile(prepared, memory) == 2
    assert rows_per_tile(prepared, memory - 1) == 1
    assert len(list(fit_tiles(prepared, memory_bytes=memory))) == 4
    tiled, whole = collect_fit(prepared, memory_bytes=memory), collect_fit(prepared)
    np.testing.assert_array_equal(tiled.coeffs_khwc, whole.coeffs_khwc)
    np.testing.assert_array_equal(tiled.lambda_hwc, whole.lambda_hwc)


def test_double_clears_what_is_masked(device):
    mask_hw = np.arange(5 * 61).reshape(5, 61) % 3 > 0
    fitted = fit(make_stack(mask_hw=mask_hw), "cls", 2, precision="double")
    assert (fitted.coeffs_khwc[:, ~mask_hw] == 0).all()
    assert (fitted.coeffs_khwc[0, mask_hw] != 0).any()


@pytest.fixture
def without_double(monkeypatch):
    """Kernels of a device opened meanwhile do not build where the preprocessor leaves any of these words."""
    words = "".join(f"#define {name} float64_is_used_here\n" for name in ("double", "double8", "double8_at"))
    monkeypatch.setattr(device_module, "read_kernel_source", lambda file: words + read_kernel_source(file))


@both_styles
def test_single_builds_without_any_float64(device, without_double):
    stack = make_stack(shape_hwc=(1, 9, 1))
    bare = with_limits(device)
    for method, options in (("project", {}), ("cls", {}), ("cls", {"solver": "bisection"}), ("ceb", {})):
        fit(stack, method, 2, **options, precision="single", device=bare)
    fit(stack, "spline", 2, per="channel", precision="single", device=bare)
    with pytest.raises(KernelBuildError, match="float64_is_used_here"):
        fit(stack, "cls", 2, precision="double", device=bare)
    if device.style == "cpu":
        with pytest.raises(KernelBuildError, match="float64_is_used_here"):
            fit(stack, "cls", 2, device=bare)


@both_styles
@pytest.mark.parametrize("options", [{}, {"solver": "bisection"}])
def test_single_keeps_image_and_bound(device, options):
    stack = make_stack()
    single, mixed = (fit(stack, "cls", 4, **options, precision=name) for name in ("single", "mixed"))
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, 4), samples_of(stack)
    exact_kp, lambda_p = exact(stack, "cls", 4)
    energy_p = reference.bound(sample_ip, np.ones(90))
    for fitted in (single, mixed):
        assert np.abs(basis_ik @ (columns_of(fitted) - exact_kp)).max() < 2e-6
        assert (np.sum(columns_of(fitted) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()
    # What is solved again in mixed precision is what single precision leaves in doubt.
    bent = lambda_p > 1e-12  # rounding of the reference leaves constant columns a little above 0
    off_single, off_mixed = (np.abs(f.lambda_hwc.ravel()[bent] / lambda_p[bent] - 1).max() for f in (single, mixed))
    assert off_mixed < 3e-5 < 1e-4 < off_single


def test_a_device_without_float64(device):
    stack, bare = make_stack(), with_limits(device, float64=False)
    with pytest.raises(InputError, match=f"precision double needs float64, which {device.info.name[:7]}"):
        fit(stack, "cls", 2, precision="double", device=bare)
    mixed, single = (prepare_fit(stack, "cls", 4, precision=name, device=bare) for name in ("mixed", "single"))
    assert mixed.report.notes[0].endswith("has no float64: mixed precision is single precision here")
    assert mixed.report.notes[1:] == single.report.notes
    np.testing.assert_array_equal(collect_fit(mixed).coeffs_khwc, collect_fit(single).coeffs_khwc)
    assert prepare_fit(stack, "ceb", 4, device=bare).report.notes == []


def test_methods_know_where_single_and_mixed_are_one(device):
    stack, bare = make_stack(shape_hwc=(1, 31, 3)), with_limits(device, float64=False)
    for name, options, refined in (("uls", {}, False), ("ceb", {}, False), ("spline", {"lam": 0.1}, False),
                                   ("cls", {}, True), ("cls", {"iterations": 2}, False)):  # fmt: skip
        method = method_class(name)(**options)
        expected = ["mixed", "single", "double"] if refined else ["mixed", "double"]
        assert differing_precisions(method, device) == expected
        assert differing_precisions(method, bare) == ["mixed"]
        single, mixed = (fit(stack, method, 8, precision=each) for each in ("single", "mixed"))
        assert (single.coeffs_khwc != mixed.coeffs_khwc).any() == refined
        notes = prepare_fit(stack, method, 3, precision="single").report.notes
        assert any("single precision leaves lambda to rounding errors" in note for note in notes) == refined


@pytest.mark.parametrize(("method", "degree", "stays"), [("uls", 8, "rounding"), ("sloan", 12, "cut")])
def test_double_does_not_lift_what_float32_coefficients_limit(device, method, degree, stays):
    stack = make_stack(256, (1, 31, 1))
    mixed, double = (prepare_fit(stack, method, degree, precision=name) for name in ("mixed", "double"))
    note = f"{method}: double precision ends in float32 coefficients all the same, so"
    (added,) = [each for each in double.report.notes if each not in mixed.report.notes]
    assert added.startswith(note)
    assert stays in added
    assert double.plan.synthesis_kr.shape == mixed.plan.synthesis_kr.shape
    # What remains is the rounding of the coefficients, of the components kept.
    exact_kp = double.plan.synthesis_kr @ (double.plan.analysis_ri @ samples_of(stack))
    check_rounded(columns_of(collect_fit(double)), exact_kp)
    assert prepare_fit(stack, method, 3, precision="double").report.notes == []


def test_the_command_takes_and_records_a_precision(tmp_path):
    succeed("synth", "ring", tmp_path / "ring.h5", "--size", 8, "--lights", 30)
    words = ["fit", tmp_path / "ring.h5", tmp_path / "f.h5", "--degree", 2]
    told = succeed(*words, "--precision", "double", "--json").json
    assert told["config"]["precision"] == "double"
    assert succeed(*words, "--json").json["config"]["precision"] == "mixed"
    (tmp_path / "one.toml").write_text('methods = ["cls"]\ndegrees = [2]\nprecision = "single"\n')
    config = ["fit", tmp_path / "ring.h5", tmp_path / "f.h5", "--config", tmp_path / "one.toml"]
    assert succeed(*config, "--json").json["config"]["precision"] == "single"
    (tmp_path / "bad.toml").write_text('precision = "half"\n')
    (tmp_path / "worse.toml").write_text("precision = 64\n")
    before = contents(tmp_path)
    for line, expected in (
        ([*words, "--precision", "quadruple"], "precision must be one of mixed, single, double, got 'quadruple'"),
        ([*config, "--precision", "double"], "--precision: "),
        (["bench", tmp_path / "ring.h5", "--precision", "half"], "precision must be one of mixed, single, double"),
        (["bench", tmp_path / "one.toml", "--precision", "double"], "--precision: "),
        (["bench", "--speed", "--precision", "double"], "--precision is an option of experiments, not of --speed"),
        (["bench", tmp_path / "bad.toml"], "precision must be one of mixed, single, double, got 'half'"),
        (["bench", tmp_path / "worse.toml"], "precision must be text, got 64"),
    ):
        ended = call(*line)
        assert (ended.code, ended.out, ended.err.count("\n")) == (2, "", 1), ended.err
        assert expected in ended.err
        assert contents(tmp_path) == before


def test_a_row_of_bench_knows_its_precision(tmp_path):
    for name in ("mixed", "double"):
        (tmp_path / f"{name}.toml").write_text(
            f'methods = ["cls"]\ndegrees = [2]\nprecision = "{name}"\n[ring]\nsize = 8\nlights = 30\n'
        )
    out = ["--out", tmp_path / "r.h5", "--json"]
    (mixed,) = succeed("bench", tmp_path / "mixed.toml", *out).json["rows"]
    first, second = succeed("bench", tmp_path / "double.toml", *out).json["rows"]
    assert first == mixed
    assert "precision" not in first["fit_config"]
    assert '"precision":"double"' in second["fit_config"]
    assert second["psnr_mean"] == pytest.approx(first["psnr_mean"], abs=1e-3)
    assert len(succeed("bench", tmp_path / "double.toml", *out).json["rows"]) == 2
    small = ["--size", 8, "--lights", 30, "--methods", "cls", "--degrees", 2, "--codecs", "none"]
    assert len(succeed("bench", "ring", *small, "--precision", "double", *out).json["rows"]) == 2


def test_rounding_takes_no_memory_beside_the_tile():
    """A tile's bytes are counted, and magnitudes of it would be as much again."""
    values_kp, out_kp = np.full((9, 1 << 17), -0.1), np.empty((9, 1 << 17), np.float32)
    tracemalloc.start()
    round_coefficients(values_kp, out_kp)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < out_kp.nbytes / 8
    for bad in (np.nan, -np.inf, -1e39):
        values_kp[3, 5] = bad
        with pytest.raises(InputError, match="float32"):
            round_coefficients(values_kp, out_kp)
