import json
from dataclasses import replace

import numpy as np
import pytest

import clrelight as cr
from clrelight.dataset import FitRecord, LightStack
from clrelight.errors import InputError
from clrelight.fit.recursive import plan_update
from clrelight.jobs.fit import fit
from clrelight.jobs.update import update_fit
from clrelight.sampling import make_pattern
from clrelight.store import read_fit, write_stack
from tests.commands import attributes, call, succeed
from tests.reference import basis
from tests.stacks import columns_of, make_stack

OLD, NEW = np.arange(0, 60), np.arange(60, 90)


def shuffled_stack(**options):
    """Lights in an order in which the first 60 cover the hemisphere."""
    stack = make_stack(**options)
    return stack.select(np.random.default_rng(3).permutation(stack.n_light))


def image_error(fitted, other, directions_i3):
    values_ik = basis.real_harmonics(directions_i3, fitted.degree)
    return np.abs(values_ik @ (columns_of(fitted) - columns_of(other))).max()


@pytest.mark.parametrize(
    ("method", "options"), [("uls", {}), ("sloan", {}), ("spline", {"lam": 1e-3}), ("spline", {"lam": 1e-6})]
)
@pytest.mark.parametrize("degree", [1, 3, 5])
def test_it_is_the_fit_of_all(device, method, options, degree):
    stack = shuffled_stack(shape_hwc=(3, 11, 3))
    old = fit(stack.select(OLD), method, degree, **options)
    grown = update_fit(old, stack.select(NEW))
    every = fit(stack, method, degree, **options)
    assert image_error(old, every, stack.directions_i3) > 1e-3
    norm = np.linalg.norm(columns_of(every), axis=0).max()
    assert np.abs(columns_of(grown) - columns_of(every)).max() < 2e-6 * max(norm, 1.0)
    assert image_error(grown, every, stack.directions_i3) < 2e-6 * max(norm, 1.0)
    np.testing.assert_array_equal(grown.directions_i3, stack.directions_i3)


def test_one_photograph_after_another(device):
    stack = shuffled_stack(shape_hwc=(1, 11, 3))
    grown = fit(stack.select(OLD), "uls", 3)
    for light in NEW:
        grown = update_fit(grown, stack.select(np.array([light])))
    every = fit(stack, "uls", 3)
    np.testing.assert_allclose(columns_of(grown), columns_of(every), atol=1e-5)


def test_gain_is_that_of_the_normal_equations():
    stack = shuffled_stack(shape_hwc=(1, 2, 3))
    y_old, y_new = (basis.real_harmonics(stack.directions_i3[lights], 3) for lights in (OLD, NEW))
    record = FitRecord(3, "uls", 1.0, "linear", stack.directions_i3[OLD], {"weights": "uniform"}, "stack")
    update = plan_update(record, stack.directions_i3[NEW])
    expected = np.linalg.solve(y_old.T @ y_old + y_new.T @ y_new, y_new.T)
    np.testing.assert_allclose(update.gain_ki, expected, atol=1e-12)


def test_srgb_masks_and_tiles(device):
    stack = shuffled_stack(shape_hwc=(7, 13, 3))
    mask = np.ones((7, 13), bool)
    mask[2:4, 3:9] = False
    codes = np.rint(255 * np.clip(stack.images_ihwc, 0, 1)).astype(np.uint8)
    stack = LightStack(codes, stack.directions_i3, 255.0, "srgb", mask_hw=mask)
    grown = update_fit(fit(stack.select(OLD), "spline", 4, lam=1e-3), stack.select(NEW), memory=100_000)
    every = fit(stack, "spline", 4, lam=1e-3)
    np.testing.assert_allclose(columns_of(grown), columns_of(every), atol=2e-6)
    assert (grown.coeffs_khwc[:, ~mask] == 0).all()


def test_photographs_of_one_light_share_its_weight(device):
    stack = shuffled_stack(shape_hwc=(1, 11, 3))
    twice = stack.select(np.concatenate([OLD, OLD[:5], NEW, NEW[:7]]))
    old = fit(twice.select(np.arange(65)), "uls", 3)
    grown = update_fit(old, twice.select(np.arange(65, twice.n_light)))
    np.testing.assert_allclose(columns_of(grown), columns_of(fit(twice, "uls", 3)), atol=5e-6)
    with pytest.raises(InputError, match="new light 2 has the direction of the fit's light 0"):
        update_fit(fit(stack.select(OLD), "uls", 3), stack.select(np.array([60, 61, 0])))


def test_spline_notes_that_its_lambda_stays(device):
    stack = shuffled_stack(shape_hwc=(2, 11, 3))
    old = fit(stack.select(OLD), "spline", 3)
    with pytest.warns(match="lambda stays that of the old photographs"):
        grown = update_fit(old, stack.select(NEW))
    assert grown.config["lam"] == old.config["lam"]


