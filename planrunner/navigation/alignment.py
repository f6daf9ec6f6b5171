"""Aligns a sensor at rest. The coarse alignment uses the directions of gravity and of the Earth's rotation. The fine alignment uses
the fact that the velocity should be zero.

In the coarse alignment, the mean specific force f points up, and the cross product ω × f with the mean rate ω points east
(Britting, "Inertial Navigation Systems Analysis", 1971, chapter 9). In the fine alignment, the navigator starts with the coarse
attitude. Because the unit does not move, any computed velocity is an error. This velocity is the measurement of a Kalman filter
with the linear error equations. The filter estimates tilt and azimuth with their covariance (gyrocompassing). Small rotations of
the unit (swaying) are permitted, because the gyros measure them.

While the unit keeps its attitude, constant sensor errors cannot be distinguished from tilt and azimuth (`ErrorEquations.levelled`).
If the unit is turned about the vertical, with stops in between, these errors can be distinguished. The filter then has further
states: the constant sensor errors, and the gyro errors due to scale factor and misalignment, which are proportional to the rate of
turn.
"""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.navigation import attitude
from planrunner.navigation.error_equations import EAST_VELOCITY, INPUTS, SIZE, TILT, ErrorEquations

STILLNESS = 1e-3  # m/s; standard uncertainty of the zero velocity at each knot
_ALL = SIZE + INPUTS + 3
_UNCHANGED = np.eye(_ALL)
_SEEN = slice(EAST_VELOCITY, EAST_VELOCITY + 2)
_MEASURED = STILLNESS**2 * np.eye(2)
_AT_ONCE = 512  # knots whose transitions are computed together
_PER_TURN = 1e-4  # standard uncertainty of scale factor and misalignment before alignment: 100 ppm, 20 arcsec
_PRIOR = math.radians(10)  # standard uncertainty of the coarse attitude; so wide that it adds no information


@dataclass(frozen=True, slots=True)
class Alignment:
    """Result of an alignment.

    `rotation`: array of shape (3, 3), body axes as columns in East-North-Up. `covariance`: array of shape (16, 16), covariance of
    the errors that remain: the 7 states of `error_equations`, the 6 constant sensor errors, and 3 gyro errors that are proportional
    to the rate of turn, per unit of this rate. The sensor errors are in body axes. `constant`: array of shape (6,), estimates of
    the constant sensor errors, rad/s and m/s². `consistency`: root mean square of the innovations, each divided by its expected
    standard deviation. `consistency` is usually about 1; a smaller value is harmless. `largest`: the largest innovation, m/s.
    `followed`: array of shape (16, 6, m), the remaining errors if one of the 6 sensors has an error of 1 rad/s or 1 m/s² in one of
    m intervals of the alignment. If the intervals are not requested, m is 0.
    """

    rotation: Array
    covariance: Array
    constant: Array
    consistency: float
    largest: float
    followed: Array = field(default_factory=lambda: np.zeros((_ALL, INPUTS, 0)))

    @property
    def tilt_covariance(self) -> Array:
        """Returns the covariance of the tilt and azimuth errors [rad²], shape (3, 3)."""
        return self.covariance[TILT, TILT]


def coarse(rate: Array, force: Array) -> Array:
    """Computes the attitude at rest. Returns the body axes as columns in East-North-Up, shape (3, 3). `rate`, `force`: arrays of
    shape (3,), mean rate and mean specific force in body axes."""
    up = force / np.linalg.norm(force)
    east = np.cross(rate, up)
    east /= np.linalg.norm(east)
    return np.vstack([east, np.cross(up, east), up])


