"""Computes the growth of small errors of an inertial navigator at rest, by the linear error equations with Schuler and 24-hour
oscillations.

The state, in SI units, contains the position errors east and north, the velocity errors east and north, and the tilt (φ_E, φ_N,
φ_U). The tilt is the rotation from the true to the computed attitude, C_computed = (1 − φ×)·C. The inputs, in navigation axes, are
gyro errors ε and accelerometer errors ∇. The equations have the φ-angle form of Titterton and Weston, "Strapdown Inertial
Navigation Technology", 2nd ed., section 12.3. With the vertical channel held (constant height, no vertical velocity), the equations
are:

    δv̇_E = −g·φ_N + 2Ω_U·δv_N + ∇_E          φ̇_E = −δv_N/R_N + Ω_U·φ_N − Ω_N·φ_U − ε_E
    δv̇_N =  g·φ_E − 2Ω_U·δv_E + ∇_N          φ̇_N =  δv_E/R_E − Ω_U·δL − Ω_U·φ_E − ε_N
    δL = δN/R_N                                φ̇_U =  δv_E·tan L/R_E + Ω_N·δL + Ω_N·φ_E − ε_U
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.navigation.wgs84 import radii
from planrunner.physics.earth import Site

EAST, NORTH, EAST_VELOCITY, NORTH_VELOCITY, TILT = 0, 1, 2, 3, slice(4, 7)
SIZE, INPUTS = 7, 6
_TERMS = 16


@dataclass(frozen=True, slots=True)
class ErrorEquations:
    """The equations ẋ = dynamics·x + inputs·(ε, ∇) of the state x: two position errors, two velocity errors, three tilts.
    `dynamics`: array of shape (7, 7), the matrix by which the state is multiplied. `inputs`: array of shape (7, 6), the matrix by
    which the errors (ε, ∇) are multiplied."""

    dynamics: Array
    inputs: Array

    @classmethod
    def at(cls, site: Site) -> ErrorEquations:
        meridian, prime_vertical = radii(site.latitude)
        north, east = float(meridian) + site.height, float(prime_vertical) + site.height
        rate_n = site.earth_rate * math.cos(site.latitude)
        rate_u = site.earth_rate * math.sin(site.latitude)
        g = site.gravity
        dynamics = np.zeros((SIZE, SIZE))
        dynamics[0, 2] = dynamics[1, 3] = 1.0
        dynamics[2, 3], dynamics[2, 5] = 2 * rate_u, -g
        dynamics[3, 2], dynamics[3, 4] = -2 * rate_u, g
        dynamics[4, 3], dynamics[4, 5], dynamics[4, 6] = -1 / north, rate_u, -rate_n
        dynamics[5, 1], dynamics[5, 2], dynamics[5, 4] = -rate_u / north, 1 / east, -rate_u
        dynamics[6, 1], dynamics[6, 2], dynamics[6, 4] = rate_n / north, math.tan(site.latitude) / east, rate_n
        inputs = np.zeros((SIZE, INPUTS))
        inputs[4, 0] = inputs[5, 1] = inputs[6, 2] = -1.0
        inputs[2, 3] = inputs[3, 4] = 1.0
        return cls(dynamics, inputs)

    def step(self, seconds: float) -> tuple[Array, Array]:
        """Returns the transition matrix (7, 7) over the time `seconds`, and the response (7, 6) to inputs that are constant during
        this time."""
        both = np.zeros((SIZE + INPUTS, SIZE + INPUTS))
        both[:SIZE, :SIZE], both[:SIZE, SIZE:] = self.dynamics, self.inputs
        found = exponential(both * seconds)
        return found[:SIZE, :SIZE], found[:SIZE, SIZE:]

    def noise(self, density: Array, seconds: float) -> Array:
        """Returns the covariance (7, 7) that white noise of the inputs adds over the time `seconds` (Van Loan, IEEE Trans.
        Automatic Control 23, 1978).

        `density`: array of shape (6, 6), variance per second of the integrated inputs, in rad²/s and (m/s)²/s."""
        both = np.zeros((2 * SIZE, 2 * SIZE))
        both[:SIZE, :SIZE] = -self.dynamics
        both[:SIZE, SIZE:] = self.inputs @ density @ self.inputs.T
        both[SIZE:, SIZE:] = self.dynamics.T
        found = exponential(both * seconds)
        covariance = found[SIZE:, SIZE:].T @ found[:SIZE, SIZE:]
        return np.asarray((covariance + covariance.T) / 2)

    def covariances(self, start: Array, density: Array, seconds: float, count: int) -> Iterator[Array]:
        """Yields the covariance (7, 7) after 1, 2 … `count` intervals of `seconds`. `start`: array of shape (7, 7), covariance
        before the first interval. `density`: the same as in `noise`."""
        transition, added = self.step(seconds)[0], self.noise(density, seconds)
        covariance = start
        for _ in range(count):
            covariance = transition @ covariance @ transition.T + added
            yield covariance

    def responses(self, start: Array, inputs: Array, seconds: float) -> Array:
        """Computes the states after each of n intervals of `seconds`. Returns an array of shape (n, 7, k). `start`: array of shape
        (7, k), initial states. `inputs`: array of shape (n, 6, k), averaged over each interval."""
        transition, response = self.step(seconds)
        found = np.empty((len(inputs), *start.shape))
        state = start
        for k, driven in enumerate(inputs):
            state = transition @ state + response @ driven
            found[k] = state
        return found

    def levelled(self) -> Array:
        """Computes the tilt after an alignment at rest for a constant error of 1 rad/s or 1 m/s² in each input, shape (3, 6). With
        this tilt and without errors of position and velocity, the derivatives δv̇_E, δv̇_N and φ̇_E are zero.

        For the errors ε and ∇, the tilt is φ_E = −∇_N/g, φ_N = ∇_E/g, and φ_U = tan L·∇_E/g − ε_E/(Ω·cos L). φ_U is the limit of
        accuracy of gyrocompassing.
        """
        g, rate_n, rate_u = self.dynamics[3, 4], -self.dynamics[4, 6], self.dynamics[4, 5]
        found = np.zeros((3, INPUTS))
        found[0, 4], found[1, 3] = -1 / g, 1 / g
        found[2, 3], found[2, 0] = rate_u / rate_n / g, -1 / rate_n
        return found


def exponential(matrix: Array) -> Array:
    """Returns the matrix exponential, computed from its series by scaling and squaring. The function is designed for the small,
    well-scaled matrices of this module."""
    norm = float(np.abs(matrix).sum(axis=1).max())
    halvings = max(0, math.ceil(math.log2(norm)) + 1) if norm > 0 else 0
    scaled = matrix / 2.0**halvings
    total = term = np.eye(len(matrix))
    for k in range(1, _TERMS):
        term = term @ scaled / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return np.asarray(total)
