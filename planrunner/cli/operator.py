"""Lets the operator answer the prompts of a plan: with Enter at the terminal, or on the live page."""

from __future__ import annotations

import argparse
import os
import sys
import threading
from collections.abc import Callable


def add_attendance(parser: argparse.ArgumentParser) -> argparse._MutuallyExclusiveGroup:
    """Adds the options that state whether an operator is present."""
    present = parser.add_mutually_exclusive_group()
    present.add_argument(
        "--unattended", action="store_true", help="no operator is present: refuse a plan with operator prompts"
    )
    return present


def add_live_page(parser: argparse.ArgumentParser) -> None:
    """Adds the options of the live page for commands that execute a run."""
    add_attendance(parser).add_argument(
        "--live-page",
        action="store_true",
        help="the operator answers prompts on the live page (`planrunner serve`), not at this terminal",
    )


class TerminalOperator:
    """The operator at the terminal. `notify`: a function that shows a line of text to the operator. A separate thread reads the
    answers, so that the run continues to supervise the bench and reacts to Ctrl-C. This thread reads directly from the file
    descriptor. Otherwise, a thread that still waits when the program exits would keep the buffer of stdin locked."""

    def __init__(self, notify: Callable[[str], None]):
        self._notify = notify
        self._answers = 0
        self._reading = False

    def ask(self, prompt: str) -> Callable[[], bool]:
        self.tell(f"{prompt}\nWhen this is done, press Enter; Ctrl-C ends the run.")
        before = self._answers
        if not self._reading:
            self._reading = True
            threading.Thread(target=self._read, daemon=True).start()
        return lambda: self._answers > before

    def tell(self, text: str) -> None:
        self._notify(text)

    def _read(self) -> None:
        """Counts the lines that the operator enters. Each line answers one question. A closed terminal gives no answer."""
        try:
            while piece := os.read(sys.stdin.fileno(), 1024):
                self._answers += piece.count(b"\n")
        except (OSError, ValueError):
            return


class PageOperator:
    """An operator who uses the live page. The answers arrive in the run folder. `notify`: a function that shows a line of text to
    the operator."""

    def __init__(self, notify: Callable[[str], None]):
        self._notify = notify

    def ask(self, prompt: str) -> Callable[[], bool]:
        self.tell(f"{prompt}\nThe run waits for an answer on the live page (`planrunner serve`).")
        return lambda: False

    def tell(self, text: str) -> None:
        self._notify(text)


def operator_of(args: argparse.Namespace, notify: Callable[[str], None]) -> TerminalOperator | PageOperator | None:
    """Returns the operator on the live page if the live page is requested, otherwise the operator at the terminal. Returns None if
    the run is unattended or there is no terminal."""
    if args.live_page:
        return PageOperator(notify)
    present = sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty() and not args.unattended
    return TerminalOperator(notify) if present else None