class FineAlignment:
    """Computes the fine alignment with a Kalman filter. The filter processes the velocities of the navigator at its output times
    (knots); at the end, it returns the attitude."""

    def __init__(
        self,
        equations: ErrorEquations,
        density: Array,
        seconds: float,
        constant: Array | None = None,
        follow: float | None = None,
    ):
        """`density`: array of shape (6, 6) in navigation axes, the covariance by which the integrated outputs of the gyros [rad²/s]
        and accelerometers [(m/s)²/s] grow per second. `seconds`: time between two knots, which are the output times of the
        navigator, s. `constant`: array of shape (6,), standard uncertainty of the constant sensor errors before the alignment; None
        if they are not estimated. `follow`: length of the intervals for `Alignment.followed`, s; None if the intervals are not
        requested."""
        self._transition = np.eye(_ALL)
        self._transition[:SIZE, :SIZE], self._response = equations.step(seconds)
        self._added = np.zeros((_ALL, _ALL))
        self._added[:SIZE, :SIZE] = equations.noise(density, seconds)
        self._state = np.zeros(_ALL)
        before = np.zeros(INPUTS + 3) if constant is None else np.append(constant, [_PER_TURN] * 3)
        self._covariance = np.diag([0.0, 0, STILLNESS**2, STILLNESS**2, *[_PRIOR**2] * 3, *before**2])
        self._squares, self._count, self._largest = 0.0, 0, 0.0
        self._each = None if follow is None else follow / seconds  # knots in an interval
        # For each interval: the errors that its sensor errors cause at its end, and the transition matrix from start to end.
        self._left: list[Array] = []
        self._passed: list[Array] = []

    def take(self, velocities: Array, rotations: Array, turns: Array) -> None:
        """Processes the measurements at the next m knots.

        `velocities`: array of shape (m, 2), velocity east and north, m/s. `rotations`: array of shape (m, 3, 3), body axes as
        columns, averaged over the time before each knot. `turns`: array of shape (m,), mean rate about the vertical in this time,
        rad/s.
        """
        for first in range(0, len(velocities), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            transitions = self._transitions(rotations[part], turns[part])
            for found, transition in zip(velocities[part], transitions, strict=True):
                self._update(found, transition)

    def _transitions(self, rotations: Array, turns: Array) -> Array:
        """Returns the transition matrices of the errors over the time before each knot, shape (m, 16, 16)."""
        found = np.repeat(self._transition[None], len(rotations), axis=0)
        by_gyros = self._response[:, :3] @ rotations
        found[:, :SIZE, SIZE : SIZE + 3] = by_gyros
        found[:, :SIZE, SIZE + 3 : SIZE + 6] = self._response[:, 3:] @ rotations
        found[:, :SIZE, SIZE + 6 :] = turns[:, None, None] * by_gyros
        return found

    def _update(self, found: Array, transition: Array) -> None:
        state = transition @ self._state
        covariance = transition @ self._covariance @ transition.T + self._added
        expected = covariance[_SEEN, _SEEN] + _MEASURED
        innovation = found - state[_SEEN]
        (a, b), (_, d) = expected.tolist()
        inverse = np.array([[d, -b], [-b, a]]) / (a * d - b * b)
        gain = covariance[:, _SEEN] @ inverse
        self._state = state + gain @ innovation
        kept = _UNCHANGED.copy()
        kept[:, _SEEN] -= gain
        self._covariance = kept @ covariance @ kept.T + STILLNESS**2 * (gain @ gain.T)
        if self._each is not None:
            self._follow(kept, transition, int(self._count / 2 / self._each))
        self._squares += float(innovation @ inverse @ innovation)
        self._count += 2
        self._largest = max(self._largest, *map(abs, innovation.tolist()))

    def _follow(self, kept: Array, transition: Array, interval: int) -> None:
        """After a measurement, updates the responses of the remaining errors to constant sensor errors in each interval.
        `interval`: index of the present interval. The initial states of the alignment do not contain these sensor errors;
        therefore, the responses start at zero."""
        while len(self._left) <= interval:
            self._left.append(np.zeros((_ALL, INPUTS)))
            self._passed.append(_UNCHANGED)
        step = kept @ transition
        self._left[-1] = step @ self._left[-1] + kept[:, :SIZE] @ transition[:SIZE, SIZE : SIZE + INPUTS]
        self._passed[-1] = step @ self._passed[-1]

    def _followed(self) -> Array:
        """Returns the errors that remain because of sensor errors in each of the m intervals, shape (16, 6, m)."""
        found, since = np.zeros((_ALL, INPUTS, len(self._left))), _UNCHANGED
        for k in reversed(range(len(self._left))):
            found[:, :, k] = since @ self._left[k]
            since = since @ self._passed[k]
        return found

    def finish(self, rotation: Array) -> Alignment:
        """Returns the result of the alignment. `rotation`: array of shape (3, 3), attitude of the navigator at the end of the
        alignment. The end is less than one knot interval after the last knot."""
        consistency = math.sqrt(self._squares / self._count) if self._count else math.nan
        aligned = attitude.small_rotation(self._state[TILT]) @ rotation
        constant = self._state[SIZE : SIZE + INPUTS].copy()
        return Alignment(aligned, self._covariance.copy(), constant, consistency, self._largest, self._followed())
