"""Performs motions that a table cannot perform by itself. A separate thread sends the commands at the planned times.

Times come from the bench's clock. If an error occurs in the thread, the motion ends, and the error is reported at the next query.
The motion also ends if the run has not queried the table for too long; otherwise, the thread could move the table again after the
watchdog has made it safe.

For a cycle, the times at which each turn begins, brakes and ends are computed in advance.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import cycle as again

from planrunner.instruments.interfaces import Clock, InstrumentError
from planrunner.plan.schedule import Cycle

SHORTEST, LONGEST = 0.005, 1.0
"""Real time between two queries of the clock, s."""


class CalledOffError(Exception):
    """Reports that the motion was cancelled."""


class TimedMotion:
    """Performs timed motions, one at a time. `broken`: the reason why a motion could not continue, in words; empty if there is
    none. `patience`: the longest real time [s] between two queries of the table by the run; after a longer time, the motion ends."""

    def __init__(self, clock: Clock):
        self.broken = ""
        self.patience = math.inf
        self._looked_at = time.monotonic()
        self._clock = clock
        self._thread: threading.Thread | None = None
        self._called_off = threading.Event()

    def begin(self, what: str, commands: Callable[[], None]) -> None:
        """Runs the function `commands` in a thread. The function calls `until` to wait between its commands. `what`: text with
        which the message begins if `commands` fails."""
        self.call_off()
        self._called_off.clear()
        self.looked_at()
        self._thread = threading.Thread(target=self._run, args=(what, commands), daemon=True)
        self._thread.start()

    def looked_at(self) -> None:
        """Records that the run has queried the state of the table."""
        self._looked_at = time.monotonic()

    def until(self, moment: float) -> None:
        """Waits until the time `moment` [s], in steps that become shorter. Raises `CalledOffError` if the motion was cancelled, and
        `InstrumentError` if the run has not queried the table for too long."""
        while (left := moment - self._clock.now()) > 0:
            if self._called_off.wait(min(max(SHORTEST, left / 100), LONGEST)):
                raise CalledOffError
        if time.monotonic() - self._looked_at > self.patience:
            raise InstrumentError(f"the run has not polled the table for {self.patience:g} s")

    def call_off(self) -> None:
        """Cancels the motion. No further command is sent after this function has returned; commands that were sent earlier remain
        in effect."""
        self._called_off.set()
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()

    def _run(self, what: str, commands: Callable[[], None]) -> None:
        try:
            commands()
        except CalledOffError:
            pass
        except Exception as error:  # nobody else would hear of it
            self.broken = f"{what}: {error or type(error).__name__}"


@dataclass(frozen=True, slots=True)
class Turn:
    """One turn of a cycle.

    `begins`, `brakes`, `ends`: times since the start of the cycle, s. `rate`: signed rate, rad/s. `target`: angle at the end of the
    turn, relative to the initial position, rad.
    """

    begins: float
    brakes: float
    ends: float
    rate: float
    target: float


def turns_of(motion: Cycle, acceleration: float) -> Iterator[Turn]:
    """Yields the turns of a cycle, which is repeated endlessly. Each turn follows a stop. `acceleration`: acceleration of the axis,
    rad/s^2. The angle of a turn is the area under its rate, which is a trapezoid or a triangle. With equal ramps, this area is the
    rate multiplied by the time from the start of the turn until the axis brakes."""
    now = target = 0.0
    for move in again(motion.moves):
        begins = now + motion.stop
        size = abs(move.turn)
        rate = min(motion.rate, math.sqrt(size * acceleration))
        target += move.turn
        brakes = begins + size / rate
        now = brakes + rate / acceleration
        yield Turn(begins, brakes, now, math.copysign(rate, move.turn), target)
