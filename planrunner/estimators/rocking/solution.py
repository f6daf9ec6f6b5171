"""Drift of one run from its two windows: from gravity in the accelerometers, and from gimbal and ring angles.

Drift is that of the element against inertial space: the tilt that an inertially fixed element shows, C(t0)·R(Ω_ie·t), is subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planrunner.archive.recording import RecordedSegment
from planrunner.estimators.interface import EstimateRequest, EstimationError
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

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the solution rests on beside the data. earth: (3,) rad/s, East-North-Up; gravity: m/s^2; installation: (6,) rad, in the order
    of `rocking_parameters.INSTALLATION`; turned: rad, by which the table's azimuth is really farther east."""

    earth: Array
    gravity: float
    installation: Array
    turned: float = 0.0

    @property
    def felt_earth(self) -> Array:
        """Earth rate in the site axes that the planned orientation refers to."""
        east, north, up = self.earth
        c, s = np.cos(self.turned), np.sin(self.turned)
        return np.array([c * east - s * north, s * east + c * north, up])

    def compensated(self, readings: Array) -> Array:
        """Specific force in element axes (n, 3) from the accelerometers (n, 3)."""
        xz, xy, yz, yx, zy, zx = self.installation
        matrix = np.array([[1.0, xz, -xy], [-yz, 1.0, yx], [zy, -zx, 1.0]])
        return np.asarray(np.linalg.solve(matrix, readings.T).T)


@dataclass(frozen=True, slots=True)
class Window:
    """Filtered samples of one window. time: (n,) s; readings: (n, 3) m/s^2; turn: (n, 3) rad, rotation vector from the planned attitude
    to that of the encoders, None without encoders."""

    time: Array
    readings: Array
    turn: Array | None


@dataclass(frozen=True, slots=True)
class ReducedRun:
    """A run as its two windows. nominal_azimuth: where the azimuth at t0 is taken from the planned orientation. off: rad, by which the
    azimuth of this run is taken to be wrong, for sensitivities."""

    run: Run
    first: Window
    second: Window
    nominal_azimuth: bool
    off: float = 0.0

    @property
    def seconds(self) -> float:
        """t1 − t0."""
        return float(self.second.time.mean() - self.first.time.mean())


def reduce_run(
    run: Run, recorded: RecordedSegment, request: EstimateRequest, windows: Windows, encoders: bool
) -> ReducedRun:
    """Read, filter and cut one recorded run. Raises `EstimationError` for data that cannot serve."""
    parameters: RockingDriftParameters = request.parameters
    channels = [*parameters.accelerometers, *((*parameters.rings, *parameters.gimbals) if encoders else ())]
    made = []
    for piece, begin in zip(read_pieces(recorded, channels, windows), (windows.first, windows.second), strict=True):
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
    return ReducedRun(run, made[0], made[1], parameters.azimuth == "nominal")


def accelerometer_drift(reduced: ReducedRun, conditions: Conditions) -> Array:
    """Steps 2 to 5: drift [rad/s] about the two level axes, in the order x, y, z, shape (2,)."""
    state, gravity, earth = reduced.run.state, conditions.gravity, conditions.felt_earth
    windows = (reduced.first, reduced.second)
    tilts = [state.tilts(conditions.compensated(window.readings), gravity) for window in windows]
    zero = float(reduced.first.time.mean())
    start = state.attitude(tilts[0].mean(axis=0), _heading(reduced, earth, zero) + reduced.off)
    left = []
    for window, seen in zip(windows, tilts, strict=True):
        fixed = start @ earth_turn(earth, window.time - zero)
        left.append(seen - state.tilts(gravity * (fixed @ UP), gravity))
    count = min(len(left[0]), len(left[1]))
    return np.asarray(np.mean(left[1][:count] - left[0][:count], axis=0) / reduced.seconds)


def gimbal_drift(reduced: ReducedRun, conditions: Conditions) -> Array:
    """Drift [rad/s] about the two level axes from the attitude that rings and gimbals show, shape (2,)."""
    state, earth = reduced.run.state, conditions.felt_earth
    zero = float(reduced.first.time.mean())
    in_space = [
        turned_by(window.turn) @ state.nominal @ np.swapaxes(earth_turn(earth, window.time - zero), 1, 2)
        for window in (reduced.first, reduced.second)
        if window.turn is not None
    ]
    start = in_space[0][len(in_space[0]) // 2]
    angles = [rotation_vector(attitude @ start.T).mean(axis=0) for attitude in in_space]
    return np.asarray(((angles[1] - angles[0]) / reduced.seconds)[list(state.level)])


def _heading(reduced: ReducedRun, earth: Array, zero: float) -> float:
    """The element's turn about the vertical at t0."""
    state, turn = reduced.run.state, reduced.first.turn
    if reduced.nominal_azimuth or turn is None:
        return state.heading(state.nominal @ earth_turn(earth, np.array([zero + reduced.run.lead]))[0])
    return state.heading(turned_by(turn.mean(axis=0)[None])[0] @ state.nominal)


def _encoder_turn(run: Run, angles: Array, request: EstimateRequest) -> Array:
    parameters: RockingDriftParameters = request.parameters
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
            f"rings and gimbals of '{run.label}' show an attitude {worst:.0f} deg from the planned one: check `rings`, `gimbals` and "
            "`gimbal_axes` against the bench"
        )
    return turn


def _plausible(run: Run, window: Window, request: EstimateRequest) -> None:
    state, gravity = run.state, request.site.gravity
    force = window.readings.mean(axis=0)
    size = float(np.linalg.norm(force))
    if abs(size / gravity - 1) > 0.02:
        raise EstimationError(
            f"the accelerometers of '{run.label}' show {size / gravity:.3f} of local gravity: check their unit, scale and range"
        )
    if state.sign * force[state.vertical] < 0.9 * gravity:
        raise EstimationError(
            f"the accelerometers of '{run.label}' do not show gravity along {'xyz'[state.vertical]} as the orientation "
            f"'{run.segment.orientation}' has it: check axes and signs"
        )
