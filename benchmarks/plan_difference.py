"""Measures `planrunner diff` of two plans of 1000 segments in one process: reading, canonical meanings, comparison and digests."""

from __future__ import annotations

import time
from dataclasses import dataclass

from planrunner.plan.model import Plan, parse_plan
from planrunner.review.difference import difference
from planrunner.review.meaning import meaning_of_plan


@dataclass(frozen=True, slots=True)
class Size:
    segments: int
    turns: int


FULL, SMALL = Size(1000, 7), Size(50, 1)


def written(segments: int, changed: bool) -> str:
    """Writes a plan with one line for each segment. changed: if True, the dwell differs, and one segment is renamed, one moved and
    one removed."""
    rows = [
        f"  - {{label: S{k}, temperature: {20 + k % 7} degC, rate: {1 + k % 11} deg/s, settle: {k % 13} s}}"
        for k in range(segments)
    ]
    if changed:
        rows[3] = rows[3].replace("S3,", "renamed,")
        rows.append(rows.pop(5))
        del rows[7]
    dwell = "11 s" if changed else "10 s"
    head = [
        "planrunner: 1",
        "title: A thousand segments",
        "sensor: {kind: imu, outputs: [gyro_x]}",
        f"defaults: {{dwell: {dwell}, orientation: {{x: up, y: north}}}}",
        "segments:",
    ]
    return "\n".join([*head, *rows]) + "\n"


def read(text: str) -> Plan:
    plan, log = parse_plan(text, "plan")
    assert plan is not None and not log.errors
    return plan


def run(size: Size = FULL) -> dict[str, object]:
    texts = [written(size.segments, changed) for changed in (False, True)]
    best = [float("inf")] * 4
    for _ in range(size.turns):
        began = time.perf_counter()
        plans = [read(text) for text in texts]
        after_reading = time.perf_counter()
        meanings = [meaning_of_plan(plan) for plan in plans]
        after_meaning = time.perf_counter()
        found = difference(*meanings)
        after_difference = time.perf_counter()
        digests = {meaning.digest() for meaning in meanings}
        ended = time.perf_counter()
        took = (
            after_reading - began,
            after_meaning - after_reading,
            after_difference - after_meaning,
            ended - after_difference,
        )
        best = [min(pair) for pair in zip(best, took, strict=True)]
    assert len(digests) == 2 and len(found.segments) == size.segments
    reading, meaning, comparing, digesting = best
    return {
        f"reading two plans of {size.segments} segments [s]": reading,
        "computing the meanings of both plans [s]": meaning,
        "comparing the meanings [s]": comparing,
        "total of reading, meanings and comparison (target ≤ 0.5) [s]": reading + meaning + comparing,
        "computing the digests of both plans [s]": digesting,
    }
