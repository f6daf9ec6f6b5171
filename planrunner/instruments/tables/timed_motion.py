"""Motions that a table does not make by itself: the computer gives their commands when it is time to, on a thread beside the run.

Times are the bench's clock's. What goes wrong on the thread is kept until somebody asks, and the motion ends there. It ends, too, when
the run has not read the table for long: whoever makes the bench safe in its place shall find nobody who moves it again.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from planrunner.instruments.interfaces import Clock, InstrumentError

SHORTEST, LONGEST = 0.005, 1.0
"""s, of the wall, between two looks at the clock."""


class CalledOffError(Exception):
    """The motion shall not go on."""


class TimedMotion:
    """One motion at a time. broken: why it could not go on, in words; empty while all is well. patience: s of the wall for which the run
    may look away."""

    def __init__(self, clock: Clock):
        self.broken = ""
        self.patience = math.inf
        self._looked_at = time.monotonic()
        self._clock = clock
        self._thread: threading.Thread | None = None
        self._called_off = threading.Event()

    def begin(self, what: str, commands: Callable[[], None]) -> None:
        """Run `commands`, which wait by `until`, on the thread. what: begins the message when they fail."""
        self.call_off()
        self._called_off.clear()
        self.looked_at()
        self._thread = threading.Thread(target=self._run, args=(what, commands), daemon=True)
        self._thread.start()

    def looked_at(self) -> None:
        """The run has asked for the table's state."""
        self._looked_at = time.monotonic()

    def until(self, moment: float) -> None:
        """Wait until it is `moment` [s], in steps that shorten as it comes near. Raises `CalledOffError`, and `InstrumentError` when the
        run has looked away for too long."""
        while (left := moment - self._clock.now()) > 0:
            if self._called_off.wait(min(max(SHORTEST, left / 100), LONGEST)):
                raise CalledOffError
        if time.monotonic() - self._looked_at > self.patience:
            raise InstrumentError(f"the run has not read the table for {self.patience:g} s")

    def call_off(self) -> None:
        """No further command is given when this returns; those that were given hold."""
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
