"""Alignment at rest: coarse from the directions of gravity and of the Earth's rotation, fine from the velocity that ought to be zero.

Coarse: the mean specific force points up, its cross product with the mean rate points east (Britting, "Inertial Navigation Systems
Analysis", 1971, chapter 9). Fine: the navigator runs from the coarse attitude; the velocity that it finds, which is all error, drives a
Kalman filter over the error model of `error_model`, from which tilt and azimuth come with their covariance (gyrocompassing). Swaying that
the gyros follow does no harm; constant sensor errors cannot be told from tilt and azimuth by anything that stands still
(`ErrorModel.levelled`), so the covariance holds the noise alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planrunner.navigation import attitude
from planrunner.navigation.error_model import EAST_VELOCITY, SIZE, TILT, ErrorModel

Array = NDArray[np.float64]

STILLNESS = 1e-3  # m/s; velocity of what stands still, standard uncertainty at each knot
_PRIOR = math.radians(10)  # standard uncertainty of the coarse attitude; the filter must not take it for information


@dataclass(frozen=True, slots=True)
class Alignment:
    """rotation: body axes as columns in East-North-Up, (3, 3). covariance: (3, 3), rad², of the remaining tilt (φ_E, φ_N, φ_U).
    consistency: root mean square of the innovations over what the noise explains, 1 where all is well. largest_velocity: m/s."""

    rotation: Array
    covariance: Array
    consistency: float
    largest_velocity: float


def coarse(rate: Array, force: Array) -> Array:
    """The body axes as columns in East-North-Up, (3, 3), from mean rate and specific force in body axes, (3,) each."""
    up = force / np.linalg.norm(force)
    east = np.cross(rate, up)
    east /= np.linalg.norm(east)
    return np.vstack([east, np.cross(up, east), up])


class FineAlignment:
    """The filter: takes velocities knot by knot and gives the attitude at the end."""

    def __init__(self, model: ErrorModel, density: Array, seconds: float):
        """density: (6, 6), variance per second of the integrated gyros [rad²/s] and accelerometers [(m/s)²/s], navigation axes.
        seconds: from knot to knot."""
        self._model, self._density = model, density
        self._transition, self._added = model.step(seconds)[0], model.noise(density, seconds)
        self._state = np.zeros(SIZE)
        self._covariance = np.diag([0.0, 0, STILLNESS**2, STILLNESS**2, *[_PRIOR**2] * 3])
        self._squares, self._count, self._largest = 0.0, 0, 0.0

    def take(self, velocities: Array) -> None:
        """velocities: (m, 2 or 3), m/s, east and north, at the next m knots."""
        seen = slice(EAST_VELOCITY, EAST_VELOCITY + 2)
        for found in velocities[:, :2]:
            state = self._transition @ self._state
            covariance = self._transition @ self._covariance @ self._transition.T + self._added
            expected = covariance[seen, seen] + STILLNESS**2 * np.eye(2)
            innovation = found - state[seen]
            gain = np.linalg.solve(expected, covariance[seen]).T
            self._state = state + gain @ innovation
            kept = np.eye(SIZE)
            kept[:, seen] -= gain
            self._covariance = kept @ covariance @ kept.T + STILLNESS**2 * gain @ gain.T
            self._squares += float(innovation @ np.linalg.solve(expected, innovation))
            self._count += 2
        if len(velocities):
            self._largest = max(self._largest, float(np.abs(velocities[:, :2]).max()))

    def finish(self, rotation: Array, seconds: float) -> Alignment:
        """The aligned attitude. rotation: the navigator's, (3, 3), `seconds` after the last knot."""
        transition = self._model.step(seconds)[0]
        tilt = (transition @ self._state)[TILT]
        covariance = transition @ self._covariance @ transition.T + self._model.noise(self._density, seconds)
        consistency = math.sqrt(self._squares / self._count) if self._count else math.nan
        return Alignment(attitude.small_rotation(tilt) @ rotation, covariance[TILT, TILT], consistency, self._largest)
