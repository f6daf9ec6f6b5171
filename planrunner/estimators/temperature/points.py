"""Values over temperature: coefficients that other estimates give by temperature, and channels by segment or along a ramp."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.estimators.interface import Estimate, EstimationError
from planrunner.plan.units import DIMENSIONS, ZERO_CELSIUS, UnknownUnitError, unit

Array = NDArray[np.float64]

_LEAST_IN_BIN = 3  # samples that a scatter about a line can be taken from


@dataclass(frozen=True)
class Points:
    """One quantity at n temperatures. temperature: (n,), degC. uncertainty: (n,), standard, NaN if not known. direction: (n,), +1 on a
    rising ramp, −1 on a falling one, 0 at a held temperature. labels: source of each value. expected: whether the values come from a
    schedule, without scatter."""

    name: str
    unit: str
    temperature: Array
    value: Array
    uncertainty: Array
    direction: NDArray[np.int64]
    labels: tuple[str, ...]
    expected: bool = False

    @property
    def series(self) -> NDArray[np.int64]:
        """(n,): number of the ramp of each value, −1 at a held temperature."""
        names = list(dict.fromkeys(self.labels))
        return np.where(self.direction != 0, [names.index(label) for label in self.labels], -1)

    @property
    def sigma(self) -> Array:
        """Positive standard uncertainties for weights: the known ones, or equal values."""
        known = np.isfinite(self.uncertainty).all() and bool((self.uncertainty > 0).all())
        return self.uncertainty if known else np.ones(len(self.value))

    @property
    def known(self) -> bool:
        return bool(np.isfinite(self.uncertainty).all() and (self.uncertainty > 0).all())


def from_estimates(uses: Mapping[str, Estimate], patterns: Sequence[str]) -> list[Points]:
    """The coefficients by temperature of the estimates used; values of the same coefficient from several estimates are joined.

    Raises `EstimationError` for an estimate without coefficients by temperature, a pattern that matches no name, and different units.
    """
    gathered: dict[str, list[tuple[str, Mapping[str, object]]]] = {}
    for used, estimate in uses.items():
        by_temperature = given_by_temperature(estimate)
        if not by_temperature:
            raise EstimationError(
                f"'{used}' ({estimate.estimator}) gives no coefficients over temperature: state the same "
                "temperature for all its segments, or use another estimate"
            )
        for name, data in by_temperature.items():
            gathered.setdefault(name, []).append((used, data))
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in gathered):
            raise EstimationError(f"no coefficient matches '{pattern}': {closest(pattern, gathered)}")
    wanted = [name for name in gathered if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)]
    expected = all(estimate.expected for estimate in uses.values())
    return [replace(_joined(name, gathered[name]), expected=expected) for name in wanted]


def given_by_temperature(estimate: Estimate) -> Mapping[str, Mapping[str, object]]:
    """The coefficients that an estimate gives by temperature (see `interface.Estimate`); empty if it gives none."""
    found = estimate.extra.get("by_temperature")
    return found if isinstance(found, Mapping) else {}


def _joined(name: str, data: Sequence[tuple[str, Mapping[str, object]]]) -> Points:
    units = sorted({str(one["unit"]) for _, one in data})
    if len(units) > 1:
        raise EstimationError(
            f"'{name}' is given in different units ({', '.join(units)}): use estimates of the same kind"
        )

    def put(key: str) -> Array:
        return np.concatenate([np.atleast_1d(np.asarray(one[key], dtype=float)) for _, one in data])

    labels = tuple(used for used, one in data for _ in np.atleast_1d(np.asarray(one["value"])))
    temperature, value = put("temperature_degC"), put("value")
    if not (np.isfinite(temperature).all() and np.isfinite(value).all()):
        raise EstimationError(f"'{name}' is not a finite number at every temperature")
    return Points(
        name, units[0], temperature, value, put("standard_uncertainty"), np.zeros(len(value), dtype=np.int64), labels
    )


def from_channels(
    segments: Sequence[RecordedSegment], channels: Sequence[str], thermometer: str | None, width: float
) -> list[Points]:
    """Channels over temperature: the samples of each segment in bins of `width` [K] of the thermometer, or its mean at the planned
    temperature. Raises `EstimationError`."""
    for recorded in segments:
        for channel in (*channels, *([thermometer] if thermometer else [])):
            if channel not in recorded.units:
                raise EstimationError(
                    f"segment '{recorded.label}' has no channel '{channel}': {closest(channel, recorded.units)}"
                )
    expected = all(recorded.expected for recorded in segments)
    return [replace(_channel(segments, channel, thermometer, width), expected=expected) for channel in channels]


def _channel(segments: Sequence[RecordedSegment], channel: str, thermometer: str | None, width: float) -> Points:
    rows: list[
        tuple[float, float, float, float, int, str]
    ] = []  # degC, value, samples, sum of squares, direction, label
    freedom, squares = 0.0, 0.0
    units = sorted({recorded.units[channel] for recorded in segments})
    if len(units) > 1:
        raise EstimationError(f"channel '{channel}' is recorded in different units ({', '.join(units)})")
    for recorded in segments:
        if thermometer is None:
            rows.append(_planned(recorded, channel))
            continue
        bins, direction = _binned(recorded, channel, thermometer, width)
        for count, celsius, mean, left in bins:
            rows.append((celsius, mean, count, left, direction, recorded.label))
            if count >= _LEAST_IN_BIN:
                freedom, squares = freedom + count - 2, squares + left
    if not rows:
        raise EstimationError(f"channel '{channel}' has no usable samples in the chosen segments")
    scatter = math.sqrt(squares / freedom) if freedom > 0 else math.nan
    temperature, value, size, spread = (np.array([row[k] for row in rows], dtype=float) for k in range(4))
    uncertainty: Array = spread if thermometer is None else scatter / np.sqrt(size)
    return Points(
        channel,
        units[0],
        temperature,
        value,
        uncertainty,
        np.array([row[4] for row in rows], dtype=np.int64),
        tuple(row[5] for row in rows),
    )


def _planned(recorded: RecordedSegment, channel: str) -> tuple[float, float, float, float, int, str]:
    """A segment's mean at its planned temperature, with its standard error in place of the sum of squares."""
    segment, statistics = recorded.segment, recorded.statistics
    if segment.temperature is None or segment.ramp_to is not None:
        raise EstimationError(
            f"segment '{recorded.label}' has no planned temperature: name the sensor's temperature channel in `temperature_channel`"
        )
    if not statistics.count:
        raise EstimationError(f"segment '{recorded.label}' has no usable samples: leave it out of `segments`")
    k = statistics.of(channel)
    own = float(statistics.standard_error[k])
    return segment.temperature - ZERO_CELSIUS, float(statistics.mean[k]), 1.0, own, 0, recorded.label


