"""Describes a cycle of stops and turns of one table axis, and computes the residual of a sensor error after one cycle.

A horizontal error of the sensor (a constant gyro drift or accelerometer bias) is written as a complex number e. In the navigation
frame, it is e·exp(iθ(t)), where θ is the angle of the axis from the first position. The residual is the integral of exp(iθ) over
one cycle, in seconds; it is zero if the cycle cancels the error. The error at the first position, multiplied by the residual, is
the error that accumulates in one cycle.

The rate of a turn has a trapezoidal profile, or a triangular one if the turn is too short to reach the full rate. All integrals are
computed piece by piece. Stops and turns at a constant rate are integrated in closed form. Ramps are integrated by Gauss–Legendre
quadrature on panels. Within a panel, the phase changes by at most 1 rad, so ten nodes are exact except for rounding (Davis and
Rabinowitz, Methods of Numerical Integration, 1984, section 2.7).
"""

from __future__ import annotations

import math
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.plan.schedule import Cycle

NOTHING = 1e-6  # fraction of a period that is negligible, because errors are known to a few per cent only


@dataclass(frozen=True)
class RotationCycle:
    """Describes a cycle of stops and turns of one table axis.

    `turns`: angle of each turn, rad, positive about the axis; before each turn, the axis rests for `stop` s. `rate`: rate of the
    turns, rad/s, above zero. `acceleration`: acceleration of the ramps, rad/s^2; infinite for turns without ramps. Raises
    `ValueError` if the cycle takes no time.
    """

    turns: tuple[float, ...]
    stop: float
    rate: float
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        if not self.period > 0:
            raise ValueError("the cycle takes no time: it neither stops nor turns")

    @classmethod
    def of(cls, cycle: Cycle, acceleration: float) -> RotationCycle:
        """Makes the cycle from the motion of a schedule, for an axis with the acceleration `acceleration` [rad/s^2]."""
        return cls(tuple(move.turn for move in cycle.moves), cycle.stop, cycle.rate, acceleration)

    # -- where the axis is -------------------------------------------------------------------------------------------

    @cached_property
    def stops(self) -> Array:
        """Returns the angle of every stop [rad], measured from the first stop, shape (n,). Full turns are included."""
        return np.concatenate(([0.0], np.cumsum(self.turns)[:-1]))

    @property
    def period(self) -> float:
        """Returns the duration of one cycle, s."""
        return float(self._pieces[1].sum())

    @property
    def net_turn(self) -> float:
        """Returns the angle [rad] by which one cycle winds up the cables."""
        return math.fsum(self.turns)

    @property
    def reach(self) -> tuple[float, float]:
        """Returns the lowest and the highest angle, measured from the first position, rad."""
        reached = np.append(self.stops, self.net_turn)
        return float(reached.min()), float(reached.max())

    def angle(self, times: Array) -> Array:
        """Returns the angle from the first position [rad] at `times` [s since the start of a cycle], shape (n,)."""
        begins, lasting, angles, rates, slopes, _ = self._pieces
        cycles, within = np.divmod(np.asarray(times, dtype=float), self.period)
        index = np.clip(np.searchsorted(begins, within, side="right") - 1, 0, len(begins) - 1)
        elapsed = np.minimum(within - begins[index], lasting[index])
        turned = angles[index] + (rates[index] + 0.5 * slopes[index] * elapsed) * elapsed
        return np.asarray(cycles * self.net_turn + turned)

    def turning_rate(self, time: float) -> float:
        """Returns the rate [rad/s] at `time` [s since the start of a cycle]."""
        begins, lasting, _, rates, slopes, _ = self._pieces
        within = math.fmod(time, self.period)
        index = max(0, int(np.searchsorted(begins, within, side="right")) - 1)
        elapsed = min(within - float(begins[index]), float(lasting[index]))
        return float(rates[index] + slopes[index] * elapsed)

    @property
    def mean_angle(self) -> float:
        """Returns the mean over time of the angle from the first position, rad. The product of this angle and the scale factor
        error of a gyro is the mean heading error."""
        _, lasting, angles, rates, slopes, _ = self._pieces
        integral = angles * lasting + rates * lasting**2 / 2 + slopes * lasting**3 / 6
        return math.fsum(integral) / self.period

    # -- the residual -------------------------------------------------------------------------------------------------

    def integral(self, frequency: float = 0.0) -> tuple[complex, complex]:
        """Returns the integrals ∫ exp(i(θ − ωt)) dt [s] over the stops and over the turns of one cycle, where ω is `frequency`
        [rad/s].

        For ω = 0, the sum of the two is the residual of the cycle. For ω = k·2π/period, the sum divided by the period is the k-th
        Fourier coefficient.
        """
        begins, lasting, angles, rates, slopes, turning = self._pieces
        beat = rates - frequency
        steady = lasting * np.exp(1j * beat * lasting / 2) * np.sinc(beat * lasting / (2 * math.pi))
        parts = np.exp(1j * (angles - frequency * begins)) * steady
        ramps = slopes != 0
        parts[ramps] = _ramps(begins[ramps], lasting[ramps], angles[ramps], rates[ramps], slopes[ramps], frequency)
        return complex(parts[~turning].sum()), complex(parts[turning].sum())

    @cached_property
    def residual(self) -> complex:
        """Returns the residual of one cycle [s], over the stops and the turns."""
        stops, turns = self.integral()
        return stops + turns

    @property
    def balanced(self) -> bool:
        """Returns True if the residual is negligible."""
        return abs(self.residual) <= NOTHING * self.period

    # -- pieces in which the rate is constant or changes evenly --------------------------------------------------------

    @cached_property
    def _pieces(self) -> tuple[Array, Array, Array, Array, Array, NDArray[np.bool_]]:
        """Returns the pieces of the cycle as six arrays of shape (4·n,): start [s], length [s], angle [rad] and rate [rad/s] at the
        start, acceleration [rad/s^2], and True if the axis turns. There are four pieces for each turn: a stop and the three parts
        of the turn. A part that does not exist has the length zero."""
        turns = np.array(self.turns)
        size, sign = np.abs(turns), np.sign(turns)
        peak = np.where(size > 0, self.rate, 0.0)
        if math.isfinite(self.acceleration):
            peak = np.minimum(peak, np.sqrt(size * self.acceleration))
        ramp = peak / self.acceleration
        steady = np.maximum(0.0, np.divide(size, peak, out=np.zeros_like(size), where=peak > 0) - ramp)
        rising = 0.5 * peak * ramp
        still = np.zeros_like(size)
        lasting = np.stack([np.full_like(size, self.stop), ramp, steady, ramp], axis=1).ravel()
        rates = np.stack([still, still, sign * peak, sign * peak], axis=1).ravel()
        slope = sign * self.acceleration if math.isfinite(self.acceleration) else still
        slopes = np.stack([still, slope, still, -slope], axis=1).ravel()
        begun = np.concatenate(([0.0], np.cumsum(turns)[:-1]))
        angles = np.stack([begun, begun, begun + sign * rising, begun + turns - sign * rising], axis=1).ravel()
        turning = np.tile([False, True, True, True], len(turns))
        return np.concatenate(([0.0], np.cumsum(lasting)[:-1])), lasting, angles, rates, slopes, turning


