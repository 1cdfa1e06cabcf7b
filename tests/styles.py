"""Run a test with either style of kernels."""

import pytest

from clrelight.opencl.devices import STYLES

both_styles = pytest.mark.parametrize("device", STYLES, indirect=True)
"""For a test of the `device` fixture: once with the kernels for CPUs, once with those for GPUs and copies of arrays."""

every_width = pytest.mark.parametrize("device", ["@4", "@8", "@16"], indirect=True)
"""The same with the kernels of a device of every width, which any device can run."""

gpu_style = pytest.mark.parametrize("device", ["gpu"], indirect=True)
