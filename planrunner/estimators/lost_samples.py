"""Warnings about missing samples of an estimate: invalid rows and gaps in time."""

from __future__ import annotations

from collections.abc import Sequence

from planrunner.archive.recording import RecordedSegment
from planrunner.base.said import Said, said

GAP_INTERVALS = 5.5
"""Number of sample intervals from which a gap is reported; shorter gaps are jitter or single samples."""
NAMED = 3


def lost_samples(segments: Sequence[RecordedSegment], sample_rate: float) -> tuple[Said, ...]:
    """One sentence about the samples left out of the segments, and another about the gaps in the segments. sample_rate: Hz, for
    segments without their own."""
    left_out, gaps = [], []
    for recorded in segments:
        statistics = recorded.statistics
        rate = recorded.segment.sample_rate or sample_rate
        if statistics.rejected:
            rows = statistics.count + statistics.rejected
            left_out.append(f"'{recorded.label}' {statistics.rejected}/{rows}")
        if statistics.largest_gap * rate > GAP_INTERVALS:
            gaps.append(f"'{recorded.label}' {statistics.largest_gap:.3g} s")
    found = []
    if left_out:
        found.append(
            said(
                "Samples that are missing or not a number were left out: {places}. Check the recording.",
                places=_named(left_out),
            )
        )
    if gaps:
        found.append(
            said(
                "Samples are missing; the longest gaps: {places}. Check the recording.",
                places=_named(gaps),
            )
        )
    return tuple(found)


def _named(places: Sequence[str]) -> tuple[str, ...]:
    more = [f"… (+{len(places) - NAMED})"] if len(places) > NAMED else []
    return (*places[:NAMED], *more)
