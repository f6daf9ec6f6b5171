"""Diagnoses a recording from start to finish: check the plan → read a run folder or a file → check the recording → diagnose.

The layers are independent of each other; this module combines them for the command line and for other programs.

Several recordings of one sensor, made one after the other, can be joined. For example, the recording of a plan can be joined with
the recording of the plan that was proposed afterwards.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date, datetime
from functools import partial
from pathlib import Path, PurePosixPath
from statistics import median
from typing import TYPE_CHECKING

from planrunner.archive.played_back import played
from planrunner.archive.reading_progress import announced
from planrunner.archive.recording import Find, FindKind, RecordedSegment, in_time_order
from planrunner.archive.run_reader import RunReader
from planrunner.archive.statistics import statistics_of
from planrunner.base import plugins
from planrunner.base.documents import JsonObject
from planrunner.base.findings import Finding, Findings, InputError, Mark, closest, count_of
from planrunner.base.progress import Announce
from planrunner.bench.clock import VirtualClock
from planrunner.bench.model import Bench, shipped_benches
from planrunner.instruments.interfaces import Block, InstrumentError, UnservedError
from planrunner.instruments.models import SensorModel
from planrunner.instruments.recording import RecordingPlayer
from planrunner.instruments.recording_keys import RecordingParameters, SegmentColumns
from planrunner.plan.model import NOMINAL_TERMS, Plan
from planrunner.plan.schedule import RecordedMotion
from planrunner.plan.selection import Detection, select
from planrunner.plan.span import Span
from planrunner.plan.units import DIMENSIONS, STANDARD_GRAVITY, unit
from planrunner.tasks.check import Sound, check_plan
from planrunner.tasks.estimate import sound_run

if TYPE_CHECKING:
    from planrunner.bench.specification import Sense
    from planrunner.error_model.observed import Observed
    from planrunner.gap.answer.diagnosis import Diagnosis, DiagnosisOptions
    from planrunner.gap.hypotheses.declarations import AttitudeReading, WrongDeclaration
    from planrunner.reporting.advice import Advice
    from planrunner.tasks.propose import Next

DIAGNOSIS_FORMAT = 1


@dataclass(frozen=True, slots=True)
class Recorded:
    """Contains a recording and the plan with which it was made.

    `where`: the run folder or the file, for messages. `bench`: name or file of the bench, in a form that a plan in another folder
    can use. `created`: time when the run began. `remarks`: notes about the run folder. `several`: True if recordings of several
    runs were joined.
    """

    sound: Sound
    segments: tuple[RecordedSegment, ...]
    where: str
    bench: str = ""
    created: datetime | None = None
    remarks: tuple[Finding, ...] = ()
    several: bool = False


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """Contains a recording, findings about it, its diagnosis, and a proposal of what to measure next. The proposal is None if no
    question is open. `declarations`: wrong declarations that were corrected before the diagnosis. `stated`: maps each effect that
    is known to act to the stated values of its parameters. A value that is stated without a parameter name has the key ''. If the
    effect has only one parameter, this value applies to it; otherwise, it applies to all amplitudes."""

    recorded: Recorded
    diagnosis: Diagnosis
    findings: Findings
    following: Next | None = None
    declarations: tuple[WrongDeclaration, ...] = ()
    stated: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def advice(self) -> list[Advice]:
        """Returns the advice for each effect that the verdict names."""
        from planrunner.error_model.effects.interface import effect_named
        from planrunner.reporting.advice import advice

        fitted = self.diagnosis.parameters
        return [advice(effect_named(name), fitted) for name in self.diagnosis.verdict.named if name != "unknown"]

    def to_json(self) -> JsonObject:
        """Returns the diagnosis according to `schemas/diagnosis.schema.json`."""
        named = [one.to_json() for one in self.advice()]
        wrong = [_declaration(one) for one in self.declarations]
        found = {
            "planrunner_diagnosis": DIAGNOSIS_FORMAT,
            "declarations": wrong,
            "named": named,
            **self.diagnosis.to_json(),
        }
        found["given"] = {"fitted": found["given"], "stated": {name: dict(own) for name, own in self.stated.items()}}
        return found | {"next": None if self.following is None else self.following.to_json()}


def _declaration(wrong: WrongDeclaration) -> JsonObject:
    """Returns a corrected declaration as JSON data according to `declarations` of `schemas/diagnosis.schema.json`."""
    from planrunner.error_model.effects.interface import about, effect_named

    told = about(effect_named(wrong.effect))
    return {
        "effect": wrong.effect,
        "name": told.name,
        "actor": told.actor.value,
        "message": wrong.message,
        "remedy": told.advice(wrong.where, None),
        "parameters": dict(wrong.parameters),
        "alternative": wrong.alternative,
    }


def diagnose_recorded(
    recorded: Recorded,
    options: DiagnosisOptions | None = None,
    jobs: int = 1,
    notice: Announce | None = None,
    given: Sequence[str] = (),
) -> Diagnosed:
    """Diagnoses how a recording differs from its simulation.

    `options`: options of the diagnosis; by default, those in the plan. `jobs`: number of threads for linear algebra; more than one
    rarely helps, because the systems are small. `notice`: receives the progress of reading. `given`: effects that are known to act.
    `EFFECT` in this list means that the effect is fitted. `EFFECT=VALUE` and `EFFECT=NAME:VALUE,NAME:VALUE…` mean that the effect
    with these values is subtracted from the samples. The gap that remains after subtraction is diagnosed. Raises `InputError` with
    all obstacles to a diagnosis.
    """
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=jobs, user_api="blas"):
        segments = announced(recorded.segments, "diagnosing", notice)
        return _diagnosed(replace(recorded, segments=segments), options, given)


def _diagnosed(recorded: Recorded, options: DiagnosisOptions | None, given: Sequence[str]) -> Diagnosed:
    from planrunner.gap.answer.diagnosis import DiagnosisOptions, diagnose
    from planrunner.observation.refusals import ObservationError

    spec = recorded.sound.plan.diagnosis
    options = options or (DiagnosisOptions() if spec is None else DiagnosisOptions(nominal=spec.nominal))
    fitted, stated = _known(given)
    options = replace(options, given=(*options.given, *fitted))
    observed, wrong, findings = corrected_observation(recorded, options.nominal)
    try:
        found = diagnose(_without(observed, stated, options.nominal), options)
    except ObservationError as error:
        raise _unfit(recorded, error) from None
    _name_outliers(recorded, found, findings)
    _compare_with_specification(recorded, found, findings)
    _compare_temperature_with_time(recorded, observed, found, findings)
    following = None if wrong else _following(recorded, found, findings)
    return Diagnosed(recorded, found, findings, following, wrong, stated)


GIVEN = "--given"


def _known(given: Sequence[str]) -> tuple[list[str], dict[str, Mapping[str, str]]]:
    """Reads the effects that are known to act. Returns the names of the effects to fit, and the stated values of the effects to
    subtract. Raises `InputError` for an unknown effect or an effect given twice."""
    from planrunner.tasks.simulate import parsed

    fitted: list[str] = []
    stated: dict[str, Mapping[str, str]] = {}
    for text in given:
        name, values = parsed(text, GIVEN)
        if name not in plugins.names(plugins.EFFECTS):
            hint = closest(name, plugins.names(plugins.EFFECTS))
            raise InputError.at(Mark(GIVEN), "effect-unknown", f"no effect '{name}' is installed", hint)
        if name in stated or name in fitted:
            message = f"'{name}' is given twice"
            raise InputError.at(Mark(GIVEN), "effect-twice", message, f"give all its parameters in one {GIVEN}")
        if values:
            stated[name] = values
        else:
            fitted.append(name)
    return fitted, stated


def _without(observed: Observed, stated: Mapping[str, Mapping[str, str]], nominal: tuple[str, ...]) -> Observed:
    """Returns the samples after subtracting the effects whose values are stated. Raises `InputError` for an effect that cannot be
    subtracted."""
    if not stated:
        return observed
    from planrunner.error_model.added import added, addition
    from planrunner.gap.hypotheses.candidates import Weighing

    levels = Weighing(observed, nominal).fitted()
    seen = replace(observed, fitted=levels)
    additions = [addition(name, values, seen, Mark(GIVEN)) for name, values in stated.items()]
    return replace(observed, values=observed.values - (added(seen, levels, additions, 0) - levels))


_CLEARLY = 2.0
"""A value is outside its specification only if it exceeds the limit by more than this number of standard uncertainties."""


def _compare_with_specification(recorded: Recorded, found: Diagnosis, log: Findings) -> None:
    """Warns about nominal terms whose values are outside the specification in the bench file. If there is no specification, the
    usual limits of the sensor's grade are used, and the grade is determined from the sensor's noise. The values come from the fit
    of the simulation or from the diagnosis. A value with an uncertainty above the usual limit is ignored: the plan does not
    determine this value, so the value shows nothing about the sensor."""
    from planrunner.bench.specification import SENSES, grade_of
    from planrunner.gap.answer.parameters import nominal_values
    from planrunner.reporting.rounding import rounded

    specification = recorded.sound.bench.specification
    limits = {} if specification is None else specification.limits()
    grades = {sense: grade_of(sense, noise) for sense, noise in _noise(found).items()}
    for one in (*nominal_values(found.grounds.weighing, found.grounds.nominal), *found.parameters):
        grade = grades.get(SENSES[one.effect]) if one.effect in SENSES else None
        limit = limits.get(one.effect) or (None if grade is None else grade.limits()[one.effect])
        if limit is None:
            continue
        bound = limit.to(one.unit)
        if abs(one.value) - _CLEARLY * one.standard_uncertainty <= bound:
            continue
        what = f"{one.effect} {one.name} is {rounded(one.value, one.standard_uncertainty)} {one.unit}, {abs(one.value) / bound:.2g} times"
        hint = "check the sensor and its configuration, and the sign, unit and axis of the channel in the bench file"
        if specification is not None and one.effect in limits:
            place = specification.at(one.effect if one.effect in specification.origin.keys else "grade")
            log.warning("gap-specification", place, f"{what} its specification of ±{bound:.4g} {one.unit}", hint)
        elif grade is not None and one.standard_uncertainty < bound:
            usual = (
                f"{what} the usual limit of ±{bound:.4g} {one.unit} for a sensor with such noise ({grade.name} grade)"
            )
            hint += "; declare the limits of the data sheet, or the grade, under `specification`"
            log.warning("gap-usual-limits", Mark(recorded.where), usual, hint)


def _noise(found: Diagnosis) -> dict[Sense, float]:
    """Returns the white noise of the gyros and of the accelerometers, in the units of `Grade.quietest`. Each value is the median of
    the declared noise over the channels. For a channel without a declaration, the measured noise is used."""
    import math

    from planrunner.bench.specification import Sense

    weighing = found.grounds.weighing
    seen, measured = weighing.declared, weighing.white / math.sqrt(weighing.declared.sample_rate)
    units = {
        "gyro": (Sense.RATE, math.degrees(1) * 60),
        "accel": (Sense.FORCE, math.sqrt(2) / (STANDARD_GRAVITY * 1e-6)),
    }
    return {
        sense: factor * median(seen.channels[index].white or float(measured[index]) for index in seen.of_kind(kind))
        for kind, (sense, factor) in units.items()
        if len(seen.of_kind(kind))
    }


def _compare_temperature_with_time(recorded: Recorded, observed: Observed, found: Diagnosis, log: Findings) -> None:
    """Warns if a named effect depends on the temperature or on the time since power-on, and the temperature changed nearly in
    proportion to time. The catalogue contains no steady drift in time. In such a recording, the fitted effect therefore contains
    a steady drift of the bias, and the standard uncertainties of its parameters do not show this."""
    import numpy as np

    from planrunner.error_model.effects.interface import FollowsTemperature, ShapedOverSegments, effect_named
    from planrunner.gap.answer.verdict import ALIKE
    from planrunner.observation.surroundings import CHANGED

    concerned = [
        one
        for one in dict.fromkeys(value.effect for value in found.parameters)
        if isinstance(effect_named(one), FollowsTemperature | ShapedOverSegments)
    ]
    parts = observed.segments()
    time, temperature = (
        np.array([samples[part].mean() for part in parts]) for samples in (observed.time, observed.temperature)
    )
    if not concerned or len(parts) < 3 or np.ptp(temperature) < CHANGED or np.ptp(time) == 0:
        return
    r = float(np.corrcoef(time, temperature)[0, 1])
    if r**2 <= ALIKE:
        return
    slope = float(np.polyfit(time, temperature, 1)[0]) * 3600
    message = (
        f"the temperature changed nearly in proportion to time (correlation {r:.3f}, {slope:.3g} K/h), so the recording cannot "
        f"distinguish {' and '.join(concerned)} from a steady drift of the bias; the stated uncertainties do not contain such a drift"
    )
    hint = "record the same temperatures again in the opposite order, or repeat one temperature at another time"
    log.warning("gap-temperature-or-time", Mark(recorded.where), message, hint)


def diagnosed_again(made: Diagnosed, observed: Observed, options: DiagnosisOptions) -> Diagnosed:
    """Diagnoses the same recording again after effects were subtracted from its samples. The new diagnosis proposes nothing to
    measure next. Raises `InputError` if the recording cannot be diagnosed."""
    from planrunner.gap.answer.diagnosis import diagnose
    from planrunner.observation.refusals import ObservationError

    try:
        return Diagnosed(made.recorded, diagnose(observed, options), Findings())
    except ObservationError as error:
        raise _unfit(made.recorded, error) from None


def _following(recorded: Recorded, found: Diagnosis, log: Findings) -> Next | None:
    """Proposes what to measure next after a recording with planned orientations. Returns None for other recordings, and if there is
    nothing to propose. If no plan can express the proposal, a finding in the log reports this, and the diagnosis stays valid."""
    from planrunner.tasks.propose import DEFAULT_SOAK, Frame, propose_next

    segments = tuple(map(_lasting, _chosen(recorded)))
    known = all(
        item.segment.attitude is not None and not isinstance(item.segment.motion, RecordedMotion) for item in segments
    )
    if recorded.sound.plan.mounting or not known:
        return None
    planned, plan = [item.segment for item in segments], recorded.sound.plan
    frame = Frame(
        plan.title,
        recorded.bench or plan.bench,
        plan.sensor.kind,
        plan.sensor.outputs,
        median(segment.settle for segment in planned),
        max(segment.soak for segment in planned) or DEFAULT_SOAK,
        0.0 if recorded.sound.models.replays else planned[0].start,
    )
    try:
        return propose_next(found, segments, recorded.sound.models, frame)
    except InputError as error:
        for finding in error.findings:
            log.warning(finding.code, Mark(recorded.where), finding.message, finding.hint)
        return None


def _lasting(item: RecordedSegment) -> RecordedSegment:
    """Returns the segment. If the plan states no dwell, the recorded duration [s] becomes the dwell of the segment."""
    if item.segment.dwell is not None:
        return item
    return replace(item, segment=replace(item.segment, dwell=item.statistics.duration))


def observe(recorded: Recorded, nominal: Sequence[str] = NOMINAL_TERMS) -> tuple[Observed, Findings]:
    """Returns the samples with the planned states, ready for a diagnosis, and warnings about the samples. Wrong declarations are
    corrected. `nominal`: the terms that the simulation fits. Raises `InputError` with all obstacles to a diagnosis."""
    seen, _, findings = corrected_observation(recorded, nominal)
    return seen, findings


def corrected_observation(
    recorded: Recorded, nominal: Sequence[str]
) -> tuple[Observed, tuple[WrongDeclaration, ...], Findings]:
    """Does the same as `observe`, but also returns the wrong declarations that were corrected. Raises `InputError` with all
    obstacles to a diagnosis."""
    from planrunner.gap.evidence.recording_checks import check_observed, check_recording, check_segments
    from planrunner.gap.hypotheses.declarations import attitude_read_otherwise, corrected, in_step
    from planrunner.observation.refusals import ObservationError
    from planrunner.observation.samples import observed, poses, unknown_orientations

    sound, used = recorded.sound, _outputs(recorded.sound.plan)
    if sound.sensor.stabilised:
        message = "gimbals decouple the outputs of this sensor from the table, so the plan does not give their input"
        hint = "diagnose a sensor that is fixed to the table"
        raise InputError.at(Mark(recorded.where), "gap-unfit", message, hint)
    shown = {
        name
        for item in _chosen(recorded)
        if isinstance(item.segment.motion, RecordedMotion)
        for name in item.segment.motion.channels
    }
    if shown and not (
        sound.plan.diagnosis and sound.plan.diagnosis.outputs
    ):  # what shows the motion is not judged by it
        used = tuple(name for name in used or [o.name for o in sound.sensor.outputs] if name not in shown)
    sensor = replace(sound.sensor, outputs=tuple(o for o in sound.sensor.outputs if not used or o.name in used))
    findings = Findings()
    segments = _chosen(_without_spikes(recorded, sensor, findings))
    check_recording(segments, sensor, recorded.where, findings)
    if findings.errors:
        raise InputError(findings)
    units = segments[0].units
    try:
        late: list[WrongDeclaration] = []
        if unknown_orientations(segments):
            seen = poses(segments, sound.models.site, sensor, nominal, only=_with_axis(used))
        else:

            def read(late: Mapping[str, float]) -> Observed:
                return observed(
                    segments,
                    sound.models.site,
                    sensor,
                    only=_with_axis(used),
                    angle_channel=only_channel(units, "angle"),
                    temperature_channel=only_channel(units, "temperature"),
                    supply_channel=only_channel(units, "voltage"),
                    pressure_channel=only_channel(units, "pressure"),
                    magnetic=sound.models.site.magnetic_field,
                    free_angle=True,
                    late=late,
                )

            seen, late = in_step(read({}), read, segments[0].statistics.period)
        fixture = sound.bench.fixture
        if fixture is not None and fixture.reach is not None:
            seen = replace(seen, reach=fixture.reach.value)
        reading = attitude_read_otherwise(seen)
        if reading is not None:
            findings.error("gap-attitude", Mark(recorded.where), *_read_otherwise(reading))
            raise InputError(findings)
        seen, wrong = corrected(seen)
        wrong += late
        for one in wrong:
            findings.warning("gap-declaration", Mark(recorded.where), *_warned(one))
        check_observed(seen, recorded.where, findings)
        check_segments(seen, recorded.where, findings)
    except ObservationError as error:
        raise _unfit(recorded, error) from None
    if findings.errors:
        raise InputError(findings)
    return seen, tuple(wrong), findings


def _read_otherwise(reading: AttitudeReading) -> tuple[str, str]:
    """Returns the message and the hint of the error about an attitude reference that must be read differently."""
    from planrunner.gap.hypotheses.declarations import REAL_PART_LAST

    read, remedies = [], []
    if reading.order == REAL_PART_LAST:
        read.append("with the real part last")
        remedies.append("exchange the columns in the bench file, so that `attitude` lists the real part first")
    if reading.conjugate:
        read.append("as a conversion of vectors from East-North-Up to the sensor's axes")
        remedies.append("in the bench file, give the channels of the three imaginary parts `per_unit: -1`")
    message = f"the outputs follow the attitude reference only if its quaternions are read {' and '.join(read)}"
    return message, "; ".join(remedies)


def _warned(wrong: WrongDeclaration) -> tuple[str, str]:
    """Returns the message and the hint of the warning about a wrong declaration."""
    from planrunner.error_model.effects.interface import about, effect_named

    told = about(effect_named(wrong.effect))
    also = f" (or {wrong.alternative})" if wrong.alternative else ""
    hint = f"{told.advice(wrong.where, None)} The diagnosis continues with the corrected declaration"
    return f"{told.name}: {wrong.message}{also}", hint


_EXAMINE = "examine the recording; errors of single samples cannot explain a difference between the means of segments"


def _without_spikes(recorded: Recorded, sensor: SensorModel, log: Findings) -> Recorded:
    """Removes spikes and repeated samples from the recording, as estimates also do; the log names these samples. Bursts and
    stretches with clipped or stuck samples are kept, because the diagnosis explains them."""
    from planrunner.observation.screening import screened, without_bad

    used = {"", *(output.name for output in sensor.outputs)}
    left_out: list[tuple[RecordedSegment, Find]] = []
    segments = []
    for item in screened(recorded.segments, sensor):
        single = tuple(
            one
            for one in item.finds or ()
            if one.bad and one.kind in (FindKind.SPIKE, FindKind.REPEATED) and one.channel in used
        )
        left_out += [(item, one) for one in single]
        segments.append(without_bad(replace(item, finds=single)))
    if left_out:
        item, one = max(left_out, key=lambda pair: abs(pair[1].size))
        kind = "spike" if one.kind is FindKind.SPIKE else "repeated sample"
        many = len(left_out) > 1
        count = f"{count_of(len(left_out), 'spike or repeated sample', 'spikes or repeated samples')} {'were' if many else 'was'}"
        place = f"{one.channel or 'all channels'} in '{item.label}' at {one.time:.6g} s"
        message = f"{count} left out of the diagnosis; {'the largest' if many else 'it'} is a {kind} of {place}"
        log.warning("gap-left-out", Mark(recorded.where), message, _EXAMINE)
    return replace(recorded, segments=tuple(segments))


def _name_outliers(recorded: Recorded, found: Diagnosis, log: Findings) -> None:
    """Warns about errors of single samples that only the spectrum of the noise reveals. The diagnosis does not take these errors
    into account."""
    import numpy as np

    weighing = found.grounds.weighing
    if weighing.outliers is None:
        return
    observed = weighing.observed
    sizes = np.abs(weighing.outliers)
    row, index = np.unravel_index(int(np.argmax(sizes / weighing.white)), sizes.shape)
    channel, label = observed.channels[index], observed.labels[observed.owner[row]]
    size = f"{sizes[row, index] / channel.factor:.3g} {channel.unit}"
    outliers = int(np.count_nonzero(sizes))
    was, largest = ("were", "the largest error is") if outliers > 1 else ("was", "its error is")
    message = (
        f"{count_of(outliers, 'single sample')} with an error smaller than the scatter of the samples {was} left out of the diagnosis; "
        f"{largest} {size}, in {channel.name} in '{label}' at {observed.time[row]:.6g} s after power-on"
    )
    log.warning("gap-left-out", Mark(recorded.where), message, _EXAMINE)


def _outputs(plan: Plan) -> tuple[str, ...]:
    """Returns the outputs to analyse; an empty result means all outputs. Raises `InputError` for an output that the plan's sensor
    does not have."""
    spec, known = plan.diagnosis, plan.sensor.outputs
    if spec is None or not spec.outputs:
        return known
    for index, name in enumerate(spec.outputs):
        if known and name not in known:
            message = f"'{name}' is not an output of this plan's sensor"
            raise InputError.at(spec.at(f"outputs[{index}]"), "gap-unfit", message, closest(name, known))
    return spec.outputs


def _chosen(recorded: Recorded) -> tuple[RecordedSegment, ...]:
    """Returns the segments that the plan's `diagnosis` selects by their labels, in chronological order. If the plan asks for
    intervals at rest, returns the intervals detected in these segments instead."""
    return in_time_order(_meant(recorded))


def _meant(recorded: Recorded) -> tuple[RecordedSegment, ...]:
    spec = recorded.sound.plan.diagnosis
    if spec is None:
        return recorded.segments
    if not isinstance(spec.segments, Detection):
        return tuple(
            recorded.segments[index] for index in select([item.label for item in recorded.segments], spec.segments)
        )
    from planrunner.estimators.interface import EstimationError
    from planrunner.observation.still_detection import still_spans

    within = select([item.label for item in recorded.segments], spec.segments.within)
    found: list[RecordedSegment] = []
    for item in (recorded.segments[index] for index in within):
        try:
            spans = still_spans(item, spec.segments)
        except EstimationError as error:
            raise InputError.at(spec.segments.origin.mark, "gap-unfit", str(error), "look at `channels`") from None
        found += [_stretch(item, number, one.span) for number, one in enumerate(spans, start=1)]
    if not found:
        message, hint = "no interval at rest was found in the recording", "raise `threshold` or shorten `at_least`"
        size = _size_of_force([recorded.segments[index] for index in within])
        if not 1 / _WRONG_UNIT < size < _WRONG_UNIT:
            message += f"; the root mean square of the specific force is {size:.3g} g"
            hint = "check the unit of the accelerometers in the bench file; at rest, they measure 1 g"
        raise InputError.at(spec.segments.origin.mark, "gap-unfit", message, hint)
    return tuple(found)


_WRONG_UNIT = 3.0
"""If the root mean square of the specific force is this many times larger or smaller than gravity, the unit is probably wrong."""


def _size_of_force(segments: Sequence[RecordedSegment]) -> float:
    """Returns the root mean square of the specific force over some segments, g, from one accelerometer for each sensor axis; 1 if no
    segment has samples of accelerometers along three axes."""
    import math

    from planrunner.error_model.observed import KINDS, axis_of

    squares, count = 0.0, 0
    for item in segments:
        known = item.statistics
        forces = [name for name in known.channels if KINDS.get(unit(item.units[name]).dimension) == "accel"]
        triad = {axis_of(name): name for name in reversed(forces) if axis_of(name) is not None}
        if len(triad) < 3 or not known.count:
            continue
        for name in triad.values():
            at, factor = known.of(name), unit(item.units[name]).factor
            squares += known.count * factor**2 * float(known.mean[at] ** 2 + known.covariance[at, at])
        count += known.count
    return math.sqrt(squares / count) / STANDARD_GRAVITY if count else 1.0


def _stretch(item: RecordedSegment, number: int, span: Span) -> RecordedSegment:
    """Returns the part of a segment's samples that lies within a span, as a separate segment."""

    def blocks(channels: Sequence[str]) -> Iterator[Block]:
        for block in item.blocks(channels):
            part = span.of(block.time, item.statistics.period)
            if part.start < part.stop:
                yield Block(block.time[part], {name: block.channels[name][part] for name in channels})

    rows = sum(len(block.time) for block in blocks(tuple(item.units)))
    label = f"{item.label} {number}"
    statistics = statistics_of(blocks(tuple(item.units)), tuple(item.units), rows, motion=item.segment.motion)
    return replace(item, segment=replace(item.segment, label=label, dwell=None), statistics=statistics, blocks=blocks)


