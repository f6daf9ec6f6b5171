"""Estimates amplitudes of effects by generalised least squares, from the means of segments and, where an output changes within
segments, also from its samples (`within`). The plan names the effects for each output.

    output = input along its own axis + Σ amplitude · column

The columns come from `planrunner.error_model.effects`, which simulations and diagnoses also use. For the fit to the means, the
columns are averaged over the segments. The parameters of the effects have the names and units of the catalogue, so that a result
can be stated in a bench file. An output may be recorded in a unit that is not a unit of rate or acceleration, for example in
pulse/s. Its model is then output = K · (input + Σ …), where K is its fitted scale factor.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.base.said import Said, counted, said
from planrunner.error_model.effects.interface import (
    Follows,
    FollowsSurroundings,
    FollowsTemperature,
    HasShape,
    ShapedOverSegments,
    shown_by,
)
from planrunner.error_model.observed import STANDARD_PRESSURE
from planrunner.error_model.segment_columns import KINDS, SegmentStates, states_of
from planrunner.estimators import rank
from planrunner.estimators.basis_judgement import FitNote, judge, planned_basis, require_basis
from planrunner.estimators.declared_axes import AxisResponse, against_nominal, contradictions
from planrunner.estimators.derived import Derived, Reported, derived
from planrunner.estimators.drift_order import planned_drift
from planrunner.estimators.error_model.common_amplitudes import CommonAmplitudes, between_outputs, common_amplitudes
from planrunner.estimators.error_model.meter_errors import meter_errors, thermometer_errors
from planrunner.estimators.error_model.outputs import ModelledOutput, Together, models
from planrunner.estimators.error_model.parameters import ErrorModelParameters
from planrunner.estimators.error_model.sampled_outputs import SampledOutputs
from planrunner.estimators.error_model.shapes import shaped_part, with_shapes
from planrunner.estimators.error_model.within import Contrasts
from planrunner.estimators.expected import ASSUMPTIONS, Known, expected_recording, planned_blocks
from planrunner.estimators.fit_tables import bases_table, drift_tables, residual_plot, residual_table
from planrunner.estimators.full_scale import beyond_full_scale, shares_along
from planrunner.estimators.interface import (
    Design,
    DesignBlock,
    DesignRequest,
    EstimateRequest,
    EstimationError,
    Foresight,
    Remark,
    Unpredicted,
)
from planrunner.estimators.method import Method, Quantities, Words, by_expectation
from planrunner.estimators.outputs_fit import BASES, OutputsFit, coefficients_by_noise, fit_outputs
from planrunner.estimators.resolution_influences import resolution_influences
from planrunner.estimators.stated_errors import site_errors, table_errors
from planrunner.estimators.tables import Role, Table, TableColumn, by_columns
from planrunner.estimators.thermometer_counts import thermometer_counts
from planrunner.observation.correlated_errors import CorrelatedError, functionals_of
from planrunner.observation.drift import DriftCourse, DriftCourses, drift_of
from planrunner.observation.flicker import flicker_errors, unstated_flicker
from planrunner.observation.observations import SIGNIFICANCE, Observations, observe, recorded_times, weights_of
from planrunner.plan.schedule import RecordedMotion, Segment
from planrunner.plan.units import DIMENSIONS, ZERO_CELSIUS, unit
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.influences import Influence, InputQuantity

DILUTION = "noise of the recorded motion"
"""In budgets, the name of the influence due to the noise of the channels that show a recorded motion."""
WITHIN = "within segments"
"""Label of the contrasts within segments, which are fitted together with the means of the segments. A contrast is a weighted sum of
the differences between samples and the mean of their segment (see `within`)."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedOutput:
    """The fit of one output. `observations`: the observations of this output. `site`: the influences of the uncertain latitude and
    gravity, and of the meters for supply and pressure, on these observations. `dilution`: the influence of the noise of the channels
    that show a recorded motion; empty if there are none."""

    model: ModelledOutput
    observations: Observations
    fit: OutputsFit
    site: tuple[CorrelatedError, ...]
    dilution: tuple[CorrelatedError, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelQuantities(Quantities):
    """The fitted amplitudes of an estimate. `outputs`: the fitted outputs in the order of the plan. `separate`: the amplitudes of
    all outputs in sequence, before common amplitudes are combined."""

    outputs: tuple[FittedOutput, ...]
    found: Derived
    common: CommonAmplitudes
    separate: Derived


class ErrorModelEstimator(Method[ErrorModelParameters, ModelQuantities]):
    """Implements the estimator `error_model`."""

    name = "error_model"
    summary = (
        "Amplitudes of any effects in the catalogue of error effects, estimated from positions, rates and temperatures"
    )
    Parameters = ErrorModelParameters

    def design(self, request: DesignRequest[ErrorModelParameters]) -> Design:
        """Checks how well the planned segments determine the amplitudes of each output. Raises `EstimationError` if the plan is not
        suitable."""
        parameters = request.parameters
        _known_monitors(parameters, {output.name: output.unit for output in request.sensor.outputs})
        by_name: dict[str, DesignBlock] = {}
        remarks: list[Remark] = []
        only_recorded: dict[str, None] = {}
        unknown = [segment.label for segment in request.segments if isinstance(segment.motion, RecordedMotion)]
        heated = _heated(request)
        for group in _planned(request):
            if unknown:  # effects and outputs are valid; only the recording shows whether it determines the amplitudes
                continue
            its_own = replace(request, segments=tuple(request.segments[row] for row in group.rows))
            for one in group.outputs:
                if quantities := _only_recorded(one, request, heated):
                    only_recorded |= dict.fromkeys(quantities)
                    continue
                made = planned_blocks(its_own, [one.name], one.names, one.columns.matrix, one.columns.magnitudes)
                made = tuple(_block_with_contrasts(block, one) for block in made)
                by_name[one.name] = made[0]
                remarks += [*_inseparable(one, group.segments), *planned_basis(its_own, made, parameters.uncertainty)]
                remarks += beyond_full_scale(its_own, [one.name], _shares(one, group.segments))
        if any(remark.code == "physics-rank" for remark in remarks):
            return Design((), remarks=tuple(remarks))
        if unknown:
            remarks += planned_basis(request, (), parameters.uncertainty)
            message = f"{len(unknown)} segments have a motion that only the recording shows"
            hint = "`planrunner check --data` tries the estimate on the recording"
            return Design((), notes=(f"{message}: {hint}",), remarks=tuple(remarks))
        blocks = tuple(by_name[name] for name in parameters.outputs if name in by_name)
        remarks += planned_drift(request, [one for one in blocks if WITHIN not in one.labels])
        hint = "`planrunner check --data` tries the estimate on the recording"
        notes = tuple(f"no segment states the {name}, which only the recording shows: {hint}" for name in only_recorded)
        return Design(blocks, notes=notes, remarks=tuple(dict.fromkeys(remarks)))

    def foresee(self, request: DesignRequest[ErrorModelParameters]) -> Foresight:
        """Predicts the coefficients by applying the estimator to the expected recording. If a shape is to be fitted, the prediction
        has no uncertainties, because only a recording determines a shape."""
        outputs = [one for group in _planned(request) for one in group.outputs]
        parts = [(one, part) for one in outputs if (part := shaped_part(one)) is not None]
        unstated = dict.fromkeys(name for one in outputs for name in _unstated(one, request.parameters))
        moved = any(isinstance(segment.motion, RecordedMotion) for segment in request.segments)
        heated = _heated(request)
        only_recorded = dict.fromkeys(name for one in outputs for name in _only_recorded(one, request, heated))
        if not parts and not unstated and not moved and not only_recorded:
            return by_expectation(self, request)
        reasons = [f"the shape of {part.effect.id} is only known from a recording" for _, part in parts]
        reasons += ["only the recording shows the motion"] if moved else []
        reasons += [f"only the recording shows the {name}" for name in only_recorded]
        reasons += [f"the plan does not state under `expected` what is expected of {name}" for name in unstated]
        why = " and ".join(dict.fromkeys(reasons))
        found = [Unpredicted(one.name, one.unit, why, one.description) for one in common_amplitudes(outputs).amplitudes]
        for output, part in parts:
            effect, letter = part.effect, "xyz"[output.errors.axis]
            assert isinstance(effect, HasShape)
            found.append(Unpredicted(f"{effect.id}_{effect.shape_name}_{letter}", effect.shape_unit, why))
        return Foresight(unpredicted=tuple(found))

    def known(self, request: DesignRequest[ErrorModelParameters]) -> Known:
        """Returns the input axis of each output, in the sensor's frame."""
        named = [one for group in _planned(request) for one in group.outputs]
        return Known(directions={one.name: np.eye(3)[one.errors.axis] for one in named})

    def quantities(self, request: EstimateRequest[ErrorModelParameters]) -> ModelQuantities:
        """Computes the amplitudes from the means of the segments and, if an output needs this, from its samples. Raises
        `EstimationError` if the plan or the data are not suitable."""
        parameters = request.parameters
        units = {name: text for one in request.segments for name, text in one.units.items()}
        _known_monitors(parameters, units)
        planned = [one.segment for one in request.segments]
        states = _recorded_states(request.segments, parameters, request.sensor.nominal_supply)
        samples = SampledOutputs(request.segments, request.site, request.sensor, parameters)
        groups = models(parameters, units, request.sensor, planned, request.site, states, samples)
        by_name = {one.model.name: one for group in groups for one in _fitted(request, group)}
        if shown := {
            course.name for one in by_name.values() for course in one.fit.drift.courses if one.fit.drift.by_evidence
        }:
            # A drift that one output shows is fitted to the other outputs as well.
            by_name = {one.model.name: one for group in groups for one in _fitted(request, group, shown)}
        outputs = tuple(by_name[name] for name in parameters.outputs)
        basis = parameters.uncertainty
        sizes = [len(one.model.coefficients) for one in outputs]

        def separately(flat: Array) -> Array:
            parts = np.split(flat, np.cumsum(sizes)[:-1])
            return np.concatenate([one.model.reported(part) for one, part in zip(outputs, parts, strict=True)])

        fits, between = [one.fit for one in outputs], _between(request, outputs)
        common = common_amplitudes([one.model for one in outputs])
        each = [Reported(c.name, c.unit, c.description) for one in outputs for c in one.model.coefficients]
        separate = derived(each, separately, *fits, between=between)
        joining = common.joining(separate.covariance(basis))
        reported = [Reported(c.name, c.unit, c.description) for c in common.amplitudes]
        found = derived(reported, lambda flat: joining @ separately(flat), *fits, between=between)
        return ModelQuantities(
            coefficients=found.coefficients(basis),
            covariance=found.covariance(basis),
            influences=found.influences([_stated(request, one) for one in outputs]),
            unstated=found.unstated,
            extra={"effects": _as_added(outputs, common, found)},
            outputs=outputs,
            found=found,
            common=common,
            separate=separate,
        )

    def words(self, request: EstimateRequest[ErrorModelParameters], made: ModelQuantities) -> Words:
        """Makes the tables and plots of the residuals of each output, and the tables of the uncertainties."""
        basis = request.parameters.uncertainty
        notes: dict[FitNote, list[str]] = {}
        warnings: list[Said] = []
        for one in made.outputs:
            judged = judge(one.fit, basis)
            for note in judged.notes:
                notes.setdefault(note, []).append(one.model.name)
            warnings += judged.warnings
        warnings += _contradictions(request, made.outputs)
        warnings += _reversed_meters(request)
        warnings += [text for one in made.outputs for text in (*_of_samples(one), *_diluted(one, basis))]
        warnings += _disagreement(request, made)
        every = len(made.outputs)
        shared = [
            note.text
            if len(names) == every or note.output
            else said("{outputs}: {note}", outputs=tuple(names), note=note.text)
            for note, names in notes.items()
        ]
        at_rest = [one.model.name for one in made.outputs if len(one.model.rows) < len(request.segments)]
        if at_rest:
            shared.append(said("{outputs}: only the segments at rest are used for the fit.", outputs=tuple(at_rest)))
        return Words(
            headline=tuple(one.name for one in made.found.quantities),
            settings={
                "uncertainty": basis,
                "outputs": {name: list(effects) for name, effects in request.parameters.outputs.items()},
                "weights": weights_of(
                    [one.model.name for one in made.outputs], [one.fit.noises[0] for one in made.outputs]
                ),
            },
            tables=(
                *(
                    residual_table(f"Residuals of {one.model.name}", "segment", one.observations, one.fit)
                    for one in made.outputs
                ),
                *drift_tables([one.fit for one in made.outputs], basis),
                bases_table(made.found, basis),
                *_common_table(made, basis),
            ),
            plots=tuple(
                residual_plot(one.observations, one.fit, f"Residuals of {one.model.name}", "segment")
                for one in made.outputs
            ),
            notes=tuple(shared),
            warnings=tuple(warnings),
            segments=tuple(recorded.label for recorded in request.segments),
        )


def _unstated(one: ModelledOutput, parameters: ErrorModelParameters) -> list[str]:
    """Returns the effects whose shape is fitted to samples, if the plan states no expected value for the shape."""
    if one.within is None:
        return []
    shaped = [amplitude.effect.id for amplitude in one.columns.amplitudes if amplitude.shape]
    return [name for name in shaped if name not in parameters.expected]


def _heated(request: DesignRequest[ErrorModelParameters]) -> dict[str, Array]:
    """Returns the columns of each output for segments at different temperatures, if only a channel of the recording shows the
    temperature; otherwise nothing. If these columns differ from the planned columns, the output depends on the temperature."""
    if request.parameters.temperature_channel is None or any(one.begins_at is not None for one in request.segments):
        return {}
    warm = tuple(
        replace(one, temperature=ZERO_CELSIUS + k % 3 * _WARMER) for k, one in enumerate(request.segments, start=1)
    )
    groups = _planned(replace(request, segments=warm))
    return {one.name: one.columns.matrix for group in groups for one in group.outputs}


_WARMER = 10.0
"""Temperature difference, K, between assumed segments."""


def _planned(request: DesignRequest[ErrorModelParameters]) -> tuple[Together, ...]:
    start = np.array([one.start for one in request.segments])
    seconds = np.array([one.dwell or 1.0 for one in request.segments])
    states = states_of(request.segments, start, seconds, request.sensor.nominal_supply)
    units = {output.name: output.unit for output in request.sensor.outputs}
    expected = expected_recording(request, Known(), (), ASSUMPTIONS[0]).segments
    samples = SampledOutputs(expected, request.site, request.sensor, request.parameters)
    return models(request.parameters, units, request.sensor, request.segments, request.site, states, samples)


def _only_recorded(
    one: ModelledOutput, request: DesignRequest[ErrorModelParameters], heated: Mapping[str, Array]
) -> list[str]:
    """Returns the quantities that the effects on an output need but that no segment states. Only a channel of the recording shows
    these quantities. `heated`: columns of outputs at other temperatures (`_heated`)."""
    channels = {
        Follows.SUPPLY: request.parameters.supply_channel,
        Follows.PRESSURE: request.parameters.pressure_channel,
    }
    stated = {
        Follows.SUPPLY: any(segment.supply_voltage is not None for segment in request.segments),
        Follows.PRESSURE: any(segment.ambient_pressure is not None for segment in request.segments),
    }
    followed = (part.effect.follows for part in one.errors.chosen if isinstance(part.effect, FollowsSurroundings))
    surroundings = [name.value for name in dict.fromkeys(followed) if channels[name] is not None and not stated[name]]
    warm = heated.get(one.name)
    follows = warm is not None and not np.allclose(warm, one.columns.matrix, rtol=1e-9, atol=0.0)
    return [*(["temperature"] if follows else []), *surroundings]


def _reversed_meters(request: EstimateRequest[ErrorModelParameters]) -> list[Said]:
    """Returns warnings about meters for supply voltage and pressure whose readings have the wrong sign. The gain of a meter is the
    slope of a straight line through the origin that is fitted to the readings as a function of the values that the plan states. The
    sign of the gain is the sign of Σ (reading · stated value)."""
    planned = [one.segment for one in request.segments]
    nominal = request.sensor.nominal_supply
    stated = states_of(planned, np.zeros(len(planned)), np.ones(len(planned)), nominal)
    read = _recorded_states(request.segments, request.parameters, nominal)
    meters = (
        (request.parameters.supply_channel, read.overvoltage, stated.overvoltage, nominal),
        (request.parameters.pressure_channel, read.overpressure, stated.overpressure, STANDARD_PRESSURE),
    )
    return [
        said(
            "The readings of {channel} have the opposite sign of the values that the plan states, so the effects that follow "
            "this channel are wrong. Check the sign and the terminals of the meter, and its channel in the bench file.",
            channel=channel,
        )
        for channel, reading, value, reference in meters
        if channel is not None and (reading + reference) @ (value + reference) < 0
    ]


def _recorded_states(
    recording: Sequence[RecordedSegment], parameters: ErrorModelParameters, nominal_supply: float
) -> SegmentStates:
    start, end = recorded_times(recording)
    states = states_of([one.segment for one in recording], start, end - start, nominal_supply)

    def means(channel: str) -> Array:
        scale = unit(recording[0].units[channel])
        found = np.array([one.statistics.mean[one.statistics.of(channel)] for one in recording])
        return np.asarray(found * scale.factor + scale.offset)

    if parameters.temperature_channel is not None:
        states = states.measured(means(parameters.temperature_channel) - ZERO_CELSIUS)
    if parameters.supply_channel is not None:
        states = replace(states, overvoltage=means(parameters.supply_channel) - nominal_supply)
    if parameters.pressure_channel is not None:
        states = replace(states, overpressure=means(parameters.pressure_channel) - STANDARD_PRESSURE)
    return states


def _known_monitors(parameters: ErrorModelParameters, units: Mapping[str, str]) -> None:
    """Raises `EstimationError` for a channel of temperature, voltage or pressure that does not exist or is in a unit of another
    dimension."""
    for key, name, dimension, hint in (
        ("temperature_channel", parameters.temperature_channel, "temperature", "name the sensor's own thermometer"),
        ("supply_channel", parameters.supply_channel, "voltage", "name the channel of the supply voltage"),
        ("pressure_channel", parameters.pressure_channel, "pressure", "name the channel of the ambient pressure"),
    ):
        if name is None:
            continue
        if name not in units:
            raise EstimationError(f"there is no channel '{name}'", hint, key)
        if unit(units[name]).dimension != DIMENSIONS[dimension]:
            raise EstimationError(f"'{name}' is in {units[name]}, which is not a unit of {dimension}", hint, key)


def _inseparable(one: ModelledOutput, segments: Sequence[Segment]) -> list[Remark]:
    """Returns an error, with a remedy, if the planned segments do not determine or separate some amplitudes."""
    amplitudes = one.columns.amplitudes
    seen = rank.look(_matrix(one) / one.columns.magnitudes)
    if not len(seen.null):
        return []
    names = rank.unidentifiable(seen.null, one.names)
    effects = {item.effect.id: item.effect for item, name in zip(amplitudes, one.names, strict=True) if name in names}
    wanted = [f"for {name}: {words}" for name, effect in effects.items() if (words := shown_by(effect))]
    where = f"rank {seen.rank} of {len(amplitudes)} from {len(segments)} segments"
    message = f"cannot identify {', '.join(names)} of {one.name} ({where}): {rank.explain(seen.null, one.names)}"
    hint = f"leave terms out, or record segments that show them ({'; '.join(wanted)})" if wanted else "leave terms out"
    last = {combination[-1][0] for combination in rank.combinations(seen.null, one.names)}
    terms = [((item.effect.id, item.name), name in last) for item, name in zip(amplitudes, one.names, strict=True)]
    return [
        Remark(
            "physics-rank",
            message,
            hint,
            f"outputs.{one.name}",
            error=True,
            superfluous=tuple(term for term, out in terms if out),
            keeps=tuple(term for term, out in terms if not out),
        )
    ]


def _shares(one: ModelledOutput, segments: Sequence[Segment]) -> Array:
    """Returns the fraction of each segment's rate that acts along the input axis of an output, shape (n, 1); zero for an
    accelerometer."""
    axis = np.eye(3)[one.errors.axis]
    return shares_along(segments, [axis if one.errors.kind == "gyro" else 0 * axis])


def _fitted(
    request: EstimateRequest[ErrorModelParameters], group: Together, shown: Collection[str] = ()
) -> list[FittedOutput]:
    """Fits all outputs of a group. `shown`: names of the drift functions that at least one output shows.

    A first fit gives approximate amplitudes for each output. The approximate amplitudes determine how strongly errors of the table
    and the site affect the output.
    """
    parameters, basis = request.parameters, request.parameters.uncertainty
    recorded = [request.segments[row] for row in group.rows]
    together = observe(recorded, [one.name for one in group.outputs], request.sensor)
    group, together = with_shapes(group, together, recorded)
    seen, abouts = [], []
    for k, one in enumerate(group.outputs):
        whole = _of_channel(together, k)
        if one.within is not None:
            error = np.where(np.isnan(one.within.moved_error), whole.standard_error[:, 0], one.within.moved_error)
            whole = replace(whole, mean=one.within.mean[:, None], standard_error=error[:, None])
        left = _with_contrasts(replace(whole, mean=whole.mean - np.reshape(one.ideal, (-1, 1))), one)
        seen.append((whole, left))
        about = coefficients_by_noise(_matrix(one), left, one.columns.magnitudes, one.names)
        abouts.append(one.response(about[0]))
    responses = _stacked(abouts)
    inputs = request.setup.inputs
    flicker = flicker_errors(together, inputs, parameters.drift_span.value)
    unstated = unstated_flicker(together, inputs, parameters.drift_span.value)
    acting = table_errors(group.model, group.segments, request.site, request.setup, responses)
    drift = replace(
        drift_of(parameters.drift, parameters.temperature_channel, together, recorded, request.segments),
        fits=len(parameters.outputs),
        shown=frozenset(shown),
    )
    counts = thermometer_counts(recorded, parameters.temperature_channel, request.sensor)
    common, rounding = thermometer_errors(group.model, counts, responses)
    site = (
        *common,
        *site_errors(group.model, group.segments, request.site, inputs, responses),
        *meter_errors(group.model, request.name, parameters, request.sensor.nominal_supply, responses),
    )
    found = []
    for k, (one, (whole, left)) in enumerate(zip(group.outputs, seen, strict=True)):
        contrasts = None if one.within is None else one.within.contrasts
        effects = (
            *(_extended(error, contrasts, own=True) for error in _of_output(flicker, k)),
            *(_extended(error, contrasts) for error in _of_output((*acting, *rounding), k)),
            *_of_angle(one),
        )
        courses = [course for course in drift.courses if not _modelled(course, drift, one)]
        own = replace(drift, courses=tuple(replace(c, columns=_padded(c.columns, contrasts)) for c in courses))
        silent = [_extended(error, contrasts, own=True) for error in _of_output(unstated, k)]
        fit = fit_outputs(
            _matrix(one), left, one.columns.magnitudes, one.names, basis, effects=effects, drift=own, unstated=silent
        )
        require_basis(fit, basis, f"{request.name}, {one.name}")
        acting_here = tuple(_extended(e, contrasts) for e in _of_output(site, k))
        found.append(FittedOutput(one, whole, fit, acting_here, _of_reference(one, group.outputs)))
    return found


def _of_reference(one: ModelledOutput, outputs: Sequence[ModelledOutput]) -> tuple[CorrelatedError, ...]:
    """Returns the error in the response of a gyro due to the noise of the channels that show a recorded motion. This noise makes a
    fitted response too small, by a fraction between zero and an upper limit (`WithinFit.dilution`). All gyros share these channels.
    The fraction is therefore at most the largest limit among the gyros whose scale factors are fitted. Accelerometers are left out.
    They respond to a specific force and, with a lever arm, to the rotation, and the noise reduces these two responses by different
    fractions."""
    if one.within is None or one.errors.kind != "gyro" or not one.within.dilution:
        return ()
    limits = [
        other.within.dilution
        for other in outputs
        if other.within is not None and other.gain is not None and other.errors.kind == "gyro"
    ]
    most = min(one.within.dilution, max(limits, default=one.within.dilution))
    quantity = InputQuantity(
        DILUTION,
        0.0,
        "1",
        most / math.sqrt(3),
        distribution="rectangular",
        source="residuals of the fit",
        from_residuals=True,
    )
    rows = np.concatenate([np.zeros(len(one.within.mean)), -one.within.contrasts.moved])
    return (CorrelatedError(quantity, {0: rows[:, None]}),)


def _of_angle(one: ModelledOutput) -> list[CorrelatedError]:
    """Returns the errors that an unknown angle of a turning table causes in the means and in the contrasts within segments."""
    if one.within is None or not one.within.phase.any():
        return []
    quantity = InputQuantity("angle of the table", 0.0, "1", 1.0, source="no channel shows the angle")
    return [CorrelatedError(quantity, {0: np.vstack([one.within.phase, one.within.contrasts.phase])})]


def _matrix(one: ModelledOutput) -> Array:
    """Returns the design matrix (n + r, p), with one row for each mean, followed by one row for each contrast within a segment."""
    matrix = one.columns.matrix
    return matrix if one.within is None else np.vstack([matrix, one.within.contrasts.matrix])


def _with_contrasts(means: Observations, one: ModelledOutput) -> Observations:
    """Returns the observations of one output: the means of the segments, followed by the contrasts within segments."""
    if one.within is None or not len(one.within.contrasts.sigma):
        return means
    contrasts = one.within.contrasts
    r = len(contrasts.sigma)
    start, end = float(means.start.min()), float(means.end.max())
    return replace(
        means,
        labels=(*means.labels, *(WITHIN,) * r),
        mean=np.vstack([means.mean, contrasts.values[:, None]]),
        standard_error=np.vstack([means.standard_error, contrasts.sigma[:, None]]),
        batches=np.append(means.batches, np.full(r, means.batches.max())),
        start=np.append(means.start, np.full(r, start)),
        end=np.append(means.end, np.full(r, end)),
        share=None if means.share is None else np.append(means.share, np.ones(r)),
        courses=None if means.courses is None else (*means.courses, *(np.zeros((0, 0)),) * r),
        within=r,
    )


def _block_with_contrasts(block: DesignBlock, one: ModelledOutput) -> DesignBlock:
    if one.within is None:
        return block
    contrasts = one.within.contrasts
    labels = (*block.labels, *(WITHIN,) * len(contrasts.sigma))
    return replace(block, matrix=_matrix(one), sigma=np.append(block.sigma, contrasts.sigma), labels=labels)


def _padded(rows: Array, contrasts: Contrasts | None) -> Array:
    """Appends rows of zeros for the contrasts to the rows (n, …) of the means."""
    if contrasts is None:
        return rows
    return np.concatenate([rows, np.zeros((len(contrasts.sigma), *rows.shape[1:]))])


def _extended(error: CorrelatedError, contrasts: Contrasts | None, own: bool = False) -> CorrelatedError:
    """Adds the contrasts within segments to an error of the means. Most errors do not change the contrasts, so their entries for
    the contrasts are zero. `own`: True for flicker, which also changes the contrasts."""
    if contrasts is None or not len(contrasts.sigma):
        return error
    changes = {}
    for k, change in error.changes.items():
        changes[k] = _padded(change, contrasts)
        if own:
            root = np.vstack([np.zeros((len(change), len(contrasts.sigma))), contrasts.flicker])
            changes[k] = np.hstack([changes[k], root])
    return replace(error, changes=changes, within={k: _padded(one, contrasts) for k, one in error.within.items()})


def _modelled(course: DriftCourse, drift: DriftCourses, output: ModelledOutput) -> bool:
    """Returns True if the plan's effects include the temperature dependence of an output's bias. In this case, no drift with
    temperature is fitted to this output."""
    return (
        drift.by_evidence
        and bool(course.changed)
        and any(
            isinstance(one.effect, FollowsTemperature) and one.name == one.effect.with_temperature
            for one in output.columns.amplitudes
        )
    )


def _of_channel(together: Observations, k: int) -> Observations:
    """Returns the observations of the k-th channel alone."""
    return replace(
        together,
        channels=together.channels[k : k + 1],
        units=together.units[k : k + 1],
        mean=together.mean[:, k : k + 1],
        standard_error=together.standard_error[:, k : k + 1],
        correlation=np.ones((1, 1)),
    )


def _contradictions(request: EstimateRequest[ErrorModelParameters], outputs: Sequence[FittedOutput]) -> list[Said]:
    """Returns warnings about outputs whose response contradicts the declarations."""
    found = []
    for kind in KINDS:
        rows = [
            AxisResponse(
                one.model.name, one.model.errors.axis, one.model.unit, one.model.ratios(one.fit.coefficients[0])
            )
            for one in outputs
            if one.model.errors.kind == kind and one.model.direct and one.model.gain is not None
        ]
        found += contradictions(rows)
    counted = []
    for one in outputs:
        nominal = request.sensor.nominal.get(f"K_{one.model.name}", 0.0) / one.model.unit.factor
        if nominal and not one.model.direct and one.model.gain is not None:
            name = one.model.names[one.model.gain]
            counted.append((name, float(one.fit.coefficients[0, one.model.gain]), nominal))
    return found + against_nominal(counted)


def _stacked(rows: Sequence[Array]) -> Array:
    """Returns the coefficients of all outputs as a matrix with one row per output, shape (m, P). A row is zero at the coefficients
    of other outputs."""
    ends = np.cumsum([len(row) for row in rows])
    made = np.zeros((len(rows), int(ends[-1])))
    for k, (row, end) in enumerate(zip(rows, ends, strict=True)):
        made[k, end - len(row) : end] = row
    return made


def _of_output(errors: Sequence[CorrelatedError], output: int) -> tuple[CorrelatedError, ...]:
    """Returns the errors, restricted to their effect on one output."""
    return tuple(
        replace(
            one,
            changes={0: one.changes[output]},
            within={0: one.within[output]} if output in one.within else {},
        )
        for one in errors
        if output in one.changes
    )


def _stated(request: EstimateRequest[ErrorModelParameters], one: FittedOutput) -> tuple[Influence, ...]:
    """Returns the influences of stated inputs on the fitted amplitudes of one output."""
    functionals = functionals_of(one.fit.gains)
    recorded = replace(request, segments=tuple(request.segments[row] for row in one.model.rows))
    return (
        *(error.through(functionals) for error in (*one.site, *one.dilution)),
        *resolution_influences(recorded, [one.model.name], functionals),
        *one.fit.influences(request.parameters.uncertainty),
    )


def _between(request: EstimateRequest[ErrorModelParameters], outputs: Sequence[FittedOutput]) -> dict[str, Array]:
    """Returns, for each kind of uncertainty, the covariance between the amplitudes of different outputs, shape (p, p) for p
    amplitudes of all outputs. The correlation of the outputs' noise comes from the segments that all these outputs use."""
    rows = [one.model.rows for one in outputs]
    shared = sorted(set.intersection(*map(set, rows)))
    if len(outputs) < 2 or not shared:
        return {}
    recorded = [request.segments[row] for row in shared]
    correlation = observe(recorded, [one.model.name for one in outputs], request.sensor).correlation
    fits = [one.fit for one in outputs]
    return {
        basis: between_outputs(fits, rows, correlation, basis)
        for basis in BASES
        if all(fit.available(basis) for fit in fits)
    }


def _disagreement(request: EstimateRequest[ErrorModelParameters], made: ModelQuantities) -> list[Said]:
    """Returns a warning for each common amplitude for which the outputs give different values."""
    from scipy.special import chdtrc

    separate = made.separate
    covariance = separate.covariance(request.parameters.uncertainty)
    acting = separate.influences([_stated(request, one) for one in made.outputs])
    covariance = covariance + sum(
        (one.covariance for one in merged(acting) if not one.in_scatter), np.zeros_like(covariance)
    )
    square, freedom = made.common.disagreement(separate.values, covariance)
    if not freedom or float(chdtrc(freedom, square)) >= SIGNIFICANCE:
        return []
    names = [
        one.name for one, places in zip(made.common.amplitudes, made.common.members, strict=True) if len(places) > 1
    ]
    return [
        counted(
            "{names}: the outputs give different values (χ² = {chi_square:.3g} with {freedom} degree of "
            "freedom), although all of them have this parameter in common: something else acts on them, or the "
            "model of an output is incomplete.",
            "{names}: the outputs give different values (χ² = {chi_square:.3g} with {freedom} degrees of "
            "freedom), although all of them have this parameter in common: something else acts on them, or the "
            "model of an output is incomplete.",
            count=freedom,
            names=tuple(names),
            chi_square=square,
            freedom=freedom,
        )
    ]


def _common_table(made: ModelQuantities, basis: str) -> list[Table]:
    """Returns a table with the value that each output alone gives for each common amplitude."""
    common, separate = made.common, made.separate
    members = zip(common.amplitudes, common.members, strict=True)
    rows = [(amplitude, place) for amplitude, places in members if len(places) > 1 for place in places]
    if not rows:
        return []
    at = [place for _, place in rows]
    table = by_columns(
        "Coefficients that outputs have in common",
        (TableColumn("coefficient"), [amplitude.name for amplitude, _ in rows]),
        (TableColumn("output"), [common.outputs[place] for place in at]),
        (TableColumn("value from this output alone", Role.VALUE), separate.values[at]),
        (TableColumn("u", Role.STANDARD_UNCERTAINTY), separate.spread(basis)[0][at]),
        (TableColumn("unit"), [amplitude.unit for amplitude, _ in rows]),
    )
    return [table]


def _as_added(outputs: Sequence[FittedOutput], common: CommonAmplitudes, found: Derived) -> dict[str, dict[str, str]]:
    """Returns the values in the form in which a bench file states them for `driver: added_effects`: maps each effect to its
    parameters, and each parameter to its value with unit. Scale factors of outputs whose unit is not a rate or an acceleration are
    omitted, because they are not effects."""
    held = {
        place: value for places, value in zip(common.members, found.values.tolist(), strict=True) for place in places
    }
    values = iter([held[place] for place in range(len(held))])
    made: dict[str, dict[str, str]] = {}
    for one in outputs:
        letter = "xyz"[one.model.errors.axis]
        for amplitude, coefficient in zip(one.model.columns.amplitudes, one.model.coefficients, strict=True):
            value, effect = next(values), amplitude.effect
            if one.model.within is not None and isinstance(effect, HasShape):
                if amplitude.alone and sum(_names(other.model, effect.id) for other in outputs) > 1:
                    continue  # a bench states one shape for all outputs
                name = f"{amplitude.name}_{letter}" if amplitude.alone and not amplitude.shape else amplitude.name
                stated = made.setdefault(effect.id, {})
                stated[name] = f"{value:.9g} {coefficient.unit}"
                stated.setdefault(effect.shape_name, f"{one.model.within.shapes[effect.id]:.9g} {effect.shape_unit}")
            elif isinstance(effect, ShapedOverSegments):
                if sum(shaped_part(other.model) is not None for other in outputs) > 1:
                    continue  # a bench states one shape for all outputs
                name = f"{amplitude.name}_{letter}" if amplitude.name != effect.shape_name else amplitude.name
                made.setdefault(effect.id, {})[name] = f"{value:.9g} {coefficient.unit}"
            elif one.model.direct or amplitude.along != one.model.errors.axis:
                name = f"{amplitude.name}_{letter}" if amplitude.alone else amplitude.name
                made.setdefault(amplitude.effect.id, {})[name] = f"{value:.9g} {coefficient.unit}"
    return made


def _names(one: ModelledOutput, effect: str) -> bool:
    """Returns True if the model of an output contains an effect."""
    return any(part.effect.id == effect for part in one.errors.chosen)


def _diluted(one: FittedOutput, basis: str) -> list[Said]:
    """Returns a warning if the noise of the channels that show a recorded motion may change a coefficient by more than twice its
    standard uncertainty. This standard uncertainty does not include the noise of these channels."""
    spreads = np.sqrt(np.diag(one.fit.covariance(basis)))
    for error in one.dilution:
        most = math.sqrt(3) * error.quantity.standard_uncertainty
        moved = np.abs(functionals_of(one.fit.gains)[:, 0] @ error.changes[0][:, 0])
        if np.any(moved * most > 2 * spreads):
            return [
                said(
                    "{output}: the noise or the counts of the channels that show the motion may make the response of the output too small, "
                    "by up to {share:.3g} % according to the residuals. The values are not corrected, but the uncertainties include this "
                    "error. State a longer time in `averaging`, or use a reference with less noise or finer counts.",
                    output=one.model.name,
                    share=100 * most,
                )
            ]
    return []


def _of_samples(one: FittedOutput) -> list[Said]:
    """Returns warnings about the fit to an output's samples."""
    within, found = one.model.within, []
    if within is None:
        return []
    for effect in within.at_bound:
        found.append(
            said(
                "{output}: the shape of {effect} is at a bound of the catalogue ({value:.4g}), so its interval is not reliable: "
                "leave the effect out, or record segments that show it.",
                output=one.model.name,
                effect=effect,
                value=within.shapes[effect],
            )
        )
    if within.coloured > 1:
        found.append(
            said(
                "{output}: within the segments, the means of consecutive samples vary {ratio:.3g} times as much (variance) as white noise "
                "and the declared bias instability explain: the noise is coloured, or the model is incomplete. The uncertainties of "
                "effects within segments are increased accordingly.",
                output=one.model.name,
                ratio=within.coloured,
            )
        )
    if within.uneven > within.coloured:
        found.append(
            said(
                "{output}: the amplitudes that single segments give vary up to {ratio:.3g} times as much (variance) as the noise explains: "
                "the channels that show the motion have errors that differ from segment to segment, or the model is incomplete. The "
                "uncertainties of effects within segments are increased accordingly.",
                output=one.model.name,
                ratio=within.uneven,
            )
        )
    return found
