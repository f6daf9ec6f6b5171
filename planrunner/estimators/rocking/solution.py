"""Computes the drift of one run between its two windows: once from the direction of gravity that the accelerometers show, and once
from gimbal and ring angles.

The drift is the rotation of the element relative to inertial space. The attitude of an element that is fixed in inertial space
changes relative to the Earth as C(t0)·R(Ω_ie·t). The tilt that this change causes is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planrunner.archive.recording import RecordedSegment
from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.estimators.interface import EstimateRequest, EstimationError, Setup
from planrunner.estimators.rocking.attitude import (
    UP,
    earth_turn,
    encoder_attitude,
    rotation_vector,
    turned_by,
)
from planrunner.estimators.rocking.parameters import RockingDriftParameters
from planrunner.estimators.rocking.runs import Run
from planrunner.estimators.rocking.windows import Windows, low_pass, read_pieces, within


@dataclass(frozen=True, slots=True)
class RockingConditions:
    """States the conditions under which drifts are computed.

    `earth`: array of shape (3,), Earth rate in East-North-Up, rad/s. `gravity`: magnitude of gravity, m/s^2. `installation`: array
    of shape (6,) in rad, installation angles in the order of `Installation.stated`. `turned`: error of the table's azimuth, rad;
    positive if the true azimuth is farther east than assumed.

    One object can hold m conditions (see `several_conditions`); its arrays then have a leading axis of length m."""

    earth: Array
    gravity: Array | float
    installation: Array
    turned: Array | float = 0.0

    @property
    def felt_earth(self) -> Array:
        """Returns the Earth rate [rad/s] in the site axes to which the planned orientation refers, shape (…, 3)."""
        east, north, up = np.moveaxis(self.earth, -1, 0)
        c, s = np.cos(self.turned), np.sin(self.turned)
        return np.stack([c * east - s * north, s * east + c * north, up], axis=-1)

    @property
    def inputs(self) -> Array:
        """Returns the matrix that converts specific force in element axes to the accelerometers' readings, shape (…, 3, 3)."""
        xz, xy, yz, yx, zy, zx = np.moveaxis(self.installation, -1, 0)
        one = np.ones_like(xz)
        return np.stack([one, xz, -xy, -yz, one, yx, zy, -zx, one], axis=-1).reshape(*xz.shape, 3, 3)

    def compensated(self, readings: Array) -> Array:
        """Computes the specific force in element axes from the accelerometers' readings. Both arrays have the shape (…, n, 3)."""
        return np.asarray(readings @ np.swapaxes(np.linalg.inv(self.inputs), -1, -2))


@dataclass(frozen=True, slots=True)
class Window:
    """The filtered samples of one window.

    `time`: array of shape (n,) in s. `readings`: array of shape (…, n, 3) in m/s^2, readings of the accelerometers. `turn`: array
    of shape (…, n, 3) in rad, rotation vector from the planned attitude to the attitude that the encoders show, None without
    encoders.
    """

    time: Array
    readings: Array
    turn: Array | None


@dataclass(frozen=True, slots=True)
class ReducedRun:
    """The windows of one run.

    `before`: the window that ends when the base begins to rock; None if there is no such window. `lead`: time [s] from the release
    to the start of the record. If it is given, the azimuth at t0 is computed from the planned orientation and from the Earth's
    rotation since the release. If it is None, the encoders give the azimuth at t0. `off`: assumed error of the azimuth of this run,
    rad, from which sensitivities are computed.

    One object can hold m variants of a run (see `several_runs`); `off` and the arrays of the second window then have a leading axis
    of length m."""

    run: Run
    first: Window
    second: Window
    before: Window | None
    lead: float | None
    off: Array | float = 0.0

    @property
    def seconds(self) -> float:
        """Returns the time between the windows, t1 − t0 [s]."""
        return float(self.second.time.mean() - self.first.time.mean())


