"""Load only drivers that survive being loaded: a child tries them first, all together, then each apart."""

from __future__ import annotations

import atexit
import ctypes
import functools
import importlib.metadata
import importlib.util
import os
import shutil
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from clrelight.opencl.child import circumstances, describe_end, run_child
from clrelight.opencl.kernel_cache import PYOPENCL_VARIABLE
from clrelight.opencl.records import read_record, write_record

VENDORS_VARIABLE = "OCL_ICD_VENDORS"
_VENDORS_FOLDER = "/etc/OpenCL/vendors"
_SECONDS = 60.0
_LOAD = "import pyopencl; [platform.get_devices() for platform in pyopencl.get_platforms()]"


@functools.cache
def leave_out_drivers() -> dict[str, str]:
    """Keep drivers that end or hang a process from the loader, before it first looks for them.

    Returns
    -------
    dict of str to str
        Files that name such drivers to the loader, and what each driver does.
    """
    if sys.platform in ("win32", "darwin") or "pyopencl" in sys.modules:
        return {}  # other loaders; or too late, and they live
    files = _vendor_files()
    key = "\0".join([*map(_describe, files), *(_version(name) for name in ("pyopencl", "pocl-binary-distribution"))])
    kept = read_record("drivers", key) if files else {"faults": {}}
    if kept is None:
        faults = {}
        if _try_loading(None):
            faults = {str(file): fault for file in files if (fault := _try_loading(file))}
        kept = {"fault": "; ".join(faults), "faults": faults}
        if not (faults and circumstances()):
            write_record("drivers", key, kept)
    if kept["faults"]:
        os.environ[VENDORS_VARIABLE] = _folder_of([file for file in files if str(file) not in kept["faults"]])
    return kept["faults"]


def _vendor_files() -> list[Path]:
    place = Path(os.environ.get(VENDORS_VARIABLE) or _VENDORS_FOLDER)
    try:
        return sorted(place.glob("*.icd")) if place.is_dir() else []
    except OSError:
        return []


def _describe(file: Path) -> str:
    """Return what changes when another driver comes: the file's words, and the library's size and time if found."""
    words = [str(file)]
    with suppress(OSError):
        words.append(file.read_text(errors="replace").strip())
        found = Path(words[-1]).stat()
        words += [str(found.st_size), str(found.st_mtime_ns)]
    return " ".join(words)


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return ""


@functools.cache
def packaged_version() -> str:
    """Return the version of the PoCL that came from the Python package index, empty where there is none."""
    return _version("pocl-binary-distribution")


def is_packaged(platform_version: str, record: int) -> bool:
    """Return whether a platform is that PoCL, which pyopencl names to the loader.

    A system may have one of that version too: the file that holds the record, at an address, tells them apart.
    """
    version = packaged_version()
    if not version or f"PoCL {version}" not in platform_version:
        return False
    library = library_of(record)
    if library is None:
        return True
    # Installers link files, or folders, to where they keep them.
    forms = (Path.absolute, Path.resolve)
    return any(form(library).is_relative_to(form(place)) for place in package_folders() for form in forms)


class _Found(ctypes.Structure):
    """What dladdr(3) fills in."""

    _fields_ = (
        ("file", ctypes.c_char_p),
        ("start", ctypes.c_void_p),
        ("symbol", ctypes.c_char_p),
        ("address", ctypes.c_void_p),
    )


def library_of(record: int) -> Path | None:
    """Return the library that holds what is at an address of this process; None where the system does not say."""
    try:
        ask = ctypes.CDLL(None).dladdr
    except (AttributeError, OSError, TypeError):  # Windows
        return None
    ask.argtypes, found = (ctypes.c_void_p, ctypes.POINTER(_Found)), _Found()
    if not ask(record, ctypes.byref(found)) or not found.file:
        return None  # it is on the heap
    return Path(os.fsdecode(found.file))


@functools.cache
def package_folders() -> tuple[Path, ...]:
    """Return where wheels put the library: beside pyopencl, which carries it, or in the folder of its own package."""
    specs = map(importlib.util.find_spec, ("pyopencl", "pocl_binary_distribution"))
    places = (place for spec in specs if spec is not None for place in spec.submodule_search_locations or ())
    return tuple(map(Path, places))


def _try_loading(file: Path | None) -> str:
    """Return what goes wrong where a process loads all drivers, or one beside those of the Python package."""
    environment = {**os.environ, PYOPENCL_VARIABLE: "1"}
    if file is not None:
        environment[VENDORS_VARIABLE] = _folder_of([file])
    code, _, complaint = run_child(_LOAD, seconds=_SECONDS, environment=environment)
    # An exception is an answer: no platform, for example.
    return "" if code in (0, 1) else describe_end(code, complaint, _SECONDS)


def _folder_of(files: list[Path]) -> str:
    folder = tempfile.mkdtemp(prefix="clrelight-drivers-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for file in files:
        shutil.copy(file, folder)
    return folder
