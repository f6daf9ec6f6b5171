"""Computes the errors of a navigation relative to the true position, and the usual figures of performance. The errors are computed
at each knot. A knot is a moment for which the navigator returns attitude, velocity and position.

Position errors are arcs on the ellipsoid between the navigated and the true position. The radial error rate of a run is the slope
of a straight line through the origin that is fitted by least squares to the radial error as a function of time. The CEP rate (CEP:
circular error probable) of one run is √(ln 2) = 0.8326 times this slope. If the two components of the position error are normal
with equal variances and zero mean, the CEP rate is the median of the radial error per unit of time (Titterton and Weston,
"Strapdown Inertial Navigation Technology", 2nd ed., appendix B). For several runs, the CEP rate is √(ln 2) times the root mean
square of their slopes.
"""

from __future__ import annotations

import math
from dataclasses import field

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass
from planrunner.navigation.mechanisation import Knots
from planrunner.navigation.wgs84 import separation

POINTS = 2000  # most stored points of the errors over time
HOUR = 3600.0
CEP_SHARE = math.sqrt(math.log(2))
NAUTICAL_MILE = 1852.0  # m


def _sigma_quantile(probability: float) -> float:
    """Returns a quantile of the ratio of the true to the estimated standard deviation. The quantile applies to one run, whose two
    error components give a χ² distribution with two degrees of freedom."""
    return math.sqrt(-1 / math.log(probability))


CEP_SPREAD = (_sigma_quantile(0.8413447) - _sigma_quantile(0.1586553)) / 2
"""Relative standard uncertainty of the CEP rate of one run: half of the central 68 % interval."""
CEP_INTERVAL = (_sigma_quantile(0.025), _sigma_quantile(0.975))
"""Ends of the 95 % interval of the CEP rate, divided by the value of one run."""


def stride(knots: int) -> int:
    """Returns the number of knots from one stored point to the next. The number is chosen so that a record has at most `POINTS`
    points. If possible, it is a divisor of 3600, so that whole hours are among the points. Knots are the moments for which the
    navigator returns a result."""
    wanted = max(1, -(-knots // POINTS))
    divisors = [k for k in range(1, int(HOUR) + 1) if int(HOUR) % k == 0]
    return next((k for k in divisors if k >= wanted), wanted)


@dataclass(frozen=True, slots=True)
class Truth:
    """States the true position and velocity at m moments: latitude and longitude [rad], height [m], and the velocity to the east
    and to the north [m/s]. The velocity is an array of shape (m, 2)."""

    latitude: Array
    longitude: Array
    height: Array
    velocity: Array


@dataclass
class ErrorRecord:
    """Contains sums of navigation errors over all knots, and the errors at every `stride`-th knot. A knot is a moment for which the
    navigator returns attitude, velocity and position. Times are in s since the navigation began, errors in m and m/s.

    `knots`: number of knots. `squares`: sum of the squares of the radial position error. `speed_squares`: sum of the squares of the
    radial velocity error. `time_error`: sum, over all knots, of the time multiplied by the radial position error. `time_squares`:
    sum, over all knots, of the squared time. `largest`: largest radial position error, which occurs at the time `largest_at`.
    `largest_speed`: largest radial velocity error. `course`: the errors at every `stride`-th knot, which `points` returns.
    """

    stride: int
    knots: int = 0
    squares: float = 0.0
    speed_squares: float = 0.0
    time_error: float = 0.0
    time_squares: float = 0.0
    largest: float = 0.0
    largest_at: float = 0.0
    largest_speed: float = 0.0
    course: list[Array] = field(default_factory=lambda: [np.zeros((5, 1))])

    def take(self, time: Array, knots: Knots, truth: Truth) -> None:
        """Adds the errors at the next m moments. `time`: array of shape (m,), s since the navigation began."""
        errors = difference(knots, truth)
        if not len(time):
            return
        radial, speed = np.hypot(errors[0], errors[1]), np.hypot(errors[2], errors[3])
        self.squares = _added(self.squares, radial * radial)
        self.speed_squares = _added(self.speed_squares, speed * speed)
        self.time_error = _added(self.time_error, time * radial)
        self.time_squares = _added(self.time_squares, time * time)
        worst = int(np.argmax(radial))
        if radial[worst] > self.largest:
            self.largest, self.largest_at = float(radial[worst]), float(time[worst])
        self.largest_speed = max(self.largest_speed, float(speed.max()))
        number = self.knots + 1 + np.arange(len(time))
        kept = number % self.stride == 0
        self.course.append(np.vstack([time, errors])[:, kept])
        self.knots += len(time)

    def points(self) -> Array:
        """Returns the stored errors on a regular time grid that begins at zero, shape (5, m). The rows are time [s], east and north
        position error [m], east and north velocity error [m/s]."""
        return np.hstack(self.course)

    @property
    def rms(self) -> float:
        return math.sqrt(self.squares / self.knots)

    @property
    def rms_speed(self) -> float:
        return math.sqrt(self.speed_squares / self.knots)

    @property
    def radial_rate(self) -> float:
        """Returns the radial error rate [m/s]."""
        return self.time_error / self.time_squares


def _added(total: float, values: Array) -> float:
    """Adds values one after another to a sum, so that the sum does not depend on how the values are divided into blocks."""
    return float(np.add.accumulate(np.append(total, values))[-1])


def difference(knots: Knots, truth: Truth) -> Array:
    """Returns the navigation errors (4, m): east and north position error [m], east and north velocity error [m/s]."""
    east, north = separation(truth.latitude, truth.longitude, knots.latitude, knots.longitude, truth.height)
    velocity = knots.velocity[:, :2] - truth.velocity
    return np.vstack([east, north, velocity.T])