def reduce_run(
    run: Run,
    recorded: RecordedSegment,
    request: EstimateRequest[RockingDriftParameters],
    windows: Windows,
    encoders: bool,
) -> ReducedRun:
    """Reads and filters one recorded run, and cuts out its windows. Raises `EstimationError` if the data are unsuitable.
    `encoders`: True if ring and gimbal angles are used."""
    parameters = request.parameters
    channels = [*parameters.accelerometers, *((*parameters.rings, *parameters.gimbals) if encoders else ())]
    made = []
    windows = windows.with_rest(run.rest_before)
    for piece, begin in zip(read_pieces(recorded, channels, windows), windows.begins, strict=True):
        columns = piece.values
        if encoders:
            turn = _encoder_turn(run, columns[:, 3:], request)
            columns = np.column_stack([columns[:, :3], turn])
        inside = within(piece, begin, windows.length)
        if not inside.any():
            raise EstimationError(
                f"'{run.label}' has no sample in the window at {begin:g} s: it was cut short, or sampled too slowly"
            )
        filtered = low_pass(replace(piece, values=columns), windows.cutoff)[inside]
        time = piece.time[inside]
        made.append(Window(time, filtered[:, :3], filtered[:, 3:] if encoders else None))
    _plausible(run, made[0], request)
    lead = None
    if parameters.azimuth == "nominal" or not encoders:
        lead = lead_of(run, parameters, request.setup, recorded.in_mode)
    return ReducedRun(run, made[0], made[1], made[2] if len(made) > 2 else None, lead)


def expected_run(run: Run, times: tuple[float, float], conditions: RockingConditions, encoders: bool) -> ReducedRun:
    """Computes the windows of an expected run, in which the element is fixed in inertial space. `times`: t0 and t1, s from the
    start of the record. `encoders`: True if ring and gimbal angles are used."""
    windows = []
    for time in np.array(times):
        attitude = run.state.nominal @ earth_turn(conditions.felt_earth, np.array([time + run.planned_lead]))
        readings = conditions.gravity * (attitude @ UP) @ conditions.inputs.T
        turn = rotation_vector(attitude @ run.state.nominal.T) if encoders else None
        windows.append(Window(np.array([time]), readings, turn))
    return ReducedRun(run, windows[0], windows[1], None, None if encoders else run.planned_lead)


def lead_of(run: Run, parameters: RockingDriftParameters, setup: Setup, in_mode: float | None = None) -> float:
    """Returns the time [s] from the release to the start of the record. If the plan states `released_before`, this time is
    returned. Otherwise, the time is `in_mode`, which the run recorded. If neither is known, the time is `Run.planned_lead`, which
    follows from the schedule. Raises `EstimationError` if neither is known and the bench plays back a recording."""
    if parameters.released_before is not None:
        return parameters.released_before.value
    if in_mode is not None:
        return in_mode
    if setup.replayed:
        raise EstimationError(
            f"the time from release to the record of '{run.label}' is not known: write `released_before`, `0 s` where "
            "records begin with the release"
        )
    return run.planned_lead


def several_conditions(each: Sequence[RockingConditions]) -> RockingConditions:
    """Combines m conditions into one object. The drifts computed with this object have the shape (m, 2)."""
    return RockingConditions(
        np.stack([one.earth for one in each]),
        np.array([one.gravity for one in each]),
        np.stack([one.installation for one in each]),
        np.array([one.turned for one in each]),
    )


def several_runs(each: Sequence[ReducedRun]) -> ReducedRun:
    """Combines m variants of a run into one object; the variants differ in the second window and in `off`. The drifts computed from
    this object have the shape (m, 2)."""
    second, turns = each[0].second, [one.second.turn for one in each if one.second.turn is not None]
    readings = np.stack([one.second.readings for one in each])
    window = replace(second, readings=readings, turn=np.stack(turns) if turns else None)
    return replace(each[0], second=window, off=np.array([one.off for one in each]))


def accelerometer_drift(reduced: ReducedRun, conditions: RockingConditions) -> Array:
    """Computes the drift [rad/s] about the two level axes by steps 2 to 5. Returns an array of shape (…, 2); the axes are in the
    order x, y, z."""
    return _drift_between(reduced, reduced.second, conditions)


def drift_before_rocking(reduced: ReducedRun, conditions: RockingConditions) -> Array | None:
    """Computes the drift [rad/s] about the two level axes before rocking begins, by steps 2 to 5. The drift is computed from the
    first window to the window that ends when the base begins to rock. Returns an array of shape (…, 2), or None if there is no such
    window."""
    return None if reduced.before is None else _drift_between(reduced, reduced.before, conditions)


def _drift_between(reduced: ReducedRun, later: Window, conditions: RockingConditions) -> Array:
    angles = [drift_angles(reduced, conditions, window.time, window.readings) for window in (reduced.first, later)]
    count = min(one.shape[-2] for one in angles)
    seconds = float(later.time.mean() - reduced.first.time.mean())
    return np.asarray(np.mean(angles[1][..., :count, :] - angles[0][..., :count, :], axis=-2) / seconds)