def _unfit(recorded: Recorded, error: Exception) -> InputError:
    from planrunner.observation.refusals import ObservationError

    hint = error.hint if isinstance(error, ObservationError) else ""
    return InputError.at(
        Mark(recorded.where), "gap-unfit", str(error), hint or "check the plan and the channels in the bench file"
    )


def recorded_run(run: Path, notice: Announce | None = None) -> Recorded:
    """Reads the recording in a run folder. `notice`: receives the progress of reading. Raises `InputError` if the folder is not a
    run, and `IntegrityError` if it was changed."""
    from planrunner.observation.screening import watch_of

    reader = RunReader.open(run)
    sound = sound_run(reader)
    known = [name for name, path in shipped_benches().items() if path.read_bytes() == sound.bench_bytes]
    bench = known[0] if known else str((run / "bench.yaml").resolve())
    created = datetime.fromisoformat(reader.run["created"])
    return Recorded(
        sound,
        reader.recording(sound.schedule, watch_of(sound.sensor), notice),
        str(run),
        bench,
        created,
        reader.findings,
    )


def recorded_file(
    plan: Path, bench: str | None, recording: Path, segments: Path | None = None, notice: Announce | None = None
) -> Recorded:
    """Reads a recording in a file.

    `bench`: bench file that assigns the columns to channels; by default, the bench of the plan. `segments`: table with the label,
    the beginning and the end of each segment; by default, the table that the bench file names, next to the recording. `notice`:
    receives the progress of reading. If the bench file names files that continue the recording, these are read too. Raises
    `InputError` if a file cannot be read or does not fit the plan.
    """
    sound = check_plan(plan, bench=bench, today=date.today()).sound()
    parameters = _parameters(sound.bench, sound.file)
    columns = parameters.segments
    if segments is not None:
        columns = SegmentColumns.of(segments.name) if columns is None else replace(columns, table=segments.name)
    table = segments
    if table is None and columns is not None:
        table = recording.parent / Path(columns.table).name
    files = _files_from(recording, parameters)
    parameters = replace(parameters, file=recording.name, segments=columns)
    if segments is not None:
        parameters = replace(parameters, pauses=None, stretches=None)
    try:
        player = RecordingPlayer.open(parameters, files, table, VirtualClock(), notice=notice)
        player.foresee(sound.schedule.segments)
        segments_played = played(player, sound.schedule.segments)
    except UnservedError as error:
        raise InputError(error.findings) from None
    except InstrumentError as error:
        hint = "check the bench file, --segments and the plan's labels"
        raise InputError.at(Mark(str(recording)), "recording-unfit", str(error), hint) from None
    return Recorded(
        sound,
        segments_played,
        str(recording),
        _bench_for_others(bench or sound.plan.bench, plan if bench is None else None),
    )


