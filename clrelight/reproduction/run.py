"""Compute works, and judge their rows."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clrelight.device import Device, open_device
from clrelight.errors import InputError
from clrelight.report.canvas import require_matplotlib
from clrelight.reproduction.rows import FAILS, NEEDS_DATA, OUT, Bench, Number, Paper, Row, Work, shown

Progress = Callable[[int, int, str], object]


@dataclass(frozen=True)
class Outcome:
    """A row with ours and a verdict; of what is out, the reason alone."""

    paper: str
    item: str
    what: str
    printed: str
    where: str
    ours: str
    tolerance: str
    verdict: str
    reason: str = ""

    def to_json(self) -> dict[str, str]:
        """Return it as an object of JSON."""
        return dict(self.__dict__)


@dataclass
class Reproduction:
    """All outcomes, pictures by file name (with paper and item), and the seconds of each work."""

    outcomes: list[Outcome] = field(default_factory=list)
    pictures: dict[str, Any] = field(default_factory=dict)
    shows: dict[str, tuple[str, str]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def holds(self) -> bool:
        """Whether no verdict fails."""
        return all(each.verdict != FAILS for each in self.outcomes)

    def counts(self) -> dict[str, int]:
        """Return how many rows have each verdict."""
        names = [each.verdict for each in self.outcomes]
        return {name: names.count(name) for name in dict.fromkeys(names)}


def reproduce(
    papers: Sequence[Paper],
    *,
    data: Path | None = None,
    device: Device | str | None = None,
    draws: bool = True,
    progress: Progress | None = None,
) -> Reproduction:
    """Compute the works of some papers and judge every row.

    Parameters
    ----------
    papers : sequence of Paper
        From `registry.choose`.
    data : path, optional
        Folder of probes, meshes and reflectances; rows that need a file that it lacks are told, and not computed.
    device : Device or str, optional
        Opened when first needed.
    draws : bool
        Whether pictures are made.
    progress : callable, optional
        Called with works done, works in all, and what is next.

    Raises
    ------
    InputError
        If a package that works need is not installed, or `data` is no folder.
    """
    if data is not None and not data.is_dir():
        raise InputError(f"{data} is no folder: --data names that of probes, meshes and reflectances")
    works = [(paper, work) for paper in papers for work in paper.works]
    _check_packages([work for _, work in works])
    opened: list[Device] = []

    def lend() -> Device:
        if not opened:
            opened.append(device if isinstance(device, Device) else open_device(device))
        return opened[0]

    bench, made = Bench(data, lend, draws), Reproduction()
    for done, (paper, work) in enumerate(works):
        if progress is not None:
            progress(done, len(works), f"{paper.id}: {work.name}")
        _perform(paper, work, bench, made)
        if paper.works[-1] is work:
            _tell_out(paper, made)
    for paper in papers:
        if not paper.works:
            _tell_out(paper, made)
    if progress is not None:
        progress(len(works), len(works), "done")
    return made


def _check_packages(works: Sequence[Work]) -> None:
    """Raise InputError where works need what is not installed, before any runs."""
    require_matplotlib()
    if any(work.surfaces for work in works):
        try:
            import embreex  # noqa: F401
            import trimesh  # noqa: F401
        except ImportError:
            raise InputError(
                "figures of surfaces need trimesh and embreex: pip install 'clrelight[surfaces]'"
            ) from None


def _perform(paper: Paper, work: Work, bench: Bench, made: Reproduction) -> None:
    missing = [name for name in work.needs if bench.data is None or not (bench.data / name).is_file()]
    if missing:
        reason = f"{', '.join(missing[:2])}{' and others' if len(missing) > 2 else ''} of --data"
        made.outcomes += [_outcome(paper, row, None, NEEDS_DATA, reason) for row in work.rows]
        return
    since = time.perf_counter()
    found = work.run(bench)
    made.seconds[f"{paper.id}: {work.name}"] = time.perf_counter() - since
    made.outcomes += judge(paper, work.rows, found.values)
    kept = {name: picture for name, picture in found.pictures.items() if name in work.pictures and picture is not None}
    made.pictures |= kept
    made.shows |= {name: (paper.id, work.pictures[name]) for name in kept}


def judge(paper: Paper, rows: Sequence[Row], values: Mapping[str, Number]) -> list[Outcome]:
    """Return the outcome of each row; a value that is not there fails."""
    outcomes = []
    for row in rows:
        found = values.get(row.value)
        verdict = FAILS if found is None else row.judge(found)
        outcomes.append(_outcome(paper, row, found, verdict, "" if found is not None else "not computed"))
    return outcomes


def _outcome(paper: Paper, row: Row, found: Number | None, verdict: str, reason: str) -> Outcome:
    tolerance, ours = str(row.agrees), "–" if found is None else shown(found)
    if verdict == "differs":
        tolerance, reason = f"{row.agrees}; ours {_around(row)}", row.reason
    if str(row.agrees) == "yes" and found is not None:
        ours = "yes" if found == 1.0 else "no"
    return Outcome(paper.id, row.item, row.what, row.printed, row.where, ours, tolerance, verdict, reason)


def _around(row: Row) -> str:
    expected = row.expected
    numbers = getattr(expected, "numbers", None)
    return str(expected) if numbers is None else f"{shown(numbers)} {expected}"


def _tell_out(paper: Paper, made: Reproduction) -> None:
    made.outcomes += [Outcome(paper.id, each.item, each.what, "", "", "–", "", OUT, each.reason) for each in paper.out]
