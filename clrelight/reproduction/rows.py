"""What a printed number or figure is here: a row with a tolerance, the work that computes it, and a verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clrelight.device import Device

AGREES, DIFFERS, FAILS = "agrees", "differs", "FAILS"
"""Within the tolerance of what is printed; outside, for the reason that the row gives, and where it says; neither."""
NEEDS_DATA, OUT = "needs data", "out"
"""Not computed: a file is missing; nothing to compute, or declared out."""

Number = float | tuple[float, ...]


@dataclass(frozen=True)
class Near:
    """Every one of some numbers within a distance of those that are printed."""

    numbers: Number
    within: float

    def holds(self, found: Number) -> bool:
        """Say whether a number, or each of as many, is near enough; NaN never is."""
        printed, own = _several(self.numbers), _several(found)
        return len(printed) == len(own) and all(abs(a - b) <= self.within for a, b in zip(printed, own, strict=True))

    def __str__(self) -> str:
        return f"±{self.within:g}"


@dataclass(frozen=True)
class Between:
    """Numbers from a least to a most."""

    least: float = -float("inf")
    most: float = float("inf")

    def holds(self, found: Number) -> bool:
        """Say whether every number lies between; NaN never does."""
        return all(self.least <= value <= self.most for value in _several(found))

    def __str__(self) -> str:
        if self.least == -float("inf"):
            return f"≤ {self.most:g}"
        return f"≥ {self.least:g}" if self.most == float("inf") else f"{self.least:g} to {self.most:g}"


@dataclass(frozen=True)
class Holds:
    """Something that is said and must be so: 1 for yes."""

    def holds(self, found: Number) -> bool:
        """Say whether it is so."""
        return found == 1.0

    def __str__(self) -> str:
        return "yes"


Tolerance = Near | Between | Holds


@dataclass(frozen=True)
class Row:
    """A number or a statement as printed, and when ours counts as the same.

    Attributes
    ----------
    item : str
        ``"table III"``, ``"figure 7"``, ``"equation 9"``, ``"bounds"``.
    what : str
    printed : str
        As it stands in the paper.
    where : str
        Table, equation, figure or section that prints it.
    value : str
        The name of ours among what the work finds.
    agrees : Near, Between or Holds
    expected : Near, Between or Holds, optional
        Where ours must lie if it does not agree.
    reason : str
        Why it does not.
    """

    item: str
    what: str
    printed: str
    where: str
    value: str
    agrees: Tolerance
    expected: Tolerance | None = None
    reason: str = ""

    def judge(self, found: Number) -> str:
        """Return the verdict on a number of ours."""
        if self.agrees.holds(found):
            return AGREES
        return DIFFERS if self.expected is not None and self.expected.holds(found) else FAILS


@dataclass(frozen=True)
class Found:
    """What a work found: numbers by name, pictures by file name (codes, figures of matplotlib, or files)."""

    values: Mapping[str, Number]
    pictures: Mapping[str, Any] = field(default_factory=dict)


@dataclass
class Bench:
    """Where works run.

    Attributes
    ----------
    data : Path, optional
        Folder of probes, meshes and stacks.
    open_device : callable
        Opens the OpenCL device when it is first asked for.
    draws : bool
        Whether pictures are wanted.
    """

    data: Path | None
    open_device: Callable[[], Device]
    draws: bool = True

    def file(self, name: str) -> Path:
        """Return a file of the data folder."""
        if self.data is None:
            raise ValueError(f"{name} was asked for without a folder of data")
        return self.data / name


QUICK, SHORT, LONG = "quick", "short", "long"
"""Under two seconds, under half a minute, minutes."""


@dataclass(frozen=True)
class Work:
    """A computation that several rows share.

    Attributes
    ----------
    name : str
    rows : tuple of Row
    run : callable
    takes : str
        ``"quick"``, ``"short"`` or ``"long"``.
    needs : tuple of str
        Files of the data folder.
    surfaces : bool
        Whether it needs trimesh and embreex.
    pictures : mapping
        Item by the file name of the picture that shows it.
    """

    name: str
    rows: tuple[Row, ...]
    run: Callable[[Bench], Found]
    takes: str = QUICK
    needs: tuple[str, ...] = ()
    surfaces: bool = False
    pictures: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Out:
    """What a paper prints and is not computed, and why not."""

    item: str
    what: str
    reason: str


@dataclass(frozen=True)
class Paper:
    """A paper: its short name, its citation, its works in the order of its pages, and what is out."""

    id: str
    citation: str
    works: Sequence[Work]
    out: Sequence[Out] = ()

    def items(self) -> list[str]:
        """Return every item that has a row, a picture or a reason, once."""
        found = [row.item for work in self.works for row in work.rows]
        found += [item for work in self.works for item in work.pictures.values()]
        return list(dict.fromkeys([*found, *(each.item for each in self.out)]))


def _several(value: Number) -> tuple[float, ...]:
    return tuple(value) if isinstance(value, tuple) else (value,)


def shown(value: Number) -> str:
    """Return numbers as a table has them."""
    return ", ".join(f"{number:.4g}" for number in _several(value))


def yes(condition: object) -> float:
    """Return 1 for what holds, and 0."""
    return 1.0 if condition else 0.0
