"""Files that replace an old one only when they are whole (POSIX)."""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from clrelight.errors import BusyError, InputError
from clrelight.interrupts import at_end, forget, holding
from clrelight.streaming import one_thread

SYNC_BYTES = 32 << 20
"""Bytes that a large file gathers before they are sent to the disk."""
STEM_BYTES = 232
"""Bytes of a name, of the 255 that systems take, to which a dot, eight random letters and an ending can be added."""


@dataclass(frozen=True)
class Part:
    """The sibling of the file `target` while it is written, and a descriptor that holds its lock, if it has one."""

    target: Path
    path: Path
    descriptor: int
    is_locked: bool = True

    def write(self, content: bytes | memoryview) -> None:
        """Write every byte, for a single call of the system may take fewer; InputError if it refuses."""
        rest = memoryview(content)
        with naming(self.target):
            while rest:
                rest = rest[os.write(self.descriptor, rest) :]

    def reserve(self, n_bytes: int) -> None:
        """Make sure that the disk has room for a file of `n_bytes`, and keep it; OSError if it has not."""
        system = os.fstatvfs(self.descriptor)
        free = system.f_bavail * system.f_frsize
        if system.f_blocks and free < n_bytes:  # some network systems report no sizes at all
            full = f"it needs {n_bytes / 1e6:.0f} MB, {free / 1e6:.0f} MB are free"
            raise OSError(errno.EFBIG, full)
        try:
            os.posix_fallocate(self.descriptor, 0, n_bytes)
        except OSError as error:
            if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
                raise  # else a file system that cannot reserve: the free space must do


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Part]:
    """Lend a file to write; it stands at `path` once the block has ended well.

    The bytes go to the sibling ``.NAME.part``, which is flushed, renamed over `path`, and removed if anything at
    all goes wrong, a keyboard interrupt included; until the rename a file that is there stays as it is. A lock on
    the sibling keeps two programs from writing one file, and goes away with its program, so that a sibling left by
    a killed one is taken over.

    Raises
    ------
    InputError
        If the folder is missing, `path` is there and no regular file, another program is writing it, or the
        system refuses (no permission, disk full).
    """
    target = Path(os.fsdecode(path))
    with naming(target):
        _check_target(target)
    with _lend_sibling(target, ".part") as part:
        with naming(target):
            os.ftruncate(part.descriptor, 0)
        yield part
        with naming(target):
            os.fsync(part.descriptor)
            os.replace(part.path, target)
    _sync_folder(target.parent)


@contextmanager
def claiming(path: str | os.PathLike) -> Iterator[bool]:
    """Keep every other program from a file or folder through long work that writes it at last, or many times.

    The claim is a lock on the sibling ``.NAME.lock``, which goes away with its program, however that ends. Lends
    whether there is one: some network file systems know none.

    Raises
    ------
    InputError
        If another program has claimed `path`, or the system refuses (no permission, disk full).
    """
    with _lend_sibling(Path(os.fsdecode(path)), ".lock") as lock:
        yield lock.is_locked


def no_locks(path: str | os.PathLike) -> str:
    """Return what to say where `claiming` found no locks."""
    return f"there are no file locks where {os.fsdecode(path)} lies: let no second program write it"


@contextmanager
def _lend_sibling(target: Path, ending: str) -> Iterator[Part]:
    """Lend a sibling that no other program has; it is removed when the block ends, unless it was renamed."""
    lent: Part | None = None
    try:
        with holding(), naming(target):
            lent = _open_locked(target.with_name(sibling_stem(target.name) + ending), target)
            key = at_end(partial(_remove_sibling, lent))
        yield lent
    finally:
        with holding():
            if lent is not None:
                forget(key)
                _remove_sibling(lent)
                os.close(lent.descriptor)


def sibling_stem(name: str) -> str:
    """Return ``.NAME``, or something else in place of a name that is no text, or leaves no room for an ending."""
    encoded = os.fsencode(name)
    try:
        is_plain = len(encoded) <= STEM_BYTES and encoded.decode("utf-8") == name
    except UnicodeDecodeError:
        is_plain = False
    return f".{name if is_plain else hashlib.sha256(encoded).hexdigest()[:32]}"


def _remove_sibling(part: Part) -> None:
    # By that name there may be another program's by now: ours was renamed.
    with suppress(OSError):
        if os.path.samestat(os.fstat(part.descriptor), os.lstat(part.path)):
            os.unlink(part.path)


@contextmanager
def syncing(path: str | os.PathLike, descriptor: int) -> Iterator[Callable[[int], None]]:
    """Lend a function that is told how many bytes were written: they go to the disk beside whatever comes next.

    So the flush at the end finds little left. What the disk says against it comes with the next call, or at the end
    of the block, as InputError that names `path`; the thread has ended when the block has.
    """
    pending: Future[None] | None = None
    waiting = 0

    def wrote(n_bytes: int) -> None:
        nonlocal pending, waiting
        waiting += n_bytes
        if waiting >= SYNC_BYTES and (pending is None or pending.done()):
            if pending is not None:
                with naming(path):
                    pending.result()
            pending, waiting = pool.submit(os.fdatasync, descriptor), 0

    with one_thread() as pool:
        yield wrote
        if pending is not None:
            with naming(path):
                pending.result()


