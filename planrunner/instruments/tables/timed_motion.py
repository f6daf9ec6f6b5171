"""Motions that a table cannot perform by itself: a separate thread gives the commands at the planned times.

Times refer to the bench's clock. An error on the thread ends the motion and is reported at the next query. The motion also ends if the run
has not read the table for too long, so that nothing moves the table again after the watchdog has made it safe.

A cycle is computed in advance: the times at which each turn begins, brakes and ends.
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
    """The motion was cancelled."""


class TimedMotion:
    """Performs one motion at a time. broken: why the motion could not continue, in words; empty without a fault. patience: real
    time [s] in which the run must query the table at least once."""

    def __init__(self, clock: Clock):
        self.broken = ""
        self.patience = math.inf
        self._looked_at = time.monotonic()
        self._clock = clock
        self._thread: threading.Thread | None = None
        self._called_off = threading.Event()

    def begin(self, what: str, commands: Callable[[], None]) -> None:
        """Runs the function `commands` on the thread; `commands` waits with `until`. what: beginning of the message if `commands`
        fails."""
        self.call_off()
        self._called_off.clear()
        self.looked_at()
        self._thread = threading.Thread(target=self._run, args=(what, commands), daemon=True)
        self._thread.start()

    def looked_at(self) -> None:
        """Records that the run has queried the table's state."""
        self._looked_at = time.monotonic()

    def until(self, moment: float) -> None:
        """Waits until `moment` [s], in steps that become shorter. Raises `CalledOffError`, and `InstrumentError` if the run has not
        queried the table for too long."""
        while (left := moment - self._clock.now()) > 0:
            if self._called_off.wait(min(max(SHORTEST, left / 100), LONGEST)):
                raise CalledOffError
        if time.monotonic() - self._looked_at > self.patience:
            raise InstrumentError(f"the run has not polled the table for {self.patience:g} s")

    def call_off(self) -> None:
        """Cancels the motion. After this returns, no further command is given; earlier commands stay in effect."""
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
    """One turn of a cycle. begins, brakes, ends: s since the cycle began; rate: rad/s, with its sign; target: rad from the initial
    position."""

    begins: float
    brakes: float
    ends: float
    rate: float
    target: float


def turns_of(motion: Cycle, acceleration: float) -> Iterator[Turn]:
    """The turns of a cycle, repeated endlessly, each after its stop. acceleration: rad/s^2. The area under a turn's rate, a
    trapezoid or a triangle, is its angle. If both ramps are equal, this area is the rate times the time until the axis brakes."""
    now = target = 0.0
    for move in again(motion.moves):
        begins = now + motion.stop
        size = abs(move.turn)
        rate = min(motion.rate, math.sqrt(size * acceleration))
        target += move.turn
        brakes = begins + size / rate
        now = brakes + rate / acceleration
        yield Turn(begins, brakes, now, math.copysign(rate, move.turn), target)
