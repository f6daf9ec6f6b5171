"""Waiting for a person at a segment's boundary: a prompt of the plan to be carried out, or a pause to end.

The bench is in its safe state meanwhile, so that a fixture can be mounted. On a simulated bench nobody is asked.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from planrunner.archive.pausing import asked_to_pause
from planrunner.archive.run_folder import RunWriter
from planrunner.execution.lookout import Lookout
from planrunner.execution.stopping import StopRequest
from planrunner.plan.schedule import Segment

EVERY = 0.1
"""Seconds of real time between two looks at whether the person is done."""
NOT_ASKED = "not asked: the bench is simulated"


class Operator(Protocol):
    def ask(self, prompt: str) -> Callable[[], bool]:
        """Put the prompt to the operator; the answer says whether it is done, at any time and at once."""

    def tell(self, text: str) -> None:
        """A line that needs no answer."""


class Boundary:
    """What happens between two segments. make_safe: brings the bench to its safe state and forgets what was commanded; go_on: what comes
    before the first move after it."""

    def __init__(
        self,
        writer: RunWriter,
        lookout: Lookout,
        stop: StopRequest,
        operator: Operator | None,
        make_safe: Callable[[], None],
        go_on: Callable[[], object],
    ):
        self._writer, self._lookout, self._stop, self._operator = writer, lookout, stop, operator
        self._make_safe, self._go_on = make_safe, go_on

    def wait(self, segment: Segment, now: Callable[[], float]) -> None:
        """Before `segment`: the prompts and a pause, if any. Returns early when the run is to stop."""
        if asked_to_pause(self._writer.folder):
            self._pause(now)
        if not segment.prompts or self._stop.after_segment:
            return
        if self._operator is None:
            for prompt in segment.prompts:
                self._writer.note("asked", prompt=prompt, answer=NOT_ASKED)
            return
        self._make_safe()
        for prompt in segment.prompts:
            if not self._until(self._operator.ask(prompt)):
                return
            self._writer.note("asked", prompt=prompt, answer="done")
        self._go_on()

    def _pause(self, now: Callable[[], float]) -> None:
        self._make_safe()
        self._writer.note("paused", clock=now())
        if self._operator is not None:
            self._operator.tell(f"paused in the safe state; continue with: planrunner resume {self._writer.path}")
        if self._until(lambda: not asked_to_pause(self._writer.folder)):
            self._go_on()
            self._writer.note("continued", clock=now())

    def _until(self, done: Callable[[], bool]) -> bool:
        """Wait in real time, whatever clock the bench has; False when the run is to stop instead."""
        while not done():
            if self._stop.after_segment:
                return False
            self._lookout.idle()
            time.sleep(EVERY)
        return True
