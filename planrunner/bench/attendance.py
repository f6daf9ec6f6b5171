"""Checks whether a plan can run unattended: on a real bench, prompts need an operator at a terminal."""

from __future__ import annotations

from planrunner.base.findings import Findings
from planrunner.bench.model import Bench, runs_on_virtual_clock
from planrunner.plan.schedule import Schedule


def check_unattended(bench: Bench, schedule: Schedule, log: Findings) -> None:
    """Adds an error for every prompt of the plan if no operator is present. On a simulated bench, no errors are added, because
    prompts are skipped there."""
    if runs_on_virtual_clock(bench):
        return
    seen = set()
    for segment in schedule.segments:
        if segment.prompts and (mark := segment.marks["prompt"]) not in seen:
            seen.add(mark)
            message = (
                f"the operator is asked before '{segment.label}' ({segment.prompts[0]}), and no operator is present "
                "to answer"
            )
            hint = "run it in a terminal without --unattended, or with --live-page, or leave the prompt out"
            log.error("run-unattended", mark, message, hint)
