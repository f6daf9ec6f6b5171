"""Finds segments in which an output drifts, while it does not drift in the other segments of an estimate.

Such a drift changes the mean of one segment. With few segments, a part of it appears in the coefficients and not in the residuals. A
drift during the whole test, which `drift_fit` looks for, has the same rate in all segments.

Each segment is divided into equal parts. The rate b of a segment is the slope of the straight line through the means of its parts, and
the scatter about this line gives its standard uncertainty u. The rate of a segment is compared with the weighted mean of the rates of
the other segments. If there are at least three other segments, the variance of the difference is multiplied by χ²/dof of their rates,
if this ratio is larger than one: noise that is correlated over the length of a segment, such as flicker, gives rates that scatter more
than the parts of a segment. The segment is named if a t-test finds that chance does not explain the difference.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Protocol, runtime_checkable

import numpy as np

from planrunner.archive.recording import FindKind, RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.estimators.transients import constant_input
from planrunner.instruments.models import OutputModel, SensorModel
from planrunner.observation.screening import varies
from planrunner.observation.surroundings import CHANGED
from planrunner.plan.units import METERED, measures, unit

_CHANCE = 1e-5
"""Probability that noise alone gives a warning about one output."""
_SCATTERING = 3  # other segments whose rates show the noise of a rate


@runtime_checkable
class FitsDrift(Protocol):
    """Keys of an estimator that fits the means of segments. `drift`: the drift functions that are fitted."""

    drift: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Rates:
    """Contains the rates of an output in n segments. `rate`: array of shape (n,), in the unit of the output per second. `sigma`: array
    of shape (n,), standard uncertainties of the rates, each with `freedom` degrees of freedom. `seconds`: array of shape (n,), lengths
    of the segments, s."""

    rate: Array
    sigma: Array
    seconds: Array
    freedom: int


def drift_within_words(
    segments: Sequence[RecordedSegment], channels: Collection[str], sensor: SensorModel
) -> tuple[Said, ...]:
    """Warns of each output that drifts within one segment and not in the others. `channels`: the channels to check; if empty, all
    outputs of the sensor. Only segments in which the input of the output is constant are used. Nothing is reported if a recorded
    temperature changes, because the rates then follow the temperature."""
    if sensor.stabilised or _temperature_changes(segments):
        return ()
    words = []
    for output in sensor.outputs:
        if not varies(output) or (channels and output.name not in channels) or unit(output.unit).dimension in METERED:
            continue
        having = [one for one in segments if output.name in one.parts and constant_input(one, output)]
        if len(having) < 2:
            continue
        rates = _rates(having, output)
        found = _different(rates)
        if found is None:
            continue
        row, difference, chance = found
        if any(one.kind is FindKind.STEP and one.channel == output.name for one in having[row].finds or ()):
            continue
        words.append(
            said(
                "{output}: the output drifts in segment '{segment}' in a way that the other segments do not show: by {size:.3g} {unit} "
                "from the beginning to the end (probability by chance: {chance:.2g}). The mean of this segment contains half of this "
                "change, and the coefficients contain a part of it. Check whether the sensor had settled and whether the mounting "
                "moved, and record this segment again.",
                output=output.name,
                segment=having[row].label,
                size=float(difference * rates.seconds[row]),
                unit=output.unit,
                chance=chance,
            )
        )
    return tuple(words)


def _temperature_changes(segments: Sequence[RecordedSegment]) -> bool:
    """Returns True if a recorded temperature changes between or within the segments."""
    names = {name for one in segments for name, text in one.units.items() if measures(text, "temperature")}
    for name in names:
        own = [one for one in segments if name in one.statistics.channels]
        scales = [unit(one.units[name]).factor for one in own]
        places = [one.statistics.of(name) for one in own]
        means = [f * one.statistics.mean[k] for f, one, k in zip(scales, own, places, strict=True)]
        spans = [
            f * math.sqrt(12 * one.statistics.covariance[k, k]) for f, one, k in zip(scales, own, places, strict=True)
        ]
        if max(float(np.ptp(means)), *spans) >= CHANGED:
            return True
    return False


def _rates(having: Sequence[RecordedSegment], output: OutputModel) -> _Rates:
    """Returns the rates of an output in segments. If the count is declared, the parts scatter at least as rounding makes them."""
    means = np.array([one.parts[output.name] for one in having])
    seconds = np.array([one.statistics.duration for one in having])
    samples = np.array([one.statistics.count for one in having]) / means.shape[1]
    place = np.arange(means.shape[1]) - (means.shape[1] - 1) / 2
    square = float(place @ place)
    slopes = means @ place / square
    left = means - means.mean(axis=1, keepdims=True) - slopes[:, None] * place
    freedom = means.shape[1] - 2
    variance = np.sum(left**2, axis=1) / freedom
    variance = np.maximum(variance, output.noise.rounding(samples, variance * samples))
    part = seconds / means.shape[1]
    return _Rates(slopes / part, np.sqrt(variance / square) / part, seconds, freedom)


def _different(rates: _Rates) -> tuple[int, float, float] | None:
    """Returns the row of the segment whose rate differs most from the others, the difference, and the probability that chance gives
    such a difference in any of the segments; None if chance explains it."""
    from scipy.special import stdtr

    n = len(rates.rate)
    if not (rates.sigma > 0).all():
        return None
    best: tuple[int, float, float] | None = None
    for row in range(n):
        others = np.arange(n) != row
        weights = 1 / rates.sigma[others] ** 2
        mean = float(rates.rate[others] @ weights / weights.sum())
        scatter = float((rates.rate[others] - mean) ** 2 @ weights) / max(n - 2, 1)
        known = n - 1 >= _SCATTERING
        factor = max(1.0, scatter) if known else 1.0
        freedom = min(n - 2, rates.freedom) if known and scatter > 1 else rates.freedom
        difference = float(rates.rate[row]) - mean
        deviation = math.sqrt(factor * (float(rates.sigma[row]) ** 2 + 1 / float(weights.sum())))
        chance = min(1.0, 2 * n * float(stdtr(freedom, -abs(difference) / deviation)))
        if chance < _CHANCE and (best is None or chance < best[2]):
            best = (row, difference, chance)
    if best is not None and n == 2:  # the two differences are equal: the segment with the larger rate drifts
        row = int(np.argmax(np.abs(rates.rate)))
        return row, float(rates.rate[row] - rates.rate[1 - row]), best[2]
    return best