def test_a_fit_by_cls_does_not_settle_that_of_more_photographs(device):
    """Samples apart by what no coefficient sees: the same fit where lambda is 0, and other fits with more of them."""
    rng, lights_i3 = np.random.default_rng(7), make_pattern("uniform", 40)
    old_i3, new_i3 = lights_i3[::2], lights_i3[1::2]
    values_ik = basis.real_harmonics(old_i3, 3)
    coeffs_k = np.r_[1.0, 0.3 * rng.standard_normal(3), 0.1 * rng.standard_normal(12)]
    first_i = values_ik @ coeffs_k
    unseen_in = np.linalg.svd(values_ik)[0][:, values_ik.shape[1] :]
    apart_i = unseen_in @ rng.standard_normal(unseen_in.shape[1])
    apart_i *= 0.9 * np.min(first_i[apart_i < 0.0] / -apart_i[apart_i < 0.0])
    samples_ip = np.stack([first_i, first_i + apart_i], axis=1)
    more_ip = np.tile(rng.random((20, 1)), 2)

    def by_cls(at_i3, seen_ip):
        stack = LightStack(seen_ip[:, None, :, None], at_i3, 1.0, "linear")
        return fit(stack, "cls", 3, precision="double")

    old = by_cls(old_i3, samples_ip)
    every = by_cls(np.concatenate([old_i3, new_i3]), np.concatenate([samples_ip, more_ip]))
    assert not old.lambda_hwc.any()
    np.testing.assert_allclose(columns_of(old)[:, 0], columns_of(old)[:, 1], atol=1e-6)
    assert (every.lambda_hwc > 0.0).all()
    assert np.linalg.norm(np.subtract(*columns_of(every).T)) > 0.1


@pytest.mark.parametrize("method", ["cls", "ceb", "spectrum", "project", "constrained"])
def test_other_methods_are_refused(device, method):
    stack = shuffled_stack(shape_hwc=(1, 5, 3))
    with pytest.raises(InputError, match=f"a fit by {method}, which does not keep .* uls, sloan, spline, which can"):
        update_fit(fit(stack.select(OLD), method, 2), stack.select(NEW))


def test_what_cannot_be_added_is_refused(device):
    stack = shuffled_stack(shape_hwc=(1, 5, 3))
    old, new = fit(stack.select(OLD), "uls", 2), stack.select(NEW)
    with pytest.raises(InputError, match="the new photographs are 1 × 4 × 3, the fit is 1 × 5 × 3"):
        update_fit(old, LightStack(new.images_ihwc[:, :, :4], new.directions_i3, 1.0))
    with pytest.raises(InputError, match="new photographs have peak 2 and transfer linear, the fit peak 1 and linear"):
        update_fit(old, replace(new, peak=2.0))
    weighted = replace(old, config={**old.config, "weights": "solid-angle"})
    with pytest.raises(InputError, match="only uniform weights can grow"):
        update_fit(weighted, new)
    with pytest.raises(InputError, match="a lambda for each channel cannot grow"):
        update_fit(fit(stack.select(OLD), "spline", 2, per="channel"), new)
    with pytest.raises(InputError, match="more than the budget"):
        update_fit(old, new, memory=1000)


def test_a_cut_fit_has_lost_what_its_photographs_said(device):
    lights = make_stack().directions_i3 * [0.05, 0.05, 0.05] + [0.0, 0.0, 1.0]
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    cap = make_stack(directions_i3=lights, shape_hwc=(1, 3, 3))
    with pytest.warns(match="truncated"):
        old = fit(cap.select(OLD), "uls", 6)
    with pytest.raises(InputError, match=r"uls left out \d+ of 49 components at the old lights"):
        update_fit(old, cap.select(NEW))


def test_the_command(tmp_path):
    stack = shuffled_stack(shape_hwc=(4, 9, 3))
    names = [tmp_path / f"{which}.h5" for which in ("old", "new", "all", "fit", "grown", "every")]
    for path, lights in zip(names[:3], (OLD, NEW, np.arange(90)), strict=True):
        write_stack(path, stack.select(lights))
    old, new, every, fitted, grown, whole = names
    succeed("fit", old, fitted, "--method", "uls", "--degree", 3)
    succeed("fit", every, whole, "--method", "uls", "--degree", 3)
    told = succeed("fit", new, grown, "--update", fitted, "--json").json
    assert (told["n_light"], told["n_new"], told["method"]) == (90, 30, "uls")
    assert told["psnr"]["mean_fitted"] > 10
    np.testing.assert_allclose(read_fit(grown).coeffs_khwc, read_fit(whole).coeffs_khwc, atol=1e-5)
    assert "holdout" not in json.loads(attributes(grown)["config"])
    ended = call("fit", new, tmp_path / "x.h5", "--update", fitted, "--degree", 4)
    assert (ended.code, "--degree:" in ended.err) == (2, True)
    assert not (tmp_path / "x.h5").exists()
    ended = call("fit", new, fitted, "--update", fitted)
    assert ended.code == 2
    assert cr.update_fit is update_fit


def test_another_mask_is_no_silent_change(device):
    stack = shuffled_stack(shape_hwc=(3, 5, 3))
    mask = np.ones((3, 5), bool)
    mask[1, 2] = False
    old, new = stack.select(OLD), stack.select(NEW)
    with pytest.raises(InputError, match="leaves out the pixel at row 1, column 2, which the fit has"):
        update_fit(fit(old, "uls", 2), replace(new, mask_hw=mask))
    with pytest.warns(match="1 pixel is 0 in the fit and not in the new photographs"):
        update_fit(fit(replace(old, mask_hw=mask), "uls", 2), new)


def test_coefficients_that_were_of_another_basis_are_refused_by_name(device):
    stack = shuffled_stack(shape_hwc=(1, 5, 3))
    made = cr.to_sh(fit(stack.select(OLD), "uls", 2, basis="gram-schmidt"))
    with pytest.raises(InputError, match="this was a fit of basis gram-schmidt"):
        update_fit(made, stack.select(NEW))
