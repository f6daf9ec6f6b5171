"""Makes a plan that can settle the open questions of a diagnosis. Determines the segments that the bench can execute, chooses among
them, and writes the text of the plan.

The segments are chosen from a menu: a coarse grid of orientations, rates, rocking and temperatures, as lines of a plan. An entry of
the menu can be chosen if the plan language can express it, and if it can be scheduled on the bench without findings. The cost of a
segment is its scheduled time, including the transition. The file of a bench that only plays recordings back contains nothing about
the real table and chamber. For such a bench, the segments are limited to the rates and temperatures of the recording, and moves are
assumed to take as long as in the recording.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.findings import Findings, InputError, Mark, count_of
from planrunner.bench.model import BenchModels
from planrunner.bench.scheduling import build_schedule
from planrunner.plan.expand import StatedSegment, expand
from planrunner.plan.model import parse_plan
from planrunner.plan.rewriting import cardinal_orientations, orientation_text
from planrunner.plan.schedule import Rock, Segment, Spin
from planrunner.plan.units import ZERO_CELSIUS, unit
from planrunner.reporting.words import explanation, listed

if TYPE_CHECKING:
    from planrunner.gap.answer.diagnosis import Diagnosis
    from planrunner.gap.answer.next import SegmentProposal


MOST_ORIENTATIONS = 16
OBLIQUE = 4  # beside those, where a table can set them
DWELLS = (1, 4)  # in dwells that are usual in the recording
RATE_SHARES = (0.9, 0.3, 0.1)  # of the largest rate
EVERYDAY = (0.0, 50.0)  # degC; commercial parts are made for 0 to 70 degC
ROCKING_HZ = (0.5, 2.0, 5.0)
_LARGEST_ROCKING = math.radians(10.0)
_WITHIN = 0.8  # of a table's limits
_APART = 5.0  # K


@dataclass(frozen=True)
class MenuEntry:
    """Contains one possible segment of a proposed plan: the keys that state the segment in the plan, except its label."""

    orientation: str
    dwell: str
    motion: str = ""
    temperature: str = ""

    def line(self, label: str) -> str:
        keys = {
            "label": label,
            "orientation": self.orientation,
            "motion": self.motion,
            "temperature": self.temperature,
            "dwell": self.dwell,
        }
        return "{" + ", ".join(f"{name}: {value}" for name, value in keys.items() if value) + "}"


def menu(recorded: Sequence[Segment], models: BenchModels) -> list[MenuEntry]:
    """Returns the possible segments after the recorded segments. A segment states a temperature only if the recorded plan states
    temperatures."""
    usual = float(np.median([segment.dwell for segment in recorded if segment.dwell]))
    places = _orientations(recorded, models)
    upright = list({tuple(np.round(place[:, 2], 3)): place for place in places}.values())
    largest = _largest_rate(recorded, models)
    rates = [sign * share * largest for share in RATE_SHARES for sign in (1, -1)] if largest else []
    rocking = list(_rocking(recorded, models))
    warm = _temperatures(recorded, models)
    found = []
    for kelvin in warm:
        here = warm[0] == kelvin
        for place in places if here else upright:
            found += [_entry(place, f"{usual * times:g} s", kelvin=kelvin) for times in DWELLS]
        for place in upright:
            for rate in rates if here else rates[:4]:
                found += [_turning(place, rate, usual * times, kelvin) for times in (DWELLS if here else DWELLS[:1])]
            for amplitude, hertz in rocking if here else ():
                rock = f"{{rock: {{amplitude: {math.degrees(amplitude):.4g} deg, frequency: {hertz:g} Hz}}}}"
                dwell = math.ceil(usual * hertz) / hertz
                found += [_entry(place, f"{dwell * times:g} s", rock, kelvin) for times in DWELLS]
    return found + list(_ramps(recorded, models, upright[0], warm))


def _entry(place: Array, dwell: str, motion: str = "", kelvin: float | None = None) -> MenuEntry:
    return MenuEntry(
        orientation_text(place), dwell, motion, "" if kelvin is None else f"{kelvin - ZERO_CELSIUS:.6g} degC"
    )


def _turning(place: Array, rate: float, seconds: float, kelvin: float | None) -> MenuEntry:
    turns = max(1, round(seconds * abs(rate) / (2 * math.pi)))
    return _entry(place, f"{{turns: {turns}}}", f"{{rate: {math.degrees(rate):.6g} deg/s}}", kelvin)


def _orientations(recorded: Sequence[Segment], models: BenchModels) -> list[Array]:
    """Lists the recorded orientations, then other orientations along the site's axes, then oblique orientations. If nothing can
    turn the sensor, lists only the recorded orientations."""
    visited = {
        tuple(np.round(item.attitude, 6).ravel() + 0.0): item.attitude for item in recorded if item.attitude is not None
    }
    places = list(visited.values())[:MOST_ORIENTATIONS]
    several = len({tuple(np.round(place[:, 2], 3)) for place in places}) > 2
    if not (models.table or (models.replays and several)):
        return places
    for place in cardinal_orientations():
        if len(places) < MOST_ORIENTATIONS and tuple(place.ravel() + 0.0) not in visited:
            places.append(place)
    return places + (_oblique() if models.table else [])


def _oblique() -> list[Array]:
    """Returns the orientations in which all three axes have equal angles to the vertical, one for each upper octant."""
    found = []
    for x, y in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        up = np.array([x, y, 1.0]) / math.sqrt(3)
        east = np.cross(up, [0.0, 0.0, 1.0])
        east /= np.linalg.norm(east)
        found.append(np.column_stack([east, np.cross(up, east), up]))
    return found[:OBLIQUE]


def _largest_rate(recorded: Sequence[Segment], models: BenchModels) -> float:
    """Returns the largest rate [rad/s] that the table and the full scale of the gyros allow. For a recording that is played back,
    this rate is chosen so that the fastest option has the largest recorded rate."""
    visited = max((abs(item.motion.rate) for item in recorded if isinstance(item.motion, Spin)), default=0.0)
    if models.table is None:
        return visited / RATE_SHARES[0]
    largest = max(axis.max_rate for axis in models.table.axes)
    turning = unit("rad/s").dimension
    for output in models.sensor.outputs if models.sensor else ():
        if unit(output.unit).dimension == turning:
            largest = min(largest, output.full_scale * unit(output.unit).factor)
    return largest


def _rocking(recorded: Sequence[Segment], models: BenchModels) -> Iterator[tuple[float, float]]:
    """Yields amplitudes [rad] and frequencies [Hz] of rocking about the vertical."""
    visited = {(m.amplitude, m.frequency) for m in (item.motion for item in recorded) if isinstance(m, Rock)}
    yield from sorted(visited)
    if models.table is None or abs(models.table.axes[0].direction[2]) < 1 or visited:
        return
    axis = models.table.axes[0]
    for hertz in ROCKING_HZ:
        pulse = 2 * math.pi * hertz
        yield min(_LARGEST_ROCKING, _WITHIN * axis.max_rate / pulse, _WITHIN * axis.max_acceleration / pulse**2), hertz


def _temperatures(recorded: Sequence[Segment], models: BenchModels) -> list[float | None]:
    """Returns temperatures [K], with the most frequent temperature of the recording first. An entry is None if the plan does not
    set the temperature of the chamber. If the plan has fewer than two temperatures, common temperatures are added."""
    stated = [item.temperature for item in recorded if item.temperature is not None]
    visited = list(dict.fromkeys(round(kelvin, 2) for kelvin in stated))
    visited.sort(key=lambda kelvin: -sum(round(other, 2) == kelvin for other in stated))
    chamber = models.chamber
    if chamber is None:
        return [*visited] if visited and models.replays else [None]
    found: list[float | None] = [*visited] or [None]
    for celsius in EVERYDAY:
        kelvin = celsius + ZERO_CELSIUS
        near = any(abs(kelvin - (other or chamber.ambient)) < _APART for other in found)
        if len(visited) < 2 and chamber.lowest <= kelvin <= chamber.highest and not near:
            found.append(kelvin)
    return found


def _ramps(
    recorded: Sequence[Segment], models: BenchModels, place: Array, warm: Sequence[float | None]
) -> Iterator[MenuEntry]:
    """Yields temperature ramps during which samples are recorded. The ramps start from the most frequent temperature."""
    if models.chamber is None:
        done = {(item.ramp_to, item.dwell) for item in recorded if item.ramp_to is not None}
        ramps = [(kelvin, dwell or 0.0) for kelvin, dwell in done]
    else:
        start = warm[0] or models.chamber.ambient
        ramps = [(kelvin, abs(kelvin - start) / models.chamber.ramp) for kelvin in warm[1:] if kelvin is not None]
    for kelvin, dwell in sorted(ramps):
        if dwell > 0:
            yield MenuEntry(
                orientation_text(place), f"{dwell:g} s", "", f"{{ramp_to: {kelvin - ZERO_CELSIUS:.6g} degC}}"
            )


DEFAULT_SOAK = 1800.0  # s, where the plan never changes temperature
_CHANGED = 1.0  # K between segments: less is no change of temperature
_LONGEST_TITLE = 200  # characters that the plan language allows
_NO_TEXT = ("null", "true", "false")  # words that YAML does not read as text


@dataclass(frozen=True)
class Frame:
    """Contains the values that a proposed plan takes from the executed plan.

    `settle`, `soak`: waiting times, s. `before`: time [s] from the beginning of the executed plan to its first sample.
    """

    title: str
    bench: str
    kind: str
    outputs: tuple[str, ...]
    settle: float
    soak: float
    before: float = 0.0


@dataclass(frozen=True)
class Next:
    """Contains a proposal of what to measure next, and the text of the proposed plan. The text is empty if the bench can execute
    no helpful segment."""

    proposal: SegmentProposal
    text: str

    def to_json(self) -> dict[str, object]:
        """Returns JSON data according to `next` of `schemas/diagnosis.schema.json`."""
        found = self.proposal
        expected: dict[str, object] = {
            "rivals": [name for name, _ in found.rivals],
            "separable": bool(self.text),
            "probability_now": found.now,
            "probability": found.probability,
            "gain": found.probability - found.now,
            "hours": found.seconds / 3600,
            "repeating": {"hours": found.repeating[0] / 3600, "probability": found.repeating[1]},
        }
        if found.sensor:
            expected["sensor"] = found.sensor
        expected["words"] = words(found, bool(self.text))
        return {"plan": None, "text": self.text, "expected": expected}


def words(found: SegmentProposal, planned: bool) -> str:
    """Describes the proposal in sentences. `planned`: True if a plan was made from the proposal."""
    rivals = listed([explanation(name) for name, _ in found.rivals])
    if planned:
        said = (
            f"{count_of(len(found.segments), 'segment')} in {_duration(found.seconds)} would separate {rivals}: the true "
            f"explanation among them is then expected to have P = {found.probability:.2f}; at present it has P "
            f"= {found.now:.2f}."
        )
        hours, reached = found.repeating
        said += f" Repeating the recorded segments would take {_duration(hours)} to reach P = {reached:.2f}."
    else:
        said = f"No segment that this bench can execute separates {rivals}."
    if found.sensor:
        return f"{said} {found.sensor[0].upper()}{found.sensor[1:]} would."
    if not planned:
        return (
            f"{said} An autocollimator, a level, accelerometers or a second triad of gyros next to the sensor would "
            "not separate them either."
        )
    return said


def propose_next(
    diagnosis: Diagnosis, recording: Sequence[RecordedSegment], models: BenchModels, frame: Frame
) -> Next | None:
    """Proposes what to measure next on a bench; None if no question is open. Raises `InputError` if no executable plan can express
    the proposal."""
    from planrunner.gap.answer.next import propose

    options, grounds = _Options(recording, models, frame), diagnosis.grounds
    found = propose(
        grounds.weighing,
        diagnosis.posterior,
        grounds.candidates,
        grounds.nominal,
        options.segments,
        options.seconds,
        recording[-1].statistics.end - recording[0].statistics.start + frame.before,
    )
    if found is None:
        return None
    chosen = options.ordered(found.segments)
    lasting = options.total(chosen)
    entries = [options.entry(segment) for segment in chosen]
    proposal = replace(found, segments=tuple(chosen), seconds=lasting)
    return Next(proposal, plan_text(frame, entries, words(proposal, True)) if entries else "")


def plan_text(frame: Frame, entries: Sequence[MenuEntry], description: str) -> str:
    """Writes a plan with one line for each segment; returns its text."""
    lines = [
        "planrunner: 1",
        f"title: {_quoted(('What to measure next: ' + frame.title)[:_LONGEST_TITLE])}",
        "description: >",
        f"  {description}",
        f"bench: {_quoted(frame.bench)}",
        f"sensor: {{kind: {_name(frame.kind)}, outputs: [{', '.join(map(_name, frame.outputs))}]}}",
        f"defaults: {{settle: {frame.settle:g} s, soak: {frame.soak:g} s}}",
        "",
        "segments:",
    ]
    width = len(str(len(entries)))
    lines += [f"  - {entry.line(f'N{number:0{width}d}')}" for number, entry in enumerate(entries, 1)]
    return "\n".join(lines) + "\n"


class _Options:
    """Contains the segments that the bench can execute, each with the line that states it in a plan."""

    def __init__(self, recording: Sequence[RecordedSegment], models: BenchModels, frame: Frame):
        self.models = models
        entries = menu([item.segment for item in recording], models)
        stated = _stated(plan_text(frame, entries, "Everything that the bench can probably do."))
        schedule = build_schedule(stated, models, Findings())
        by_label = {item.label: (item, entry) for item, entry in zip(stated, entries, strict=True)}
        self.segments = schedule.segments
        self._of = {segment.label: by_label[segment.label] for segment in schedule.segments}
        self._known: dict[tuple[str, str], float] = {}
        self._move, self._change = _pauses(recording)
        self._last = recording[-1].segment

    def entry(self, segment: Segment) -> MenuEntry:
        return self._of[segment.label][1]

    def seconds(self, before: Segment | None, segment: Segment) -> float:
        """Returns the time [s] that a segment takes if it follows the segment `before`, or if it is the first segment (`before` is
        None)."""
        key = ("" if before is None else before.label, segment.label)
        if key not in self._known:
            self._known[key] = self._following(before, segment)
        return self._known[key]

    def _following(self, before: Segment | None, segment: Segment) -> float:
        if self.models.replays:
            was, now = _end(before or self._last), segment.temperature
            warmer = segment.ramp_to is None and was is not None and now is not None and abs(was - now) > _CHANGED
            return (segment.dwell or 0.0) + self._move + (self._change if warmer else 0.0)
        stated = [] if before is None else [self._of[before.label][0]]
        both = build_schedule([*stated, self._of[segment.label][0]], self.models, Findings()).segments
        return both[-1].seconds

    def ordered(self, segments: Sequence[Segment]) -> list[Segment]:
        """Returns the given segments without those that the bench cannot execute in this order."""
        stated = [replace(self._of[item.label][0], label=f"{i}") for i, item in enumerate(segments)]
        kept = build_schedule(stated, self.models, Findings()).segments
        return [segments[int(item.label)] for item in kept]

    def total(self, segments: Sequence[Segment]) -> float:
        if not self.models.replays:
            return build_schedule([self._of[item.label][0] for item in segments], self.models, Findings()).total
        pairs = zip([None, *segments[:-1]], segments, strict=True) if segments else ()
        return sum(self.seconds(before, segment) for before, segment in pairs)


def _stated(text: str) -> list[StatedSegment]:
    """Returns the segments that the text of a proposed plan contains. Raises `InputError` if this plan has errors."""
    plan, log = parse_plan(text, "<proposal>")
    stated = [] if plan is None or log.errors else expand(plan, log)
    if log.errors:
        message = f"no executable plan can be proposed: {log.errors[0].message}"
        hint = "the diagnosis is valid; a proposed plan inherits title, sensor and bench from the plan of the run: check these"
        raise InputError.at(Mark("<proposal>"), "gap-next-unsound", message, hint)
    return stated


def _end(segment: Segment) -> float | None:
    return segment.ramp_to if segment.ramp_to is not None else segment.temperature


def _pauses(recording: Sequence[RecordedSegment]) -> tuple[float, float]:
    """Returns the median time [s] between consecutive recorded segments at the same temperature, and the additional time [s] that a
    change of temperature takes."""
    moves, changes = list[float](), list[float]()
    for before, after in pairwise(recording):
        pause = after.statistics.start - (before.statistics.start + before.statistics.duration)
        was, now = before.segment.temperature, after.segment.temperature
        changed = was is not None and now is not None and abs(was - now) > _CHANGED
        (changes if changed or before.segment.ramp_to is not None else moves).append(max(pause, 0.0))
    move = float(np.median(moves)) if moves else 0.0
    return move, (float(np.median(changes)) - move if changes else DEFAULT_SOAK)


def _duration(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 5400 else f"{math.ceil(seconds / 60)} min"


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _name(text: str) -> str:
    return _quoted(text) if text.lower() in _NO_TEXT else text
