"""What a sensor feels in a test on the ground, sample by sample, and when.

Site axes are east, north and up. A step holds one orientation, at rest, turning at a constant rate about the vertical, or turning from
stop to stop; between steps nothing is recorded. Rates are in deg/h, specific force is in m/s².
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LATITUDE = 39.98  # deg
GRAVITY = 9.80154  # m/s²
EARTH = 15.041067  # deg/h
STANDARD_GRAVITY = 9.80665  # m/s²
WORDS = {
    "east": (1.0, 0.0, 0.0), "west": (-1.0, 0.0, 0.0), "north": (0.0, 1.0, 0.0),
    "south": (0.0, -1.0, 0.0), "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0),
}  # fmt: skip
NORTHWARD = EARTH * np.cos(np.radians(LATITUDE))
UPWARD = EARTH * np.sin(np.radians(LATITUDE))


@dataclass(frozen=True)
class Step:
    """axes: where the sensor's x, y and z point when the table stands at its home angle. dwell: s recorded; pause: s before it; rate:
    deg/s, positive about up. moves: deg, turns about up, over and over again, each after a stop of `stop` s, at `rate` deg/s. mode: of a
    platform; rocks: whether the base of a platform rocks, which only its gimbals and rings show. volts, hectopascals: stated supply of the
    sensor and pressure of the air; 0 where they are not stated."""

    label: str
    axes: str
    dwell: float
    rate: float = 0.0
    pause: float = 30.0
    moves: tuple[float, ...] = ()
    stop: float = 0.0
    mode: str = ""
    rocks: bool = False
    volts: float = 0.0
    hectopascals: float = 0.0

    def angle(self, time: Array) -> Array:
        """Of the table, rad, some seconds since the step began."""
        if not self.moves:
            return np.asarray(np.radians(self.rate) * time)
        turns = np.resize(self.moves, 1 + int(self.dwell / self.stop))
        knots, angles = [0.0], [0.0]
        for turn in turns:
            knots += [knots[-1] + self.stop, knots[-1] + self.stop + abs(turn) / self.rate]
            angles += [angles[-1], angles[-1] + turn]
        return np.asarray(np.radians(np.interp(time, knots, angles)))

    @property
    def matrix(self) -> Array:
        """Rows are the sensor's axes in site axes."""
        return np.array([WORDS[word] for word in self.axes.split()])


@dataclass(frozen=True)
class Felt:
    """Sample by sample: seconds since the test began (n,), number of the step (n,), angular rate of the sensor in inertial space in deg/h
    (n, 3) and specific force in m/s² (n, 3), both in sensor axes."""

    time: Array
    step: NDArray[np.int64]
    rate: Array
    force: Array


def starts(steps: Sequence[Step]) -> Array:
    """When each step's record begins, s."""
    ends = np.cumsum([step.pause + step.dwell for step in steps])
    return np.asarray(ends - [step.dwell for step in steps])


def felt(steps: Sequence[Step], sampling: float, tilts: Array | None = None, rate_errors: Array | None = None) -> Felt:
    """sampling: Hz; tilts: (S, 3), rad, how each step's orientation is turned away from the planned one, about east, north and up;
    rate_errors: (S,), by how much of itself each rate is wrong. Without such errors, all tests of a campaign have the same arrays, which
    cannot be written."""
    if tilts is None and rate_errors is None:
        return _as_planned(tuple(steps), sampling)
    return _felt(steps, sampling, tilts, rate_errors)


@lru_cache(maxsize=2)
def _as_planned(steps: tuple[Step, ...], sampling: float) -> Felt:
    made = _felt(steps, sampling, None, None)
    for one in (made.time, made.step, made.rate, made.force):
        one.flags.writeable = False
    return made


def _felt(steps: Sequence[Step], sampling: float, tilts: Array | None, rate_errors: Array | None) -> Felt:
    times, owners, rates, forces = [], [], [], []
    for number, (step, start) in enumerate(zip(steps, starts(steps), strict=True)):
        local = np.arange(round(step.dwell * sampling)) / sampling
        wrong = 0.0 if rate_errors is None else float(rate_errors[number])
        spin = np.zeros((len(local), 3))
        if step.moves:  # each sample is the mean over the interval that ends with it
            edges = step.angle(np.append(local, local[-1] + 1 / sampling))
            turned, spin[:, 2] = (edges[1:] + edges[:-1]) / 2, np.degrees(np.diff(edges)) * sampling * 3600
        else:
            turned, spin[:, 2] = step.angle((1 + wrong) * local), step.rate * (1 + wrong) * 3600
        axes = step.matrix if tilts is None else step.matrix @ turn(tilts[number]).T
        # Seen from the table, the Earth's rate turns backwards about the vertical.
        earth = np.stack([NORTHWARD * np.sin(turned), NORTHWARD * np.cos(turned), np.full(len(local), UPWARD)], axis=1)
        times.append(start + local)
        owners.append(np.full(len(local), number))
        rates.append((earth + spin) @ axes.T)
        forces.append(np.broadcast_to(axes @ [0.0, 0.0, GRAVITY], (len(local), 3)))
    return Felt(*(np.concatenate(part) for part in (times, owners, rates, forces)))


def turn(vector: Array) -> Array:
    """Matrix of a rotation about a vector by its length, rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross)
