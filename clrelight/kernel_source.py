"""Find kernel files and resolve their includes, with ``#line`` so that the compiler names the true file."""

from __future__ import annotations

import functools
import re
from pathlib import Path

_PACKAGE_FOLDER = Path(__file__).resolve().parent / "kernels"
_CHECKOUT_FOLDER = Path(__file__).resolve().parent.parent / "kernels"
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"')


@functools.cache
def kernel_folder() -> Path:
    """Return the folder of the kernels: in an installed package, else beside it in a checkout."""
    for folder in (_PACKAGE_FOLDER, _CHECKOUT_FOLDER):
        if (folder / "common").is_dir():
            return folder
    raise FileNotFoundError(f"no OpenCL kernels in {_PACKAGE_FOLDER} nor in {_CHECKOUT_FOLDER}: reinstall clrelight")


@functools.cache
def kernel_for(file: str, style: str) -> str:
    """Return the file of a style's kernels: ``"fit/cls.gpu.cl"`` for ``"fit/cls.cl"``, if there is one, on a GPU.

    Parameters
    ----------
    file : str
        Path relative to the kernel folder, such as ``"fit/cls.cl"``.
    style : str
        One of `clrelight.opencl.devices.STYLES`.
    """
    twin = f"{file.removesuffix('.cl')}.{style}.cl"
    return twin if (kernel_folder() / twin).is_file() else file


@functools.cache
def read_kernel_source(file: str) -> str:
    """Return the text of a kernel file with its ``#include "..."`` lines replaced by what they name.

    Includes are named relative to the kernel folder and taken once each. They are resolved here because
    ``-I`` breaks on folders with a space in some OpenCL compilers.

    Parameters
    ----------
    file : str
        Path relative to the kernel folder, such as ``"fit/project.cl"``.
    """
    return "".join(_expand(file, set()))


def _expand(file: str, seen: set[str]) -> list[str]:
    seen.add(file)
    path = kernel_folder() / file
    lines = [f'#line 1 "{file}"\n']
    for number, line in enumerate(path.read_text(encoding="ascii").splitlines(), start=1):
        match = _INCLUDE.match(line)
        if match is None:
            lines.append(line + "\n")
        else:
            if match[1] not in seen:
                lines.extend(_expand(match[1], seen))
            lines.append(f'#line {number + 1} "{file}"\n')
    return lines
