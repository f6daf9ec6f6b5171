"""Handles segments that are recorded only as a summary: the means of their samples, with standard deviations and counts."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial

import numpy as np

from planrunner.archive.formats import IntegrityError
from planrunner.archive.recording import RecordedSegment, Statistics
from planrunner.base.findings import InputError, Mark
from planrunner.instruments.interfaces import Block, SummaryChannels
from planrunner.plan.schedule import Segment

METADATA = "planrunner_summary"
"""Key of the metadata of a segment's file that names the channels of the summary."""


def to_text(summary: SummaryChannels) -> str:
    """Writes a summary as a text for the metadata of a file."""
    return json.dumps(asdict(summary), ensure_ascii=False, sort_keys=True)


def from_text(text: str) -> SummaryChannels:
    """Reads a summary from the text in the metadata of a file. Raises ValueError for any other text."""
    data = json.loads(text)
    if not isinstance(data, dict) or set(data) != {"deviations", "count", "seconds"}:
        raise ValueError("it is not the description of a summary")
    deviations, count, seconds = data["deviations"], data["count"], data["seconds"]
    if not isinstance(deviations, dict) or not all(
        isinstance(name, str) for name in (*deviations.values(), count, seconds)
    ):
        raise ValueError("it is not the description of a summary")
    return SummaryChannels(dict(deviations), count, seconds)


def summarised(
    segment: Segment,
    units: Mapping[str, str],
    summary: SummaryChannels,
    blocks: Iterator[Block],
    where: str,
    readings: Mapping[str, float] | None = None,
) -> RecordedSegment:
    """Makes a segment from its summary. `blocks`: blocks that contain the single row of the summary. `where`: name of the run or of
    the file, for messages. Raises `IntegrityError` if the blocks do not contain exactly the row of a summary."""
    rows = [block for block in blocks if len(block.time)]
    named = {*summary.deviations, *summary.deviations.values(), summary.count, summary.seconds}
    if len(rows) != 1 or len(rows[0].time) != 1 or set(rows[0].channels) != named:
        raise IntegrityError(f"{where}: '{segment.label}' is not one row of means with their scatter")
    row = {name: float(values[0]) for name, values in rows[0].channels.items()}
    names = tuple(summary.deviations)
    count, start, seconds = row[summary.count], float(rows[0].time[0]), row[summary.seconds]
    if not (count >= 1 and count == round(count) and math.isfinite(seconds) and seconds > 0):
        raise IntegrityError(f"{where}: '{segment.label}' has {count:g} samples in {seconds:g} s")
    mean = np.array([row[name] for name in names])
    deviation = np.array([row[summary.deviations[name]] for name in names])
    several = count > 1
    period = seconds / count
    statistics = Statistics(
        channels=names,
        count=int(count),
        rejected=0,
        mean=mean,
        minimum=mean,
        maximum=mean,
        covariance=np.diag(deviation**2) if several else np.full((len(names), len(names)), math.nan),
        standard_error=deviation / math.sqrt(count) if several else np.full(len(names), math.nan),
        batches=int(count),
        start=start,
        end=start + seconds - period,
        largest_gap=period if several else 0.0,
    )
    own = {name: units[name] for name in names}
    refused = partial(_no_samples, where, segment.label)
    return RecordedSegment(segment, own, statistics, refused, readings=dict(readings or {}), finds=(), summary=True)


def _no_samples(where: str, label: str, channels: Sequence[str]) -> Iterator[Block]:
    """Raises `InputError`, because a summary has no samples that could be read."""
    message = (
        f"'{label}' is a row of a table, with the mean, the standard deviation and the number of its samples; "
        "this operation needs the samples"
    )
    hint = "use a recording of samples, or an estimator that works with the means of segments"
    raise InputError.at(Mark(where), "recording-summary", message, hint)
