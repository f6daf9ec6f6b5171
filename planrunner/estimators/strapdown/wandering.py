"""Computes the effect of flicker on a navigation: the response of the linear error equations to biases that change during alignment
and navigation.

The constant error of a sensor is defined as the average over a stated time span (see `observation.flicker`). Only deviations from
this average count here as disturbances of alignment and navigation. The errors of a navigation are linear in the sensors' errors.
The navigation errors are therefore sums of the responses to the sensor errors in short intervals. The response to a sensor error
that is constant in one interval is known. The covariance of the means of flicker over these intervals then gives the covariance of
the navigation errors.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.navigation.error_equations import INPUTS, SIZE, TILT, ErrorEquations
from planrunner.observation.flicker import weighted_covariance

SHORTEST = 10.0  # s, shortest interval
_AXES = 3


@dataclass(frozen=True, slots=True)
class WanderingBias:
    """Describes the response of a navigation to sensor errors that are constant in each interval of `step` [s].

    `aligned`: array of shape (3, 6, m) in rad, tilt after the alignment. Each entry is the tilt for an error of 1 rad/s or 1 m/s²
    of one of the 6 sensors in one of the m intervals of the alignment. `attitude`: array of shape (n, 3, 3), mean attitude over
    each interval of the navigation, with the body axes as columns in East-North-Up. `between`: number of intervals from the start
    of the alignment to the start of the navigation. `span`: the time over which constant errors are averages, s.
    """

    equations: ErrorEquations
    aligned: Array
    attitude: Array
    between: int
    step: float
    span: float

    @property
    def begun(self) -> int:
        """Returns the number of intervals before the first interval of the navigation."""
        return max(self.between, int(self.aligned.shape[2]))

    @property
    def middles(self) -> Array:
        """Returns the middle of each of the l intervals of alignment and navigation, shape (l,), s since the alignment began."""
        return np.asarray(self.step * (np.arange(self.begun + len(self.attitude)) + 0.5))

    def errors(self, biases: Array) -> Array:
        """Computes the navigation errors for r cases of changing biases, at the start of the navigation and after each of its n
        intervals. Returns an array of shape (7, n + 1, r), with the states that `error_equations` defines. `biases`: array of shape
        (6, l, r), rad/s and m/s², mean biases over the l intervals whose middles are `middles`."""
        m = self.aligned.shape[2]
        start = np.zeros((SIZE, biases.shape[2]))
        start[TILT] = np.einsum("asm,smr->ar", self.aligned, biases[:, :m])
        driven = np.einsum("kis,skr->kir", self._turned(), biases[:, self.begun :])
        states = self.equations.responses(start, driven, self.step)
        return np.concatenate([start[None], states]).swapaxes(0, 1)

    def _turned(self) -> Array:
        """Returns the matrices (n, 6, 6) that convert errors of gyros and accelerometers from body to navigation axes."""
        turned = np.zeros((len(self.attitude), INPUTS, INPUTS))
        turned[:, :_AXES, :_AXES] = turned[:, _AXES:, _AXES:] = self.attitude
        return turned

    def covariances(self, moments: Array) -> Array:
        """Computes, for each sensor, the joint covariance of the tilts after the alignment [rad] and of the position and velocity
        errors at k moments of the navigation. The bias instability is 1 rad/s or 1 m/s². Returns an array of shape (k, 6, 7, 7)."""
        begun, count = self.begun, len(self.attitude)
        transition, response = self.equations.step(self.step)
        driven = np.empty((count, SIZE, INPUTS))  # [k]: state k intervals after an interval with an input of one unit
        driven[0] = response
        for k in range(1, count):
            driven[k] = transition @ driven[k - 1]
        turned = self._turned()
        found = np.empty((len(moments), INPUTS, SIZE, SIZE))
        for row, moment in enumerate(moments):
            whole = min(int(moment / self.step + 1e-9), count)
            weights = np.zeros((INPUTS, SIZE, begun + count))
            weights[:, :_AXES, : self.aligned.shape[2]] = self.aligned.swapaxes(0, 1)
            carried = self.equations.step(moment)[0][:4, TILT]
            weights[:, _AXES:, : self.aligned.shape[2]] = np.einsum("ab,bsm->sam", carried, self.aligned)
            rest = moment - whole * self.step
            last, within = self.equations.step(rest)
            along = last[:4] @ driven[:whole][::-1] @ turned[:whole]
            weights[:, _AXES:, begun : begun + whole] = along.transpose(2, 1, 0)
            if whole < count and rest > 0:
                weights[:, _AXES:, begun + whole] = (within[:4] @ turned[whole]).T
            found[row] = weighted_covariance(weights, self.step, self.span)
        return found


def interval(seconds: float, most: int) -> float:
    """Returns the length [s] of the intervals into which a time of `seconds` is divided. The length is at least `SHORTEST`, and
    long enough to give at most `most` intervals."""
    return max(SHORTEST, math.ceil(seconds / most))


class MeanAttitude:
    """Computes the mean attitude over each interval of a navigation, from attitudes at more closely spaced moments."""

    def __init__(self, step: float):
        self.step = step
        self._sums: list[Array] = []
        self._counts: list[int] = []

    def take(self, time: Array, rotations: Array) -> None:
        """Adds attitudes of the navigator. `time`: array of shape (m,), s since the navigation began. `rotations`: array of shape
        (m, 3, 3), attitudes at these times."""
        place = np.maximum(np.ceil(time / self.step - 1e-9).astype(np.int64) - 1, 0)
        for k in np.unique(place):
            while len(self._sums) <= k:
                self._sums.append(np.zeros((_AXES, _AXES)))
                self._counts.append(0)
            here = place == k
            self._sums[k] += rotations[here].sum(axis=0)
            self._counts[k] += int(here.sum())

    @property
    def means(self) -> Array:
        """Returns the mean attitude over each interval, shape (n, 3, 3)."""
        return np.array([one / max(count, 1) for one, count in zip(self._sums, self._counts, strict=True)])
