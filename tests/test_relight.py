from dataclasses import replace

import numpy as np
import pytest

from clrelight.dataset import CoefficientMap
from clrelight.errors import InputError
from clrelight.relight import relight, to_display
from clrelight.sampling import make_pattern
from tests.reference import basis, psnr
from tests.styles import both_styles

UNIT = 2.0**-24


def make_map(degree, shape_hwc, seed=0):
    coeffs = np.random.default_rng(seed).standard_normal(((degree + 1) ** 2, *shape_hwc)).astype(np.float32)
    return CoefficientMap(coeffs, degree, "uls", 1.0, "linear", np.array([[0.0, 0.0, 1.0]]))


@pytest.mark.parametrize(("degree", "shape"), [(0, (1, 1, 1)), (1, (3, 5, 1)), (6, (7, 11, 3)), (9, (1, 257, 1))])
@pytest.mark.parametrize("n_light", [1, 2, 7, 33])
def test_against_float64(device, degree, shape, n_light):
    fitted = make_map(degree, shape)
    directions = make_pattern("uniform", n_light)
    images = relight(fitted, directions)
    assert images.shape == (n_light, *shape)
    assert images.dtype == np.float32
    coeffs_kp = fitted.coeffs_khwc.reshape(fitted.n_coeff, -1).astype(np.float64)
    basis_ik = basis.real_harmonics(directions, degree)
    size_ip = np.abs(basis_ik) @ np.abs(coeffs_kp)
    error_ip = np.abs(images.reshape(n_light, -1) - basis_ik @ coeffs_kp)
    # A product, and at most 64 sums in one run and one more for each run.
    assert (error_ip <= UNIT * (min(fitted.n_coeff, 64) + 6) * size_ip).all()


@both_styles
@pytest.mark.parametrize("shape", [(1, 1, 1), (7, 11, 3), (1, 257, 1)])
def test_coefficients_kept_as_halves(device, shape):
    fitted = make_map(6, shape)
    halves, directions = replace(fitted, coeffs_khwc=fitted.coeffs_khwc.astype(np.float16)), make_pattern("uniform", 3)
    np.testing.assert_array_equal(relight(halves, directions), relight(halves.to_float32(), directions))


@both_styles
def test_one_coefficient_is_one_function(device):
    coeffs = np.zeros((9, 1, 1, 1), np.float32)
    coeffs[3] = 2.0
    fitted = CoefficientMap(coeffs, 2, "uls", 255.0, "srgb", np.array([[0.0, 0.0, 1.0]]))
    images = relight(fitted, np.array([[1.0, 0.0, 0.0], [-0.6, 0.0, 0.8], [0.0, 1.0, 0.0]]))
    np.testing.assert_allclose(images.ravel(), [2 * 0.4886025, -1.2 * 0.4886025, 0.0], rtol=1e-6)


def test_lights_that_are_none(device):
    fitted = make_map(1, (1, 1, 1))
    with pytest.raises(InputError, match=r"light 1 has direction \[0\. 0\. 2\.\], which is no finite unit vector"):
        relight(fitted, np.array([[0.0, 0, 1], [0, 0, 2]]))
    for lights in ([0, 0, 1], [[0, 1]], [[[0, 0, 1]]]):
        with pytest.raises(InputError, match="float64 of shape"):
            relight(fitted, lights)
    with pytest.raises(InputError, match="directions must be numbers"):
        relight(fitted, [["up"]])
    with pytest.raises(InputError, match="at least 1 light, got none"):
        relight(fitted, np.zeros((0, 3)))


@pytest.mark.parametrize("dtype", [None, ">f8", "<f4", "<i2"])
def test_lights_of_any_type(device, dtype):
    fitted = make_map(1, (1, 2, 1))
    lights = [[0, 0, 1], [1, 0, 0]]
    found = relight(fitted, lights if dtype is None else np.array(lights, dtype))
    np.testing.assert_array_equal(found, relight(fitted, np.array(lights, np.float64)))


@pytest.mark.parametrize("transfer", ["linear", "srgb"])
def test_display_values(transfer):
    radiance = np.concatenate([np.linspace(-0.5, 1.5, 999), [np.inf, -np.inf]]).astype(np.float32)
    shown = to_display(radiance, transfer)
    assert shown.dtype == np.uint8
    np.testing.assert_array_equal(shown, np.rint(255 * psnr.display(radiance, transfer)))
    assert to_display(np.array([0.5]), transfer)[0] == (188 if transfer == "srgb" else 128)
