from dataclasses import replace

import numpy as np
import pytest

from clrelight.arrays import check_directions, check_radiance
from clrelight.dataset import CoefficientMap, LightStack, split_lights
from clrelight.errors import InputError

UP = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])


def make_stack(**changed):
    good = {"images_ihwc": np.ones((2, 3, 4, 3), np.uint8), "directions_i3": UP, "peak": 255.0}
    return LightStack(**{**good, **changed})


def make_map(**changed):
    good = {
        "coeffs_khwc": np.zeros((4, 2, 3, 1), np.float32),
        "degree": 1,
        "method": "cls",
        "peak": 1.0,
        "transfer": "linear",
        "directions_i3": UP,
    }
    return CoefficientMap(**{**good, **changed})


def test_a_stack():
    stack = make_stack(weights_i=np.array([0.0, 2.0]), mask_hw=np.zeros((3, 4), bool), transfer="srgb")
    assert stack.n_light == 2
    assert stack.image_shape == (3, 4, 3)
    with pytest.raises(AttributeError):
        stack.peak = 1.0


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"images_ihwc": np.ones((2, 3, 4), np.uint8)}, r"none of them empty, got shape \(2, 3, 4\)"),
        ({"images_ihwc": np.ones((2, 0, 4, 3), np.uint8)}, r"none of them empty, got shape \(2, 0, 4, 3\)"),
        ({"images_ihwc": np.ones((2, 3, 4, 3), complex)}, "uint8, uint16, float16, float32 or numbers .* got complex"),
        ({"images_ihwc": np.full((2, 3, 4, 3), "a")}, "got <U1"),
        ({"images_ihwc": np.full((2, 3, 4, 3), None)}, "got object"),
        ({"images_ihwc": [[1, 2], [3]]}, "images must be an array, or lists of equal lengths"),
        ({"images_ihwc": "s.h5"}, "got <U4"),
        ({"images_ihwc": np.full((2, 3, 4, 3), -1)}, "int64 from -1 to 0: integers must be from 0 to 65535"),
        ({"images_ihwc": np.full((2, 3, 4, 3), 65536)}, "int64 from 0 to 65536"),
        ({"images_ihwc": np.ones((3, 3, 4, 3), np.uint8)}, "there are 3 images but 2 light directions"),
        ({"transfer": "gamma"}, "transfer must be one of linear, srgb, got 'gamma'"),
        ({"peak": 0.0}, "peak must be a positive number, got 0.0"),
        ({"peak": -1.0}, "peak must be a positive number"),
        ({"peak": np.nan}, "peak must be a positive number"),
        ({"peak": np.inf}, "peak must be a positive number"),
        ({"weights_i": np.ones(3)}, r"weights must be 2 finite numbers >= 0, got shape \(3,\)"),
        ({"weights_i": np.array([1.0, -1.0])}, "weights must be 2 finite numbers >= 0"),
        ({"weights_i": np.array([1.0, np.nan])}, "weights must be 2 finite numbers >= 0"),
        ({"weights_i": np.zeros(2)}, "weights must not all be 0"),
        ({"weights_i": ["a", "b"]}, "weights must be numbers, got <U1"),
        ({"mask_hw": np.ones((4, 3), bool)}, r"mask must be bool of shape \(3, 4\), got bool \(4, 3\)"),
        ({"mask_hw": np.ones((3, 4), np.uint8)}, r"mask must be bool of shape \(3, 4\), got uint8"),
    ],
)
def test_a_stack_refuses(changed, message):
    with pytest.raises(InputError, match=message):
        make_stack(**changed)


