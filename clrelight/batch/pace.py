"""How many small tasks go to a worker at a time, told by the seconds of those before."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from statistics import median

SECONDS = 0.5
"""For which a worker is to be at work, at least: what a scheduler does for it takes some milliseconds."""
MOST_SECONDS = 2 * SECONDS
"""After which a worker begins no more of what it was given at a time."""
_MOST_TASKS = 64
"""What a death of a worker can cast doubt on; more would save nothing, for at 8 ms a task they are enough."""
_LOOK_BACK = 15


class Pace:
    """Sizes of parcels of tasks.

    One task goes out at a time until there are seconds of some. Their median decides, so that neither the first task of
    a worker, which loads what the others have, nor a large stack among small ones does.
    """

    def __init__(self) -> None:
        self._seconds: deque[float] = deque(maxlen=_LOOK_BACK)
        self.size = 1

    def learn(self, seconds: Iterable[float]) -> None:
        """Take what tasks took at their workers."""
        self._seconds.extend(seconds)
        if self._seconds:
            usual = max(median(self._seconds), SECONDS / _MOST_TASKS)
            self.size = max(1, math.ceil(SECONDS / usual - 1e-9))
