"""Which files of a folder are meant: by names that light files give, or by being a series of photographs."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Callable, Sequence
from itertools import islice
from pathlib import Path, PurePosixPath

from clrelight.errors import InputError
from clrelight.images import IMAGE_EXTENSIONS

_NO_PHOTOGRAPH = re.compile(r"(?:^|[^a-z])(?:mask|normals?|normalmap|albedo|depth|thumb|thumbnail|preview)(?:$|[^a-z])")
_MOST_PLACES = 100
_INDEX = re.compile(r"([0-9]{1,9})[\s,;]+(.+)")


def natural_key(name: str) -> tuple[list[str | int], str]:
    """Return a sort key that orders numbers within names by value: ``9.png`` before ``10.png``."""
    parts = re.split(r"([0-9]+)", name.casefold())
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], name


def list_photographs(folder: Path, count: int, source: Path) -> tuple[tuple[Path, ...], list[str]]:
    """Return the images of a folder that `count` lights were taken of, in natural order, and notes.

    These are all images but those whose names say that they are something else (a mask, normals, a thumbnail); or,
    where there are more than lights, the one series of names that differ in numbers alone and has as many.

    Raises
    ------
    InputError
        If there is no such set of images, or more than one.
    """
    listed = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_EXTENSIONS and not p.name.startswith(".")]
    listed.sort(key=lambda p: natural_key(p.name))
    if not listed:
        raise InputError(f"there are no images in {folder}")
    series: dict[str, list[Path]] = {}
    for path in listed:
        series.setdefault(re.sub(r"[0-9]+", "#", path.name.casefold()), []).append(path)
    photographs = [path for path in listed if not _NO_PHOTOGRAPH.search(path.stem.casefold())]
    if len(photographs) != count:
        fitting = [paths for paths in series.values() if len(paths) == count > 1]
        if len(fitting) != 1:
            raise InputError(f"{folder} holds {_counted(listed, photographs)}, but {source} {count} light directions")
        photographs = fitting[0]
    notes = [f"images in the order of their names, {photographs[0].name} to {photographs[-1].name}"]
    left = [path.name for path in listed if path not in photographs]
    if left:
        notes.append(f"left out of the images: {_some(left)}")
    largest = max(series.values(), key=len)
    odd = [path.name for path in photographs if path not in largest]
    if len(largest) > 1 and 0 < len(odd) < len(largest):
        notes.append(f"taken as photographs although named otherwise than {largest[0].name}: {_some(odd)}")
    return tuple(photographs), notes


def list_series(folder: Path) -> tuple[Path, ...]:
    """Return the photographs of a folder that has no light file, in natural order: all images but masks and such.

    InputError if there are none.
    """
    listed = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_EXTENSIONS and not p.name.startswith(".")]
    photographs = [path for path in listed if not _NO_PHOTOGRAPH.search(path.stem.casefold())]
    if not photographs:
        raise InputError(f"there are no images in {folder}")
    return tuple(sorted(photographs, key=lambda p: natural_key(p.name)))


def resolve_names(
    folder: Path, names: Sequence[str], source: Path, label: Callable[[int], str]
) -> tuple[tuple[Path, ...], list[str]]:
    """Return the named files and notes: as written relative to the folder, else by base name in the folder.

    Light files keep the folders of the machine they were made on, also Windows's. Names are also found if they differ
    in case, in how Unicode writes an accent, or in the extension, where one file alone can be meant; and without a
    number before each that counts the lines.

    Raises
    ------
    InputError
        If a file is missing, could be one of several, or is named twice.
    """
    known = _Files(folder)
    plain = _without_index(names)
    if plain is not None and known.find(names[0])[0] is None:
        names = plain
    images: list[Path] = []
    kinds: dict[str, list[str]] = {}
    taken: dict[tuple[int, int], int] = {}
    missing: list[int] = []
    for light, name in enumerate(names):
        path, how = known.find(name)
        if path is None:
            missing.append(light)
            continue
        if how:
            kinds.setdefault(how, []).append(f"{name} is {path.name}")
        status = path.stat()
        first = taken.setdefault((status.st_dev, status.st_ino), light)
        if first != light:
            one = "" if names[first] == name else f" as {names[first]} and {name}"
            raise InputError(f"{source} names image {path.name}{one} for {label(first)} and for {label(light)}")
        images.append(path)
    if missing:
        more = f"; {len(missing)} of {len(names)} images are missing" if len(missing) > 1 else ""
        if len(missing) == len(names):
            more += _elsewhere(folder, names[0], source)
        wanted = known.wanted(names[missing[0]])
        raise InputError(f"there is no image {wanted}, which {source} names for {label(missing[0])}{more}")
    return tuple(images), [
        f"{len(found)} name{'s differ' if len(found) > 1 else ' differs'} in {how} from the files: {found[0]}"
        for how, found in kinds.items()
    ]


def has_image(folder: Path, name: str) -> bool:
    """Tell whether `resolve_names` would find an image."""
    return _Files(folder).find(name)[0] is not None


def _elsewhere(folder: Path, name: str, source: Path) -> str:
    """Return which folder within holds an image, as where a project keeps its light file beside its exports."""
    plain = PurePosixPath(name.replace("\\", "/")).name
    places = sorted(islice((path for path in folder.iterdir() if path.is_dir()), _MOST_PLACES))
    held = (place for place in places if os.path.isfile(place / plain))
    return next((f"; {place} holds it: give that folder, and --lights {source}" for place in held), "")


class _Files:
    """The files of a folder by their names, by what of a name is the same everywhere, and by its stem."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._alike_in: dict[Path, dict[tuple[str, str], list[Path]]] = {}

    def wanted(self, name: str) -> Path:
        """Return the path that a name asks for first."""
        return self._candidates(name)[0]

    def find(self, name: str) -> tuple[Path | None, str]:
        """Return the file of a name, and in what the two differ if they do; InputError if several could be meant."""
        candidates = self._candidates(name)
        found = next((path for path in candidates if os.path.isfile(path)), None)
        if found is not None:
            return found, ""
        for key_of, how in ((_key, "case or accents"), (_stem_key, "extension")):
            for wanted in candidates:
                fitting = self._alike(wanted.parent, how, key_of(wanted.name))
                if len(fitting) > 1:
                    both = " and ".join(path.name for path in fitting[:2])
                    raise InputError(f"there is no image {wanted}, and both {both} could be meant: name one of them")
                if fitting:
                    return fitting[0], how
        return None, ""

    def _candidates(self, name: str) -> list[Path]:
        written = PurePosixPath(name.replace("\\", "/"))
        if written.is_absolute() or not written.name:
            return [self.folder / (written.name or name)]
        return [self.folder / written, self.folder / written.name]

    def _alike(self, parent: Path, how: str, key: str) -> list[Path]:
        if parent not in self._alike_in:
            alike = self._alike_in.setdefault(parent, {})
            for path in sorted(parent.iterdir()) if os.path.isdir(parent) else []:
                if path.is_file() and not path.name.startswith("."):
                    alike.setdefault(("case or accents", _key(path.name)), []).append(path)
                    if path.suffix.lower() in IMAGE_EXTENSIONS:
                        alike.setdefault(("extension", _stem_key(path.name)), []).append(path)
        return self._alike_in[parent].get((how, key), [])


def _key(name: str) -> str:
    """Return what of a file's name is the same on every system."""
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        # Bytes that are no UTF-8, as older systems wrote them.
        name = name.encode("utf-8", "surrogateescape").decode("windows-1252", "replace")
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold())


def _stem_key(name: str) -> str:
    return re.sub(r"\.[a-z][a-z0-9]{1,4}$", "", _key(name))


def _without_index(names: Sequence[str]) -> list[str] | None:
    """Return the names without the numbers before them, if these count from 0 or 1."""
    found = [_INDEX.fullmatch(name) for name in names]
    if not all(found):
        return None
    numbers = [int(each[1]) for each in found if each]
    if numbers not in (list(range(len(names))), list(range(1, len(names) + 1))):
        return None
    return [each[2].strip("\"'") for each in found if each]


def _counted(listed: list[Path], photographs: list[Path]) -> str:
    others = [path.name for path in listed if path not in photographs]
    return f"{len(photographs)} images" + (f" (without {_some(others)})" if others else "")


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
