"""Computes the input of an integrating sensor: inertial rate and specific force, averaged over every sampling interval.

While the table turns, such a mean is an integral over products of sines of the joint angles. The integral is computed by
Gauss-Legendre quadrature over stretches of smooth motion, with as many points as the fastest phase requires. Therefore, means over
intervals in which a ramp begins or ends are as accurate as all other means. During a ramp, the rate of a joint is linear in time,
so the quadrature is exact. For rotation about one axis, the mean rates add up to the angle of the joint.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from planrunner.instruments.virtual.courses import Stretch
from planrunner.instruments.virtual.streaming import Sampling
from planrunner.instruments.virtual.world import Components, World

# Largest phase [rad] within an interval for which one, two and three quadrature points are sufficient. Over the phase h, their
# errors are about h²/24, h⁴/4320 and h⁶/2016000 of the amplitude, each below 1e-12.
_ONE_POINT, _TWO_POINTS, _THREE_POINTS = 4e-6, 8e-3, 0.1
_TOGETHER = 2**14  # times that are processed together
_SNAP = 1e-6  # of an interval: a break nearer than this to a sample's end counts as there


def interval_means(world: World, sampling: Sampling, first: int, length: int) -> tuple[Components, Components]:
    """Returns the mean inertial rate [rad/s] and the mean specific force [m/s^2] along the sensor's axes, for `length` consecutive
    sampling intervals. `first`: number of the first of these intervals, counted from 0. Each component is a float if nothing moves,
    otherwise an array (length,)."""
    begin = sampling.start + first / sampling.rate
    stretches = world.stretches(begin, begin + length / sampling.rate)
    if all(stretch.pace == 0.0 for stretch in stretches):
        return _moment(world, begin)
    means = np.zeros((6, length))
    for stretch in stretches:
        _add(means, world, stretch, begin, sampling.rate)
    return (means[0], means[1], means[2]), (means[3], means[4], means[5])


def _add(means: np.ndarray, world: World, stretch: Stretch, begin: float, rate: float) -> None:
    """Adds the contribution of a stretch of smooth motion to the means (6, n) over intervals of 1/rate s; the first interval begins
    at the time `begin`."""
    low, high = (_snapped((time - begin) * rate) for time in (stretch.begin, stretch.end))
    low, high = max(low, 0.0), min(high, float(means.shape[1]))
    whole, last = math.ceil(low), math.floor(high)
    if whole > last:  # begins and ends within one interval
        _add_part(means, world, stretch.pace, begin, rate, low, high)
        return
    _add_part(means, world, stretch.pace, begin, rate, low, float(whole))
    _add_part(means, world, stretch.pace, begin, rate, float(last), high)
    if whole == last:
        return
    if stretch.pace == 0.0:
        means[:, whole:last] += np.array([*sum(_moment(world, begin + (whole + last) / 2 / rate), ())])[:, None]
        return
    edges = np.arange(whole, last, dtype=float)
    points = _points(stretch.pace / rate)
    together = max(1, _TOGETHER // edges.size)
    for start in range(0, len(points), together):
        some = points[start : start + together]
        _add_moments(means[:, whole:last], world, [begin + (edges + point) / rate for point, _ in some], some)


def _add_part(means: np.ndarray, world: World, pace: float, begin: float, rate: float, low: float, high: float) -> None:
    """Adds the contribution of the time between `low` and `high` to the interval that contains it. `low` and `high` are counted in
    intervals from `begin`. `pace`: largest rate of change of the phases, rad/s. `rate`: sample rate, Hz."""
    width = high - low
    if width <= 0.0:
        return
    index = math.floor(low)
    points = [(point, weight * width) for point, weight in _points(pace * width / rate)]
    times = [np.array([begin + (low + point * width) / rate]) for point, _ in points]
    _add_moments(means[:, index : index + 1], world, times, points)


def _add_moments(
    means: np.ndarray, world: World, times: Sequence[np.ndarray], points: Sequence[tuple[float, float]]
) -> None:
    """Adds the weighted stimulus at `times` to the means (6, n); `times` has one array (n,) for each quadrature point."""
    rates, forces = world.stimulus(np.concatenate(times))
    for mean, felt in zip(means, (*rates, *forces), strict=True):
        for (_, weight), moments in zip(
            points, np.broadcast_to(felt, mean.size * len(points)).reshape(len(points), -1), strict=True
        ):
            mean += weight * moments


def _moment(world: World, time: float) -> tuple[Components, Components]:
    """Returns the stimulus at one time, as plain floats."""
    rates, forces = world.stimulus(np.array([time]))
    x, y, z = (float(np.ravel(v)[0]) for v in rates)
    a, b, c = (float(np.ravel(v)[0]) for v in forces)
    return (x, y, z), (a, b, c)


def _snapped(position: float) -> float:
    """Returns a position in units of intervals. If it differs from the boundary of an interval only because times are rounded,
    returns the boundary."""
    return float(round(position)) if abs(position - round(position)) < _SNAP else position


@lru_cache(maxsize=64)
def _points(phase: float) -> tuple[tuple[float, float], ...]:
    """Returns the points of a quadrature over an interval of length one, each with its position and weight. The points are
    sufficient for phases that change by up to `phase` rad within the interval."""
    order = 1 if phase <= _ONE_POINT else 2 if phase <= _TWO_POINTS else 3
    panels = max(1, math.ceil(phase / _THREE_POINTS))
    places, weights = np.polynomial.legendre.leggauss(order)
    return tuple(
        (float((panel + 0.5 + 0.5 * place) / panels), float(weight / 2 / panels))
        for panel in range(panels)
        for place, weight in zip(places, weights, strict=True)
    )
