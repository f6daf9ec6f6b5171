"""Reports the progress of a long pass over data: the work, the completed fraction, and the time left at the present speed."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic

from planrunner.base.dataclass import dataclass

EVERY = 0.05
"""Minimum real time between two reports of progress, s."""
LONG = 2.0
"""Expected duration [s] below which work is not announced."""


now = monotonic
"""Returns the time [s] by which progress is measured."""


@dataclass(frozen=True, slots=True)
class Underway:
    """Reports the progress of some work.

    `what`: the work, such as "checking long.csv". `fraction`: completed part, 0 to 1. `time_left`: expected remaining real time
    [s].
    """

    what: str
    fraction: float
    time_left: float


Announce = Callable[[Underway], None]


class Pace:
    """Reports progress of work on a known amount of data, such as rows. A callback that raises an exception is not called again,
    because a display must not end the work."""

    def __init__(self, what: str, amount: float, notice: Announce | None):
        self._what, self._amount, self._notice = what, amount, notice
        self._began = self._shown = now()

    def reached(self, amount: float) -> None:
        """States the amount of data that has been processed so far, and reports the progress if a report is due. The method can be
        called often."""
        if self._notice is None or amount <= 0 or self._amount <= 0:
            return
        time = now()
        if time - self._shown < EVERY:
            return
        self._shown = time
        fraction = min(1.0, amount / self._amount)
        whole = (time - self._began) / fraction
        if whole < LONG:
            return
        try:
            self._notice(Underway(self._what, fraction, whole * (1 - fraction)))
        except Exception:
            self._notice = None
