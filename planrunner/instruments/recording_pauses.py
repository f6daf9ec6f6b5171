"""Segments of a recording that nobody tabled: stretches parted by pauses in its time, in the order of the plan."""

from __future__ import annotations

import math

import numpy as np

from planrunner.instruments.recording_file import RecordingFile
from planrunner.plan.span import Span


def stretches(file: RecordingFile, pause: float) -> tuple[Span, ...]:
    """The stretches of a recording within which no two rows are more than `pause` s apart, in one pass over it. Each ends a sample period
    after its last row.

    Raises `InstrumentError` as the file does.
    """
    found: list[Span] = []
    start = last = math.nan
    period = 0.0 if math.isnan(file.interval) else min(file.interval, pause)
    for time, _ in file.rows():
        steps = np.diff(time, prepend=time[0] if math.isnan(last) else last)
        breaks = np.flatnonzero(steps > pause)
        if math.isnan(start):
            start = float(time[0])
        for index in breaks:
            found.append(Span(start, (float(time[index - 1]) if index else last) + period))
            start = float(time[index])
        last = float(time[-1])
    return (*found, Span(start, last + period))
