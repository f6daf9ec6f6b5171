"""Drivers of plug-ins that play back a recording."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from planrunner.base.findings import Findings, Mark
from planrunner.instruments.interfaces import InstrumentError, PlaysBack, UnservedError
from planrunner.plan.schedule import Rest, Segment

SEGMENTS = [Segment(n, label, None, "unknown", Rest(), 10.0) for n, label in enumerate("AB")]


class OnlyA(PlaysBack):
    """A recording that contains only the segment A. `foresee` refuses every other segment."""

    def foresee(self, segments: Sequence[Segment]) -> None:
        log = Findings()
        for one in segments:
            if one.label != "A":
                log.error("recording-no-segment", Mark("mine.dat"), f"mine.dat has no segment '{one.label}'")
        if log.errors:
            raise UnservedError(log.errors)


class Unreadable(PlaysBack):
    def foresee(self, segments: Sequence[Segment]) -> None:
        raise InstrumentError("mine.dat cannot be read")


def test_what_a_driver_foresees_becomes_findings() -> None:
    log = Findings()
    OnlyA().look_over(SEGMENTS[:1], log)
    assert not list(log)
    OnlyA().look_over(SEGMENTS, log)
    assert [(one.severity, one.code, one.message) for one in log.errors] == [
        ("error", "recording-no-segment", "mine.dat has no segment 'B'")
    ]


def test_a_fault_of_the_driver_is_raised() -> None:
    with pytest.raises(InstrumentError, match="cannot be read"):
        Unreadable().look_over(SEGMENTS, Findings())


def test_a_driver_that_foresees_nothing_has_no_findings() -> None:
    log = Findings()
    PlaysBack().look_over(SEGMENTS, log)
    assert not list(log)
