"""The virtual bench as it lives: its table, chamber and sensor in running time, at a stated multiple of the wall's.

Everything that is simulated here happens in one thread; whoever changes the world first lets those who record it catch up, so that what
was felt before a command is felt as it was.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from planrunner.instruments.virtual.world import World


class RunningClock:
    """Seconds since the simulated bench was switched on. speed: seconds of the bench in one of the wall."""

    def __init__(self, speed: float = 1.0, monotonic: Callable[[], float] = time.monotonic):
        self.speed = speed
        self._monotonic = monotonic
        self._origin = monotonic()

    def now(self) -> float:
        return (self._monotonic() - self._origin) * self.speed

    def sleep(self, seconds: float) -> None:
        """Nobody sleeps here: the bench is asked what it is doing, whenever that is."""
        raise AssertionError("a simulated instrument does not wait")


@dataclass(slots=True)
class LiveWorld:
    """table, chamber, sensor: the virtual instruments that know the truth, or None. recorders: called with the time before the world
    changes."""

    world: World
    clock: Any
    table: Any = None
    chamber: Any = None
    sensor: Any = None
    recorders: list[Callable[[float], None]] = field(default_factory=list)

    def now(self) -> float:
        now: float = self.clock.now()
        return now

    def before_change(self) -> float:
        """Let everybody catch up; the time."""
        now = self.now()
        for record in self.recorders:
            record(now)
        return now
