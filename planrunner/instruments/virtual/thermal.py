"""Computes temperatures of the virtual world. The setpoint of the chamber changes at a limited rate, the air lags behind the
setpoint, and the sensor lags behind the air.

The setpoint r changes linearly to its target and then stays there. The air temperature T and the sensor temperature S are
first-order lags, dT/dt = (r − T)/τ_a and dS/dt = (T − S)/τ_s. Both equations are solved in closed form from the moment of the last
command, so the result for a given moment does not depend on how often the temperatures were queried before.
"""

from __future__ import annotations

import math

import numpy as np

from planrunner.base.arrays import Array
from planrunner.base.dataclass import dataclass


@dataclass(frozen=True, slots=True)
class Lags:
    """Rates of change of the setpoint, the air and the sensor. `ramp`: rate of change of the setpoint, K/s. `air`, `sensor`: time
    constants with which the air and the sensor lag behind, s."""

    ramp: float
    air: float
    sensor: float


@dataclass(frozen=True, slots=True)
class Command:
    """Contains the temperatures [K] at the moment of a command. `start`: time of the command, s. `target`: final value of the
    setpoint."""

    start: float
    setpoint: float
    air: float
    sensor: float
    target: float

    @classmethod
    def resting(cls, kelvin: float) -> Command:
        return cls(0.0, kelvin, kelvin, kelvin, kelvin)


def temperatures(command: Command, lags: Lags, times: Array) -> tuple[Array, Array, Array]:
    """Returns the temperatures [K] of setpoint, air and sensor at `times` (n,), s, as three arrays (n,). The times must not be
    before the command."""
    elapsed = np.asarray(times, dtype=float) - command.start
    change = command.target - command.setpoint
    ramping = abs(change) / lags.ramp
    slope = math.copysign(lags.ramp, change)
    during = np.minimum(elapsed, ramping)
    setpoint = np.where(elapsed < ramping, command.setpoint + slope * during, command.target)
    air, sensor = _follow(lags, command.setpoint, slope, command.air, command.sensor, during)
    if np.any(elapsed > ramping):
        end_air, end_sensor = _follow(lags, command.setpoint, slope, command.air, command.sensor, np.array(ramping))
        after = np.maximum(elapsed - ramping, 0.0)
        held = _follow(lags, command.target, 0.0, float(end_air), float(end_sensor), after)
        air, sensor = np.where(elapsed > ramping, held[0], air), np.where(elapsed > ramping, held[1], sensor)
    return setpoint, air, sensor


def time_to_reach(command: Command, lags: Lags, tolerance: float) -> float:
    """Returns the time [s] after the command until the air stays within `tolerance` [K] of the target.

    After the ramp, the difference between the air and the target decays exponentially. Before the end of the ramp, the air can be
    within the tolerance only if the whole change is no larger than the tolerance.
    """
    if abs(command.target - command.setpoint) <= tolerance and abs(command.target - command.air) <= tolerance:
        return 0.0
    ramping = abs(command.target - command.setpoint) / lags.ramp
    end = temperatures(command, lags, np.array([command.start + ramping]))[1][0]
    distance = abs(float(end) - command.target)
    return ramping + (lags.air * math.log(distance / tolerance) if distance > tolerance else 0.0)


def _follow(lags: Lags, origin: float, slope: float, air: float, sensor: float, elapsed: Array) -> tuple[Array, Array]:
    """Returns the temperatures [K] of air and sensor after the times `elapsed` (n,), s, as two arrays (n,). `air`, `sensor`:
    initial temperatures. The setpoint is `origin` + `slope`·t."""
    slow = lags.sensor if abs(lags.sensor - lags.air) > 1e-6 * lags.air else lags.air * (1 + 1e-6)
    air_off = air - (origin - slope * lags.air)
    shared = air_off * lags.air / (lags.air - slow)
    sensor_off = sensor - (origin - slope * (lags.air + slow)) - shared
    air_decay, sensor_decay = np.exp(-elapsed / lags.air), np.exp(-elapsed / slow)
    now = origin + slope * elapsed
    air_now = now - slope * lags.air + air_off * air_decay
    sensor_now = now - slope * (lags.air + slow) + shared * air_decay + sensor_off * sensor_decay
    return air_now, sensor_now
