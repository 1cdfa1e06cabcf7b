"""A process of its own for what may end or hang the process that does it, and words for how it ended."""

from __future__ import annotations

import math
import mmap
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import ExitStack, suppress

from clrelight.errors import DeviceError, telling_line
from clrelight.opencl.folder import LEAST_ROOM

SPARE_FILES = 24
"""Files that drivers open beside what is open: libraries, pipes to a child, and twelve of their linker's."""

SPARE_ADDRESSES = 448 << 20
"""Bytes of address space that drivers, threads and compiler take: with less, PoCL aborts or waits for ever."""

_LITTLE_MEMORY, _FEW_FILES = 8 << 30, 64


def run_child(
    code: str, *, seconds: float, environment: Mapping[str, str] | None = None
) -> tuple[int | None, str, str]:
    """Run Python code with this process's module path; return exit code (None: too late), output and complaints.

    Where this process is killed, the child ends by an alarm of its own: a driver that hangs would keep a processor.
    """
    alarm = f"import signal; hasattr(signal, 'alarm') and signal.alarm({math.ceil(seconds) + 5}); "
    child = subprocess.Popen(
        [sys.executable, "-c", f"{alarm}import sys; sys.path[:] = {sys.path!r}; {code}"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        errors="replace",
        env=environment,
        start_new_session=True,  # Ctrl-C is for us; we end the child
    )
    try:
        output, complaint = child.communicate(timeout=seconds)
        return child.returncode, output, complaint
    except subprocess.TimeoutExpired:
        return None, "", ""
    finally:
        if child.poll() is None:
            with suppress(OSError):
                os.killpg(child.pid, signal.SIGKILL) if hasattr(os, "killpg") else child.kill()
            child.communicate()


def check_descriptors() -> None:
    """Raise DeviceError where drivers could not open their files: one says then that it has no device, one aborts."""
    try:
        with ExitStack() as opened:
            for _ in range(SPARE_FILES):
                opened.callback(os.close, os.open(os.devnull, os.O_RDONLY))
    except OSError as error:
        raise DeviceError("too few files may be open at once (ulimit -n): allow more, such as ulimit -n 256") from error


def check_addresses() -> None:
    """Raise DeviceError where the address space is limited so far that drivers could not start."""
    memory, _ = _limits()
    if memory < 0:
        return
    try:
        mmap.mmap(-1, SPARE_ADDRESSES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS, prot=mmap.PROT_READ).close()
    except OSError as error:
        enough = max(2_000_000, (memory + SPARE_ADDRESSES) >> 10)
        raise DeviceError(
            f"the address space is limited to {memory / 2**30:.2f} GiB (ulimit -v), of which less than "
            f"{SPARE_ADDRESSES >> 20} MiB are free for OpenCL's drivers: allow more, such as ulimit -v {enough}"
        ) from error


def describe_end(code: int | None, complaint: str, seconds: float) -> str:
    """Return how a child ended that did not end well, and what in this process's surroundings may be the cause."""
    found = circumstances()
    because = f" ({'; '.join(found)})" if found else ""
    if code is None:
        return f"does not answer within {seconds:.0f} s{because}"
    how = f"ends the process, {_signal_name(-code)}" if code < 0 else "fails"
    return f"{how}{because}: {telling_line(complaint)}"


def circumstances() -> list[str]:
    """Return what of this process's surroundings keeps drivers from working, in words."""
    found = []
    if sys.platform == "linux" and shutil.which("ld") is None:
        found.append("PoCL needs the linker ld, which is not on PATH: it is in the package binutils")
    if sys.platform == "linux" and not os.path.exists("/proc/self"):
        found.append("/proc is not mounted, where drivers and this program look what the processor is")
    try:
        with tempfile.TemporaryFile() as file:
            file.write(bytes(LEAST_ROOM))
    except OSError as error:
        found.append(f"temporary files cannot be written: {error.strerror or error}; TMPDIR names another folder")
    memory, files = _limits()
    if 0 <= memory < _LITTLE_MEMORY:
        found.append(f"the address space is limited to {memory / 2**30:.1f} GiB, see ulimit -v")
    if 0 <= files < _FEW_FILES:
        found.append(f"only {files} files may be open at once, see ulimit -n")
    return found


def _limits() -> tuple[int, int]:
    """Return the limits on address space and descriptors, negative where there is none."""
    try:
        import resource
    except ImportError:  # Windows
        return -1, -1
    memory, files = (resource.getrlimit(which)[0] for which in (resource.RLIMIT_AS, resource.RLIMIT_NOFILE))
    return (
        -1 if memory == resource.RLIM_INFINITY else memory,
        -1 if files == resource.RLIM_INFINITY else files,
    )


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return f"signal {number}"
