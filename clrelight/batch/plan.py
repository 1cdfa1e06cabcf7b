"""From a folder or a list to tasks: one for each stack, with its options and names of files made whole."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from clrelight.batch.lists import read_list
from clrelight.batch.perform import outputs_of
from clrelight.batch.stacks import Listing, Stack, list_folder, matches
from clrelight.batch.task import Task
from clrelight.batch.verb import Verb, is_direction
from clrelight.batch.verbs import find_verb
from clrelight.errors import InputError

_DEFAULT = "default"


def read_listing(
    path: str | os.PathLike[str],
    job: str | None = None,
    *,
    match: Sequence[str] = (),
    out: str | os.PathLike[str] | None = None,
) -> Listing:
    """Return what a folder, or a list in TOML, says.

    Parameters
    ----------
    path : path
    job : str, optional
        What is to be done; default: what the list says.
    match : sequence of str
        Patterns; where there are some, stacks whose names match none are left out.
    out : path, optional
        Folder of the results, which may lie in the folder, and holds no stacks then.

    Raises
    ------
    InputError
        If there is no such thing, the list says what is not known, or two stacks have one name.
    """
    place = Path(os.fsdecode(path))
    if place.is_dir():
        if not job:
            raise InputError(f"{place} is a folder: name the job with --job, such as --job pack")
        listing = list_folder(place, find_verb(job), out)
    else:
        listing = read_list(place, job)
    kept = [each for each in listing.stacks if not match or matches(each.name, match)]
    if not kept:
        missed = f" that match {', '.join(match)}" if match and listing.stacks else ""
        raise InputError(f"{place} holds no stacks{missed} that {job or listing.job} takes")
    _check_names(kept)
    return replace(listing, stacks=tuple(kept))


def make_tasks(
    listing: Listing,
    out: str | os.PathLike[str],
    *,
    job: str | None = None,
    ending: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> list[Task]:
    """Return what is to be done to each stack.

    Options count in this order, the last most: those of the list, of its overrides that match, of the stack itself, and
    the given ones; ``"default"`` takes one back. In texts, ``{name}`` stands for the stack's name and ``{source}`` for
    its path.

    Parameters
    ----------
    listing : Listing
    out : path
        Folder of the results.
    job, ending : str, optional
        Instead of the list's.
    options : mapping, optional
        For all stacks; files are meant from the current folder.

    Raises
    ------
    InputError
        If the job or an option is not known, or two stacks would write one file.
    """
    verb, folder = find_verb(job or listing.job), os.path.abspath(os.fsdecode(out))
    if job and listing.job and job != listing.job:
        raise InputError(f"the list says that its job is {listing.job}, not {job}")
    last = _ending(verb, ending or listing.ending)
    tasks = []
    for stack in listing.stacks:
        chosen = _resolved(verb, listing.options, stack, listing.base, folder)
        for pattern, more in listing.overrides:
            if matches(stack.name, [pattern]):
                chosen |= _resolved(verb, more, stack, listing.base, folder)
        chosen |= _resolved(verb, stack.options, stack, listing.base, folder)
        chosen |= _resolved(verb, options or {}, stack, os.getcwd(), folder)
        verb.check(chosen)
        chosen = _without_defaults(chosen)
        result = "" if verb.is_measure else os.path.join(folder, *stack.name.split("/")) + last
        named = (chosen.get(name) for name in verb.reads)
        files = [value for value in named if isinstance(value, str) and value and not is_direction(value)]
        tasks.append(Task(stack.name, verb.id, stack.source, result, chosen, (stack.source, *files)))
    _check_outputs(tasks)
    return tasks


def _ending(verb: Verb, ending: str) -> str:
    known = (verb.ending, *verb.endings)
    if ending and ending not in known:
        written = " or ".join(each or "a folder" for each in known)
        raise InputError(f"{verb.id} writes {'no file' if verb.is_measure else written}, not {ending}")
    return ending or verb.ending


def _resolved(verb: Verb, options: Mapping[str, Any], stack: Stack, base: str, folder: str) -> dict[str, Any]:
    """Return options of one stack: placeholders filled in, and names of files made whole."""
    found = {}
    for name, value in options.items():
        if isinstance(value, str):
            value = value.replace("{name}", stack.name).replace("{source}", stack.source)
            if name in verb.reads and not is_direction(value):
                value = os.path.abspath(os.path.join(base, value))
            elif name in verb.writes:
                value = os.path.abspath(os.path.join(folder, value))
        found[name] = value
    return found


def _without_defaults(options: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value != _DEFAULT}


def _check_names(stacks: Sequence[Stack]) -> None:
    seen: dict[str, str] = {}
    for stack in stacks:
        parts = stack.name.split("/")
        if not stack.name or any(part in ("", ".", "..") or "\0" in part for part in parts) or parts[0][0] == ".":
            raise InputError(f"{stack.name!r} is no name for a stack ({stack.source})")
        if stack.name in seen:
            raise InputError(f"{seen[stack.name]} and {stack.source} are both called {stack.name}: name one of them")
        seen[stack.name] = stack.source


def _check_outputs(tasks: Sequence[Task]) -> None:
    writers: dict[str, str] = {}
    sources = {os.path.realpath(path): task.name for task in tasks for path in task.inputs}
    for task in tasks:
        for path in outputs_of(task):
            real = os.path.realpath(path)
            if real in sources:
                raise InputError(f"{task.name} would write {path}, which {sources[real]} reads: choose another folder")
            if real in writers:
                raise InputError(f"{writers[real]} and {task.name} would both write {path}: use {{name}} in its name")
            writers[real] = task.name
