"""What holds for every fit: sample types, tiles, order of pixels, masks, held-out lights, wrong requests."""

import gc
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from clrelight.dataset import LightStack
from clrelight.device import Device
from clrelight.errors import InputError
from clrelight.fit import FitMethod, fit_tiles, method_class, method_ids, prepare_fit, register
from clrelight.fit.run import collect_fit, rows_per_tile
from clrelight.jobs.fit import fit
from clrelight.opencl import devices as device_module
from clrelight.sampling import make_pattern
from clrelight.tiles import LightSubset
from tests.reference.basis import real_harmonics
from tests.stacks import columns_of, make_samples, make_stack, samples_of

METHODS = ["project", "uls", "sloan", "cls", "ceb", "ceb-crossing"]
MAPS = ("coeffs_khwc", "lambda_hwc", "rank_hwc")


def assert_same(a, b):
    for name in MAPS:
        first, second = getattr(a, name), getattr(b, name)
        assert (first is None) == (second is None)
        if first is not None:
            np.testing.assert_array_equal(first, second, strict=True)


def codes(dtype, shape_hwc=(5, 61, 3)):
    """Whole numbers to 255, which all sample types hold exactly."""
    directions = make_pattern("uniform", 90)
    values = np.rint(255 * make_samples(directions, shape_hwc)).astype(dtype)
    return LightStack(values, directions, 255.0)


def test_the_paper_s_methods_in_order():
    assert [name for name in method_ids() if name in METHODS] == METHODS
    with pytest.raises(InputError, match=r"unknown method 'cbl'; known are project, uls, sloan, cls, ceb"):
        method_class("cbl")


@pytest.mark.parametrize("name", METHODS)
def test_options_survive_their_config(name):
    method = method_class(name)()
    assert method_class(name).from_config(method.to_config()) == method
    with pytest.raises(InputError, match=f"method {name} has no option 'speed'"):
        method_class(name).from_config({"speed": 1})


def test_an_id_is_taken_once():
    @dataclass(frozen=True)
    class Impostor(FitMethod):
        id: ClassVar[str] = "cls"

        def plan(self, lighting, degree):
            raise NotImplementedError

    with pytest.raises(ValueError, match="a fit 'cls' is registered already"):
        register(Impostor)
    assert method_class("cls") is not Impostor


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("dtype", ["uint16", "float16", "float32"])
def test_equal_values_of_any_type_fit_equally(device, dtype, method):
    assert_same(fit(codes(dtype), method, 4), fit(codes("uint8"), method, 4))


@pytest.mark.parametrize("method", ["uls", "cls"])
@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float16", "float32"])
def test_srgb_is_decoded(device, dtype, method):
    encoded = replace(codes(dtype), transfer="srgb")
    code = encoded.images_ihwc.astype(np.float64) / 255.0
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    reference = fit(LightStack(linear.astype(np.float32), encoded.directions_i3, 1.0), method, 4)
    fitted = fit(encoded, method, 4)
    assert (fitted.transfer, reference.transfer) == ("srgb", "linear")
    if np.dtype(dtype).kind == "u":
        assert_same(fitted, reference)  # by a table
    else:
        size = np.linalg.norm(columns_of(reference), axis=0) + 1.0
        assert (np.abs(columns_of(fitted) - columns_of(reference)) <= 1e-5 * size).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("rows", [1, 2, 3])
def test_tiles_change_no_bit(device, rows, method):
    stack = make_stack(90, (7, 61, 3))
    prepared = prepare_fit(stack, method, 4)
    # Samples being read and samples being fitted, components, the bound and its doubt, coefficients and a lambda.
    memory = rows * 61 * 3 * 4 * (90 + 90 + len(prepared.plan.singular_r) + 2 + 25 + 1)
    assert rows_per_tile(prepared, memory) == rows
    assert rows_per_tile(prepared, memory + 10**9) == 7
    assert [(t.first, t.end) for t in fit_tiles(prepared, memory_bytes=memory)] == [
        (first, min(first + rows, 7)) for first in range(0, 7, rows)
    ]
    done = []
    tiled = collect_fit(prepared, memory_bytes=memory, progress=lambda *step: done.append(step))
    assert done == [(min(first + rows, 7), 7) for first in range(0, 7, rows)]
    assert_same(tiled, fit(stack, method, 4))


