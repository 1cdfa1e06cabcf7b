"""Compiled kernels between runs, for drivers that keep them in files and trust what they find there (PoCL).

PoCL maps whatever its cache holds into the process: damaged bytes crash it, a build that failed midway poisons it, and
two processes race in it. So each process gives it an empty folder of its own. What a program left there once its
kernels ran is sealed into one archive with a checksum, and unpacked, after a check, before it is built again. That is a
checksum of the archive's name too: what lies under another program's, or another driver's, is not taken.

To know its own file again PoCL preprocesses a program's source each time, in 30 ms. Of the PoCL that we test a program
is built of the bitcode in its archive instead, in 3: for that its kernels have names that no other program's have,
since PoCL finds what it compiled of bitcode by the names alone.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import re
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from clrelight.errors import DeviceError
from clrelight.opencl.archives import holds_whole, two_folders, unpack_archive, write_archive
from clrelight.opencl.folder import cache_folder, log

POCL_VARIABLE = "POCL_CACHE_DIR"
PYOPENCL_VARIABLE = "PYOPENCL_NO_CACHE"
MOST_BYTES = 256 << 20
"""All archives together; those that were not used for longest go first."""

_FILE_BYTES, _ROOM_BYTES = 1 << 20, 32 << 20
"""Of what LLVM writes for the programs of a command: a large file, and all of them, about."""
_DIGEST = hashlib.sha256
_VERSION = 2
_STALE_SECONDS = 7 * 86400.0
_KERNEL = re.compile(r"\b(?:__)?kernel\s(?:[^;{]*?\s)?void\s+(\w+)\s*\(")
_BITCODE = "program.bc"
_TAG = 16
_building = threading.RLock()
_said: set[str] = set()
_unpacked: dict[str, dict[str, set[str]]] = {}
_held: dict[Path, list[str]] = {}
"""Files in the archives that this process has read or written: a program that has no others is not sealed again."""


@contextmanager
def own_folder() -> Iterator[None]:
    """Let PoCL, which looks once while it starts, take a new folder; one that the user named stays his."""
    global _run_folder
    if _run_folder is not None or POCL_VARIABLE in os.environ:
        yield
        return
    _run_folder = _make_run_folder()
    os.environ[POCL_VARIABLE] = str(_run_folder)
    try:
        yield
    finally:
        del os.environ[POCL_VARIABLE]  # processes that this one starts take their own


_run_folder: Path | None = None


@contextmanager
def no_pyopencl_cache() -> Iterator[None]:
    """Let pyopencl, which looks once while it is imported, keep no database of its own in the user's cache folder.

    Where there is no such folder it cannot be imported, a damaged one ends every launch, and nothing is faster for it.
    """
    named = os.environ.get(PYOPENCL_VARIABLE)
    os.environ[PYOPENCL_VARIABLE] = named or "1"
    try:
        yield
    finally:
        if named is None:
            del os.environ[PYOPENCL_VARIABLE]


def _make_run_folder() -> Path:
    _check_limit()
    place = cache_folder()
    if place is not None:
        place /= "run"
        try:
            place.mkdir(exist_ok=True)
            _remove_stale(place)
            folder = Path(tempfile.mkdtemp(prefix=f"{os.getpid()}-", dir=place)) if _has_room(place) else None
        except OSError:
            folder = None
    if place is None or folder is None:
        other = Path(tempfile.gettempdir())
        if not _has_room(other):
            raise DeviceError(
                f"kernels are compiled into files, which take some {_ROOM_BYTES >> 20} MB: there is no such room in "
                f"{f'{place.parent} nor in ' if place else ''}{other}"
            )
        folder = Path(tempfile.mkdtemp(prefix="clrelight-kernels-"))
    # Registered before the driver starts, so it runs after its last kernel.
    atexit.register(_remove_own, folder, os.getpid())
    return folder


def _check_limit() -> None:
    """Raise DeviceError where LLVM would end the process, as its files may not get as large as they do."""
    import resource  # not on Windows, where PoCL keeps nothing

    limit = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    if limit != resource.RLIM_INFINITY and limit < _FILE_BYTES:
        raise DeviceError(
            f"kernels are compiled into files of {_FILE_BYTES >> 20} MB and more, those of this process may have "
            f"{limit} bytes: raise ulimit -f"
        )


def _has_room(folder: Path) -> bool:
    system = os.statvfs(folder)
    return not system.f_blocks or system.f_bavail * system.f_frsize >= _ROOM_BYTES


def _remove_own(folder: Path, owner: int) -> None:
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def _remove_stale(place: Path) -> None:
    """Remove the folders of processes that were killed; by age, as other machines may share the place."""
    for entry in os.scandir(place):
        try:
            if time.time() - entry.stat().st_mtime > _STALE_SECONDS:
                shutil.rmtree(entry.path, ignore_errors=True)
        except OSError:
            continue


class KernelCache:
    """The archives of one driver build on one processor.

    Parameters
    ----------
    identity : str
        Of driver, processor and what else decides on machine code.
    by_bitcode : bool
        Whether the driver builds programs of the bitcode that it has left, as PoCL 3.0 does.
    """

    def __init__(self, identity: str, *, by_bitcode: bool = False) -> None:
        place = cache_folder()
        keeps = place is not None and _run_folder is not None
        named = _DIGEST(f"{_VERSION}\0{identity}".encode()).hexdigest()[:32]
        self._folder = place / "kernels" / named if place and keeps else None
        self._by_bitcode = by_bitcode and self._folder is not None
        # Shared by all devices of one driver in this process: what is unpacked again may be mapped already.
        self._programs = _unpacked.setdefault(str(self._folder), {})

    @contextmanager
    def building(self, source: str, options: list[str]) -> Iterator[str]:
        """Build a program inside: what is kept of it is unpacked before, and what it adds is known as its own.

        Yields
        ------
        str
            The program's name for the other methods.
        """
        # Of bitcode, what was compiled of the source would lie at other places.
        words = [source, *options, *(["of bitcode"] if self._by_bitcode else [])]
        name = _DIGEST("\0".join(words).encode()).hexdigest()[:40]
        if self._folder is None or _run_folder is None:
            yield name
            return
        with _building:
            self._programs[name] = self._unpack(name) if name not in self._programs else self._programs[name]
            yield name

    @contextmanager
    def compiling(self, source: str, name: str) -> Iterator[list[str]]:
        """Compile a program's source inside `building`, with these options in addition."""
        before = set() if self._folder is None else _program_folders()
        kernels = dict.fromkeys(_KERNEL.findall(source)) if self._by_bitcode else {}
        yield [f"-D{kernel}={self.own_name(kernel, name)}" for kernel in kernels]
        if self._folder is not None:
            self._programs[name] |= _program_folders() - before

    def bitcode(self, name: str) -> bytes | None:
        """Return what a program is to be built of inside `building`, None where that is its source."""
        if not self._by_bitcode or _run_folder is None:
            return None
        found = [path for folder in self._programs[name] if (path := _run_folder / folder / _BITCODE).is_file()]
        return found[0].read_bytes() if len(found) == 1 else None

    def forget(self, name: str) -> None:
        """Remove, inside `building`, all of a program that the driver does not take, lest it finds that again."""
        if _run_folder is not None:
            for folder in [*(_run_folder / folder for folder in self._programs[name]), *self._own_folders(name)]:
                shutil.rmtree(folder, ignore_errors=True)
            self._programs[name] = set()
            _held.pop(self._path(name), None)

    def own_name(self, kernel: str, name: str) -> str:
        """Return what a kernel is called in a program."""
        return f"{kernel}_{name[:_TAG]}" if self._by_bitcode else kernel

    def seal(self, names: set[str]) -> None:
        """Keep what these programs have compiled by now, in whole archives; a full disk costs the archive, no more."""
        if self._folder is None or _run_folder is None:
            return
        with _building:
            for name in names:
                folders = [_run_folder / folder for folder in self._programs.get(name, ())]
                folders += self._own_folders(name)
                files = sorted(
                    path.relative_to(_run_folder).as_posix()
                    for folder in folders
                    for path in folder.rglob("*")
                    if path.is_file()
                )
                if files and files != _held.get(self._path(name)):
                    self._write(name, files)

    def _own_folders(self, name: str) -> list[Path]:
        """Return where PoCL keeps what it compiles of a program's bitcode: folders of the kernels' names."""
        return [] if _run_folder is None else list(_run_folder.glob(f"*_{name[:_TAG]}"))

    def _path(self, name: str) -> Path:
        assert self._folder is not None
        return self._folder / f"{name}.kernels"

    def _write(self, name: str, files: list[str]) -> None:
        assert _run_folder is not None
        path = self._path(name)
        try:
            write_archive(path, _run_folder, files)
            _held[path] = files
            self._prune()
        except OSError as error:
            _say_once(f"{path.parent}: {error.strerror or error}: kernels are compiled anew in the next run")

    def _unpack(self, name: str) -> set[str]:
        """Return the folders that an archive brought; none where there is no archive, or a damaged one."""
        assert _run_folder is not None
        path = self._path(name)
        try:
            content = path.read_bytes()
        except OSError as error:
            if not isinstance(error, FileNotFoundError):
                _say_once(f"{path}: {error.strerror or error}: kernels are compiled anew")
            return set()
        if not holds_whole(path, content):
            _say_once(f"{path}: damaged: its kernels are compiled anew")
            return set()
        try:
            files = unpack_archive(content, _run_folder)
        except OSError as error:
            _say_once(f"{_run_folder}: {error.strerror or error}: kernels are compiled anew")
            return set()
        with suppress(OSError):  # another process may prune it now
            os.utime(path)
        _held[path] = sorted(files)
        return {folder for file in files if (folder := two_folders(file)).find("/") == 2}

    def _prune(self) -> None:
        assert self._folder is not None
        entries = []
        for entry in _archives(self._folder.parent):
            with suppress(FileNotFoundError):  # another process may prune at the same time
                entries.append((entry.stat().st_mtime, entry.stat().st_size, entry.path))
        total = sum(size for _, size, _ in entries)
        for _, size, path in sorted(entries):
            if total <= MOST_BYTES:
                break
            with suppress(FileNotFoundError):
                os.unlink(path)
            total -= size


def _archives(parent: Path) -> Iterator[os.DirEntry[str]]:
    for folder in os.scandir(parent):
        if folder.is_dir():
            yield from (entry for entry in os.scandir(folder.path) if entry.name.endswith(".kernels"))


def _program_folders() -> set[str]:
    """PoCL keeps a program in AB/CDEF..., of bitcode in the kernels' names; its temporary files lie in the cache."""
    assert _run_folder is not None
    return {path.relative_to(_run_folder).as_posix() for path in _run_folder.glob("??/*") if path.is_dir()}


def _say_once(line: str) -> None:
    if line not in _said:
        _said.add(line)
        log.warning("clrelight: %s", line)
