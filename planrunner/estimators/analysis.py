"""Computes the results of a recording: first every estimate of the plan, in the order that `uses` requires, then the limits.

If one estimate fails, the results contain a message about the failure, and the other estimates are still made.

Each estimate also gets three kinds of warnings: about missing samples; about counts that are so coarse compared with the noise
that rounding errors do not average out; and about a thermometer whose readings contradict the plan.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.reading_progress import announced
from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.findings import InputError
from planrunner.base.processes import ClusterError, ProcessEndedError
from planrunner.base.progress import Announce
from planrunner.base.said import Said, said
from planrunner.base.workers import ALONE, Workers
from planrunner.estimators.declared_temperatures import NamesThermometer, thermometer_words
from planrunner.estimators.drifts_within import FitsDrift, drift_within_words
from planrunner.estimators.foresight import detection_of, patterns_of
from planrunner.estimators.interface import (
    Estimate,
    EstimateRequest,
    EstimationError,
    Setup,
    UnfitDataError,
    estimator_of,
)
from planrunner.estimators.limits import LimitVerdict, hold
from planrunner.estimators.monte_carlo_validation import Chains, linear_chain, validated
from planrunner.estimators.open_flicker import with_flicker_words
from planrunner.estimators.repeated_estimates import with_scatter_words
from planrunner.estimators.results import Results, segment_statistics
from planrunner.estimators.screened_estimate import estimated
from planrunner.estimators.thermometer_counts import thermometer_count_words, thermometer_counts
from planrunner.estimators.transients import transient_words
from planrunner.instruments.models import NoiseModel, OutputModel, SensorModel
from planrunner.observation.lattice import differ, undeclared_step, unevenness
from planrunner.observation.screening import screened, varies
from planrunner.physics.earth import Site
from planrunner.plan.kinds import Record
from planrunner.plan.meaning import channels_of
from planrunner.plan.model import USUAL, EstimateSpec, Limit, MonteCarloSpec
from planrunner.plan.schedule import RecordedMotion, Rest, Spin
from planrunner.plan.selection import select
from planrunner.plan.units import METERED, unit
from planrunner.uncertainty.budget import Measured, combine


def analyse(
    estimates: Mapping[str, EstimateSpec],
    limits: Sequence[Limit],
    recording: Sequence[RecordedSegment],
    site: Site,
    sensor: SensorModel,
    setup: Setup | None = None,
    notice: Announce | None = None,
    workers: Workers = ALONE,
) -> Results:
    """Makes all estimates of a plan and applies its limits. `notice`: a function that is called with the progress while samples are
    read. `workers`: processes that share the Monte Carlo draws.

    Failures that the data cause do not raise an exception. Such a failure becomes a message under the name of the estimate, or
    under `limit on …`. Raises `ClusterError` or `ProcessEndedError` if the workers fail.
    """
    looked_at = screened(announced(recording, "screening the samples", notice), sensor)
    recording = [
        replace(item, finds=one.finds, repeats=one.repeats, parts=one.parts, readings_of=one.readings_of)
        for item, one in zip(recording, looked_at, strict=True)
    ]
    made: dict[str, Estimate] = {}
    failures: dict[str, str] = {}
    unfit: list[str] = []
    for name in _in_order(estimates):
        spec = estimates[name]
        try:
            made[name] = _estimate(
                name, spec, recording, site, sensor, made, estimates, setup or Setup(), notice, workers
            )
        except (ClusterError, ProcessEndedError):
            raise
        except EstimationError as error:
            failures[name] = str(error)
            missing = [used for used in spec.uses if used not in made]
            if isinstance(error, UnfitDataError) or (missing and all(used in unfit for used in missing)):
                unfit.append(name)
        except InputError as error:
            failures[name] = "; ".join(finding.message for finding in error.findings)
        except MemoryError:
            failures[name] = (
                f"the memory is too small for an estimate of the recorded segments ({len(recording)}): an estimate of n segments needs "
                "about 50·n² bytes; use fewer segments for each estimate (key `segments`)"
            )
        except Exception as error:  # an estimator may come from anywhere
            failures[name] = (
                f"the estimator '{spec.estimator}' failed unexpectedly ({type(error).__name__}: {error}); report "
                "this to its author"
            )
    made = with_scatter_words(made, estimates, recording)
    verdicts: list[LimitVerdict] = []
    for limit in limits:
        try:
            verdicts.append(hold(limit, made))
        except EstimationError as error:
            of_limit = f"limit on {limit.quantity}"
            failures[of_limit] = str(error)
            if limit.quantity.partition(".")[0] in unfit:
                unfit.append(of_limit)
    written = {name: made[name] for name in estimates if name in made}
    statistics = tuple(segment_statistics(recorded) for recorded in recording)
    return Results(written, tuple(verdicts), failures, statistics, unfit=tuple(unfit))


def _in_order(estimates: Mapping[str, EstimateSpec]) -> list[str]:
    """Returns the names of the estimates, ordered so that every estimate comes after the estimates that it uses. Estimates that use
    each other in a circle come last. These estimates fail later, because their inputs are missing."""
    order: list[str] = []
    waiting = list(estimates)
    while waiting:
        ready = [
            name for name in waiting if all(used in order or used not in estimates for used in estimates[name].uses)
        ]
        if not ready:
            return order + waiting
        order += ready
        waiting = [name for name in waiting if name not in ready]
    return order


def _estimate(
    name: str,
    spec: EstimateSpec,
    recording: Sequence[RecordedSegment],
    site: Site,
    sensor: SensorModel,
    made: Mapping[str, Estimate],
    estimates: Mapping[str, EstimateSpec],
    setup: Setup,
    notice: Announce | None,
    workers: Workers,
) -> Estimate:
    for other in spec.uses:
        if other not in made:
            why = "could not be made" if other in estimates else "is not in the plan"
            raise EstimationError(f"it uses the estimate '{other}', which {why}")
    labels = [recorded.label for recorded in recording]
    chosen = tuple(recording[index] for index in select(labels, patterns_of(spec)))
    if not chosen:
        raise EstimationError(f"no recorded segment has a label that matches {', '.join(patterns_of(spec))}")
    used = _used_outputs(spec.parameters, sensor)
    chosen = announced(_relevant(chosen, used, sensor), f"estimating '{name}'", notice)
    estimator = estimator_of(spec)
    detection = detection_of(spec, estimator)
    uses = {other: made[other] for other in spec.uses}

    def requested(segments: tuple[RecordedSegment, ...]) -> EstimateRequest[Record]:
        return EstimateRequest(name, segments, spec.parameters, site, sensor, uses, detection, setup)

    estimate, counted = estimated(
        chosen, spec.outliers, lambda segments: combined(estimator.estimate(requested(segments)))
    )
    estimate = with_flicker_words(estimate)
    request = requested(counted)
    if spec.validate is not None:
        chained = isinstance(estimator, Chains)
        draws = estimator.chain(request, estimate) if isinstance(estimator, Chains) else linear_chain(estimate)
        how = spec.validate if isinstance(spec.validate, MonteCarloSpec) else USUAL
        estimate = validated(estimate, draws, how, not chained, workers)
    rounded = coarse_counts(counted, used, sensor)
    further = (
        *rounded,
        *equal_outputs(counted, used),
        *transient_words(counted, used, sensor),
        *(
            drift_within_words(counted, used, sensor, _thermometer(spec.parameters))
            if isinstance(spec.parameters, FitsDrift)
            else ()
        ),
        *lost_samples(chosen, sensor.sample_rate),
        *thermometer_words(chosen, spec.parameters),
        *thermometer_count_words(estimate, thermometer_counts(counted, _thermometer(spec.parameters), sensor)),
    )
    return replace(estimate, warnings=(*estimate.warnings, *further))


def _thermometer(parameters: Record) -> str | None:
    return parameters.temperature_channel if isinstance(parameters, NamesThermometer) else None


def _used_outputs(parameters: Record, sensor: SensorModel) -> frozenset[str]:
    """Returns the names of the sensor's outputs that an estimate uses, without outputs that may keep one value, such as
    thermometers. If the parameters name none, the estimate uses all outputs."""
    outputs = [one.name for one in sensor.outputs if varies(one)]
    named = channels_of(parameters)
    return frozenset(name for name in outputs if name in named) or frozenset(outputs)


def _relevant(
    segments: Sequence[RecordedSegment], used: Collection[str], sensor: SensorModel
) -> tuple[RecordedSegment, ...]:
    """Returns the segments without the findings about outputs of the sensor that the estimate does not use, either as outputs or
    because they show the motion of a segment."""
    motions = [one.segment.motion for one in segments]
    shown = {name for motion in motions if isinstance(motion, RecordedMotion) for name in motion.channels}
    others = {one.name for one in sensor.outputs if varies(one)} - set(used) - shown
    return tuple(
        one
        if one.finds is None
        else replace(one, finds=tuple(find for find in one.finds if find.channel not in others))
        for one in segments
    )


_RESTS_ON = {
    "residual": "scatter of the segments about the model",
    "within_segment": "noise within the segments",
    "repeats": "scatter of the repeats",
}


def combined(estimate: Estimate) -> Estimate:
    """Adds a budget to each coefficient of an estimate. The budget combines the contribution of the data with all influences."""
    basis = estimate.settings.get("uncertainty", "")
    measured = [
        Measured(item.name, item.value, item.unit, item.standard_uncertainty, item.degrees_of_freedom)
        for item in estimate.coefficients
    ]
    sums = combine(measured, estimate.covariance, estimate.influences, _RESTS_ON.get(basis, "the data"))
    coefficients = tuple(
        replace(item, standard_uncertainty=float(u), degrees_of_freedom=float(dof))
        for item, u, dof in zip(
            estimate.coefficients, sums.standard_uncertainties, sums.degrees_of_freedom, strict=True
        )
    )
    return replace(
        estimate,
        coefficients=coefficients,
        covariance=sums.covariance,
        data_covariance=estimate.covariance,
        budgets=sums.budgets,
    )


def coarse_counts(
    segments: Sequence[RecordedSegment], channels: Collection[str], sensor: SensorModel
) -> tuple[Said, ...]:
    """Warns of each channel whose noise, in at least one segment, is too small to average out the rounding to counts. `channels`:
    the channels to check; if empty, all outputs of the sensor. If the bench file declares no resolution for a channel, the count is
    found from the samples.

    In a channel with too little noise, equal inputs have equal rounding errors. These errors do not appear in the noise within the
    segments or in the scatter of repetitions.
    """
    found = []
    outputs = [one for one in sensor.outputs if varies(one) and (not channels or one.name in channels)]
    undeclared = [one for one in outputs if not one.noise.resolution and unit(one.unit).dimension not in METERED]
    counts = _observed_counts(segments, [one.name for one in undeclared])
    for output in outputs:
        noise = output.noise
        if not noise.resolution:
            noise = replace(noise, resolution=counts.get(output.name, 0.0), counted=_carried(segments, output.name))
        if not noise.resolution:
            if output in undeclared and _constant(segments, output.name):
                found.append(
                    said(
                        "{output}: within each segment, all samples are equal. The noise is smaller than one count, so rounding errors "
                        "do not average out, and no scatter shows them. The uncertainties are too small. Record with a finer "
                        "resolution, or declare `resolution` in the bench file.",
                        output=output.name,
                    )
                )
            continue
        coarse = [
            one.label
            for one in segments
            if _coarse(one, output.name, noise) and (output.noise.resolution or _changes(one, output.name))
        ]
        if coarse:
            found.append(
                said(
                    "{output}: the noise in '{segment}' is too small for counts of {resolution:.4g} {unit}, so rounding errors do "
                    "not average out. They are the same whenever the sensor senses the same input: repeats do not reduce them, "
                    "and scatter may not show them. The uncertainties may be too small, and noise coefficients "
                    "describe the rounding instead of the noise. Record with a finer resolution.",
                    output=output.name,
                    segment=coarse[0],
                    resolution=noise.resolution,
                    unit=output.unit,
                )
            )
        elif words := _uneven_counts(segments, output, noise.resolution):
            found.append(words)
    return tuple(found)


def _uneven_counts(segments: Sequence[RecordedSegment], output: OutputModel, count: float) -> Said | None:
    """Returns a warning if some multiples of the count are much rarer than their neighbours, although the noise is larger than the
    count, and if the rounding errors that follow are not negligible. The errors are at most unevenness·count/π, by the first term
    of the Fourier series of a rounding error. They are the same in many segments, so they are compared with the standard error of
    the mean over all segments."""
    values, errors = [], []
    for one, kept in _kept_values(segments, output.name):
        values.append(kept)
        errors.append(float(one.statistics.standard_error[one.statistics.of(output.name)]))
    known = [error for error in errors if math.isfinite(error) and error > 0]
    if not known:
        return None
    found = unevenness(values, count)
    if found < _UNEVEN or found * count / math.pi < float(np.median(known)) / math.sqrt(len(known)):
        return None
    return said(
        "{output}: all samples are multiples of {count:.4g} {unit}, but some multiples are much rarer than their neighbours. The "
        "output was probably rounded to other counts before, in the sensor or in the recording program. The rounding errors do not "
        "average out, and no scatter shows them: the mean of a segment may be wrong by up to {half:.2g} {unit} (half a count). The "
        "uncertainties may be too small. Use a recording that was rounded only once.",
        output=output.name,
        count=count,
        unit=output.unit,
        half=count / 2,
    )


_UNEVEN = 0.3
"""Unevenness from which a warning is given. The rounding errors are then about 10 % of a count."""


def _coarse(recorded: RecordedSegment, channel: str, noise: NoiseModel) -> bool:
    statistics = recorded.statistics
    if channel not in statistics.channels or statistics.count < 2:
        return False
    place = statistics.of(channel)
    return not noise.dithers(float(statistics.covariance[place, place]))


def _carried(segments: Sequence[RecordedSegment], channel: str) -> bool:
    """Returns True if the rounding errors of a channel with coarse counts seem to be carried over from sample to sample. Carried
    rounding errors average out. For this test, the variance of the batch means is divided by the variance that independent samples
    would cause. The ratio is averaged over all segments. If errors are carried over and the white noise σ is below q/√12, where q
    is one count, the ratio is below 1/3 for long batches. The ratio is 1 if each sample is rounded independently."""
    ratios, freedoms = [], []
    for one in segments:
        if channel not in one.units or not one.statistics.batches > 1 or not _changes(one, channel):
            continue
        known, place = one.statistics, one.statistics.of(channel)
        if not known.covariance[place, place] > 0:  # a motion that is followed exactly
            continue
        ratios.append(float(known.standard_error[place] ** 2 * known.count / known.covariance[place, place]))
        freedoms.append(known.freedom)
    return bool(ratios) and sum(freedoms) >= _MANY and float(np.average(ratios, weights=freedoms)) < _CARRIED


_MANY = 8
"""Smallest number of degrees of freedom of batch means from which `_carried` can decide."""
_CARRIED = 0.5
"""Ratio of the variance of batch means to the variance that independent samples would cause, below which rounding errors count as
carried over."""


def _changes(recorded: RecordedSegment, channel: str) -> bool:
    """Returns True if the samples of a channel differ within a segment by more than floating-point rounding. The screening reports
    a channel that is stuck."""
    place = recorded.statistics.of(channel)
    return differ(float(recorded.statistics.minimum[place]), float(recorded.statistics.maximum[place]))


def _constant(segments: Sequence[RecordedSegment], channel: str) -> bool:
    """Returns True if the samples of a channel are equal within each segment. Tables of means and segments with a single sample are
    not considered."""
    shown = [
        one
        for one in segments
        if channel in one.units and one.statistics.count > 1 and not (one.summary or one.expected)
    ]
    known = all(np.isfinite(one.statistics.mean[one.statistics.of(channel)]) for one in shown)
    return len(shown) > 1 and known and not any(_changes(one, channel) for one in shown)


def _observed_counts(segments: Sequence[RecordedSegment], channels: Sequence[str]) -> dict[str, float]:
    """Finds the counts of channels, in their units, from the values that the screening has kept: those of the first runs of equal
    samples of each segment. Channels whose samples are not multiples of a count are left out. Samples that screening excluded are
    not used. Only segments at rest or at a constant rate are used, because their samples repeat. A segment in which a channel keeps
    one value shows no count."""
    counts: dict[str, float] = {}
    for name in channels:
        taken: list[Array] = []
        repeated = samples = 0.0
        for one, kept in _kept_values(segments, name):
            taken.append(kept)  # perhaps none
            repeated += one.repeats[name].share * one.statistics.count
            samples += one.statistics.count
        if samples:
            counts[name] = undeclared_step(np.concatenate(taken), _FEWEST, repeated / samples)
    return counts


def _kept_values(segments: Sequence[RecordedSegment], channel: str) -> Iterator[tuple[RecordedSegment, Array]]:
    """Returns each segment at rest or at a constant rate in which a channel changes, with the values that the screening has kept.
    Samples that the screening excluded are not used."""
    for one in segments:
        steady = isinstance(one.segment.motion, Rest | Spin) and not one.expected
        if not steady or channel not in one.repeats or not _changes(one, channel):
            continue
        values, place = one.repeats[channel].values, one.statistics.of(channel)
        yield one, values[(values >= one.statistics.minimum[place]) & (values <= one.statistics.maximum[place])]


_FEWEST = 2
"""Smallest number of different values from which a count is found. Two values are enough, because an output that rarely leaves one
value has a coarse count."""


def equal_outputs(segments: Sequence[RecordedSegment], outputs: Collection[str]) -> tuple[Said, ...]:
    """Warns of each pair of the given outputs that have the same samples in all segments: equal ranges, and a correlation of 1. Two
    sensors never have the same noise."""
    shown = [one for one in segments if one.statistics.count > 1 and not (one.summary or one.expected)]
    names = [name for name in sorted(outputs) if shown and all(name in one.units for one in shown)]
    names = [name for name in names if any(_changes(one, name) for one in shown)]
    return tuple(
        said(
            "{first} and {second} have the same samples in every segment, so at least one of the two is not a measurement: a "
            "column of the recording is probably used or copied twice. Check the channels in the bench file and the recording.",
            first=first,
            second=second,
        )
        for k, first in enumerate(names)
        for second in names[k + 1 :]
        if all(_equal(one, first, second) for one in shown)
    )


def _equal(recorded: RecordedSegment, first: str, second: str) -> bool:
    """Returns True if two outputs have the same samples in a segment."""
    known = recorded.statistics
    a, b = known.of(first), known.of(second)
    same = known.minimum[a] == known.minimum[b] and known.maximum[a] == known.maximum[b]
    scatter = known.covariance[a, a]
    return bool(same and abs(known.covariance[a, b] - scatter) <= 1e-9 * scatter)


GAP_INTERVALS = 5.5
"""A gap is reported if it is longer than this number of sample intervals; shorter gaps are jitter or single samples."""
NAMED = 3


def lost_samples(segments: Sequence[RecordedSegment], sample_rate: float) -> tuple[Said, ...]:
    """Reports two faults: samples that are missing or not a number, and gaps between samples. Returns at most one sentence about
    each fault. `sample_rate`: sample rate [Hz] for segments that state none."""
    left_out, gaps = [], []
    for recorded in segments:
        statistics = recorded.statistics
        rate = recorded.segment.sample_rate or sample_rate
        if statistics.rejected:
            rows = statistics.count + statistics.rejected
            left_out.append(f"'{recorded.label}' {statistics.rejected}/{rows}")
        if statistics.largest_gap * rate > GAP_INTERVALS:
            gaps.append(f"'{recorded.label}' {statistics.largest_gap:.3g} s")
    found = []
    if left_out:
        found.append(
            said(
                "Samples that are missing or not a number were left out: {places}. Check the recording.",
                places=_named(left_out),
            )
        )
    if gaps:
        found.append(
            said(
                "Samples are missing; the longest gaps: {places}. Check the recording.",
                places=_named(gaps),
            )
        )
    return tuple(found)


def _named(places: Sequence[str]) -> tuple[str, ...]:
    more = [f"… (+{len(places) - NAMED})"] if len(places) > NAMED else []
    return (*places[:NAMED], *more)
