"""What a selftest says: statements with a figure and a limit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Statement:
    """One line of the table.

    Attributes
    ----------
    part : str
        What is tested: a method, a codec, a stage.
    case : str
        At what: a degree, a scale, a set of lights.
    what : str
        What the figure is.
    figure, limit : float
        It holds where the figure is at most the limit.
    """

    part: str
    case: str
    what: str
    figure: float
    limit: float

    @property
    def holds(self) -> bool:
        """Whether the figure is within the limit; NaN is not."""
        return bool(self.figure <= self.limit)
