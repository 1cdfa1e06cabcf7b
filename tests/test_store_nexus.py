"""What other programs make of our files: NeXus defaults, named axes with units, and old files without them."""

import time

import h5py
import numpy as np
import pytest

from clrelight.dataset import CoefficientMap, LightStack
from clrelight.lighting.light import Light
from clrelight.results import Results
from clrelight.store import (
    describe,
    open_stack,
    read_fit,
    read_light,
    read_results,
    write_fit,
    write_light,
    write_results,
    write_stack,
)
from clrelight.store.nexus import MOST_PICTURES, VIEW
from tests.test_report import make_results, make_rows

LIGHTS = np.array([[0.6, 0, 0.8], [0, 0, 1], [-0.48, 0.6, 0.64], [0, -0.6, 0.8]])


def make_stack(channels, dtype=np.uint8):
    images = np.random.default_rng(channels).integers(0, 200, (4, 5, 7, channels)).astype(dtype)
    return LightStack(images, LIGHTS, 255.0, "srgb", np.ones(4), np.ones((5, 7), bool), "a $name")


def make_fit(channels):
    coeffs = np.random.default_rng(channels).normal(size=(4, 5, 7, channels)).astype(np.float32)
    return CoefficientMap(
        coeffs, degree=1, method="uls", directions_i3=LIGHTS, peak=255.0, transfer="linear", config={}, name="fit"
    )


def text(value):
    return value.decode() if isinstance(value, bytes) else str(value)


def default_group(file):
    """Follow the attributes as NeXus says to, to the group that is shown."""
    group = file
    while text(group.attrs["NX_class"]) != "NXdata":
        group = group[text(group.attrs["default"])]
    return group


def signal_of(group):
    """Return what is shown, having compared its axes with what NeXus asks of them."""
    signal = group[text(group.attrs["signal"])]
    axes = [text(axis) for axis in group.attrs["axes"]]
    assert len(axes) == signal.ndim
    for axis, length in zip(axes, signal.shape, strict=True):
        assert axis == "." or group[axis].shape == (length,)
    for name in group.attrs.get("auxiliary_signals", []):
        assert group[text(name)].shape == signal.shape
    return signal


@pytest.mark.parametrize("channels", [1, 3, 5])
@pytest.mark.parametrize("dtype", [np.uint8, np.float16])
def test_a_stack_opens_on_the_picture_under_a_light_from_the_upper_left(channels, dtype, tmp_path):
    path, stack = tmp_path / "s.h5", make_stack(channels, dtype)
    write_stack(path, stack)
    expected = stack.images_ihwc[2]
    with h5py.File(path) as file:
        group = default_group(file)
        assert group.name == f"/{VIEW}/picture"
        assert text(group.attrs["title"]) == "light 2 of 4, from -0.48, 0.60, 0.64"
        signal, every = signal_of(group), signal_of(file[VIEW]["images"])
        assert text(signal.attrs["interpretation"]) == ("rgb-image" if channels == 3 else "image")
        assert signal.dtype == every.dtype == (np.uint8 if dtype is np.uint8 else np.float32)  # which browsers read
        if channels == 3:
            np.testing.assert_array_equal(signal[...], expected)
            np.testing.assert_array_equal(every[...], stack.images_ihwc)
        elif channels == 1:
            np.testing.assert_array_equal(signal[...], expected[..., 0])
            np.testing.assert_array_equal(every[...], stack.images_ihwc[..., 0])
        else:
            np.testing.assert_array_equal(signal[...], np.moveaxis(expected, 2, 0))
            np.testing.assert_array_equal(every[...], np.moveaxis(stack.images_ihwc, 3, 0))
    with open_stack(path) as again:
        np.testing.assert_array_equal(again.images_ihwc[...], stack.images_ihwc)


@pytest.mark.parametrize("channels", [1, 3, 2])
def test_a_fit_opens_on_its_mean(channels, tmp_path):
    path, fitted = tmp_path / "f.h5", make_fit(channels)
    write_fit(path, fitted)
    with h5py.File(path) as file:
        signal = signal_of(default_group(file))
        shown = signal[...] if channels == 3 else signal[...].reshape(-1, 5, 7).transpose(1, 2, 0)
    np.testing.assert_array_equal(shown, fitted.coeffs_khwc[0])
    np.testing.assert_array_equal(read_fit(path).coeffs_khwc, fitted.coeffs_khwc)


def test_a_light_opens_as_a_curve_per_channel(tmp_path):
    coeffs = np.arange(12.0).reshape(4, 3)
    write_light(tmp_path / "l.h5", Light(coeffs, "me", "", {}))
    with h5py.File(tmp_path / "l.h5") as file:
        signal = signal_of(default_group(file))
        np.testing.assert_array_equal(signal[...], coeffs.T)
        assert text(signal.attrs["interpretation"]) == "spectrum"
    np.testing.assert_array_equal(read_light(tmp_path / "l.h5").coeffs_kc, coeffs)