def _binned(
    recorded: RecordedSegment, channel: str, thermometer: str, width: float
) -> tuple[list[tuple[int, float, float, float]], int]:
    """(samples, mean degC, mean value, sum of squares about a straight line) of each bin, ascending; and the sense of the ramp."""
    try:
        scale = unit(recorded.units[thermometer])
    except UnknownUnitError as error:
        raise EstimationError(str(error)) from None
    if scale.dimension != DIMENSIONS["temperature"]:
        raise EstimationError(
            f"channel '{thermometer}' is recorded in {scale.text}, which is not a unit of temperature"
        )
    sums: dict[int, Array] = {}  # bin → n, ΣT, ΣT², Σy, Σy², ΣTy about the first sample
    first: tuple[float, float] | None = None
    last = 0.0
    for block in recorded.blocks([channel, thermometer]):
        celsius = block.channels[thermometer] * scale.factor + scale.offset - ZERO_CELSIUS
        value = block.channels[channel]
        good = np.isfinite(celsius) & np.isfinite(value)
        celsius, value = celsius[good], value[good]
        if not celsius.size:
            continue
        first = first or (float(celsius[0]), float(value[0]))
        last = float(celsius[-1])
        place = np.floor(celsius / width).astype(np.int64)
        t, y = celsius - first[0], value - first[1]
        for one in np.unique(place):
            at = place == one
            own = np.array([at.sum(), t[at].sum(), t[at] @ t[at], y[at].sum(), y[at] @ y[at], t[at] @ y[at]])
            sums[int(one)] = sums.get(int(one), np.zeros(6)) + own
    found = []
    for one in sorted(sums):
        n, t1, t2, y1, y2, ty = sums[one]
        assert first is not None
        tt, yy, cross = t2 - t1**2 / n, y2 - y1**2 / n, ty - t1 * y1 / n
        left = max(0.0, yy - (cross**2 / tt if tt > 0 else 0.0))
        found.append((int(n), first[0] + t1 / n, first[1] + y1 / n, float(left)))
    change = last - first[0] if first else 0.0
    return found, int(np.sign(change)) if abs(change) > width else 0
