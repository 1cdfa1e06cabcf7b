"""Whether a result is still that of its inputs: digests of configuration, code, and files.

Files are known by name, size and time of change, as git knows them: where those are as they were nothing is read. Where
they are not (a copy, a touch, a clock that was set) the contents decide. Times are compared for equality, never for
order, so that no clock can make old results look new.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import xxhash

from clrelight import __version__
from clrelight.batch.task import Task
from clrelight.errors import InputError
from clrelight.store.opening import opening
from clrelight.store.schemas import SCHEMAS
from clrelight.store.shards import seal_in

_PIECE = 1 << 22
_SEAL = "seal "
_BESIDE_RESULTS = ("cli", "report", "speed")
"""Rooms on which no result hangs."""


@dataclass(frozen=True)
class Fingerprint:
    """What is known of a file, or of a folder's files, without their contents and with them.

    Attributes
    ----------
    bytes : int
        Of all files together.
    files : int
    stat : str
        Digest of names, sizes and times of change.
    content : str
        Digest of names and contents.
    """

    bytes: int
    files: int
    stat: str
    content: str

    def to_json(self) -> dict[str, Any]:
        """Return a JSON object."""
        return asdict(self)


def files_of(path: str | os.PathLike[str]) -> list[tuple[str, str]]:
    """Return name and path of a file, or of all files of a folder in the order of names; hidden ones are left out.

    InputError if there is nothing there.
    """
    text = os.fsdecode(path)
    try:
        if not stat.S_ISDIR(os.stat(text).st_mode):
            return [("", text)]
        return sorted(_walk(text, ""))
    except FileNotFoundError:
        raise InputError(f"there is no file or folder {text}") from None
    except OSError as error:
        raise InputError(f"cannot read {text}: {error.strerror or error}") from error


def _walk(folder: str, below: str) -> Iterator[tuple[str, str]]:
    for entry in os.scandir(folder):
        if entry.name.startswith("."):
            continue
        if entry.is_dir(follow_symlinks=False):
            yield from _walk(entry.path, f"{below}{entry.name}/")
        elif entry.is_file():
            yield f"{below}{entry.name}", entry.path


def look_at(path: str | os.PathLike[str]) -> tuple[int, int, str]:
    """Return bytes, number of files, and the digest of names, sizes and times of a file or folder."""
    found = []
    for name, file in files_of(path):
        try:
            known = os.stat(file)
        except OSError as error:
            raise InputError(f"cannot read {file}: {error.strerror or error}") from error
        found.append((name, known.st_size, known.st_mtime_ns))
    return sum(size for _, size, _ in found), len(found), _digest_of(found)


def read_content(path: str | os.PathLike[str]) -> str:
    """Return the digest of names and contents of a file or folder; InputError where one cannot be read."""
    found = []
    for name, file in files_of(path):
        summed = xxhash.xxh3_128()
        try:
            with open(file, "rb", buffering=0) as stream:
                while piece := stream.read(_PIECE):
                    summed.update(piece)
        except OSError as error:
            raise InputError(f"cannot read {file}: {error.strerror or error}") from error
        found.append((name, summed.hexdigest()))
    return _digest_of(found)


def take_fingerprint(path: str | os.PathLike[str]) -> Fingerprint:
    """Return the fingerprint of a file or folder; InputError if it changes meanwhile."""
    seen = look_at(path)
    content = read_content(path)
    if look_at(path) != seen:
        raise InputError(f"{os.fsdecode(path)} changes while it is read")
    return Fingerprint(*seen, content)


def take_seal(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the fingerprint of a file of ours as JSON, by its seal: no more of a large file is read than its table.

    The seal stands for the checksums of all blocks, which are compared whenever one is read. Of another file it is that
    of `take_fingerprint`.
    """
    seen = look_at(path)
    sealed = _seal_of(path)
    content = read_content(path) if sealed is None else sealed
    if look_at(path) != seen:
        raise InputError(f"{os.fsdecode(path)} changes while it is read")
    return Fingerprint(*seen, content).to_json()


def _seal_of(path: str | os.PathLike[str]) -> str | None:
    if os.path.isdir(path):
        return None
    try:
        with opening(path, *SCHEMAS) as opened:
            return f"{_SEAL}{seal_in(opened)}"
    except InputError:
        return None


def content_of(content: bytes) -> str:
    """Return what `read_content` does of a file that holds these bytes."""
    return _digest_of([("", xxhash.xxh3_128(content).hexdigest())])


def is_unchanged(path: str | os.PathLike[str], before: Mapping[str, Any], *, verify: bool = False) -> bool:
    """Return whether a file or folder holds what it held when its fingerprint was taken.

    Parameters
    ----------
    path : path
    before : mapping
        The fingerprint as JSON.
    verify : bool
        Read the contents also where names, sizes and times are as they were.
    """
    try:
        n_bytes, n_files, seen = look_at(path)
        if (n_bytes, n_files) != (before["bytes"], before["files"]):
            return False
        if seen == before["stat"] and not verify:
            return True
        if str(before["content"]).startswith(_SEAL):
            return _seal_of(path) == before["content"]
        return read_content(path) == before["content"]
    except (InputError, KeyError):
        return False


def task_key(task: Task, folder: str | os.PathLike[str]) -> str:
    """Return the digest of what a task does beside its inputs' contents: job, options, names, version and code.

    Names of files count as they are from `folder`, that of the results, so that both may be moved together.
    """
    files = {path: relative(path, folder) for path in (task.source, task.out, *task.inputs) if path}
    options = {
        name: files.get(value, relative(value, folder)) if isinstance(value, str) and os.path.isabs(value) else value
        for name, value in task.options.items()
    }
    return _digest_of([task.job, task.name, *files.values(), options, code_digest()])


def relative(path: str, folder: str | os.PathLike[str]) -> str:
    """Return a path as it is from a folder."""
    return os.path.relpath(path, folder)


@functools.cache
def code_digest() -> str:
    """Return a digest of the version and of every source file that results hang on, kernels included."""
    from clrelight.kernel_source import kernel_folder

    package = Path(__file__).resolve().parents[1]
    summed = hashlib.sha256(__version__.encode())
    for root, pattern in ((package, "*.py"), (kernel_folder(), "*.cl*")):
        for path in sorted(root.rglob(pattern)):
            name = path.relative_to(root).as_posix()
            if root is package and name.split("/")[0] in _BESIDE_RESULTS:
                continue
            summed.update(f"\0{name}\0".encode())
            summed.update(path.read_bytes())
    return summed.hexdigest()[:32]


def _digest_of(parts: Iterable[Any]) -> str:
    text = json.dumps(list(parts), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode("ascii")).hexdigest()[:32]
