"""Lists of stacks in TOML: which stacks, with which options for all or some of them."""

from __future__ import annotations

import glob
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from clrelight.batch.stacks import Listing, Stack, matches
from clrelight.batch.verbs import find_verb
from clrelight.errors import InputError

_KEYS = ("job", "stacks", "exclude", "ending", "options", "stack", "override")
_STACK_KEYS = ("source", "name", "options")


def read_list(file: Path, job: str | None) -> Listing:
    """Return what a list in TOML says (docs/batches.md); InputError names what is not right."""
    try:
        given = tomllib.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"there is no file or folder {file}") from None
    except OSError as error:
        raise InputError(f"cannot read {file}: {error.strerror or error}") from error
    except RecursionError:
        raise InputError(f"{file} is no list in TOML: its values are nested too deeply") from None
    except ValueError as error:  # of TOML, of UTF-8, or of a number with thousands of digits
        raise InputError(f"{file} is no list in TOML: {error}") from None
    try:
        return _listing_of(given, file.parent, job)
    except InputError as error:
        raise InputError(f"{file}: {error}") from None


def _listing_of(given: Mapping[str, Any], base: Path, job: str | None) -> Listing:
    _check_keys(given, _KEYS, "")
    named = job or _typed(str, given, "job", "")
    if not named:
        raise InputError('it needs a job, such as job = "pack", or --job')
    find_verb(named)
    patterns, excluded = (_texts(given, key) for key in ("stacks", "exclude"))
    stacks: dict[str, Stack] = {}
    for pattern in patterns:
        for path in _expanded(base, pattern):
            stack = Stack(path.name if path.is_dir() else path.stem, os.path.abspath(path))
            if not matches(os.path.relpath(path, base), excluded) and not matches(stack.name, excluded):
                stacks.setdefault(stack.source, stack)
    for entry in _tables(given, "stack"):
        _check_keys(entry, _STACK_KEYS, "[[stack]] ")
        if "source" not in entry:
            raise InputError("every [[stack]] needs a source")
        for path in _expanded(base, _typed(str, entry, "source", "")):
            plain = path.name if path.is_dir() else path.stem
            name = _typed(str, entry, "name", plain)
            stacks[os.path.abspath(path)] = Stack(name, os.path.abspath(path), _typed(dict, entry, "options", {}))
    overrides = []
    for entry in _tables(given, "override"):
        if "match" not in entry:
            raise InputError('every [[override]] needs a match, such as "coin-*"')
        options = {name: value for name, value in entry.items() if name != "match"}
        overrides.append((_typed(str, entry, "match", ""), options))
    notes = [
        f"[[override]] {pattern} matches no stack"
        for pattern, _ in overrides
        if not any(matches(stack.name, [pattern]) for stack in stacks.values())
    ]
    ending, options = _typed(str, given, "ending", ""), _typed(dict, given, "options", {})
    told = _typed(str, given, "job", "")
    return Listing(tuple(stacks.values()), str(base), told, ending, options, tuple(overrides), tuple(notes))


def _expanded(base: Path, pattern: str) -> list[Path]:
    """Return what a pattern names, in the order of names; InputError where that is nothing."""
    plain = base / pattern
    if plain.exists():
        return [plain]
    found = sorted(Path(each) for each in glob.glob(os.path.join(glob.escape(str(base)), pattern), recursive=True))
    if not found:
        raise InputError(f"there is no {plain}")
    return found


def _check_keys(given: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in given:
        if key not in known:
            raise InputError(f"{where}unknown key {key!r}; known are {', '.join(known)}")


def _typed(kind: type, given: Mapping[str, Any], key: str, default: Any) -> Any:
    value = given.get(key, default)
    if type(value) is not kind:
        raise InputError(f"{key} must be {'a text' if kind is str else 'a table'}, got {_short(value)}")
    return value


def _texts(given: Mapping[str, Any], key: str) -> list[str]:
    value = given.get(key, [])
    if not isinstance(value, list) or not all(isinstance(each, str) for each in value):
        raise InputError(f"{key} must be a list of texts, got {_short(value)}")
    return value


def _tables(given: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    value = given.get(key, [])
    if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
        raise InputError(f"[[{key}]] must be tables, got {_short(value)}")
    return value


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:80]}..."