def _files_from(recording: Path, parameters: RecordingParameters) -> tuple[Path, ...]:
    """Returns the paths of all files of a recording. `recording`: path of the first file. The files that continue it lie relative to
    it as the bench file says. Raises `InputError` if the bench file names such files for another first file, because it is then
    unknown which files continue this one."""
    declared = PurePosixPath(parameters.file)
    if parameters.continued_by and declared.name != recording.name:
        message = f"the bench file names files that continue {declared.name} (`continued_by`), but not {recording.name}"
        hint = f"give {declared.name}, or correct `file` and `continued_by` in the bench file"
        raise InputError.at(Mark(str(recording)), "recording-unfit", message, hint)
    beside = [os.path.relpath(name, declared.parent) for name in parameters.continued_by]
    return (recording, *(recording.parent / name for name in beside))


def _bench_for_others(bench: str, plan: Path | None) -> str:
    """Returns the name or path of a bench in a form that is also valid in a plan in another folder. `plan`: plan file that names
    the bench; None if the command line names it."""
    path = Path(bench) if plan is None else plan.parent / bench
    return bench if bench in shipped_benches() else str(path.resolve())


def _parameters(bench: Bench, plan: str) -> RecordingParameters:
    for entry in bench.instruments.values():
        if isinstance(entry.parameters, RecordingParameters) and entry.parameters.summary is None:
            return entry.parameters
    message = (
        f"the bench '{bench.name}' has no sensor with `driver: recording` and samples, so it cannot assign the columns of "
        "a file to channels"
    )
    hint = "use --bench to name a bench that maps the columns of the recording to channels"
    raise InputError.at(Mark(plan), "recording-no-mapping", message, hint)


