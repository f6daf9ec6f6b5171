"""Compares the drift of a coefficient with its uncertainty, and determines the date on which the device should be calibrated again.

The drift is described by a straight line x = a + b·(t − t̄), which is fitted to the weighted values. For a later time t, the line
predicts a value with the variance

    u²(t) = u_line²(t) + τ² + ū²,    u_line² = var a + (t − t̄)² var b

where τ is the scatter from run to run and ū is the root mean square of the stated uncertainties. The next calibration is due when
the predicted deviation from the last value, together with its expanded uncertainty, reaches the permissible deviation:

    |b|·(t − t_last) + k·√(u_line²(t) + τ² + ū²) = permissible

This procedure is method 2, the control chart, of ILAC-G24:2022 / OIML D 10:2022 (7.3), in which the interval follows from the
scatter and the drift of successive calibrations. NCSLI RP-1 calls the corresponding procedure the variables-data method. If no
permissible deviation is stated, the calibration is due when the drift alone exceeds the expanded uncertainty of a value, k·√(τ² +
ū²), because then the last calibration no longer describes the device.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass

COVERAGE = 2.0
"""Coverage factor k of expanded uncertainties, about 95 %."""
HORIZON = 3653.0
"""Longest interval [days] that is recommended. The data of the fit do not support a longer interval."""
LEAST = 3
"""Smallest number of values for the estimate of a drift."""
LEAST_SPAN = 1.0
"""Shortest time [days] that the values of a drift must cover. Within a shorter time, the values show warm-up and noise, not the
aging of the device. The date of the next calibration is also stated in whole days."""


@dataclass(frozen=True, slots=True)
class DriftLine:
    """Contains a straight line fitted to the values of a coefficient over time.

    `slope`, `slope_uncertainty`: slope and its standard uncertainty, in units of the values per day. `level`: value of the line at
    the mean time `middle`. `between`: τ, the scatter from run to run. `stated`: ū, the root mean square of the stated
    uncertainties. All times are in days.
    """

    slope: float
    slope_uncertainty: float
    level: float
    level_uncertainty: float
    middle: float
    last: float
    between: float
    stated: float

    @property
    def significant(self) -> bool:
        """Returns True if the drift exceeds its expanded uncertainty."""
        return abs(self.slope) > COVERAGE * self.slope_uncertainty

    def uncertainty(self, time: float) -> float:
        """Returns the standard uncertainty of the value that the line predicts for a given time [days]."""
        line = self.level_uncertainty**2 + ((time - self.middle) * self.slope_uncertainty) ** 2
        return math.sqrt(line + self.between**2 + self.stated**2)


def drift_line(days: Array, values: Array, u: Array, between: float) -> DriftLine | None:
    """Fits the weighted straight line to the values over time. `days`, `values`, `u`: arrays of shape (n,), times, values and their
    standard uncertainties. `between`: τ, the scatter from run to run. Returns None if there are too few values or if they cover too
    short a time."""
    if len(values) < LEAST or float(np.ptp(days)) < LEAST_SPAN:
        return None
    variance = u**2 + between**2
    if not (variance > 0).all():
        return None
    w = 1 / variance
    middle = float(np.average(days, weights=w))
    level = float(np.average(values, weights=w))
    moment = float((w * (days - middle) ** 2).sum())
    slope = float((w * (days - middle) * values).sum()) / moment
    stated = math.sqrt(float(np.mean(u**2)))
    return DriftLine(
        slope, math.sqrt(1 / moment), level, math.sqrt(1 / float(w.sum())), middle, float(days[-1]), between, stated
    )


def days_left(line: DriftLine, permissible: float | None = None) -> float:
    """Returns the time [days] from the last value to the next calibration; 0 if the calibration is due at once, and at most
    `HORIZON`. `permissible`: largest permissible deviation."""

    def due(later: float) -> bool:
        change = abs(line.slope) * later
        if permissible is None:
            return change > COVERAGE * math.hypot(line.between, line.stated)
        return change + COVERAGE * line.uncertainty(line.last + later) > permissible

    if due(0.0):
        return 0.0
    if not due(HORIZON):
        return HORIZON
    low, high = 0.0, HORIZON  # it grows with time
    while high - low > 0.01:
        middle = (low + high) / 2
        low, high = (low, middle) if due(middle) else (middle, high)
    return low
