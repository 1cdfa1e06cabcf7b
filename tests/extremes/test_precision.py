"""Single and double precision at the extremes: what single holds of mixed, and that double only rounds its result."""

import pytest

from clrelight.sampling import make_pattern
from tests.extremes.judge import IMAGE, cap, judge, stack_of
from tests.extremes.test_conditions import METHODS, SETS
from tests.styles import both_styles

DOUBLE = 2e-7
"""Of the brightest sample: what rounding the coefficients to float32 may make."""
DOUBLE_BOUND = 1e-6
LIMITS = {"single": {}, "double": {"bound": DOUBLE_BOUND}}
CASES = {
    **{f"degree {degree}": (stack_of(make_pattern("uniform", 256)), degree, 1.0) for degree in (1, 8, 15)},
    **{f"cap of {radius}": (stack_of(cap(200, radius)), 6, 1.0) for radius in (60, 10, 2)},
    **{name: (stack_of(lights), 6, 1.0) for name, lights in SETS.items()},
    **{f"{count} lights": (stack_of(make_pattern("uniform", count), columns=24), 6, 1.0) for count in (1, 8, 257)},
    **{f"energy {factor:g}": (stack_of(make_pattern("uniform", 90)), 4, factor) for factor in (1e-12, 0.999, 10.0)},
    **{f"times {scale:g}": (stack_of(make_pattern("uniform", 90), scale), 4, 1.0) for scale in (1e-30, 1e30)},
}


@both_styles
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("precision", "limit"), [("single", IMAGE), ("double", DOUBLE)])
def test_images_and_bounds(device, precision, limit, method, case):
    stack, degree, factor = CASES[case]
    assert judge(stack, method, degree, factor, precision=precision, **LIMITS[precision]) < limit
