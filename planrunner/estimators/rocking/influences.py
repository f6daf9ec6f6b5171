"""Influences on rocking drifts other than the data.

Whatever differs from run to run (accelerometer stability, azimuth after caging, counts) shows in the scatter of the repeats: it is listed
in the budget, so that it can be compared with what is expected, and not added again. What all runs share (site, installation angles) is
added; nearly all of it cancels between static and dynamic runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from planrunner.estimators.interface import EstimateRequest
from planrunner.estimators.rocking.parameters import INSTALLATION, RockingDriftParameters
from planrunner.estimators.rocking.solution import ReducedRun, RockingConditions, accelerometer_drift, gimbal_drift
from planrunner.estimators.rocking.statistics import WEIGHTS, CombinedDrifts
from planrunner.physics.earth import Site
from planrunner.plan.units import unit
from planrunner.uncertainty.influences import Influence, InputQuantity

Array = NDArray[np.float64]
Runs = Sequence[Sequence[Sequence[ReducedRun]]]
"""State by state, quadruple by quadruple, four runs each."""
DEG_PER_HOUR = math.degrees(1.0) * 3600
STEP = 1e-5  # rad, of the difference quotients


def conditions_of(site: Site, parameters: RockingDriftParameters) -> RockingConditions:
    return RockingConditions(site.earth_rate_enu, site.gravity, parameters.installation_angles.angles())


def drifts_of(reduced: ReducedRun, conditions: RockingConditions) -> Array:
    """Drifts of one run [deg/h]: two level axes by the accelerometers, then by the gimbals where there are encoders; shape (2,) or (4,)."""
    parts = [accelerometer_drift(reduced, conditions)]
    if reduced.first.turn is not None:
        parts.append(gimbal_drift(reduced, conditions))
    return np.concatenate(parts) * DEG_PER_HOUR


def influences_of(
    runs: Runs,
    combined: CombinedDrifts,
    conditions: RockingConditions,
    request: EstimateRequest[RockingDriftParameters],
) -> tuple[Influence, ...]:
    found = _shared(runs, combined, conditions, request)
    for quantity, change in _of_each_run(request):
        columns = [
            combined.shares[s] @ (change(reduced) * weight / len(state))
            for s, state in enumerate(runs)
            for four in state
            for reduced, weight in zip(four, WEIGHTS, strict=True)
        ]
        found.append(Influence(quantity, np.concatenate(columns, axis=1), in_scatter=True))
    return tuple(found)


def _shared(
    runs: Runs,
    combined: CombinedDrifts,
    conditions: RockingConditions,
    request: EstimateRequest[RockingDriftParameters],
) -> list[Influence]:
    """Latitude, gravity, azimuth and installation angles act on all runs alike."""
    inputs, site = request.setup.inputs, request.site
    parameters = request.parameters
    changes: list[tuple[InputQuantity, RockingConditions, float]] = []
    if (latitude := inputs.get("latitude")) is not None:
        farther = replace(site, latitude=site.latitude + STEP).earth_rate_enu
        changes.append((latitude, replace(conditions, earth=farther), STEP))
    if (gravity := inputs.get("gravity")) is not None:
        changes.append((gravity, replace(conditions, gravity=site.gravity * (1 + STEP)), site.gravity * STEP))
    if (azimuth := inputs.get("azimuth")) is not None:
        changes.append((azimuth, replace(conditions, turned=STEP), STEP))
    for k, name in enumerate(INSTALLATION):
        angle = getattr(parameters.installation_angles, name)
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
            moved = conditions.installation + STEP * (np.arange(len(INSTALLATION)) == k)
            changes.append((quantity, replace(conditions, installation=moved), STEP))
    before = _coefficients(runs, combined, conditions)
    return [
        Influence(quantity, ((_coefficients(runs, combined, changed) - before) / step)[:, None])
        for quantity, changed, step in changes
    ]


def _coefficients(runs: Runs, combined: CombinedDrifts, conditions: RockingConditions) -> Array:
    total = np.zeros(len(combined.axes))
    for share, state in zip(combined.shares, runs, strict=True):
        for four in state:
            drifts = np.array([drifts_of(reduced, conditions) for reduced in four])
            total += share @ (WEIGHTS @ drifts) / len(state)
    return total


def _of_each_run(
    request: EstimateRequest[RockingDriftParameters],
) -> list[tuple[InputQuantity, Callable[[ReducedRun], Array]]]:
    """Quantities that are drawn anew in each run, with ∂drift [deg/h]/∂input of a run, shape (k, inputs)."""
    parameters = request.parameters
    found: list[tuple[InputQuantity, Callable[[ReducedRun], Array]]] = []

    def accelerometers(reduced: ReducedRun) -> Array:
        """∂/∂(change of an accelerometer between the windows), 1/(g·(t1 − t0)) for the one that shows the tilt: (k, 2)."""
        columns = np.zeros((2 if reduced.first.turn is None else 4, 2))
        columns[0, 0] = columns[1, 1] = DEG_PER_HOUR / (request.site.gravity * reduced.seconds)
        return columns

    stability = parameters.accelerometer_stability
    if stability is not None and stability.value:
        quantity = InputQuantity(
            "accelerometer stability", 0.0, "m/s^2", stability.value, source="plan accelerometer_stability"
        )
        found.append((quantity, accelerometers))
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
        found.append((quantity, accelerometers))
    azimuth = azimuth_uncertainty(request)
    if azimuth is not None:
        conditions = conditions_of(request.site, parameters)

        def heading(reduced: ReducedRun) -> Array:
            moved = drifts_of(replace(reduced, off=STEP), conditions)
            return np.asarray((moved - drifts_of(reduced, conditions)) / STEP)[:, None]

        found.append((azimuth, heading))
    if request.setup.table is not None and request.setup.table.position_uncertainty:
        # The error of a ring differs between t0 and t1; the gimbal method interprets the difference as drift of the element.
        off = math.sqrt(2) * request.setup.table.position_uncertainty
        quantity = InputQuantity(
            "table position", 0.0, "rad", off, source="bench table position_uncertainty, at t0 and at t1"
        )
        found.append((quantity, _gimbal_columns))
    return found


def _gimbal_columns(reduced: ReducedRun) -> Array:
    """∂/∂(change of the base's attitude that the rings do not show), (k, 2)."""
    columns = np.zeros((2 if reduced.first.turn is None else 4, 2))
    if reduced.first.turn is not None:
        columns[2, 0] = columns[3, 1] = DEG_PER_HOUR / reduced.seconds
    return columns


def azimuth_uncertainty(request: EstimateRequest[RockingDriftParameters]) -> InputQuantity | None:
    """Uncertainty of the element's azimuth at t0 in one run; None if not stated."""
    parameters = request.parameters
    if parameters.azimuth_uncertainty is not None:
        value, source = parameters.azimuth_uncertainty.value, "plan azimuth_uncertainty"
    elif parameters.azimuth == "encoders" and request.setup.table is not None:
        value, source = request.setup.table.position_uncertainty, "bench table position_uncertainty"
    else:
        return None
    return InputQuantity("azimuth of the element", 0.0, "rad", value, source=source) if value else None


def resolution(request: EstimateRequest[RockingDriftParameters], parameters: RockingDriftParameters) -> float:
    """One count of the coarsest accelerometer [m/s^2], as the bench declares it; 0 where it does not."""
    counts = [0.0]
    for name in parameters.accelerometers:
        output = request.sensor.output(name)
        if output is not None and output.noise.resolution:
            counts.append(output.noise.resolution * unit(output.unit).factor)
    return max(counts)
