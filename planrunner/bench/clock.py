"""Provides clocks for simulated time and for real time. The two clocks have the same methods, so that the executor can use either
of them."""

from __future__ import annotations

import time
from collections.abc import Callable


class VirtualClock:
    """A clock of simulated time. This clock advances only during calls of `sleep`, which take no real time."""

    def __init__(self, start: float = 0.0):
        self._now = start

    def now(self) -> float:
        """Returns the simulated time since the run began, s."""
        return self._now

    def sleep(self, seconds: float) -> None:
        if seconds > 0:
            self._now += seconds

    def set(self, seconds: float) -> None:
        """Sets the time when a run is resumed."""
        self._now = seconds

    def attend(self, callback: Callable[[], bool] | None) -> None:
        """Accepts a callback and ignores it, because sleeping takes no real time."""


class WallClock:
    """A real-time clock. This clock is monotonic: it does not jump if the computer's clock is set.

    A sleep is interruptible: about every `slice` seconds it calls the callback given to `attend`, and it ends early if the callback
    returns True. `speed`: seconds of this clock per second of real time, for a bench whose simulated instruments run faster.
    """

    def __init__(self, slice: float = 0.1, speed: float = 1.0):
        self.speed = speed
        self._origin = time.monotonic()
        self._slice = slice
        self._attend: Callable[[], bool] | None = None

    def now(self) -> float:
        """Returns the time since the run began, s. The time during which the run was interrupted does not count."""
        return (time.monotonic() - self._origin) * self.speed

    def sleep(self, seconds: float) -> None:
        end = time.monotonic() + seconds / self.speed
        while (left := end - time.monotonic()) > 0:
            if self._attend is not None and self._attend():
                return
            time.sleep(min(left, self._slice))

    def set(self, seconds: float) -> None:
        """Sets the time at which the clock continues when a run is resumed."""
        self._origin = time.monotonic() - seconds / self.speed

    def attend(self, callback: Callable[[], bool] | None) -> None:
        """Sets a callback that is called during sleeps; if it returns True, the sleep ends. None removes the callback."""
        self._attend = callback
