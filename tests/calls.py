"""Which functions of PoCL's library a program calls, by the names in its bitcode."""

import re

from clrelight.opencl import kernel_cache
from clrelight.opencl.declarations import declare_called

_BITS = {b"c": 8, b"h": 8, b"s": 16, b"t": 16, b"i": 32, b"j": 32, b"f": 32, b"l": 64, b"m": 64, b"d": 64}
_TYPE_BITS = {b"char": 8, b"short": 16, b"int": 32, b"float": 32, b"long": 64, b"double": 64}
_MOST_BITS = 128


def find_long_calls(bitcode):
    """Return the mangled names that take, or by their own name return, a vector of more than 128 bits."""
    found = set()
    for name in re.findall(rb"_Z\d+[A-Za-z_0-9]+", bitcode):
        # Names lie one behind the other: of each, what follows its length is enough to see its arguments.
        for lanes, element in re.findall(rb"Dv(\d+)_([chstijflmd])", name):
            if int(lanes) * _BITS[element] > _MOST_BITS:
                found.add(name.decode())
        for element, lanes in re.findall(rb"convert_u?(char|short|int|float|long|double)(\d+)", name):
            if int(lanes) * _TYPE_BITS[element] > _MOST_BITS:
                found.add(name.decode())
        for lanes, element in re.findall(rb"vload(?:_half)?(\d+)mP(?:U\d+CL[a-z]+)?K?(Dh|[chstijflmd])", name):
            if int(lanes) * _BITS.get(element, 32) > _MOST_BITS:
                found.add(name.decode())
    return found


def check_calls(device, file, defines, name):
    """Raise where a program, just built, holds a call of more than 128 bits; for PoCL, which tells."""
    folder = kernel_cache._run_folder
    for program in device._cache._programs.get(name, ()):
        found = find_long_calls((folder / program / "program.bc").read_bytes())
        assert not found, f"{file} {defines} calls {sorted(found)}: see kernels/common/calls.clh"


def check_spelt(device, source):
    """Raise where a program builds with the driver's whole header alone: the driver has complained before."""
    if device.info.packaged and declare_called(source) is not None:
        file = re.search(r'#line 1 "(.*)"', source)
        raise AssertionError(f"{file[1] if file else source} calls a function whose name it does not spell")
