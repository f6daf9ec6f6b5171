"""Stops a run on request: the first Ctrl-C ends the run after the segment; the second Ctrl-C or a termination signal ends the run
at once.

The signal handlers only record the request; the executor checks for requests between steps, and makes the bench safe before the run
ends. A third Ctrl-C raises KeyboardInterrupt, in case a driver does not return. After this exception, the executor also makes the
bench safe.
"""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable
from types import FrameType, TracebackType

from planrunner.base.interruption import SignalHandler, signals

AT_ONCE_SIGNALS = ("SIGTERM", "SIGHUP", "SIGBREAK")


class StopRequest:
    """Records a request to stop the run, and how the run must stop. As a context manager it handles the signals that stop a run,
    and restores the previous signal handlers on exit.

    `notify`: a function that is called at every request with a line of text for the operator. The signal handler calls it, so it
    must be quick.
    """

    def __init__(self, notify: Callable[[str], None] | None = None):
        self.after_segment = False
        self.at_once = False
        self.reason = ""
        self._presses = 0
        self._notify = notify
        self._restore: dict[int, SignalHandler] = {}

    def request(self, *, at_once: bool = False, reason: str = "asked to stop") -> None:
        """Requests to stop at once if `at_once` is True, otherwise after the segment."""
        self.after_segment = True
        self.at_once = self.at_once or at_once
        self.reason = reason
        if self._notify is None:
            return
        with contextlib.suppress(Exception):  # a failing display must not prevent the run from stopping
            self._notify(
                "stopping at once" if at_once else "stopping after this segment; press Ctrl-C again to stop at once"
            )

    def __enter__(self) -> StopRequest:
        if threading.current_thread() is not threading.main_thread():
            return self
        self._listen(signal.SIGINT, self._on_interrupt)
        for number in signals(AT_ONCE_SIGNALS):
            if signal.getsignal(number) != signal.SIG_IGN:  # nohup ignores SIGHUP on purpose
                self._listen(number, self._on_termination)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._restore.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        self._restore.clear()

    def _listen(self, number: int, handler: Callable[[int, FrameType | None], None]) -> None:
        self._restore[number] = signal.signal(number, handler)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        self._presses += 1
        if self._presses > 2:
            raise KeyboardInterrupt
        self.request(at_once=self._presses == 2, reason="Ctrl-C" if self._presses == 1 else "Ctrl-C twice")

    def _on_termination(self, number: int, frame: FrameType | None) -> None:
        self.request(at_once=True, reason=signal.Signals(number).name)
