"""Clocks: simulated and real time behind the same three methods; the executor does not know which it has."""

from __future__ import annotations

import time
from collections.abc import Callable


class VirtualClock:
    """Time that passes only when somebody sleeps, at once."""

    def __init__(self, start: float = 0.0):
        self._now = start

    def now(self) -> float:
        """Seconds since the run began."""
        return self._now

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            self._now += seconds

    def set(self, seconds: float) -> None:
        """Go to a time, when a run is resumed."""
        self._now = seconds

    def attend(self, callback: Callable[[], bool] | None) -> None:
        """Nobody needs to be attended to during a sleep that takes no time."""


class WallClock:
    """Real time, monotonic: it does not jump when the computer's clock is set.

    A sleep is interruptible: about every `slice` seconds the attending callback is called, and the sleep ends early
    when it returns True. speed: seconds of this clock in one of the wall, for a bench whose simulated instruments hasten.
    """

    def __init__(self, slice: float = 0.1, speed: float = 1.0):
        self.speed = speed
        self._origin = time.monotonic()
        self._slice = slice
        self._attend: Callable[[], bool] | None = None

    def now(self) -> float:
        """Seconds since the run began; the time for which it lay interrupted is not counted."""
        return (time.monotonic() - self._origin) * self.speed

    def sleep(self, seconds: float) -> None:
        end = time.monotonic() + seconds / self.speed
        while (left := end - time.monotonic()) > 0:
            if self._attend is not None and self._attend():
                return
            time.sleep(min(left, self._slice))

    def set(self, seconds: float) -> None:
        """Go on from a time, when a run is resumed."""
        self._origin = time.monotonic() - seconds / self.speed

    def attend(self, callback: Callable[[], bool] | None) -> None:
        """Call `callback` during sleeps; it returns whether to end the sleep. None: nobody."""
        self._attend = callback
