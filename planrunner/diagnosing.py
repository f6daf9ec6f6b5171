"""Diagnosing a recording from start to finish: check → read a run folder or a file → look it over → diagnose.

The layers know nothing of one another; here they are put together, for the command line and for programs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.run_reader import RunReader
from planrunner.archive.statistics import statistics_of
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import Bench, driver_of
from planrunner.checking import Sound, check_plan
from planrunner.instruments.interfaces import Block, InstrumentError
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_file import HeldRecording
from planrunner.instruments.recording_keys import RecordingParameters, SegmentColumns
from planrunner.plan.findings import Findings, InputError, Mark
from planrunner.plan.schedule import Segment
from planrunner.plan.units import DIMENSIONS, unit
from planrunner.running import sound_run

if TYPE_CHECKING:
    from planrunner.gap.diagnosis import Diagnosis, Options
    from planrunner.gap.observed import Observed

DIAGNOSIS_FORMAT = 1


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recording beside the plan that it was made by. where: the run folder or the file, for messages."""

    sound: Sound
    segments: tuple[RecordedSegment, ...]
    where: str


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """A diagnosis, what was remarked of the recording, and whose it is."""

    recorded: Recorded
    diagnosis: Diagnosis
    findings: Findings

    def to_json(self) -> dict[str, Any]:
        """As `schemas/diagnosis.schema.json` has it."""
        return {"planrunner_diagnosis": DIAGNOSIS_FORMAT, **self.diagnosis.to_json()}


def diagnose_recorded(recorded: Recorded, options: Options | None = None) -> Diagnosed:
    """What the recording holds beyond its simulation. Raises `InputError` with everything that stands against a diagnosis."""
    from planrunner.gap.diagnosis import Options, diagnose
    from planrunner.gap.observed import ObservationError

    observed, findings = observe(recorded)
    try:
        return Diagnosed(recorded, diagnose(observed, options or Options()), findings)
    except ObservationError as error:
        raise _unfit(recorded, error) from None


def observe(recorded: Recorded) -> tuple[Observed, Findings]:
    """The samples beside their planned state, and warnings. Raises `InputError` with what stands against a diagnosis."""
    from planrunner.gap.observed import ObservationError, observed
    from planrunner.gap.recording_checks import check_observed, check_recording

    sound, used = recorded.sound, recorded.sound.plan.sensor.outputs
    sensor = replace(sound.sensor, outputs=tuple(o for o in sound.sensor.outputs if not used or o.name in used))
    findings = Findings()
    check_recording(recorded.segments, sensor, recorded.where, findings)
    if findings.errors:
        raise InputError(findings)
    units = recorded.segments[0].units
    try:
        seen = observed(
            recorded.segments,
            sound.models.site,
            sensor,
            axes=_axes(used),
            angle_channel=_only(units, "angle"),
            temperature_channel=_only(units, "temperature"),
            magnetic=sound.models.site.magnetic_field,
        )
    except ObservationError as error:
        raise _unfit(recorded, error) from None
    check_observed(seen, recorded.where, findings)
    if findings.errors:
        raise InputError(findings)
    return seen, findings


def _unfit(recorded: Recorded, error: Exception) -> InputError:
    return InputError.at(
        Mark(recorded.where), "gap-unfit", str(error), "look at the plan and at the bench file's channels"
    )


def recorded_run(run: Path) -> Recorded:
    """A run folder. Raises `InputError` and `IntegrityError`."""
    sound = sound_run(run)
    return Recorded(sound, RunReader.open(run).recording(sound.schedule), str(run))


def recorded_file(plan: Path, bench: str | None, recording: Path, segments: Path | None = None) -> Recorded:
    """A recording in a file. bench: maps its columns; the plan's own without it. segments: table of labels with beginnings and ends; the
    bench's, beside the recording, without it. Raises `InputError`."""
    sound = check_plan(plan, bench=bench, today=date.today()).sound()
    parameters = _parameters(sound.bench, sound.file)
    columns = parameters.segments
    if segments is not None:
        columns = SegmentColumns.of(segments.name) if columns is None else replace(columns, table=segments.name)
    table = segments
    if table is None and columns is not None:
        table = recording.parent / Path(columns.table).name
    parameters = replace(parameters, file=recording.name, segments=columns)
    try:
        player = RecordingPlayer.open(parameters, recording, table, VirtualClock())
        player.file = HeldRecording.of(player.file)
        player.foresee(sound.schedule.segments)
        played = tuple(_play(player, segment) for segment in sound.schedule.segments)
    except InstrumentError as error:
        hint = "look at the bench file, at --segments and at the plan's labels"
        raise InputError.at(Mark(str(recording)), "recording-unfit", str(error), hint) from None
    return Recorded(sound, played, str(recording))


def _parameters(bench: Bench, plan: str) -> RecordingParameters:
    for entry in bench.instruments.values():
        if driver_of(entry) is RecordingPlayer:
            found: RecordingParameters = entry.parameters
            return found
    message = (
        f"the bench '{bench.name}' has no sensor with `driver: recording`, so it does not say what a file's columns are"
    )
    hint = "name a bench that maps the recording's columns with --bench"
    raise InputError.at(Mark(plan), "recording-no-mapping", message, hint)


def _play(player: RecordingPlayer, segment: Segment) -> RecordedSegment:
    units = dict(player.channels())
    whole = list(player.stream(segment))
    rows = sum(len(block.time) for block in whole)
    return RecordedSegment(segment, units, statistics_of(whole, tuple(units), rows), partial(_again, whole))


def _again(whole: Sequence[Block], channels: Sequence[str]) -> Iterator[Block]:
    for block in whole:
        yield Block(block.time, {name: block.channels[name] for name in channels})


def _axes(outputs: Sequence[str]) -> dict[str, str] | None:
    """The sensor axis of each output that the plan uses, by the letter in its name; None where it names no outputs."""
    letters = {name: [word for word in name.lower().split("_") if word in ("x", "y", "z")] for name in outputs}
    return {name: found[0] for name, found in letters.items() if found} or None


def _only(units: dict[str, str], dimension: str) -> str | None:
    """The one channel of a dimension; None without one or with several."""
    found = [name for name, text in units.items() if unit(text).dimension == DIMENSIONS[dimension]]
    return found[0] if len(found) == 1 else None
