"""Describes a slow drift of the outputs during a test by drift functions. A drift function depends on the time, on the temperature,
or on the temperature's rate of change. The drift of an output is a linear combination of one or more such functions. Drifts are not
reported as results. The drift functions are fitted together with the coefficients only so that the unknown drift contributes to the
uncertainties of the coefficients. A drift function is represented by its mean over each segment, minus its average over the
recorded time of all segments that the estimate uses. A fitted constant is therefore the value at the average time, the average
temperature and the average rate of change of the whole test. The constant has the same meaning for outputs that use only some of
the segments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.observation.observations import Observations, recorded_times
from planrunner.observation.refusals import EstimationError
from planrunner.observation.surroundings import CHANGED
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, key, optional
from planrunner.plan.units import measures, unit

BY_EVIDENCE, NONE = "by_evidence", "none"
ORDERS = ("linear", "quadratic", "cubic")
WITH_TEMPERATURE = ("temperature", "temperature_rate")
_PER = {"linear": "h", "quadratic": "h^2", "cubic": "h^3", "temperature": "K", "temperature_rate": "(K/h)"}
_HOUR = 3600.0
_FEWEST = 4  # segments that show a jump of the clock
_OF_SPACING = 0.1  # of the median time from segment to segment: shorter jumps of the clock hardly change a drift
_JUMPED = 2  # highest power of the time that is tried with a jump of the clock
_STEADY = 1e-9  # K: a smaller change of the temperature is rounding


def drift() -> tuple[str, ...]:
    """Makes the plan key `drift` of estimators that fit constants to segments."""
    words: tuple[str, ...] = key(
        ListOf(Choice((BY_EVIDENCE, NONE, *ORDERS, *WITH_TEMPERATURE)), single=True, minimum=1),
        "Drift of the outputs that is fitted together with the coefficients. It follows the time (`quadratic` includes `linear`, and "
        "`cubic` includes both), the recorded temperature, or the rate of change of this temperature. `by_evidence`: a "
        "drift is fitted only if the segments show one.",
        ["linear", "temperature"],
        default=(BY_EVIDENCE,),
    )
    return words


def thermometer() -> str | None:
    """Makes the plan key that names the channel with the temperature of a segment."""
    channel: str | None = optional(
        CHANNEL,
        "The sensor's own thermometer, for a drift with temperature; by default the recorded temperature channel, if there is exactly one.",
        "sensor_temperature",
    )
    return channel


@dataclass(frozen=True, slots=True, eq=False)
class DriftCourse:
    """Contains one drift function as columns for a fit.

    `columns`: array of shape (n, r), values of the drift function for each of r parts of an output, in the unit `per`. A fitted
    amplitude has the unit of the output divided by `per`. `parts`: names of the parts if there are several. `order`: power of the
    time; 0 if the drift function is not a function of the time. `changed`: change of the recorded temperature between segments, K,
    if the drift function follows the temperature and the change is significant; otherwise 0.
    """

    name: str
    per: str
    columns: Array
    order: int = 0
    parts: tuple[str, ...] = ("",)
    changed: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class ClockJump:
    """Describes a place at which the clock of the recording may have jumped: the pause between two segments that differs most from the
    other pauses, or the longest gap within a segment.

    `label`: the segment after the pause, or the segment that contains the gap. `within`: True for a gap. `seconds`: length of the
    jump, s: the gap, or the pause minus the median of the other pauses. `courses`: the powers of the time without
    the jump. `step`: a change of the outputs at this place: 0 before it and 1 after it.
    """

    label: str
    within: bool
    seconds: float
    courses: tuple[DriftCourse, ...]
    step: DriftCourse


@dataclass(frozen=True, slots=True, eq=False)
class DriftCourses:
    """The drift functions that may be fitted.

    `by_evidence`: True if only the drift functions that the data show are fitted; False if all drift functions are fitted. `fits`:
    number of separate fits that search for the same drift. `shown`: names of the drift functions that at least one of these fits
    shows; each fit then includes these functions if its segments allow it. `jumps`: places at which the clock may have jumped.
    """

    courses: tuple[DriftCourse, ...] = ()
    by_evidence: bool = True
    fits: int = 1
    shown: frozenset[str] = frozenset()
    jumps: tuple[ClockJump, ...] = ()


NO_DRIFT = DriftCourses()


def asked(words: Sequence[str]) -> tuple[str, ...]:
    """Returns the names of the drift functions that a plan requests, including the lower powers of the time. If the data decide
    which functions are fitted, returns the names of all functions that are tried. Raises `EstimationError` for options that exclude
    each other."""
    alone = [word for word in words if word in (BY_EVIDENCE, NONE)]
    if alone and len(set(words)) > 1:
        other = next(word for word in words if word != alone[0])
        raise EstimationError(
            f"`drift: {alone[0]}` excludes `{other}`", f"write only one of them: {', '.join(words)}", "drift"
        )
    if NONE in words:
        return ()
    if BY_EVIDENCE in words:
        return (*ORDERS, "temperature")
    highest = max((ORDERS.index(word) + 1 for word in words if word in ORDERS), default=0)
    return (*ORDERS[:highest], *(word for word in WITH_TEMPERATURE if word in words))


def drift_of(
    words: Sequence[str],
    channel: str | None,
    observations: Observations,
    segments: Sequence[RecordedSegment],
    test: Sequence[RecordedSegment],
) -> DriftCourses:
    """Returns the drift functions for the observations of recorded segments.

    `channel`: the thermometer that the plan names, or None. `segments`: the segments of the observations, in the same order; empty
    if the observations are parts of segments, because their temperatures are then unknown. `test`: all segments that the estimate
    uses. Raises `EstimationError` if the plan requests a drift with the temperature, but no temperature is recorded.
    """
    names, by_evidence = asked(words), BY_EVIDENCE in words
    if not names or (by_evidence and observations.expected):
        return NO_DRIFT
    if segments:
        place = {id(one): row for row, one in enumerate(test)}
        rows = [place[id(one)] for one in segments]
        start, end = recorded_times(test)
        seconds = (end - start) * [one.share for one in test]
    else:
        rows, start, end, seconds = (
            [*range(len(observations.start))],
            observations.start,
            observations.end,
            observations.seconds,
        )
    kelvin = None
    if set(names) & set(WITH_TEMPERATURE):
        name = recorded_thermometer(test if segments else (), channel, by_evidence)
        kelvin = None if name is None else _temperatures(test, name)
    courses = _courses(start, end, seconds, kelvin, rows, names, by_evidence)
    used = [replace(one, columns=one.columns[rows]) for one in courses]
    if by_evidence:  # unknown times, and a temperature that does not change, show no drift
        used = [one for one in used if np.any(one.columns)]
    jumps = _jumps(test, start, end, seconds, rows) if by_evidence and segments else ()
    return DriftCourses(tuple(used), by_evidence, jumps=jumps)


def _jumps(
    test: Sequence[RecordedSegment], start: Array, end: Array, seconds: Array, rows: Sequence[int]
) -> tuple[ClockJump, ...]:
    """Returns the places at which the clock of the recording may have jumped, forward or back. A place counts only if the jump is at
    least a tenth of the median time from segment to segment. `test`: the segments in the order of the plan. `start`, `end`: arrays of
    shape (n,), times of the segments, s. `seconds`: array of shape (n,), recorded time of the used samples, s. `rows`: rows of the
    observations among the segments.

    After a jump back, the recorded times have a wrong order, but the plan has the true one. After a segment was recorded again, the plan
    has a wrong order, but the times have the true one. If the two orders differ, both are used."""
    if len(test) < _FEWEST:
        return ()
    planned, timed = np.arange(len(start)), np.argsort(start, kind="stable")
    orders = [planned] if np.array_equal(planned, timed) else [planned, timed]
    least = _OF_SPACING * float(np.median(np.abs(np.diff(start[timed]))))
    found: list[ClockJump] = []

    def add(row: int, within: bool, size: float, later: NDArray[np.bool_]) -> None:
        begun, ended = start.copy(), end.copy()
        if within:
            ended[row] -= size
        begun[later] -= size
        ended[later] -= size
        courses = tuple(replace(one, columns=one.columns[rows]) for one in in_time(begun, ended, seconds, _JUMPED))
        after = ((start - begun) + (end - ended))[rows] / (2 * size)
        found.append(ClockJump(test[row].label, within, size, courses, DriftCourse("step", "", after[:, None])))

    for order in orders:
        pauses = start[order][1:] - end[order][:-1]
        last = int(np.argmax(np.abs(pauses - np.median(pauses))))  # before the jump
        longer = float(pauses[last] - np.median(np.delete(pauses, last)))
        if abs(longer) > least:
            add(int(order[last + 1]), False, longer, np.isin(planned, order[last + 1 :]))
    gaps = np.array([one.statistics.largest_gap for one in test])
    held = int(np.argmax(gaps))
    if gaps[held] > least:
        shared = np.any((start > start[held]) & (start < end[held]))  # the other segments have the planned times
        add(held, True, float(gaps[held]), (start >= end[held]) & ~shared)
    return tuple(found)


def courses_by_evidence(
    start: Array, end: Array, seconds: Array, kelvin: Array | None, observed: int
) -> tuple[DriftCourses, DriftCourses]:
    """Returns the drift functions that n observations may show, in two versions. The first version has one row for each
    observation. The second version has r rows: the observations, followed by further times.

    `start`, `end`: arrays of shape (r,) in s, the start and end of each observation, followed by the further times. `seconds`:
    array of shape (r,), recorded time of each observation, s, and 0 at the further times. `kelvin`: array of shape (r,),
    temperatures, K, None if they are not recorded. `observed`: number n of observations.
    """
    rows = list(range(observed))
    names = asked((BY_EVIDENCE,))
    whole = [one for one in _courses(start, end, seconds, kelvin, rows, names, True) if np.any(one.columns[:observed])]
    seen = tuple(replace(one, columns=one.columns[:observed]) for one in whole)
    return DriftCourses(seen), DriftCourses(tuple(whole))


def _courses(
    start: Array,
    end: Array,
    seconds: Array,
    kelvin: Array | None,
    rows: Sequence[int],
    names: Sequence[str],
    by_evidence: bool,
) -> list[DriftCourse]:
    """Returns the drift functions whose names are among `names`. Drift functions of the temperature are included only if the
    temperature is known and changes between the given rows. `start`, `end`, `seconds` and `kelvin` have the shape (n,), as in
    `in_time`. `by_evidence`: True if the data decide which functions are fitted."""
    courses = list(in_time(start, end, seconds))
    if kelvin is not None:
        changed = float(np.ptp(kelvin[rows]))
        if not by_evidence or changed >= CHANGED:  # the noise of a thermometer must not count as a drift
            found = _with_temperature((start + end) / 2, kelvin, seconds, names)
            courses += [replace(one, changed=changed if changed >= CHANGED else 0.0) for one in found]
    return [one for one in courses if one.name in names]


def in_time(start: Array, end: Array, seconds: Array, highest: int = len(ORDERS)) -> tuple[DriftCourse, ...]:
    """Returns drift functions that are powers of the time [h] since the middle of the test, up to the highest order. `start`,
    `end`: arrays of shape (n,) in s. `seconds`: array of shape (n,), total duration of the used samples in each segment, s, which
    is the weight of the segment when the functions are centred."""
    middle = (float(start.min()) + float(end.max())) / 2
    low, high = (start - middle) / _HOUR, (end - middle) / _HOUR
    made = []
    for order, name in enumerate(ORDERS[:highest], start=1):
        # (bⁿ⁺¹ − aⁿ⁺¹)/((n + 1)·(b − a)) without the difference, which cancels for short segments.
        means = sum(low**k * high ** (order - k) for k in range(order + 1)) / (order + 1)
        made.append(DriftCourse(name, _PER[name], _centred(np.asarray(means), seconds), order))
    return tuple(made)


def _with_temperature(middle: Array, kelvin: Array, seconds: Array, names: Sequence[str]) -> tuple[DriftCourse, ...]:
    """Returns the drift functions of the temperature whose names are among `names`. `middle`: array of shape (n,), middle times of
    the segments, s. `kelvin`: array of shape (n,), temperatures of the segments, K. The rate of change of the temperature is
    computed from the temperatures of the neighbouring segments. `seconds`: array of shape (n,), recorded time of the used samples,
    s."""
    if len(kelvin) < 2 or np.ptp(kelvin) < _STEADY:
        return ()
    by_level, by_rate = WITH_TEMPERATURE
    found = [DriftCourse(by_level, _PER[by_level], _centred(kelvin, seconds))] if by_level in names else []
    if by_rate not in names:
        return tuple(found)
    order = np.argsort(middle, kind="stable")
    rate = np.empty(len(kelvin))
    rate[order] = np.gradient(kelvin[order], middle[order] / _HOUR)
    return (*found, DriftCourse(by_rate, _PER[by_rate], _centred(rate, seconds)))


def _centred(values: Array, seconds: Array) -> Array:
    return np.asarray(values - values @ seconds / seconds.sum())[:, None]


def recorded_thermometer(segments: Sequence[RecordedSegment], channel: str | None, by_evidence: bool) -> str | None:
    """Returns the thermometer among the channels that all segments record. The choice and the arguments `channel` and `by_evidence`
    are the same as in `thermometer_of`."""
    return thermometer_of(_common(segments), channel, by_evidence)


def thermometer_of(units: Mapping[str, str], channel: str | None, by_evidence: bool) -> str | None:
    """Returns the channel that contains the temperature; None if there is no such channel and the plan does not require one.

    `units`: units of the channels that every segment has. `channel`: the channel that the plan names, or None. Raises
    `EstimationError` if the named channel is not a recorded temperature, or if the plan requires a thermometer but there is none,
    or more than one. `by_evidence`: True if the data decide which drift functions are fitted, so that the plan does not require a
    thermometer.
    """
    thermometers = [name for name in sorted(units) if measures(units[name], "temperature")]
    if channel is not None:
        if channel in thermometers:
            return channel
        message = f"'{channel}' is not a temperature that is recorded in every segment"
        raise EstimationError(message, closest(channel, thermometers), "temperature_channel")
    if len(thermometers) == 1:
        return thermometers[0]
    if by_evidence:
        return None
    if thermometers:
        hint = "name the sensor's own thermometer in `temperature_channel`"
        raise EstimationError(f"there are several thermometers: {', '.join(thermometers)}", hint, "drift")
    message = "a drift with temperature needs a thermometer that is recorded in every segment"
    raise EstimationError(message, "record one, or write `drift: linear`", "drift")


def _common(segments: Sequence[RecordedSegment]) -> dict[str, str]:
    """Returns the units of the channels that every segment has."""
    if not segments:
        return {}
    shared = set.intersection(*(set(one.statistics.channels) for one in segments))
    return {name: text for name, text in segments[0].units.items() if name in shared}


def _temperatures(segments: Sequence[RecordedSegment], channel: str) -> Array:
    """Returns the mean temperatures of the segments, K, shape (n,)."""
    means = np.array([one.statistics.mean[one.statistics.of(channel)] for one in segments])
    scales = [unit(one.units[channel]) for one in segments]
    return np.asarray(means * [one.factor for one in scales] + [one.offset for one in scales])
