"""Finds the count of a thermometer, and describes the errors of its readings that follow from this count.

The readings of a thermometer are often whole multiples of a count, such as 1 K. Two errors follow:

- It is not known whether the thermometer rounds its readings or cuts off the remainder. Readings that are cut off are too small by
  half a count q on average, and no reading shows this error. It is the same in all segments. If both cases have the probability ½,
  the mean square of the error is ½·(q/2)². The distribution with this variance and the half-width q/2 is U-shaped (JCGM 101:2008,
  6.4.6). If the bench file declares the resolution of the thermometer, the readings count as rounded, and there is no such error.
- If the noise of the thermometer is too small to move its readings to the next count, the mean of a segment has the rounding error
  of a single reading. Segments have the same error if they have the same reading at the same planned temperature, or, without
  planned temperatures, if they have the same reading and follow each other. The distribution of this error is rectangular, with the
  half-width q/2 (JCGM 100:2008, F.2.2.1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.interface import Estimate
from planrunner.instruments.models import NoiseModel, SensorModel
from planrunner.observation.lattice import MANY, differ, undeclared_step
from planrunner.plan.units import ZERO_CELSIUS, unit
from planrunner.uncertainty.influences import InputQuantity

_SHOWN = 5
"""Different readings from which the count of a thermometer is found if its reading never changes within a segment. A fine
thermometer reads at least one value between two such counts with a probability of 1 − 2⁻⁴."""
_COARSEST = 5.0
"""Largest count, K, that is found from readings that never change within a segment. The setpoints of a test are multiples of a
larger number."""
_PLANNED = 1e-6
"""Difference, K, up to which a reading is equal to the planned temperature. Such readings are not measurements."""
_READINGS = "readings of the thermometer"
_LARGE = 0.5
"""Share of the variance of a coefficient from which a warning names the counts."""


@dataclass(frozen=True, slots=True)
class ThermometerCounts:
    """Describes the count of a thermometer.

    `count`: size of one count, K. `declared`: True if the bench file states the count. `groups`: array of shape (n, r), 1 if a
    segment has the r-th rounding error, otherwise 0. `parts`: names of the r rounding errors.
    """

    channel: str
    count: float
    declared: bool
    groups: Array
    parts: tuple[str, ...]

    @property
    def offset(self) -> InputQuantity | None:
        """Returns the error that all readings have in common; None if the readings are known to be rounded."""
        if self.declared:
            return None
        name = f"rounded or cut-off readings {self.channel}"
        return InputQuantity(name, 0.0, "K", self.count / math.sqrt(8), distribution="u-shaped", source=_READINGS)

    @property
    def rounding(self) -> InputQuantity:
        """Returns the rounding error of one reading."""
        source = "bench file" if self.declared else _READINGS
        u = self.count / math.sqrt(12)
        return InputQuantity(f"counts {self.channel}", 0.0, "K", u, distribution="rectangular", source=source)


def thermometer_counts(
    segments: Sequence[RecordedSegment], channel: str | None, sensor: SensorModel
) -> ThermometerCounts | None:
    """Returns the count of a thermometer. The result is None if there is no thermometer, or if its readings show no count."""
    if channel is None or not segments or any(one.expected or channel not in one.units for one in segments):
        return None
    scale, output = unit(segments[0].units[channel]), sensor.output(channel)
    declared = 0.0 if output is None else output.noise.resolution * scale.factor
    count = declared or _found(segments, channel) * scale.factor
    if not count:
        return None
    held: dict[tuple[int, float], list[int]] = {}
    shown: dict[int, float] = {}
    first, last, run = math.nan, None, 0
    for row in np.argsort([one.statistics.start for one in segments], kind="stable").tolist():
        one = segments[row]
        place = one.statistics.of(channel)
        if NoiseModel(resolution=count).dithers(float(one.statistics.covariance[place, place]) * scale.factor**2):
            continue
        if math.isnan(first):
            first = float(one.statistics.minimum[place])
        counts = round((float(one.statistics.mean[place]) - first) * scale.factor / count)  # from the first reading
        shown[counts] = round(first * scale.factor + counts * count + scale.offset - ZERO_CELSIUS, 6) + 0.0
        run, last = run + (counts != last), counts
        planned = one.segment.temperature
        held.setdefault((counts, -run if planned is None else planned), []).append(row)
    groups = np.zeros((len(segments), len(held)))
    for column, rows in enumerate(held.values()):
        groups[rows, column] = 1.0
    parts = tuple(f"{shown[counts]:.6g} degC in '{segments[rows[0]].label}'" for (counts, _), rows in held.items())
    return ThermometerCounts(channel, count, bool(declared), groups, parts)


def _found(segments: Sequence[RecordedSegment], channel: str) -> float:
    """Returns the count that the readings show, in the unit of the channel; 0 if they show none."""
    shown = [(one, one.readings_of[channel]) for one in segments if channel in one.readings_of]
    if not shown:
        return 0.0
    values = np.concatenate([readings.values for _, readings in shown])
    moves = any(_moves(one, channel) for one, _ in shown)
    if not moves and all(_copied(one, channel) for one, _ in shown):
        return 0.0
    total = sum(one.statistics.count for one, _ in shown)
    share = sum(readings.share * one.statistics.count for one, readings in shown) / max(total, 1)
    count = undeclared_step(values, MANY if moves else _SHOWN, share)
    largest = _COARSEST / unit(segments[0].units[channel]).factor
    return count if moves or count <= largest else 0.0


def _moves(one: RecordedSegment, channel: str) -> bool:
    place = one.statistics.of(channel)
    return differ(float(one.statistics.minimum[place]), float(one.statistics.maximum[place]))


def _copied(one: RecordedSegment, channel: str) -> bool:
    """Returns True if the readings of a segment are equal to its planned temperature."""
    scale, planned = unit(one.units[channel]), one.segment.temperature
    kelvin = float(one.statistics.mean[one.statistics.of(channel)]) * scale.factor + scale.offset
    return planned is not None and abs(kelvin - planned) <= _PLANNED


def thermometer_count_words(estimate: Estimate, counts: ThermometerCounts | None) -> tuple[Said, ...]:
    """Warns of a thermometer whose counts cause most of the uncertainty of a coefficient. `estimate`: an estimate with budgets."""
    if counts is None:
        return ()
    causes = {one.name for one in (counts.offset, counts.rounding) if one is not None}
    worst, largest = "", _LARGE
    for budget in estimate.budgets:
        own = sum(line.contribution**2 for line in budget.lines if line.added and line.quantity in causes)
        share = own / budget.standard_uncertainty**2 if budget.standard_uncertainty > 0 else 0.0
        if share > largest:
            worst, largest = budget.coefficient, share
    if not worst:
        return ()
    return (
        said(
            "{channel}: all readings are multiples of {count:.3g} K. The recording does not show whether the thermometer rounds its "
            "readings or cuts off the remainder, so all temperatures may be wrong by {half:.3g} K. This causes {share:.0f} % of the "
            "variance of {coefficient}. Record the temperature with finer counts. If the thermometer rounds its readings, declare "
            "`resolution` for this channel in the bench file.",
            channel=counts.channel,
            count=counts.count,
            half=counts.count / 2,
            share=100 * largest,
            coefficient=worst,
        )
        if counts.offset is not None
        else said(
            "{channel}: the counts of {count:.3g} K are too coarse for the noise of the thermometer, so rounding errors do not average "
            "out. They cause {share:.0f} % of the variance of {coefficient}. Record the temperature with finer counts.",
            channel=counts.channel,
            count=counts.count,
            share=100 * largest,
            coefficient=worst,
        ),
    )
