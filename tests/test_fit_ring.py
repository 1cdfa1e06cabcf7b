"""Fits of the ring scene, and of photographs, against float64."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from clrelight.ingest import ingest_folder
from clrelight.jobs.fit import fit
from clrelight.store.stacks import open_stack
from tests.reference import basis
from tests.reference import fit as reference
from tests.stacks import columns_of, ring_stack, samples_of

DEGREES = [2, 4, 6, 8]


@functools.cache
def ring_samples():
    return samples_of(ring_stack())


def image_error(stack, fitted, exact_kp):
    return np.abs(basis.real_harmonics(stack.directions_i3, fitted.degree) @ (columns_of(fitted) - exact_kp))


def check_bound(stack, fitted):
    energy_p = reference.bound(samples_of(stack), np.ones(stack.n_light))
    assert (np.sum(columns_of(fitted) ** 2, axis=0) <= energy_p * (1 + 1e-5)).all()


def check_linear(stack, method, degree):
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, degree), samples_of(stack)
    left_out = [2] if method == "sloan" else []
    used = np.delete(np.arange(basis_ik.shape[1]), left_out)
    exact_kp = np.zeros((basis_ik.shape[1], sample_ip.shape[1]))
    exact_kp[used] = reference.least_squares(basis_ik[:, used], sample_ip, np.ones(stack.n_light))
    fitted = fit(stack, method, degree)
    assert (fitted.coeffs_khwc[left_out] == 0).all()
    assert (image_error(stack, fitted, exact_kp) < 1e-5 + 3e-7 * np.linalg.norm(exact_kp, axis=0)).all()


def check_cls(stack, degree, solver):
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, degree), samples_of(stack)
    fitted = fit(stack, "cls", degree, solver=solver)
    check_bound(stack, fitted)
    some = slice(None, None, 5)
    exact_kp, lambda_p, free_p = reference.constrained(basis_ik, sample_ip[:, some], np.ones(stack.n_light))
    assert np.abs(basis_ik @ (columns_of(fitted)[:, some] - exact_kp)).max() < 1e-5
    energy_p = reference.bound(sample_ip[:, some], np.ones(stack.n_light))
    bent = (energy_p > 1e-3 * free_p) & (energy_p < 0.99 * free_p)
    np.testing.assert_allclose(fitted.lambda_hwc.ravel()[some][bent], lambda_p[bent], rtol=1e-4)
    return fitted


def check_ceb(stack, degree):
    basis_ik, sample_ip = basis.real_harmonics(stack.directions_i3, degree), samples_of(stack)
    fitted = fit(stack, "ceb", degree)
    check_bound(stack, fitted)
    exact_kp, rank_p = reference.truncated(basis_ik, sample_ip, np.ones(stack.n_light))
    # Sums that meet the bound to a rounding error may go either way.
    assert np.mean(fitted.rank_hwc.ravel() == rank_p) >= 0.999
    assert np.mean((image_error(stack, fitted, exact_kp) < 1e-5).all(axis=0)) >= 0.999


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("method", ["uls", "sloan"])
def test_linear(device, method, degree):
    check_linear(ring_stack(), method, degree)


@pytest.mark.parametrize("degree", DEGREES)
def test_cls(device, degree):
    bisection = check_cls(ring_stack(), degree, "bisection")
    newton = check_cls(ring_stack(), degree, "newton")
    error_kp = columns_of(bisection) - columns_of(newton)
    assert np.abs(basis.real_harmonics(ring_stack().directions_i3, degree) @ error_kp).max() < 2e-6


@pytest.mark.parametrize("degree", DEGREES)
def test_ceb(device, degree):
    check_ceb(ring_stack(), degree)


def test_crossing_breaks_the_bound_that_ceb_keeps(device):
    energy_p = reference.bound(ring_samples(), np.ones(256))
    crossing = np.sum(columns_of(fit(ring_stack(), "ceb-crossing", 6)) ** 2, axis=0)
    assert np.mean(crossing > 1.01 * energy_p) > 0.9
    check_bound(ring_stack(), fit(ring_stack(), "ceb", 6))


def test_what_each_method_costs(device):
    """More error for less norm, in the paper's order (tables I and III; section IV-D)."""
    stack, sample_ip = ring_stack(), ring_samples()
    basis_ik = basis.real_harmonics(stack.directions_i3, 6)
    error, norm = {}, {}
    for method in ("uls", "sloan", "cls", "ceb"):
        coeffs_kp = columns_of(fit(stack, method, 6))
        error[method] = np.mean((basis_ik @ coeffs_kp - sample_ip) ** 2)
        norm[method] = np.mean(np.sum(coeffs_kp**2, axis=0))
    assert error["uls"] < error["sloan"] < error["cls"] < error["ceb"]
    assert norm["uls"] > 10 * norm["sloan"] > 100 * norm["cls"] > 100 * norm["ceb"]


@pytest.mark.parametrize(
    ("folder", "options"),
    [
        ("loewenkopf", {"transfer": "srgb", "crop": (10, 10, 30, 20)}),
        ("diligent/bearPNG", {"crop": (40, 60, 24, 20)}),  # lights near the zenith only
    ],
)
def test_photographs(device, real_data, tmp_path, folder, options):
    ingest_folder(real_data / "stacks" / folder, tmp_path / "stack.h5", **options)
    with open_stack(tmp_path / "stack.h5") as opened:
        stack = replace(opened, mask_hw=None)
        check_linear(stack, "uls", 4)
        check_cls(stack, 4, "bisection")
        check_cls(stack, 6, "newton")
        check_ceb(stack, 6)
