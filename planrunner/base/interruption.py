"""Ends a command when a signal arrives, at any time. The command prints a short line on standard error, never a traceback, and has
the exit code 130.

Ctrl-C, SIGTERM and a closed terminal raise a `KeyboardInterrupt`, so that files being written stay complete. During a run the
executor handles signals itself (`execution.stopping`). While modules are imported or objects are released, Python may print the
`KeyboardInterrupt` and continue; in this case, it is raised again. Libraries may replace the `KeyboardInterrupt` by another
exception; in this case, `reason` shows that a signal was the cause.
"""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from types import FrameType, TracebackType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

SignalHandler = Callable[[int, FrameType | None], object] | int | None
"""The handler that `signal.signal` replaces; None if Python did not set this handler."""
INTERRUPTED = 130
"""Exit code of a command that a signal ended."""
ENDING = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
AGAIN_AFTER = 0.01
"""If Python ignored an interruption, it is raised again after this time, s."""


class EndedError(KeyboardInterrupt):
    """Reports that a signal ended the command. The class is needed because dataclasses are created with `exec`. After a plain
    `KeyboardInterrupt` within `exec`, Python ends the process by SIGINT and ignores the exit code."""


class Interruption:
    """A context manager that handles the signals that end a command. The context manager has an effect only in the main thread.
    Signals that are ignored on purpose, as by `nohup`, remain ignored. `reason`: the name of the signal in words; empty before a
    signal arrives."""

    def __init__(self) -> None:
        self.reason = ""
        self._heard = signal.SIGINT
        self._raised = 0
        self._listening = self._within_hook = False
        self._restore: dict[int, SignalHandler] = {}
        self._hook = sys.unraisablehook

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in signals(ENDING):
                if signal.getsignal(number) != signal.SIG_IGN:
                    self._restore[number] = signal.signal(number, self._hear)
            self._hook, sys.unraisablehook = sys.unraisablehook, self._raise_again
            self._listening = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._listening = False
        if sys.unraisablehook == self._raise_again:
            sys.unraisablehook = self._hook
        for number, handler in self._restore.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        self._restore.clear()

    def tell(self) -> int:
        """Prints which signal ended the command, and returns the exit code."""
        with contextlib.suppress(OSError, ValueError, AttributeError):  # standard error may be closed
            print(self.reason or "interrupted", file=sys.stderr, flush=True)
        return INTERRUPTED

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self._heard = signal.Signals(number)
        self.reason = "interrupted" if number == signal.SIGINT else f"ended by {self._heard.name}"
        if not self._within_hook:  # where Python would lose it again
            self._raised += 1
            raise EndedError

    def _raise_again(self, lost: UnraisableHookArgs, /) -> None:
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            self._hook(lost)
            return
        self._within_hook = True
        try:
            threading.Thread(target=self._interrupt, args=(self._raised,), daemon=True).start()
        finally:
            self._within_hook = False

    def _interrupt(self, raised: int) -> None:
        """Repeats the signal until it raises an interruption in the main thread, or until the context manager ends. `raised`: the
        number of interruptions that were raised before the first repetition."""
        while True:
            time.sleep(AGAIN_AFTER)
            if self._raised > raised or not self._listening:
                return
            if sys.platform == "win32":
                _thread.interrupt_main(self._heard)
            else:  # only a signal ends a wait of the main thread
                signal.pthread_kill(_main_thread(), self._heard)


def leave_with(code: int) -> None:
    """Marks the command as finished. If a signal arrives later, while the interpreter shuts down, it ends the process at once with
    the exit code of the command."""
    for number in signals(ENDING):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, lambda number, frame: os._exit(code))


def be_deaf() -> None:
    """Ignores the signals that end planrunner. A process that must continue in spite of these signals uses this function."""
    for number in signals(ENDING):
        signal.signal(number, signal.SIG_IGN)


def _main_thread() -> int:
    number = threading.main_thread().ident
    assert number is not None
    return number


def signals(names: Sequence[str]) -> list[signal.Signals]:
    """Returns the signals with these names. Signals that this system lacks are omitted."""
    return [signal.Signals[name] for name in names if name in signal.Signals.__members__]
