"""Computes observations: the means of channels over segments, with uncertainties from the scatter within the segments."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.archive.statistics import statistics_of
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.findings import closest
from planrunner.instruments.interfaces import Block
from planrunner.instruments.models import NoiseModel, SensorModel
from planrunner.observation.refusals import EstimationError, UnfitDataError
from planrunner.plan.schedule import Rest, Spin

_LEAST = 0.01  # smallest fraction of the scatter within a segment that counts as white noise
_FEW = 20  # degrees of freedom up to which the correlation of means is poorly known
_BELOW = 1 - 1e-12  # factor on correlations, because the transform of ±1 is infinite
SIGNIFICANCE = 0.01  # level of the tests for weights, for the two bases of uncertainty, and for scatter and outliers


@dataclass(frozen=True, slots=True)
class Observations:
    """Contains the means of k channels over n segments, in the channels' units.

    `mean`: array of shape (n, k), the means. `standard_error`: array of shape (n, k), standard error of each mean, estimated from
    the scatter within its segment; NaN if the segment is too short. `batches`: array of shape (n,), number of batches from which
    the standard errors of a segment are estimated. `start`, `end`: arrays of shape (n,), start and end of the recorded intervals, s
    on the run's clock; the end does not belong to the interval. `correlation`: array of shape (k, k), correlation between the noise
    of the channels, determined from all segments. `expected`: True if the observations are predicted from a schedule; in this case,
    the means contain no noise, and the standard errors follow from the declared noise. `share`: array of shape (n,), fraction of
    the samples of each segment that are used; None if all are used. `courses`: for each of the n segments, the functions of its
    motion that are fitted together with its mean (`Statistics.course`); None without motion. `within`: number of observations at
    the end that are not means but contrasts within segments. The standard errors of the contrasts are known. `moving`: True if
    the motion of a segment changes the outputs, so that their scatter within the segment is not only noise.
    """

    channels: tuple[str, ...]
    units: tuple[str, ...]
    labels: tuple[str, ...]
    mean: Array
    standard_error: Array
    batches: NDArray[np.int64]
    start: Array
    end: Array
    correlation: Array
    expected: bool = False
    share: Array | None = None
    courses: tuple[Array, ...] | None = None
    within: int = 0
    moving: bool = False

    @property
    def of_means(self) -> Observations:
        """Returns the observations without the contrasts within segments."""
        if not self.within:
            return self
        n = len(self.labels) - self.within
        return replace(
            self,
            labels=self.labels[:n],
            mean=self.mean[:n],
            standard_error=self.standard_error[:n],
            batches=self.batches[:n],
            start=self.start[:n],
            end=self.end[:n],
            share=None if self.share is None else self.share[:n],
            courses=None if self.courses is None else self.courses[:n],
            within=0,
        )

    @property
    def freedom(self) -> Array:
        """Returns the degrees of freedom (n,) of the standard errors; 0 for a standard error that is unknown."""
        taken = 0.0 if self.courses is None else np.array([np.sum(course**2) for course in self.courses])
        return np.asarray(np.maximum(self.batches - 1 - taken, 0.0))

    @property
    def seconds(self) -> Array:
        """Returns the recorded time [s] that is used in each segment, shape (n,)."""
        lasted: Array = self.end - self.start
        return lasted if self.share is None else lasted * self.share


class Weighting(StrEnum):
    """States which noise determines the weights of a channel's segments. The values of this enumeration are the texts in
    reports."""

    DECLARED = "declared noise"
    EQUAL = "equal"
    POOLED = "one noise level for all segments"
    INDIVIDUAL = "the noise level of each segment"


@dataclass(frozen=True, slots=True)
class WithinSegmentNoise:
    """Contains the standard uncertainty of the means of one channel due to the noise within segments.

    `sigma`: array of shape (n,), standard uncertainties, all positive. `known`: False if the samples give no information about the
    noise; all elements of `sigma` are then 1. `degrees_of_freedom`: degrees of freedom of `sigma`, over all segments together.
    """

    sigma: Array
    known: bool
    weighting: Weighting
    degrees_of_freedom: float

    @property
    def unequal(self) -> bool:
        """Returns True if the weights of the segments differ by more than the jitter of recorded times explains."""
        return bool(self.sigma.max() > 1.05 * self.sigma.min())


def weights_of(channels: Sequence[str], noises: Sequence[WithinSegmentNoise]) -> dict[str, str]:
    """Returns, for each channel, a text that describes its weights. An estimate reports these texts among its settings."""
    return {name: noise.weighting.value for name, noise in zip(channels, noises, strict=True)}


def observe(segments: Sequence[RecordedSegment], channels: Sequence[str], sensor: SensorModel) -> Observations:
    """Makes the observations of the named channels. Raises `EstimationError` if a channel is missing, changes its unit, or has no
    usable samples."""
    if not segments:
        raise EstimationError("no recorded segments are chosen: check the labels in `segments`")
    places: dict[tuple[str, ...], list[int]] = {}
    rows: dict[tuple[str, ...], list[int]] = {}
    for row, recorded in enumerate(segments):
        statistics = recorded.statistics
        if statistics.channels not in places:
            missing = [channel for channel in channels if channel not in statistics.channels]
            if missing:
                close = closest(missing[0], statistics.channels)
                raise EstimationError(f"segment '{recorded.label}' has no channel '{missing[0]}': {close}")
            places[statistics.channels] = [statistics.of(channel) for channel in channels]
        rows.setdefault(statistics.channels, []).append(row)
        if statistics.count == 0:
            raise UnfitDataError(
                f"segment '{recorded.label}' has no usable samples: leave it out of `segments` or record it again"
            )
    n, k = len(segments), len(channels)
    mean, error, covariance = np.empty((n, k)), np.empty((n, k)), np.empty((n, k, k))
    for held, at in rows.items():
        index, own = places[held], [segments[row].statistics for row in at]
        mean[at] = np.array([statistics.mean for statistics in own])[:, index]
        error[at] = np.array([statistics.standard_error for statistics in own])[:, index]
        covariance[at] = np.array([statistics.covariance for statistics in own])[:, index][:, :, index]
    freedom = np.array([recorded.statistics.count - 1 for recorded in segments])
    covariance[freedom == 0] = 0.0
    variances = covariance.diagonal(axis1=1, axis2=2)
    rounding = np.array([_rounding(sensor, channel, variances[:, k]) for k, channel in enumerate(channels)]).T
    told = np.array([recorded.statistics.batches > 1 or recorded.expected for recorded in segments])
    error = np.where(told[:, None], np.hypot(error, rounding), np.nan)
    samples = _correlation(np.einsum("nij,n->ij", np.where(np.isnan(covariance), 0.0, covariance), freedom))
    return Observations(
        tuple(channels),
        tuple(_unit(segments, channel) for channel in channels),
        tuple(recorded.label for recorded in segments),
        mean,
        error,
        np.array([recorded.statistics.batches for recorded in segments]),
        *recorded_times(segments),
        _correlation_of_means(samples, segments, channels),
        all(recorded.expected for recorded in segments),
        np.array([recorded.share for recorded in segments]),
        tuple(recorded.statistics.course for recorded in segments),
        moving=not all(isinstance(recorded.segment.motion, Rest | Spin) for recorded in segments),
    )


def about_course(recorded: RecordedSegment, channel: str, course: Callable[[Array], Array]) -> float:
    """Computes the standard error of a channel's mean over a segment from the scatter of the samples about a known function of
    time. The samples are read again for this purpose. If only published statistics are available instead of samples, the standard
    error comes from these statistics. `course`: returns this function at times (k,), s since the start of the segment, in the unit
    of the channel."""
    whole = recorded.statistics
    if recorded.summary:
        return float(whole.standard_error[whole.of(channel)])

    def left() -> Iterator[Block]:
        for block in recorded.blocks((channel,)):
            yield Block(block.time, {channel: block.channels[channel] - course(block.time - whole.start)})

    found = statistics_of(left(), (channel,), whole.count + whole.rejected, motion=recorded.segment.motion)
    known = found if found.batches > 1 else whole
    return float(known.standard_error[known.of(channel)])


def _correlation(scatter: Array) -> Array:
    """Returns the correlation (k, k) of k channels. `scatter`: array of shape (k, k), sums of products of the channels'
    deviations."""
    size = np.sqrt(scatter.diagonal())
    sizes = size[:, None] * size
    correlation = np.where(sizes > 0, scatter / np.where(sizes > 0, sizes, 1.0), 0.0)
    np.fill_diagonal(correlation, 1.0)
    return np.asarray(correlation)


def _correlation_of_means(samples: Array, segments: Sequence[RecordedSegment], channels: Sequence[str]) -> Array:
    """Returns the correlation between the means of the channels, shape (k, k). By default, this is the correlation of the samples,
    which is known best. The correlation of the batch means is returned instead if it differs significantly from the correlation of
    the samples (Fisher's z, with Bonferroni's bound over the pairs). The two correlations differ if the samples of several channels
    have a common part that averages out, such as a vibration.

    Fisher's transform of a correlation coefficient r with ν degrees of freedom has the variance 1/(ν − 2) (Fisher, Metron 1, 1921)."""
    k, scatter, freedom = len(channels), np.zeros((len(channels),) * 2), 0.0
    for own in (recorded.statistics for recorded in segments):
        if own.freedom > 0 and len(own.mean_covariance):
            at = [own.of(channel) for channel in channels]
            scatter += own.freedom * own.count * own.mean_covariance[np.ix_(at, at)]
            freedom += own.freedom
    if k < 2 or freedom <= _FEW or not np.isfinite(scatter).all() or not (scatter.diagonal() > 0).all():
        return samples
    from scipy.special import ndtri

    means, (i, j) = _correlation(scatter), np.triu_indices(k, 1)
    apart = np.abs(np.arctanh(means[i, j] * _BELOW) - np.arctanh(samples[i, j] * _BELOW)) * math.sqrt(freedom - 2)
    return means if apart.max() > -ndtri(SIGNIFICANCE / 2 / len(i)) else samples


