"""Warnings about missing samples of an estimate: invalid rows and gaps in time."""

from __future__ import annotations

from collections.abc import Sequence

from planrunner.archive.recording import RecordedSegment

GAP_INTERVALS = 5.5
"""Number of sample intervals from which a gap is reported; shorter gaps are jitter or single samples."""
NAMED = 3


def lost_samples(segments: Sequence[RecordedSegment], sample_rate: float) -> tuple[str, ...]:
    """A sentence about the samples left out of the segments, and another about the gaps in them. sample_rate: Hz, for segments without
    their own."""
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
            f"Samples that are missing or not a number were left out: {_named(left_out)}. Check the recording."
        )
    if gaps:
        found.append(f"Samples are missing; the longest gaps: {_named(gaps)}. Check the recording.")
    return tuple(found)


def _named(texts: Sequence[str]) -> str:
    """Only names and figures, so that the sentence around them can be translated."""
    more = [f"… (+{len(texts) - NAMED})"] if len(texts) > NAMED else []
    return ", ".join([*texts[:NAMED], *more])
