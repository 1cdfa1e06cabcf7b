"""Other bases than spherical harmonics, and normals, at the extremes of samples and lights."""

import numpy as np
import pytest

from clrelight.errors import InputError
from clrelight.jobs.fit import fit
from clrelight.jobs.variation.normals import normals
from clrelight.sampling import make_pattern
from tests.extremes.judge import IMAGE, stack_of
from tests.reference.bases import FUNCTIONS
from tests.stacks import columns_of, samples_of


def near_the_horizon(n_light):
    """Return lights of which every second one is 0.006 degrees above the horizon."""
    lights_i3 = make_pattern("uniform", n_light)
    lights_i3[::2, 2] = 1e-4
    return lights_i3 / np.linalg.norm(lights_i3, axis=1, keepdims=True)


EVEN = make_pattern("uniform", 40)
CASES = {
    "one pixel": (EVEN, {"columns": 2}),
    "times 1e-30": (EVEN, {"scale": 1e-30}),
    "times 1e30": (EVEN, {"scale": 1e30}),
    "black": (EVEN, {"scale": 0.0}),
    "as many lights as coefficients": (make_pattern("uniform", 4), {"columns": 24}),
    "all the same": (np.repeat(make_pattern("uniform", 1), 30, axis=0), {"columns": 24}),
    "twice each": (np.repeat(make_pattern("uniform", 20), 2, axis=0), {}),
    "near the horizon": (near_the_horizon(40), {}),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("basis", [name for name in FUNCTIONS if name != "sh"])
def test_least_squares_of_every_basis(basis, case):
    lights_i3, made = CASES[case]
    stack = stack_of(lights_i3, **made)
    found_kp, sample_ip = columns_of(fit(stack, "uls", 1, basis=basis)), samples_of(stack)
    basis_ik = FUNCTIONS[basis](lights_i3, 1)
    exact_kp = np.linalg.lstsq(basis_ik, sample_ip, rcond=None)[0]
    assert np.isfinite(found_kp).all()
    assert np.abs(basis_ik @ (found_kp - exact_kp)).max() <= IMAGE * sample_ip.max()


@pytest.mark.parametrize("scale", [1e-30, 1e30])
def test_normals_do_not_hang_on_the_unit_of_the_samples(scale):
    plain, scaled = (normals(stack_of(EVEN, each), method="quick").normals_hw3 for each in (1.0, scale))
    assert np.abs(np.linalg.norm(plain, axis=2) - 1.0)[0, 2:].max() < 1e-6
    np.testing.assert_allclose(scaled, plain, rtol=0, atol=1e-5)


def test_what_is_black_has_no_normal():
    with pytest.raises(InputError, match="no pixel tells a normal"):
        normals(stack_of(EVEN, 0.0))
    stack = stack_of(EVEN, 1.0)
    stack.images_ihwc[:, :, :4] = 0.0
    found_hw3 = normals(stack).normals_hw3
    assert np.isfinite(found_hw3).all()
    assert not found_hw3[:, :4].any()
