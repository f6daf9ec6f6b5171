"""Courses that a slow drift of the outputs may take during a test: in time, with temperature, and with the rate of change of the
temperature.

A drift is a nuisance: its courses are fitted together with the coefficients, so that the uncertainties of the coefficients include
a contribution of the unknown drift. A course is described by its mean over each segment, minus its average over the recorded time
of all segments of the estimate. A constant is therefore the value for the whole test: at the average time, at the average
temperature and at its average rate of change. Thus a constant has the same meaning for outputs that use only some of the segments.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.observation.observations import Observations, recorded_times
from planrunner.observation.refusals import EstimationError
from planrunner.observation.surroundings import CHANGED
from planrunner.plan.kinds import CHANNEL, Choice, ListOf, key, optional
from planrunner.plan.units import DIMENSIONS, UnknownUnitError, unit

BY_EVIDENCE, NONE = "by_evidence", "none"
ORDERS = ("linear", "quadratic", "cubic")
WITH_TEMPERATURE = ("temperature", "temperature_rate")
_PER = {"linear": "h", "quadratic": "h^2", "cubic": "h^3", "temperature": "K", "temperature_rate": "(K/h)"}
_HOUR = 3600.0
_STEADY = 1e-9  # K: a smaller change of the temperature is rounding


def drift() -> tuple[str, ...]:
    """The key `drift` of estimators that fit constants to segments."""
    words: tuple[str, ...] = key(
        ListOf(Choice((BY_EVIDENCE, NONE, *ORDERS, *WITH_TEMPERATURE)), single=True, minimum=1),
        "Drift of the outputs during the test that is fitted together with the coefficients: in time (`quadratic` includes `linear`, and "
        "`cubic` includes both), with the recorded temperature, or with its rate of change. `by_evidence`: a "
        "drift is fitted only if the segments show one.",
        ["linear", "temperature"],
        default=(BY_EVIDENCE,),
    )
    return words


def thermometer() -> str | None:
    """The key that names the channel whose mean is the temperature of a segment."""
    channel: str | None = optional(
        CHANNEL,
        "The sensor's own thermometer, for a drift with temperature; by default the only recorded channel that is a temperature.",
        "sensor_temperature",
    )
    return channel


@dataclass(frozen=True, slots=True, eq=False)
class DriftCourse:
    """One course of drift. columns: (n, r), the same course for r parts of an output; they do not have the unit of the output. per:
    the unit by which a fitted amplitude is divided. parts: names of the parts, if there are several. order: power of the time for a
    course in time, otherwise 0. changed: change of the recorded temperature between segments, K, if the course follows it and the
    change is significant; otherwise 0."""

    name: str
    per: str
    columns: Array
    order: int = 0
    parts: tuple[str, ...] = ("",)
    changed: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class DriftCourses:
    """The courses that may be fitted. by_evidence: if True, a course is fitted only if the data show it; otherwise all courses are
    fitted. fits: number of separate fits in which the same drift is sought. shown: names of the courses that one of these fits
    shows; they are fitted where the segments allow it."""

    courses: tuple[DriftCourse, ...] = ()
    by_evidence: bool = True
    fits: int = 1
    shown: frozenset[str] = frozenset()


NO_DRIFT = DriftCourses()


def asked(words: Sequence[str]) -> tuple[str, ...]:
    """The courses that a plan asks for, including the lower orders in time; for `by_evidence`, the courses that may be tried. Raises
    `EstimationError` for options that exclude each other."""
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
    """The courses for the observations of recorded segments.

    channel: the thermometer, if the plan names one. segments: segments of the observations, in their order; empty if the
    observations are parts of segments with unknown temperature. test: all segments of the estimate. Raises `EstimationError` if the
    plan asks for a temperature that is not recorded.
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
    if by_evidence:  # times that are not known, or a temperature that does not change, show nothing
        used = [one for one in used if np.any(one.columns)]
    return DriftCourses(tuple(used), by_evidence)


def courses_by_evidence(
    start: Array, end: Array, seconds: Array, kelvin: Array | None, observed: int
) -> tuple[DriftCourses, DriftCourses]:
    """The courses that n observations may show, and the same courses over all r rows.

    start, end: (r,), s, first for the observations, then for further times; seconds: (r,), recorded time of each observation, s,
    and 0 at the further times; kelvin: (r,), temperatures, None if they are not recorded. observed: number n of observations.
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
    """The courses among `names`; courses with the temperature only if the temperature is known and changes between the given rows.
    Arrays: (n,), as in `in_time`."""
    courses = list(in_time(start, end, seconds))
    if kelvin is not None:
        changed = float(np.ptp(kelvin[rows]))
        if not by_evidence or changed >= CHANGED:  # a thermometer's noise must not explain anything
            found = _with_temperature((start + end) / 2, kelvin, seconds, names)
            courses += [replace(one, changed=changed if changed >= CHANGED else 0.0) for one in found]
    return [one for one in courses if one.name in names]


def in_time(start: Array, end: Array, seconds: Array, highest: int = len(ORDERS)) -> tuple[DriftCourse, ...]:
    """Powers of the time since the middle of the test, h, up to the highest order. start, end: (n,), s; seconds: (n,), recorded time of
    the used samples, s."""
    middle = (float(start.min()) + float(end.max())) / 2
    low, high = (start - middle) / _HOUR, (end - middle) / _HOUR
    made = []
    for order, name in enumerate(ORDERS[:highest], start=1):
        # (bⁿ⁺¹ − aⁿ⁺¹)/((n + 1)·(b − a)) without the difference, which cancels for short segments.
        means = sum(low**k * high ** (order - k) for k in range(order + 1)) / (order + 1)
        made.append(DriftCourse(name, _PER[name], _centred(np.asarray(means), seconds), order))
    return tuple(made)


def _with_temperature(middle: Array, kelvin: Array, seconds: Array, names: Sequence[str]) -> tuple[DriftCourse, ...]:
    """The courses with temperature among `names`. middle: (n,), s; kelvin: (n,), temperatures of the segments. The rate of change
    of the temperature is the slope of the line through the neighbouring segments."""
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
    """The thermometer that is recorded in all segments, as for `thermometer_of`."""
    return thermometer_of(_common(segments), channel, by_evidence)


def thermometer_of(units: Mapping[str, str], channel: str | None, by_evidence: bool) -> str | None:
    """The channel of the temperature; None if there is none and the plan does not require it.

    units: units of the channels that every segment has; channel: the channel that the plan names, if any. Raises `EstimationError`.
    """
    thermometers = [name for name in sorted(units) if _is_temperature(units[name])]
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


def _is_temperature(text: str) -> bool:
    try:
        return unit(text).dimension == DIMENSIONS["temperature"]
    except UnknownUnitError:
        return False


def _common(segments: Sequence[RecordedSegment]) -> dict[str, str]:
    """Units of the channels that every segment has."""
    if not segments:
        return {}
    shared = set.intersection(*(set(one.statistics.channels) for one in segments))
    return {name: text for name, text in segments[0].units.items() if name in shared}


def _temperatures(segments: Sequence[RecordedSegment], channel: str) -> Array:
    """Mean temperatures, K, (n,)."""
    means = np.array([one.statistics.mean[one.statistics.of(channel)] for one in segments])
    scales = [unit(one.units[channel]) for one in segments]
    return np.asarray(means * [one.factor for one in scales] + [one.offset for one in scales])
