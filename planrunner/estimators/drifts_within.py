"""Finds segments in which an output drifts, while it does not drift in the other segments of an estimate.

Such a drift changes the mean of one segment. With few segments, a part of it appears in the coefficients and not in the residuals. A
drift during the whole test, which `drift_fit` looks for, has the same rate in all segments.

Each segment is divided into equal parts. The rate b of a segment is the slope of the straight line through the means of its parts, and
the scatter about this line gives its standard uncertainty u. This scatter is described as white noise and a random walk. The ratio of
the two densities is the same in all segments. The variances are averaged over this ratio, weighted by the likelihood of the scatter in
all segments, with the lines eliminated (restricted likelihood: H. D. Patterson and R. Thompson, Biometrika 58, 1971). The most likely
ratio alone is sometimes zero by chance. White noise alone would give rates with much too small uncertainties, if the noise is
correlated over the length of a segment.

The rate of a segment is compared with the weighted mean of the rates of the other segments. If there are at least three other segments,
the variance of the difference is multiplied by χ²/dof of their rates, if this ratio is larger than one. The segment is named if a t-test
finds that chance does not explain the difference.
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
"""Probability that white noise alone gives a warning about one output. In simulations, a random walk with white noise of any size
gives a warning in at most 0.5 % of the estimates, and flicker in at most 0.1 %."""
_SCATTERING = 3  # other segments whose rates show the noise of a rate
_RATIOS = np.concatenate([[0.0], np.logspace(-4, 5, 73)])
"""Variance of a random walk over one part, divided by the variance of the white noise of a part. Before the measurement, all of these
ratios are equally probable."""


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
    segments: Sequence[RecordedSegment], channels: Collection[str], sensor: SensorModel, thermometer: str | None = None
) -> tuple[Said, ...]:
    """Warns of each output that drifts within one segment and not in the others. `channels`: the channels to check; if empty, all
    outputs of the sensor. Only segments in which the input of the output is constant are used. Nothing is reported if a recorded
    temperature changes, because the rates then follow the temperature. `thermometer`: the thermometer that the plan names, or None."""
    if sensor.stabilised or _temperature_changes(segments, sensor, thermometer):
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


def _temperature_changes(segments: Sequence[RecordedSegment], sensor: SensorModel, thermometer: str | None) -> bool:
    """Returns True if a recorded temperature of the sensor changes between or within the segments. The temperature is the one that the
    plan names (`thermometer`); if it names none, the sensor's own temperatures; if the sensor has none, all recorded temperatures. The
    changes are those of means, so that the noise of a thermometer does not count."""
    names = {name for one in segments for name, text in one.units.items() if measures(text, "temperature")}
    own = {one.name for one in sensor.outputs} & names
    named = {thermometer} & names if thermometer is not None else set()
    for name in named or own or names:
        having = [one for one in segments if name in one.statistics.channels]
        means = [unit(one.units[name]).factor * one.statistics.mean[one.statistics.of(name)] for one in having]
        ends = [
            unit(one.units[name]).factor * abs(one.readings_of[name].last - one.readings_of[name].first)
            for one in having
            if name in one.readings_of
        ]
        if max([float(np.ptp(means)) if means else 0.0, *ends]) >= CHANGED:
            return True
    return False


def _rates(having: Sequence[RecordedSegment], output: OutputModel) -> _Rates:
    """Returns the rates of an output in segments. If the count is declared, the parts scatter at least as rounding makes them."""
    means = np.array([one.parts[output.name] for one in having])
    seconds = np.array([one.statistics.duration for one in having])
    count = means.shape[1]
    samples = np.array([one.statistics.count for one in having]) / count
    place = np.arange(count) - (count - 1) / 2
    square = float(place @ place)
    part = seconds / count
    white, walk = _noise(means, part)
    white = np.maximum(white, output.noise.rounding(samples, white * samples))
    variance = white / square + walk * float(place @ _random_walk(count) @ place) / square**2
    return _Rates(means @ place / square / part, np.sqrt(variance) / part, seconds, count - 2)


def _noise(means: Array, part: Array) -> tuple[Array, Array]:
    """Returns the variance of the white noise of a part, and the variance of the random walk over one part, each of shape (n,).
    `means`: array of shape (n, k), means of k parts of n segments. `part`: array of shape (n,), lengths of a part, s."""
    count = means.shape[1]
    lines = np.column_stack([np.ones(count), np.arange(count)])
    free = np.linalg.qr(lines, mode="complete")[0][:, 2:]
    sizes, turned = np.linalg.eigh(free.T @ _random_walk(count) @ free)
    squares = ((means - means.mean(axis=1, keepdims=True)) @ free @ turned) ** 2
    # With white noise of density N² and a walk of density K², this ratio is K²·τ²/N² for parts of τ seconds.
    ratios = _RATIOS[:, None] * (part / part.max()) ** 2
    spread = 1 + ratios[..., None] * sizes
    white = np.mean(squares / spread, axis=2)
    deviance = (count - 2) * np.log(np.maximum(white, np.finfo(float).tiny)).sum(axis=1) + np.log(spread).sum(
        axis=(1, 2)
    )
    weight = np.exp((deviance.min() - deviance) / 2)
    weight /= weight.sum()
    return weight @ white, weight @ (white * ratios)


def _random_walk(count: int) -> Array:
    """Returns the covariance of the means of `count` equal parts of a random walk whose variance grows by one in each part."""
    place = np.arange(count)
    return np.asarray(np.minimum.outer(place, place) + 0.5 - np.eye(count) / 6)


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
