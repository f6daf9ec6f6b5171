"""Estimates scale factors of several axes in one tilted mounting (提高标度因数测试效率的方法, Xi'an Aerospace Precision Electromechanical,
2022).

For each temperature and repeat, F_r is the mean of the zero readings before and after the rates. The line F_j − F_r = K·cos θ·ω_j +
F_0 + ν_j is fitted by ordinary least squares to the outputs F_j at the rates ω_j. The names of the metrics follow IEEE 952 and
1431. The source does not treat the Earth's rotation. The component of this rotation along the rotation axis of the table is the
same in F_j and F_r, so it cancels. The other components change as the table turns, so their average over whole turns in F_j is
zero. These other components remain in the zero readings F_r at the home position. Therefore, F_0 contains these components if they
are not corrected.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, said
from planrunner.error_model.observed import axis_of
from planrunner.estimators.declared_axes import AxisResponse, against_nominal, contradictions
from planrunner.estimators.interface import Design, DesignRequest, EstimateRequest, EstimationError, UnfitDataError
from planrunner.estimators.method import Method, Quantities, Words
from planrunner.estimators.stated_errors import common_rate
from planrunner.estimators.tilted import planning as tilted_planning
from planrunner.estimators.tilted.evaluation import (
    Group,
    K,
    TiltedConditions,
    answers_of,
    columns_of_repeats,
    evaluate,
    make_group,
    worst_of,
)
from planrunner.estimators.tilted.fixture_calibration import calibrated_axes
from planrunner.estimators.tilted.influences import Rounding, Situation, influences, unstated_influences
from planrunner.estimators.tilted.mounted_axes import MountedAxes, mounted_axes, rotation_axis, seeing
from planrunner.estimators.tilted.parameters import THERMOMETER, ScaleFactorTiltedParameters
from planrunner.estimators.tilted.rate_lines import rate_and_output
from planrunner.estimators.tilted.rate_series import RateSeries, by_temperature, split_series, temperature_label
from planrunner.estimators.tilted.report import report
from planrunner.estimators.tilted.results import (
    HEADLINE,
    Item,
    coefficients,
    items,
    over_temperature,
    shown_covariance,
    shown_influences,
)
from planrunner.estimators.tilted.scatter import (
    NoiseOfMeans,
    Scatter,
    gradient_of,
    half_drift,
    moved_alike,
    moved_further,
    noise_of_means,
    scatter_between_repeats,
    scatter_of_means,
    whole,
    with_expected_repeatability,
)
from planrunner.estimators.tilted.turning_rates import as_recording_begins, mean_rates, part_turns, recorded_seconds
from planrunner.estimators.unstated_flicker import FlickerEvidence, UnstatedFlicker
from planrunner.observation.correlated_errors import CorrelatedError, explained
from planrunner.observation.flicker import SPAN, flicker_errors, unstated_flicker
from planrunner.observation.observations import Observations, dithered, observe, within_segment_noise
from planrunner.plan.schedule import Segment
from planrunner.plan.units import DIMENSIONS, Unit, unit
from planrunner.uncertainty.influences import Influence


@dataclass(frozen=True, slots=True, kw_only=True)
class TiltedQuantities(Quantities):
    """Contains the results of a scale-factor test in a tilted fixture.

    `kept`: labels of the segments in complete series. `units`: for each axis, the unit of the rate and the unit of the output.
    `scatter`: type A uncertainty on the chosen basis. `within`: type A uncertainty from the noise within the segments alone.
    `acting`: influences of declared inputs on the results, in the order of `TiltedResults.vector`. `doubts`: warnings about series
    that are left out, and about zeros that drift too much. `calibrated`: True if the angles of the fixture come from a calibration.
    """

    situation: Situation
    kept: tuple[str, ...]
    units: tuple[tuple[Unit, Unit], ...]
    shown: tuple[Item, ...]
    scatter: Scatter
    within: Scatter
    noise: NoiseOfMeans
    acting: tuple[Influence, ...]
    doubts: tuple[Said, ...]
    calibrated: bool


class ScaleFactorTilted(Method[ScaleFactorTiltedParameters, TiltedQuantities]):
    """Implements the estimator `scale_factor_tilted`."""

    name = "scale_factor_tilted"
    summary = "Scale factors of several axes in one tilted mounting, over rates, repeats and temperatures"
    Parameters = ScaleFactorTiltedParameters

    def design(self, request: DesignRequest[ScaleFactorTiltedParameters]) -> Design:
        """Checks the lines through the planned rates, and reports parts that the plan lacks. Raises `EstimationError` if the plan
        is not suitable."""
        return tilted_planning.design(request)

    def quantities(self, request: EstimateRequest[ScaleFactorTiltedParameters]) -> TiltedQuantities:
        """Computes the scale factors from the means. Raises `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        if not request.segments:
            raise EstimationError("no recorded segments are chosen: check the labels in `segments`")
        channels = request.segments[0].statistics.channels
        axes, fixture = calibrated_axes(
            seeing(mounted_axes(request.setup.mounting, channels, parameters.outputs)), request.uses
        )
        kept, series, warnings = _complete(request)
        observations = observe(kept, axes.outputs, request.sensor)
        situation = _situation(request, axes, fixture, kept, series, observations)
        groups, found = situation.groups, situation.found
        # Expected observations do not scatter, so their uncertainties come from the declared noise.
        basis = "within_segment" if observations.expected else parameters.uncertainty
        # The scatter between repeats includes flicker, except for the part that all repeats have in common.
        seen = basis == "repeats"
        stated = flicker_errors(observations, request.setup.inputs, SPAN.value)
        flicker = () if seen else stated
        sigma, freedom_of_sigma = _sigma(request, observations, flicker)
        noise = noise_of_means(groups, sigma, observations.correlation, freedom_of_sigma)
        within = scatter_of_means(groups, found, situation.answers, noise, "within_segment")
        scatter = (
            scatter_between_repeats(found, groups, situation.answers, stated)
            if seen
            else scatter_of_means(groups, found, situation.answers, noise, basis, flicker)
        )
        if observations.expected:
            found = with_expected_repeatability(found, groups, scatter)
            situation = replace(situation, found=found)
            further: set[int] = set()
        else:
            further = moved_alike(groups) if seen else moved_further(groups, sigma, flicker)
        declared = {axis for effect in flicker for axis in effect.changes}
        covariance, freedom = whole(found, groups, scatter, situation.gradient)
        acting = tuple(
            influences(
                situation,
                request.setup.inputs,
                common_rate(request.name, parameters.rate_uncertainty),
                basis,
                _rounding(request, kept, axes),
                flicker,
                {axis: half_drift(groups, axis, sigma[:, axis], seen) for axis in further},
            )
        )
        units = tuple(rate_and_output(parameters.rate_unit, text) for text in observations.units)
        shown = items(found, groups, axes, units, situation.reference)
        learnt = coefficients(found, shown, covariance, freedom)
        held = over_temperature(shown, learnt, groups, axes, situation.reference)
        return TiltedQuantities(
            coefficients=learnt,
            covariance=shown_covariance(shown, covariance),
            influences=shown_influences(shown, acting),
            unstated=_unstated(request, situation, observations, sigma, freedom_of_sigma, shown),
            extra={"by_temperature": held} if held else {},
            situation=situation,
            kept=tuple(one.label for one in kept),
            units=units,
            shown=shown,
            scatter=scatter,
            within=within,
            noise=noise,
            acting=acting,
            doubts=(*warnings, *_further_than_declared(axes, further & declared)),
            calibrated=bool(fixture),
        )

    def words(self, request: EstimateRequest[ScaleFactorTiltedParameters], found: TiltedQuantities) -> Words:
        """Makes the tables and plots of the results at all rates, repeats and temperatures."""
        parameters = request.parameters
        situation = found.situation
        told = report(situation, found.units, found.scatter, found.within, found.noise, found.acting, parameters)
        return replace(
            told,
            headline=tuple(
                item.name for word in HEADLINE for item in found.shown if item.reference and item.quantity == word
            ),
            settings={
                "uncertainty": parameters.uncertainty,
                "earth_rate": parameters.earth_rate,
                "reference_temperature": situation.groups[situation.reference].label or "not stated",
                "fixture_angles": "calibrated" if found.calibrated else "as stated",
            },
            warnings=(*found.doubts, *_against_declared(request, found), *told.warnings),
            segments=found.kept,
        )


def _unstated(
    request: EstimateRequest[ScaleFactorTiltedParameters],
    situation: Situation,
    observations: Observations,
    sigma: Array,
    freedom: Array,
    shown: Sequence[Item],
) -> tuple[UnstatedFlicker, ...]:
    """Returns how flicker affects the coefficients, for outputs for which the bench file states no flicker. `sigma`: array of shape
    (N, m), noise of each segment's mean. `freedom`: array of shape (m,), degrees of freedom of this noise. Both arrays are results
    of `_sigma`."""
    silent = unstated_flicker(observations, request.setup.inputs, SPAN.value)
    found = []
    for error, influence in unstated_influences(situation, silent, request.parameters.uncertainty):
        axis = observations.channels.index(error.channel)
        evidence = None
        if freedom[axis]:
            evidence = FlickerEvidence(
                columns_of_repeats(situation.groups, situation.conditions, axis),
                observations.mean[:, axis],
                sigma[:, axis],
                float(freedom[axis]),
                error.changes[axis],
                error.within[axis],
                np.zeros((len(sigma), 0)),
            )
        (acting,) = shown_influences(shown, [influence])
        found.append(UnstatedFlicker(error.channel, acting, evidence))
    return tuple(found)


def _against_declared(request: EstimateRequest[ScaleFactorTiltedParameters], found: TiltedQuantities) -> list[Said]:
    """Returns warnings about outputs whose scale factor differs from the nominal value. For an output of angular rate without a
    declared scale factor, the nominal value is one."""
    axes, slopes = found.situation.conditions.axes, found.situation.found.means[found.situation.reference, :, K]
    named: list[tuple[str, float, float]] = []
    plain: list[AxisResponse] = []
    for axis, output, slope, (_, own) in zip(axes.names, axes.outputs, slopes, found.units, strict=True):
        value, letter = float(slope * own.factor), axis_of(output)
        if nominal := request.sensor.nominal.get(f"K_{output}"):
            named.append((f"K_{axis}", value, nominal))
        elif own.dimension == DIMENSIONS["angular rate"] and letter is not None:
            plain.append(AxisResponse(output, letter, own, {letter: value}))
    return [*against_nominal(named), *contradictions(plain)]


def _situation(
    request: EstimateRequest[ScaleFactorTiltedParameters],
    axes: MountedAxes,
    fixture: tuple[Influence, ...],
    kept: Sequence[RecordedSegment],
    series: Sequence[RateSeries],
    observations: Observations,
) -> Situation:
    seconds = tuple(recorded_seconds(one) for one in kept)
    conditions, segments = _conditions(request, kept, axes, seconds)
    groups = _groups(request, kept, series, observations)
    _require_response(groups, axes)
    reference = _reference(groups, request.parameters)
    found = evaluate(groups, conditions, reference)
    worst = worst_of(groups, found, reference)
    return Situation(
        groups,
        conditions,
        found,
        worst,
        reference,
        answers_of(groups, conditions, worst),
        gradient_of(found, groups, reference, worst),
        segments,
        seconds,
        request.site,
        kept[0].segment.orientation,
        observations.units,
        fixture,
    )


def _complete(
    request: EstimateRequest[ScaleFactorTiltedParameters],
) -> tuple[list[RecordedSegment], tuple[RateSeries, ...], list[Said]]:
    """Returns the recorded segments of complete series; the complete series; and warnings about the other series."""
    recorded = request.segments
    series = split_series([one.segment for one in recorded], request.parameters.zero)
    whole_ones: list[RateSeries] = []
    lacking: list[tuple[RateSeries, Said]] = []
    for repeats in by_temperature(series).values():
        rates = [tuple(recorded[index].segment.rate for index in one.spins) for one in repeats]
        most = max(rates, key=len)
        for one, own in zip(repeats, rates, strict=True):
            cut = [recorded[index].label for index in one.segments if recorded[index].truncated]
            if one.lacks:
                lacking.append((one, said("has no {parts}", parts=one.lacks)))
            elif cut:
                lacking.append((one, said("is cut short in '{segment}'", segment=cut[0])))
            elif len(own) < len(most):
                lacking.append((one, said("has {count} of {most} rates", count=len(own), most=len(most))))
            elif own != most:
                lacking.append((one, said("has different rates from the other series")))
            else:
                whole_ones.append(one)
    warnings = [said("Series {series} {why}, so it is left out.", series=one.name, why=why) for one, why in lacking]
    if not whole_ones:
        one, why = lacking[0]
        raise EstimationError(
            f"no series is complete: {one.name} {why}. Each series needs a zero at rest before the rates and "
            "another after them, labelled as in `zero` "
            f"({', '.join(request.parameters.zero)})"
        )
    rates_at = {tuple(recorded[index].segment.rate for index in one.spins) for one in whole_ones}
    if any(len(set(rates)) < 2 for rates in rates_at):
        raise EstimationError(
            "a series has only one rate, so a line cannot be distinguished from a constant: add rates"
        )
    order = sorted(index for one in whole_ones for index in one.segments)
    place = {index: row for row, index in enumerate(order)}

    def moved(indices: Sequence[int]) -> tuple[int, ...]:
        return tuple(place[index] for index in indices)

    kept = tuple(replace(one, start=moved(one.start), spins=moved(one.spins), end=moved(one.end)) for one in whole_ones)
    return [recorded[index] for index in order], kept, warnings


def _conditions(
    request: EstimateRequest[ScaleFactorTiltedParameters],
    kept: Sequence[RecordedSegment],
    axes: MountedAxes,
    seconds: Sequence[float | None],
) -> tuple[TiltedConditions, tuple[Segment, ...]]:
    planned = [one.segment for one in kept]
    along = rotation_axis(planned)
    commanded = np.array([segment.rate for segment in planned])
    how = request.parameters.earth_rate
    if how == "corrected":
        axes.require_azimuths()
        begun = as_recording_begins(planned, request.site, request.setup.table)
        return TiltedConditions(axes, commanded, along, mean_rates(begun, request.site, seconds)), begun
    if how == "averaged":
        intervals = [1 / (segment.sample_rate or request.sensor.sample_rate) for segment in planned]
        parts = part_turns(planned, seconds, intervals)
        if parts:
            label, turns = parts[0]
            raise EstimationError(
                f"'{label}' covers {turns:.4g} turns, which is not a whole number, so the Earth's rotation is not averaged out: "
                "write "
                "`earth_rate: corrected`, or `dwell: {turns: 1, at_least: …}`"
            )
    return TiltedConditions(axes, commanded, along, None), tuple(planned)


def _groups(
    request: EstimateRequest[ScaleFactorTiltedParameters],
    kept: Sequence[RecordedSegment],
    series: Sequence[RateSeries],
    observations: Observations,
) -> tuple[Group, ...]:
    commanded = np.array([one.segment.rate for one in kept])
    made = []
    for planned, repeats in by_temperature(series).items():
        rows = [index for one in repeats for index in one.segments]
        kelvin = _measured(request, [kept[row] for row in rows], planned)
        made.append(make_group(repeats, temperature_label(planned), kelvin, commanded, observations.mean))
    return tuple(made)


def _require_response(groups: Sequence[Group], axes: MountedAxes) -> None:
    """Raises `UnfitDataError` for an output that is equal at all rates, for example because the sensor has no power."""
    for group in groups:
        silent = np.flatnonzero(np.any(np.ptp(group.outputs, axis=1) == 0, axis=0))
        if silent.size:
            name = axes.outputs[silent[0]]
            where = f" at {group.label}" if group.label else ""
            raise UnfitDataError(
                f"'{name}' has no response to the rate{where}: its mean is the same at all rates; check that the "
                f"sensor had power and was measuring (`mode`), and check its wiring"
            )


def _measured(
    request: EstimateRequest[ScaleFactorTiltedParameters], recorded: Sequence[RecordedSegment], planned: float | None
) -> float:
    """Returns the mean temperature of the sensor [K]: the recorded temperature, otherwise the planned temperature, otherwise NaN."""
    wanted = request.parameters.temperature
    channel = wanted or THERMOMETER
    if wanted is None and any(channel not in one.statistics.channels for one in recorded):
        return math.nan if planned is None else planned
    observed = observe(recorded, [channel], request.sensor)
    own = unit(observed.units[0])
    if own.dimension != unit("K").dimension:
        raise EstimationError(
            f"the channel '{channel}' is in {own.text}, which is not a unit of temperature: name another channel"
        )
    return own.to_si(float(observed.mean[:, 0].mean()))


def _reference(groups: Sequence[Group], parameters: ScaleFactorTiltedParameters) -> int:
    off = [abs(group.kelvin - parameters.reference_temperature.value) for group in groups]
    return int(np.nan_to_num(off, nan=math.inf).argmin())


def _sigma(
    request: EstimateRequest[ScaleFactorTiltedParameters],
    observations: Observations,
    flicker: Sequence[CorrelatedError],
) -> tuple[Array, Array]:
    """Returns the noise (N, m) of each segment's mean, and the degrees of freedom (m,) of this noise. The part that flicker adds to
    the scatter within the segments is not included. An output whose samples show no noise is treated as noiseless. If the
    uncertainties are based on this noise, an `EstimationError` is raised instead."""
    known = [within_segment_noise(observations, k, explained(flicker, k)) for k in range(len(observations.channels))]
    if request.parameters.uncertainty == "within_segment" and not all(one.known for one in known):
        raise EstimationError(
            f"{request.name}: the samples within the segments do not vary (or are too few), so the within-segment noise cannot give an "
            "uncertainty; write `uncertainty: repeats` or `uncertainty: residual`"
        )
    sigma = np.column_stack([one.sigma if one.known else np.zeros_like(one.sigma) for one in known])
    return sigma, np.array([one.degrees_of_freedom if one.known else 0.0 for one in known])


def _further_than_declared(axes: MountedAxes, further: set[int]) -> list[Said]:
    return [
        said(
            "From before to after the rates, the zeros of {output} changed by more than noise and the declared bias "
            "instability explain (at 1 %). The budget includes this drift; check for warm-up, or declare a larger bias "
            "instability.",
            output=axes.outputs[axis],
        )
        for axis in sorted(further)
    ]


def _rounding(
    request: EstimateRequest[ScaleFactorTiltedParameters], kept: Sequence[RecordedSegment], axes: MountedAxes
) -> dict[str, Rounding]:
    """Returns, for each output, the rounding error that remains in the means. If noise dithers the samples, their rounding errors
    average out; otherwise, a mean has the rounding error of a single sample."""
    found = {}
    for output in axes.outputs:
        variances = [float(np.diag(one.statistics.covariance)[one.statistics.of(output)]) for one in kept]
        dithering = all(dithered(request.sensor, output, variance) for variance in variances)
        share = 1 / math.sqrt(min(one.statistics.count for one in kept)) if dithering else 1.0
        found[output] = Rounding(share, min(variances) > 0)
    return found
