"""Examines the planned rates before anything moves: predicts the uncertainties of scale factors of tilted axes, and reports missing
parts of the plan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from planrunner.estimators.expected import planned_blocks
from planrunner.estimators.full_scale import beyond_full_scale
from planrunner.estimators.interface import Design, DesignBlock, DesignRequest, EstimationError, Remark
from planrunner.estimators.tilted.fixture_calibration import require_calibration
from planrunner.estimators.tilted.mounted_axes import MountedAxes, mounted_axes, rotation_axis, seeing
from planrunner.estimators.tilted.mounting_comparison import scheduled_seconds, time_note
from planrunner.estimators.tilted.parameters import ScaleFactorTiltedParameters
from planrunner.estimators.tilted.rate_lines import line_through
from planrunner.estimators.tilted.rate_series import (
    RateSeries,
    by_temperature,
    has_both_signs,
    split_series,
)
from planrunner.estimators.tilted.turning_rates import part_turns

FEEBLE = 0.1  # cosine (84.3 deg) below which an axis senses less than a tenth of the rate


def design(request: DesignRequest[ScaleFactorTiltedParameters]) -> Design:
    """Returns the design of the estimator for planned segments. Raises `EstimationError` if the plan is not suitable for the
    method."""
    outputs = [output.name for output in request.sensor.outputs]
    axes = seeing(mounted_axes(request.setup.mounting, outputs, request.parameters.outputs))
    require_calibration(axes, request.uses)
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
    return Design(blocks, notes=(note,), remarks=remarks)


def _blocks(request: DesignRequest[ScaleFactorTiltedParameters], axes: MountedAxes) -> tuple[DesignBlock, ...]:
    """Makes the design blocks: for each output, a straight line through all planned rates. The blocks contain the rate of the table
    instead of the rate along the axis."""
    spins = tuple(segment for segment in request.segments if segment.rate)
    rates = np.array([segment.rate for segment in spins])
    matrix, magnitudes = line_through(rates)
    return planned_blocks(replace(request, segments=spins), axes.outputs, ("offset", "rate"), matrix, magnitudes)


# -- what the plan lacks ---------------------------------------------------------------------------------------------


def _remarks(
    request: DesignRequest[ScaleFactorTiltedParameters], axes: MountedAxes, series: Sequence[RateSeries]
) -> Iterator[Remark]:
    yield from _series_remarks(request, series)
    yield from _earth_remarks(request, axes)
    yield from beyond_full_scale(request, axes.outputs, rotation_axis(request.segments) @ axes.directions.T)
    for name, angle in zip(axes.names, axes.angles, strict=True):
        if abs(math.cos(angle)) < FEEBLE:
            yield Remark(
                "physics-mounting",
                f"mounting.{name} at {math.degrees(angle):.4g} deg senses {abs(math.cos(angle)):.2g} of the rate, and an error of one "
                f"arc-minute in its angle changes its scale factor by {abs(math.tan(angle)) * math.radians(1 / 60) * 1e6:.0f} ppm",
                "mount the axis at a smaller angle to the rotation axis",
            )
    others = [name for name in request.setup.mounting if name not in axes.names]
    if others:
        yield Remark(
            "physics-mounting",
            f"mounting.{others[0]} is not used: none of `outputs` belongs to it",
            "add its output, or remove the axis from `mounting`",
            "outputs",
        )


def _series_remarks(
    request: DesignRequest[ScaleFactorTiltedParameters], series: Sequence[RateSeries]
) -> Iterator[Remark]:
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
            "all rates have the same sign, so asymmetry cannot be determined, and F0 includes any offset that depends on the sense of "
            "rotation",
            "write the rates with ±",
        )
    repeats = {kelvin: len(held) for kelvin, held in by_temperature(series).items()}
    if not lacking and request.parameters.uncertainty == "repeats" and min(repeats.values(), default=2) < 2:
        yield Remark(
            "physics-repeats",
            "at some temperature the rates are run only once, so the uncertainty cannot be based on their repeatability",
            "add `repeat: 6`, or write `uncertainty: residual`",
            "uncertainty",
            error=True,
        )


def _earth_remarks(request: DesignRequest[ScaleFactorTiltedParameters], axes: MountedAxes) -> Iterator[Remark]:
    how, planned = request.parameters.earth_rate, request.segments
    slow = [segment for segment in planned if 0 < abs(segment.rate) < request.site.earth_rate]
    if slow:
        yield Remark(
            "physics-slow-rate",
            f"'{slow[0].label}' turns at {math.degrees(abs(slow[0].rate)) * 3600:.3g} deg/h, more slowly than the "
            f"Earth: the axes then sense mainly the Earth's rotation, not the table's",
            "turn faster than 15 deg/h",
        )
    parts = part_turns(planned, [segment.dwell for segment in planned], [0.0] * len(planned))
    if how == "corrected":
        axes.require_azimuths()
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
