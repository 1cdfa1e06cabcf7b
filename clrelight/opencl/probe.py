"""Whether a device can be trusted, and with how many lanes: a child process finds out, with a time limit, by numbers.

Drivers abort, hang, or compute wrong numbers on processors that they do not know. The verdict is kept per driver build,
processor and kernels, so that a machine pays for it once.
"""

from __future__ import annotations

import functools
import hashlib
import json
import platform
import re
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

from clrelight import __version__
from clrelight.kernel_source import kernel_folder
from clrelight.opencl.child import circumstances, describe_end, run_child
from clrelight.opencl.records import read_record, write_record

WIDTHS = (16, 8, 4)
"""Lanes of the vectors in kernels."""
SECONDS = 240.0
"""Longest that a child may take, compiling included."""

_CODE = "from clrelight.truth import main; main(words)"
_OURS = (
    *("SyntaxError", "IndentationError", "ImportError", "ModuleNotFoundError", "NotImplementedError", "RecursionError"),
    *("NameError", "UnboundLocalError", "AttributeError", "TypeError", "AssertionError"),
)
"""Exceptions of this program's own modules, such as those that are being replaced: wrong numbers raise others."""
_UNTESTED = "cannot be tested, by a fault of this program and not of the driver: "
_USUAL = 8
"""Lanes of AVX2, of which two would fit registers of 16; kernels for GPUs have no other."""


@dataclass(frozen=True)
class Verdict:
    """What is known of a device.

    Attributes
    ----------
    lanes : int
        Width of the vectors that its kernels get; 0 where no width computes soundly.
    fault : str
        Why it is not used; empty for a sound device.
    """

    lanes: int
    fault: str = ""


def judge_device(name: str, identity: str, index: int, native: int, style: str, *, again: bool = False) -> Verdict:
    """Return the verdict on a device: the one that is kept, else what children find.

    Parameters
    ----------
    name : str
        What a terminal is told, for the test takes some seconds.
    identity : str
        Of the driver's build and its device.
    index : int
        Its place in the list of devices.
    native : int
        Float lanes that the driver says its vectors have.
    style : str
        The kernels that it gets.
    again : bool
        Do not believe what is kept.
    """
    key = "\0".join([identity, style, machine_identity(), kernel_identity()])
    kept = None if again else read_record("devices", key)
    if kept is not None and (not kept["fault"] or kept.get("code") == code_identity()):
        return Verdict(int(kept["lanes"]), str(kept["fault"]))
    if _tells and sys.stderr.isatty():
        print(f"clrelight: testing {name}, once for this driver and processor ...", file=sys.stderr)
    verdict = _find_width(index, native, style)
    # Of processes that test at once the first one's word holds: on a busy machine they may find other widths fastest,
    # and results of one program would differ in their last digits.
    other = None if again else read_record("devices", key)
    if other is not None and not other["fault"]:
        return Verdict(int(other["lanes"]))
    # What a limit of this process, an absent program or half an installation did may be otherwise tomorrow.
    if not verdict.fault:
        write_record("devices", key, asdict(verdict))
    elif not (verdict.fault.startswith(_UNTESTED) or circumstances()):
        write_record("devices", key, {**asdict(verdict), "code": code_identity()})
    return verdict


_tells = True


def tell_nothing() -> None:
    """Say nothing of tests, on no terminal."""
    global _tells
    _tells = False


def _find_width(index: int, native: int, style: str) -> Verdict:
    """Try widths from the widest on; first the faster of two where registers are of another width than usual."""
    widths = [width for width in WIDTHS if width <= max(native, _USUAL)] if style == "cpu" else [_USUAL]
    compared = [] if native == _USUAL or len(widths) == 1 else widths[:2]
    rates = {width: _ask(index, width, style, "--rate")[0] for width in compared}
    faults = []
    for width in sorted(widths, key=lambda width: -rates.get(width, 0.0)):
        fault = _ask(index, width, style)[1]
        if not fault:
            return Verdict(width)
        faults.append(fault)
    return Verdict(0, faults[0])


def _ask(index: int, lanes: int, style: str, *words: str) -> tuple[float, str]:
    """Return the rate of a projection and the fault, if any, that a child finds at a width."""
    code = f"words = {[str(index), str(lanes), style, *words]!r}; {_CODE}"
    ended, output, complaint = run_child(code, seconds=SECONDS)
    if ended == 1 and (ours := _fault_of_ours(complaint)):
        return 0.0, _UNTESTED + ours
    if ended != 0:
        return 0.0, describe_end(ended, complaint, SECONDS)
    if not output:
        return 0.0, "says nothing"
    said = json.loads(output.splitlines()[-1])
    if said["wrong"]:
        more = f", and {len(said['wrong']) - 1} more" if len(said["wrong"]) > 1 else ""
        return 0.0, f"computes wrong numbers with {lanes} lanes ({said['wrong'][0]}{more} of {said['checks']} checks)"
    return float(said["rate"]), ""


def _fault_of_ours(complaint: str) -> str:
    """Return what a traceback says, and of which line, where the exception that ended a child is none of a driver."""
    raised = [line for line in complaint.splitlines() if re.match(rf"({'|'.join(_OURS)})(:|$)", line)]
    if not raised or not complaint.rstrip().splitlines()[-1].startswith(raised[-1]):
        return ""
    places = re.findall(r'^  File "([^"]+)", line (\d+)', complaint, re.MULTILINE)
    where = f" ({Path(places[-1][0]).name}, line {places[-1][1]})" if places else ""
    return f"{raised[-1][:300]}{where}"


@functools.cache
def machine_identity() -> str:
    """Return the processor's name and features, and the circumstances that decide on what drivers can do."""
    parts = [platform.machine(), platform.system()]
    try:
        seen: dict[str, str] = {}
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            name, _, value = line.partition(":")
            if name.strip() in ("model name", "flags", "Features", "CPU part", "isa"):
                seen.setdefault(name.strip(), value.strip())
        parts += [f"{name} {value}" for name, value in sorted(seen.items())]
    except OSError:
        parts.append(platform.processor())
    return "\0".join([*parts, *circumstances()])


@functools.cache
def kernel_identity() -> str:
    """Return a digest of all kernels and of what tests them."""
    digest = hashlib.sha256()
    for path in [*sorted(kernel_folder().rglob("*.cl*")), Path(__file__).parents[1] / "truth.py"]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def code_identity() -> str:
    """Return a digest of the program's modules, any of which may be to blame for a fault: another one asks again."""
    digest = hashlib.sha256(__version__.encode())
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
