"""The five papers, and which of their works a user asks for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from clrelight.errors import InputError
from clrelight.reproduction import fitting, frequency, irradiance, lighting, variation
from clrelight.reproduction.rows import QUICK, Paper, Work

PAPERS = {
    each.PAPER.id: each.PAPER for each in (fitting, irradiance, lighting, frequency, variation)
}  # fmt: skip
"""By the short name that commands take."""


def choose(paper: str | None, items: Sequence[str] = (), *, quick: bool = False) -> list[Paper]:
    """Return papers with the works that are asked for, each row of an item that is named; InputError names what is not.

    Parameters
    ----------
    paper : str, optional
        A short name of `PAPERS`; default: all of them.
    items : sequence of str
        Figures and tables, such as ``"figure 7"`` or ``"7"``, ``"table III"``; the rows of each.
    quick : bool
        Only works that take seconds.
    """
    if paper is not None and paper not in PAPERS:
        raise InputError(f"papers are {', '.join(PAPERS)}, got {paper!r}")
    papers = list(PAPERS.values()) if paper is None else [PAPERS[paper]]
    if items:
        papers = _of_items(papers, items)
    if quick:
        papers = [replace(each, works=[work for work in each.works if work.takes == QUICK]) for each in papers]
    return papers


def _of_items(papers: Iterable[Paper], items: Sequence[str]) -> list[Paper]:
    chosen: list[Paper] = []
    found: set[str] = set()
    for each in papers:
        works: list[Work] = []
        for work in each.works:
            rows = tuple(row for row in work.rows if any(_means(name, row.item) for name in items))
            shows = {file: item for file, item in work.pictures.items() if any(_means(name, item) for name in items)}
            if rows or shows:
                works.append(replace(work, rows=rows or work.rows, pictures=shows or work.pictures))
        out = [left for left in each.out if any(_means(name, left.item) for name in items)]
        named = [row.item for work in works for row in work.rows] + [left.item for left in out]
        named += [item for work in works for item in work.pictures.values()]
        found |= {name for name in items if any(_means(name, item) for item in named)}
        if works or out:
            chosen.append(replace(each, works=works, out=out))
    for name in items:
        if name not in found:
            known = dict.fromkeys(item for each in papers for item in each.items())
            raise InputError(f"nothing is known of {name!r}; there are {', '.join(known)}")
    return chosen


def _means(name: str, item: str) -> bool:
    """Say whether a name means an item: the same words; a number alone a figure; a figure among several."""
    wanted, held = name.lower().split(), item.lower().replace(",", " ").split()
    if len(wanted) == 1 and wanted[0].isdigit():
        wanted = ["figure", wanted[0]]
    if wanted == held:
        return True
    if held[:1] == ["figures"] and wanted[:1] == ["figure"] and len(wanted) == 2:
        return _number_in(wanted[1], held[1:])
    return False


def _number_in(number: str, words: Sequence[str]) -> bool:
    if "to" in words and number.isdigit():
        at = words.index("to")
        return int(words[at - 1]) <= int(number) <= int(words[at + 1])
    return number in words
