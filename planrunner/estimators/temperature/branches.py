"""Distinguishes rising and falling temperature. Finds the branches of a recorded temperature, and describes how values differ
between the two directions.

Let C be the mean of the values in both directions, and D the width of the hysteresis loop: a value is C(T) + D(T)/2 on a rising
ramp and C(T) − D(T)/2 on a falling ramp. The branches are separated by the turning points of the temperature, not by the boundaries
of segments. A temperature cycle therefore gives the same branches whether it is recorded as one segment or as several.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planrunner.base.arrays import Array, Integers
from planrunner.base.dataclass import dataclass
from planrunner.estimators.temperature.curve import Curve, curve, groups_of

_BACK = 0.1  # of the range of temperatures: a smaller change is ripple of the chamber's controller


def branches(temperature: Array, least: float) -> Integers:
    """Divides successive temperatures [degC] into rising and falling branches. Returns, for each of the n temperatures, the index
    of its branch, counted from 0.

    A branch ends at an extreme value if the temperature then moves back by more than `least` [K] and by more than a tenth of the
    range of all temperatures.
    """
    number = np.zeros(len(temperature), dtype=np.int64)
    if not len(temperature):
        return number
    back = max(least, _BACK * float(np.ptp(temperature)))
    low = high = 0  # indices of the extremes since the last turning point
    rising: bool | None = None
    for place, celsius in enumerate(temperature.tolist()):
        low = place if celsius < temperature[low] else low
        high = place if celsius > temperature[high] else high
        if rising is not False and temperature[high] - celsius > back:
            turned, rising = rising is not None, False
            number[high + 1 :] += turned
            low = place
        elif rising is not True and celsius - temperature[low] > back:
            turned, rising = rising is not None, True
            number[low + 1 :] += turned
            high = place
    return number


def approached(temperature: Sequence[float], least: float) -> tuple[Integers, Integers]:
    """Determines the direction from which each of n temperatures was reached: +1 from below, −1 from above. The temperatures were
    held one after the other. Also returns, for each temperature, the index of the sweep to which it belongs. The temperatures
    before the first change belong to the first sweep. If the temperature never changes, the directions are 0 and the indices −1. A
    change of at most `least` [K] counts as no change."""
    direction = np.zeros(len(temperature), dtype=np.int64)
    for place in range(1, len(temperature)):
        change = temperature[place] - temperature[place - 1]
        direction[place] = direction[place - 1] if abs(change) <= least else int(np.sign(change))
    if not direction.any():
        return direction, direction - 1
    first = int(np.flatnonzero(direction)[0])
    direction[:first] = direction[first]
    return direction, np.cumsum(np.diff(direction, prepend=direction[0]) != 0).astype(np.int64)


@dataclass(frozen=True)
class Difference:
    """Describes the difference D between the values at rising temperature and the values at falling temperature. `curve`: form of D
    as a function of temperature. `low`, `high`: limits of the temperature range in which both directions were recorded, degC.
    Outside this range, D has its value at the nearer limit."""

    curve: Curve
    low: float
    high: float

    def width(self, temperature: Array) -> Array:
        """Returns the columns that describe the difference D between rising and falling temperature, shape (n, q). `temperature`:
        array of shape (n,), degC."""
        return self.curve.columns(np.clip(temperature, self.low, self.high))

    def columns(self, temperature: Array, direction: Integers) -> Array:
        """Returns the columns that describe the contribution +D/2 or −D/2 to the values, shape (n, q); zero for values without a
        direction. `temperature`: array of shape (n,), degC. `direction`: array of shape (n,), +1 for rising, −1 for falling
        temperature, 0 if there is no direction."""
        return self.width(temperature) * (direction / 2)[:, None]


def difference_of(temperature: Array, direction: Integers, highest: int, width: float, left: int) -> Difference | None:
    """Returns the form of D(T), the width of the hysteresis loop. The form is a polynomial of the order `highest`, or of a lower
    order if there are few temperatures. The result is None if fewer than two temperatures were reached in both directions. The form
    does not depend on the measured values. Therefore, the choice of the form does not add to the uncertainty of D.

    `width`: temperatures that differ by no more than this count as one temperature, K. `left`: the largest number of coefficients
    that the number of values allows.
    """
    group = groups_of(temperature, width)
    both = np.intersect1d(group[direction > 0], group[direction < 0])
    if len(both) < 2 or left < 1:
        return None
    inside = temperature[np.isin(group, both) & (direction != 0)]
    order = max(0, min(highest, (len(both) + 1) // 2 - 1, left - 1))
    low, high = float(inside.min()), float(inside.max())
    return Difference(curve("polynomial", order, (low + high) / 2, inside), low, high)