@pytest.mark.parametrize("channels", [1, 3])
def test_results_open_on_their_pictures_under_their_keys(channels, tmp_path):
    results = make_results(make_rows(methods=("uls", "cls")), channels)
    write_results(tmp_path / "r.h5", results)
    with h5py.File(tmp_path / "r.h5") as file:
        group = default_group(file)
        signal = signal_of(group)
        names = [text(group.attrs["signal"]), *map(text, group.attrs["auxiliary_signals"])]
        assert len(names) == min(len(results.pictures), MOST_PICTURES)
        assert text(signal.attrs["long_name"]) == "ring/reference"
        for name in names:
            picture = results.pictures[text(group[name].attrs["long_name"])]
            np.testing.assert_array_equal(group[name][...].reshape(picture.shape), picture)
    assert read_results(tmp_path / "r.h5").pictures.keys() == results.pictures.keys()


def test_results_without_pictures_have_no_default(tmp_path):
    write_results(tmp_path / "r.h5", Results(make_rows()))
    with h5py.File(tmp_path / "r.h5") as file:
        assert "default" not in file.attrs
        assert VIEW not in file


def test_the_same_input_gives_the_same_bytes_at_another_second(tmp_path):
    for channels in (1, 3):
        write_stack(tmp_path / "a.h5", make_stack(channels))
        time.sleep(1.1 - time.time() % 1)
        write_stack(tmp_path / "b.h5", make_stack(channels))
        assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_large_file_that_is_streamed_has_its_picture_too(tmp_path, monkeypatch):
    monkeypatch.setattr("clrelight.store.writing.IN_MEMORY_BYTES", 0)
    write_stack(tmp_path / "s.h5", make_stack(1))
    with h5py.File(tmp_path / "s.h5") as file:
        np.testing.assert_array_equal(signal_of(default_group(file))[...], make_stack(1).images_ihwc[2, :, :, 0])


def test_what_is_for_others_may_be_changed_or_taken_away(tmp_path):
    path = tmp_path / "s.h5"
    write_stack(path, make_stack(3))
    told = describe(path)
    with h5py.File(path, "r+") as file:
        file["images"].attrs["units"] = "furlong"
        file[VIEW].attrs["default"] = "images"
    assert describe(path)["datasets"] == told["datasets"]
    with h5py.File(path, "r+") as file:  # as files were before
        del file[VIEW]
        for name in ("NX_class", "default"):
            del file.attrs[name]
    with open_stack(path) as stack:
        np.testing.assert_array_equal(stack.images_ihwc[...], make_stack(3).images_ihwc)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("images", "count"), ("weights", "sr"), ("height", "pixel"), ("width", "pixel"), ("directions", "1")],
)
def test_axes_and_values_have_units(name, unit, tmp_path):
    write_stack(tmp_path / "s.h5", make_stack(3))
    with h5py.File(tmp_path / "s.h5") as file:
        assert text(file[name].attrs["units"]) == unit
        assert text(file[name].attrs["long_name"])
        assert [axis[0].name for axis in file["images"].dims] == ["/light", "/height", "/width", "/channel"]


def test_xarray_opens_named_axes_with_units(tmp_path):
    xarray = pytest.importorskip("xarray", reason="xarray is not installed")
    pytest.importorskip("h5netcdf", reason="h5netcdf is not installed")
    write_stack(tmp_path / "s.h5", make_stack(3))
    with xarray.open_dataset(tmp_path / "s.h5", engine="h5netcdf") as data:
        assert data.images.dims == ("light", "height", "width", "channel")
        assert data.directions.dims == ("light", "xyz")
        assert (data.images.units, data.weights.units, data.height.units) == ("count", "sr", "pixel")
        assert data.height.values.tolist() == [0, 1, 2, 3, 4]
        np.testing.assert_array_equal(data.images.sel(light=2, channel=1), make_stack(3).images_ihwc[2, :, :, 1])
    write_fit(tmp_path / "f.h5", make_fit(1))
    with xarray.open_dataset(tmp_path / "f.h5", engine="h5netcdf") as data:
        assert data.coefficients.dims == ("coefficient", "height", "width", "channel")


@pytest.mark.parametrize("channels", [1, 3, 4])
def test_silx_takes_the_defaults_for_sound(channels, tmp_path):
    nxdata = pytest.importorskip("silx.io.nxdata", reason="silx is not installed")
    write_stack(tmp_path / "s.h5", make_stack(channels))
    write_fit(tmp_path / "f.h5", make_fit(channels))
    write_results(tmp_path / "r.h5", make_results(make_rows(), 1))
    for name in "sfr":
        with h5py.File(tmp_path / f"{name}.h5") as file:
            shown = nxdata.get_default(file)
            assert shown is not None
            assert shown.issues == []
            for group in file[VIEW].values():
                assert nxdata.NXdata(group).issues == []