def test_a_row_beyond_the_memory_budget():
    # 90 samples that are read and 90 that are fitted, 9 components, the bound and its doubt, 9 coefficients, a lambda.
    row = 61 * 3 * 4 * (90 + 90 + 9 + 2 + 9 + 1)
    with pytest.raises(InputError, match=f"this fit takes {row} bytes, more than the memory budget {row - 1}"):
        fit(make_stack(90, (3, 61, 3)), "uls", 2, memory=row - 1)


def with_limits(device, **changed):
    """The same device, said to be another than it is."""
    _, raw = device_module.loaded_devices()[device.info.index]
    return Device(replace(device.info, **changed), raw)


@pytest.mark.parametrize("method", METHODS)
def test_a_device_with_its_own_memory(device, method):
    # Newton on a CPU is one kernel of its own, equal but for rounding: see test_fit_cls.py.
    options = {"solver": "bisection"} if method == "cls" else {}
    there = fit(make_stack(), method, 4, **options, device=with_limits(device, kind="gpu"))
    assert_same(there, fit(make_stack(), method, 4, **options, device=device))


@pytest.mark.parametrize("solver", ["bisection", "newton"])
def test_a_device_without_float64(device, solver):
    stack = make_stack()
    options = {"solver": solver}
    single = fit(stack, "cls", 4, **options, device=with_limits(device, float64=False))
    double = fit(stack, "cls", 4, **options, device=device)
    assert (single.lambda_hwc != double.lambda_hwc).any()
    image_ip = real_harmonics(stack.directions_i3, 4) @ (columns_of(single) - columns_of(double))
    assert np.abs(image_ip).max() < 1e-5
    energy_p = 4 * np.pi * np.mean(np.square(samples_of(stack)), axis=0)
    assert (np.sum(columns_of(single) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()


@pytest.mark.parametrize("method", METHODS)
def test_the_same_twice(device, method):
    assert_same(fit(make_stack(), method, 6), fit(make_stack(), method, 6))


@pytest.mark.parametrize("method", METHODS)
def test_pixels_do_not_know_their_place(device, method):
    stack = make_stack()
    order = np.random.default_rng(0).permutation(5 * 61 * 3)
    shuffled = stack.images_ihwc.reshape(90, -1)[:, order].reshape(stack.images_ihwc.shape)
    moved, still = fit(replace(stack, images_ihwc=shuffled), method, 4), fit(stack, method, 4)
    for name in MAPS:
        values = getattr(still, name)
        if values is not None:
            flat = values.reshape(*values.shape[:-3], -1)[..., order]
            np.testing.assert_array_equal(getattr(moved, name).reshape(flat.shape), flat)


@pytest.mark.parametrize("method", METHODS)
def test_coefficients_scale_with_brightness(device, method):
    # Powers of two are exact in floating point: everything but lambda and the ranks is proportional.
    stack = make_stack()
    dim, bright = fit(stack, method, 4), fit(replace(stack, images_ihwc=stack.images_ihwc * np.float32(4)), method, 4)
    np.testing.assert_array_equal(bright.coeffs_khwc, 4 * dim.coeffs_khwc)
    if dim.lambda_hwc is not None:
        np.testing.assert_array_equal(bright.lambda_hwc, dim.lambda_hwc)
    if dim.rank_hwc is not None:
        np.testing.assert_array_equal(bright.rank_hwc, dim.rank_hwc)


@pytest.mark.parametrize("method", METHODS)
def test_masked_pixels_are_zero_and_others_as_ever(device, method):
    mask = np.random.default_rng(1).random((5, 61)) < 0.6
    stack = make_stack()
    masked, whole = fit(replace(stack, mask_hw=mask), method, 4), fit(stack, method, 4)
    for name in MAPS:
        values = getattr(masked, name)
        if values is not None:
            assert (values[..., ~mask, :] == 0).all()
            np.testing.assert_array_equal(values[..., mask, :], getattr(whole, name)[..., mask, :])


def test_holdout_leaves_every_kth_light_out(device):
    stack = make_stack(80)
    kept = np.arange(80) % 4 != 3
    fitted = fit(stack, "cls", 4, holdout=4)
    np.testing.assert_array_equal(fitted.directions_i3, stack.directions_i3[kept])
    assert_same(fitted, fit(stack.select(np.flatnonzero(kept)), "cls", 4))


class FileLike:
    """An image dataset that is no NumPy array."""

    def __init__(self, images_ihwc):
        self.shape, self.dtype = images_ihwc.shape, images_ihwc.dtype
        self._images = images_ihwc

    def __getitem__(self, key):
        return self._images[key].copy()


@pytest.mark.parametrize("holdout", [None, 5])
def test_datasets_are_read_like_arrays(device, holdout):
    stack = make_stack()
    lazy = replace(stack, images_ihwc=FileLike(stack.images_ihwc))
    assert_same(fit(lazy, "cls", 4, holdout=holdout), fit(stack, "cls", 4, holdout=holdout))
    subset = lazy.select(np.array([7, 2, 2])).images_ihwc
    assert isinstance(subset, LightSubset)
    np.testing.assert_array_equal(subset[1:, 2:4], stack.images_ihwc[[2, 2], 2:4])


def test_a_map_knows_how_it_was_made(device):
    stack = replace(make_stack(), peak=2.0, name="vase")
    fitted = fit(stack, "cls", 2, energy=0.5, weights="solid-angle")
    assert (fitted.method, fitted.degree, fitted.peak, fitted.name) == ("cls", 2, 2.0, "vase")
    assert fitted.config == {
        "energy": 0.5,
        "iterations": 32,
        "solver": "newton",
        "weights": "solid-angle",
        "sampling": "hemisphere",
        "precision": "mixed",
    }


def test_values_are_in_units_of_the_peak(device):
    stack = make_stack()
    halved = fit(replace(stack, peak=2.0), "cls", 4)
    np.testing.assert_array_equal(2 * halved.coeffs_khwc, fit(stack, "cls", 4).coeffs_khwc)


def test_stages_are_timed(device):
    prepared = prepare_fit(make_stack(), "cls", 4, options={"solver": "bisection"})
    collect_fit(prepared)
    assert list(prepared.report.seconds) == ["plan", "read", "project", "shrink", "synthesize"]
    assert min(prepared.report.seconds.values()) > 0
    singular = np.linalg.svd(prepared.plan.synthesis_kr)[1]
    np.testing.assert_allclose(singular, 1.0, rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"degree": -1}, "degree must be auto or 0 to 100, got -1"),
        ({"degree": 101}, "degree must be auto or 0 to 100, got 101"),
        ({"method": "nnls"}, "unknown method 'nnls'; known are"),
        ({"weights": "area"}, "weights must be one of uniform, solid-angle, got 'area'"),
        ({"precision": "half"}, "precision must be one of mixed, single, double, got 'half'"),
        ({"sampling": "sphere"}, "sampling must be one of hemisphere, scattered, got 'sphere'"),
        ({"method": "project", "fill": "noise"}, "fill must be zero or mirror, got 'noise'"),
        ({"energie": 2}, "method cls has no option 'energie'"),
        ({"holdout": 1}, "holdout must be at least 2"),
        ({"holdout": 91}, "holdout 91 keeps no light out of 90; use at most 90"),
    ],
)
def test_requests_that_make_no_sense(arguments, message):
    with pytest.raises(InputError, match=message):
        fit(make_stack(90, (1, 2, 1)), **{"method": "cls", "degree": 2, **arguments})


def test_options_beside_a_ready_method():
    with pytest.raises(InputError, match="options belong to a method given by its id"):
        prepare_fit(make_stack(9, (1, 2, 1)), method_class("cls")(energy=2.0), 2, options={"energy": 0.5})
    assert prepare_fit(make_stack(9, (1, 2, 1)), method_class("cls")(energy=2.0), 2).config["energy"] == 2.0


def test_wrong_samples_are_named(device):
    stack = make_stack(9, (4, 5, 3))
    stack.images_ihwc[6, 3, 2, 1] = np.nan
    with pytest.raises(InputError, match="image 6 is nan at row 3, column 2, channel 1"):
        fit(stack, "cls", 2, memory=4000)


@pytest.mark.parametrize("method", ["uls", "cls", "ceb", "spline", "spectrum"])
def test_what_a_fit_held_goes_with_it(device, method):
    """Not when Python looks for circles: until then every fit would take new memory from the system, which is slow."""
    prepared = prepare_fit(make_stack(), method, 3, device=device)
    collect_fit(prepared)
    gc.disable()
    gc.freeze()  # what there is already is not looked through
    try:
        collect_fit(prepared)
        assert gc.collect() == 0
    finally:
        gc.unfreeze()
        gc.enable()