def drift_angles(reduced: ReducedRun, conditions: RockingConditions, time: Array, readings: Array) -> Array:
    """Computes the tilts [rad] about the two level axes, minus the tilts of an inertially fixed element that has the same attitude
    at t0. Returns an array of shape (…, n, 2).

    `time`: array of shape (n,), s from the start of the record. `readings`: array of shape (…, n, 3) in m/s^2, readings of the
    accelerometers at these times.
    """
    state, earth = reduced.run.state, conditions.felt_earth
    gravity = np.asarray(conditions.gravity)[..., None]
    zero = float(reduced.first.time.mean())
    tilt = state.tilts(conditions.compensated(reduced.first.readings), gravity).mean(axis=-2)
    start = state.attitude(tilt, _heading(reduced, earth, zero) + reduced.off)
    up = earth_turn(earth, time - zero)[..., 2] @ np.swapaxes(start, -1, -2)  # of the fixed element, in element axes
    return np.asarray(state.tilts(conditions.compensated(readings), gravity) - state.tilts(up, 1.0))


def gimbal_drift(reduced: ReducedRun, conditions: RockingConditions) -> Array:
    """Returns the drift [rad/s] about the two level axes, computed from ring and gimbal angles, shape (…, 2)."""
    state, earth = reduced.run.state, conditions.felt_earth
    zero = float(reduced.first.time.mean())
    in_space = [
        turned_by(window.turn) @ state.nominal @ np.swapaxes(earth_turn(earth, window.time - zero), -1, -2)
        for window in (reduced.first, reduced.second)
        if window.turn is not None
    ]
    middle = in_space[0].shape[-3] // 2
    start = np.swapaxes(in_space[0][..., middle : middle + 1, :, :], -1, -2)
    angles = [rotation_vector(attitude @ start).mean(axis=-2) for attitude in in_space]
    return np.asarray(((angles[1] - angles[0]) / reduced.seconds)[..., list(state.level)])


def _heading(reduced: ReducedRun, earth: Array, zero: float) -> Array:
    """Returns the rotation (…) of the element about the vertical at t0, rad. `earth`: array of shape (…, 3), Earth rate in site
    axes, rad/s. `zero`: the time t0, s from the start of the record."""
    state, turn = reduced.run.state, reduced.first.turn
    if reduced.lead is not None or turn is None:
        assert reduced.lead is not None  # without encoders the azimuth is nominal
        return state.heading(state.nominal @ earth_turn(earth, np.array([zero + reduced.lead]))[..., 0, :, :])
    return state.heading(turned_by(turn.mean(axis=0)) @ state.nominal)


def _encoder_turn(run: Run, angles: Array, request: EstimateRequest[RockingDriftParameters]) -> Array:
    parameters = request.parameters
    table = request.setup.table
    assert table is not None
    count = len(parameters.rings)
    rings, gimbals = list(angles[:, :count].T), list(angles[:, count:].T)
    axes = ["xyz".index(name) for name in parameters.gimbal_axes]
    directions = [axis.direction for axis in table.axes]
    attitude = encoder_attitude(rings, directions, request.site.azimuth, gimbals, axes)
    turn = rotation_vector(attitude @ run.state.nominal.T)
    if float(np.abs(turn).max()) > 0.5:
        worst = np.degrees(np.abs(turn).max())
        raise EstimationError(
            f"the rings and gimbals of '{run.label}' give an attitude {worst:.0f} deg from the planned one: check `rings`, `gimbals` and "
            "`gimbal_axes` against the bench"
        )
    return turn


def _plausible(run: Run, window: Window, request: EstimateRequest[RockingDriftParameters]) -> None:
    state, gravity = run.state, request.site.gravity
    force = window.readings.mean(axis=0)
    size = float(np.linalg.norm(force))
    if abs(size / gravity - 1) > 0.02:
        raise EstimationError(
            f"the accelerometers of '{run.label}' show {size / gravity:.3f} of local gravity: check their unit, scale and range"
        )
    if state.sign * force[state.vertical] < 0.9 * gravity:
        raise EstimationError(
            f"the accelerometers of '{run.label}' do not show gravity along {'xyz'[state.vertical]} as the "
            f"orientation '{run.segment.orientation}' requires: check axes and signs"
        )
