"""Plays back a recording: provides a sensor that reads a file as if the samples were measured now.

Columns of the file become channels with units. Each label of the plan belongs to an interval of the recording. The intervals are
stated in a table of segments, or are separated by pauses in the recorded time; otherwise, the whole recording is one interval. All
files must be inside the data folder, except files that are named on the command line. Rows are streamed, so a long recording is
never in memory as a whole.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.documents import Json
from planrunner.base.findings import Findings, Mark
from planrunner.base.progress import Announce
from planrunner.instruments.formats.file import TimeStamps
from planrunner.instruments.interfaces import Block, Clock, InstrumentError, PlaysBack, Surroundings, UnservedError
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.instruments.recording_file import RecordedFile, RecordingFile, beneath, open_recording
from planrunner.instruments.recording_keys import RecordingParameters
from planrunner.instruments.recording_scan import Wanted, scan
from planrunner.instruments.recording_segments import SegmentTable, read_segment_table, stated_stretches, stretches
from planrunner.instruments.recording_summary import SummaryPlayer
from planrunner.plan.schedule import Segment
from planrunner.plan.span import Span
from planrunner.plan.units import DIMENSIONS, unit

RATE_TOLERANCE = math.log(1.25)
_ALWAYS_NOISY = (DIMENSIONS["angular rate"], DIMENSIONS["acceleration"])
_TABLE = "check the table of segments in the bench file and the plan's labels"


class RecordingPlayer(PlaysBack):
    """The sensor of a bench that plays back a recording."""

    role = "sensor"
    Parameters = RecordingParameters

    def __init__(
        self,
        parameters: RecordingParameters,
        file: RecordingFile,
        spans: SegmentTable | None,
        clock: Clock,
        piece: float,
        parted: tuple[Span, ...] = (),
        notice: Announce | None = None,
    ):
        self.parameters = parameters
        self.file = file
        self.spans = spans
        self.parted = parted
        self.clock = clock
        self.piece = piece
        power_on = parameters.power_on
        self.origin = file.origin if power_on is None else power_on.value
        self.notice = notice
        self._served: str | None = None
        self._held: Span | None = None

    @classmethod
    def model(cls, parameters: RecordingParameters) -> SensorModel:
        rate = parameters.sample_rate.value
        outputs = tuple(
            OutputModel(
                name,
                channel.unit,
                channel.amount("full_scale", math.inf),
                NoiseModel(
                    channel.white(rate),
                    channel.amount("bias_instability"),
                    channel.amount("resolution"),
                    states_flicker=channel.bias_instability is not None,
                ),
            )
            for name, channel in parameters.channels.items()
        )
        return SensorModel(
            parameters.kind, outputs, rate, one_rate=True, nominal_supply=parameters.nominal_supply.value
        )

    @classmethod
    def connect(cls, parameters: RecordingParameters, surroundings: Surroundings) -> RecordingPlayer | SummaryPlayer:
        paths = [beneath(surroundings.data_root, name) for name in parameters.files]
        if parameters.summary is not None:
            return SummaryPlayer.open(parameters, paths[0], surroundings.clock)
        table = None if parameters.segments is None else beneath(surroundings.data_root, parameters.segments.table)
        piece = 1.0 if surroundings.real_time else math.inf
        return cls.open(parameters, paths, table, surroundings.clock, piece, surroundings.notice)

    @classmethod
    def open(
        cls,
        parameters: RecordingParameters,
        paths: Sequence[Path],
        table: Path | None,
        clock: Clock,
        piece: float = math.inf,
        notice: Announce | None = None,
    ) -> RecordingPlayer:
        """Opens a player for the files at `paths`, each of which continues the previous one.

        `table`: file with the table of segments. `piece`: length [s] of the longest block. `notice`: receives the progress while a
        whole file is read. Raises `InstrumentError` if the files do not contain the described recording.
        """
        columns = {name: channel.column for name, channel in parameters.channels.items()}
        parts = [RecordedFile(path, name) for path, name in zip(paths, parameters.files, strict=True)]
        pause, stamps = parameters.pause_between_files, _stamps(parameters)
        file = open_recording(parts, stamps, columns, parameters.format, None if pause is None else pause.value)
        _check_time(file, parameters)
        spans = None
        stated = parameters.segments
        if stated is not None and table is not None:
            columns_of_table = (stated.label, stated.start, stated.end)
            spans = read_segment_table(
                table, stated.table, columns_of_table, stated.unit, stated.trim.value, file.origin, stamps.dates
            )
        if parameters.stretches is not None:
            spans = stated_stretches(parameters, file.origin)
        both = [name for name in ("segments", "stretches", "pauses") if getattr(parameters, name) is not None]
        if len(both) > 1:
            named = " and ".join(f"`{name}`" for name in both[:2])
            raise InstrumentError(f"{named} both define the segments of the recording: keep one of them")
        parted = () if parameters.pauses is None else stretches(file, parameters.pauses.value, parameters.file, notice)
        return cls(parameters, file, spans, clock, piece, parted, notice)

    # -- capabilities --------------------------------------------------------------------------------------------------

    def channels(self) -> Mapping[str, str]:
        return {name: channel.unit for name, channel in self.parameters.channels.items()}

    def foresee(self, segments: Sequence[Segment]) -> None:
        """Checks that the recording contains every segment with its whole dwell, and that it can be read to its end. Raises
        `UnservedError` with all errors that were found."""
        found = Findings()
        self.look_over(segments, found)
        if found.errors:
            raise UnservedError(found.errors)

    def look_over(self, segments: Sequence[Segment], log: Findings) -> None:
        """Examines the recording in one pass, before the segments are played back, and adds all findings to `log`."""
        name, rate = self.parameters.file, self.parameters.sample_rate.value
        try:
            channels = self.parameters.channels.items()
            live = [one for one, channel in channels if unit(channel.unit).dimension in _ALWAYS_NOISY]
            self._held = scan(self.file, name, rate, self._wanted(segments, log), log, self.notice, live)
        except InstrumentError as error:
            log.error(
                "recording-unfit", Mark(name), str(error), "correct the file, or its description in the bench file"
            )

    def length_of(self, segment: Segment) -> float | None:
        """Returns the time [s] for which the recording contains data of a segment; None before the recording has been examined."""
        if self.spans is not None and segment.label in self.spans.spans:
            return self.spans.span(segment.label).seconds
        if self.parted and segment.index < len(self.parted):
            return self.parted[segment.index].seconds
        return None if self._held is None else self._held.seconds

    def _wanted(self, segments: Sequence[Segment], log: Findings) -> list[Wanted]:
        """Finds the intervals of the segments in the recording. For each segment that the recording does not contain, adds a
        finding to `log`."""
        name, labels = self.parameters.file, [segment.label for segment in segments]
        if self.parted:
            if len(labels) == len(self.parted):
                parts = zip(segments, self.parted, strict=True)
                return [Wanted(one.label, span, one.dwell, Mark(name)) for one, span in parts]
            message = (
                f"{name} holds {len(self.parted)} stretches, separated by pauses, but the plan has {len(labels)} "
                "segments"
            )
            hint = "check `pauses` in the bench file and the plan's segments"
            log.error("recording-labels", Mark(name), message, hint)
            return []
        if self.spans is None:
            if len(labels) > 1:
                log.error("recording-labels", Mark(name), str(self._one_stretch(labels[0], labels[1])), _TABLE)
            return [Wanted(one.label, Span(self.file.origin, math.inf), one.dwell, Mark(name)) for one in segments[:1]]
        found = []
        for one in segments:
            try:
                mark = Mark(self.spans.name, self.spans.lines.get(one.label, 1))
                found.append(Wanted(one.label, self.spans.span(one.label), one.dwell, mark))
            except InstrumentError as error:
                log.error("recording-labels", Mark(self.spans.name), str(error), _TABLE)
        return found

    def stream(self, segment: Segment) -> Iterator[Block]:
        """Yields the samples of the first `dwell` seconds of a segment. If the dwell is not planned, yields all samples of the
        segment. Times are counted from power-on if the bench file declares this time, otherwise from the first row of the
        recording. Raises `InstrumentError` if the recording does not contain the whole dwell, or contains no samples of the
        segment.
        """
        span = self._span(segment)
        interval = 1 / self.parameters.sample_rate.value
        if segment.dwell is not None and segment.dwell > span.seconds + 0.5 * interval:
            raise self._too_short(segment, span.seconds)
        first = last = until = math.inf
        for time, columns in self.file.rows(span):
            if math.isinf(first):
                first = float(time[0])
                until = math.inf if segment.dwell is None else first + segment.dwell - 0.5 * interval
            count = int(np.searchsorted(time, until))
            if count:
                last = float(time[count - 1])
                yield from self._pieces(time[:count], {name: values[:count] for name, values in columns.items()})
            if count < time.size:
                break
        if math.isinf(first):
            where = f"between {span.start:g} s and {span.end:g} s"
            raise InstrumentError(f"{self.parameters.file} has no samples {where} for '{segment.label}'")
        if segment.dwell is not None and last - first + 1.5 * interval < segment.dwell:
            raise self._too_short(segment, last - first + interval)

    def identify(self) -> Mapping[str, str]:
        return {"manufacturer": "recording", "model": self.parameters.kind, "file": self.parameters.file}

    def checkpoint(self) -> Mapping[str, Json]:
        return {"served": self._served}

    def restore(self, state: Mapping[str, Json]) -> None:
        self._served = state["served"]

    # -- how it does it ------------------------------------------------------------------------------------------------

    def _pieces(self, time: Array, columns: Mapping[str, Array]) -> Iterator[Block]:
        """Divides a block into pieces of at most `self.piece` seconds. In real time, a piece lasts about one second."""
        rate = self.parameters.sample_rate.value
        size = time.size if math.isinf(self.piece) else max(1, round(self.piece * rate))
        for first in range(0, time.size, size):
            part = slice(first, first + size)
            channels = {}
            for name, channel in self.parameters.channels.items():
                values = columns[name][part]
                if channel.zero or channel.per_unit != 1:
                    values = (values - channel.zero) / channel.per_unit
                channels[name] = values if channel.sign > 0 else -values
            self.clock.sleep(len(time[part]) / rate)
            yield Block(time[part] - self.origin, channels)

    def _span(self, segment: Segment) -> Span:
        if self.spans is not None:
            return self.spans.span(segment.label)
        if self.parted:
            return self.parted[segment.index]
        if self._served not in (None, segment.label):
            raise self._one_stretch(self._served, segment.label)
        self._served = segment.label
        return Span(self.file.origin, math.inf)

    def _one_stretch(self, served: str | None, label: str) -> InstrumentError:
        return InstrumentError(
            f"{self.parameters.file} has no table of segments and is therefore a single segment, which is played "
            f"back as '{served}'; "
            f"'{label}' needs `segments: {{table: …}}` in the bench file"
        )

    def _too_short(self, segment: Segment, available: float) -> InstrumentError:
        return InstrumentError(
            f"the recording is shorter than the plan: '{segment.label}' dwells {segment.dwell:g} s, but "
            f"{self.parameters.file} holds only {available:.6g} s of it; shorten the dwell or write `dwell: recorded`"
        )


def _stamps(parameters: RecordingParameters) -> TimeStamps:
    """Describes how the time of a row is determined. Raises `InstrumentError` if the bench file does not describe the time."""
    if parameters.stamps is None:
        raise InstrumentError(
            f"the bench file does not say which column of {parameters.file} is the time: write `time: {{column: …}}`, or "
            "`time: sample_count` if it has none, or `summary` for a table with one row per segment"
        )
    return parameters.stamps


def _check_time(file: RecordingFile, parameters: RecordingParameters) -> None:
    """Raises `InstrumentError` in two cases: if the declared sample rate contradicts the time column, usually because the unit of
    time is wrong; and if power-on is declared later than the first row."""
    declared = parameters.sample_rate.value
    if not math.isnan(file.interval) and abs(math.log(file.interval * declared)) > RATE_TOLERANCE:
        message = (
            f"{parameters.file} is declared at {declared:g} Hz, but its rows are {file.interval:.4g} s apart "
            f"({1 / file.interval:.4g} Hz): correct `sample_rate`, or the unit of the column '{_stamps(parameters).column}'"
        )
        raise InstrumentError(message)
    power_on = parameters.power_on
    if power_on is not None and power_on.value > file.origin:
        message = f"{parameters.file} begins at {file.origin:g} s, before the power-on at {power_on.value:g} s"
        raise InstrumentError(f"{message}: correct `time: {{power_on: …}}` in the bench file")
