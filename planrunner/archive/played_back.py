"""Makes the segments of a recording that is played back. These segments have the same form as the segments of a run, but there is
no run folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from planrunner.archive.reading_progress import RowsRead
from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.archive.summaries import summarised
from planrunner.instruments.interfaces import Block
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_file import HeldRecording, at_hand
from planrunner.instruments.recording_summary import SummaryPlayer
from planrunner.plan.schedule import Segment


def played(player: RecordingPlayer | SummaryPlayer, segments: Sequence[Segment]) -> tuple[RecordedSegment, ...]:
    """Returns the segments of a recording as the player plays them back. The recording is kept in memory or in a temporary Parquet
    file, so that it can be read repeatedly. Raises `InstrumentError` if the recording cannot be read."""
    if isinstance(player, SummaryPlayer):
        name, units = player.parameters.file, player.channels()
        return tuple(summarised(one, units, player.summary, player.stream(one), name) for one in segments)
    player.file = at_hand(player.file, player.parameters.file, player.notice)
    seconds = (player.length_of(one) if one.dwell is None else one.dwell for one in segments)
    rows = min(player.file.about, sum(player.parameters.sample_rate.value * (one or math.inf) for one in seconds))
    passed = RowsRead(f"reading {player.parameters.file}", 2 * rows, player.notice)
    return tuple(_play(player, segment, passed) for segment in segments)


def _play(player: RecordingPlayer, segment: Segment, passed: RowsRead) -> RecordedSegment:
    """Plays back one segment of the recording. If the recording of the player is in memory, the samples of the segment are also in
    memory. Otherwise they are read again each time they are needed."""
    units = dict(player.channels())
    read = partial(player.stream, segment)
    if isinstance(player.file, HeldRecording):
        whole = list(player.stream(segment))
        read = partial(iter, whole)
    rows = sum(len(block.time) for block in passed.through(read()))
    statistics = statistics_of(passed.through(read()), tuple(units), rows, motion=segment.motion)
    return RecordedSegment(segment, units, statistics, partial(_again, read))


def _again(read: Callable[[], Iterator[Block]], channels: Sequence[str]) -> Iterator[Block]:
    for block in read():
        yield Block(block.time, {name: block.channels[name] for name in channels})
