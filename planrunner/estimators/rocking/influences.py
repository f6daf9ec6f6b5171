"""Computes the Type B influences on the drifts of a rocking test.

Some effects differ from run to run: accelerometer stability and noise, drift, azimuth after caging, and counts. These effects are
part of the scatter between repeated runs, so the budget lists them for comparison but does not add them. The prediction of a run
uses them. Other effects are common to all runs: site and installation angles. These common effects are added to the budget; they
almost cancel between static and dynamic runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

import numpy as np

from planrunner.base.arrays import Array
from planrunner.estimators.interface import DesignRequest, EstimateRequest
from planrunner.estimators.rocking.attitude import turned_by
from planrunner.estimators.rocking.parameters import RockingDriftParameters
from planrunner.estimators.rocking.solution import (
    ReducedRun,
    RockingConditions,
    accelerometer_drift,
    gimbal_drift,
    several_conditions,
    several_runs,
)
from planrunner.estimators.rocking.statistics import AXES, WEIGHTS, CombinedDrifts
from planrunner.estimators.stated_errors import stated_site
from planrunner.physics.earth import Site
from planrunner.plan.units import unit
from planrunner.uncertainty.budget import merged
from planrunner.uncertainty.conditions import StatedCondition, influences_on_several
from planrunner.uncertainty.influences import Influence, InputQuantity

T = TypeVar("T")
Runs = Sequence[Sequence[Sequence[ReducedRun]]]
"""The runs: for each state, a list of quadruples, each of which consists of four runs."""
Request = EstimateRequest[RockingDriftParameters] | DesignRequest[RockingDriftParameters]
AT_ONCE = 50_000
"""Number of samples of all variants together that are processed in one step."""
DEG_PER_HOUR = math.degrees(1.0) * 3600


def conditions_of(site: Site, parameters: RockingDriftParameters) -> RockingConditions:
    return RockingConditions(site.earth_rate_enu, site.gravity, parameters.installation_angles.angles())


def drifts_of(reduced: ReducedRun, conditions: RockingConditions) -> Array:
    """Computes the drifts of one run [deg/h] about the two level axes. Returns an array of shape (…, 2), or (…, 4) if there are
    encoders: first the drifts computed from the accelerometers, then the drifts computed from the gimbals."""
    parts = [accelerometer_drift(reduced, conditions)]
    if reduced.first.turn is not None:
        parts.append(gimbal_drift(reduced, conditions))
    return np.concatenate(np.broadcast_arrays(*parts), axis=-1) * DEG_PER_HOUR


def influences_of(
    runs: Runs,
    combined: CombinedDrifts,
    conditions: RockingConditions,
    request: EstimateRequest[RockingDriftParameters],
) -> tuple[Influence, ...]:
    def formula(moved: Sequence[RockingConditions]) -> Array:
        return _coefficients(runs, combined, moved)

    found = list(influences_on_several(formula, _of_all_runs(conditions, request)))
    for share, state in zip(combined.shares, runs, strict=True):
        for four in state:
            for reduced, weight in zip(four, WEIGHTS, strict=True):
                own = influences_on_several(partial(_drifts_of_variants, conditions), _of_one_run(reduced, request))
                found += [one.through(share * weight / len(state)) for one in own]
    return merged(found)


def expected_scatter(reduced: ReducedRun, conditions: RockingConditions, request: Request) -> Array:
    """Computes, from the declared effects, how the drifts of one run scatter about the mean of all runs. Returns the covariance of
    the k drifts [deg²/h²], shape (k, k)."""
    own = influences_on_several(partial(_drifts_of_variants, conditions), _of_one_run(reduced, request))
    count = len(drifts_of(reduced, conditions))
    return np.asarray(sum((one.covariance for one in own), np.zeros((count, count))))


def _of_all_runs(
    conditions: RockingConditions, request: EstimateRequest[RockingDriftParameters]
) -> Iterator[StatedCondition[RockingConditions]]:
    """Yields the inputs whose errors all runs have in common: latitude, gravity, azimuth and installation angles."""
    inputs = request.setup.inputs
    for stated in stated_site(inputs, request.site):
        yield stated.seen_by(lambda site: replace(conditions, earth=site.earth_rate_enu, gravity=site.gravity))
    if (azimuth := inputs.get("azimuth")) is not None:
        yield StatedCondition.single(azimuth, lambda by: replace(conditions, turned=by))
    for k, (name, angle) in enumerate(request.parameters.installation_angles.stated().items()):
        if angle.standard_uncertainty:
            quantity = InputQuantity(
                f"installation angle {name}",
                angle.value,
                "rad",
                angle.standard_uncertainty,
                angle.degrees_of_freedom,
                angle.shape,
                source=f"plan installation_angles.{name}",
            )
            yield StatedCondition.single(quantity, partial(_installed, conditions, k))


def _installed(conditions: RockingConditions, k: int, by: float) -> RockingConditions:
    return replace(
        conditions, installation=conditions.installation + by * (np.arange(len(conditions.installation)) == k)
    )


def _coefficients(runs: Runs, combined: CombinedDrifts, each: Sequence[RockingConditions]) -> Array:
    """Returns the k resulting coefficients under each of m conditions, shape (m, k)."""
    total = np.zeros((len(each), len(combined.axes)))
    for share, state in zip(combined.shares, runs, strict=True):
        for four in state:
            for reduced, weight in zip(four, WEIGHTS, strict=True):
                parts = [drifts_of(reduced, several_conditions(some)) for some in _portions(each, reduced)]
                total += weight * np.concatenate(parts) @ share.T / len(state)
    return total


def _drifts_of_variants(conditions: RockingConditions, each: Sequence[ReducedRun]) -> Array:
    """Returns the drifts of m variants of one run, shape (m, 2) or (m, 4)."""
    return np.concatenate([drifts_of(several_runs(some), conditions) for some in _portions(each, each[0])])


def _portions(each: Sequence[T], reduced: ReducedRun) -> Iterator[Sequence[T]]:
    """Splits a list of conditions, or of variants of a run, into parts that are small enough to need little memory, even if the
    windows have many samples."""
    size = max(1, AT_ONCE // max(len(reduced.first.time), len(reduced.second.time)))
    for first in range(0, len(each), size):
        yield each[first : first + size]


def _of_one_run(reduced: ReducedRun, request: Request) -> Iterator[StatedCondition[ReducedRun]]:
    """Yields the inputs whose errors differ from run to run."""
    parameters, label = request.parameters, reduced.run.label
    names = {axis: f"{label} {AXES[axis]}" for axis in reduced.run.state.level}
    accelerometers = {name: partial(_tilted, reduced, axis) for axis, name in names.items()}
    drifting = {name: partial(_drifting, reduced, axis) for axis, name in names.items()}
    if repeatability := parameters.drift_repeatability:
        quantity = InputQuantity("drift", 0.0, "rad/s", repeatability.value, source="plan drift_repeatability")
        yield StatedCondition(quantity, drifting, in_scatter=True)
    if walk := parameters.random_walk:
        rate = walk.value / math.sqrt(reduced.seconds)
        quantity = InputQuantity("random walk", 0.0, "rad/s", rate, source="plan random_walk, from t0 to t1")
        yield StatedCondition(quantity, drifting, in_scatter=True)
    if noise := _noise(request):
        quantity = InputQuantity("accelerometer noise", 0.0, "m/s^2", noise, source="bench sensor")
        yield StatedCondition(quantity, accelerometers, in_scatter=True)
    stability = parameters.accelerometer_stability
    if stability is not None and stability.value:
        quantity = InputQuantity(
            "accelerometer stability", 0.0, "m/s^2", stability.value, source="plan accelerometer_stability"
        )
        yield StatedCondition(quantity, accelerometers, in_scatter=True)
    count = resolution(request, parameters)
    if count:
        # Two readings, each rounded: √2 · count/√12.
        quantity = InputQuantity(
            "accelerometer resolution",
            0.0,
            "m/s^2",
            count / math.sqrt(6),
            distribution="triangular",
            source="bench sensor",
        )
        yield StatedCondition(quantity, accelerometers, in_scatter=True)
    azimuth = azimuth_uncertainty(request)
    if azimuth is not None:
        yield StatedCondition(azimuth, {label: lambda by: replace(reduced, off=by)}, in_scatter=True)
    table = request.setup.table
    moved = reduced.run.dynamic and reduced.second.turn is not None
    if moved and table is not None and table.position_uncertainty:
        # The error of a ring that has moved differs between t0 and t1; the gimbal method interprets the difference as drift of the element.
        off = math.sqrt(2) * table.position_uncertainty
        quantity = InputQuantity(
            "table position", 0.0, "rad", off, source="bench table position_uncertainty, at t0 and at t1"
        )
        rings = {name: partial(_ringed, reduced, axis) for axis, name in names.items()}
        yield StatedCondition(quantity, rings, in_scatter=True)


def _tilted(reduced: ReducedRun, axis: int, by: float) -> ReducedRun:
    """Returns a variant of the run in which the reading of one accelerometer is larger by `by` [m/s^2] in the second window.
    `axis`: axis of this accelerometer."""
    second = reduced.second
    return replace(reduced, second=replace(second, readings=second.readings + by * np.eye(3)[axis]))


def _drifting(reduced: ReducedRun, axis: int, by: float) -> ReducedRun:
    """Returns a variant of the run in which the element also drifts at the rate `by` [rad/s] about one of its axes. `axis`: this
    axis."""
    second, vector = reduced.second, by * reduced.seconds * np.eye(3)[axis]
    readings = second.readings @ turned_by(vector[None])[0].T
    turn = None if second.turn is None else second.turn + vector
    return replace(reduced, second=replace(second, readings=readings, turn=turn))


def _ringed(reduced: ReducedRun, axis: int, by: float) -> ReducedRun:
    """Returns a variant of the run in which the attitude from the encoders is wrong by the angle `by` [rad] in the second window.
    `axis`: axis of the element about which the attitude is wrong."""
    second = reduced.second
    assert second.turn is not None
    return replace(reduced, second=replace(second, turn=second.turn + by * np.eye(3)[axis]))


def _noise(request: Request) -> float:
    """Returns the standard deviation [m/s^2] that white noise causes in the difference between the readings of an accelerometer in
    two windows. The readings have passed the low-pass filter. The result is for the noisiest accelerometer."""
    parameters = request.parameters
    averaging = max(parameters.window.value, 0.5 / parameters.cutoff.value)
    declared = [request.sensor.output(name) for name in parameters.accelerometers]
    sizes = [one.noise.white * unit(one.unit).factor for one in declared if one is not None]
    return math.sqrt(2 / averaging) * max(sizes, default=0.0)


def azimuth_uncertainty(request: Request) -> InputQuantity | None:
    """Returns the uncertainty of the element's azimuth at t0 in one run; None if it is not stated."""
    parameters = request.parameters
    if parameters.azimuth_uncertainty is not None:
        value, source = parameters.azimuth_uncertainty.value, "plan azimuth_uncertainty"
    elif parameters.azimuth == "encoders" and request.setup.table is not None:
        value, source = request.setup.table.position_uncertainty, "bench table position_uncertainty"
    else:
        return None
    return InputQuantity("azimuth of the element", 0.0, "rad", value, source=source) if value else None


def resolution(request: Request, parameters: RockingDriftParameters) -> float:
    """Returns the largest count of all accelerometers [m/s^2], as declared in the bench file; 0 if none is declared."""
    counts = [0.0]
    for name in parameters.accelerometers:
        output = request.sensor.output(name)
        if output is not None and output.noise.resolution:
            counts.append(output.noise.resolution * unit(output.unit).factor)
    return max(counts)