def recorded_times(segments: Sequence[RecordedSegment]) -> tuple[Array, Array]:
    """Returns the start and end times [s] of the n recorded segments as two arrays (n,). If segments overlap, their recorded times
    do not come from the same clock; in this case, the planned start times are used."""
    start = np.array([recorded.statistics.start for recorded in segments])
    length = np.array([max(recorded.statistics.duration, 1e-9) for recorded in segments])
    order = np.argsort(start)
    half = length / np.array([2 * max(recorded.statistics.count, 1) for recorded in segments])
    if np.any(start[order][1:] < (start + length - half)[order][:-1]):
        start = np.array([recorded.segment.start for recorded in segments])
    return start, start + length


def within_segment_noise(
    observations: Observations, channel: int, explained: Array | float = 0.0
) -> WithinSegmentNoise:
    """Determines the noise of the means of one channel, for weights and for uncertainties.

    The variance of each mean is multiplied by the recorded time of its segment, and the product is pooled over the segments. If
    Bartlett's test (Snedecor and Cochran, Statistical Methods, 13.10) finds that the product differs between the segments, each
    segment keeps its own value. For equal noise, the weights therefore depend only on the recorded time, and not on chance
    differences between short segments. `channel`: index of the channel. `explained`: array of shape (n,), part of the variance of
    the means that has another known cause; this part is subtracted.
    """
    error = observations.standard_error[:, channel]
    if observations.expected:
        return WithinSegmentNoise(error, True, Weighting.DECLARED, math.inf)
    if observations.within:
        shares = explained if isinstance(explained, float) else explained[: len(error) - observations.within]
        means = within_segment_noise(observations.of_means, channel, shares)
        return replace(means, sigma=np.concatenate([means.sigma, error[len(means.sigma) :]]))
    plain = pooled_noise(error, observations.seconds, observations.freedom)
    return replace(plain, sigma=_left(plain.sigma**2, explained)) if plain.known else plain