@pytest.mark.parametrize(
    ("directions", "message"),
    [
        (UP.astype("c16"), "directions must be numbers, got complex128"),
        ([[0, 0, 1], [0, 1]], "directions must be an array, or lists of equal lengths"),
        ("up", "directions must be numbers, got <U2"),
        (UP[0], r"got float64 \(3,\)"),
        (UP[:, :2], r"got float64 \(2, 2\)"),
        (UP * [[1.0], [1.00001]], r"light 1 has direction .* no finite unit vector"),
        (np.array([[np.nan, 0, 0], [0, 0, 1]]), "light 0 has direction"),
        (np.array([[0.0, 0, 1], [np.inf, 0, 0]]), "light 1 has direction"),
        (UP[:1], "there are 2 images but 1 light direction$"),
    ],
)
def test_directions(directions, message):
    with pytest.raises(InputError, match=message):
        make_stack(directions_i3=directions)


@pytest.mark.parametrize(
    ("images", "dtype"),
    [
        (np.arange(24.0).reshape(1, 2, 4, 3), np.float32),
        (np.arange(24.0).reshape(1, 2, 4, 3).tolist(), np.float32),
        (np.arange(24.0, dtype=">f4").reshape(1, 2, 4, 3), np.float32),
        (np.arange(24.0, dtype=">f2").reshape(1, 2, 4, 3), np.float16),
        (np.arange(24, dtype=">u2").reshape(1, 2, 4, 3), np.uint16),
        (np.arange(24).reshape(1, 2, 4, 3), np.uint16),
        (np.arange(24).reshape(1, 2, 4, 3).tolist(), np.uint16),
        (np.arange(24, dtype=np.int8).reshape(1, 2, 4, 3), np.uint16),
        (np.arange(24).reshape(1, 2, 4, 3) % 2 == 0, np.uint8),
    ],
)
def test_other_numbers_become_samples(images, dtype):
    for directions in ([[0, 0, 1]], np.array([[0, 0, 1]], ">i4"), np.array([[0.0, 0.0, 1.0]], np.float32)):
        stack = LightStack(images, directions, 255, weights_i=[2], mask_hw=[[True] * 4] * 2)
        assert stack.images_ihwc.dtype == dtype
        np.testing.assert_array_equal(stack.images_ihwc, images)
        assert (stack.directions_i3.tolist(), stack.directions_i3.dtype) == ([[0.0, 0.0, 1.0]], np.float64)
        np.testing.assert_array_equal(stack.read_rows(1, 2), np.asarray(images)[:, 1:2])
        np.testing.assert_array_equal(stack.weights_i, [2.0])


@pytest.mark.parametrize("dtype", [">f4", "<f8", ">f2", "<i4"])
def test_other_numbers_become_coefficients(dtype):
    values = np.arange(24).reshape(4, 2, 3, 1)
    for given in (values.astype(dtype), values.astype(dtype).tolist()):
        fitted = make_map(coeffs_khwc=given, directions_i3=UP.astype("f8").tolist())
        is_half = dtype == ">f2" and not isinstance(given, list)
        assert fitted.coeffs_khwc.dtype == (np.float16 if is_half else np.float32)
        np.testing.assert_array_equal(fitted.coeffs_khwc, values)


def test_a_double_beyond_float_is_no_radiance():
    images = np.ones((2, 1, 1, 3))
    images[1, 0, 0, 2] = 1e300
    stack = make_stack(images_ihwc=images, peak=1.0)
    with pytest.raises(InputError, match="image 1 is inf at row 0, column 0, channel 2"):
        stack.read_rows(0, 1)