def _with_axis(outputs: Sequence[str]) -> tuple[str, ...] | None:
    """Returns the outputs whose names state an axis; None if there are none."""
    from planrunner.error_model.observed import axis_of

    return tuple(name for name in outputs if axis_of(name) is not None) or None


def only_channel(units: Mapping[str, str], dimension: str) -> str | None:
    """Returns the only channel of a dimension; None if there is no such channel or more than one."""
    found = [name for name, text in units.items() if unit(text).dimension == DIMENSIONS[dimension]]
    return found[0] if len(found) == 1 else None


def joined(first: Recorded, runs: Sequence[Path], notice: Announce | None = None) -> Recorded:
    """Joins a recording and later runs of the same sensor, if the sensor stayed switched on between the runs.

    The time axis is continuous: a later run is shifted by the difference between the start times in the run folders. The shift is
    larger if the run would otherwise begin before the end of the previous run. `notice`: receives the progress of reading. Raises
    `InputError` if a run has other channels or cannot be read.
    """
    whole, origin = first, first.created
    for run in runs:
        further = recorded_run(run, notice)
        if dict(further.segments[0].units) != dict(first.segments[0].units):
            message = "its channels differ from those of the preceding recording"
            raise InputError.at(
                Mark(str(run)), "gap-other-sensor", message, "join only runs of the same sensor on the same bench"
            )
        made = further.created
        later = 0.0 if made is None or origin is None else (made - origin).total_seconds()
        end = max(item.statistics.end for item in whole.segments)
        later = max(later, end - min(0.0, min(item.statistics.start for item in further.segments)))
        segments = tuple(_moved(item, later, f"{run.name}/") for item in further.segments)
        whole = replace(
            whole, segments=whole.segments + segments, remarks=whole.remarks + further.remarks, several=True
        )
    return whole


def _moved(item: RecordedSegment, seconds: float, before: str) -> RecordedSegment:
    """Returns the segment, delayed by the given time, with a label that no other run contains."""
    segment = replace(item.segment, label=before + item.label, start=item.segment.start + seconds)
    known = item.statistics
    statistics = replace(known, start=known.start + seconds, end=known.end + seconds)
    finds = None if item.finds is None else tuple(replace(one, time=one.time + seconds) for one in item.finds)
    return replace(item, segment=segment, statistics=statistics, blocks=partial(_later, item, seconds), finds=finds)


def _later(item: RecordedSegment, seconds: float, channels: Sequence[str]) -> Iterator[Block]:
    for block in item.blocks(channels):
        yield Block(block.time + seconds, block.channels)