def pooled_noise(error: Array, seconds: Array, freedom: Array) -> WithinSegmentNoise:
    """Determines the noise of n means. The noise is pooled as in `within_segment_noise`.

    `error`: array of shape (n,), standard errors. `seconds`: array of shape (n,), recorded times, s. `freedom`: array of shape
    (n,), degrees of freedom of the standard errors.
    """
    degrees = np.where(np.isfinite(error), freedom, 0.0)
    usable = (degrees > 0) & (error > 0)
    n = len(error)
    if not usable.any():
        return WithinSegmentNoise(np.ones(n), False, Weighting.EQUAL, 0.0)
    spread = error**2 * seconds
    pooled = float(np.sum(degrees[usable] * spread[usable]) / np.sum(degrees[usable]))
    if usable.all() and n > 1 and variances_differ(spread, degrees, pooled):
        own = float(np.sum(error**2) ** 2 / np.sum(error**4 / degrees))
        return WithinSegmentNoise(error, True, Weighting.INDIVIDUAL, own)
    return WithinSegmentNoise(np.sqrt(pooled / seconds), True, Weighting.POOLED, float(np.sum(degrees[usable])))


def _left(variance: Array, explained: Array | float) -> Array:
    """Returns the standard uncertainties (n,) after the explained part of the variance has been subtracted. The results are at
    least one hundredth of the standard uncertainties before the subtraction."""
    return np.sqrt(np.maximum(variance - explained, _LEAST**2 * variance))


