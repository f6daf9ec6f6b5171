"""Waits for a person between two segments, until a prompt of the plan is confirmed or a pause ends.

During the wait, the bench is in its safe state, so that a fixture can be mounted. On a simulated bench, prompts are skipped. A
prompt can be confirmed by the operator at the terminal or, from another process, by an answer in the run folder.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from planrunner.archive.live import Answer
from planrunner.archive.pausing import asked_to_pause
from planrunner.archive.run_folder import RunWriter
from planrunner.execution.live import LiveReport
from planrunner.execution.lookout import Lookout
from planrunner.execution.stopping import StopRequest
from planrunner.plan.schedule import Segment

EVERY = 0.1
"""Real time between two checks for an answer, s."""
NOT_ASKED = "not asked: the bench is simulated"


class Operator(Protocol):
    def ask(self, prompt: str) -> Callable[[], bool]:
        """Shows the prompt to the operator. Returns a function that can be called at any time; without waiting, it returns True if
        the prompt has been confirmed."""

    def tell(self, text: str) -> None:
        """Shows a line that needs no answer."""


class Boundary:
    """Handles prompts and pauses between two segments. `make_safe`: a function that brings the bench to its safe state and forgets
    earlier commands. `go_on`: a function that is called before the first move after the wait."""

    def __init__(
        self,
        writer: RunWriter,
        lookout: Lookout,
        stop: StopRequest,
        operator: Operator | None,
        live: LiveReport,
        make_safe: Callable[[], None],
        go_on: Callable[[], object],
    ):
        self._writer, self._lookout, self._stop, self._operator = writer, lookout, stop, operator
        self._live = live
        self._make_safe, self._go_on = make_safe, go_on

    def wait(self, segment: Segment, now: Callable[[], float]) -> None:
        """Handles the prompts and a requested pause before `segment`. Returns early if the run must stop."""
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
            if not self._ask(prompt, self._operator):
                return
        self._go_on()

    def _ask(self, prompt: str, operator: Operator) -> bool:
        """Waits until the prompt is confirmed at the terminal or by an answer in the run folder. Returns False if the run must stop."""
        question = self._live.ask(prompt)
        answers: list[Answer] = []
        at_the_terminal = operator.ask(prompt)

        def done() -> bool:
            if at_the_terminal():
                return True
            answer = self._live.answer(question)
            answers.extend([] if answer is None else [answer])
            return answer is not None

        confirmed = self._until(done)
        self._live.asked()
        if confirmed:
            self._writer.note("asked", prompt=prompt, answer="done", **({"by": answers[0].by} if answers else {}))
            if answers:
                operator.tell(f"confirmed on the live page by {answers[0].by}")
        return confirmed

    def _pause(self, now: Callable[[], float]) -> None:
        self._make_safe()
        self._writer.note("paused", clock=now())
        self._live.pause(True)
        if self._operator is not None:
            self._operator.tell(f"paused in the safe state; continue with: planrunner resume {self._writer.path}")
        if self._until(lambda: not asked_to_pause(self._writer.folder)):
            self._live.pause(False)
            self._go_on()
            self._writer.note("continued", clock=now())

    def _until(self, done: Callable[[], bool]) -> bool:
        """Waits in real time, regardless of the bench's clock. Returns False if the run must stop."""
        while not done():
            if self._stop.after_segment:
                return False
            self._lookout.idle()
            self._live.beat()
            time.sleep(EVERY)
        return True
