"""What a program calls of its driver's library, declared: of the driver's own header the lines that it needs.

PoCL reads a header of 14 500 declarations for each program, which is .11 s of the .13 that a small one takes to build.
"""

from __future__ import annotations

import functools
import re
from pathlib import Path

from clrelight.opencl.drivers import package_folders

GUARD = "_OPENCL_H_"
"""Where this is defined, the driver takes its header for read already."""

_FOLDER = Path(".libs", "share", "pocl", "include")
_HEADER, _TYPES = "opencl-c.h", "opencl-c-base.h"
_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
_PART = re.compile(r"[ \t]*#(?:[^\n]*\\\n)*[^\n]*\n|[^#;]*;[ \t]*\n?")
"""A line for the preprocessor, or a statement."""
_NAME = re.compile(r"\s*[\w\s*]*?(\w+)\s*\([^#{}]*\)[\w\s]*;\s*")
_WORD = re.compile(r"[A-Za-z_]\w*")


def declare_called(source: str) -> str | None:
    """Return what to put in front of a program's source, whose build defines `GUARD`.

    Of every function whose name stands in the source all forms are declared, so that calls mean what they mean with
    the whole header; a name that a macro puts together is not seen, and does not build.

    Parameters
    ----------
    source : str
        Its ``#include`` lines resolved.

    Returns
    -------
    str or None
        None where there is no header of the packaged PoCL.
    """
    parts = _read_header()
    if not parts:
        return None
    words = set(_WORD.findall(source))
    return f"#undef {GUARD}\n" + "".join(part for name, part in parts if name is None or name in words)


@functools.cache
def _read_header() -> list[tuple[str | None, str]]:
    """Return the header in parts, those that declare a function with its name; none where there is no header."""
    for folder in package_folders():
        try:
            types = (folder / _FOLDER / _TYPES).read_text(encoding="ascii")
            header = (folder / _FOLDER / _HEADER).read_text(encoding="ascii")
        except (OSError, UnicodeDecodeError):
            continue
        include = f'#include "{_TYPES}"\n'
        before, found, functions = header.partition(include)
        if found and f"#ifndef {GUARD}" in before:
            parts = _PART.findall(_COMMENT.sub("", functions))
            return [(None, before + types), *((_name_of(part), part) for part in parts)]
    return []


def _name_of(part: str) -> str | None:
    """Return the function that a statement declares, None where it does anything else."""
    found = None if part.lstrip().startswith("#") else _NAME.fullmatch(part)
    return found[1] if found and found[1] != "__attribute__" else None