def variances_differ(variances: Array, degrees: Array, pooled: float) -> bool:
    """Returns True if Bartlett's test finds that g variances differ from each other. `variances`: array of shape (g,), positive.
    `degrees`: array of shape (g,), their degrees of freedom. `pooled`: the pooled variance."""
    from scipy.special import chdtrc

    total, groups = float(degrees.sum()), len(degrees)
    correction = 1 + (np.sum(1 / degrees) - 1 / total) / (3 * (groups - 1))
    statistic = (total * np.log(pooled) - np.sum(degrees * np.log(variances))) / correction
    return bool(chdtrc(groups - 1, statistic) < SIGNIFICANCE)


def dithered(sensor: SensorModel, channel: str, variance: float | Array) -> NDArray[np.bool_]:
    """Returns True for each variance with which the rounding to counts averages out in the mean of the channel
    (`NoiseModel.dithers`). `variance`: variance of the samples, in the channel's squared unit."""
    return _noise(sensor, channel).dithers(variance)


def _noise(sensor: SensorModel, channel: str) -> NoiseModel:
    return output.noise if (output := sensor.output(channel)) else NoiseModel()


def _rounding(sensor: SensorModel, channel: str, variances: Array) -> Array:
    """Returns the contribution (n,) of rounding to the uncertainty of each mean: resolution/√12 if the noise is too small to dither
    the rounding, otherwise zero. `variances`: array of shape (n,), variances of the samples in each segment."""
    noise = _noise(sensor, channel)
    return np.where(noise.dithers(variances), 0.0, noise.resolution / math.sqrt(12))


def _unit(segments: Sequence[RecordedSegment], channel: str) -> str:
    units = sorted({recorded.units[channel] for recorded in segments})
    if len(units) > 1:
        raise EstimationError(
            f"channel '{channel}' is recorded in different units ({', '.join(units)}): use segments of one kind"
        )
    return units[0]