@cache
def _gauss_legendre() -> tuple[Array, Array]:
    """Returns the ten nodes of the Gauss–Legendre quadrature, and their weights, as two arrays (10,). The nodes are cached, because
    numpy must load its polynomials to compute them, and few plans need them."""
    return np.polynomial.legendre.leggauss(10)


def _ramps(begins: Array, lasting: Array, angles: Array, rates: Array, slopes: Array, frequency: float) -> Array:
    """Returns the integrals (n,) of exp(i(θ − ωt)) over n ramps [s], by quadrature on panels. `begins`, `lasting`: arrays of shape
    (n,), start and duration of each ramp, s. `angles`, `rates`, `slopes`: arrays of shape (n,), angle [rad], rate [rad/s] and
    acceleration [rad/s²] at its start. `frequency`: ω, rad/s."""
    nodes, weights = _gauss_legendre()
    span = (np.maximum(np.abs(rates), np.abs(rates + slopes * lasting)) + abs(frequency)) * lasting
    panels = np.maximum(1, np.ceil(span)).astype(int)
    owner = np.repeat(np.arange(len(lasting)), panels)
    first = np.repeat(np.cumsum(panels) - panels, panels)
    width = (lasting / panels)[owner]
    elapsed = width[:, None] * ((np.arange(len(owner)) - first)[:, None] + (nodes + 1) / 2)
    angle = angles[owner, None] + (rates[owner, None] + 0.5 * slopes[owner, None] * elapsed) * elapsed
    panel = np.exp(1j * (angle - frequency * (begins[owner, None] + elapsed))) @ weights * width / 2
    return np.bincount(owner, panel.real, len(lasting)) + 1j * np.bincount(owner, panel.imag, len(lasting))
