"""Checks whether a recorded thermometer reads what the bench file and the plan declare: detects wrong units, reversed and unscaled
readings, and single readings that no temperature can cause.

An estimator cannot find such a fault in its own data, because any readings give a temperature coefficient. A sensor may be warmer
than its surroundings, or kept at one temperature by an oven. Therefore, only these readings contradict the declarations:

- readings outside `POSSIBLE`;
- readings that differ from the planned temperature by more than `FARTHEST`;
- readings that change more than the planned temperature does, or in the opposite direction;
- readings that change in the opposite direction to those of another thermometer.

Along a ramp, the first and the last readings are compared with the planned temperatures at both ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.declared_axes import LARGEST_DEVIATION
from planrunner.observation.drift import thermometer_of
from planrunner.observation.refusals import EstimationError
from planrunner.plan.kinds import Record
from planrunner.plan.units import ZERO_CELSIUS, Unit, measures, unit

POSSIBLE = (-200.0, 250.0)
"""Temperatures, degC, at which inertial sensors are operated: from liquid nitrogen to deep boreholes."""
FARTHEST = 150.0
"""Largest difference, K, between the temperature of a sensor and the planned temperature: an oven of 85 degC in a chamber at -55
degC makes a difference of 140 K."""
NEAR = 60.0
"""Readings agree with a unit other than the declared one if, in that unit, they differ from the planned temperature by at most
this value, K."""
LEAST_CHANGE = 25.0
"""Smallest change of the planned temperature, K, with which the change of the readings is compared. Self-heating of the sensor may
mask a smaller change."""
_UNITS = ("degC", "K", "degF")


@runtime_checkable
class NamesThermometer(Protocol):
    """Keys of an estimator that uses a thermometer. `temperature_channel`: the thermometer; None to use the only recorded
    thermometer."""

    temperature_channel: str | None


@dataclass(frozen=True, slots=True)
class ThermometerReadings:
    """Contains n readings of one thermometer, in its declared unit `unit`. There is one reading for each segment, or one for each end
    of a ramp.

    `labels`: labels of the segments. `mean`: array of shape (n,), the readings. `lowest`, `highest`: arrays of shape (n,), smallest
    and largest sample of the segment. `planned`: array of shape (n,), temperatures that the plan states, degC; NaN if it states none.
    """

    channel: str
    unit: Unit
    labels: tuple[str, ...]
    mean: Array
    lowest: Array
    highest: Array
    planned: Array

    def celsius(self, values: Array, own: Unit) -> Array:
        """Converts values of the recording from the unit `own` to degC."""
        return np.asarray(values * own.factor + own.offset - ZERO_CELSIUS)

    def possible(self, own: Unit) -> bool:
        """Returns True if all readings are possible temperatures in the unit `own`."""
        low, high = self.celsius(self.lowest, own), self.celsius(self.highest, own)
        return not (np.any(low < POSSIBLE[0]) or np.any(high > POSSIBLE[1]))

    def usual(self, own: Unit) -> bool:
        """Returns True if the means of most segments are possible temperatures that agree with the plan in the unit `own`."""
        means = self.celsius(self.mean, own)
        away = np.nan_to_num(np.abs(means - self.planned))
        wrong = (means < POSSIBLE[0]) | (means > POSSIBLE[1]) | (away > FARTHEST)
        return not (np.mean(wrong) > 0.5 or _contradicts(self.slope(own)))

    def slope(self, own: Unit) -> float:
        """Returns the change of the readings, taken in the unit `own`, divided by the change of the planned temperature; NaN if the
        planned temperature changes by less than `LEAST_CHANGE`."""
        return _slope(self.celsius(self.mean, own), self.planned)

    def credible(self, own: Unit) -> bool:
        """Returns True if the readings, taken in the unit `own`, contradict neither the plan nor the temperatures at which sensors
        are operated."""
        return self.possible(own) and self.usual(own)

    def explains(self, own: Unit) -> bool:
        """Returns True if the readings, taken in the unit `own`, agree with the plan. If a degree of this unit has another size
        than a degree of the declared unit, only a change of the planned temperature can confirm the unit."""
        away, slope = np.abs(self.celsius(self.mean, own) - self.planned), self.slope(own)
        if not self.credible(own) or np.any(away > NEAR):
            return False
        return abs(slope - 1) <= LARGEST_DEVIATION or (np.isnan(slope) and own.factor == self.unit.factor)


def thermometer_words(segments: Sequence[RecordedSegment], parameters: Record) -> tuple[Said, ...]:
    """Returns warnings about the thermometer that an estimate uses. `parameters`: the values of the estimator's keys. The result is
    empty if the estimator uses no thermometer."""
    if not isinstance(parameters, NamesThermometer) or not segments:
        return ()
    shared = set.intersection(*(set(one.statistics.channels) for one in segments))
    units = {name: text for name, text in segments[0].units.items() if name in shared}
    try:
        channel = thermometer_of(units, parameters.temperature_channel, True)
    except EstimationError:  # the estimator names this fault
        return ()
    if channel is None or len({one.units[channel] for one in segments}) > 1:
        return ()
    against_plan = contradictions(_readings(segments, channel, unit(units[channel])))
    others = [name for name in sorted(units) if name != channel and measures(units[name], "temperature")]
    return against_plan or tuple(
        said(
            "{channel} and {other} change in opposite directions: when {other} rises by 1 K, {channel} changes by {slope:.3g} K. One of "
            "the two thermometers has the wrong sign, or the temperatures of segments are exchanged. Coefficients that are computed "
            "from wrong readings are wrong.",
            channel=channel,
            other=other,
            slope=slope,
        )
        for other in others
        if (slope := _change(segments, channel, other)) < -LARGEST_DEVIATION
    )


def _ends(one: RecordedSegment, channel: str) -> list[tuple[float, float]]:
    """Returns the readings of a thermometer in a segment, in K, with the planned temperature, K, NaN if it is not known: the mean
    at a constant temperature, or the readings at both ends of a ramp."""
    scale, segment, statistics = unit(one.units[channel]), one.segment, one.statistics
    mean = float(statistics.mean[statistics.of(channel)])
    found = [(mean, math.nan if segment.temperature is None else segment.temperature)]
    if segment.ramp_to is not None and channel in one.readings_of:
        ends, begin = one.readings_of[channel], segment.begins_at
        found = [(ends.first, math.nan if begin is None else begin), (ends.last, segment.ramp_to)]
    return [(reading * scale.factor + scale.offset, planned) for reading, planned in found]


def _change(segments: Sequence[RecordedSegment], channel: str, other: str) -> float:
    """Returns the change of the readings of a thermometer divided by the change of the readings of another thermometer; NaN if the
    latter change by less than `LEAST_CHANGE`."""
    pairs = []
    for one in segments:
        if channel in one.readings_of and other in one.readings_of:
            for end in ("first", "last"):
                row = [(unit(one.units[name]), getattr(one.readings_of[name], end)) for name in (channel, other)]
                pairs.append([scale.factor * reading for scale, reading in row])
    return _slope(*np.array(pairs).reshape(-1, 2).T)


def _slope(readings: Array, reference: Array) -> float:
    """Returns the slope of readings (n,) over a reference temperature (n,), both in K; NaN if the reference changes by less than
    `LEAST_CHANGE`."""
    known = np.isfinite(reference) & np.isfinite(readings)
    if not known.any() or np.ptp(reference[known]) < LEAST_CHANGE:
        return float("nan")
    away = reference[known] - reference[known].mean()
    return float(away @ readings[known] / (away @ away))


def _readings(segments: Sequence[RecordedSegment], channel: str, own: Unit) -> ThermometerReadings:
    columns, labels = [], []
    for one in segments:
        place, found = one.statistics.of(channel), one.statistics
        for kelvin, planned in _ends(one, channel):
            reading = (kelvin - own.offset) / own.factor
            columns.append((reading, found.minimum[place], found.maximum[place], planned - ZERO_CELSIUS))
            labels.append(one.label)
    mean, lowest, highest, stated = np.array(columns, dtype=float).T
    return ThermometerReadings(channel, own, tuple(labels), mean, lowest, highest, stated)


def contradictions(found: ThermometerReadings) -> tuple[Said, ...]:
    """Returns a warning if the readings contradict the declarations. If the readings agree with another unit, the warning names this
    unit."""
    if found.credible(found.unit):
        return ()
    if not found.usual(found.unit):
        for other in map(unit, _UNITS):
            if found.explains(other):
                return (
                    said(
                        "{channel} is declared in {declared}, but its samples agree with {other}. Correct its unit in the bench file. "
                        "Coefficients that are computed from its readings are wrong.",
                        channel=found.channel,
                        declared=found.unit.text,
                        other=other.text,
                    ),
                )
    if not found.possible(found.unit):
        low, high = found.celsius(found.lowest, found.unit), found.celsius(found.highest, found.unit)
        worst = int(np.argmax(np.maximum(POSSIBLE[0] - low, high - POSSIBLE[1])))
        return (
            said(
                "{channel} reads {low:.4g} to {high:.4g} degC in '{segment}'. No sensor has such a temperature: its unit or its "
                "conversion from counts in the bench file is wrong, or some samples are bad. Coefficients that are "
                "computed from its readings are wrong.",
                channel=found.channel,
                low=float(low[worst]),
                high=float(high[worst]),
                segment=found.labels[worst],
            ),
        )
    slope = found.slope(found.unit)
    if _contradicts(slope):
        return (
            said(
                "{channel} changes by {slope:.3g} K for each kelvin by which the planned temperature changes: its unit, its sign or its "
                "conversion from counts in the bench file is wrong, or the temperatures of segments are exchanged. Coefficients that are "
                "computed from its readings are wrong.",
                channel=found.channel,
                slope=slope,
            ),
        )
    away = float(np.nanmedian(found.celsius(found.mean, found.unit) - found.planned))
    return (
        said(
            "{channel} differs from the planned temperatures by {away:.3g} K: its unit or its conversion from counts in the bench file is "
            "wrong. "
            "Coefficients that are computed from its readings are wrong.",
            channel=found.channel,
            away=away,
        ),
    )


def _contradicts(slope: float) -> bool:
    """Returns True if the readings change more than the planned temperature, or in the opposite direction. `slope`: result of
    `ThermometerReadings.slope`. An oven keeps the readings constant, and an incomplete soak makes their change smaller."""
    return slope > 1 + LARGEST_DEVIATION or slope < -LARGEST_DEVIATION
