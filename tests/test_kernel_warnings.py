"""A compiler prints how many warnings it has, whatever is done with them: a command's first run is to print none."""

from clrelight.device import open_device
from clrelight.kernel_source import read_kernel_source


def test_the_largest_kernel_of_klt_has_none():
    device = open_device()
    program = device._compile(read_kernel_source("codec/units_encode.cl"), ["-cl-std=CL1.2"])
    (of_device,) = program.devices
    assert "warning" not in program.get_build_info(of_device, device._cl.program_build_info.LOG)
