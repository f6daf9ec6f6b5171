"""Ending a command by a signal, from its first import to its last line: a short line on standard error and exit code 130, never a
traceback.

Ctrl-C, SIGTERM and a closed terminal raise `KeyboardInterrupt`, so that what is being written is left whole; during a run the executor
listens itself (`execution.stopping`). While modules are imported, or objects are released, Python may print such an exception and go on
as if nothing had happened, and libraries may turn it into another: the first is raised again, the second is known by `reason`. This
module imports next to nothing, so that it can be in place before the rest is imported.
"""

from __future__ import annotations

import _thread
import contextlib
import signal
import sys
import threading
import time
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

INTERRUPTED = 130
"""Exit code of a command that a signal ended, whichever it was."""
ENDING = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
AGAIN_AFTER = 0.01
"""Seconds after which an interruption that Python let go of is raised again."""


class Interruption:
    """As a context manager it listens to the signals that end a command, where it is entered in the main thread; signals that are ignored
    on purpose, as by `nohup`, stay so. reason: what was heard, in words; empty before."""

    def __init__(self) -> None:
        self.reason = ""
        self._heard = signal.SIGINT
        self._restore: dict[int, Any] = {}
        self._hook = sys.unraisablehook

    def __enter__(self) -> Interruption:
        if threading.current_thread() is threading.main_thread():
            for number in _ending():
                if signal.getsignal(number) != signal.SIG_IGN:
                    self._restore[number] = signal.signal(number, self._hear)
            self._hook, sys.unraisablehook = sys.unraisablehook, self._raise_again
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if sys.unraisablehook == self._raise_again:
            sys.unraisablehook = self._hook
        for number, handler in self._restore.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)
        self._restore.clear()

    def tell(self) -> int:
        """Say what ended the command; the exit code."""
        with contextlib.suppress(OSError, ValueError, AttributeError):  # nobody may be there to read it
            print(self.reason or "interrupted", file=sys.stderr, flush=True)
        return INTERRUPTED

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self._heard = signal.Signals(number)
        self.reason = "interrupted" if number == signal.SIGINT else f"ended by {self._heard.name}"
        raise KeyboardInterrupt

    def _raise_again(self, lost: UnraisableHookArgs, /) -> None:
        if not isinstance(lost.exc_value, KeyboardInterrupt):
            self._hook(lost)
            return
        threading.Thread(target=self._interrupt, daemon=True).start()

    def _interrupt(self) -> None:
        time.sleep(AGAIN_AFTER)
        if sys.platform == "win32":
            _thread.interrupt_main(self._heard)
        else:  # a wait of the main thread ends at a signal alone
            signal.pthread_kill(_main_thread(), self._heard)


def leave_to_the_system() -> None:
    """The command is over: a signal that comes while the interpreter ends does what it does to any program, without a traceback."""
    for number in _ending():
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, signal.SIG_DFL)


def be_deaf() -> None:
    """For a process that must outlive the signals that end planrunner."""
    for number in _ending():
        signal.signal(number, signal.SIG_IGN)


def _main_thread() -> int:
    number = threading.main_thread().ident
    assert number is not None
    return number


def _ending() -> list[signal.Signals]:
    return [getattr(signal, name) for name in ENDING if hasattr(signal, name)]