@contextmanager
def replacing_folder(path: str | os.PathLike) -> Iterator[Path]:
    """Lend a new folder to put files into; it stands at `path` once the block has ended well.

    It is filled in a sibling ``.NAME.*.part`` that no other program uses, its files are flushed, and it is renamed to
    `path`, where nothing or an empty folder may be. The sibling is removed if anything goes wrong.

    Raises
    ------
    InputError
        If something is at `path`, or the system refuses (no permission, disk full).
    """
    target = Path(os.fsdecode(path))
    with naming(target), folder_aside(target) as sibling:
        # One more level: the sibling is for its owner's eyes alone, the result for whom the umask says.
        folder = sibling / target.name
        folder.mkdir()
        try:
            yield folder
        except InputError as error:  # of a file that nobody will see there
            raise InputError(str(error).replace(str(folder), str(target))) from error
        for place, _, names in os.walk(folder):
            for name in names:
                with open(os.path.join(place, name), "rb") as written:
                    os.fsync(written.fileno())
            _sync_folder(Path(place))
        os.replace(folder, target)
    _sync_folder(target.parent)


@contextmanager
def folder_aside(target: Path) -> Iterator[Path]:
    """Lend a folder ``.NAME.*.part`` beside `target` that is no other program's, and gone when the block has ended."""
    sibling: Path | None = None
    try:
        with holding():
            prefix = sibling_stem(target.name) + "."
            sibling = Path(tempfile.mkdtemp(prefix=prefix, suffix=".part", dir=target.parent))
            key = at_end(partial(shutil.rmtree, sibling, ignore_errors=True))
        yield sibling
    finally:
        with holding():
            if sibling is not None:
                shutil.rmtree(sibling, ignore_errors=True)
                forget(key)


@contextmanager
def naming(path: str | os.PathLike) -> Iterator[None]:
    """Turn what the system says against writing `path` into one line of InputError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot write {os.fsdecode(path)}: {reason_of(error)}") from error


def reason_of(error: OSError) -> str:
    """Return why the system refused, without the file's name."""
    return "the disk is full" if error.errno in (errno.ENOSPC, errno.EDQUOT) else error.strerror or str(error)


def check_output(path: str | os.PathLike, inputs: Iterable[str | os.PathLike] = ()) -> None:
    """Raise InputError if `path` cannot be written as it looks now, or is one of the `inputs`, by whatever name.

    For asking before long work: so that it is not done in vain, and no input is replaced by its own result.
    """
    target = Path(os.fsdecode(path))
    with naming(target):
        _check_target(target)
    for source in inputs:
        if _is_same_file(target, source):
            raise InputError(f"cannot write {target}: that is the input {os.fsdecode(source)}, choose another name")


def _is_same_file(target: Path, source: str | os.PathLike) -> bool:
    try:
        # Neither need be there yet: two outputs of one command are compared too.
        return os.path.realpath(target) == os.path.realpath(os.fsdecode(source)) or os.path.samefile(target, source)
    except (OSError, ValueError):  # one of them is not there, or is no name at all
        return False


def _check_target(target: Path) -> None:
    if not target.name or "\0" in str(target):
        raise InputError(f"cannot write {str(target)!r}: that is no file name")
    if not target.parent.is_dir():
        raise InputError(f"cannot write {target}: there is no folder {target.parent}")
    with suppress(FileNotFoundError):
        if not stat.S_ISREG(os.lstat(target).st_mode):
            raise InputError(f"cannot write {target}: it is there and is no regular file")


def _open_locked(sibling: Path, target: Path) -> Part:
    while True:
        descriptor = os.open(sibling, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
        try:
            is_locked = _lock(descriptor, target)
            ours = os.fstat(descriptor)
            if not stat.S_ISREG(ours.st_mode) or ours.st_nlink > 1:
                raise InputError(f"cannot write {sibling}: it is there and is no plain file, remove it")
            with suppress(FileNotFoundError):
                if os.path.samestat(ours, os.lstat(sibling)):
                    return Part(target, sibling, descriptor, is_locked)
        except BaseException:
            os.close(descriptor)
            raise
        # Its writer renamed it between our open and our lock: what we hold is the finished file, not a part.
        os.close(descriptor)


def _lock(descriptor: int, target: Path) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise BusyError(
            f"cannot write {target}: another program is writing it; wait for its end, or choose another name"
        ) from None
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL):
            raise
        return False  # a file system without locks: go on, as every other writer would
    return True


def _sync_folder(folder: Path) -> None:
    # The file is whole and in place; a file system that cannot sync folders is no reason to say otherwise.
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
