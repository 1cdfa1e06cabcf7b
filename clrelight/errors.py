"""Errors that a caller may want to catch by type; everything else is a plain ValueError or TypeError."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what, and what would be right."""


def unknown(what: str, given: object, known: Iterable[str]) -> InputError:
    """Return the error of a name that is none of those known: the line lists these, and says which is nearest."""
    import difflib  # of no use where nothing is wrong

    names = list(known)
    near = difflib.get_close_matches(str(given), names, n=1)
    meant = f" (did you mean {near[0]!r}?)" if near else ""
    return InputError(f"unknown {what} {given!r}; known are {', '.join(names)}{meant}")


def counted(count: int, one: str, many: str = "") -> str:
    """Return a number and what there are so many of: ``1 light does``, ``2 lights do``; an s by itself."""
    return f"{count} {one if count == 1 else many or one + 's'}"


class StoreFormatError(InputError):
    """A file is not one of ours, is damaged, or comes from a newer version."""


class RemoteError(InputError):
    """A file on another machine cannot be fetched; nothing is said of what it holds."""


class BusyError(InputError):
    """Another program is writing the file."""


class PayloadError(InputError):
    """Encoded bytes are damaged, cut short, or not ours."""


class DeviceError(InputError):
    """No OpenCL device fits the request."""


def telling_line(complaint: str) -> str:
    """Return the line that says most: a compiler's error, else the first that speaks of an error, else the last."""
    # What is indented are lines of source code, in a traceback.
    lines = [line.strip() for line in complaint.splitlines() if line.strip() and not line.startswith(" ")]
    for sign in (r"(^|\s)error: ", "error"):
        for line in lines:
            if re.search(sign, line, re.IGNORECASE):
                return line[:300]
    return lines[-1][:300] if lines else "without a word"


class KernelBuildError(RuntimeError):
    """An OpenCL program did not build.

    Attributes
    ----------
    file : str
        Kernel file, relative to the kernel folder.
    defines : dict
        The preprocessor definitions of this build.
    log : str
        The compiler's log, with true file names and lines.
    """

    def __init__(self, file: str, defines: Mapping[str, object], log: str) -> None:
        self.file, self.defines, self.log = file, dict(defines), log
        settings = " ".join(f"{k}={v}" for k, v in self.defines.items()) or "none"
        super().__init__(f"{file} does not build (defines: {settings}): {telling_line(log)}\n{log.strip()}")
