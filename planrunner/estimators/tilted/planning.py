"""What planned rates will tell of tilted axes, before anything moves: uncertainties to expect, and what the plan lacks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.flicker import SPAN, planned_flicker
from planrunner.estimators.full_scale import beyond_full_scale
from planrunner.estimators.interface import Coefficient, Design, DesignBlock, DesignRequest, EstimationError, Remark
from planrunner.estimators.planned import planned_blocks
from planrunner.estimators.slope_units import rate_and_output, slope_unit
from planrunner.estimators.tilted.evaluation import Conditions, Group, answers_of, evaluate, make_group, worst_of
from planrunner.estimators.tilted.fixture_calibration import planned_axes
from planrunner.estimators.tilted.influences import Situation, common_rate, influences
from planrunner.estimators.tilted.mounted_axes import MountedAxes, mounted_axes, rotation_axis, seeing
from planrunner.estimators.tilted.mounting_comparison import scheduled_seconds, time_note
from planrunner.estimators.tilted.rate_series import (
    RateSeries,
    by_temperature,
    has_both_signs,
    split_series,
    temperature_label,
)
from planrunner.estimators.tilted.results import coefficients, items
from planrunner.estimators.tilted.scatter import Noise, gradient_of, noise_of_means, scatter_of_means, whole
from planrunner.estimators.tilted.turning_rates import as_recording_begins, mean_rates, part_turns
from planrunner.plan.schedule import Segment
from planrunner.uncertainty.budget import merged

Array = NDArray[np.float64]

FEEBLE = 0.1  # cosine (84.3 deg) below which an axis sees a tenth of the rate, and its angle counts ten times


def design(request: DesignRequest) -> Design:
    """Raises `EstimationError` where the plan makes no sense for the method."""
    outputs = [output.name for output in request.sensor.outputs]
    axes, fixture = planned_axes(
        seeing(mounted_axes(request.setup.mounting, outputs, request.parameters.outputs)), request.uses
    )
    series = split_series(request.segments, request.parameters.zero)
    rotation_axis(request.segments)
    remarks = tuple(_remarks(request, axes, series))
    blocks = _blocks(request, axes)
    complete = [one for one in series if not one.lacks]
    if (
        any(remark.error for remark in remarks)
        or not complete
        or np.unique([block.matrix[:, 1] for block in blocks]).size < 2
    ):
        return Design(blocks, remarks=remarks)
    waiting = scheduled_seconds(request.segments, [None] * len(request.segments))
    note = time_note(waiting, len(axes.names), request.parameters.remounting.value)
    return Design(
        blocks, _predicted(request, axes, fixture, complete), (note,), _by_temperature(axes, complete), remarks
    )


def _by_temperature(axes: MountedAxes, complete: Sequence[RateSeries]) -> dict[str, object]:
    """What the estimate will give over temperature; nothing where only the recording can tell its temperature."""
    planned = [kelvin for kelvin in by_temperature(complete) if kelvin is not None]
    if not planned:
        return {}
    return {"temperatures": tuple(planned), "names_by_temperature": tuple(f"K_{axis}" for axis in axes.names)}


def _blocks(request: DesignRequest, axes: MountedAxes) -> tuple[DesignBlock, ...]:
    """A line through all planned rates, for each output; the rate of the table stands for that of the axis."""
    spins = tuple(segment for segment in request.segments if segment.rate)
    rates = np.array([segment.rate for segment in spins])
    matrix = np.column_stack([np.ones(len(rates)), rates])
    magnitudes = np.array([1.0, float(np.abs(rates).max(initial=1e-12))])
    return planned_blocks(replace(request, segments=spins), axes.outputs, ("offset", "rate"), matrix, magnitudes)


# -- what the plan lacks ---------------------------------------------------------------------------------------------


def _remarks(request: DesignRequest, axes: MountedAxes, series: Sequence[RateSeries]) -> Iterator[Remark]:
    yield from _series_remarks(request, series)
    yield from _earth_remarks(request, axes)
    yield from beyond_full_scale(request, axes.outputs, rotation_axis(request.segments) @ axes.directions.T)
    for name, angle in zip(axes.names, axes.angles, strict=True):
        if abs(math.cos(angle)) < FEEBLE:
            yield Remark(
                "physics-mounting",
                f"mounting.{name} at {math.degrees(angle):.4g} deg sees {abs(math.cos(angle)):.2g} of the rate, and an arc-minute of "
                f"its angle is {abs(math.tan(angle)) * math.radians(1 / 60) * 1e6:.0f} ppm of its scale factor",
                "mount the axis nearer to the rotation axis",
            )
    others = [name for name in request.setup.mounting if name not in axes.names]
    if others:
        yield Remark(
            "physics-mounting",
            f"mounting.{others[0]} is not used: none of `outputs` belongs to it",
            "add its output, or take it out of `mounting`",
            "outputs",
        )


def _series_remarks(request: DesignRequest, series: Sequence[RateSeries]) -> Iterator[Remark]:
    lacking = [one for one in series if one.lacks]
    if lacking:
        more = f" (and {len(lacking) - 1} more series)" if len(lacking) > 1 else ""
        yield Remark(
            "physics-zero",
            f"{lacking[0].name} has no {lacking[0].lacks}{more}: F_r is the mean of the zeros before and after the rates",
            "record the sensor at rest before and after the rates, name these segments in `zero` and choose them in `segments`",
            "zero",
            error=True,
        )
    rates = np.array([request.segments[index].rate for one in series for index in one.spins])
    if rates.size and not has_both_signs(rates):
        yield Remark(
            "physics-both-signs",
            "all rates have one sign, so there is no asymmetry, and an offset that depends on the sense of rotation is in F0",
            "write the rates with ±",
        )
    repeats = {kelvin: len(held) for kelvin, held in by_temperature(series).items()}
    if not lacking and request.parameters.uncertainty == "repeats" and min(repeats.values(), default=2) < 2:
        yield Remark(
            "physics-repeats",
            "at some temperature the rates are run once, so the uncertainty cannot rest on how they repeat",
            "add `repeat: 6`, or write `uncertainty: residual`",
            "uncertainty",
            error=True,
        )


def _earth_remarks(request: DesignRequest, axes: MountedAxes) -> Iterator[Remark]:
    how, planned = request.parameters.earth_rate, request.segments
    slow = [segment for segment in planned if 0 < abs(segment.rate) < request.site.earth_rate]
    if slow:
        yield Remark(
            "physics-slow-rate",
            f"'{slow[0].label}' turns at {math.degrees(abs(slow[0].rate)) * 3600:.3g} deg/h, more slowly than the Earth: its rotation, not "
            "the table's, decides what the axes feel",
            "turn faster than 15 deg/h",
        )
    parts = part_turns(planned, [segment.dwell for segment in planned], [0.0] * len(planned))
    if how == "corrected":
        axes.require_azimuths("`earth_rate: corrected` needs; or write `earth_rate: averaged`")
        unknown = next((segment.label for segment in planned if segment.attitude is None), None)
        if unknown is not None:
            raise EstimationError(
                f"the orientation of '{unknown}' is unknown, so the Earth's rotation cannot be corrected for: write `earth_rate: averaged`"
            )
    elif parts:
        label, turns = parts[0]
        yield Remark(
            "physics-part-turns",
            f"'{label}' covers {turns:.4g} turns, so the Earth's rotation across the rotation axis is not averaged out",
            "write `earth_rate: corrected`, or `dwell: {turns: 1, at_least: …}`",
            "earth_rate",
            error=how == "averaged",
        )


# -- what to expect --------------------------------------------------------------------------------------------------


def _predicted(
    request: DesignRequest, axes: MountedAxes, fixture: Any, complete: Sequence[RateSeries]
) -> tuple[Coefficient, ...]:
    """From declared noise and flicker, and all that is stated of fixture, table and site; none without nominal scale factors."""
    planned = request.segments
    outputs = [request.sensor.output(name) for name in axes.outputs]
    units = [rate_and_output(request.parameters.rate_unit, output.unit) for output in outputs if output is not None]
    slopes = _nominal(request, axes, units)
    if slopes is None:
        return ()
    conditions, begun = _conditions(request, axes)
    felt = conditions.felt if conditions.felt is not None else conditions.along * conditions.commanded[:, None]
    mean = felt @ axes.directions.T * slopes
    groups = tuple(
        make_group(
            repeats, temperature_label(kelvin), math.nan if kelvin is None else kelvin, conditions.commanded, mean
        )
        for kelvin, repeats in by_temperature(complete).items()
    )
    off = [abs(group.kelvin - request.parameters.reference_temperature.value) for group in groups]
    reference = int(np.nan_to_num(off, nan=math.inf).argmin())
    found = evaluate(groups, conditions, reference)
    worst = worst_of(groups, found, reference)
    noise = _noise(request, axes, groups)
    answers = answers_of(groups, conditions, worst)
    scatter = scatter_of_means(groups, found, answers, noise, "within_segment")
    k_spread = np.sqrt(np.diagonal(scatter.covariance, axis1=1, axis2=2)).reshape(found.means.shape)[..., 0]
    repeats = np.sqrt([len(group.names) for group in groups])
    found = replace(found, repeatability=np.abs(k_spread * repeats[:, None] / found.means[..., 0]))
    gradient = gradient_of(found, groups, reference, worst)
    covariance, freedom = whole(found, groups, scatter, gradient)
    seconds = tuple(segment.dwell for segment in planned)
    texts = tuple(own.text for _, own in units)
    situation = Situation(
        groups,
        conditions,
        found,
        worst,
        reference,
        answers,
        gradient,
        begun,
        seconds,
        request.site,
        planned[0].orientation,
        texts,
        fixture,
    )
    common = common_rate(request.name, request.parameters.rate_uncertainty)
    flicker = planned_flicker(planned, axes.outputs, request.setup.inputs, SPAN.value)
    for item in merged(influences(situation, request.setup.inputs, common, "repeats", flicker=flicker)):
        covariance = covariance + item.covariance
    return coefficients(found, items(found, groups, axes, units, reference), covariance, freedom)


def _nominal(request: DesignRequest, axes: MountedAxes, units: Sequence[Any]) -> Array | None:
    """Declared scale factors in output unit/(rad/s), (m,); an output that is a rate has one without a declaration."""
    found = []
    for output, pair in zip(axes.outputs, units, strict=True):
        text, _ = slope_unit(*pair)
        nominal = request.sensor.nominal.get(f"K_{output}", 1.0 if text == "1" else math.nan)
        found.append(nominal / pair[1].factor)
    return np.array(found) if np.isfinite(found).all() else None


def _conditions(request: DesignRequest, axes: MountedAxes) -> tuple[Conditions, tuple[Segment, ...]]:
    planned = request.segments
    commanded, along = np.array([segment.rate for segment in planned]), rotation_axis(planned)
    if request.parameters.earth_rate != "corrected":
        return Conditions(axes, commanded, along, None), planned
    begun = as_recording_begins(planned, request.site, request.setup.table)
    felt = mean_rates(begun, request.site, [segment.dwell for segment in planned])
    return Conditions(axes, commanded, along, felt), begun


def _noise(request: DesignRequest, axes: MountedAxes, groups: Sequence[Group]) -> Noise:
    models = [model for name in axes.outputs if (model := request.sensor.output(name)) is not None]
    sigma = np.array(
        [
            [
                model.noise.standard_error(segment.dwell or 1.0, segment.sample_rate or request.sensor.sample_rate)
                for model in models
            ]
            for segment in request.segments
        ]
    )
    return noise_of_means(groups, sigma, np.eye(len(models)), np.full(len(models), math.inf))