def test_directions_may_be_off_by_rounding():
    check_directions(UP * (1 + 9e-7), 2)
    check_directions(-UP, None)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"coeffs_khwc": np.zeros((4, 2, 3), np.float32)}, r"got shape \(4, 2, 3\)"),
        ({"coeffs_khwc": np.zeros((4, 2, 3, 1), complex)}, "coefficients must be float32 or float16, got complex128"),
        ({"coeffs_khwc": [[1.0], [2.0, 3.0]]}, "coefficients must be an array, or lists of equal lengths"),
        ({"directions_i3": [["x", "y", "z"]]}, "directions must be numbers, got <U1"),
        ({"degree": 2}, "degree 2 has 9 coefficients, got 4"),
        ({"degree": -3}, "got 4"),
        ({"transfer": "log"}, "got 'log'"),
        ({"peak": 0.0}, "peak must be a positive number"),
        ({"directions_i3": 2 * UP}, "light 0 has direction"),
        ({"lambda_hwc": np.zeros((2, 3), np.float32)}, r"lambda must be float32 of shape \(2, 3, 1\)"),
        ({"lambda_hwc": np.zeros((2, 3, 1))}, "lambda must be float32 .* got float64"),
        ({"rank_hwc": np.zeros((2, 3, 1), np.int64)}, "rank must be int32 .* got int64"),
    ],
)
def test_a_map_refuses(changed, message):
    with pytest.raises(InputError, match=message):
        make_map(**changed)


def test_a_map():
    fitted = make_map(lambda_hwc=np.zeros((2, 3, 1), np.float32), rank_hwc=np.zeros((2, 3, 1), np.int32))
    assert (fitted.n_coeff, fitted.image_shape) == (4, (2, 3, 1))


def test_select():
    images = np.arange(2 * 3 * 4 * 3, dtype=np.uint8).reshape(2, 3, 4, 3)
    stack = make_stack(images_ihwc=images, weights_i=np.array([1.0, 2.0]), name="vase")
    picked = stack.select(np.array([1]))
    np.testing.assert_array_equal(picked.images_ihwc, images[1:])
    np.testing.assert_array_equal(picked.directions_i3, UP[1:])
    np.testing.assert_array_equal(picked.weights_i, [2.0])
    assert picked.name == "vase"


def test_rows_are_contiguous():
    images = np.arange(2 * 3 * 4 * 3, dtype=np.uint16).reshape(2, 3, 4, 3)
    for source in (images, np.asfortranarray(images)):
        rows = make_stack(images_ihwc=source).read_rows(1, 3)
        assert rows.flags.c_contiguous
        np.testing.assert_array_equal(rows, images[:, 1:3])


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-3])
def test_radiance_names_the_first_bad_sample(dtype, value):
    images = np.ones((2, 5, 4, 3), dtype)
    images[1, 3, 2, 1] = value
    images[1, 4, 0, 0] = value
    check_radiance(images[:, :3])
    with pytest.raises(InputError, match=r"image 1 is \S+ at row 3, column 2, channel 1: radiance must be finite"):
        make_stack(images_ihwc=images).read_rows(0, 5)
    with pytest.raises(InputError, match="at row 3, column 2"):
        make_stack(images_ihwc=images).read_rows(2, 5)
    make_stack(images_ihwc=images).read_rows(0, 3)


def test_integers_are_radiance_as_they_are():
    images = np.full((2, 3, 4, 3), 255, np.uint8)
    np.testing.assert_array_equal(make_stack(images_ihwc=images).read_rows(0, 3), images)


def test_replacing_checks_again():
    with pytest.raises(InputError, match="peak"):
        replace(make_stack(), peak=-1.0)


@pytest.mark.parametrize(("n_light", "holdout"), [(10, 2), (10, 3), (10, 10), (7, 4)])
def test_split(n_light, holdout):
    kept, out = split_lights(n_light, holdout)
    assert out.tolist() == list(range(holdout - 1, n_light, holdout))
    assert sorted([*kept, *out]) == list(range(n_light))


def test_no_split():
    kept, out = split_lights(4, None)
    assert (kept.tolist(), out.tolist()) == ([0, 1, 2, 3], [])


@pytest.mark.parametrize(
    ("holdout", "message"), [(1, "at least 2"), (0, "at least 2"), (-2, "at least 2"), (5, "use at most 4")]
)
def test_splits_that_leave_nothing(holdout, message):
    with pytest.raises(InputError, match=message):
        split_lights(4, holdout)
