"""Effects of thermal lag: the temperature of the sensing element lags behind the temperature that the thermometer shows."""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.error_model.effects.interface import About, Actor, Shaped, Variant, per_axis
from planrunner.error_model.observed import Observed, TemperatureCourse
from planrunner.plan.units import STANDARD_GRAVITY as G

_SCALES = {"gyro": ("deg/s/K", np.pi / 180, 1e-3), "accel": ("ug/K", 1e-6 * G, 100.0)}
"""For each kind of triad: the unit of the amplitude, the SI value of this unit, and the usual size of the amplitude in this
unit."""
_NODES = 256  # largest number of nodes of a segment in which the temperature changes
_SETTLED = 3.0  # smallest gap between two segments, in time constants of the assumed change of temperature


def _about(triad: str) -> About:
    return About(
        f"{triad} bias follows the temperature with a delay",
        f"The sensing elements of the {triad}s reach a new temperature later than the thermometer, so "
        "their bias lags behind the temperature.",
        Actor.PLAN,
        "Soak several times longer than the lag, or compensate with the delayed temperature: {found}.",
    )


class _BiasTemperatureLagged(Shaped):
    """Adds c·(Tₑ − T) to the bias of each axis, where Tₑ is the temperature of the sensing element and T is the temperature that the
    thermometer shows. c·(Tₑ − T) is the difference between a bias c·Tₑ and a bias c·T. The model is τ·dTₑ/dt = T − Tₑ, with Tₑ = T when
    the recording begins."""

    stage, shape_name, shape_unit = "sensor", "tau", "s"
    shown_by = "a recorded temperature ramp, or segments soon after a change of temperature"
    over_segments = True
    kind: str

    def grid(self, observed: Observed) -> Array:
        acts = observed.of_kind(self.kind) and observed.last_change.any()
        return np.geomspace(30.0, 3000.0, 9) if acts else np.empty(0)

    def at(self, observed: Observed, value: float) -> Variant:
        unit, factor, natural = _SCALES[self.kind]
        behind = lag(observed, value)
        return Variant(tuple(per_axis(observed, self.kind, "c", unit, factor, natural * factor, behind)), value)

    def remembered(self, observed: Observed, value: float) -> tuple[TemperatureCourse, ...]:
        """Replaces all earlier temperatures by the temperatures at two instants, which have the same effect on later samples. At
        the first instant, T and Tₑ have the last value of Tₑ. At the second instant, T changes to its last value, and Tₑ does not
        change."""
        time, shown, behind = observed.time[-1:], observed.temperature[-1:], lag(observed, value)[-1]
        rate = float(observed.temperature_rate[-1])
        return TemperatureCourse(time, shown + behind, 0.0), TemperatureCourse(time, shown, rate)


class GyroBiasTemperatureLagged(_BiasTemperatureLagged):
    """Adds c·(Tₑ − T) to the bias of each gyro, where T is the temperature that the thermometer shows, and Tₑ is T after a
    first-order lag."""

    id, kind, about = "gyro_bias_temperature_lagged", "gyro", _about("gyro")


class AccelBiasTemperatureLagged(_BiasTemperatureLagged):
    """Adds c·(Tₑ − T) to the bias of each accelerometer, where T is the temperature that the thermometer shows, and Tₑ is T after a
    first-order lag."""

    id, hypothesis, kind, about = "accel_bias_temperature_lagged", False, "accel", _about("accelerometer")


def lag(observed: Observed, tau: float) -> Array:
    """Computes the difference Tₑ − T [K], shape (N,), where T is the temperature that the thermometer shows, and Tₑ is T after a
    first-order lag of `tau` [s]. Between two segments, the temperature is assumed to approach the first value of the next segment
    exponentially, starting with the slope at the end of the earlier segment. If this slope is zero or points away from the next value,
    the temperature is assumed to change in a step."""
    found = np.empty(len(observed.time))
    behind, before = 0.0, None
    for course in observed.past.get(tau, ()):
        behind = _through(course, tau, _reached(before, course, behind, tau))[-1]
        before = course
    for rows in observed.segments():
        time, order = np.unique(observed.time[rows], return_inverse=True)
        temperature = np.empty(len(time))
        temperature[order] = observed.temperature[rows]
        course = TemperatureCourse(time, temperature, float(observed.temperature_rate[rows][-1]))
        own = _through(course, tau, _reached(before, course, behind, tau))
        found[rows] = own[order]
        behind, before = float(own[-1]), course
    return found


def _reached(before: TemperatureCourse | None, course: TemperatureCourse, behind: float, tau: float) -> float:
    """Returns the lag Tₑ − T [K] at the first instant of a record of temperatures, `course`. `behind`: the lag Tₑ − T [K] at the end of
    the preceding record, `before`. Between the two records, T = T₁ + D·exp(−t/s). Tₑ − T₁ is then the sum of two terms. The first term is
    the initial value of Tₑ − T₁, which decays with the time constant τ. The second term is the convolution of D·exp(−t/s) with
    exp(−t/τ)/τ."""
    if before is None:
        return 0.0
    gap = float(course.time[0] - before.time[-1])
    rise = float(course.temperature[0] - before.temperature[-1])
    settles = rise / before.rate if before.rate * rise > 0 else 0.0
    s = min(settles, gap / _SETTLED)
    s *= 1 + 1e-6 * (abs(s - tau) < 1e-6 * tau)  # the formula is not defined if both are equal
    own, given = math.exp(-gap / tau), math.exp(-gap / s) if s > 0 else 0.0
    return (behind - rise) * own - rise * s / (s - tau) * (given - own)


def _through(course: TemperatureCourse, tau: float, behind: float) -> Array:
    """Returns the lag Tₑ − T (n,), K, at the times of a record of temperatures. `behind`: Tₑ − T at the first of these times, K.
    The temperature changes linearly between samples. With d = Tₑ − T, q = exp(−h/τ) and g = τ/h, a step of length h gives d₁ = q·d₀
    − g·(1 − q)·(T₁ − T₀)."""
    from scipy.signal import lfilter

    since = course.time - course.time[0]
    if np.ptp(course.temperature) == 0.0 or len(since) < 2:
        return np.asarray(behind * np.exp(-since / tau))
    nodes = np.linspace(0.0, since[-1], min(max(len(since), 16), _NODES))
    temperature = np.interp(nodes, since, course.temperature)
    step = float(nodes[1])
    q = math.exp(-step / tau)
    change = -(tau / step) * (1 - q) * np.diff(temperature, prepend=temperature[0])
    change[0] = behind
    return np.asarray(np.interp(since, nodes, lfilter([1.0], [1.0, -q], change)))
