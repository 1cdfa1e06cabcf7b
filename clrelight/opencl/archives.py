"""Files of compiled kernels in one: a checksum of where it belongs and of what it holds, then a zip archive."""

from __future__ import annotations

import hashlib
import io
import shutil
import zipfile
from collections.abc import Iterable
from pathlib import Path

from clrelight.opencl.folder import write_whole


def write_archive(path: Path, folder: Path, files: Iterable[str]) -> None:
    """Keep files of a folder; OSError where they cannot be read or the archive cannot be written."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for file in files:
            # Without times, so that equal contents are equal bytes.
            archive.writestr(zipfile.ZipInfo(file), (folder / file).read_bytes())
    content = packed.getvalue()
    write_whole(path, _checksum(path, content) + content)


def holds_whole(path: Path, content: bytes) -> bool:
    """Return whether an archive's bytes are as they were written, and to that path, not another's."""
    size = hashlib.sha256().digest_size
    return _checksum(path, content[size:]) == content[:size]


def unpack_archive(content: bytes, folder: Path) -> list[str]:
    """Return the files that a whole archive brings into a folder; OSError, and none of them, where that fails."""
    with zipfile.ZipFile(io.BytesIO(content[hashlib.sha256().digest_size :])) as archive:
        files = archive.namelist()
        try:
            archive.extractall(folder)
        except OSError:
            # Half of it may be there, which the driver must not find.
            for file in files:
                shutil.rmtree(folder / two_folders(file), ignore_errors=True)
            raise
    return files


def two_folders(file: str) -> str:
    """Return the first two names of a path: PoCL keeps a program, or one form of a kernel, in a folder in a folder."""
    return "/".join(file.split("/")[:2])


def _checksum(path: Path, content: bytes) -> bytes:
    """Return the digest of an archive's content, of its name, and of the folder, which is its driver's."""
    return hashlib.sha256(f"{path.parent.name}/{path.name}\0".encode() + content).digest()
