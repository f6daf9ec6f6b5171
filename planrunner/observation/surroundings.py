"""Determines the surroundings of a sensor at each sample: its temperature, its supply voltage, and the ambient pressure.

The values come from recorded channels, whose noise is smoothed, or from the plan. Voltage and pressure are returned as differences
from their reference values.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.error_model.observed import REFERENCE_TEMPERATURE, STANDARD_PRESSURE, planned_excess
from planrunner.instruments.models import NOMINAL_SUPPLY
from planrunner.plan.units import ZERO_CELSIUS, unit

CHANGED = 1.0  # K, within a segment or between the means of consecutive segments: less counts as no change
_SMOOTHING = 10  # most coefficients of the polynomial that smooths the temperature of a segment
_WORTH = 12.0  # gain of twice the log likelihood per coefficient: 3.5 σ, which noise rarely reaches
_BLOCKS = 256  # means of the thermometer that the polynomial is fitted to
_EXACT = 1e-9  # K: less noise than this counts as none, and gives no uncertainty of a mean
_ALIKE = 0.01  # probability at and above which the temperatures of segments count as equal


@dataclass(frozen=True, slots=True)
class Temperature:
    """The temperature during one segment.

    `celsius`: array of shape (n,), temperature, degC. `rate`: array of shape (n,), rate of change of the temperature, K/s.
    `uncertainty`: standard uncertainty of a constant temperature due to the noise of the thermometer; NaN if the temperature
    changes or comes from the plan.
    """

    celsius: Array
    rate: Array
    uncertainty: float = math.nan


def temperature_of(item: RecordedSegment, time: Array, kelvin: Array | None) -> Temperature:
    """Returns the smoothed reading of the thermometer. If `kelvin` is None, returns the planned temperature. `time`: array of shape
    (n,), s. `kelvin`: array of shape (n,), readings of the thermometer, K."""
    if kelvin is None:
        planned = item.segment.begins_at
        celsius = REFERENCE_TEMPERATURE if planned is None else planned - ZERO_CELSIUS
        target = celsius if item.segment.ramp_to is None else item.segment.ramp_to - ZERO_CELSIUS
        span = max(float(time[-1] - time[0]), 1e-9)
        return Temperature(
            celsius + (target - celsius) * (time - time[0]) / span, np.full(len(time), (target - celsius) / span)
        )
    return smoothed(time, kelvin - ZERO_CELSIUS)


def smoothed(time: Array, values: Array) -> Temperature:
    """Fits a polynomial to the temperatures `values` (n,) of a segment, so that the noise of the thermometer does not influence
    effects of temperature. Returns the polynomial and its derivative at the samples. `time`: array of shape (n,), s.

    The number of coefficients is chosen so that twice the log likelihood, minus `_WORTH` for each coefficient, is largest. A
    constant temperature needs one coefficient; an approach to a setpoint needs several.
    """
    middle, half = (time[0] + time[-1]) / 2, max((time[-1] - time[0]) / 2, 1e-9)
    scaled = (time - middle) / half
    edges = np.linspace(0, len(time), min(len(time), _BLOCKS) + 1).astype(np.int64)[:-1]
    counts = np.diff(np.append(edges, len(time)))
    x, y = np.add.reduceat(scaled, edges) / counts, np.add.reduceat(values, edges) / counts
    level, n = float(y.mean()), len(x)
    basis, upper = np.linalg.qr(np.polynomial.chebyshev.chebvander(x, min(_SMOOTHING, n - 1) - 1))
    along = basis.T @ (y - level)
    left = np.maximum(np.sum((y - level) ** 2) - np.cumsum(along**2), 0.0) + 1e-300
    size = 1 + int(np.argmin(n * np.log(left) + _WORTH * np.arange(len(along))))
    if size == 1:
        own = float(values.mean())
        return Temperature(np.full(len(time), own), np.zeros(len(time)), float(np.sqrt(left[0] / (n - 1) / n)))
    series = np.polynomial.chebyshev.Chebyshev(np.linalg.solve(upper[:size, :size], along[:size]))
    return Temperature(level + series(scaled), series.deriv()(scaled) / half)


def settled(recording: Sequence[RecordedSegment], parts: Sequence[dict[str, Array]], known: Sequence[float]) -> None:
    """Replaces the temperatures of segments at a common constant setpoint by their mean, if the thermometer shows no significant
    difference between the segments (χ² test at a significance level of 1 %). `known`: standard uncertainty of the temperature of each
    segment, NaN if the temperature is not constant. `parts`: the samples of each segment, by name of the quantity. The temperatures in
    `parts` are changed in place."""
    from scipy.special import chdtrc

    setpoints = [item.segment.temperature if item.segment.ramp_to is None else None for item in recording]
    for setpoint in dict.fromkeys(setpoints):
        alike = [k for k, own in enumerate(setpoints) if own == setpoint and known[k] > _EXACT]
        if setpoint is None or len(alike) < 2:
            continue
        means, weights = (
            np.array([parts[k]["temperature"][0] for k in alike]),
            np.array([known[k] for k in alike]) ** -2,
        )
        mean = float(weights @ means / weights.sum())
        if chdtrc(len(alike) - 1, float(weights @ (means - mean) ** 2)) >= _ALIKE:
            for k in alike:
                parts[k]["temperature"][:] = mean


def changes(recording: Sequence[RecordedSegment], means: Sequence[float]) -> Array:
    """Returns the sign of the last change of temperature up to each segment, shape (S,). The sign comes from setpoints if they are
    planned, otherwise from mean temperatures."""
    signs, last, before = [], 0.0, None
    for item, mean in zip(recording, means, strict=True):
        now = item.segment.ramp_to if item.segment.ramp_to is not None else item.segment.temperature
        now = mean + ZERO_CELSIUS if now is None else now
        if before is not None and abs(now - before) > CHANGED:
            last = float(np.sign(now - before))
        before = now
        signs.append(last)
    return np.array(signs)


@dataclass(frozen=True, slots=True)
class Monitors:
    """Names the channels that record the surroundings of the sensor. A name is None if the values come from the plan.

    `thermometer`: channel with the temperature of the sensor. `voltmeter`: channel with the supply voltage of the sensor.
    `barometer`: channel with the ambient pressure. `nominal_supply`: nominal supply voltage, V.
    """

    thermometer: str | None = None
    voltmeter: str | None = None
    barometer: str | None = None
    nominal_supply: float = NOMINAL_SUPPLY

    @property
    def channels(self) -> list[str]:
        return [one for one in (self.thermometer, self.voltmeter, self.barometer) if one is not None]

    def excess_of(self, item: RecordedSegment, time: Array, table: Mapping[str, Array]) -> dict[str, Array]:
        """Returns the overvoltage [V] and the overpressure [Pa] at the n samples of a segment, each of shape (n,). The values are
        computed from smoothed recorded values if there are any. `time`: array of shape (n,), s. `table`: the values (n,) of each
        recorded channel, in its unit."""
        planned = planned_excess(item.segment, self.nominal_supply)
        found = {}
        for name, channel, reference, stated in (
            ("overvoltage", self.voltmeter, self.nominal_supply, planned[0]),
            ("overpressure", self.barometer, STANDARD_PRESSURE, planned[1]),
        ):
            if channel is None:
                found[name] = np.full(len(time), stated)
            else:
                own = unit(item.units[channel])
                found[name] = smoothed(time, table[channel] * own.factor + own.offset - reference).celsius
        return found
