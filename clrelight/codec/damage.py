"""What of a damaged encoding is lost, where the rest of it is decoded all the same."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

_NAMED = 12


@dataclass(frozen=True)
class Lost:
    """A unit that is damaged, and the square of pixels that it costs.

    Attributes
    ----------
    level : int
        Its level; 0 for the lowest subband.
    top, left, bottom, right : int
        Pixels of the whole image.
    """

    level: int
    top: int
    left: int
    bottom: int
    right: int

    def to_json(self) -> dict[str, Any]:
        """Return what a report's facts hold."""
        return {
            "row": self.top,
            "column": self.left,
            "level": self.level or "low",
            "height": self.bottom - self.top,
            "width": self.right - self.left,
        }

    def __str__(self) -> str:
        size = f"{self.right - self.left} x {self.bottom - self.top} pixels"
        filled = f"from level {self.level + 1}" if 0 < self.level < 5 else "from the lowest resolution"
        place = f"unit row {self.top}, column {self.left}, level {self.level or 'low'} damaged"
        return f"{place}: its {size} are filled {filled if self.level else 'from what lies around'}"


@dataclass
class Damage:
    """What was found damaged so far, of what was asked for.

    Attributes
    ----------
    lost : dict of int to Lost
        By the number of the unit.
    """

    lost: dict[int, Lost] = field(default_factory=dict)

    def notes(self) -> list[str]:
        """Return what is to be said: a line for each unit, or for the first of many."""
        found = [self.lost[number] for number in sorted(self.lost)]
        notes = [str(each) for each in found[:_NAMED]]
        return notes + ([f"{len(found) - _NAMED} more units are damaged"] if len(found) > _NAMED else [])

    def to_json(self) -> list[dict[str, Any]]:
        """Return all units as JSON values."""
        return [self.lost[number].to_json() for number in sorted(self.lost)]
