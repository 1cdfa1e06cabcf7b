"""The command line. Command modules import what is heavy inside their functions, so that ``--help`` is quick."""

from __future__ import annotations

# Not signal, whose import takes milliseconds in which Ctrl-C would still print a traceback.
import _signal  # type: ignore[import-not-found]
import os
import sys


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit: 0 done, 1 our fault, 2 bad input, 128 + n ended by signal n."""
    import atexit

    # Before anything is begun, and after all is done, there is nothing to say and nothing to clean up.
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(_signal, name, None)
        if number is not None and (name == "SIGINT" or _signal.getsignal(number) is not _signal.SIG_IGN):
            _signal.signal(number, lambda number, frame: os._exit(128 + number))
            # At the very end Python would give them back to the system, which has other exit codes.
            atexit.register(_signal.signal, number, _signal.SIG_IGN)
    # Before NumPy is loaded: threads of its BLAS would wait for more work by spinning, on processors that kernels need.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    from clrelight.cli.app import run
    from clrelight.cli.standard import flush_streams, mend_streams

    mend_streams()
    code = run(arguments)
    flush_streams()
    if code > 128:
        # Python may end itself by SIGINT instead, if an interrupt has passed a library that runs Python code.
        os._exit(code)
    sys.exit(code)


__all__ = ["main"]
